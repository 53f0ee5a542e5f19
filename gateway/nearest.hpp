// The admissible setpoint nearest to one that is not: what a refusal offers.
#pragma once

#include <optional>

#include "gateway/envelope.hpp"

namespace weakgrid {

/// What of the request the offer keeps.
enum class Policy : std::uint8_t { minimum_distance, keep_p, keep_q, keep_power_factor };

/// Admissible on every grid of the box and, under the policy, nearest to `wanted` in the (p, q) plane; v_c is
/// brought into its range first and then stays. keep_power_factor: on the line through p = q = 0, q/p kept,
/// signs may turn. None: nothing admissible was found, or an input is not finite. Bounded, heap-free.
std::optional<Setpoint> nearest_admissible(const GridBox& box, const Converter& converter,
                                           const Limits& limits, const Setpoint& wanted,
                                           Policy policy) noexcept;

}  // namespace weakgrid
