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

// At corners of the box: where a random search over boxes found the slowest decay to within 0.3/s. The
// weakest grid first: what is slowest there is mostly slowest of all, and of the others that need only be
// shown.
double decay_over_box(const Rules& rules, const Setpoint& setpoint, Grid& where) noexcept {
  double slowest = std::numeric_limits<double>::infinity();
  for (const double V : {rules.box.V.low, rules.box.V.high}) {
    const std::array<Grid, 4> grids = corners(rules.box, V);
    for (auto grid = grids.rbegin(); grid != grids.rend(); ++grid) {
      const SpaceVector Z_g{grid->R_g, rules.converter.omega * grid->L_g};
      const SteadyState at = steady_state(Z_g, grid->V, {setpoint.p, setpoint.q});
      const LoopPolynomial loop = loop_polynomial(*rules.loop, *grid, at.v_p, at.i);
      if (decays(loop, slowest)) continue;
      if (const double decay = loop_decay(loop); decay < slowest) {
        slowest = decay;
        where = *grid;
      }
    }
  }
  return slowest;
}

}  // namespace

bool is_inside(const Rules& rules, const Setpoint& setpoint) noexcept {
  return slack(rules.box, rules.converter, rules.limits, setpoint) >= 0.0;
}

bool certify(const Rules& rules, const Setpoint& from, const Setpoint& to, double& ramp_s,
             Margins* margins) noexcept {
  if (!rules.loop) return true;
  const LoopModel& loop = *rules.loop;
  const double omega = rules.converter.omega;
  Grid where;
  const double decay = decay_over_box(rules, to, where);
  if (margins != nullptr) margins->add({Limit::decay, true, decay, rules.decay_min, where});
  double least = std::numeric_limits<double>::infinity();
  Grid least_at;
  for (const Grid& grid : corners(rules.box, rules.box.V.low)) {
    const SpaceVector Z_g{grid.R_g, omega * grid.L_g};
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
  if (margins != nullptr) margins->add({Limit::transient, true, least, 0.0, least_at});
  return decay >= rules.decay_min && least >= 0.0 && ramp_s <= rules.max_ramp_s;
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
  const auto passes = [&](const Setpoint& a, const Setpoint& b) {
    return !first_outside(c.box, c.converter, c.limits, a, b);
  };
  // As decide() will see it, from rest.
  const auto will_do = [&](const Setpoint& s) {
    double ramp_s = c.default_ramp_s;
    return is_inside(c, s) && certify(c, from, s, ramp_s, nullptr) &&
           (!is_inside(c, from) || passes(from, s)) && (!is_inside(c, c.fallback) || passes(s, c.fallback));
  };
  if (will_do(*near)) return near;
  if (policy != Policy::minimum_distance) return std::nullopt;  // on that way the policy would not be kept
  Setpoint good = from, bad = *near;
  if (!will_do(good)) return std::nullopt;
  for (int k = 0; k < 12; ++k) {
    const Setpoint middle{0.5 * (good.p + bad.p), 0.5 * (good.q + bad.q), 0.5 * (good.v_c + bad.v_c)};
    (will_do(middle) ? good : bad) = middle;
  }
  return good;
}

}  // namespace weakgrid
