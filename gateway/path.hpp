// The way from one setpoint to another, p, q and v_c moving together: a straight line in (p, q, v_c).
#pragma once

#include <optional>

#include "gateway/envelope.hpp"

namespace weakgrid {

/// The first setpoint on the way that is outside on some grid of the box, by more than `tolerance`; none: the
/// whole way is inside. Guaranteed between samples too, by a bound on how fast |v_p|² changes; bounded,
/// so that a way that follows a limit at less than some 1e-4 may be taken for one that leaves.
std::optional<Setpoint> first_outside(const GridBox& box, const Converter& converter, const Limits& limits,
                                      const Setpoint& from, const Setpoint& to,
                                      double tolerance = 1e-6) noexcept;

/// Where the straight way leaves: one setpoint in between from which both legs stay inside, if a short one is
/// found.
std::optional<Setpoint> detour(const GridBox& box, const Converter& converter, const Limits& limits,
                               const Setpoint& from, const Setpoint& to) noexcept;

}  // namespace weakgrid
