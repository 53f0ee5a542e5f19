// Search along rays from the point asked for; every point that is returned has been assessed.
#include "gateway/nearest.hpp"

#include <algorithm>
#include <cmath>

namespace weakgrid {

namespace {

struct Search {
  const GridBox& box;
  const Converter& converter;
  const Limits& limits;
  double v_c;

  double slack_at(SpaceVector s) const noexcept { return slack(box, converter, limits, {s.re, s.im, v_c}); }
  bool admits(SpaceVector s) const noexcept { return slack_at(s) >= 0.0; }
};

double distance(SpaceVector a, SpaceVector b) noexcept { return abs(a - b); }

// All that is admissible lies within: |s| = |v_p||i|, |v_p| ≤ V + |Z_g||i|.
double reach_of(const GridBox& box, double omega, const Limits& limits) noexcept {
  const double Z_g = abs(SpaceVector{box.R_g.high, omega * box.L_g.high});
  return limits.i_max * std::min(limits.v_p_max, box.V.high + Z_g * limits.i_max);
}

// Between an admissible point and one that is not: the last admissible one.
SpaceVector last_admissible(const Search& search, SpaceVector inside, SpaceVector outside) noexcept {
  for (int k = 0; k < 60; ++k) {
    const SpaceVector middle = 0.5 * (inside + outside);
    if (middle == inside || middle == outside) break;
    (search.admits(middle) ? inside : outside) = middle;
  }
  return inside;
}

// The point of largest slack between two, were it to have one maximum.
SpaceVector highest(const Search& search, SpaceVector a, SpaceVector b) noexcept {
  for (int k = 0; k < 40; ++k) {
    const SpaceVector third = a + (1.0 / 3.0) * (b - a), two_thirds = a + (2.0 / 3.0) * (b - a);
    if (search.slack_at(third) >= 0.0) return third;
    (search.slack_at(third) < search.slack_at(two_thirds) ? a : b) =
        search.slack_at(third) < search.slack_at(two_thirds) ? third : two_thirds;
  }
  return 0.5 * (a + b);
}

// On the ray from `wanted` along the unit vector `along`: the first admissible point within `reach`.
std::optional<SpaceVector> first_on_ray(const Search& search, SpaceVector wanted, SpaceVector along,
                                        double reach) noexcept {
  // How fast slack can change with s away from λ = 0 gives how far to go without missing much; what is
  // shorter than the least step may hide only around a maximum.
  constexpr double slope = 4.0;
  const double most = reach / 10.0;
  SpaceVector before = wanted, last = wanted;
  double slack_before = search.slack_at(wanted), slack_last = slack_before;
  for (double r = 0.0; r < reach;) {
    // The nearer, the finer: what hides at the doorstep shall be found.
    const double least = std::min(reach / 160.0, 1e-5 + 0.1 * r);
    r += std::clamp(-slack_last / slope, least, most);
    const SpaceVector here = wanted + r * along;
    const double slack_here = search.slack_at(here);
    if (slack_here >= 0.0) return last_admissible(search, here, last);
    if (slack_last > slack_before && slack_last >= slack_here) {
      const SpaceVector top = highest(search, before, here);
      if (search.admits(top)) return last_admissible(search, top, before);
    }
    before = last;
    slack_before = slack_last;
    last = here;
    slack_last = slack_here;
  }
  return std::nullopt;
}

std::optional<SpaceVector> nearest_on_line(const Search& search, SpaceVector wanted, SpaceVector along,
                                           double reach) noexcept {
  const auto one = first_on_ray(search, wanted, along, reach);
  const auto other = first_on_ray(search, wanted, -1.0 * along, one ? distance(*one, wanted) : reach);
  return other && (!one || distance(*other, wanted) < distance(*one, wanted)) ? other : one;
}

// Downhill from an admissible point by ever smaller steps: into a tip that rays pass by.
SpaceVector downhill(const Search& search, SpaceVector wanted, SpaceVector best) noexcept {
  constexpr int directions = 33, moves_max = 400;
  const SpaceVector part = unit_phasor(pi / (directions - 1));
  double h = 0.02 * distance(best, wanted);
  for (int moves = 0; moves < moves_max && h > 1e-9;) {
    const double d = distance(best, wanted);
    if (!(d > 0.0)) break;
    SpaceVector along = times_j((1.0 / d) * (wanted - best));  // from a right angle on one side to the other
    bool moved = false;
    for (int k = 0; k < directions && !moved; ++k, along = conj(part) * along) {
      const SpaceVector here = best + h * along;
      if (distance(here, wanted) < d && search.admits(here)) {
        best = here;
        moved = true;
      }
    }
    if (moved)
      ++moves;
    else
      h *= 0.5;
  }
  return best;
}

// Some admissible point of an area so small that rays pass by: uphill in slack, from the middle and around.
std::optional<SpaceVector> uphill(const Search& search, double reach) noexcept {
  constexpr int directions = 8, moves_max = 400;
  const SpaceVector part = unit_phasor(2.0 * pi / directions);
  SpaceVector start_along{1.0, 0.0};
  for (int start = 0; start <= directions; ++start, start_along = part * start_along) {
    SpaceVector here = start == 0 ? SpaceVector{} : (0.5 * reach) * start_along;
    double slack_here = search.slack_at(here);
    double h = 0.25 * reach;
    for (int moves = 0; moves < moves_max && h > 1e-7 * reach; ++moves) {
      if (slack_here >= 0.0) return here;
      bool moved = false;
      SpaceVector along{1.0, 0.0};
      for (int k = 0; k < directions; ++k, along = part * along) {
        const SpaceVector there = here + h * along;
        const double slack_there = search.slack_at(there);
        if (!(slack_there > slack_here)) continue;
        here = there;
        slack_here = slack_there;
        moved = true;
      }
      if (!moved) h *= 0.5;
    }
  }
  return std::nullopt;
}

// Distance over the direction: coarsely all around, then by golden section about each of the best minima.
std::optional<SpaceVector> nearest_around(const Search& search, SpaceVector wanted, double reach) noexcept {
  constexpr int directions = 64, minima = 4;
  constexpr double sector = 2.0 * pi / directions, none = 1e9;
  std::optional<SpaceVector> best;
  const auto try_angle = [&](double angle, double within) {
    const SpaceVector quarter = unit_phasor(0.25 * angle);  // takes a quarter turn at most
    const auto found = first_on_ray(search, wanted, quarter * quarter * (quarter * quarter), within);
    if (!found) return none;
    const double d = distance(*found, wanted);
    if (!best || d < distance(*best, wanted)) best = found;
    return d;
  };
  std::array<double, directions> coarse;
  for (int k = 0; k < directions; ++k) coarse[k] = try_angle(sector * (k - directions / 2), reach);
  std::array<int, directions> order;
  int count = 0;
  for (int k = 0; k < directions; ++k)
    if (coarse[k] < none && coarse[k] <= coarse[(k + 1) % directions] &&
        coarse[k] <= coarse[(k + directions - 1) % directions])
      order[count++] = k;
  std::sort(order.begin(), order.begin() + count, [&](int a, int b) { return coarse[a] < coarse[b]; });
  for (int n = 0; n < std::min(count, minima); ++n) {
    constexpr double golden = 0.61803398874989485;
    double low = sector * (order[n] - 1 - directions / 2), high = low + 2.0 * sector;
    // Nothing farther than a step beyond the best is of interest.
    const double within = std::min(reach, 1.5 * coarse[order[n]] + 0.01 * reach);
    double x = high - golden * (high - low), y = low + golden * (high - low);
    double at_x = try_angle(x, within), at_y = try_angle(y, within);
    while (high - low > 1e-8) {
      if (at_x < at_y) {
        high = y;
        y = x;
        at_y = at_x;
        at_x = try_angle(x = high - golden * (high - low), within);
      } else {
        low = x;
        x = y;
        at_x = at_y;
        at_y = try_angle(y = low + golden * (high - low), within);
      }
    }
  }
  if (!best) best = uphill(search, reach);
  if (best) best = downhill(search, wanted, *best);
  return best;
}

}  // namespace

std::optional<Setpoint> nearest_admissible(const GridBox& box, const Converter& converter,
                                           const Limits& limits, const Setpoint& wanted,
                                           Policy policy) noexcept {
  const SpaceVector s{wanted.p, wanted.q};
  const double v_c_low = limits.v_c_min + limits.reserve.dc_voltage;
  const double v_c_high = limits.v_c_max - limits.reserve.dc_voltage;
  if (!finite(s) || !std::isfinite(wanted.v_c) || !(v_c_low <= v_c_high)) return std::nullopt;
  double v_c = std::clamp(wanted.v_c, v_c_low, v_c_high);
  // The bounds are sums: the last bit may fall outside.
  for (int k = 0; k < 4; ++k) {
    if (v_c - limits.v_c_min < limits.reserve.dc_voltage) v_c = std::nextafter(v_c, 1e3);
    if (limits.v_c_max - v_c < limits.reserve.dc_voltage) v_c = std::nextafter(v_c, 0.0);
  }
  const Search search{box, converter, limits, v_c};
  const double reach = reach_of(box, converter.omega, limits) + abs(s);
  if (!(reach < 1e6)) return std::nullopt;
  std::optional<SpaceVector> found;
  if (search.admits(s)) {
    found = s;
  } else {
    switch (policy) {
      case Policy::minimum_distance:
        found = nearest_around(search, s, reach);
        break;
      case Policy::keep_p:
        found = nearest_on_line(search, s, {0.0, 1.0}, reach);
        break;
      case Policy::keep_q:
        found = nearest_on_line(search, s, {1.0, 0.0}, reach);
        break;
      case Policy::keep_power_factor:
        if (abs2(s) > 0.0) found = nearest_on_line(search, s, s / abs(s), reach);
        break;
    }
  }
  if (!found || !search.admits(*found)) return std::nullopt;
  return Setpoint{found->re, found->im, v_c};
}

}  // namespace weakgrid
