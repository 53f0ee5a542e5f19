// The averaged converter, its DC link and the Thévenin grid, integrated over one held modulation.
// Section II of the paper.
#pragma once

#include "plant/model.hpp"

namespace weakgrid {

/// States i (complex) and v_c; v_p is algebraic. Heap-free, noexcept. The caller keeps v_c > 0 (protection).
class Plant {
 public:
  /// Starts idle: i = 0 and v_c as given, μ such that v_p = v_g. substeps: RK4 steps per period, 1 … 1000.
  Plant(const Converter& converter, const Timing& timing, unsigned substeps, const Grid& grid,
        double v_c) noexcept;

  /// Integrates one period with p_i and the grid constant. mu: its αβ value at the start of the period.
  void advance(SpaceVector mu, double p_i, const Grid& grid) noexcept;

  /// One period with the bridge blocked: i = 0, v_p = v_g, v_c stays.
  void advance_blocked(const Grid& grid) noexcept;

  /// Back to idle at the present grid angle.
  void restart(double v_c, const Grid& grid) noexcept;

  SpaceVector i() const noexcept { return i_; }
  double v_c() const noexcept { return v_c_; }
  /// At the end of the last period, with the μ that was in force in it.
  SpaceVector v_p() const noexcept { return v_p_; }
  /// αβ means over the last period.
  SpaceVector v_p_mean() const noexcept { return v_p_mean_; }
  SpaceVector i_mean() const noexcept { return i_mean_; }
  /// The μ that continues the one in force into the next period: turned on by ωT.
  SpaceVector mu_turned() const noexcept { return mu_ * turn_period_; }

 private:
  struct State {
    SpaceVector i;
    double v_c;
  };
  // Of one period: divisions are what costs most of a substep.
  struct Circuit {
    double R_g, per_L_sum, share_of_bridge, share_of_grid, per_C;
  };
  Circuit circuit(const Grid& grid) const noexcept;
  static State derivative(const State& x, SpaceVector mu, SpaceVector v_g, double p_i,
                          const Circuit& c) noexcept;
  static SpaceVector pcc_voltage(const State& x, SpaceVector mu, SpaceVector v_g, const Circuit& c) noexcept;
  void turn_grid() noexcept;
  void settle_idle(const Grid& grid) noexcept;

  Converter converter_;
  Hold hold_;
  unsigned substeps_;
  double h_;                           // substep, seconds
  SpaceVector turn_half_;              // e^{jωh/2}
  SpaceVector turn_period_;            // e^{jωT}
  SpaceVector grid_phasor_{1.0, 0.0};  // e^{jωt}
  SpaceVector mu_;                     // in force in the last period, at its start
  SpaceVector i_;
  double v_c_;
  SpaceVector v_p_, v_p_mean_, i_mean_;
};

}  // namespace weakgrid
