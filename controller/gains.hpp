// Pole placement for the error triple (e_ξ1, e_ξ2, y), continuous and sampled, and the notch gain.
// Section IV of the paper. For start-up: uses Eigen, not for the step.
#pragma once

#include <array>

#include "controller/notch.hpp"
#include "plant/model.hpp"

namespace weakgrid {

struct Gains {
  double k1 = 0.0;  ///< 1/s²
  double k2 = 0.0;  ///< 1/s
  double k3 = 0.0;  ///< 1/s³
};

/// Settling times in seconds; a real pole at −4.6/t settles within t.
using SettlingTimes = std::array<double, 3>;

inline constexpr double settling_factor = 4.6;

/// The paper's gains: poles at −4.6/t.
Gains continuous_gains(const SettlingTimes& settling_times_s);

/// Poles at e^{−4.6 T/t} for the triple discretised exactly at T seconds (Ackermann).
Gains sampled_gains(const SettlingTimes& settling_times_s, double T);

/// The filter for κ = κ_r + jκ_i in 1/s.
Notch make_notch(SpaceVector kappa, double omega, double T);

/// e^{−x} for 0 ≤ x ≤ 1e15 from + × ÷ alone, so that every machine derives the same constants.
double exp_minus(double x);

}  // namespace weakgrid
