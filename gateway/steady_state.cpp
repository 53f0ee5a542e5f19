// Steady state in closed form (Section III). Only + − × ÷ √: a recorded decision re-executes bit for bit.
#include "gateway/steady_state.hpp"

#include <cmath>
#include <limits>

namespace weakgrid {

SteadyState steady_state(SpaceVector Z_g, double V, SpaceVector s) noexcept {
  constexpr double nan = std::numeric_limits<double>::quiet_NaN();
  constexpr SpaceVector none{nan, nan};
  if (!(V > 0.0)) return {nan, false, none, none};

  // eq:i ss times ṽ_p, with v_p of eq:vp ss, is |v_p|² = V ṽ_p + Z_g s̃. Its imaginary part gives Im v_p, its
  // real part a quadratic in Re v_p. Written so, nothing is divided by |Z_g|², as eq:mag_i2 does.
  const SpaceVector sZ = s * conj(Z_g);
  const double a = sZ.re;
  const double b_V = sZ.im / V;
  const double lambda = V * V + 4.0 * a - 4.0 * b_V * b_V;  // eq:lambda
  if (!(lambda >= 0.0)) return {lambda, false, none, none};

  const SpaceVector v_p{0.5 * (V + std::sqrt(lambda)), -b_V};  // eq:|vp|^2 ss
  const SpaceVector i = conj(s / v_p);                         // eq:s
  if (!finite(v_p) || !finite(i)) return {lambda, false, none, none};
  return {lambda, true, v_p, i};
}

}  // namespace weakgrid
