// Request → decision: freshness, ranges, authority, envelope, certificate, way, and the reference that
// follows.
#include "gateway/arbiter.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "gateway/path.hpp"
#include "gateway/steady_state.hpp"
#include "gateway/transient.hpp"

namespace weakgrid {
namespace {

// Written so that NaN is outside.
bool within(double x, double low, double high) { return x >= low && x <= high; }

// To the nearest step, at least one. What is no number takes the longest ramp: slow is the safe side.
std::uint32_t ramp_steps(double ramp_s, std::int64_t period_ns) {
  constexpr std::uint32_t longest = std::numeric_limits<std::uint32_t>::max();
  const double steps = std::floor(ramp_s * 1e9 / static_cast<double>(period_ns) + 0.5);
  if (!(steps < static_cast<double>(longest))) return longest;
  return steps < 1.0 ? 1 : static_cast<std::uint32_t>(steps);
}

Decision refused(Decision decision, Verdict verdict, Field field) {
  decision.verdict = verdict;
  decision.field = field;
  return decision;
}

}  // namespace

Arbiter::Arbiter(const Configuration& configuration) noexcept
    : configuration_(configuration), setpoint_(configuration.initial) {
  const Setpoint& s = configuration.initial;
  course_.p = {s.p, s.p, 0.0, 0, 0};
  course_.q = {s.q, s.q, 0.0, 0, 0};
  course_.v_c = {s.v_c, s.v_c, 0.0, 0, 0};
}

void Arbiter::Course::advance_to(std::uint64_t step) noexcept {
  while (const auto move = track.advance_to(step, true)) {
    p = p.towards(move->p, move->start, move->ramp_steps);
    q = q.towards(move->q, move->start, move->ramp_steps);
    v_c = v_c.towards(move->v_c, move->start, move->ramp_steps);
  }
}

Setpoint Arbiter::Course::at(std::uint64_t step) const noexcept {
  return {p.at(step).value, q.at(step).value, v_c.at(step).value};
}

bool Arbiter::Course::moves(std::uint64_t step) const noexcept {
  return p.at(step).slope != 0.0 || q.at(step).slope != 0.0 || v_c.at(step).slope != 0.0;
}

std::uint64_t Arbiter::steps(double seconds) const noexcept {
  return ramp_steps(seconds, configuration_.timing.period_ns);
}

// The unit is idle: it has tripped or begun anew.
Reference Arbiter::block() noexcept {
  blocked_ = true;
  authority_.release();
  offers_ = {};
  course_.track.cancel();
  const Setpoint& idle = configuration_.initial;
  course_.p = {idle.p, idle.p, 0.0, 0, 0};
  course_.q = {idle.q, idle.q, 0.0, 0, 0};
  course_.v_c = {idle.v_c, idle.v_c, 0.0, 0, 0};
  return issue(idle, configuration_.default_ramp_s, 0, 0);
}

void Arbiter::note_foreign_reference(std::uint32_t id) noexcept {
  if (id <= reference_id_) return;
  reference_id_ = id;
  standing_is_known_ = false;
}

void Arbiter::adopt(const Reference& reference) noexcept {
  if (reference.id < reference_id_) return;
  reference_id_ = reference.id;
  follow(reference);
}

void Arbiter::follow(const Reference& reference) noexcept {
  (void)course_.track.accept(reference);
  setpoint_ = {reference.p, reference.q, reference.v_c};
  standing_ = reference;
  standing_is_known_ = true;
}

Decision Arbiter::decide(const Request& request, std::uint64_t step_now) noexcept {
  course_.advance_to(step_now);
  if (course_.track.fallen_back && !course_.track.pending && standing_is_known_) {
    const Reference& over = *course_.track.in_force;
    setpoint_ = {over.fallback_p, over.fallback_q, over.fallback_v_c};
  }
  Decision decision;
  decision.client = request.client;
  decision.id = request.id;
  decision.kind = request.kind;
  decision.setpoint = complete(request);
  decision.decided_step = step_now;
  decision.standing_reference_id = reference_id_;
  decision.request_fingerprint = fingerprint(request);
  if (request.client == 0) return refused(decision, Verdict::bad_request, Field::client);
  if (request.id == 0) return refused(decision, Verdict::bad_request, Field::id);

  // Freshness comes before content: a repeat must find its answer however the world has moved on.
  Client& client = recall(request.client);
  if (request.id == client.last.id) {
    Decision again = client.last;
    again.repeated = true;
    return again;
  }
  if (request.id < client.last.id) return refused(decision, Verdict::stale_request, Field::id);

  judge(request, step_now, decision);
  if (authority_.is_held(step_now)) {
    decision.holder = authority_.holder();
    decision.held_until_step = authority_.until_step();
  }
  client.last = decision;
  return decision;
}

Arbiter::Client& Arbiter::recall(std::uint64_t client) noexcept {
  auto found = std::find_if(clients_.begin(), clients_.end(),
                            [client](const Client& known) { return known.last.client == client; });
  if (found == clients_.end()) {
    found = std::min_element(clients_.begin(), clients_.end(),
                             [](const Client& x, const Client& y) { return x.heard < y.heard; });
    *found = Client{};
    found->last.client = client;
  }
  found->heard = ++hearings_;
  return *found;
}

Setpoint Arbiter::complete(const Request& request) const noexcept {
  return {(request.given & given_p) != 0 ? request.p : setpoint_.p,
          (request.given & given_q) != 0 ? request.q : setpoint_.q,
          (request.given & given_v_c) != 0 ? request.v_c : setpoint_.v_c};
}

Field Arbiter::offending_field(const Request& request) const noexcept {
  constexpr double power_max = 10.0, v_c_max = 10.0;
  constexpr std::uint32_t known = given_p | given_q | given_v_c;
  if (request.who.source >= Source::protection || request.who.name.empty()) return Field::source;
  if (request.lease_s != 0.0 &&
      !within(request.lease_s, configuration_.min_ramp_s, configuration_.max_lease_s))
    return Field::lease_s;
  if (request.kind == RequestKind::set_grid) {
    const auto is_interval = [](Interval x, double least, double most) {
      return within(x.low, least, most) && within(x.high, x.low, most);
    };
    const bool good = is_interval(request.R_g, 0.0, 10.0) && is_interval(request.X_g, 0.0, 10.0) &&
                      is_interval(request.V, 0.1, 2.0);
    return good ? Field::none : Field::grid;
  }
  if (request.kind != RequestKind::set && request.kind != RequestKind::accept) return Field::none;
  if (request.ramp_s != 0.0 && !within(request.ramp_s, configuration_.min_ramp_s, configuration_.max_ramp_s))
    return Field::ramp_s;
  if (request.effective_step > step_max) return Field::effective_step;
  if (request.kind == RequestKind::accept) return Field::none;
  if (request.given == 0 || (request.given & ~known) != 0) return Field::given;
  if (!standing_is_known_ && request.given != known) return Field::given;
  if ((request.given & given_p) != 0 && !within(request.p, -power_max, power_max)) return Field::p;
  if ((request.given & given_q) != 0 && !within(request.q, -power_max, power_max)) return Field::q;
  if ((request.given & given_v_c) != 0 && !(request.v_c > 0.0 && request.v_c <= v_c_max)) return Field::v_c;
  return Field::none;
}

void Arbiter::judge(const Request& request, std::uint64_t step_now, Decision& decision) noexcept {
  const bool moves = request.kind == RequestKind::set || request.kind == RequestKind::accept;
  decision.field = offending_field(request);
  if (decision.field != Field::none) {
    decision.verdict = Verdict::bad_request;
    return;
  }
  if (moves && request.effective_step != 0 && request.effective_step <= step_now) {
    decision.verdict = Verdict::stale_request;
    decision.field = Field::effective_step;
    return;
  }
  const bool takes = request.kind == RequestKind::take;
  if (!(takes ? authority_.may_take(request.who, step_now) : authority_.may_order(request.who, step_now))) {
    decision.verdict = Verdict::not_authorised;
    return;
  }
  const double lease_s = request.lease_s != 0.0 ? request.lease_s : configuration_.default_lease_s;
  decision.verdict = Verdict::accepted;
  switch (request.kind) {
    case RequestKind::take:
      authority_.give(request.who, std::min(step_now, step_max) + steps(lease_s));
      return;
    case RequestKind::release:
      authority_.release();
      return;
    case RequestKind::set_grid:
      take_grid(request, step_now, decision);
      return;
    case RequestKind::renew:
      judge_renewal(request, step_now, decision);
      return;
    case RequestKind::accept: {
      const auto found = std::find_if(offers_.begin(), offers_.end(),
                                      [&](const Offer& o) { return o.token == request.token; });
      if (request.token == 0 || found == offers_.end() || found->valid_until_step < step_now) {
        decision.verdict = Verdict::no_such_offer;
        return;
      }
      decision.setpoint = found->setpoint;
      judge_setpoint(request, step_now, decision);
      return;
    }
    case RequestKind::set:
      judge_setpoint(request, step_now, decision);
      return;
  }
  decision.verdict = Verdict::bad_request;
}

void Arbiter::judge_setpoint(const Request& request, std::uint64_t step_now, Decision& decision) noexcept {
  if (blocked_) {
    decision.verdict = Verdict::unit_blocked;
    return;
  }
  const std::uint64_t start = start_of(request, step_now);
  // What stands when this one begins; not known after a restart: then the target alone is judged.
  Course course = course_;
  course.advance_to(start);
  const Setpoint from = standing_is_known_ ? course.at(start) : decision.setpoint;
  double ramp_s = request.ramp_s != 0.0 ? request.ramp_s : configuration_.default_ramp_s;

  const Assessment assessment =
      assess(configuration_.box, configuration_.converter, configuration_.limits, decision.setpoint);
  decision.margins = assessment.margins;
  std::optional<Setpoint> near;
  if (!assessment.admissible) {
    decision.verdict = Verdict::outside_envelope;
    near = acceptable_near(decision.setpoint, from, request.policy);
  } else if (!certify(from, decision.setpoint, ramp_s, &decision.margins)) {
    decision.verdict = Verdict::not_stable;
    near = acceptable_near(decision.setpoint, from, request.policy);
  } else if (standing_is_known_) {
    if (const auto outside =
            leaves(course, decision.setpoint, start, static_cast<std::uint32_t>(steps(ramp_s)))) {
      decision.verdict = Verdict::path_outside;
      decision.leaves_at = *outside;
      if (const auto via = detour(configuration_.box, configuration_.converter, configuration_.limits, from,
                                  decision.setpoint)) {
        double leg_s = ramp_s;
        if (certify(from, *via, leg_s, nullptr)) offer(*via, true, step_now, decision);
      }
      return;
    }
  }
  if (near) offer(*near, false, step_now, decision);
  if (decision.verdict != Verdict::accepted) return;
  const double lease_s = request.lease_s != 0.0 ? request.lease_s : configuration_.default_lease_s;
  const std::uint64_t lease_end = start + steps(lease_s);
  decision.reference = issue(decision.setpoint, ramp_s, start, lease_end);
  decision.steps_to_reach = static_cast<std::uint32_t>(
      std::min<std::uint64_t>(decision.reference->ramp_steps + steps(configuration_.settling_s),
                              std::numeric_limits<std::uint32_t>::max()));
  authority_.give(request.who, lease_end);
}

void Arbiter::judge_renewal(const Request& request, std::uint64_t step_now, Decision& decision) noexcept {
  // In time for source and controller alike, or not at all: else one falls back and the other does not.
  const std::uint64_t lead = configuration_.lead_steps;
  if (!standing_ || !standing_is_known_ || standing_->lease_end_step == 0 || blocked_ ||
      standing_->lease_end_step <= step_now + lead) {
    decision.verdict = Verdict::nothing_stands;
    return;
  }
  const double lease_s = request.lease_s != 0.0 ? request.lease_s : configuration_.default_lease_s;
  Reference renewal = *standing_;
  renewal.renews = standing_->renews != 0 ? standing_->renews : standing_->id;
  if (++reference_id_ == 0) reference_id_ = 1;
  renewal.id = reference_id_;
  renewal.lease_end_step = std::max(renewal.lease_end_step, std::min(step_now, step_max) + steps(lease_s));
  decision.setpoint = {renewal.p, renewal.q, renewal.v_c};
  decision.reference = renewal;
  follow(renewal);
  authority_.give(request.who, renewal.lease_end_step);
}

// What stands is judged anew on the grid as it is now known.
void Arbiter::take_grid(const Request& request, std::uint64_t step_now, Decision& decision) noexcept {
  const double omega = configuration_.converter.omega;
  configuration_.box = {request.R_g, {request.X_g.low / omega, request.X_g.high / omega}, request.V};
  decision.setpoint = setpoint_;
  if (!standing_ || !standing_is_known_ || blocked_ || course_.track.fallen_back) return;
  const Assessment now =
      assess(configuration_.box, configuration_.converter, configuration_.limits, setpoint_);
  decision.margins = now.margins;
  double ramp_s = configuration_.default_ramp_s;
  if (now.admissible && certify(setpoint_, setpoint_, ramp_s, &decision.margins)) return;
  const std::uint64_t start = start_of({}, step_now);
  Course course = course_;
  course.advance_to(start);
  const Setpoint from = course.at(start);
  const Setpoint safe = acceptable_near(setpoint_, configuration_.fallback, Policy::minimum_distance)
                            .value_or(configuration_.fallback);
  (void)certify(from, safe, ramp_s, nullptr);
  decision.reference = issue(safe, ramp_s, start, standing_->lease_end_step);
}

// At corners of the box: where a random search over boxes found the slowest decay to within 0.3/s.
double Arbiter::decay_over_box(const Setpoint& setpoint, Grid& where) const noexcept {
  const double omega = configuration_.converter.omega;
  double slowest = std::numeric_limits<double>::infinity();
  const auto consider = [&](const Grid& grid) {
    const SteadyState at = steady_state({grid.R_g, omega * grid.L_g}, grid.V, {setpoint.p, setpoint.q});
    const double decay =
        loop_decay(*configuration_.loop, grid, at.v_p, at.i, configuration_.decay_min + 10.0);
    if (!(decay >= slowest)) {
      slowest = decay;
      where = grid;
    }
  };
  const GridBox& box = configuration_.box;
  const std::array<Grid, 4> low = corners(box, box.V.low), high = corners(box, box.V.high);
  for (std::size_t k = 0; k < low.size(); ++k) {
    if (std::find_if(low.begin(), low.begin() + static_cast<std::ptrdiff_t>(k), [&](const Grid& g) {
          return g.R_g == low[k].R_g && g.L_g == low[k].L_g;
        }) != low.begin() + static_cast<std::ptrdiff_t>(k))
      continue;  // a flat box has fewer corners
    consider(low[k]);
    if (box.V.low < box.V.high) consider(high[k]);
  }
  return slowest;
}

// Small disturbances decay at the target, and the paper's transient conditions hold on the way: the ramp is
// made longer until they do. False: no ramp does, or it would be longer than allowed.
bool Arbiter::certify(const Setpoint& from, const Setpoint& to, double& ramp_s,
                      Margins* margins) const noexcept {
  if (!configuration_.loop) return true;
  const LoopModel& loop = *configuration_.loop;
  const double omega = configuration_.converter.omega;
  Grid where;
  const double decay = decay_over_box(to, where);
  if (margins != nullptr) margins->add({Limit::decay, true, decay, configuration_.decay_min, where});
  double least = std::numeric_limits<double>::infinity();
  Grid least_at;
  for (const Grid& grid : corners(configuration_.box, configuration_.box.V.low)) {
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
  return decay >= configuration_.decay_min && least >= 0.0 && ramp_s <= configuration_.max_ramp_s;
}

bool Arbiter::fallback_holds() const noexcept {
  const Configuration& c = configuration_;
  double ramp_s = c.default_ramp_s;
  return slack(c.box, c.converter, c.limits, c.fallback) >= 0.0 &&
         certify(c.fallback, c.fallback, ramp_s, nullptr);
}

// Where the way from what stands to `to` leaves the envelope; and from `to` to the fallback, which a lost
// client would take. A way that begins outside (the grid has changed) may only lead back.
std::optional<Setpoint> Arbiter::leaves(const Course& course, const Setpoint& to, std::uint64_t start,
                                        std::uint32_t ramp_steps) const noexcept {
  const Configuration& c = configuration_;
  const auto check = [&](const Setpoint& a, const Setpoint& b) {
    return first_outside(c.box, c.converter, c.limits, a, b);
  };
  const auto is_inside = [&](const Setpoint& s) { return slack(c.box, c.converter, c.limits, s) >= 0.0; };
  const Setpoint from = course.at(start);
  if (is_inside(from)) {
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
  if (is_inside(c.fallback)) return check(to, c.fallback);
  return std::nullopt;
}

// The nearest setpoint that would be accepted: inside, and if the certificate does not hold there, the last
// on the straight way from what stands for which it does.
std::optional<Setpoint> Arbiter::acceptable_near(const Setpoint& wanted, const Setpoint& from,
                                                 Policy policy) const noexcept {
  const Configuration& c = configuration_;
  const auto near = nearest_admissible(c.box, c.converter, c.limits, wanted, policy);
  if (!near) return std::nullopt;
  const auto is_inside = [&](const Setpoint& s) { return slack(c.box, c.converter, c.limits, s) >= 0.0; };
  const auto passes = [&](const Setpoint& a, const Setpoint& b) {
    return !first_outside(c.box, c.converter, c.limits, a, b);
  };
  // As decide() will see it, from rest.
  const auto will_do = [&](const Setpoint& s) {
    double ramp_s = c.default_ramp_s;
    return is_inside(s) && certify(from, s, ramp_s, nullptr) && (!is_inside(from) || passes(from, s)) &&
           (!is_inside(c.fallback) || passes(s, c.fallback));
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

void Arbiter::offer(const Setpoint& setpoint, bool is_detour, std::uint64_t step_now,
                    Decision& decision) noexcept {
  if (++offers_made_ == 0) offers_made_ = 1;  // 0 says "none" on the wire
  const Offer made{offers_made_, setpoint, is_detour,
                   std::min(step_now, step_max) + steps(configuration_.offer_s)};
  offers_[offers_made_ % offer_max] = made;
  decision.offer = made;
}

std::uint64_t Arbiter::start_of(const Request& request, std::uint64_t step_now) const noexcept {
  if (request.effective_step != 0) return request.effective_step;
  return std::min(step_now, step_max) + std::max(configuration_.lead_steps, std::uint32_t{1});
}

Reference Arbiter::issue(const Setpoint& setpoint, double ramp_s, std::uint64_t effective_step,
                         std::uint64_t lease_end_step) noexcept {
  if (++reference_id_ == 0) reference_id_ = 1;  // 0 says "none" on the wire
  const std::int64_t period_ns = configuration_.timing.period_ns;
  Reference reference;
  reference.id = reference_id_;
  reference.p = setpoint.p;
  reference.q = setpoint.q;
  reference.v_c = setpoint.v_c;
  reference.effective_step = effective_step;
  reference.ramp_steps = ramp_steps(ramp_s, period_ns);
  reference.lease_end_step = lease_end_step;
  reference.fallback_p = configuration_.fallback.p;
  reference.fallback_q = configuration_.fallback.q;
  reference.fallback_v_c = configuration_.fallback.v_c;
  reference.fallback_ramp_steps = ramp_steps(configuration_.fallback_ramp_s, period_ns);
  follow(reference);
  return reference;
}

}  // namespace weakgrid
