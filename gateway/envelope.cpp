// The limits of Section III over a box of grids. With W = |v_p|²,
//   W = V²/2 + a + (V/2)√λ,  λ = V² + 4a − 4b²/V²,  a + jb = s Z̃_g   (eq:|vp|^2 ss, eq:lambda)
// is concave in Z_g, rises with V, and carries everything else: |i| = |s|/√W, and the bridge voltage.
#include "gateway/envelope.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace weakgrid {

namespace {

// Along one edge of the box, Z = Z_0 + t Z_1 with Z_1 = 1 or j, the t where W is the largest, if between the
// ends: √λ a_1 = 2 b b_1/V − V a_1, squared a quadratic in b of which one root is not spurious.
double stationary_point(SpaceVector s, SpaceVector Z_0, SpaceVector Z_1, double V) noexcept {
  const SpaceVector at_0 = s * conj(Z_0), slope = s * conj(Z_1);
  const double a_1 = slope.re, b_1 = slope.im;
  const double cross = at_0.re * b_1 - a_1 * at_0.im;
  const double root = std::sqrt(1.0 + 4.0 * b_1 * cross / (abs2(s) * (V * V)));
  const double b = a_1 * (V * V) * (1.0 + root) / (2.0 * b_1);
  return (b - at_0.im) / b_1;
}

struct Squared {
  double lambda;  ///< eq:lambda
  double W;       ///< eq:|vp|^2 ss; NaN where λ < 0
};

Squared voltage_squared(const Grid& grid, double omega, SpaceVector s) noexcept {
  const SpaceVector sZ = s * conj(SpaceVector{grid.R_g, omega * grid.L_g});
  const double V = grid.V, b_V = sZ.im / V;
  const double lambda = V * V + 4.0 * sZ.re - 4.0 * b_V * b_V;
  return {lambda, 0.5 * (V * V) + sZ.re + 0.5 * V * std::sqrt(lambda)};
}

struct Peak {
  double W = 0.0;
  Grid grid;
};

// The largest W of the box: at the highest voltage, on its boundary (W rises with a), at a corner or where an
// edge is stationary.
Peak peak_of(const GridBox& box, double omega, SpaceVector s) noexcept {
  const double V = box.V.high;
  Peak peak;
  const auto consider = [&](const Grid& grid) {
    const double W = voltage_squared(grid, omega, s).W;
    if (!(W <= peak.W)) peak = {W, grid};  // a NaN stays
  };
  for (const Grid& corner : corners(box, V)) consider(corner);
  const double X_low = omega * box.L_g.low, X_high = omega * box.L_g.high;
  if (X_low < X_high)
    for (const double R_g : {box.R_g.low, box.R_g.high}) {
      const double X_g = stationary_point(s, {R_g, 0.0}, {0.0, 1.0}, V);
      if (X_g > X_low && X_g < X_high) consider({R_g, X_g / omega, V});
    }
  if (box.R_g.low < box.R_g.high)
    for (const double L_g : {box.L_g.low, box.L_g.high}) {
      const double R_g = stationary_point(s, {0.0, omega * L_g}, {1.0, 0.0}, V);
      if (R_g > box.R_g.low && R_g < box.R_g.high) consider({R_g, L_g, V});
    }
  return peak;
}

// |v_p + jX_L i| of eq:L di: v_p conj(i) = s leaves nothing else to know.
double bridge_voltage(double v_p, SpaceVector s, double X_L) noexcept {
  const double i = abs(s) / v_p;
  return std::sqrt(v_p * v_p + X_L * i * (X_L * i) + 2.0 * X_L * s.im);
}

}  // namespace

BoxState box_state(const GridBox& box, double omega, SpaceVector s) noexcept {
  BoxState state;
  double W_min = 0.0;
  bool first = true;
  for (const Grid& corner : corners(box, box.V.low)) {
    const Squared here = voltage_squared(corner, omega, s);
    if (first || std::isnan(here.lambda) || here.lambda < state.lambda) {  // a NaN stays
      state.lambda = here.lambda;
      state.lambda_grid = corner;
    }
    if (first || !(here.W >= W_min)) {
      W_min = here.W;
      state.v_p_min_grid = corner;
    }
    first = false;
  }
  if (!(box.V.low > 0.0)) state.lambda = std::numeric_limits<double>::quiet_NaN();
  if (!(state.lambda >= 0.0)) return state;
  const Peak peak = peak_of(box, omega, s);
  state.v_p_min = std::sqrt(W_min);
  state.v_p_max = std::sqrt(peak.W);
  state.v_p_max_grid = peak.grid;
  state.exists = std::isfinite(state.v_p_min) && std::isfinite(state.v_p_max);
  return state;
}

