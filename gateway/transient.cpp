// Transient conditions: see the header.
#include "gateway/transient.hpp"

#include <algorithm>

namespace weakgrid {

double voltage_ratio_max(const LoopModel& m, const Grid& grid) noexcept {
  const double L = m.converter.L, L_g = grid.L_g, share = L / (L + L_g);
  const double K_2 = (grid.R_g + L * m.k2) / (L + L_g);
  const double slowest = m.k3 / m.k1;
  const double K_1 = share * m.k1, K_3 = share * m.k3;
  const double turn = m.converter.omega * L_g / (L + L_g);
  const auto hold = [&](double ratio) {
    const double K_2r = K_2 - m.kappa * (ratio - 1.0);
    const double first = K_2r - slowest;  // eq:condicion conservativa
    const double phase = turn + m.kappa * ratio;
    return first > 0.0 && first * first - K_3 / (K_1 * K_1) * (phase * phase) * K_2r > 0.0;
  };
  // Both fall with the ratio. The first is linear: its root bounds the search.
  if (!hold(0.0)) return 0.0;
  double low = 0.0, high = 1.0 + (K_2 - slowest) / m.kappa;
  while (high - low > 1e-9 * high) {
    const double middle = 0.5 * (low + high);
    (hold(middle) ? low : high) = middle;
  }
  return low;
}

double voltage_ratio(const LoopModel& m, double from, double to, double ramp_s) noexcept {
  const double rise = to - from;
  if (!(rise > 0.0)) return 1.0;
  return 1.0 + rise / from * std::min(1.0, 0.5 * pi / (m.kappa * ramp_s));
}

double ramp_for_ratio(const LoopModel& m, double from, double to, double ratio) noexcept {
  const double rise = to - from;
  if (!(rise > 0.0) || rise / from <= ratio - 1.0) return 0.0;
  return 0.5 * pi * rise / (from * m.kappa * (ratio - 1.0));
}

}  // namespace weakgrid
