// Request → decision: freshness, ranges, envelope, and the reference that follows.
#include "gateway/arbiter.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

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
    : configuration_(configuration), setpoint_(configuration.initial) {}

Reference Arbiter::block() noexcept {
  blocked_ = true;
  return issue(configuration_.initial, configuration_.default_ramp_s, 0);
}

void Arbiter::note_foreign_reference(std::uint32_t id) noexcept {
  if (id <= reference_id_) return;
  reference_id_ = id;
  standing_is_known_ = false;
}

void Arbiter::adopt(const Reference& reference) noexcept {
  reference_id_ = reference.id;
  setpoint_ = {reference.p, reference.q, reference.v_c};
  standing_ = reference;
  standing_is_known_ = true;
}

Decision Arbiter::decide(const Request& request, std::uint64_t step_now) noexcept {
  Decision decision;
  decision.client = request.client;
  decision.id = request.id;
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
  if (decision.verdict == Verdict::accepted)
    decision.reference =
        issue(decision.setpoint, request.ramp_s != 0.0 ? request.ramp_s : configuration_.default_ramp_s,
              start_of(request, step_now));
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
  if (request.given == 0 || (request.given & ~known) != 0) return Field::given;
  if (!standing_is_known_ && request.given != known) return Field::given;
  if ((request.given & given_p) != 0 && !within(request.p, -power_max, power_max)) return Field::p;
  if ((request.given & given_q) != 0 && !within(request.q, -power_max, power_max)) return Field::q;
  if ((request.given & given_v_c) != 0 && !(request.v_c > 0.0 && request.v_c <= v_c_max)) return Field::v_c;
  if (request.ramp_s != 0.0 && !within(request.ramp_s, configuration_.min_ramp_s, configuration_.max_ramp_s))
    return Field::ramp_s;
  if (request.effective_step > step_max) return Field::effective_step;
  return Field::none;
}

void Arbiter::judge(const Request& request, std::uint64_t step_now, Decision& decision) const noexcept {
  decision.field = offending_field(request);
  if (decision.field != Field::none) {
    decision.verdict = Verdict::bad_request;
  } else if (request.effective_step != 0 && request.effective_step <= step_now) {
    decision.verdict = Verdict::stale_request;
    decision.field = Field::effective_step;
  } else if (blocked_) {
    decision.verdict = Verdict::unit_blocked;
  } else {
    const Assessment assessment =
        assess(configuration_.grid, configuration_.converter, configuration_.limits, decision.setpoint);
    decision.verdict = assessment.admissible ? Verdict::accepted : Verdict::outside_envelope;
    decision.margins = assessment.margins;
  }
}

std::uint64_t Arbiter::start_of(const Request& request, std::uint64_t step_now) const noexcept {
  if (request.effective_step != 0) return request.effective_step;
  return std::min(step_now, step_max) + std::max(configuration_.lead_steps, std::uint32_t{1});
}

Reference Arbiter::issue(const Setpoint& setpoint, double ramp_s, std::uint64_t effective_step) noexcept {
  if (++reference_id_ == 0) reference_id_ = 1;  // 0 says "none" on the wire
  Reference reference;
  reference.id = reference_id_;
  reference.p = setpoint.p;
  reference.q = setpoint.q;
  reference.v_c = setpoint.v_c;
  reference.effective_step = effective_step;
  reference.ramp_steps = ramp_steps(ramp_s, configuration_.timing.period_ns);
  setpoint_ = setpoint;
  standing_is_known_ = true;
  standing_ = reference;
  return reference;
}

}  // namespace weakgrid
