// Request → decision: freshness, ranges, authority, envelope, certificate, way, and the reference that
// follows.
#include "gateway/arbiter.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "gateway/path.hpp"

namespace weakgrid {
namespace {

Setpoint target(const Reference& reference) noexcept { return {reference.p, reference.q, reference.v_c}; }

// |v_g| that a grid can have.
constexpr double V_min = 0.1, V_max = 2.0;

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
  course_.stand_at(configuration.initial);
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
  course_.stand_at(idle);
  return issue(idle, configuration_.default_ramp_s, 0, 0);
}

void Arbiter::note_foreign_reference(std::uint32_t id) noexcept {
  const bool is_in_room =
      room_end_ != 0 && reference_id_ == room_end_ && id <= room_end_ && room_end_ - id < room;
  if (id <= reference_id_ && !is_in_room) return;
  reference_id_ = std::max(reference_id_, id);
  standing_is_known_ = false;
}

void Arbiter::leave_room() noexcept {
  reference_id_ += room;
  room_end_ = reference_id_;
}

void Arbiter::adopt(const Reference& reference) noexcept {
  // What stood before ids were left free stands, though a request has been decided meanwhile.
  const bool is_before_room =
      room_end_ != 0 && reference_id_ == room_end_ && room_end_ - reference.id == room;
  if (reference.id < reference_id_ && !is_before_room) return;
  reference_id_ = std::max(reference_id_, reference.id);
  follow(reference);
}

void Arbiter::follow(const Reference& reference) noexcept {
  (void)course_.track.accept(reference);
  setpoint_ = target(reference);
  standing_ = reference;
  standing_is_known_ = true;
}

// What stands now, and what a decision is taken on.
Decision Arbiter::begun(RequestKind kind, std::uint64_t step_now) noexcept {
  course_.advance_to(step_now);
  if (course_.track.fallen_back && !course_.track.pending && standing_is_known_) {
    const Reference& over = *course_.track.in_force;
    setpoint_ = {over.fallback_p, over.fallback_q, over.fallback_v_c};
  }
  Decision decision;
  decision.kind = kind;
  decision.decided_step = step_now;
  decision.standing_reference_id = reference_id_;
  decision.unit_state = unit_state_;
  return decision;
}

void Arbiter::tell_holder(std::uint64_t step_now, Decision& decision) const noexcept {
  if (!authority_.is_held(step_now)) return;
  decision.holder = authority_.holder();
  decision.held_until_step = authority_.until_step();
}

Decision Arbiter::decide(const Request& request, std::uint64_t step_now) noexcept {
  Decision decision = begun(request.kind, step_now);
  decision.client = request.client;
  decision.id = request.id;
  decision.setpoint = complete(request);
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
  tell_holder(step_now, decision);
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
  if (request.kind >= RequestKind::revalidate) return Field::kind;
  if (request.who.source >= Source::protection || request.who.name.empty()) return Field::source;
  if (request.lease_s != 0.0 &&
      !within(request.lease_s, configuration_.min_ramp_s, configuration_.max_lease_s))
    return Field::lease_s;
  if (request.kind == RequestKind::set_grid) {
    const auto is_interval = [](Interval x, double least, double most) {
      return within(x.low, least, most) && within(x.high, x.low, most);
    };
    const bool good = is_interval(request.R_g, 0.0, 10.0) && is_interval(request.X_g, 0.0, 10.0) &&
                      is_interval(request.V, V_min, V_max);
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
  if (request.kind != RequestKind::stop &&
      !(takes ? authority_.may_take(request.who, step_now) : authority_.may_order(request.who, step_now))) {
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
      configuration_.box = {request.R_g,
                            {request.X_g.low / configuration_.converter.omega,
                             request.X_g.high / configuration_.converter.omega},
                            request.V};
      judge_standing(step_now, decision);
      return;
    case RequestKind::start:
    case RequestKind::stop:
    case RequestKind::reset:
      judge_operation(request, decision);
      return;
    case RequestKind::revalidate:
      break;
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
    near = acceptable_near(configuration_, area_, decision.setpoint, from, request.policy);
  } else if (!certify(configuration_, from, decision.setpoint, ramp_s, &decision.margins)) {
    decision.verdict = Verdict::not_stable;
    near = acceptable_near(configuration_, area_, decision.setpoint, from, request.policy);
  } else if (standing_is_known_) {
    if (const auto outside = leaves(configuration_, course, decision.setpoint, start,
                                    static_cast<std::uint32_t>(steps(ramp_s)))) {
      decision.verdict = Verdict::path_outside;
      decision.leaves_at = *outside;
      if (const auto via = detour(configuration_.box, configuration_.converter, configuration_.limits, from,
                                  decision.setpoint)) {
        double leg_s = ramp_s;
        if (certify(configuration_, from, *via, leg_s, nullptr)) offer(*via, true, step_now, decision);
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
  decision.setpoint = target(renewal);
  decision.reference = renewal;
  follow(renewal);
  authority_.give(request.who, renewal.lease_end_step);
}

// A unit that closes goes to idle: where that may not stand, it would trip again, or oscillate.
void Arbiter::judge_operation(const Request& request, Decision& decision) noexcept {
  const UnitState is = unit_state_;
  if (request.kind == RequestKind::stop) {
    if (is == UnitState::off)
      decision.verdict = Verdict::interlocked;
    else
      authority_.release();
    return;
  }
  const Setpoint& idle = configuration_.initial;
  const Assessment assessment =
      assess(configuration_.box, configuration_.converter, configuration_.limits, idle);
  decision.setpoint = idle;
  decision.margins = assessment.margins;
  double ramp_s = configuration_.default_ramp_s;
  const bool may_close =
      assessment.admissible && certify(configuration_, idle, idle, ramp_s, &decision.margins);
  const UnitState from = request.kind == RequestKind::start ? UnitState::off : UnitState::tripped;
  if (is != from || !may_close) decision.verdict = Verdict::interlocked;
}

Decision Arbiter::revalidate(Interval V, std::uint64_t step_now) noexcept {
  Decision decision = begun(RequestKind::revalidate, step_now);
  decision.verdict = Verdict::accepted;
  decision.measured_V = V;
  Interval& known = configuration_.box.V;
  known = {std::max(std::min(known.low, V.low), V_min), std::min(std::max(known.high, V.high), V_max)};
  judge_standing(step_now, decision);
  tell_holder(step_now, decision);
  return decision;
}

// What stands is judged anew on the grid as it is now known.
void Arbiter::judge_standing(std::uint64_t step_now, Decision& decision) noexcept {
  decision.setpoint = setpoint_;
  if (!standing_ || !standing_is_known_ || blocked_) return;
  Course course = course_;
  course.advance_to(step_now);
  const std::optional<Reference> pending = course.track.pending;
  if (course.track.fallen_back && !pending) return;
  const bool holds = course.track.in_force && !course.track.fallen_back;
  // What is in force until the newest order begins has to hold as well.
  const bool present_may_stand =
      !holds || !pending || may_stand(configuration_, target(*course.track.in_force));
  const Assessment now =
      assess(configuration_.box, configuration_.converter, configuration_.limits, setpoint_);
  decision.margins = now.margins;
  double ramp_s = configuration_.default_ramp_s;
  const bool may_stand_itself =
      now.admissible && certify(configuration_, setpoint_, setpoint_, ramp_s, &decision.margins);
  if (may_stand_itself && present_may_stand) return;
  std::uint64_t start = start_of({}, step_now);
  if (present_may_stand && pending) start = std::max(start, pending->effective_step);
  course.advance_to(start);
  const Setpoint from = course.at(start);
  const Setpoint safe =
      acceptable_near(configuration_, area_, setpoint_, configuration_.fallback, Policy::minimum_distance)
          .value_or(configuration_.fallback);
  (void)certify(configuration_, from, safe, ramp_s, nullptr);
  decision.reference = issue(safe, ramp_s, start, standing_->lease_end_step);
}

Reference Arbiter::fall_back(std::uint64_t step_now) noexcept {
  course_.advance_to(step_now);
  authority_.release();
  return issue(configuration_.fallback, configuration_.fallback_ramp_s, start_of({}, step_now), 0);
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
