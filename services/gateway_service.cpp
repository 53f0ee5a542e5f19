// weakgrid-gateway: requests in, decisions and references out.
#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <atomic>
#include <memory>
#include <mutex>
#include <utility>
#include <vector>

#include "gateway/arbiter.hpp"
#include "services/decision_text.hpp"
#include "services/gateway_memory.hpp"
#include "services/runtime/announcer.hpp"
#include "services/runtime/program.hpp"
#include "services/runtime/service_manager.hpp"

namespace weakgrid {
namespace {

// The supervisor of one unit.
class GatewayUnit {
 public:
  /// memory: what the journal of an earlier start tells; settings hold the grid of it already.
  GatewayUnit(const Settings& settings, const GatewayMemory& memory, std::optional<Journal>& journal,
              Bus& bus)
      : unit_(settings.unit.number),
        who_(name_in_log(settings)),
        timing_(timing(settings)),
        journal_(journal),
        memory_(memory.reference ? std::optional(memory) : std::nullopt),
        after_restart_(settings.gateway.after_restart),
        arbiter_(arbiter_configuration(settings)),
        evidence_(evidence_configuration(settings)),
        announcer_(bus, settings, "gateway", {}),
        references_(bus, unit_),
        decisions_(bus, unit_),
        envelopes_(bus, unit_),
        operations_(bus, unit_) {
    const std::lock_guard lock(mutex_);
    note_event("started", "the gateway has started");
    check_fallback();
    if (memory.reference) arbiter_.note_foreign_reference(memory.reference->id);
  }

  ~GatewayUnit() {
    const std::lock_guard lock(mutex_);
    note_event("stopped", "the gateway was stopped");
    spdlog::info("{}stopped after {} accepted and {} rejected requests", who_, accepted_.load(),
                 rejected_.load());
  }

  void say(std::uint64_t malformed) {
    watch_lease();
    say_envelope();
    announcer_.say(health(malformed));
  }

  const Health& said() const { return announcer_.said(); }

  // On threads of the bus, as the next two.
  void decide(const Request& request) {
    const std::lock_guard lock(mutex_);
    if (!has_looked_around()) return;  // clients repeat
    if (!heard_plant_ && !heard_controller_ && !arbiter_.standing()) arbiter_.forget();
    const Holder before = arbiter_.authority().holder();
    const bool was_held = arbiter_.authority().is_held(step_);
    const Decision decision = arbiter_.decide(request, step_);
    if (!decision.repeated) {
      // Written before anybody hears of it: a kill -9 in between loses no decision.
      if (journal_ && !note(*journal_, unit_, &request, decision, known_grid(), timing_))
        unwritten_.fetch_add(1);
      if (was_held && decision.held_until_step != 0 && decision.holder != before)
        note_event("authority", text_of(decision.holder) + " takes over from " + text_of(before));
      if (decision.reference) issue(*decision.reference);
      if (decision.verdict == Verdict::accepted) operate(decision);
      if (decision.kind == RequestKind::set_grid && decision.verdict == Verdict::accepted) check_fallback();
      (decision.verdict == Verdict::accepted ? accepted_ : rejected_).fetch_add(1);
      spdlog::info("{}client {:x} request {}: {}", who_, request.client, request.id,
                   describe(decision, timing_));
    }
    if (!decisions_.write({decision, describe(decision, timing_)})) unsent_.fetch_add(1);
  }

