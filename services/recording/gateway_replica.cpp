// GatewayReplica: see the header.
#include "services/recording/gateway_replica.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <bit>

#include "services/decision_text.hpp"

namespace weakgrid {

namespace {

bool same_bits(const Reference& a, const Reference& b) {
  const auto bits = [](double x) { return std::bit_cast<std::uint64_t>(x); };
  return a.id == b.id && bits(a.p) == bits(b.p) && bits(a.q) == bits(b.q) && bits(a.v_c) == bits(b.v_c) &&
         a.effective_step == b.effective_step && a.ramp_steps == b.ramp_steps && a.renews == b.renews &&
         a.lease_end_step == b.lease_end_step;
}

std::string name_of(std::uint64_t client, std::uint32_t id) {
  return fmt::format("client {:x} request {}", client, id);
}

}  // namespace

void GatewayReplica::configure(const Arbiter::Configuration& configuration, bool resumes,
                               const std::string& build) {
  resumes_ = resumes;
  arbiter_.emplace(configuration);
  timing_ = configuration.timing;
  findings_.build = build;
}

void GatewayReplica::process(const UnitInputs& inputs, const Requests& requests, const Strays& strays,
                             DifferenceLog& differences) {
  inputs_ = &inputs;
  requests_ = &requests;
  strays_ = &strays;
  differences_ = &differences;
  is_late_ = decisions_.empty() || decisions_.begin()->first != 1;
  for (const auto& [sequence, taken] : decisions_)
    answered_.emplace(taken.message.decision.client, taken.message.decision.id);
  std::uint64_t last_step = 0;
  for (const auto& [sequence, taken] : decisions_) {
    last_step = taken.message.decision.decided_step;
    plants_then_ = taken.plants;
    if (arbiter_)
      decide(taken.message);
    else
      add_unchecked(findings_.unchecked, last_step, "no manifest tells its settings");
  }
  if (!arbiter_ || references_.empty()) return;
  // Killed in between, it has said what is in force and not why.
  for (auto last = references_.upper_bound(newest_); last != references_.end(); ++last)
    if (may_answer_a_request(last->second)) {
      add_unchecked(findings_.unchecked, last_step,
                    fmt::format("reference {} is of a decision that is not in the recording", last->first));
      newest_ = last->first;
    }
  issue_unasked(references_.rbegin()->first, last_step);
}

// It is what a request has asked for that this gateway is not recorded to have answered.
bool GatewayReplica::may_answer_a_request(const Reference& reference) const {
  const auto asks_for_it = [&](const Request& r) {
    if (r.kind == RequestKind::renew) return reference.renews != 0;
    if (reference.renews != 0) return false;
    if (r.kind == RequestKind::accept || r.kind == RequestKind::set_grid) return true;
    return r.kind == RequestKind::set && r.given != 0 && ((r.given & given_p) == 0 || r.p == reference.p) &&
           ((r.given & given_q) == 0 || r.q == reference.q) &&
           ((r.given & given_v_c) == 0 || r.v_c == reference.v_c);
  };
  return std::any_of(requests_->begin(), requests_->end(), [&](const auto& asked) {
    return answered_.count(asked.first) == 0 && asks_for_it(asked.second);
  });
}

// References that nobody asked for: the unit has tripped or restarted. Before the first decision of a gateway
// whose beginning is not recorded nobody knows who asked: what stood then is taken as it is.
void GatewayReplica::issue_unasked(std::uint32_t up_to, std::uint64_t step) {
  for (auto next = references_.upper_bound(newest_); next != references_.end() && next->first <= up_to;
       next = references_.upper_bound(newest_)) {
    const bool is_beginning = (is_late_ || resumes_) && clients_.empty();
    Arbiter blocked = *arbiter_;
    if (next->first != newest_ + 1) blocked.note_foreign_reference(next->first - 1);
    const Reference idle = blocked.block();
    // Who began on a tripped unit has said so, like everybody who sees one trip.
    if (is_beginning && !same_bits(idle, next->second)) {
      arbiter_->adopt(next->second);
    } else {
      *arbiter_ = blocked;
      compare(next->second, idle, step);
      sure_from_step_ = 0;
    }
    newest_ = next->first;
  }
}

// References of others, or of this one before the recording.
void GatewayReplica::catch_up(std::uint32_t reference_id) {
  if (reference_id <= newest_) return;
  const auto standing = inputs_->references.find(reference_id);
  if ((is_late_ || resumes_) && clients_.empty() && standing != inputs_->references.end())
    arbiter_->adopt(standing->second);
  else if (resumes_ && clients_.empty() && reference_id == newest_ + Arbiter::room)
    arbiter_->leave_room();
  else if (clients_.empty() && standing == inputs_->references.end() && reference_id > Arbiter::room &&
           inputs_->references.count(reference_id - Arbiter::room) != 0) {
    arbiter_->note_foreign_reference(reference_id - Arbiter::room);
    arbiter_->leave_room();
  } else {
    // It stands, and the recording does not hold it.
    standing_is_lost_ = standing == inputs_->references.end();
    arbiter_->note_foreign_reference(reference_id);
  }
  newest_ = reference_id;
}

UnitState GatewayReplica::state_at(const Decision& decision) const {
  // The plant of that time is the last one that had come as far, or one before it: to one that was killed a
  // gateway listens on for a while, when a recorder has heard its successor long since. A decision before any
  // sample finds none.
  std::optional<UnitState> of_the_last;
  for (std::size_t n = plants_then_; n-- > 0;) {
    const auto& changes = inputs_->plants[n].states;
    if (changes.empty() || changes.front().first > decision.decided_step) continue;
    UnitState state = UnitState::running;
    for (const auto& [step, is] : changes)
      if (step <= decision.decided_step) state = is;
    if (state == decision.unit_state || inputs_->plants[n].is_hole(decision.decided_step))
      return decision.unit_state;
    if (!of_the_last) of_the_last = state;
  }
  return of_the_last.value_or(decision.unit_state);
}

const Request* GatewayReplica::request_of(const Decision& recorded) {
  const auto [from, to] = requests_->equal_range({recorded.client, recorded.id});
  const Request* other = nullptr;
  for (auto request = from; request != to; ++request) {
    if (fingerprint(request->second) == recorded.request_fingerprint) return &request->second;
    other = &request->second;
  }
  // One that differs in nothing but its name is the one, unless it has been answered under its own.
  for (auto stray = strays_->requests.begin(); other == nullptr && stray != strays_->requests.end();
       ++stray) {
    // Nothing but its name tells one renewal from another.
    if (recorded.kind == RequestKind::renew) break;
    if (answered_.count(stray->first) != 0) continue;
    Request named = stray->second;
    named.client = recorded.client;
    if (fingerprint(named) == recorded.request_fingerprint) other = &stray->second;
    named = stray->second;
    named.id = recorded.id;
    if (fingerprint(named) == recorded.request_fingerprint) other = &stray->second;
  }
  if (other != nullptr)
    differences_->add({.unit = unit_,
                       .step = recorded.decided_step,
                       .what = "request",
                       .which = name_of(recorded.client, recorded.id),
                       .field = "request_fingerprint",
                       .recorded = std::uint64_t{recorded.request_fingerprint},
                       .computed = std::uint64_t{fingerprint(*other)}});
  else
    add_unchecked(findings_.unchecked, recorded.decided_step,
                  name_of(recorded.client, recorded.id) + " is not in the recording");
  return nullptr;
}

void GatewayReplica::decide(const DecisionMessage& message) {
  const Decision& recorded = message.decision;
  if (decided_.count({recorded.client, recorded.id}) == 0) {
    issue_unasked(recorded.standing_reference_id, recorded.decided_step);
    catch_up(recorded.standing_reference_id);
  }
  const UnitState state = state_at(recorded);
  arbiter_->note_unit(state);
  if (recorded.kind == RequestKind::revalidate) {
    if (!is_blocked(state)) arbiter_->unblock();
    if (!compare(message, arbiter_->revalidate(recorded.measured_V, recorded.decided_step)))
      take_as_recorded(recorded);
    return;
  }
  const Request* request = request_of(recorded);
  if (request != nullptr && standing_is_lost_)
    add_unchecked(findings_.unchecked, recorded.decided_step,
                  fmt::format("reference {}, on which it went on, is not in the recording",
                              recorded.standing_reference_id));
  if (request == nullptr || standing_is_lost_) {
    standing_is_lost_ = standing_is_lost_ && !recorded.reference;
    return take_as_recorded(recorded);
  }
  const bool is_stale_id = recorded.verdict == Verdict::stale_request && recorded.field == Field::id;
  if (is_late_ && is_stale_id && clients_.count(recorded.client) == 0) {
    add_unchecked(findings_.unchecked, recorded.decided_step,
                  "what that client asked before is not in the recording");
    return;
  }
  if (!is_blocked(state)) arbiter_->unblock();
  // That it knew of nothing that stood shows when it asks for all three.
  if (clients_.empty() && recorded.verdict == Verdict::bad_request && recorded.field == Field::given &&
      request->given != 0)
    arbiter_->forget();
  // Who held authority when the recording or this process began shows when somebody else is refused.
  if ((is_late_ || resumes_) && recorded.verdict == Verdict::not_authorised &&
      !arbiter_->authority().is_held(recorded.decided_step)) {
    Authority held;
    held.give(recorded.holder, recorded.held_until_step);
    arbiter_->adopt(held);
  }
  clients_.insert(recorded.client);
  decided_.emplace(recorded.client, recorded.id);
  std::optional<Arbiter> before;
  if (!is_sure(recorded)) before = arbiter_;
  if (!compare(message, arbiter_->decide(*request, recorded.decided_step))) {
    arbiter_ = before;
    take_as_recorded(recorded);
  }
}

// Until the unit is where an order of its own leads, what it knew of before is a guess: its journal is not in the
// recording.
bool GatewayReplica::is_sure(const Decision& recorded) const {
  return !resumes_ || recorded.decided_step >= sure_from_step_;
}

// What it led to stands all the same.
void GatewayReplica::take_as_recorded(const Decision& recorded) {
  if (recorded.reference && recorded.reference->id > newest_) {
    arbiter_->adopt(*recorded.reference);
    newest_ = recorded.reference->id;
  }
  Authority held;
  held.give(recorded.holder, recorded.held_until_step);
  arbiter_->adopt(held);
}

// False: not known well enough to be compared.
bool GatewayReplica::compare(const DecisionMessage& message, const Decision& computed) {
  const Decision& recorded = message.decision;
  const bool must_be_same = is_sure(recorded);
  if (recorded.reference)
    sure_from_step_ = std::min(sure_from_step_, recorded.decided_step + recorded.steps_to_reach);
  const WireFields as_recorded = fields_of(unit_, message);
  if (!must_be_same &&
      !is_same(as_recorded, fields_of(unit_, DecisionMessage{computed, describe(computed, *timing_)}))) {
    add_unchecked(findings_.unchecked, recorded.decided_step,
                  "what its journal told it is not in the recording");
    return false;
  }
  ++findings_.decisions;
  if (recorded.verdict == Verdict::accepted) ++findings_.accepted_recorded;
  if (computed.verdict == Verdict::accepted) ++findings_.accepted_computed;
  const std::uint64_t before = differences_->count();
  differences_->add_first(
      {.unit = unit_,
       .step = recorded.decided_step,
       .what = "decision",
       .which = recorded.kind == RequestKind::revalidate ? std::string("revalidation")
                                                         : name_of(recorded.client, recorded.id),
       .field = {},
       .recorded = {},
       .computed = {}},
      fields_of(unit_, message), fields_of(unit_, DecisionMessage{computed, describe(computed, *timing_)}));
  if (differences_->count() == before) ++findings_.decisions_identical;
  if (!computed.reference || computed.repeated) return true;
  newest_ = computed.reference->id;
  const auto issued = references_.find(newest_);
  if (issued != references_.end())
    compare(issued->second, *computed.reference, recorded.decided_step);
  else
    look_for(*computed.reference, recorded.decided_step);
  return true;
}

// An issued reference that is not where it belongs: under another name, of another unit, or lost.
void GatewayReplica::look_for(const Reference& issued, std::uint64_t step) {
  const auto is_it_but_for_the_id = [&](const Reference& r) {
    Reference named = r;
    named.id = issued.id;
    return same_bits(named, issued);
  };
  const auto add = [&](const char* field, std::uint64_t recorded, std::uint64_t computed) {
    differences_->add({.unit = unit_,
                       .step = step,
                       .what = "reference",
                       .which = fmt::format("id {}", issued.id),
                       .field = field,
                       .recorded = recorded,
                       .computed = computed});
  };
  for (auto stray = references_.begin(); stray != references_.end(); ++stray)
    if (is_it_but_for_the_id(stray->second)) {
      add("id", stray->first, issued.id);
      references_.erase(stray);
      return;
    }
  for (const Reference& stray : strays_->references)
    if (same_bits(stray, issued)) return add("unit", 0, unit_);
  add_unchecked(findings_.unchecked, step, fmt::format("reference {} is not in the recording", issued.id));
}

void GatewayReplica::compare(const Reference& recorded, const Reference& computed, std::uint64_t step) {
  ++findings_.references;
  const std::uint64_t before = differences_->count();
  differences_->add_first({.unit = unit_,
                           .step = step,
                           .what = "reference",
                           .which = fmt::format("id {}", recorded.id),
                           .field = {},
                           .recorded = {},
                           .computed = {}},
                          fields_of(unit_, recorded), fields_of(unit_, computed));
  if (differences_->count() == before) ++findings_.references_identical;
}

}  // namespace weakgrid
