// What keeps the law of a controller that follows in step with the one that leads: the same samples and
// references, and where the answers differ the leader's state, with what has come since done again.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>

#include "controller/controller.hpp"

namespace weakgrid {

class Shadow {
 public:
  /// A reference that the law was given.
  void note(const Reference& reference) noexcept { references_[noted_++ % references_.size()] = reference; }
  /// A sample that the law was given, and its answer.
  void note(const Measurement& sample, const Modulation& answer) noexcept {
    Slot& slot = slot_of(sample.step);
    slot.sample = sample;
    slot.own = answer;
    slot.has_own = true;
    last_ = sample.step;
    compare(slot);
  }
  /// What the leader has answered.
  void hear(const Modulation& answer) noexcept {
    Slot& slot = slot_of(answer.step);
    slot.heard = answer;
    slot.has_heard = true;
    compare(slot);
  }
  /// The law's last answers were the leader's, to the bit.
  bool is_in_step() const noexcept { return is_in_step_; }
  void lose_step() noexcept { is_in_step_ = false; }

  /// The leader's state. Another's is not looked at, nor one of a step that is long past, nor of a sample
  /// that was not had here: the leader may listen to another plant.
  void adopt(const ControllerState& state, Controller& law) noexcept {
    const std::uint64_t step = state.last.step;
    const Slot& of_state = slot_of(step);
    if (is_in_step_ || !of_state.has_heard || !is_same(of_state.heard, state.last)) return;
    if (!of_state.has_own || of_state.own.step != step ||
        of_state.own.measurement_fingerprint != state.last.measurement_fingerprint)
      return;
    // However far the last sample has jumped: a bounded number of steps is done again.
    if (last_ > step && last_ - step >= slots_.size()) return;
    if (!is_finite(state.law)) return;  // it came over a network
    law.restore(state);
    for (std::size_t n = 0; n < references_.size(); ++n) {
      const Reference& reference = references_[(noted_ + n) % references_.size()];
      if (reference.id != 0) (void)law.accept(reference);  // refuses what the state knows
    }
    is_in_step_ = true;
    for (std::uint64_t later = step + 1; later <= last_; ++later) {
      Slot& slot = slot_of(later);
      if (!slot.has_own || slot.sample.step != later) continue;
      slot.own = law.step(slot.sample);
      compare(slot);
    }
  }

 private:
  struct Slot {
    Measurement sample;
    Modulation own, heard;
    bool has_own = false, has_heard = false;
  };

  Slot& slot_of(std::uint64_t step) noexcept { return slots_[step % slots_.size()]; }
  static bool is_same(const Modulation& a, const Modulation& b) noexcept {
    return a.step == b.step && a.measurement_fingerprint == b.measurement_fingerprint && a.mu.re == b.mu.re &&
           a.mu.im == b.mu.im;
  }
  static bool is_finite(const LawState& s) noexcept {
    const double sum = s.q_error + s.eta_error + s.p_r;
    return std::isfinite(sum) && finite(s.v_p_hat + s.v_p + s.e1) && finite(s.y + s.mu_before) &&
           finite(s.mu + s.command);
  }
  void compare(const Slot& slot) noexcept {
    if (slot.has_own && slot.has_heard && slot.own.step == slot.heard.step)
      is_in_step_ = is_same(slot.own, slot.heard);
  }

  std::array<Slot, 64> slots_{};
  std::array<Reference, 16> references_{};
  std::size_t noted_ = 0;
  std::uint64_t last_ = 0;  // step
  bool is_in_step_ = false;
};

}  // namespace weakgrid
