// The limits of Section III, assessed at the one current that the setpoint asks for.
#include "gateway/envelope.hpp"

#include <algorithm>

#include "gateway/steady_state.hpp"

namespace weakgrid {

Assessment assess(const Grid& grid, const Converter& converter, const Limits& limits,
                  const Setpoint& setpoint) noexcept {
  const SpaceVector Z_g{grid.R_g, converter.omega * grid.L_g};
  const double X_L = converter.omega * converter.L;
  const double v_c = setpoint.v_c;
  const auto [lambda, exists, v_p, i] = steady_state(Z_g, grid.V, {setpoint.p, setpoint.q});

  Assessment result;
  Margins& margins = result.margins;
  margins.add({Limit::steady_state, true, lambda});  // eq:lambda
  // λ and not `exists`: what overflows beyond λ leaves NaN margins here, and so a reason for the refusal.
  if (lambda >= 0.0) {
    const double V_p = abs(v_p);
    // departs from eq:limite control inductivo: exact with the drop in the filter, which the paper neglects
    const double V_bridge = abs(v_p + X_L * times_j(i));
    margins.add({Limit::current, true, limits.i_max - abs(i)});                // eq:q safe zone inductivo
    margins.add({Limit::control, true, v_c * converter.mu_max - V_bridge});    // eq:L di
    margins.add({Limit::control_rough, false, v_c * converter.mu_max - V_p});  // eq:limite control inductivo
    margins.add({Limit::pcc_voltage_min, true, V_p - limits.v_p_min});
    margins.add({Limit::pcc_voltage_max, true, limits.v_p_max - V_p});
  }
  margins.add({Limit::dc_voltage_min, true, v_c - limits.v_c_min});
  margins.add({Limit::dc_voltage_max, true, limits.v_c_max - v_c});
  result.admissible = std::none_of(margins.begin(), margins.end(), violated);
  return result;
}

}  // namespace weakgrid
