// The flatness law of one unit on a bus, one answer to each sample; and all that one process serves.
#pragma once

#include <array>
#include <atomic>
#include <memory>
#include <vector>

#include "services/controller_dialogue.hpp"
#include "services/runtime/announcer.hpp"
#include "services/runtime/stage_timings.hpp"

namespace weakgrid {

class ControllerUnit {
 public:
  ControllerUnit(const Settings& settings, Bus& bus);

  // On threads of the bus.
  void keep(const Reference& reference) { dialogue_.keep(reference); }
  void answer(const Measurement& measurement, const Arrival& from, const Reader<Measurement>& reader);
  /// Of whoever writes it, this one as well.
  void hear(const Modulation& modulation, const Arrival& from) {
    if (from.writer != modulations_.id()) dialogue_.hear(modulation);
  }
  void hear(const ControllerState& state, const Arrival& from) {
    if (from.writer != states_.id()) dialogue_.hear(state);
  }

  void say(std::uint64_t malformed);
  const Health& said() const { return announcer_.said(); }
  void note_end() const;

 private:
  void count(const Modulation& modulation) noexcept;
  Health health(std::uint64_t malformed);

  const std::string who_;  // in the log
  const bool is_redundant_;
  ControllerDialogue dialogue_;
  const std::uint64_t state_every_;  // steps: 50 ms
  std::atomic<bool> running_{false};
  std::atomic<std::uint32_t> status_{0};
  std::atomic<std::uint64_t> step_{0}, unsent_{0}, lease_ends_{0};
  std::array<std::atomic<std::uint64_t>, 7> counts_{};
  std::uint32_t fallen_back_ = 0;  // the reference whose fallback was followed at the last sample, 0 = none
  std::string logged_;
  enum { sample, compute, write, stage_count };
  std::array<Stage, stage_count> stages_{Stage{"sample"}, Stage{"compute"}, Stage{"write"}};

  Announcer announcer_;
  Writer<Modulation> modulations_;
  Writer<ControllerState> states_;
};

/// Units number … number + count − 1 of the settings; they answer from the first sample on.
class Controllers {
 public:
  Controllers(const Settings& settings, Bus& bus);
  ~Controllers();
  void say();
  /// For the service manager, on the thread that says.
  std::string status() const;

 private:
  ControllerUnit& unit(const Arrival& from) { return *units_[from.unit - served_.first]; }

  const Units served_;
  std::vector<std::unique_ptr<ControllerUnit>> units_;
  // For a controller that is one of two: what the other says.
  std::optional<Reader<Modulation>> answers_;
  std::optional<Reader<ControllerState>> states_;
  std::optional<Reader<Reference>> references_;
  std::optional<Reader<Measurement>> measurements_;
};

}  // namespace weakgrid
