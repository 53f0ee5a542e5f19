// Asks the boundary; every point that is returned has been assessed.
#include "gateway/nearest.hpp"

#include <algorithm>
#include <cmath>

namespace weakgrid {

std::optional<Setpoint> nearest_admissible(AdmissibleArea& area, const GridBox& box,
                                           const Converter& converter, const Limits& limits,
                                           const Setpoint& wanted, Policy policy) noexcept {
  const SpaceVector s{wanted.p, wanted.q};
  const double v_c_low = limits.v_c_min + limits.reserve.dc_voltage;
  const double v_c_high = limits.v_c_max - limits.reserve.dc_voltage;
  if (!finite(s) || !std::isfinite(wanted.v_c) || !(v_c_low <= v_c_high)) return std::nullopt;
  double v_c = std::clamp(wanted.v_c, v_c_low, v_c_high);
  // The bounds are sums: the last bit may fall outside.
  for (int k = 0; k < 4; ++k) {
    if (v_c - limits.v_c_min < limits.reserve.dc_voltage) v_c = std::nextafter(v_c, 1e3);
    if (limits.v_c_max - v_c < limits.reserve.dc_voltage) v_c = std::nextafter(v_c, 0.0);
  }
  const auto admits = [&](SpaceVector at) {
    return slack(box, converter, limits, {at.re, at.im, v_c}) >= 0.0;
  };
  if (admits(s)) return Setpoint{s.re, s.im, v_c};
  if (!area.is_of(box, converter, limits, v_c)) area = AdmissibleArea(box, converter, limits, v_c);
  std::optional<SpaceVector> found;
  switch (policy) {
    case Policy::minimum_distance:
      found = area.nearest(s);
      break;
    case Policy::keep_p:
      found = area.nearest_on_line(s, {0.0, 1.0});
      if (found) found->re = s.re;
      break;
    case Policy::keep_q:
      found = area.nearest_on_line(s, {1.0, 0.0});
      if (found) found->im = s.im;
      break;
    case Policy::keep_power_factor:
      if (abs2(s) > 0.0) found = area.nearest_on_line(s, s / abs(s));
      break;
  }
  if (!found || !admits(*found)) return std::nullopt;
  return Setpoint{found->re, found->im, v_c};
}

}  // namespace weakgrid
