// What the gateway orders, the lease that it holds for, and which of it is in force at a step: the same in
// source, controller and gateway. Leases are counted in steps, so that a dead gateway is survived by both.
#pragma once

#include <cmath>
#include <cstdint>
#include <optional>

namespace weakgrid {

/// p goes to the source, q and v_c to the controller. Both ramp from what stands. Per unit.
struct Reference {
  std::uint32_t id = 0;  ///< 1, 2, … in the order of issue
  double p = 0.0;
  double q = 0.0;
  double v_c = 0.0;
  std::uint64_t effective_step = 0;
  std::uint32_t ramp_steps = 0;
  /// The order whose lease this prolongs, below id; 0 = an order of its own. A renewal says all that the
  /// order said, so that whoever has not heard of the order starts from the renewal alone.
  std::uint32_t renews = 0;
  std::uint64_t lease_end_step = 0;  ///< from this step on the fallback stands; 0 = never
  double fallback_p = 0.0;
  double fallback_q = 0.0;
  double fallback_v_c = 1.8384776310850235;  ///< 1.3·√2
  std::uint32_t fallback_ramp_steps = 0;
};

/// Every number is one that a unit could be ordered to. Source and controller refuse the rest alike, so that
/// neither follows half an order.
inline bool is_plausible(const Reference& r) noexcept {
  // Comparisons with NaN are false, so NaN is implausible.
  const auto is_setpoint = [](double p, double q, double v_c) {
    return std::abs(p) <= 10.0 && std::abs(q) <= 10.0 && v_c > 0.0 && v_c <= 10.0;
  };
  return is_setpoint(r.p, r.q, r.v_c) && (r.renews == 0 || r.renews < r.id) &&
         (r.lease_end_step == 0 || is_setpoint(r.fallback_p, r.fallback_q, r.fallback_v_c));
}

/// Which reference is in force, which waits for its step, and whether a lease has ended. Total, heap-free.
/// The fields are for observers, and for whoever carries the track over the wire.
struct ReferenceTrack {
  /// A ramp begins.
  struct Move {
    double p = 0.0;
    double q = 0.0;
    double v_c = 0.0;
    std::uint64_t start = 0;
    std::uint32_t ramp_steps = 0;
    bool is_fallback = false;  ///< since a lease is over
  };

  std::optional<Reference> in_force;
  std::optional<Reference> pending;  ///< waits for its step; always newer than the one in force
  std::uint32_t newest_id = 0;       ///< accepted
  std::uint32_t order_id = 0;        ///< the first id of the newest order, by which renewals name it
  bool fallen_back = false;          ///< the lease in force has ended: its fallback stands

  std::uint32_t id() const noexcept { return in_force ? in_force->id : 0; }

  /// Refused (false): not plausible, or not newer than the newest known. An order replaces the one that
  /// waits. A renewal of the newest order gives it the new id and the later lease end, and nothing moves. Of
  /// an order that has fallen back, or that is not the newest known, a renewal is an order. Of one that was
  /// cancelled it does nothing: a trip is not undone by somebody who has not heard of it.
  bool accept(const Reference& reference) noexcept {
    if (!is_plausible(reference) || reference.id <= newest_id) return false;
    // A renewal may also name the renewal before it.
    const bool is_renewal = order_id != 0 && reference.renews >= order_id && reference.renews <= newest_id;
    newest_id = reference.id;
    if (is_renewal && pending) {
      prolong(*pending, reference);
    } else if (is_renewal && !in_force) {
      return true;
    } else if (is_renewal && !fallen_back) {
      prolong(*in_force, reference);
    } else {
      order_id = reference.renews != 0 ? reference.renews : reference.id;
      pending = reference;
    }
    return true;
  }

  /// What begins at `step` or has begun since the last one: ask until there is none; at most three times.
  /// Steps rise. A pending order begins at its step, late at this one; one whose lease is over by then never
  /// does, its fallback stands at once. A lease ends at its step exactly, and the next order just then is in
  /// time. A joiner (that starts while the unit runs) finds every ramp where the others are.
  std::optional<Move> advance_to(std::uint64_t step, bool joins) noexcept {
    const bool is_due = pending && pending->effective_step <= step;
    const std::uint64_t begin = is_due && joins ? pending->effective_step : step;
    if (in_force && !fallen_back && is_over(*in_force, step) &&
        !(is_due && begin <= in_force->lease_end_step)) {
      fallen_back = true;
      return fallback(in_force->lease_end_step);
    }
    if (!is_due) return std::nullopt;
    in_force = pending;
    pending.reset();
    fallen_back = is_over(*in_force, begin);
    if (fallen_back) return fallback(begin);
    return Move{in_force->p, in_force->q, in_force->v_c, begin, in_force->ramp_steps, false};
  }

  /// Nothing is in force any more; what waits goes on waiting.
  void idle() noexcept {
    in_force.reset();
    fallen_back = false;
  }

  /// A trip: nor does anything wait.
  void cancel() noexcept {
    idle();
    pending.reset();
  }

  /// Another unit: a renewal of what was in force is an order to it.
  void forget() noexcept {
    idle();
    if (!pending) order_id = 0;
  }

 private:
  static bool is_over(const Reference& r, std::uint64_t step) noexcept {
    return r.lease_end_step != 0 && r.lease_end_step <= step;
  }

  // Never shortened: what is over would have to begin in the past, with a jump.
  static void prolong(Reference& standing, const Reference& renewal) noexcept {
    standing.id = renewal.id;
    const bool is_later = renewal.lease_end_step > standing.lease_end_step;
    if (standing.lease_end_step != 0 && (renewal.lease_end_step == 0 || is_later))
      standing.lease_end_step = renewal.lease_end_step;
  }

  Move fallback(std::uint64_t start) const noexcept {
    const Reference& r = *in_force;
    return {r.fallback_p, r.fallback_q, r.fallback_v_c, start, r.fallback_ramp_steps, true};
  }
};

}  // namespace weakgrid
