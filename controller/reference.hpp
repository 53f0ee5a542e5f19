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
  ReferenceShaper(double v_c, double T) noexcept : idle_v_c_(v_c), T_(T) { idle(); }

  /// q_r = 0 and v_cr as at the start; a pending reference stays pending.
  void idle() noexcept {
    q_ = {0.0, 0.0, 0.0, 0, 0};
    v_c_ = {idle_v_c_, idle_v_c_, 0.0, 0, 0};
    id_ = 0;
  }

  /// Waits for its effective_step. Refused (false): not finite, out of range, or not newer than the newest
  /// known.
  bool accept(const Reference& reference) noexcept {
    if (!is_plausible(reference) || reference.id <= newest_id_) return false;
    newest_id_ = reference.id;
    pending_ = reference;
    return true;
  }

  /// Puts the pending reference in force once its step has come. Steps rise.
  /// A joiner (a controller that starts while the unit runs) finds the ramp where the others are.
  void advance_to(std::uint64_t step, bool joins) noexcept {
    if (!pending_ || pending_->effective_step > step) return;
    const std::uint64_t start = joins ? pending_->effective_step : step;
    q_ = q_.towards(pending_->q, start, pending_->ramp_steps);
    v_c_ = v_c_.towards(pending_->v_c, start, pending_->ramp_steps);
    id_ = pending_->id;
    pending_.reset();
  }

  ShapedReference at(std::uint64_t step) const noexcept {
    const Ramp::Point q = q_.at(step);
    const Ramp::Point v_c = v_c_.at(step);
    return {q.value, q.slope / T_, v_c.value, v_c.slope / T_};
  }

  std::uint32_t id() const noexcept { return id_; }

 private:
  double idle_v_c_;
  double T_;
  Ramp q_, v_c_;
  std::optional<Reference> pending_;
  std::uint32_t id_ = 0;
  std::uint32_t newest_id_ = 0;
};

}  // namespace weakgrid
