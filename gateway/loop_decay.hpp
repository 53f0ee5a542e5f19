// How fast small disturbances of the closed loop die out at an operating point: what the envelope does not
// say. Section IV, with the PCC voltage fed back as it is: the paper's "Transient Stability Filtering v_p"
// leaves Re{ĩ e_vp} out as an input.
#pragma once

#include <array>

#include "plant/model.hpp"

namespace weakgrid {

/// The law whose decay is asked for; continuous, with the gains that the sampled loop uses.
struct LoopModel {
  Converter converter;
  double k1 = 0.0, k2 = 0.0, k3 = 0.0;  ///< 1/s², 1/s, 1/s³
  double kappa = 92.0;                  ///< κ_r of the notch, 1/s
};

/// Of (i, v̂_p, ê_ξ1, ŷ), eight real states, linearised: the coefficients of its characteristic polynomial,
/// [k] of s^k, [8] = 1, with time in units of `unit_s`. Not finite if an input was not.
struct LoopPolynomial {
  std::array<double, 9> coefficients;
  double unit_s;
};

/// At the steady state (v_p, i) on this grid.
LoopPolynomial loop_polynomial(const LoopModel& model, const Grid& grid, SpaceVector v_p,
                               SpaceVector i) noexcept;

/// Every mode decays faster than `rate`, in 1/s: Routh–Hurwitz. False where it is not finite.
bool decays(const LoopPolynomial& loop, double rate) noexcept;

/// The decay rate of the slowest mode, in 1/s; negative: it grows. Within 1e-3/s below what decays() tells,
/// and that within 0.1/s of the truth. Bounded, heap-free, + − × ÷ only. −∞ where nothing decays() at all.
double loop_decay(const LoopPolynomial& loop) noexcept;

}  // namespace weakgrid
