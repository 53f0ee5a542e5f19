// GatewayReplica: see the header.
#include "services/recording/gateway_replica.hpp"

#include <fmt/format.h>

#include "services/decision_text.hpp"

namespace weakgrid {

namespace {

std::string name_of(std::uint64_t client, std::uint32_t id) {
  return fmt::format("client {:x} request {}", client, id);
}

}  // namespace

void GatewayReplica::configure(const Arbiter::Configuration& configuration, const std::string& build) {
  arbiter_.emplace(configuration);
  timing_ = configuration.timing;
  findings_.build = build;
}

void GatewayReplica::process(const UnitInputs& inputs, const Requests& requests, DifferenceLog& differences) {
  inputs_ = &inputs;
  requests_ = &requests;
  differences_ = &differences;
  is_late_ = !decisions_.empty() && decisions_.begin()->first != 1;
  std::uint64_t last_step = 0;
  for (const auto& [sequence, decision] : decisions_) {
    last_step = decision.decision.decided_step;
    if (arbiter_)
      decide(decision);
    else
      add_unchecked(findings_.unchecked, last_step, "no manifest tells its settings");
  }
  if (arbiter_ && !references_.empty()) issue_unasked(references_.rbegin()->first, last_step);
}

// References that nobody asked for: the unit has tripped or restarted.
void GatewayReplica::issue_unasked(std::uint32_t up_to, std::uint64_t step) {
  for (auto next = references_.upper_bound(newest_); next != references_.end() && next->first <= up_to;
       next = references_.upper_bound(newest_)) {
    if (next->first != newest_ + 1) {
      // Before it another gateway's have stood, or ones that are not in the recording.
      if (newest_ == 0 && is_late_)
        arbiter_->adopt(next->second);
      else
        arbiter_->note_foreign_reference(next->first - 1);
      newest_ = is_late_ && newest_ == 0 ? next->first : next->first - 1;
      continue;
    }
    compare(next->second, arbiter_->block(), step);
    newest_ = next->first;
  }
}

void GatewayReplica::catch_up(std::uint32_t reference_id) {
  if (reference_id <= newest_) return;
  if (newest_ == 0 && is_late_) {
    // Late to come: what stands is the state topic's last word.
    const auto standing = inputs_->references.find(reference_id);
    if (standing != inputs_->references.end()) {
      arbiter_->adopt(standing->second);
      newest_ = reference_id;
      return;
    }
  }
  arbiter_->note_foreign_reference(reference_id);
  newest_ = reference_id;
}

bool GatewayReplica::is_blocked_at(const Decision& decision) const {
  // The plant of that time is the last one that had come as far; a decision before any sample finds none.
  for (auto plant = inputs_->plants.rbegin(); plant != inputs_->plants.rend(); ++plant) {
    if (plant->blocked.empty() || plant->blocked.front().first > decision.decided_step) continue;
    bool blocked = false;
    for (const auto& [step, is] : plant->blocked)
      if (step <= decision.decided_step) blocked = is;
    return blocked;
  }
  return decision.verdict == Verdict::unit_blocked;
}

const Request* GatewayReplica::request_of(const Decision& recorded) {
  const auto [from, to] = requests_->equal_range({recorded.client, recorded.id});
  const Request* other = nullptr;
  for (auto request = from; request != to; ++request) {
    if (fingerprint(request->second) == recorded.request_fingerprint) return &request->second;
    other = &request->second;
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
  const Request* request = request_of(recorded);
  if (request == nullptr) return;
  const bool is_stale_id = recorded.verdict == Verdict::stale_request && recorded.field == Field::id;
  if (is_late_ && is_stale_id && clients_.count(recorded.client) == 0) {
    add_unchecked(findings_.unchecked, recorded.decided_step,
                  "what that client asked before is not in the recording");
    return;
  }
  if (!is_blocked_at(recorded)) arbiter_->unblock();
  const Decision computed = arbiter_->decide(*request, recorded.decided_step);
  clients_.insert(recorded.client);
  decided_.emplace(recorded.client, recorded.id);

  ++findings_.decisions;
  if (recorded.verdict == Verdict::accepted) ++findings_.accepted_recorded;
  if (computed.verdict == Verdict::accepted) ++findings_.accepted_computed;
  const std::uint64_t before = differences_->count();
  differences_->add_first({.unit = unit_,
                           .step = recorded.decided_step,
                           .what = "decision",
                           .which = name_of(recorded.client, recorded.id),
                           .field = {},
                           .recorded = {},
                           .computed = {}},
                          fields_of(unit_, message),
                          fields_of(unit_, DecisionMessage{computed, describe(computed, *timing_)}));
  if (differences_->count() == before) ++findings_.decisions_identical;
  if (!computed.reference || computed.repeated) return;
  newest_ = computed.reference->id;
  const auto issued = references_.find(newest_);
  if (issued != references_.end()) compare(issued->second, *computed.reference, recorded.decided_step);
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
