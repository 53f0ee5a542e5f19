// Marching squares for where the boundary is, then pieces halved until each is nearly straight: that leads
// into tips far narrower than a square. Every end of a piece is admissible to the last bit.
#include "gateway/admissible_area.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace weakgrid {

namespace {

constexpr int squares = 50;  // of the raster, in a row

}  // namespace

// The last admissible point on the way out, to 1e-13: regula falsi (Illinois), every third time a half.
SpaceVector AdmissibleArea::boundary(SpaceVector inside, double slack_inside, SpaceVector outside,
                                     double slack_outside) const noexcept {
  double weight_inside = slack_inside, weight_outside = slack_outside;
  bool was_inside = false, was_outside = false;
  for (int k = 0; k < 100 && abs2(outside - inside) > 1e-26; ++k) {
    const double share = k % 3 == 2 ? 0.5 : weight_inside / (weight_inside - weight_outside);
    SpaceVector here = inside + share * (outside - inside);
    if (!finite(here) || here == inside || here == outside) here = 0.5 * (inside + outside);
    const double slack_here = slack_at(here);
    if (slack_here >= 0.0) {
      inside = here;
      if (slack_here == 0.0) break;
      weight_inside = slack_here;
      if (was_inside) weight_outside *= 0.5;
    } else {
      outside = here;
      weight_outside = slack_here;
      if (was_outside) weight_inside *= 0.5;
    }
    was_inside = slack_here >= 0.0;
    was_outside = !was_inside;
  }
  return inside;
}

// The boundary on the way outwards, a unit vector, from `base` or, if that is outside, back inwards.
std::optional<SpaceVector> AdmissibleArea::boundary_along(SpaceVector base, SpaceVector outwards, double step,
                                                          double farthest) const noexcept {
  const double slack_base = slack_at(base);
  const bool inside = slack_base >= 0.0;
  SpaceVector last = base;
  double slack_last = slack_base;
  for (double way = step; way < farthest; way *= 4.0) {
    const SpaceVector here = base + (inside ? way : -way) * outwards;
    const double slack_here = slack_at(here);
    if ((slack_here >= 0.0) != inside)
      return inside ? boundary(last, slack_last, here, slack_here)
                    : boundary(here, slack_here, last, slack_last);
    last = here;
    slack_last = slack_here;
  }
  return std::nullopt;
}

// Depth first, so that pieces follow each other.
void AdmissibleArea::trace(SpaceVector from, SpaceVector to) noexcept {
  constexpr int deepest = 64;
  std::array<SpaceVector, deepest> ends;
  int count = 0;
  ends[count++] = to;
  while (count > 0 && count_ <= piece_max) {
    const SpaceVector end = ends[count - 1];
    const double length = abs(end - from);
    if (!(length > 0.0)) {
      --count;
      continue;
    }
    const SpaceVector along = (1.0 / length) * (end - from), middle = 0.5 * (from + end);
    const Beside first = sloped(from, 0.0, along), last = sloped(end, 0.0, along);
    // Where the tangents meet is the tip, if there is one; the normal may miss it.
    const double tip_share = last.slope / (last.slope - first.slope), tip_height = first.slope * tip_share;
    SpaceVector towards = -1.0 * times_j(along);
    double step = std::max(0.02 * length, 1e-10), farthest = 2.0 * length;
    if (tip_height > 0.2 && tip_height < 100.0) {
      const SpaceVector tip = length * ((tip_share - 0.5) * along + tip_height * towards);
      towards = (1.0 / abs(tip)) * tip;
      step = 0.5 * abs(tip);
      farthest = 8.0 * step;
    }
    const auto summit = boundary_along(middle, towards, step, farthest);
    const double height = summit ? abs(*summit - middle) : length;
    const bool is_bent = height > 0.1 * length || !(std::abs(first.slope - last.slope) < 0.1);
    if (summit && is_bent && length > 2e-8 && count < deepest) {
      ends[count++] = *summit;
      continue;
    }
    // The middle says how far a smooth line, or one with a slight bend anywhere, is from the chord.
    const double fall = summit ? sloped(*summit, 0.0, along).fall : 0.0;
    if (count_ < piece_max)
      pieces_[count_] = {from, end, first.slope, last.slope, 2.0 * height + 1e-10, fall};
    ++count_;
    from = end;
    --count;
  }
}

