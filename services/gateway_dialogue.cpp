// GatewayDialogue: see the header.
#include "services/gateway_dialogue.hpp"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <nlohmann/json.hpp>
#include <utility>

#include "services/decision_text.hpp"

namespace weakgrid {

GatewayDialogue::GatewayDialogue(const Settings& settings, std::uint64_t instance, const std::string& who,
                                 const GatewayMemory& memory, GatewayOutlet& outlet, Time now)
    : unit_(settings.unit.number),
      who_(who),
      timing_(timing(settings)),
      after_restart_(settings.gateway.after_restart),
      started_(now),
      outlet_(outlet),
      memory_(memory.reference ? std::optional(memory) : std::nullopt),
      precedence_(instance, now),
      arbiter_(arbiter_configuration(settings)),
      evidence_(evidence_configuration(settings)) {
  note_event("started", "the gateway has started");
  check_fallback();
  if (memory.reference) arbiter_.note_foreign_reference(memory.reference->id);
}

void GatewayDialogue::stop() {
  note_event("stopped", "the gateway was stopped");
  spdlog::info("{}stopped after {} accepted and {} rejected requests", who_, accepted_, rejected_);
}

// One of several serves. What another has ordered meanwhile, and in whose name, nobody here knows: as after a
// restart without a journal.
bool GatewayDialogue::may_act(Time now) {
  const auto change = precedence_.ask(has_heard_all(now), now);
  if (precedence_.is_another_there(now) && !precedence_.acts()) {
    if (!std::exchange(has_yielded_, true)) spdlog::info("{}stands by: another gateway serves", who_);
    memory_.reset();
  }
  if (change == Precedence::Change::ends) {
    note_event("standby", "another gateway serves");
    has_left_room_ = false;
  }
  // One that serves and was not heard of yet has given the next ids, perhaps.
  if (change == Precedence::Change::begins && !memory_ && (has_yielded_ || has_heard_of_orders_))
    leave_room();
  if (change == Precedence::Change::begins && std::exchange(has_yielded_, false)) {
    arbiter_.forget();
    said_.reset();
    const std::string text = "serves from now on: the gateway that did is silent";
    note_event("takeover", text);
    spdlog::warn("{}{}", who_, text);
  }
  return precedence_.acts();
}

void GatewayDialogue::decide(const Request& request, Time now) {
  if (!may_act(now) || !has_looked_around(now)) return;  // clients repeat
  if (!heard_plant_ && !heard_controller_ && !arbiter_.standing()) arbiter_.forget();
  if (memory_) leave_room();
  const Holder before = arbiter_.authority().holder();
  const bool was_held = arbiter_.authority().is_held(step_);
  const Decision decision = arbiter_.decide(request, step_);
  if (!decision.repeated) {
    // Written before anybody hears of it: a kill -9 in between loses no decision.
    note(&request, decision);
    if (was_held && decision.held_until_step != 0 && decision.holder != before)
      note_event("authority", text_of(decision.holder) + " takes over from " + text_of(before));
    if (decision.reference) issue(*decision.reference);
    if (decision.verdict == Verdict::accepted) operate(decision);
    if (decision.kind == RequestKind::set_grid && decision.verdict == Verdict::accepted) check_fallback();
    ++(decision.verdict == Verdict::accepted ? accepted_ : rejected_);
    spdlog::info("{}client {:x} request {}: {}", who_, request.client, request.id,
                 describe(decision, timing_));
  }
  write(DecisionMessage{decision, describe(decision, timing_)});
}

void GatewayDialogue::watch(const Measurement& measurement, bool is_another, Time now) {
  step_ = measurement.step;
  arbiter_.note_unit(measurement.state);
  is_another_ = is_another_ || is_another;
  is_unseen_ = !may_act(now);
  if (is_unseen_) return;
  if (memory_) go_on(measurement);
  const Rules& rules = arbiter_.rules();
  if (const auto V = evidence_.add(rules.box, rules.converter.omega, measurement)) revalidate(*V);
  is_another = std::exchange(is_another_, false);
  if (!is_another && measurement.blocked == was_blocked_) return;
  was_blocked_ = measurement.blocked;
  if (measurement.blocked || is_another) {
    const Reference idle = arbiter_.block();
    const std::string text =
        fmt::format("the unit is {} at step {}: no setpoint stands any more",
                    measurement.blocked ? name(measurement.state) : "another one", measurement.step);
    note_event(measurement.blocked ? "blocked" : "restarted", text, idle);
    issue(idle);
    spdlog::warn("{}{}", who_, text);
  }
  if (!measurement.blocked) arbiter_.unblock();
}

void GatewayDialogue::hear(const Health& health, Time now) {
  precedence_.hear(health, now);
  if (health.service == "gateway" || health.state == ServiceState::stopped) return;
  arbiter_.note_foreign_reference(health.reference_id);
  has_heard_of_orders_ = has_heard_of_orders_ || health.reference_id != 0;
  heard_plant_ = heard_plant_ || health.service == "plant";
  heard_controller_ = heard_controller_ || health.service == "controller";
}

void GatewayDialogue::look_after(Time now) {
  if (!may_act(now)) return;
  watch_lease();
  say_envelope();
}

// What start, stop and reset mean for the plant.
void GatewayDialogue::operate(const Decision& decision) {
  Operation operation{.client = decision.client, .id = decision.id};
  if (decision.kind == RequestKind::start)
    operation.kind = OperationKind::start;
  else if (decision.kind == RequestKind::stop)
    operation.kind = OperationKind::stop;
  else if (decision.kind == RequestKind::reset)
    operation.kind = OperationKind::reset_trip;
  else
    return;
  write(operation);
}

// What is measured may contradict what is known of the grid.
void GatewayDialogue::revalidate(Interval V) {
  const Decision decision = arbiter_.revalidate(V, step_);
  note(nullptr, decision);
  if (decision.reference) issue(*decision.reference);
  check_fallback();
  const std::string text = describe(decision, timing_);
  spdlog::warn("{}{}", who_, text);
  write(DecisionMessage{decision, text});
}

KnownGrid GatewayDialogue::known_grid() const {
  const GridBox& box = arbiter_.rules().box;
  const double omega = arbiter_.rules().converter.omega;
  return {box.R_g, {omega * box.L_g.low, omega * box.L_g.high}, box.V};
}

void GatewayDialogue::issue(const Reference& reference) {
  write(reference);
  reference_id_ = reference.id;
}

void GatewayDialogue::note(const Request* request, const Decision& decision) {
  if (!outlet_.keeps()) return;
  if (!outlet_.keep("decision", entry(unit_, request, decision, known_grid(), timing_))) ++unwritten_;
}

void GatewayDialogue::note_event(std::string_view kind, const std::string& text,
                                 const std::optional<Reference>& reference) {
  if (!outlet_.keeps()) return;
  if (!outlet_.keep(kind, entry(unit_, text, reference, step_))) ++unwritten_;
}

// Nothing is refused for it: a unit has to fall back on something.
void GatewayDialogue::check_fallback() {
  fallback_holds_ = arbiter_.fallback_holds();
  if (fallback_holds_) return;
  const std::string text = "the fallback itself is not admissible or not stable on every grid of the box";
  spdlog::warn("{}{}", who_, text);
  note_event("fallback", text);
}

// The unit falls back by itself; people are told.
void GatewayDialogue::watch_lease() {
  const auto& standing = arbiter_.standing();
  if (!standing || standing->lease_end_step == 0 || step_ < standing->lease_end_step) return;
  if (fallen_back_id_ == standing->id) return;
  fallen_back_id_ = standing->id;
  const std::string text =
      fmt::format("the lease of reference {} ended at step {}: the unit falls back to p = {:.6g}, q = {:.6g}",
                  standing->id, standing->lease_end_step, standing->fallback_p, standing->fallback_q);
  spdlog::warn("{}{}", who_, text);
  note_event("lease_end", text);
}

namespace {
bool is_same_but_for_step(const Envelope& a, const Envelope& b) {
  return a.reference_id == b.reference_id && a.grid == b.grid && a.fallen_back == b.fallen_back &&
         a.lease_end_step == b.lease_end_step && a.fallback_holds == b.fallback_holds &&
         a.holder == b.holder && a.held_until_step == b.held_until_step;
}
}  // namespace

// At each change; the margins are those of what stands.
void GatewayDialogue::say_envelope() {
  const auto& standing = arbiter_.standing();
  const Rules& rules = arbiter_.rules();
  Envelope now;
  now.step = step_;
  now.reference_id = reference_id_;
  now.grid = known_grid();
  if (standing) {
    now.lease_end_step = standing->lease_end_step;
    now.fallen_back = standing->lease_end_step != 0 && now.step >= standing->lease_end_step;
    now.setpoint = now.fallen_back
                       ? Setpoint{standing->fallback_p, standing->fallback_q, standing->fallback_v_c}
                       : Setpoint{standing->p, standing->q, standing->v_c};
  } else {
    now.setpoint = arbiter_.idle();
  }
  now.fallback_holds = fallback_holds_;
  if (arbiter_.authority().is_held(now.step)) {
    now.holder = arbiter_.authority().holder();
    now.held_until_step = arbiter_.authority().until_step();
  }
  if (said_ && is_same_but_for_step(*said_, now)) return;
  said_ = now;
  double ramp_s = rules.default_ramp_s;
  const Assessment assessment = assess(rules.box, rules.converter, rules.limits, now.setpoint);
  now.margins = assessment.margins;
  if (assessment.admissible) (void)certify(rules, now.setpoint, now.setpoint, ramp_s, &now.margins);
  if (!outlet_.write(now)) said_.reset();
}

// A power cut may have taken the end of the journal, another gateway may have ordered unheard: the ids that they
// have given are not given again.
void GatewayDialogue::leave_room() {
  if (!std::exchange(has_left_room_, true)) arbiter_.leave_room();
}

// At the first sample: what the journal tells stands only if this is still the unit that it tells of. Steps
// rise as long as a unit lives, and one that lives follows what was ordered.
void GatewayDialogue::go_on(const Measurement& measurement) {
  const GatewayMemory memory = *std::exchange(memory_, std::nullopt);
  const Reference& last = *memory.reference;
  const bool follows = measurement.reference_id != 0 || last.effective_step > measurement.step;
  const bool is_the_unit = !measurement.blocked && measurement.step >= memory.step && follows;
  if (arbiter_.standing()) return;  // ordered anew meanwhile
  if (is_the_unit) arbiter_.adopt(last);
  leave_room();
  if (measurement.blocked) return;  // told below
  if (is_the_unit) {
    // Plant and controller follow a newer one: until a request gives p, q and v_c nothing is known to stand.
    if (!arbiter_.standing()) return;
    if (after_restart_ == AfterRestart::fallback) {
      const Reference back = arbiter_.fall_back(measurement.step);
      note_event("fallback", "after a restart the fallback stands, as the settings want it", back);
      issue(back);
      return;
    }
    arbiter_.adopt(memory.authority);
    issue(last);  // who joins late finds it again; who knows it does not move
    spdlog::info("{}goes on from the journal: reference {} stands", who_, last.id);
    return;
  }
  const Reference idle = arbiter_.block();
  arbiter_.unblock();
  const std::string text =
      "the unit has begun anew since the journal was written: no setpoint stands any more";
  note_event("restarted", text, idle);
  issue(idle);
  spdlog::warn("{}{}", who_, text);
}

// Before it knows which references plant and controller hold, a restarted gateway would issue one that they
// refuse as old, or give the id of one of theirs to another. Where nobody is, nobody is heard.
bool GatewayDialogue::has_heard_all(Time now) const {
  return (heard_plant_ && heard_controller_) || now - started_ > std::chrono::seconds(3);
}

bool GatewayDialogue::has_looked_around(Time now) const {
  return precedence_.acts() && ((!memory_ && !is_unseen_) || now - started_ > std::chrono::seconds(3));
}

Health GatewayDialogue::health(Time now) const {
  Health health;
  health.state = has_looked_around(now) ? ServiceState::running : ServiceState::starting;
  if (!fallback_holds_) health.text = "the fallback does not hold on every grid that may be";
  if (health.state == ServiceState::starting) health.text = "looks around for plant and controller";
  if (has_yielded_) {
    health.service = "standby gateway";  // nobody takes it for the one that decides
    health.state = ServiceState::waiting;
    health.text = "stands by: another gateway serves";
  }
  health.step = step_;
  health.reference_id = reference_id_;
  health.counters = {
      {"accepted", accepted_}, {"rejected", rejected_}, {"unsent", unsent_}, {"unwritten", unwritten_}};
  return health;
}

}  // namespace weakgrid
