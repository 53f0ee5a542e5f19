// What a plant makes of what it hears: which answer drives the emulated unit, which orders and operations it
// follows, and the one controller that it listens to. Knows no bus, clock or log.
#pragma once

#include <array>
#include <atomic>
#include <optional>
#include <span>

#include "plant/emulator.hpp"
#include "services/leadership.hpp"
#include "services/runtime/mailbox.hpp"
#include "services/runtime/messages.hpp"
#include "services/runtime/one_writer.hpp"
#include "services/waiting_references.hpp"

namespace weakgrid {

class PlantDialogue {
 public:
  /// until: the step at which it waits for an operation.
  PlantDialogue(const EmulatorConfiguration& configuration, std::span<const Event> events,
                std::uint64_t until)
      : emulator_(configuration, events), until_(until) {}

  // From any one thread for each kind of message: waits for the loop.
  /// False: another controller is listened to, or one of a higher epoch has taken over.
  template <class Reader>
  bool admit(WriterId controller, std::uint64_t epoch, const Reader& reader,
             std::chrono::steady_clock::time_point now) noexcept {
    // No controller has such a one, and none could replace it.
    if (epoch > Leadership::epoch_max) {
      count(foreign_);
      return false;
    }
    const OneWriter::Verdict verdict = one_controller_.admit(controller, reader, now, epoch);
    if (verdict == OneWriter::Verdict::refused) count(foreign_);
    if (verdict == OneWriter::Verdict::changed) count(controller_changes_);
    return verdict != OneWriter::Verdict::refused;
  }
  void keep(const Modulation& modulation) noexcept { keep(modulations_, modulation); }
  void keep(const Reference& reference) noexcept {
    if (!references_.put(reference)) count(overflow_);
    newest_heard_.store(reference.id, std::memory_order_release);
  }
  void keep(const Operation& operation) noexcept { keep(operations_, operation); }

  // On the thread of the loop.
  /// Takes the references and operations that have come; refused(operation): to wait at a step that has
  /// passed, or not for this state.
  template <class Refused>
  void hear(Refused refused) {
    references_.take([this](const Reference& reference) {
      if (!emulator_.accept(reference)) count(refused_references_);
    });
    while (const auto operation = operations_.take()) {
      if (obey(*operation)) continue;
      count(refused_operations_);
      refused(*operation);
    }
  }
  bool waits() const noexcept { return emulator_.step() >= until_; }
  std::uint64_t until() const noexcept { return until_; }
  /// The answer to this sample, the present one, of those that have come.
  std::optional<Modulation> answer_to(const Measurement& measurement) noexcept;
  /// Ends the step; none: hold.
  void advance(const std::optional<Modulation>& modulation) noexcept {
    emulator_.advance(modulation ? command(*modulation) : std::nullopt);
  }
  void trip(Trip cause) noexcept { (void)emulator_.trip(cause); }
  const Emulator& emulator() const noexcept { return emulator_; }

  // From any thread.
  /// Of the references, also while the loop waits and takes none.
  std::uint32_t newest_heard() const noexcept { return newest_heard_.load(std::memory_order_acquire); }
  std::uint64_t late_modulations() const noexcept { return late_modulations_; }
  std::uint64_t saturated_answers() const noexcept { return saturated_; }
  std::uint64_t foreign() const noexcept { return foreign_; }
  std::uint64_t controller_changes() const noexcept { return controller_changes_; }
  std::uint64_t overflow() const noexcept { return overflow_; }
  std::uint64_t refused_references() const noexcept { return refused_references_; }
  std::uint64_t refused_operations() const noexcept { return refused_operations_; }

 private:
  using Count = std::atomic<std::uint64_t>;
  static void count(Count& what) noexcept { what.fetch_add(1, std::memory_order_relaxed); }
  template <class Message, std::size_t n>
  void keep(Mailbox<Message, n>& box, const Message& message) noexcept {
    if (!box.put(message)) count(overflow_);
  }
  bool obey(const Operation& operation) noexcept;

  Emulator emulator_;
  std::uint64_t until_;
  std::uint64_t unanswered_ = 0;  // the first step that no answer has come to, those before are repeats
  OneWriter one_controller_;
  Mailbox<Modulation, 8> modulations_;
  WaitingReferences references_;
  Mailbox<Operation, 16> operations_;
  std::atomic<std::uint32_t> newest_heard_{0};
  Count late_modulations_{0}, saturated_{0}, foreign_{0}, controller_changes_{0}, overflow_{0},
      refused_references_{0}, refused_operations_{0};
};

}  // namespace weakgrid
