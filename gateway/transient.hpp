// The paper's conditions for stability in a transient (eq:condicion conservativa and the one after it), and
// the ramp that keeps them: a PCC voltage that rises faster than the notch follows is a matter of stability.
#pragma once

#include "gateway/grid_box.hpp"
#include "gateway/loop_decay.hpp"

namespace weakgrid {

/// The largest V_p/V̂_p at which both conditions hold on this grid; below 1: they do not hold at rest either.
/// Within 1e-9; κ_i = 0 as in the paper. Total: NaN inputs give 0.
double voltage_ratio_max(const LoopModel& model, const Grid& grid) noexcept;

/// The largest V_p/V̂_p while |v_p| rises from `from` to `to` by raised cosine within ramp_s: the notch, first
/// order, lags by at most (dV/dt)_max/κ. At least 1.
double voltage_ratio(const LoopModel& model, double from, double to, double ramp_s) noexcept;

/// The shortest ramp of which voltage_ratio stays at or below `ratio` > 1; 0: any.
double ramp_for_ratio(const LoopModel& model, double from, double to, double ratio) noexcept;

}  // namespace weakgrid
