// Plant, controller and gateway as simulated processes: the services' dialogues, with simulated time and a
// simulated network where the programs have threads and a bus. What a bug planted on purpose does is done
// here, in the wiring.
#pragma once

#include <nlohmann/json.hpp>

#include "services/controller_dialogue.hpp"
#include "services/gateway_dialogue.hpp"
#include "services/plant_dialogue.hpp"
#include "services/runtime/time_grid.hpp"
#include "tests/deterministic/judge.hpp"
#include "tests/deterministic/tape.hpp"

namespace weakgrid::deterministic {

/// What can be broken on purpose: the judge must find it.
enum class Bug : std::uint8_t {
  none,
  no_fence,             ///< the plant listens to every controller
  no_lease,             ///< the source never learns of a lease's end
  repeats_decided,      ///< a request that comes twice is taken for two
  no_ramp,              ///< the law jumps to its reference
  journal_after_words,  ///< a decision is journalled a moment after it was said
  journal_forgotten,    ///< a restarted gateway does not read its journal
  stale_answer,         ///< the plant takes any answer for that to the present sample
  no_envelope,          ///< the gateway's limits are far too wide
  no_modulation_limit,  ///< the law's answers are longer than the bridge can make
  no_protection,        ///< the unit's protection is far too wide
  hidden_state,         ///< an answer depends on something that is no input
};

class World;

/// Which writers are matched, as a Reader says it; the same whenever it is asked again.
struct Matched {
  const World* world;
  Time at;
  bool is_alive(WriterId writer) const;
};

class PlantProcess : public Process {
 public:
  PlantProcess(World& world, WriterId number);
  /// Hears, samples, sends, and waits for the answer.
  void step();
  void take(const Modulation& modulation, WriterId from);
  void take(const Reference& reference);
  void take(const Operation& operation);
  Health health() const;
  const std::optional<Measurement>& last() const { return last_; }
  std::optional<std::size_t> differs_at() const { return dialogue_.differs_at(); }

 private:
  static constexpr nanoseconds resend_after = 20ms;
  static constexpr std::uint64_t catch_up_max = 1000;

  void send(const Measurement& sample);
  void wait_for_answer(std::uint64_t exchange);
  std::optional<Modulation> answer();
  void end_step(const std::optional<Modulation>& answer);
  void make_up_for_missed();
  const Emulator& emulator() const { return dialogue_->emulator(); }

  World& world_;
  Taped<PlantDialogue> dialogue_;
  std::optional<Measurement> last_;
  std::optional<TimeGrid> grid_;
  std::uint64_t exchange_ = 0;  // counts steps that wait in lockstep
  bool is_waiting_ = false, has_been_answered_ = false, controller_is_lost_ = false;
  nanoseconds waited_{0};
};

class ControllerProcess : public Process {
 public:
  ControllerProcess(World& world, WriterId number, Redundancy redundancy);
  void take(const Measurement& measurement, WriterId from);
  void take(const Reference& reference);
  void take(const Modulation& others);
  void take(const ControllerState& others);
  Redundancy redundancy() const { return redundancy_; }
  std::uint64_t takeovers() const { return dialogue_->takeovers(); }
  Health health() const;
  std::optional<std::size_t> differs_at() const { return dialogue_.differs_at(); }

 private:
  World& world_;
  const Redundancy redundancy_;
  Taped<ControllerDialogue> dialogue_;
  bool answers_ = false;
};

/// Everything a gateway says, as one number.
class Echo : public GatewayOutlet {
 public:
  bool write(const Reference& r) override { return add(bits_of(r)); }
  bool write(const Operation& o) override { return add(static_cast<std::uint32_t>(o.kind) + o.id); }
  bool write(const DecisionMessage& d) override {
    return add(bits_of(d.text) + bits_of(d.decision.reference) + (d.decision.repeated ? 1u : 0u));
  }
  bool write(const Envelope& e) override { return add(e.reference_id + static_cast<std::uint32_t>(e.step)); }
  bool keeps() const override { return true; }
  bool keep(std::string_view kind, nlohmann::json body) override {
    return add(bits_of(std::string(kind) + body.dump()));
  }
  std::uint32_t said() const { return said_.value(); }

 private:
  bool add(std::uint32_t bits) {
    said_.add(std::uint64_t{bits});
    return true;
  }
  Fingerprint said_;
};

class GatewayProcess : public Process, public Echo {
 public:
  /// memory: what its journal tells.
  GatewayProcess(World& world, WriterId number, const GatewayMemory& memory);

  void take(const Request& request, Asked asked, bool is_hostile);
  void take(const Measurement& measurement, WriterId from);
  void take(const Health& health);
  void look_after();
  void stop();
  /// It is killed just before it says or keeps something for the n-th time from now on.
  void dies_before_word(std::uint32_t n) { words_left_ = n; }
  std::optional<std::size_t> differs_at() const;
  const Arbiter& arbiter() const { return dialogue_->arbiter(); }
  const std::optional<Reference>& last_reference() const { return last_reference_; }

  bool write(const Reference& reference) override;
  bool write(const Operation& operation) override;
  bool write(const DecisionMessage& decision) override;
  bool write(const Envelope& envelope) override;
  bool keep(std::string_view kind, nlohmann::json body) override;

 private:
  struct Killed {};
  template <class Call>
  void make(Call call);
  void speak();
  void check_resumed(const Measurement& measurement);

  World& world_;
  const GatewayMemory memory_;
  const Time started_;
  Settings settings_;
  OneWriter one_plant_;
  std::unique_ptr<GatewayDialogue> dialogue_;
  std::vector<std::pair<std::function<void(GatewayDialogue&)>, std::uint32_t>> tape_;
  std::optional<Reference> last_reference_;
  std::uint32_t words_left_ = ~0u;
  bool has_seen_unit_ = false;
  Asked asked_;  // what is decided just now
  bool is_hostile_ = false;
};

}  // namespace weakgrid::deterministic
