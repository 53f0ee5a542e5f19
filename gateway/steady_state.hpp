// Steady state of a converter that injects s = p + jq into a Thévenin grid. Section III; per unit.
#pragma once

#include "plant/model.hpp"

namespace weakgrid {

/// Frame: v_g = V real. v_p and i are NaN unless the steady state exists, so that no comparison admits them.
struct SteadyState {
  double lambda;  ///< λ of eq:lambda; NaN if V is not above 0 or an input is NaN
  bool exists;    ///< λ ≥ 0 and everything below is finite
  SpaceVector v_p;
  SpaceVector i;
};

/// The root on the operating branch, √λ = V + 2 Re(Z_g i) ≥ 0: for the same power it carries less current, at
/// a higher |v_p|, than the other. Z_g = R_g + jX_g may be zero: nothing is singular on a strong grid, and
/// |v_p| ≥ V/2 always. Total: NaN, infinite or overflowing inputs give exists = false.
SteadyState steady_state(SpaceVector Z_g, double V, SpaceVector s) noexcept;

}  // namespace weakgrid
