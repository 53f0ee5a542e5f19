// ControllerReplica: see the header.
#include "services/recording/controller_replica.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <utility>

namespace weakgrid {

namespace {

// How many newer answers an answer waits for its sample, reference and state, which come by other readers.
constexpr std::size_t lag = 512;

constexpr const char* heard_unknown =
    "which of the orders before it has heard is not in the recording";

bool same_bits(double a, double b) {
  return std::bit_cast<std::uint64_t>(a) == std::bit_cast<std::uint64_t>(b);
}

bool same_bits(const Modulation& a, const Modulation& b) {
  return a.step == b.step && a.period_ns == b.period_ns && a.reference_id == b.reference_id &&
         a.status == b.status && a.newest_reference_id == b.newest_reference_id &&
         a.measurement_fingerprint == b.measurement_fingerprint && same_bits(a.mu.re, b.mu.re) &&
         same_bits(a.mu.im, b.mu.im);
}

}  // namespace

ControllerReplica::ControllerReplica(std::uint32_t unit, const std::string& writer, const UnitInputs& inputs,
                                     DifferenceLog& differences, const Options& options)
    : inputs_(inputs),
      differences_(differences),
      options_(options),
      lost_because_("the answers before are not in the recording, nor a state"),
      findings_{.unit = unit, .writer = writer, .build = {}, .unchecked = {}} {}

void ControllerReplica::configure(const ControllerConfiguration& configuration, const std::string& build) {
  controller_.emplace(configuration);
  findings_.build = build;
}

void ControllerReplica::see(std::uint64_t sequence, const Modulation& modulation) {
  if (!has_begun_ && answers_.empty())
    for (const PlantStream& plant : inputs_.plants) ends_before_.push_back(plant.last_step());
  auto at = answers_.end();
  while (at != answers_.begin() && std::prev(at)->sequence >= sequence) --at;
  if (at != answers_.end() && at->sequence == sequence) return;
  answers_.insert(at, {sequence, modulation});
  samples_since_answer_ = 0;
}

void ControllerReplica::note_sample() {
  constexpr std::size_t most = UnitInputs::samples_max / 4;
  if (++samples_since_answer_ == most) process(true);
}

void ControllerReplica::see(const ControllerState& state) {
  states_.push_back(state);
  if (states_.size() > lag) states_.pop_front();
}

void ControllerReplica::process(bool all) {
  while (!answers_.empty() && (all || answers_.size() > lag)) {
    process(answers_.front());
    answers_.pop_front();
  }
}

void ControllerReplica::lose(const std::string& why) {
  is_synced_ = false;
  lost_because_ = why;
}

void ControllerReplica::process(const Answer& answer) {
  const Modulation& recorded = answer.modulation;
  if (has_begun_ && answer.sequence <= last_sequence_) return;
  if (!has_begun_) findings_.first_step = recorded.step;
  findings_.last_step = recorded.step;
  if (!controller_)
    return add_unchecked(findings_.unchecked, recorded.step, "no manifest tells its settings");
  // The very first answer of a process: it knew nothing before.
  constexpr std::uint32_t first = started | bad_measurement | wrong_timing;
  if (!has_begun_ && answer.sequence == 1 && (recorded.status & first) != 0 && options_.from_step == 0)
    is_synced_ = true;
  if (has_begun_ && is_synced_ && answer.sequence != last_sequence_ + 1 && !fill_gap(answer))
    lose(fmt::format("{} answers before step {} are not in the recording",
                     answer.sequence - last_sequence_ - 1, recorded.step));
  // A step back is another plant, and its first samples may be those of the first one to the bit.
  if (has_begun_ && listens_ && recorded.step < last_step_) {
    ++plant_;
    listens_ = false;
    changes_plant_ = true;
  }
  has_begun_ = true;
  last_sequence_ = answer.sequence;
  last_step_ = recorded.step;

  const Measurement* sample = sample_of(recorded);
  if (is_synced_ && accept_references(recorded, sample) && sample != nullptr) {
    const Modulation computed = controller_->step(*sample);
    compare(recorded, computed);
    if (watch) watch(*sample, recorded, *controller_);
  } else {
    add_unchecked(findings_.unchecked, recorded.step, lost_because_);
  }
  meet_state(recorded);
}

// Answers that were given and not recorded: as many as samples in between, so each was answered once.
bool ControllerReplica::fill_gap(const Answer& answer) {
  const Modulation& next = answer.modulation;
  const std::uint64_t missing = answer.sequence - last_sequence_ - 1;
  if (!listens_ || next.step <= last_step_ || next.step - last_step_ - 1 != missing) return false;
  if (next.newest_reference_id != controller_->state().references.track.newest_id) return false;
  for (std::uint64_t step = last_step_ + 1; step < next.step; ++step) {
    const Measurement* sample = inputs_.plants[plant_].find(step);
    if (sample == nullptr) return false;
    const Modulation computed = controller_->step(*sample);
    if (watch) watch(*sample, computed, *controller_);
  }
  return true;
}

// The sample that was answered; what is recorded in its place and is not it is a difference.
const Measurement* ControllerReplica::sample_of(const Modulation& recorded) {
  const Measurement* other = nullptr;
  const char* field = "measurement_fingerprint";
  for (std::size_t n = plant_; n < inputs_.plants.size(); ++n) {
    const Measurement* sample = inputs_.plants[n].find(recorded.step);
    if (sample == nullptr || is_over(n)) continue;
    if (recorded.measurement_fingerprint != 0 && fingerprint(*sample) != recorded.measurement_fingerprint) {
      if (listens_ ? n == plant_ : inputs_.plants.size() == 1) other = sample;
      continue;
    }
    if (is_synced_ && (changes_plant_ || (listens_ && n != plant_ && !is_twin(inputs_.plants[n]))))
      controller_->reset();
    changes_plant_ = false;
    plant_ = n;
    listens_ = true;
    last_sample_ = *sample;
    return sample;
  }
  // Or the answer names the wrong step: the sample that was due has that fingerprint.
  if (other == nullptr && is_synced_ && listens_ && recorded.measurement_fingerprint != 0) {
    const PlantStream& plant = inputs_.plants[plant_];
    const Measurement* due = plant.find(last_sample_.step + 1);
    if (due != nullptr && fingerprint(*due) == recorded.measurement_fingerprint) other = due;
    // Or the sample does: it is the one but for its step, and was not answered under the step it names. Of a
    // blocked unit all samples are the same but for their steps.
    for (const Measurement& sample : plant.samples) {
      Measurement named = sample;
      named.step = recorded.step;
      if (fingerprint(named) == recorded.measurement_fingerprint && !is_answered(sample)) other = &sample;
    }
    field = "step";
  }
  if (other != nullptr) {
    differences_.add({.unit = findings_.unit,
                      .step = recorded.step,
                      .what = "sample",
                      .which = {},
                      .field = field,
                      .recorded = std::uint64_t{recorded.measurement_fingerprint},
                      .computed = std::uint64_t{fingerprint(*other)}});
    if (is_synced_)
      lose(fmt::format("the sample {} recorded is not the one that was answered", recorded.step));
  } else if (is_synced_) {
    lose(fmt::format("sample {} is not in the recording", recorded.step));
  }
  return nullptr;
}

// This plant has sent nothing since the controller's first answer: what it sent is not what was answered.
bool ControllerReplica::is_over(std::size_t plant) const {
  return plant < ends_before_.size() && inputs_.plants[plant].last_step() == ends_before_[plant];
}

// Its samples were so far those that were answered: then this plant has been listened to all along. All plants
// begin alike, and blocked ones go on alike.
bool ControllerReplica::is_twin(const PlantStream& plant) const {
  const Measurement* sample = plant.find(last_sample_.step);
  return sample != nullptr && fingerprint(*sample) == fingerprint(last_sample_);
}

// By this controller, among the samples of the plant listened to.
bool ControllerReplica::is_answered(const Measurement& sample) const {
  if (sample.step <= last_sample_.step) return sample.step >= inputs_.plants[plant_].first_step;
  const bool is = std::any_of(answers_.begin(), answers_.end(), [&](const Answer& answer) {
    return answer.modulation.step == sample.step &&
           answer.modulation.measurement_fingerprint == fingerprint(sample);
  });
  return is || is_lost(sample);
}

// On its way to the controller, or its answer on the way to the recording: such a thing has happened
// thereabouts.
bool ControllerReplica::is_lost(const Measurement& sample) const {
  if (answers_.empty()) return false;
  if (inputs_.plants[plant_].holes_near(answers_.front().modulation.step, lag) > 1) return true;
  if (answers_.back().modulation.step <= sample.step) return false;
  for (auto answer = answers_.begin(); answer != answers_.end(); ++answer) {
    const bool is_first = answer == answers_.begin();
    if ((answer->modulation.status & gap) != 0) return true;
    if (!is_first && answer->sequence != std::prev(answer)->sequence + 1) return true;
  }
  return false;
}

bool ControllerReplica::accept_references(const Modulation& recorded, const Measurement* sample) {
  const std::uint32_t newest = recorded.newest_reference_id;
  const std::uint32_t known = controller_->state().references.track.newest_id;
  if (newest <= known) return true;
  const auto last = inputs_.references.find(newest);
  if (last == inputs_.references.end()) {
    lose(fmt::format("reference {} is not in the recording", newest));
    return false;
  }
  // All since the last answer, in the order of issue: a renewal depends on what it renews.
  auto first = known > 0 ? inputs_.references.upper_bound(known) : last;
  if (sample != nullptr) {
    are_orders_known_ = known > 0 ? first == last : last == inputs_.references.begin();
    if (!are_orders_known_) first = first_heard(first, last, *sample, recorded);
  }
  for (auto at = first; at != std::next(last); ++at) controller_->accept(at->second);
  return true;
}

// Who joins late has heard no order of before: of those up to `last` the fewest that explain its answer. Who was
// cut off has heard the last ones: the most that do.
ControllerReplica::References ControllerReplica::first_heard(References first, References last,
                                                             const Measurement& sample,
                                                             const Modulation& recorded) const {
  constexpr int tries_max = 64;
  const bool joins = first == last;
  References heard = first;
  for (int n = 0; n < tries_max; ++n) {
    Controller trial = *controller_;
    for (auto at = heard; at != std::next(last); ++at) trial.accept(at->second);
    if (same_bits(trial.step(sample), recorded)) return heard;
    if (heard == (joins ? inputs_.references.begin() : last)) break;
    if (joins)
      --heard;
    else
      ++heard;
  }
  return first;
}

void ControllerReplica::compare(const Modulation& recorded, const Modulation& computed) {
  if (!are_orders_known_ && !same_bits(recorded, computed)) {
    lose(heard_unknown);
    return add_unchecked(findings_.unchecked, recorded.step, lost_because_);
  }
  ++findings_.compared;
  if ((recorded.status & saturated) != 0) ++findings_.saturated_recorded;
  if ((computed.status & saturated) != 0) ++findings_.saturated_computed;
  if (same_bits(recorded, computed)) {
    ++findings_.identical;
    return;
  }
  Modulation named = computed;
  named.epoch = recorded.epoch;  // who leads is no matter of the law
  const double distance = abs(recorded.mu - computed.mu);
  findings_.mu_distance_squares += distance * distance;
  if (distance > findings_.mu_distance_max) {
    findings_.mu_distance_max = distance;
    findings_.mu_distance_max_step = recorded.step;
  }
  if (options_.other_settings && differences_.count() > 0) return;
  differences_.add_first({.unit = findings_.unit,
                          .step = recorded.step,
                          .what = "modulation",
                          .which = {},
                          .field = {},
                          .recorded = {},
                          .computed = {}},
                         fields_of(findings_.unit, recorded), fields_of(findings_.unit, named));
}

// A state recorded of this step: compared, or gone on from.
void ControllerReplica::meet_state(const Modulation& answer) {
  if (states_.empty()) return;
  const std::uint64_t step = answer.step;
  const auto at = std::find_if(states_.begin(), states_.end(), [&](const ControllerState& state) {
    return state.last.step == step && state.last.measurement_fingerprint == answer.measurement_fingerprint;
  });
  if (at == states_.end()) return;
  const ControllerState recorded = *at;
  states_.erase(states_.begin(), std::next(at));
  if (!controller_ || step < options_.from_step) return;
  if (!is_synced_) {
    controller_->restore(recorded);
    is_synced_ = true;
    are_orders_known_ = true;
    ++findings_.resumed;
    return;
  }
  if (options_.other_settings) return;
  const WireFields computed = fields_of(findings_.unit, controller_->state());
  const WireFields as_recorded = fields_of(findings_.unit, recorded);
  if (!std::exchange(are_orders_known_, true) && !is_same(as_recorded, computed)) {
    controller_->restore(recorded);
    ++findings_.resumed;
    return add_unchecked(findings_.unchecked, step, heard_unknown);
  }
  ++findings_.states_compared;
  const std::uint64_t before = differences_.count();
  differences_.add_first({.unit = findings_.unit,
                          .step = step,
                          .what = "state",
                          .which = {},
                          .field = {},
                          .recorded = {},
                          .computed = {}},
                         as_recorded, computed);
  if (differences_.count() == before) ++findings_.states_identical;
}

}  // namespace weakgrid