// Some admissible point of an area that lies between the lines of the raster: uphill in slack.
std::optional<SpaceVector> AdmissibleArea::uphill(SpaceVector here, double step) const noexcept {
  constexpr int directions = 8, moves_max = 400;
  const SpaceVector part = unit_phasor(2.0 * pi / directions);
  const double finest = 1e-6 * step;
  double slack_here = slack_at(here);
  for (int moves = 0; moves < moves_max && step > finest; ++moves) {
    if (slack_here >= 0.0) return here;
    bool moved = false;
    SpaceVector along{1.0, 0.0};
    for (int k = 0; k < directions; ++k, along = part * along) {
      const SpaceVector there = here + step * along;
      const double slack_there = slack_at(there);
      if (!(slack_there > slack_here)) continue;
      here = there;
      slack_here = slack_there;
      moved = true;
    }
    if (!moved) step *= 0.5;
  }
  return std::nullopt;
}

AdmissibleArea::AdmissibleArea(const GridBox& box, const Converter& converter, const Limits& limits,
                               double v_c) noexcept
    : box_(box), converter_(converter), limits_(limits), v_c_(v_c) {
  // All that is admissible lies within: |s| = |v_p||i|, |v_p| ≤ V + |Z_g||i|.
  const double Z_g = abs(SpaceVector{box.R_g.high, converter.omega * box.L_g.high});
  const double reach = 1.02 * limits.i_max * std::min(limits.v_p_max, box.V.high + Z_g * limits.i_max);
  if (!(reach < 1e6)) return;
  const SpaceVector highest = trace_around({}, reach);
  if (count_ > 0) return;
  // From the highest point of the raster, and from around.
  std::optional<SpaceVector> inside = uphill(highest, 2.0 * reach / squares);
  const SpaceVector part = unit_phasor(0.25 * pi);
  SpaceVector start{0.5 * reach, 0.0};
  for (int k = 0; k < 8 && !inside; ++k, start = part * start) inside = uphill(start, 0.25 * reach);
  if (!inside) return;
  // It may be thin and long: all once more with finer lines, then around the point that was found.
  constexpr int tiles = 4;
  for (int tile = 0; tile < tiles * tiles; ++tile)
    (void)trace_around(
        (reach / tiles) * SpaceVector{2.0 * (tile % tiles) + 1.0 - tiles, 2.0 * (tile / tiles) + 1.0 - tiles},
        reach / tiles);
  for (double half = reach / 8.0; count_ == 0 && half > 1e-7 * reach; half *= 0.25)
    (void)trace_around(*inside, half);
}

// Gives the point of the raster where slack is highest.
SpaceVector AdmissibleArea::trace_around(SpaceVector centre, double half) noexcept {
  const double size = 2.0 * half / squares;
  const auto at = [&](int column, int row) {
    return centre + SpaceVector{column * size - half, row * size - half};
  };
  SpaceVector highest = centre;
  double slack_highest = -std::numeric_limits<double>::infinity();
  std::array<double, squares + 1> below, above;  // slack along two lines of the raster
  const auto look_along = [&](int row) {
    for (int column = 0; column <= squares; ++column) {
      above[column] = slack_at(at(column, row));
      if (!(above[column] > slack_highest)) continue;
      slack_highest = above[column];
      highest = at(column, row);
    }
  };
  look_along(0);
  for (int row = 0; row < squares; ++row) {
    below = above;
    look_along(row + 1);
    for (int column = 0; column < squares; ++column) {
      // Corners in turn, anticlockwise; the boundary enters where inside turns to outside.
      const std::array<SpaceVector, 4> corner{at(column, row), at(column + 1, row), at(column + 1, row + 1),
                                              at(column, row + 1)};
      const std::array<double, 4> value{below[column], below[column + 1], above[column + 1], above[column]};
      std::array<SpaceVector, 2> enters, leaves;
      int entered = 0, left = 0;
      for (int k = 0; k < 4; ++k) {
        const int next = (k + 1) % 4;
        const bool here = value[k] >= 0.0, there = value[next] >= 0.0;
        if (here && !there) enters[entered++] = boundary(corner[k], value[k], corner[next], value[next]);
        if (!here && there) leaves[left++] = boundary(corner[next], value[next], corner[k], value[k]);
      }
      if (entered == 1) trace(enters[0], leaves[0]);
      if (entered == 2) {
        // A saddle: the middle says which two belong together.
        const bool joined = slack_at(0.5 * (corner[0] + corner[2])) >= 0.0;
        const bool in_turn = (value[0] >= 0.0) == joined;
        trace(enters[0], leaves[in_turn ? 0 : 1]);
        trace(enters[1], leaves[in_turn ? 1 : 0]);
      }
    }
  }
  return highest;
}

// The slope of the boundary against a direction, from how slack changes along and across.
AdmissibleArea::Beside AdmissibleArea::sloped(SpaceVector at, double slack_there,
                                              SpaceVector along) const noexcept {
  constexpr double little = 1e-8;
  const double fall = (slack_at(at + little * times_j(along)) - slack_there) / little;
  const double across = (slack_at(at + little * along) - slack_there) / little;
  return {at, across / fall, fall};
}

}  // namespace weakgrid
