// The references q_r and v_cr with exact derivatives: raised-cosine ramps between accepted setpoints.
#pragma once

#include <optional>

#include "plant/model.hpp"

namespace weakgrid {

struct ShapedReference {
  double q_r = 0.0;
  double dq_r = 0.0;  ///< 1/s
  double v_cr = 0.0;
  double dv_cr = 0.0;  ///< 1/s
};

/// Heap-free, noexcept; evaluated at any step.
class ReferenceShaper {
 public:
  struct State {
    Ramp q, v_c;
    std::optional<Reference> pending;
    std::uint32_t id = 0;         ///< in force, 0 = none
    std::uint32_t newest_id = 0;  ///< accepted
  };

  ReferenceShaper(double v_c, double T) noexcept : idle_v_c_(v_c), T_(T) { idle(); }

  /// q_r = 0 and v_cr as at the start; a pending reference stays pending.
  void idle() noexcept {
    state_.q = {0.0, 0.0, 0.0, 0, 0};
    state_.v_c = {idle_v_c_, idle_v_c_, 0.0, 0, 0};
    state_.id = 0;
  }

  /// Waits for its effective_step. Refused (false): not finite, out of range, or not newer than the newest
  /// known.
  bool accept(const Reference& reference) noexcept {
    if (!is_plausible(reference) || reference.id <= state_.newest_id) return false;
    state_.newest_id = reference.id;
    state_.pending = reference;
    return true;
  }

  /// Puts the pending reference in force once its step has come. Steps rise.
  /// A joiner (a controller that starts while the unit runs) finds the ramp where the others are.
  void advance_to(std::uint64_t step, bool joins) noexcept {
    const std::optional<Reference>& pending = state_.pending;
    if (!pending || pending->effective_step > step) return;
    const std::uint64_t start = joins ? pending->effective_step : step;
    state_.q = state_.q.towards(pending->q, start, pending->ramp_steps);
    state_.v_c = state_.v_c.towards(pending->v_c, start, pending->ramp_steps);
    state_.id = pending->id;
    state_.pending.reset();
  }

  ShapedReference at(std::uint64_t step) const noexcept {
    const Ramp::Point q = state_.q.at(step);
    const Ramp::Point v_c = state_.v_c.at(step);
    return {q.value, q.slope / T_, v_c.value, v_c.slope / T_};
  }

  const State& state() const noexcept { return state_; }
  void restore(const State& state) noexcept { state_ = state; }

 private:
  double idle_v_c_;
  double T_;
  State state_;
};

}  // namespace weakgrid
