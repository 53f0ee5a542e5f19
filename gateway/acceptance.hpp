// What a setpoint must pass before it may stand, on every grid that may be: envelope, certificate, and the
// way to it and from it to the fallback.
#pragma once

#include <cstdint>
#include <optional>

#include "gateway/course.hpp"
#include "gateway/envelope.hpp"
#include "gateway/loop_decay.hpp"
#include "gateway/nearest.hpp"

namespace weakgrid {

/// What setpoints are held against.
struct Rules {
  GridBox box;  ///< what the gateway knows of the grid
  Converter converter;
  Limits limits;
  std::optional<LoopModel> loop;  ///< none: no certificate, as for the unfiltered law
  double decay_min = 30.0;        ///< 1/s, of small disturbances: README
  Setpoint fallback;              ///< at the end of a lease
  double default_ramp_s = 0.020;  ///< reference steps would saturate μ on a weak grid
  double max_ramp_s = 60.0;
};

bool is_inside(const Rules& rules, const Setpoint& setpoint) noexcept;

/// Small disturbances decay at the target, and the paper's transient conditions hold on the way: ramp_s is
/// made longer until they do. False: no ramp does, or it would be longer than allowed. Adds both margins.
bool certify(const Rules& rules, const Setpoint& from, const Setpoint& to, double& ramp_s,
             Margins* margins) noexcept;

/// It may stand, however it was come by.
bool may_stand(const Rules& rules, const Setpoint& setpoint) noexcept;

/// Where the way from what stands at `start` to `to` leaves the envelope; or from `to` to the fallback, which
/// a lost client would take. A way that begins outside (the grid has changed) may only lead back.
std::optional<Setpoint> leaves(const Rules& rules, const Course& course, const Setpoint& to,
                               std::uint64_t start, std::uint32_t ramp_steps) noexcept;

/// The nearest setpoint that would be accepted from rest at `from`: inside, and if the certificate does not
/// hold there, the last on the straight way from `from` for which it does. `area`: see nearest_admissible.
std::optional<Setpoint> acceptable_near(const Rules& rules, AdmissibleArea& area, const Setpoint& wanted,
                                        const Setpoint& from, Policy policy) noexcept;

}  // namespace weakgrid
