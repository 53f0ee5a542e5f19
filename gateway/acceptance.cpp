// Acceptance: envelope, certificate and way, over the box.
#include "gateway/acceptance.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "gateway/path.hpp"
#include "gateway/steady_state.hpp"
#include "gateway/transient.hpp"

namespace weakgrid {

namespace {

// Corners of the box, where a random search over boxes found the slowest decay to within 0.3/s. The weakest
// grid first: what is slowest there is mostly slowest of all, and of the others that need only be shown.
constexpr std::size_t corner_count = 8;
std::array<Grid, corner_count> corners_weakest_first(const GridBox& box) noexcept {
  std::array<Grid, corner_count> grids;
  const std::array<Grid, 4> at_low = corners(box, box.V.low), at_high = corners(box, box.V.high);
  std::reverse_copy(at_low.begin(), at_low.end(), grids.begin());
  std::reverse_copy(at_high.begin(), at_high.end(), grids.begin() + at_low.size());
  return grids;
}

LoopPolynomial loop_at(const Rules& rules, const Grid& grid, const Setpoint& setpoint) noexcept {
  const SpaceVector Z_g{grid.R_g, rules.converter.omega * grid.L_g};
  const SteadyState at = steady_state(Z_g, grid.V, {setpoint.p, setpoint.q});
  return loop_polynomial(*rules.loop, grid, at.v_p, at.i);
}

double decay_over_box(const Rules& rules, const Setpoint& setpoint, Grid& where) noexcept {
  double slowest = std::numeric_limits<double>::infinity();
  for (const Grid& grid : corners_weakest_first(rules.box)) {
    const LoopPolynomial loop = loop_at(rules, grid, setpoint);
    if (decays(loop, slowest)) continue;
    if (const double decay = loop_decay(loop); decay < slowest) {
      slowest = decay;
      where = grid;
    }
  }
  return slowest;
}

// Fast enough, and by more than loop_decay() may fall short: what is offered so is accepted.
bool decays_fast_enough(const Rules& rules, const Grid& grid, const Setpoint& setpoint) noexcept {
  return decays(loop_at(rules, grid, setpoint), rules.decay_min + 2e-3);
}

// The paper's transient conditions: ramp_s is made longer until they hold.
LimitMargin transient_margin(const Rules& rules, const Setpoint& from, const Setpoint& to,
                             double& ramp_s) noexcept {
  const LoopModel& loop = *rules.loop;
  double least = std::numeric_limits<double>::infinity();
  Grid least_at;
  for (const Grid& grid : corners(rules.box, rules.box.V.low)) {
    const SpaceVector Z_g{grid.R_g, rules.converter.omega * grid.L_g};
    const SteadyState start = steady_state(Z_g, grid.V, {from.p, from.q});
    const SteadyState end = steady_state(Z_g, grid.V, {to.p, to.q});
    const double V_end = abs(end.v_p), V_start = start.exists ? abs(start.v_p) : V_end;
    const double most = voltage_ratio_max(loop, grid);
    if (most > 1.0) ramp_s = std::max(ramp_s, ramp_for_ratio(loop, V_start, V_end, most));
    const double inside = most - voltage_ratio(loop, V_start, V_end, ramp_s);
    if (!(inside >= least)) {
      least = inside;
      least_at = grid;
    }
  }
  // The ramp was made just long enough: its last bit is no reason to refuse.
  least = least < 0.0 && least > -1e-9 ? 0.0 : least;
  return {Limit::transient, true, least, 0.0, least_at};
}

bool is_same(const Setpoint& a, const Setpoint& b) noexcept {
  return a.p == b.p && a.q == b.q && a.v_c == b.v_c;
}

// Between good and bad, by halving.
template <class Good>
Setpoint last_good(Setpoint good, Setpoint bad, int halvings, Good is_good) noexcept {
  for (int k = 0; k < halvings; ++k) {
    const Setpoint middle{0.5 * (good.p + bad.p), 0.5 * (good.q + bad.q), 0.5 * (good.v_c + bad.v_c)};
    (is_good(middle) ? good : bad) = middle;
  }
  return good;
}

}  // namespace

bool is_inside(const Rules& rules, const Setpoint& setpoint) noexcept {
  return slack(rules.box, rules.converter, rules.limits, setpoint) >= 0.0;
}

bool certify(const Rules& rules, const Setpoint& from, const Setpoint& to, double& ramp_s,
             Margins* margins) noexcept {
  if (!rules.loop) return true;
  Grid where;
  const double decay = decay_over_box(rules, to, where);
  const LimitMargin transient = transient_margin(rules, from, to, ramp_s);
  if (margins != nullptr) {
    margins->add({Limit::decay, true, decay, rules.decay_min, where});
    margins->add(transient);
  }
  return decay >= rules.decay_min && transient.margin >= 0.0 && ramp_s <= rules.max_ramp_s;
}

bool may_stand(const Rules& rules, const Setpoint& setpoint) noexcept {
  double ramp_s = rules.default_ramp_s;
  return is_inside(rules, setpoint) && certify(rules, setpoint, setpoint, ramp_s, nullptr);
}

std::optional<Setpoint> leaves(const Rules& c, const Course& course, const Setpoint& to, std::uint64_t start,
                               std::uint32_t ramp_steps) noexcept {
  const auto check = [&](const Setpoint& a, const Setpoint& b) {
    return first_outside(c.box, c.converter, c.limits, a, b);
  };
  const Setpoint from = course.at(start);
  if (is_inside(c, from)) {
    if (!course.moves(start)) {
      if (const auto outside = check(from, to)) return outside;
    } else {
      // What still moves carries its slope over: the way is a curve, taken chord by chord.
      constexpr std::uint32_t chords = 32;
      const Ramp p = course.p.towards(to.p, start, ramp_steps), q = course.q.towards(to.q, start, ramp_steps),
                 v_c = course.v_c.towards(to.v_c, start, ramp_steps);
      Setpoint last = from;
      for (std::uint32_t k = 1; k <= chords; ++k) {
        const std::uint64_t step = start + std::uint64_t{ramp_steps} * k / chords;
        const Setpoint here{p.at(step).value, q.at(step).value, v_c.at(step).value};
        if (const auto outside = check(last, here)) return outside;
        last = here;
      }
    }
  }
  if (is_inside(c, c.fallback)) return check(to, c.fallback);
  return std::nullopt;
}

std::optional<Setpoint> acceptable_near(const Rules& c, AdmissibleArea& area, const Setpoint& wanted,
                                        const Setpoint& from, Policy policy) noexcept {
  const auto near = nearest_admissible(area, c.box, c.converter, c.limits, wanted, policy);
  if (!near) return std::nullopt;
  const std::array<Grid, corner_count> grids = corners_weakest_first(c.box);
  const auto too_slow_on = [&](const Setpoint& s) {
    return std::find_if(grids.begin(), grids.end(),
                        [&](const Grid& grid) { return c.loop && !decays_fast_enough(c, grid, s); });
  };
  const auto passes = [&](const Setpoint& a, const Setpoint& b) {
    return !first_outside(c.box, c.converter, c.limits, a, b);
  };
  const bool from_is_inside = is_inside(c, from), fallback_is_inside = is_inside(c, c.fallback);
  // But for the decay; as decide() will see it, from rest.
  const auto way_will_do = [&](const Setpoint& s) {
    double ramp_s = c.default_ramp_s;
    if (!is_inside(c, s)) return false;
    if (c.loop && !(transient_margin(c, from, s, ramp_s).margin >= 0.0 && ramp_s <= c.max_ramp_s))
      return false;
    return (!from_is_inside || passes(from, s)) &&
           (!fallback_is_inside || (from_is_inside && is_same(from, c.fallback)) || passes(s, c.fallback));
  };
  Setpoint candidate = *near;
  auto slow = too_slow_on(candidate);
  if (slow != grids.end() && policy != Policy::minimum_distance)
    return std::nullopt;  // on the way from `from` the policy would not be kept
  // The last on that way that is fast enough, on one grid at a time; rarely is another the slowest there.
  constexpr int halvings = 12, rounds = 4;
  for (int round = 0; slow != grids.end() && round < rounds; ++round) {
    candidate = last_good(from, candidate, halvings,
                          [&](const Setpoint& s) { return decays_fast_enough(c, *slow, s); });
    slow = too_slow_on(candidate);
  }
  if (slow == grids.end() && way_will_do(candidate)) return candidate;
  const auto will_do = [&](const Setpoint& s) { return too_slow_on(s) == grids.end() && way_will_do(s); };
  if (policy != Policy::minimum_distance || !will_do(from)) return std::nullopt;
  return last_good(from, candidate, halvings, will_do);
}

}  // namespace weakgrid
