// Somebody else on the bus of a unit under test: sees everything, asks for setpoints, operates.
#pragma once

#include <gtest/gtest.h>

#include <deque>
#include <mutex>
#include <optional>
#include <vector>

#include "services/cli/client.hpp"
#include "tests/support/processes_under_test.hpp"

namespace weakgrid::test {

/// The last samples of the plant (as long as it lives another's count for nothing), all references.
class Bystander {
 public:
  explicit Bystander(const Domain& domain, std::uint32_t unit = 1, const DdsSettings& dds = {})
      : client_(domain.number(), unit, dds),
        references_(client_.bus(), unit,
                    [this](const Reference& r, Arrival) {
                      const std::lock_guard lock(mutex_);
                      seen_references_.push_back(r);
                    }),
        modulations_(client_.bus(), unit,
                     [this](const Modulation& m, Arrival) {
                       const std::lock_guard lock(mutex_);
                       modulation_ = m;
                     }),
        measurements_(client_.bus(), unit, [this](const Measurement& m, Arrival a) { keep(m, a.writer); }) {}

  Client& client() { return client_; }

  std::optional<Measurement> measurement() const {
    const std::lock_guard lock(mutex_);
    return samples_.empty() ? std::nullopt : std::optional(samples_.back());
  }
  std::optional<Modulation> modulation() const {
    const std::lock_guard lock(mutex_);
    return modulation_;
  }
  std::vector<Reference> references() const {
    const std::lock_guard lock(mutex_);
    return seen_references_;
  }
  /// Who measures now: changes with a restart of the plant.
  WriterId plant() const {
    const std::lock_guard lock(mutex_);
    return plant_;
  }
  /// The largest source power measured since the plant changed or this was asked last.
  double take_source_power_max() {
    const std::lock_guard lock(mutex_);
    return std::exchange(source_power_max_, 0.0);
  }

  /// The newest health of a service, of an instance other than `not_this` (one that was killed says nothing
  /// more).
  std::optional<Health> health(const std::string& service, std::uint64_t not_this = 0) const {
    std::optional<Health> newest;
    for (const auto& [key, health] : client_.peers())
      if (key.first == service && key.second != not_this &&
          (!newest || newest->wall_time_ns < health.wall_time_ns))
        newest = health;
    return newest;
  }
  std::uint64_t instance(const std::string& service) const {
    const auto known = health(service);
    return known ? known->instance : 0;
  }
  bool is(const std::string& service, ServiceState state, std::uint64_t not_this = 0) const {
    const auto known = health(service, not_this);
    return known && known->state == state;
  }
  std::uint64_t count(const std::string& service, const std::string& name) const {
    const auto known = health(service);
    return known ? counter(*known, name) : 0;
  }

  /// All three run and the loop has gone round `steps` times more, from sample to modulation.
  ::testing::AssertionResult runs(milliseconds patience = long_enough, std::uint64_t steps = 200) {
    const auto all_run = [this] {
      return is("plant", ServiceState::running) && is("controller", ServiceState::running) &&
             is("gateway", ServiceState::running) && measurement() && modulation();
    };
    if (!wait_until(all_run, patience)) return ::testing::AssertionFailure() << "not all run:" << words();
    return goes_on(patience, steps);
  }
  ::testing::AssertionResult goes_on(milliseconds patience = long_enough, std::uint64_t steps = 200) {
    const auto from = measurement();
    const auto there = [&] {
      const auto now = measurement();
      const auto answer = modulation();
      return from && now && answer && now->step >= from->step + steps && answer->step >= from->step + steps;
    };
    if (!wait_until(there, patience))
      return ::testing::AssertionFailure() << "the loop stands still:" << words();
    return ::testing::AssertionSuccess();
  }

  /// Every sample of a grid period (at 100 µs) lies on p and q, within `tolerance`.
  ::testing::AssertionResult settles_at(double p, double q, double tolerance = 1e-3) {
    const auto there = [&] {
      const std::lock_guard lock(mutex_);
      if (samples_.size() < kept) return false;
      for (const Measurement& m : samples_) {
        const SpaceVector s = power(m.v_p, m.i);
        if (!(std::abs(s.re - p) <= tolerance && std::abs(s.im - q) <= tolerance)) return false;
      }
      return true;
    };
    if (wait_until(there)) return ::testing::AssertionSuccess();
    const auto last = measurement().value_or(Measurement{});
    const SpaceVector s = power(last.v_p, last.i);
    return ::testing::AssertionFailure()
           << "p " << s.re << " q " << s.im << " at step " << last.step << words();
  }

  /// Asks for p, q and v_c and waits until plant and controller know of the reference.
  std::optional<Reference> order(double p, double q, double v_c = 1.8384776310850235) {
    const auto answer =
        client_.ask({.given = given_p | given_q | given_v_c, .p = p, .q = q, .v_c = v_c}, long_enough);
    if (!answer || !answer->decision.reference) {
      ADD_FAILURE() << "refused or unanswered: " << (answer ? answer->text : "no answer");
      return std::nullopt;
    }
    const std::uint32_t id = answer->decision.reference->id;
    for (const char* reader : {"plant", "controller"})
      EXPECT_TRUE(wait_until([&] {
        const auto known = health(reader);
        return known && known->reference_id >= id;
      })) << reader
          << " does not take reference " << id << words();
    return answer->decision.reference;
  }

  /// What is known, for a failure.
  std::string words() const {
    std::string text;
    for (const auto& [key, h] : client_.peers())
      text += "\n  " + h.service + " " + std::to_string(h.instance) + ": " + name(h.state) + ", step " +
              std::to_string(h.step) + ", reference " + std::to_string(h.reference_id) + " " + h.text;
    return text;
  }

 private:
  static constexpr std::size_t kept = 200;

  void keep(const Measurement& m, WriterId writer) {
    const std::lock_guard lock(mutex_);
    if (one_plant_.admit(writer, measurements_) == OneWriter::Verdict::refused) return;
    if (writer != plant_) {
      samples_.clear();
      source_power_max_ = 0.0;
      plant_ = writer;
    }
    if (!samples_.empty() && m.step == samples_.back().step) return;  // sent again
    samples_.push_back(m);
    source_power_max_ = std::max(source_power_max_, std::abs(m.p_i));
    if (samples_.size() > kept) samples_.pop_front();
  }

  mutable std::mutex mutex_;
  std::vector<Reference> seen_references_;
  std::optional<Modulation> modulation_;
  std::deque<Measurement> samples_;
  OneWriter one_plant_;
  WriterId plant_ = 0;
  double source_power_max_ = 0.0;
  Client client_;
  Reader<Reference> references_;
  Reader<Modulation> modulations_;
  Reader<Measurement> measurements_;
};

}  // namespace weakgrid::test