namespace {

// Margins of the limits that need a steady state, all NaN if λ ≥ 0 but something overflows: so that there is
// a reason for the refusal.
struct StateMargins {
  double current, control, control_rough, v_p_min, v_p_max;
  Grid control_grid;
};

StateMargins margins_of(const BoxState& x, const Converter& converter, const Limits& limits, SpaceVector s,
                        double v_c) noexcept {
  constexpr double nan = std::numeric_limits<double>::quiet_NaN();
  const double X_L = converter.omega * converter.L;
  const double V_min = x.exists ? x.v_p_min : nan, V_max = x.exists ? x.v_p_max : nan;
  // departs from eq:limite control inductivo: exact with the drop in the filter, which the paper neglects.
  // Convex in W, so the largest bridge voltage is at one of the extremes of |v_p|.
  const double at_min = bridge_voltage(V_min, s, X_L), at_max = bridge_voltage(V_max, s, X_L);
  const bool low_binds = at_min > at_max;
  const double reach = v_c * converter.mu_max;
  return {.current = limits.i_max - abs(s) / V_min,          // eq:q safe zone inductivo
          .control = reach - (low_binds ? at_min : at_max),  // eq:L di
          .control_rough = reach - V_max,                    // eq:limite control inductivo
          .v_p_min = V_min - limits.v_p_min,
          .v_p_max = limits.v_p_max - V_max,
          .control_grid = low_binds ? x.v_p_min_grid : x.v_p_max_grid};
}

}  // namespace

Assessment assess(const GridBox& box, const Converter& converter, const Limits& limits,
                  const Setpoint& setpoint) noexcept {
  const SpaceVector s{setpoint.p, setpoint.q};
  const Reserve& r = limits.reserve;
  const BoxState x = box_state(box, converter.omega, s);

  Assessment result;
  const auto add = [&margins = result.margins](Limit limit, double margin, double required,
                                               const Grid& grid) {
    margins.add({limit, limit != Limit::control_rough, margin, required, grid});
  };
  add(Limit::steady_state, x.lambda, r.steady_state, x.lambda_grid);  // eq:lambda
  if (x.lambda >= 0.0) {
    const StateMargins m = margins_of(x, converter, limits, s, setpoint.v_c);
    add(Limit::current, m.current, r.current, x.v_p_min_grid);
    add(Limit::control, m.control, r.control, m.control_grid);
    add(Limit::control_rough, m.control_rough, 0.0, x.v_p_max_grid);
    add(Limit::pcc_voltage_min, m.v_p_min, r.pcc_voltage, x.v_p_min_grid);
    add(Limit::pcc_voltage_max, m.v_p_max, r.pcc_voltage, x.v_p_max_grid);
  }
  add(Limit::dc_voltage_min, setpoint.v_c - limits.v_c_min, r.dc_voltage, x.lambda_grid);
  add(Limit::dc_voltage_max, limits.v_c_max - setpoint.v_c, r.dc_voltage, x.lambda_grid);
  result.admissible = std::none_of(result.margins.begin(), result.margins.end(), violated);
  return result;
}

double slack_in_plane(const GridBox& box, const Converter& converter, const Limits& limits,
                      const Setpoint& setpoint) noexcept {
  const SpaceVector s{setpoint.p, setpoint.q};
  const Reserve& r = limits.reserve;
  const BoxState x = box_state(box, converter.omega, s);
  if (!(x.lambda >= 0.0 && x.exists)) return x.lambda < 0.0 ? x.lambda : -1e300;
  const StateMargins m = margins_of(x, converter, limits, s, setpoint.v_c);
  double least = x.lambda - r.steady_state;
  for (const double inside :
       {m.current - r.current, m.control - r.control, m.v_p_min - r.pcc_voltage, m.v_p_max - r.pcc_voltage})
    if (!(inside >= least)) least = inside;
  return std::isnan(least) ? -1e300 : least;
}

double slack(const GridBox& box, const Converter& converter, const Limits& limits,
             const Setpoint& setpoint) noexcept {
  double least = slack_in_plane(box, converter, limits, setpoint);
  for (const double inside : {setpoint.v_c - limits.v_c_min - limits.reserve.dc_voltage,
                              limits.v_c_max - setpoint.v_c - limits.reserve.dc_voltage})
    if (!(inside >= least)) least = inside;
  return std::isnan(least) ? -1e300 : least;
}

double upper_slack(const BoxState& x, const Converter& converter, const Limits& limits,
                   const Setpoint& setpoint) noexcept {
  const StateMargins m = margins_of(x, converter, limits, {setpoint.p, setpoint.q}, setpoint.v_c);
  const double control = m.control - limits.reserve.control, v_p = m.v_p_max - limits.reserve.pcc_voltage;
  return std::isnan(v_p) || v_p < control ? v_p : control;
}

Assessment assess(const Grid& grid, const Converter& converter, const Limits& limits,
                  const Setpoint& setpoint) noexcept {
  return assess(box_of(grid), converter, limits, setpoint);
}

}  // namespace weakgrid
