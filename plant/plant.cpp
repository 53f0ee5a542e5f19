// Plant: classical Runge–Kutta over the substeps of one period.
#include "plant/plant.hpp"

namespace weakgrid {

Plant::Plant(const Converter& converter, const Timing& timing, unsigned substeps, const Grid& grid,
             double v_c) noexcept
    : converter_(converter),
      hold_(timing.hold),
      substeps_(substeps),
      h_(period_s(timing) / static_cast<double>(substeps)),
      turn_half_(unit_phasor(0.5 * converter.omega * h_)),
      turn_period_(unit_phasor(converter.omega * period_s(timing))),
      v_c_(v_c) {
  settle_idle(grid);
}

void Plant::settle_idle(const Grid& grid) noexcept {
  const SpaceVector v_g = grid.V * grid_phasor_;
  i_ = {};
  i_mean_ = {};
  v_p_ = v_g;
  v_p_mean_ = v_g;
  mu_ = (v_g / v_c_) * conj(turn_period_);
}

void Plant::restart(double v_c, const Grid& grid) noexcept {
  v_c_ = v_c;
  settle_idle(grid);
}

Plant::Circuit Plant::circuit(const Grid& grid) const noexcept {
  const double L = converter_.L, L_sum = L + grid.L_g;
  return {grid.R_g, 1.0 / L_sum, grid.L_g / L_sum, L / L_sum, 1.0 / converter_.C};
}

Plant::State Plant::derivative(const State& x, SpaceVector mu, SpaceVector v_g, double p_i,
                               const Circuit& c) noexcept {
  return {c.per_L_sum * (x.v_c * mu - v_g - c.R_g * x.i),                // eq:L+Lg di
          c.per_C * (p_i / x.v_c - (mu.re * x.i.re + mu.im * x.i.im))};  // eq:C vC
}

SpaceVector Plant::pcc_voltage(const State& x, SpaceVector mu, SpaceVector v_g, const Circuit& c) noexcept {
  return (c.share_of_bridge * x.v_c) * mu + c.share_of_grid * (v_g + c.R_g * x.i);  // eq:vp
}

void Plant::turn_grid() noexcept {
  const SpaceVector turned = grid_phasor_ * turn_period_;
  // One Newton step towards |e^{jωt}| = 1, so that rounding never adds up.
  grid_phasor_ = (1.5 - 0.5 * abs2(turned)) * turned;
}

void Plant::advance(SpaceVector mu, double p_i, const Grid& grid) noexcept {
  mu_ = mu;
  SpaceVector v_g = grid.V * grid_phasor_;
  const Circuit c = circuit(grid);
  SpaceVector v_p = pcc_voltage({i_, v_c_}, mu, v_g, c);
  SpaceVector v_p_sum{}, i_sum{};
  const double h = h_;
  for (unsigned n = 0; n < substeps_; ++n) {
    const State x0{i_, v_c_};
    const SpaceVector v_g_mid = v_g * turn_half_;
    const SpaceVector v_g_end = v_g_mid * turn_half_;
    const bool turning = hold_ == Hold::turning;
    const SpaceVector mu_mid = turning ? mu * turn_half_ : mu;
    const SpaceVector mu_end = turning ? mu_mid * turn_half_ : mu;

    const State k1 = derivative(x0, mu, v_g, p_i, c);
    const State x1{x0.i + (0.5 * h) * k1.i, x0.v_c + 0.5 * h * k1.v_c};
    const State k2 = derivative(x1, mu_mid, v_g_mid, p_i, c);
    const State x2{x0.i + (0.5 * h) * k2.i, x0.v_c + 0.5 * h * k2.v_c};
    const State k3 = derivative(x2, mu_mid, v_g_mid, p_i, c);
    const State x3{x0.i + h * k3.i, x0.v_c + h * k3.v_c};
    const State k4 = derivative(x3, mu_end, v_g_end, p_i, c);
    i_ = x0.i + (h / 6.0) * (k1.i + 2.0 * (k2.i + k3.i) + k4.i);
    v_c_ = x0.v_c + (h / 6.0) * (k1.v_c + 2.0 * (k2.v_c + k3.v_c) + k4.v_c);

    // Simpson's rule over the substep. Stage 2 falls short of the middle by as much as stage 3 overshoots it.
    const State middle{0.5 * (x1.i + x2.i), 0.5 * (x1.v_c + x2.v_c)};
    const SpaceVector v_p_end = pcc_voltage({i_, v_c_}, mu_end, v_g_end, c);
    v_p_sum = v_p_sum + (v_p + 4.0 * pcc_voltage(middle, mu_mid, v_g_mid, c) + v_p_end);
    i_sum = i_sum + (x0.i + 4.0 * middle.i + i_);

    v_p = v_p_end;
    v_g = v_g_end;
    mu = mu_end;
  }
  const double weights = 6.0 * static_cast<double>(substeps_);
  v_p_ = v_p;
  v_p_mean_ = v_p_sum / weights;
  i_mean_ = i_sum / weights;
  turn_grid();
}

void Plant::advance_blocked(const Grid& grid) noexcept {
  turn_grid();
  settle_idle(grid);
}

}  // namespace weakgrid
