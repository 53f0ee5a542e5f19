// weakgrid-controller: the flatness law on the bus, one answer to each sample.
#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <atomic>

#include "controller/controller.hpp"
#include "services/manifest_constants.hpp"
#include "services/runtime/announcer.hpp"
#include "services/runtime/mailbox.hpp"
#include "services/runtime/program.hpp"
#include "services/runtime/realtime.hpp"

namespace weakgrid {
namespace {

class ControllerService {
 public:
  explicit ControllerService(const Settings& settings)
      : controller_(controller_configuration(settings)),
        state_every_(
            std::max<std::uint64_t>(50'000'000 / std::uint64_t{settings.timing.period_us * 1000u}, 1)),
        realtime_(settings),
        bus_(settings.unit.domain, settings.dds.interfaces, "weakgrid-controller"),
        announcer_(bus_, settings, "controller", constants_of(controller_.constants())),
        modulations_(bus_, settings.unit.number),
        states_(bus_, settings.unit.number),
        reference_reader_(bus_, settings.unit.number, [this](const Reference& r, WriterId) { keep(r); }),
        measurement_reader_(bus_, settings.unit.number,
                            [this](const Measurement& m, WriterId w) { answer(m, w); }) {}

  void serve(StopSignal& stop) {
    realtime_.loop_runs();
    while (!stop.wait(std::chrono::milliseconds(5))) announcer_.say(health());
    announcer_.say(health());
    spdlog::info("stopped at step {}", step_.load());
  }

 private:
  // On a thread of the bus: references come here and wait for the next sample.
  void keep(const Reference& reference) {
    if (!references_.put(reference))
      refused_references_.fetch_add(1, std::memory_order_relaxed);
    else
      newest_heard_.store(reference.id, std::memory_order_release);
  }

  // On the thread of the bus that brings the samples: the whole hot path of this process.
  void answer(const Measurement& measurement, WriterId writer) {
    switch (one_plant_.admit(writer, measurement_reader_)) {
      case OneWriter::Verdict::refused:
        foreign_.fetch_add(1, std::memory_order_relaxed);
        return;
      case OneWriter::Verdict::changed:
        controller_.reset();
        break;
      case OneWriter::Verdict::known:
        break;
    }
    while (const auto reference = references_.take())
      if (!controller_.accept(*reference)) refused_references_.fetch_add(1, std::memory_order_relaxed);
    const Modulation modulation = controller_.step(measurement);
    if (modulation.step != measurement.step) {
      stale_.fetch_add(1, std::memory_order_relaxed);
      return;
    }
    if (!modulations_.write(modulation)) unsent_.fetch_add(1, std::memory_order_relaxed);
    if (measurement.step == step_.load(std::memory_order_relaxed) && running_) return;  // asked again
    if (measurement.step % state_every_ == 0 && !states_.write(controller_.state()))
      unsent_.fetch_add(1, std::memory_order_relaxed);
    step_.store(measurement.step, std::memory_order_relaxed);
    running_.store(true, std::memory_order_relaxed);
    count(modulation);
  }

  void count(const Modulation& modulation) noexcept {
    const std::uint32_t status = modulation.status;
    const std::uint32_t fallen_back = (status & fallback) != 0 ? modulation.reference_id : 0;
    if (fallen_back != 0 && fallen_back != fallen_back_) lease_ends_.fetch_add(1, std::memory_order_relaxed);
    fallen_back_ = fallen_back;
    status_.store(status, std::memory_order_relaxed);
    if (status == 0) return;
    for (std::size_t bit = 0; bit < counts_.size(); ++bit)
      if ((status >> bit & 1u) != 0) counts_[bit].fetch_add(1, std::memory_order_relaxed);
  }

  Health health() {
    Health health;
    const std::uint32_t status = status_;
    const bool running = running_;
    health.state = running ? ServiceState::running : ServiceState::starting;
    health.step = step_;
    health.reference_id = newest_heard_.load(std::memory_order_acquire);
    if (!running)
      health.text = "waits for a plant";
    else if ((status & wrong_timing) != 0)
      health.text = "the plant's period, delay, hold or sampling is not mine";
    else if ((status & bad_measurement) != 0)
      health.text = "bad measurement";
    if (health.text != logged_ && (status & (wrong_timing | bad_measurement)) != 0)
      spdlog::error("{}", health.text);
    logged_ = health.text;
    constexpr const char* names[] = {"saturated",    "bad_measurement", "low_voltage", "gap",
                                     "wrong_timing", "started",         "fallback"};
    for (std::size_t bit = 0; bit < counts_.size(); ++bit)
      health.counters.push_back({names[bit], counts_[bit]});
    health.counters.push_back({"lease_ends", lease_ends_});
    health.counters.push_back({"stale", stale_});
    health.counters.push_back({"unsent", unsent_});
    health.counters.push_back({"refused_references", refused_references_});
    health.counters.push_back({"foreign_measurements", foreign_});
    health.counters.push_back({"malformed", measurement_reader_.malformed() + reference_reader_.malformed()});
    return health;
  }

  Controller controller_;
  const std::uint64_t state_every_;  // steps: 50 ms
  OneWriter one_plant_;
  Mailbox<Reference, 16> references_;
  std::atomic<bool> running_{false};
  std::atomic<std::uint32_t> status_{0}, newest_heard_{0};
  std::atomic<std::uint64_t> step_{0}, stale_{0}, unsent_{0}, foreign_{0}, refused_references_{0},
      lease_ends_{0};
  std::array<std::atomic<std::uint64_t>, 7> counts_{};
  std::uint32_t fallen_back_ = 0;  // the reference whose fallback was followed at the last sample, 0 = none
  std::string logged_;

  RealtimeSetup realtime_;  // the bus inherits it
  Bus bus_;
  Announcer announcer_;
  Writer<Modulation> modulations_;
  Writer<ControllerState> states_;
  Reader<Reference> reference_reader_;
  Reader<Measurement> measurement_reader_;
};

}  // namespace
}  // namespace weakgrid

int main(int argc, char** argv) {
  using namespace weakgrid;
  return run_service(
      argc, argv, "weakgrid-controller",
      "Answers each sample of its unit's plant with a modulation: the filtered flatness law.", {},
      [](const Settings& settings, StopSignal& stop) { ControllerService(settings).serve(stop); });
}
