// weakgrid-gateway: requests in, decisions and references out.
#include <spdlog/spdlog.h>

#include <atomic>
#include <mutex>

#include "gateway/arbiter.hpp"
#include "services/decision_text.hpp"
#include "services/runtime/announcer.hpp"
#include "services/runtime/program.hpp"

namespace weakgrid {
namespace {

class GatewayService {
 public:
  explicit GatewayService(const Settings& settings)
      : timing_(timing(settings)),
        arbiter_(arbiter_configuration(settings)),
        bus_(settings.unit.domain, settings.dds.interfaces, "weakgrid-gateway"),
        announcer_(bus_, settings, "gateway", {}),
        references_(bus_, settings.unit.number),
        decisions_(bus_, settings.unit.number),
        health_reader_(bus_, settings.unit.number, [this](const Health& h, WriterId) { hear(h); }),
        measurement_reader_(bus_, settings.unit.number,
                            [this](const Measurement& m, WriterId w) { watch(m, w); }),
        request_reader_(bus_, settings.unit.number, [this](const Request& r, WriterId) { decide(r); }) {}

  void serve(StopSignal& stop) {
    while (!stop.wait(std::chrono::milliseconds(5))) announcer_.say(health());
    spdlog::info("stopped after {} accepted and {} rejected requests", accepted_.load(), rejected_.load());
  }

 private:
  void decide(const Request& request) {
    const std::lock_guard lock(mutex_);
    if (!has_looked_around()) return;  // clients repeat
    const Decision decision = arbiter_.decide(request, step_);
    if (!decision.repeated) {
      if (decision.reference) issue(*decision.reference);
      (decision.verdict == Verdict::accepted ? accepted_ : rejected_).fetch_add(1);
      spdlog::info("client {:x} request {}: {}", request.client, request.id, describe(decision, timing_));
    }
    if (!decisions_.write({decision, describe(decision, timing_)})) unsent_.fetch_add(1);
  }

  // With mutex_ held.
  void issue(const Reference& reference) {
    if (!references_.write(reference)) unsent_.fetch_add(1);
    reference_id_ = reference.id;
  }

  // Follows the unit: its step, its trips, and whether it is still the same one.
  void watch(const Measurement& measurement, WriterId writer) {
    const auto verdict = one_plant_.admit(writer, measurement_reader_);
    if (verdict == OneWriter::Verdict::refused) {
      foreign_.fetch_add(1, std::memory_order_relaxed);
      return;
    }
    // The step a decision names and what is known of it change together.
    const std::lock_guard lock(mutex_);
    step_.store(measurement.step, std::memory_order_relaxed);
    if (verdict != OneWriter::Verdict::changed && measurement.blocked == was_blocked_) return;
    was_blocked_ = measurement.blocked;
    if (measurement.blocked || verdict == OneWriter::Verdict::changed) {
      issue(arbiter_.block());
      spdlog::warn("the unit has {} at step {}: no setpoint stands any more",
                   measurement.blocked ? "tripped" : "restarted", measurement.step);
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

  // Before it knows which reference plant and controller hold, a restarted gateway would issue one that they
  // refuse as old. Where nobody is, nobody is heard. With mutex_ held.
  bool has_looked_around() const {
    return (heard_plant_ && heard_controller_) ||
           std::chrono::steady_clock::now() - started_ > std::chrono::seconds(3);
  }

  Health health() {
    Health health;
    {
      const std::lock_guard lock(mutex_);
      health.state = has_looked_around() ? ServiceState::running : ServiceState::starting;
    }
    if (health.state == ServiceState::starting) health.text = "looks around for plant and controller";
    health.step = step_;
    health.reference_id = reference_id_;
    health.counters = {{"accepted", accepted_},
                       {"rejected", rejected_},
                       {"unsent", unsent_},
                       {"foreign_measurements", foreign_},
                       {"malformed", request_reader_.malformed() + measurement_reader_.malformed()}};
    return health;
  }

  const Timing timing_;
  std::mutex mutex_;
  Arbiter arbiter_;
  OneWriter one_plant_;
  bool was_blocked_ = false;
  bool heard_plant_ = false, heard_controller_ = false;
  const std::chrono::steady_clock::time_point started_ = std::chrono::steady_clock::now();
  std::atomic<std::uint64_t> step_{0}, accepted_{0}, rejected_{0}, unsent_{0}, foreign_{0};
  std::atomic<std::uint32_t> reference_id_{0};

  Bus bus_;
  Announcer announcer_;
  Writer<Reference> references_;
  Writer<DecisionMessage> decisions_;
  Reader<Health> health_reader_;
  Reader<Measurement> measurement_reader_;
  Reader<Request> request_reader_;
};

}  // namespace
}  // namespace weakgrid

int main(int argc, char** argv) {
  using namespace weakgrid;
  return run_service(
      argc, argv, "weakgrid-gateway",
      "Accepts setpoints inside the steady-state envelope and issues references to one unit.", {},
      [](const Settings& settings, StopSignal& stop) { GatewayService(settings).serve(stop); });
}