  // Follows the unit: its step, its trips, and whether it is still the same one.
  void watch(const Measurement& measurement, const Arrival& from, const Reader<Measurement>& reader) {
    const auto verdict = one_plant_.admit(from.writer, reader);
    if (verdict == OneWriter::Verdict::refused) {
      foreign_.fetch_add(1, std::memory_order_relaxed);
      return;
    }
    // The step a decision names and what is known of it change together.
    const std::lock_guard lock(mutex_);
    step_.store(measurement.step, std::memory_order_relaxed);
    arbiter_.note_unit(measurement.state);
    if (memory_) go_on(measurement);
    const Rules& rules = arbiter_.rules();
    if (const auto V = evidence_.add(rules.box, rules.converter.omega, measurement)) revalidate(*V);
    if (verdict != OneWriter::Verdict::changed && measurement.blocked == was_blocked_) return;
    was_blocked_ = measurement.blocked;
    if (measurement.blocked || verdict == OneWriter::Verdict::changed) {
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

  void hear(const Health& health) {
    if (health.service == "gateway" || health.state == ServiceState::stopped) return;
    const std::lock_guard lock(mutex_);
    arbiter_.note_foreign_reference(health.reference_id);
    heard_plant_ = heard_plant_ || health.service == "plant";
    heard_controller_ = heard_controller_ || health.service == "controller";
  }

 private:
  // With mutex_ held: what start, stop and reset mean for the plant.
  void operate(const Decision& decision) {
    Operation operation{.client = decision.client, .id = decision.id};
    if (decision.kind == RequestKind::start)
      operation.kind = OperationKind::start;
    else if (decision.kind == RequestKind::stop)
      operation.kind = OperationKind::stop;
    else if (decision.kind == RequestKind::reset)
      operation.kind = OperationKind::reset_trip;
    else
      return;
    if (!operations_.write(operation)) unsent_.fetch_add(1);
  }

  // With mutex_ held: what is measured may contradict what is known of the grid.
  void revalidate(Interval V) {
    const Decision decision = arbiter_.revalidate(V, step_);
    if (journal_ && !note(*journal_, unit_, nullptr, decision, known_grid(), timing_))
      unwritten_.fetch_add(1);
    if (decision.reference) issue(*decision.reference);
    check_fallback();
    spdlog::warn("{}{}", who_, describe(decision, timing_));
    if (!decisions_.write({decision, describe(decision, timing_)})) unsent_.fetch_add(1);
  }

  KnownGrid known_grid() const {
    const GridBox& box = arbiter_.rules().box;
    const double omega = arbiter_.rules().converter.omega;
    return {box.R_g, {omega * box.L_g.low, omega * box.L_g.high}, box.V};
  }

  // With mutex_ held.
  void issue(const Reference& reference) {
    if (!references_.write(reference)) unsent_.fetch_add(1);
    reference_id_ = reference.id;
  }

  // With mutex_ held.
  void note_event(const std::string& kind, const std::string& text,
                  const std::optional<Reference>& reference = {}) {
    if (journal_ && !note(*journal_, unit_, kind, text, reference, step_)) unwritten_.fetch_add(1);
  }

  // With mutex_ held. Nothing is refused for it: a unit has to fall back on something.
  void check_fallback() {
    fallback_holds_ = arbiter_.fallback_holds();
    if (fallback_holds_) return;
    const std::string text = "the fallback itself is not admissible or not stable on every grid of the box";
    spdlog::warn("{}{}", who_, text);
    note_event("fallback", text);
  }

  // The unit falls back by itself; people are told.
  void watch_lease() {
    const std::lock_guard lock(mutex_);
    const auto& standing = arbiter_.standing();
    if (!standing || standing->lease_end_step == 0 || step_ < standing->lease_end_step) return;
    if (fallen_back_id_ == standing->id) return;
    fallen_back_id_ = standing->id;
    const std::string text = fmt::format(
        "the lease of reference {} ended at step {}: the unit falls back to p = {:.6g}, q = {:.6g}",
        standing->id, standing->lease_end_step, standing->fallback_p, standing->fallback_q);
    spdlog::warn("{}{}", who_, text);
    note_event("lease_end", text);
  }

  // At each change; the margins are those of what stands.
  void say_envelope() {
    const std::lock_guard lock(mutex_);
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
    if (!envelopes_.write(now)) said_.reset();
  }

  static bool is_same_but_for_step(const Envelope& a, const Envelope& b) {
    return a.reference_id == b.reference_id && a.grid == b.grid && a.fallen_back == b.fallen_back &&
           a.lease_end_step == b.lease_end_step && a.fallback_holds == b.fallback_holds &&
           a.holder == b.holder && a.held_until_step == b.held_until_step;
  }

  // At the first sample, with mutex_ held: what the journal tells stands only if this is still the unit that
  // it tells of. Steps rise as long as a unit lives, and one that lives follows what was ordered.
  void go_on(const Measurement& measurement) {
    const GatewayMemory memory = *std::exchange(memory_, std::nullopt);
    const Reference& last = *memory.reference;
    const bool follows = measurement.reference_id != 0 || last.effective_step > measurement.step;
    if (measurement.blocked || arbiter_.standing()) return;  // told below, or ordered anew meanwhile
    if (measurement.step >= memory.step && follows) {
      arbiter_.adopt(last);
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

  // Before it knows which reference plant and controller hold, a restarted gateway would issue one that they
  // refuse as old. Where nobody is, nobody is heard. With mutex_ held.
  bool has_looked_around() const {
    return (heard_plant_ && heard_controller_ && !memory_) ||
           std::chrono::steady_clock::now() - started_ > std::chrono::seconds(3);
  }

  Health health(std::uint64_t malformed) {
    Health health;
    {
      const std::lock_guard lock(mutex_);
      health.state = has_looked_around() ? ServiceState::running : ServiceState::starting;
      if (!fallback_holds_) health.text = "the fallback does not hold on every grid that may be";
    }
    if (health.state == ServiceState::starting) health.text = "looks around for plant and controller";
    health.step = step_;
    health.reference_id = reference_id_;
    health.counters = {{"accepted", accepted_},
                       {"rejected", rejected_},
                       {"unsent", unsent_},
                       {"unwritten", unwritten_},
                       {"unsynced", journal_ ? journal_->unsynced() : 0},
                       {"foreign_measurements", foreign_},
                       {"malformed", malformed}};
    return health;
  }

  const std::uint32_t unit_;
  const std::string who_;  // in the log
  const Timing timing_;
  std::optional<Journal>& journal_;
  std::optional<GatewayMemory> memory_;  // until the unit has been seen
  std::uint32_t fallen_back_id_ = 0;
  bool fallback_holds_ = true;
  const AfterRestart after_restart_;
  std::mutex mutex_;
  Arbiter arbiter_;
  GridEvidence evidence_;
  std::optional<Envelope> said_;
  OneWriter one_plant_;
  bool was_blocked_ = false;
  bool heard_plant_ = false, heard_controller_ = false;
  const std::chrono::steady_clock::time_point started_ = std::chrono::steady_clock::now();
  std::atomic<std::uint64_t> step_{0}, accepted_{0}, rejected_{0}, unsent_{0}, unwritten_{0}, foreign_{0};
  std::atomic<std::uint32_t> reference_id_{0};

  Announcer announcer_;
  Writer<Reference> references_;
  Writer<DecisionMessage> decisions_;
  Writer<Envelope> envelopes_;
  Writer<Operation> operations_;
};

// Units number … number + count − 1 of the settings; one journal for all.
class Gateways {
 public:
  Gateways(const Settings& settings, std::optional<Journal>& journal, Bus& bus)
      : served_(settings.unit.number, settings.unit.count) {
    for (std::uint32_t n = 0; n < settings.unit.count; ++n) {
      Settings known = numbered(settings, n);
      const GatewayMemory memory =
          journal ? recall(settings.gateway.journal, known.unit.number) : GatewayMemory{};
      if (memory.grid) {
        known.gateway.grid_resistance = memory.grid->R_g;
        known.gateway.grid_reactance = memory.grid->X_g;
        known.gateway.grid_voltage = memory.grid->V;
      }
      units_.push_back(std::make_unique<GatewayUnit>(known, memory, journal, bus));
    }
    health_.emplace(bus, served_, [this](const Health& h, Arrival a) { unit(a).hear(h); });
    measurements_.emplace(bus, served_,
                          [this](const Measurement& m, Arrival a) { unit(a).watch(m, a, *measurements_); });
    requests_.emplace(bus, served_, [this](const Request& r, Arrival a) { unit(a).decide(r); });
  }
  void say() {
    for (std::uint32_t n = 0; n < served_.count; ++n)
      units_[n]->say(requests_->malformed(served_.first + n) + measurements_->malformed(served_.first + n));
  }
  std::string status() const {
    std::vector<const Health*> said;
    for (const auto& unit : units_) said.push_back(&unit->said());
    return one_line(said);
  }

 private:
  GatewayUnit& unit(const Arrival& from) { return *units_[from.unit - served_.first]; }

  const Units served_;
  std::vector<std::unique_ptr<GatewayUnit>> units_;
  std::optional<Reader<Health>> health_;
  std::optional<Reader<Measurement>> measurements_;
  std::optional<Reader<Request>> requests_;
};

}  // namespace
}  // namespace weakgrid

int main(int argc, char** argv) {
  using namespace weakgrid;
  return run_service(argc, argv, "weakgrid-gateway",
                     "Accepts setpoints inside the steady-state envelope and issues references to its units.",
                     {}, [](const Settings& settings, StopSignal& stop) {
                       std::optional<Journal> journal;
                       // A gateway that was killed a moment ago still holds it.
                       for (int patience = 50; !journal && !settings.gateway.journal.empty(); --patience)
                         try {
                           journal.emplace(settings.gateway.journal);
                         } catch (const SettingsError&) {
                           throw;
                         } catch (const std::runtime_error&) {
                           if (patience == 0 || stop.wait(std::chrono::milliseconds(100))) throw;
                         }
                       Bus bus(settings.unit.domain, settings.dds, Role::gateway);
                       Gateways gateways(settings, journal, bus);
                       ServiceManager manager({.status = [&] { return gateways.status(); },
                                               .stuck = {[&] { return bus.stuck(); }}});
                       while (!stop.wait(std::chrono::milliseconds(5))) {
                         gateways.say();  // waits for the thread that decides
                         manager.tell();
                       }
                     });
}
