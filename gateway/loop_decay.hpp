// How fast small disturbances of the closed loop die out at an operating point: what the envelope does not
// say. Section IV, with the PCC voltage fed back as it is: the paper's "Transient Stability Filtering v_p"
// leaves Re{ĩ e_vp} out as an input.
#pragma once

#include "plant/model.hpp"

namespace weakgrid {

/// The law whose decay is asked for; continuous, with the gains that the sampled loop uses.
struct LoopModel {
  Converter converter;
  double k1 = 0.0, k2 = 0.0, k3 = 0.0;  ///< 1/s², 1/s, 1/s³
  double kappa = 92.0;                  ///< κ_r of the notch, 1/s
};

/// A lower bound, in 1/s, of the decay rate of the slowest mode of (i, v̂_p, ê_ξ1, ŷ), eight real states,
/// at the steady state (v_p, i) on this grid, to within rounding and 0.1/s; at most 4/s below it. Negative:
/// it grows. Bounded, heap-free,
/// + − × ÷ only. NaN or infinite inputs: −∞.
/// Stops as soon as it has shown `enough`: then the bound may be that far below.
double loop_decay(const LoopModel& model, const Grid& grid, SpaceVector v_p, SpaceVector i,
                  double enough = 1e300) noexcept;

}  // namespace weakgrid
