// What a gateway knows of the grid: each of R_g, L_g and V lies in an interval. Per unit, L_g in seconds.
#pragma once

#include <array>

#include "plant/model.hpp"

namespace weakgrid {

struct Interval {
  double low = 0.0;
  double high = 0.0;
  friend constexpr bool operator==(Interval, Interval) = default;
};

struct GridBox {
  Interval R_g;
  Interval L_g;  ///< X_g/ω
  Interval V{1.0, 1.0};
  friend constexpr bool operator==(const GridBox&, const GridBox&) = default;
};

constexpr GridBox box_of(const Grid& g) { return {{g.R_g, g.R_g}, {g.L_g, g.L_g}, {g.V, g.V}}; }

/// Finite, low ≤ high, R_g and L_g not negative, V above 0.
inline bool is_valid(const GridBox& b) {
  const auto ordered = [](Interval x, double least) {
    return x.low >= least && x.low <= x.high && std::isfinite(x.high);
  };
  return ordered(b.R_g, 0.0) && ordered(b.L_g, 0.0) && ordered(b.V, 0.0) && b.V.low > 0.0;
}

/// The four impedance corners at one voltage: low and high R_g at low L_g, then at high L_g.
constexpr std::array<Grid, 4> corners(const GridBox& b, double V) {
  return {Grid{b.R_g.low, b.L_g.low, V}, Grid{b.R_g.high, b.L_g.low, V}, Grid{b.R_g.low, b.L_g.high, V},
          Grid{b.R_g.high, b.L_g.high, V}};
}

}  // namespace weakgrid
