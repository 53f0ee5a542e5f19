// What the measured operating point says of the grid. Behind an impedance Z_g stands
// |v_g|² = |v_p|² − 2 Re(Z_g conj(s)) + |Z_g|² |i|², Thevenin's circuit read backwards (eq:|vp|^2 ss).
#pragma once

#include <cstdint>
#include <optional>

#include "gateway/grid_box.hpp"
#include "plant/model.hpp"

namespace weakgrid {

/// Means over a while of standing still.
struct OperatingPoint {
  double v_p2 = 0.0;  ///< |v_p|²
  double i2 = 0.0;    ///< |i|²
  SpaceVector s;      ///< p + jq
};

/// The least and the most |v_g| behind an impedance of the box, exact: the formula is convex and separable in
/// R_g and X_g. Its own reverse is the steady state: there, some grid of the box has this |v_g|.
Interval implied_voltage(const GridBox& box, double omega, const OperatingPoint& point) noexcept;

/// Cycle after cycle, whether any grid of the box explains the measurements.
class GridEvidence {
 public:
  struct Configuration {
    std::uint32_t cycle_steps = 200;  ///< one period of the grid
    std::uint32_t cycles = 10;        ///< so many in a row contradict before it counts; 0: never
    double tolerance = 0.02;          ///< of |v_g|: what measurement and transients may be off
  };
  explicit GridEvidence(const Configuration& configuration) noexcept : configuration_(configuration) {}

  /// One sample of a unit that runs; a blocked one tells nothing. Some: no grid of the box explains the last
  /// `cycles` cycles; the |v_g| that would, over all impedances of the box and all these cycles.
  std::optional<Interval> add(const GridBox& box, double omega, const Measurement& sample) noexcept;

 private:
  Configuration configuration_;
  OperatingPoint sum_;
  std::uint32_t samples_ = 0;
  std::uint32_t contradictions_ = 0;
  Interval implied_{};
};

}  // namespace weakgrid
