// The references q_r and v_cr with exact derivatives: raised-cosine ramps between accepted setpoints.
#pragma once

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
    ReferenceTrack track;
  };

  ReferenceShaper(double v_c, double T) noexcept : idle_v_c_(v_c), T_(T) { idle(); }

  /// q_r = 0 and v_cr as at the start; a pending reference stays pending.
  void idle() noexcept {
    stand();
    state_.track.idle();
  }

  /// The same for another unit.
  void forget() noexcept {
    stand();
    state_.track.forget();
  }

  bool accept(const Reference& reference) noexcept { return state_.track.accept(reference); }

  /// Begins what has come by `step`: a pending order, or the fallback once a lease is over. Steps rise.
  /// A joiner (a controller that starts while the unit runs) finds the ramp where the others are.
  void advance_to(std::uint64_t step, bool joins) noexcept {
    while (const auto move = state_.track.advance_to(step, joins)) {
      state_.q = state_.q.towards(move->q, move->start, move->ramp_steps);
      state_.v_c = state_.v_c.towards(move->v_c, move->start, move->ramp_steps);
    }
  }

  ShapedReference at(std::uint64_t step) const noexcept {
    const Ramp::Point q = state_.q.at(step);
    const Ramp::Point v_c = state_.v_c.at(step);
    return {q.value, per_second(q.slope), v_c.value, per_second(v_c.slope)};
  }

  const State& state() const noexcept { return state_; }
  void restore(const State& state) noexcept { state_ = state; }

 private:
  // Most of the time nothing moves, and a division is slow.
  double per_second(double slope) const noexcept { return slope == 0.0 ? slope : slope / T_; }

  void stand() noexcept {
    state_.q = {0.0, 0.0, 0.0, 0, 0};
    state_.v_c = {idle_v_c_, idle_v_c_, 0.0, 0, 0};
  }

  double idle_v_c_;
  double T_;
  State state_;
};

}  // namespace weakgrid
