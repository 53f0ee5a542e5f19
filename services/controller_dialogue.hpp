// What a controller makes of what it hears: the law, the orders that wait for its next sample, the one plant
// that it listens to, and whether it or another answers it. Knows no bus, clock or log.
#pragma once

#include <atomic>
#include <optional>

#include "controller/controller.hpp"
#include "services/leadership.hpp"
#include "services/runtime/mailbox.hpp"
#include "services/runtime/one_writer.hpp"
#include "services/shadow.hpp"
#include "services/waiting_references.hpp"

namespace weakgrid {

class ControllerDialogue {
 public:
  explicit ControllerDialogue(const ControllerConfiguration& configuration,
                              Redundancy redundancy = Redundancy::none,
                              std::chrono::nanoseconds takeover = std::chrono::milliseconds(20))
      : controller_(configuration),
        is_redundant_(redundancy != Redundancy::none),
        leadership_(redundancy, takeover) {
    publish();
  }

  /// From any one thread: waits for the next sample.
  void keep(const Reference& reference) noexcept {
    if (!references_.put(reference)) count(overflow_);
    newest_heard_.store(reference.id, std::memory_order_release);
  }

  /// From any one thread each: another controller's answer or state; waits likewise.
  void hear(const Modulation& answer) noexcept { (void)heard_.put(answer); }
  void hear(const ControllerState& state) noexcept { heard_state_.put(state); }

  // From one other thread.
  /// False: another plant is listened to.
  template <class Reader>
  bool admit(WriterId plant, const Reader& reader, std::chrono::steady_clock::time_point now) noexcept {
    const OneWriter::Verdict verdict = one_plant_.admit(plant, reader, now);
    if (verdict == OneWriter::Verdict::refused) count(foreign_);
    if (verdict == OneWriter::Verdict::changed) {
      controller_.reset();
      shadow_.lose_step();
    }
    return verdict != OneWriter::Verdict::refused;
  }
  /// None: the sample is older than the last, or another controller answers it.
  std::optional<Modulation> answer(const Measurement& measurement,
                                   std::chrono::steady_clock::time_point now) noexcept {
    references_.take([this](const Reference& reference) {
      if (!controller_.accept(reference)) count(refused_references_);
      if (is_redundant_) shadow_.note(reference);
    });
    if (is_redundant_) listen();
    Modulation modulation = controller_.step(measurement);
    if (modulation.step != measurement.step) {
      count(stale_);
      return std::nullopt;
    }
    if (!is_redundant_) return modulation;
    const bool led = leadership_.leads();
    const bool leads = leadership_.answers(measurement.step, now);
    // Out of step with who led it knows nothing but the references: anew, as after a start.
    if (leads && !led && !shadow_.is_in_step()) {
      controller_.start_anew();
      modulation = controller_.step(measurement);
    }
    shadow_.note(measurement, modulation);
    // After the sample, which the state may be of.
    if (const auto state = heard_state_.take(); state && !leads) shadow_.adopt(*state, controller_);
    if (leads != led) count(takeovers_);
    publish();
    if (!leads) return std::nullopt;
    modulation.epoch = leadership_.epoch();
    return modulation;
  }
  const Controller& controller() const noexcept { return controller_; }

  // From any thread.
  bool leads() const noexcept { return leads_; }
  /// It follows, and its last answers would have been the leader's to the bit.
  bool is_in_step() const noexcept { return in_step_; }
  std::uint64_t epoch() const noexcept { return epoch_; }
  std::uint64_t takeovers() const noexcept { return takeovers_; }
  std::uint32_t newest_heard() const noexcept { return newest_heard_.load(std::memory_order_acquire); }
  std::uint64_t stale() const noexcept { return stale_; }
  std::uint64_t foreign() const noexcept { return foreign_; }
  std::uint64_t refused_references() const noexcept { return refused_references_; }
  std::uint64_t overflow() const noexcept { return overflow_; }

 private:
  using Count = std::atomic<std::uint64_t>;
  static void count(Count& what) noexcept { what.fetch_add(1, std::memory_order_relaxed); }

  void listen() noexcept {
    while (const auto answer = heard_.take()) {
      const bool led = leadership_.leads();
      if (!leadership_.hear(*answer)) continue;
      if (led) shadow_.lose_step();
      shadow_.hear(*answer);
    }
  }
  void publish() noexcept {
    leads_.store(leadership_.leads(), std::memory_order_relaxed);
    in_step_.store(!leadership_.leads() && shadow_.is_in_step(), std::memory_order_relaxed);
    epoch_.store(leadership_.epoch(), std::memory_order_relaxed);
  }

  Controller controller_;
  const bool is_redundant_;
  Leadership leadership_;
  Shadow shadow_;
  Mailbox<Modulation, 16> heard_;
  Newest<ControllerState> heard_state_;
  OneWriter one_plant_;
  WaitingReferences references_;
  std::atomic<std::uint32_t> newest_heard_{0};
  std::atomic<bool> leads_{true}, in_step_{false};
  Count stale_{0}, foreign_{0}, refused_references_{0}, overflow_{0}, epoch_{0}, takeovers_{0};
};

}  // namespace weakgrid
