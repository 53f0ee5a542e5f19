// Judge: see the header.
#include "tests/deterministic/judge.hpp"

#include <cmath>

#include "tests/deterministic/envelope_check.hpp"
#include "tests/deterministic/tape.hpp"

namespace weakgrid::deterministic {

Judge::Judge(const Settings& s)
    : rules_(arbiter_configuration(s)),
      protection_(emulator_configuration(s).protection),
      // The steepest of a raised cosine over the shortest ramp that anybody asks for, from one end of what is
      // allowed to the other, twice over for a slope that is carried on.
      step_change_max_(2.0 * (0.5 * pi) * 2.0 * period_s(timing(s)) / s.gateway.ramp_s),
      T_(period_s(timing(s))) {}

void Judge::fail(std::uint64_t step, const std::string& what) const { throw Violation{step, what}; }

// Where a unit goes when there is nothing else: stands whether or not the grid carries it.
bool Judge::is_rest(const Setpoint& s) const {
  const Setpoint& f = rules_.fallback;
  return (s.p == f.p && s.q == f.q && s.v_c == f.v_c) || (s.p == 0.0 && s.q == 0.0);
}

void Judge::see_issued(WriterId gateway, const Reference& r, const GridBox& box) {
  const auto known = issued_.find(r.id);
  if (known != issued_.end()) {
    if (bits_of(known->second.reference) != bits_of(r))
      fail(step_, "two different references have the id " + std::to_string(r.id));
    known->second.gateway = gateway;
    return;
  }
  const std::string broken = is_rest(of(r)) ? "" : limit_broken(of(r), box, rules_.converter, rules_.limits);
  if (!broken.empty())
    fail(step_, "reference " + std::to_string(r.id) + " is outside of the envelope: " + broken);
  Issued issued{r, gateway, r.lease_end_step};
  const auto order = issued_.find(r.renews);
  if (r.renews != 0 && order != issued_.end())
    for (auto at = order; at != issued_.end(); ++at)
      if (at->first == r.renews || at->second.reference.renews == r.renews) {
        const std::uint64_t other = at->second.lease_end_step;
        issued.lease_end_step =
            other == 0 || issued.lease_end_step == 0 ? 0 : std::max(issued.lease_end_step, other);
      }
  issued_.emplace(r.id, issued);
}

void Judge::know(WriterId gateway, const std::optional<GridBox>& box) {
  if (gateway == knower_ && box == known_) return;
  knower_ = gateway;
  known_ = box;
  good_on_known_.clear();
}

void Judge::see_decided(WriterId gateway, Asked asked, bool must_be_refused, const Decision& decision) {
  if (decision.repeated || decision.verdict != Verdict::accepted || decision.kind == RequestKind::revalidate)
    return;
  if (must_be_refused) fail(step_, "a hostile request was accepted");
  if (!accepted_.emplace(gateway, asked).second) fail(step_, "one request was accepted twice");
}

void Judge::see_sample(WriterId id, const Measurement& m) {
  step_ = m.step;
  Plant& plant = plants_[id];
  check_protection(plant, m);
  if (!m.blocked) {
    check_in_force(m);
    check_lease("the source", m.step, m.reference_id, m.fallback);
    if (plant.last && !plant.last->blocked) check_ramp("p", m.step, plant.last->p_i, m.p_i);
  }
  check_fallback_reached(plant, m);
  plant.last = m;
}

void Judge::check_protection(Plant& plant, const Measurement& m) const {
  if (m.blocked) {
    plant.outside_v_p = 0;
    if (m.p_i != 0.0) fail(m.step, "the bridge is blocked and the source is not open");
    return;
  }
  if (!finite(m.i) || !finite(m.v_p) || !std::isfinite(m.v_c) || abs(m.i) > protection_.i_max ||
      m.v_c > protection_.v_c_max || m.v_c < protection_.v_c_min)
    fail(m.step, "the unit is outside of its protection and not blocked: |i| = " + std::to_string(abs(m.i)) +
                     ", v_c = " + std::to_string(m.v_c));
  const double v_p = abs(m.v_p);
  const bool outside = v_p > protection_.v_p_max || v_p < protection_.v_p_min;
  plant.outside_v_p = outside ? plant.outside_v_p + 1 : 0;
  if (plant.outside_v_p > protection_.v_p_steps)
    fail(m.step, "|v_p| has been outside of its protection for too long: " + std::to_string(v_p));
}

// Against what the gateway knows by now, not when it was issued.
void Judge::check_in_force(const Measurement& m) {
  if (m.reference_id == 0 || m.fallback) return;
  const auto issued = issued_.find(m.reference_id);
  if (issued == issued_.end())
    fail(m.step, "reference " + std::to_string(m.reference_id) + " is in force and nobody has issued it");
  if (!known_ || issued->second.gateway != knower_ || is_rest(of(issued->second.reference))) return;
  if (!good_on_known_.insert(m.reference_id).second) return;
  const std::string broken =
      limit_broken(of(issued->second.reference), *known_, rules_.converter, rules_.limits);
  if (!broken.empty())
    fail(m.step, "reference " + std::to_string(m.reference_id) +
                     " is in force and outside of the envelope of what the gateway knows: " + broken);
}

void Judge::check_lease(const char* who, std::uint64_t step, std::uint32_t id, bool is_fallback) const {
  if (id == 0 || is_fallback) return;
  const auto issued = issued_.find(id);
  if (issued == issued_.end()) fail(step, std::string(who) + " follows a reference that nobody has issued");
  const std::uint64_t end = issued->second.lease_end_step;
  if (end != 0 && step >= end)
    fail(step, std::string(who) + " follows reference " + std::to_string(id) + " whose lease ended at step " +
                   std::to_string(end));
}

void Judge::check_fallback_reached(Plant& plant, const Measurement& m) const {
  const bool is_the_same = plant.last && plant.last->fallback && plant.last->reference_id == m.reference_id &&
                           !plant.last->blocked;
  if (!m.fallback || m.blocked || !is_the_same) plant.fallback_since = m.step;
  if (!m.fallback || m.blocked) return;
  const Reference& r = issued_.at(m.reference_id).reference;
  if (m.step - plant.fallback_since > r.fallback_ramp_steps && std::abs(m.p_i - r.fallback_p) > 1e-9)
    fail(m.step, "the fallback is not reached at the end of its ramp: p = " + std::to_string(m.p_i));
}

void Judge::check_ramp(const char* what, std::uint64_t step, double before, double after) const {
  if (std::abs(after - before) > step_change_max_)
    fail(step, std::string(what) + " jumps from " + std::to_string(before) + " to " + std::to_string(after));
}

void Judge::see_applied(WriterId, const Measurement& m, const std::optional<Modulation>& answer,
                        std::uint32_t newest_at_plant) {
  if (!answer) return;
  if (answer->step != m.step || answer->measurement_fingerprint != fingerprint(m))
    fail(m.step, "the bridge follows an answer to another sample");
  // What both know and what is due, both follow. (Until it is due they may differ: it may have come before
  // the one that it replaces was due here, and after it there.)
  const auto newest = issued_.find(newest_at_plant);
  const bool is_due = newest != issued_.end() && newest->second.reference.effective_step <= m.step;
  if (!m.blocked && is_due && answer->newest_reference_id == newest_at_plant && m.reference_id != 0 &&
      answer->reference_id != 0 && answer->reference_id != m.reference_id)
    fail(m.step, "source and law know the same references and follow different ones: " +
                     std::to_string(m.reference_id) + " and " + std::to_string(answer->reference_id));
}

void Judge::see_answered(WriterId controller, const Measurement& m, const Modulation& answer,
                         const ControllerState& state) {
  constexpr double mu_max = 0.70710678118654752 * (1.0 + 1e-9);
  if (!finite(answer.mu) || abs2(answer.mu) > mu_max * mu_max)
    fail(m.step, "|mu| = " + std::to_string(abs(answer.mu)));
  Law& law = laws_[controller];
  constexpr std::uint32_t unusable = bad_measurement | wrong_timing;
  if (m.blocked || (answer.status & unusable) != 0) {
    law.last_step.reset();
    return;
  }
  const ReferenceTrack& track = state.references.track;
  check_lease("the law", m.step, track.id(), track.fallen_back);
  const ShapedReference now{state.references.q.at(m.step).value, 0.0, state.references.v_c.at(m.step).value,
                            0.0};
  const bool goes_on =
      law.last_step && *law.last_step + 1 == m.step && (answer.status & (started | gap)) == 0;
  if (goes_on) {
    check_ramp("q", m.step, law.last.q_r, now.q_r);
    check_ramp("v_c", m.step, law.last.v_cr, now.v_cr);
  }
  law.last_step = m.step;
  law.last = now;
}

}  // namespace weakgrid::deterministic
