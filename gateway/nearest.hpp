// The admissible setpoint nearest to one that is not: what a refusal offers.
#pragma once

#include <optional>

#include "gateway/admissible_area.hpp"

namespace weakgrid {

/// What of the request the offer keeps.
enum class Policy : std::uint8_t { minimum_distance, keep_p, keep_q, keep_power_factor };

/// Admissible on every grid of the box and, under the policy, nearest to `wanted` in the (p, q) plane; v_c is
/// brought into its range first and then stays. keep_power_factor: on the line through p = q = 0, q/p kept,
/// signs may turn. None: nothing admissible was found, or an input is not finite. Bounded, heap-free.
/// `area` only saves time: it is traced anew (1 … 10 ms) where it is of another box, v_c or limits.
std::optional<Setpoint> nearest_admissible(AdmissibleArea& area, const GridBox& box,
                                           const Converter& converter, const Limits& limits,
                                           const Setpoint& wanted, Policy policy) noexcept;

}  // namespace weakgrid
