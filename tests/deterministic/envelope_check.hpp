// The limits of Section III once more, by another way than the gateway's: |v_p|² as the upper root of
// W² − (V² + 2 Re(Z_g s̃)) W + |Z_g|²|s|² = 0, at grids spread over the box.
#pragma once

#include <cmath>
#include <string>

#include "gateway/envelope.hpp"

namespace weakgrid::deterministic {

/// Why this setpoint may not stand on this grid; empty: it may.
inline std::string limit_broken(const Setpoint& s, double R, double X, double V, double X_L, double mu_max,
                                const Limits& limits) {
  constexpr double tolerance = 1e-6;
  const double s2 = s.p * s.p + s.q * s.q, Z2 = R * R + X * X;
  const double b = V * V + 2.0 * (R * s.p + X * s.q);
  const double discriminant = b * b - 4.0 * Z2 * s2;
  if (!(discriminant >= -tolerance) || !(b > 0.0)) return "no steady state";
  const double W = 0.5 * (b + std::sqrt(std::fmax(discriminant, 0.0)));
  const double v_p = std::sqrt(W), i = std::sqrt(s2) / v_p;
  const double bridge = std::hypot(v_p + X_L * s.q / v_p, X_L * s.p / v_p);
  if (!(i <= limits.i_max + tolerance)) return "|i| = " + std::to_string(i);
  if (!(v_p >= limits.v_p_min - tolerance && v_p <= limits.v_p_max + tolerance))
    return "|v_p| = " + std::to_string(v_p);
  if (!(bridge <= s.v_c * mu_max + tolerance)) return "bridge voltage " + std::to_string(bridge);
  if (!(s.v_c >= limits.v_c_min - tolerance && s.v_c <= limits.v_c_max + tolerance))
    return "v_c = " + std::to_string(s.v_c);
  return "";
}

/// The same on every grid of the box, at three levels of each quantity.
inline std::string limit_broken(const Setpoint& s, const GridBox& box, const Converter& converter,
                                const Limits& limits) {
  const double omega = converter.omega;
  const auto level = [](Interval x, int n) { return x.low + 0.5 * n * (x.high - x.low); };
  for (int r = 0; r < 3; ++r)
    for (int l = 0; l < 3; ++l)
      for (int v = 0; v < 3; ++v) {
        const double R = level(box.R_g, r), X = omega * level(box.L_g, l), V = level(box.V, v);
        const std::string broken = limit_broken(s, R, X, V, omega * converter.L, converter.mu_max, limits);
        if (!broken.empty())
          return broken + " at R_g = " + std::to_string(R) + ", X_g = " + std::to_string(X) +
                 ", V = " + std::to_string(V);
      }
  return "";
}

}  // namespace weakgrid::deterministic
