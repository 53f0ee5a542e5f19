// What a controller makes of what it hears: the law, the orders that wait for its next sample, and the one
// plant that it listens to. Knows no bus, clock or log.
#pragma once

#include <atomic>
#include <optional>

#include "controller/controller.hpp"
#include "services/runtime/one_writer.hpp"
#include "services/waiting_references.hpp"

namespace weakgrid {

class ControllerDialogue {
 public:
  explicit ControllerDialogue(const ControllerConfiguration& configuration) : controller_(configuration) {}

  /// From any one thread: waits for the next sample.
  void keep(const Reference& reference) noexcept {
    if (!references_.put(reference)) count(overflow_);
    newest_heard_.store(reference.id, std::memory_order_release);
  }

  // From one other thread.
  /// False: another plant is listened to.
  template <class Reader>
  bool admit(WriterId plant, const Reader& reader, std::chrono::steady_clock::time_point now) noexcept {
    const OneWriter::Verdict verdict = one_plant_.admit(plant, reader, now);
    if (verdict == OneWriter::Verdict::refused) count(foreign_);
    if (verdict == OneWriter::Verdict::changed) controller_.reset();
    return verdict != OneWriter::Verdict::refused;
  }
  /// None: the sample is older than the last.
  std::optional<Modulation> answer(const Measurement& measurement) noexcept {
    references_.take([this](const Reference& reference) {
      if (!controller_.accept(reference)) count(refused_references_);
    });
    const Modulation modulation = controller_.step(measurement);
    if (modulation.step == measurement.step) return modulation;
    count(stale_);
    return std::nullopt;
  }
  const Controller& controller() const noexcept { return controller_; }

  // From any thread.
  std::uint32_t newest_heard() const noexcept { return newest_heard_.load(std::memory_order_acquire); }
  std::uint64_t stale() const noexcept { return stale_; }
  std::uint64_t foreign() const noexcept { return foreign_; }
  std::uint64_t refused_references() const noexcept { return refused_references_; }
  std::uint64_t overflow() const noexcept { return overflow_; }

 private:
  using Count = std::atomic<std::uint64_t>;
  static void count(Count& what) noexcept { what.fetch_add(1, std::memory_order_relaxed); }

  Controller controller_;
  OneWriter one_plant_;
  WaitingReferences references_;
  std::atomic<std::uint32_t> newest_heard_{0};
  Count stale_{0}, foreign_{0}, refused_references_{0}, overflow_{0};
};

}  // namespace weakgrid
