// The notch filter that makes v̂_p of v_p. eq:dvp_est
#pragma once

#include "plant/model.hpp"

namespace weakgrid {

/// Discretised in the rotating frame: exactly unity gain and zero phase at ω, where a hold in αβ would lag
/// half a step.
struct Notch {
  SpaceVector turn;    ///< e^{jωT}
  SpaceVector intake;  ///< 1 − e^{−κT}, κ = κ_r + jκ_i in 1/s

  /// v̂_p at the next sample, from v̂_p and v_p at this one.
  constexpr SpaceVector next(SpaceVector v_p_hat, SpaceVector v_p) const {
    return turn * (v_p_hat + intake * (v_p - v_p_hat));
  }
};

}  // namespace weakgrid
