// weakgrid-plant: the emulated unit on the bus, in lockstep with its controller or on a grid of time.
#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <atomic>
#include <limits>
#include <mutex>
#include <thread>

#include "plant/emulator.hpp"
#include "services/modulation_digest.hpp"
#include "services/runtime/announcer.hpp"
#include "services/runtime/mailbox.hpp"
#include "services/runtime/program.hpp"
#include "services/runtime/realtime.hpp"
#include "services/runtime/semaphore.hpp"
#include "services/runtime/time_grid.hpp"

namespace weakgrid {
namespace {

class PlantService {
 public:
  PlantService(const Settings& settings, std::uint64_t until)
      : unit_(settings.unit.number),
        pace_(settings.plant.pace),
        overrun_(settings.plant.overrun),
        period_ns_(timing(settings).period_ns),
        patience_(static_cast<std::int64_t>(settings.plant.patience_s * 1e9)),
        emulator_(emulator_configuration(settings), events(settings)),
        until_(until),
        realtime_(settings),
        bus_(settings.unit.domain, settings.dds.interfaces, "weakgrid-plant"),
        announcer_(bus_, settings, "plant", {}),
        measurements_(bus_, unit_),
        modulation_reader_(bus_, unit_, [this](const Modulation& m, WriterId w) { take(m, w); }),
        reference_reader_(bus_, unit_, [this](const Reference& r, WriterId) { keep(references_, r); }),
        operation_reader_(bus_, unit_, [this](const Operation& o, WriterId) { keep(operations_, o); }) {
    publish();
  }

  void serve(StopSignal& stop) {
    std::thread loop([this] { run(); });
    realtime_.loop_runs();
    // A controller's answer within 5 ms of a change is what whoever waits for an acknowledgement sees.
    while (!stop.wait(std::chrono::milliseconds(5))) announcer_.say(health());
    stopping_ = true;
    wake_.post();
    loop.join();
    announcer_.say(health());
    spdlog::info("stopped at step {}", emulator_.step());
  }

 private:
  static constexpr std::chrono::milliseconds resend_after{20};
  // Steps made up at once; before the next ones it hears operations and writes a sample.
  static constexpr std::uint64_t catch_up_max = 1000;

  // On threads of the bus.
  void take(const Modulation& modulation, WriterId writer) {
    if (one_controller_.admit(writer, modulation_reader_) == OneWriter::Verdict::refused) {
      foreign_.fetch_add(1, std::memory_order_relaxed);
      return;
    }
    keep(modulations_, modulation);
  }
  template <class Message, std::size_t n>
  void keep(Mailbox<Message, n>& box, const Message& message) {
    if (!box.put(message)) overflow_.fetch_add(1, std::memory_order_relaxed);
    wake_.post();
  }

  // On the loop thread.
  void run() {
    if (pace_ == Pace::realtime) sharpen_timers();
    while (!stopping_) {
      hear();
      if (emulator_.step() >= until_) {
        pause();
        continue;
      }
      if (pace_ == Pace::realtime && state_ == ServiceState::running && !grid_)
        grid_ = TimeGrid{emulator_.step(), monotonic_ns(), period_ns_};
      last_ = emulator_.sample();
      const std::optional<Modulation> modulation = grid_ ? exchange_in_time(*last_) : exchange(*last_);
      if (stopping_) break;
      if (modulation) digest_.add(unit_, *modulation);
      emulator_.advance(modulation ? command(*modulation) : std::nullopt);
      if (grid_) keep_time();
      publish();
    }
  }

  // The answer to this sample, of those that have come.
  std::optional<Modulation> answer_to(const Measurement& measurement) {
    while (const auto modulation = modulations_.take()) {
      if (modulation->step > measurement.step || modulation->step < unanswered_) continue;
      if (modulation->period_ns != static_cast<std::uint32_t>(measurement.timing.period_ns)) {
        foreign_.fetch_add(1, std::memory_order_relaxed);
        continue;
      }
      unanswered_ = modulation->step + 1;
      if (modulation->step < measurement.step) {
        late_modulations_.fetch_add(1, std::memory_order_relaxed);
        continue;
      }
      if ((modulation->status & saturated) != 0) saturated_.fetch_add(1, std::memory_order_relaxed);
      return modulation;
    }
    return std::nullopt;
  }

  // Sends the sample once, at its time. None: the next one's time has come.
  std::optional<Modulation> exchange_in_time(const Measurement& measurement) {
    (void)measurements_.write(measurement);  // not sent is as good as lost: a hold
    const timespec next = to_timespec(grid_->time_of(measurement.step + 1));
    do {
      if (const auto modulation = answer_to(measurement)) return modulation;
    } while (!stopping_ && wake_.wait_until(next));
    return std::nullopt;
  }

  // Waits for the time of the step that begins. Steps whose time is over by then are held at once, so that
  // the ones after them come in time. The first of them is still written: it tells a recording whether the
  // answer before it was used. The others are not, nobody can answer them in time.
  void keep_time() {
    sleep_until(grid_->time_of(emulator_.step()));
    const std::uint64_t missed = grid_->missed(emulator_.step(), monotonic_ns());
    if (missed == 0 || emulator_.step() >= until_) return;
    overruns_.fetch_add(1, std::memory_order_relaxed);
    if (overrun_ == Overrun::block) emulator_.trip(Trip::overrun);
    (void)measurements_.write(emulator_.sample());
    const std::uint64_t n = std::min({missed, catch_up_max, until_ - emulator_.step()});
    for (std::uint64_t k = 0; k < n; ++k) emulator_.advance(std::nullopt);
    missed_steps_.fetch_add(n, std::memory_order_relaxed);
  }

  // Sends the sample until its answer is there: best effort loses a packet now and then, lockstep must not.
  // None: patience is over. Until the first answer there is no hurry.
  std::optional<Modulation> exchange(const Measurement& measurement) {
    const bool patient = state_ == ServiceState::starting;
    const auto patience = controller_is_lost_ ? resend_after : patience_;
    for (std::chrono::nanoseconds waited{0}; patient || waited < patience; waited += resend_after) {
      if (waited.count() > 0 && !patient) resends_.fetch_add(1, std::memory_order_relaxed);
      if (measurements_.matched() > 0 && modulation_reader_.matched() > 0)
        (void)measurements_.write(measurement);  // not sent is as good as lost: sent again
      const timespec resend_at = monotonic_after(resend_after);
      while (wake_.wait_until(resend_at)) {
        if (stopping_) return std::nullopt;
        if (const auto modulation = answer_to(measurement)) {
          controller_is_lost_ = false;
          state_ = ServiceState::running;
          return modulation;
        }
      }
    }
    controller_is_lost_ = true;
    return std::nullopt;
  }

  // References and operations that have come.
  void hear() {
    while (const auto reference = references_.take())
      if (!emulator_.accept(*reference)) refused_references_.fetch_add(1, std::memory_order_relaxed);
    while (const auto operation = operations_.take()) {
      if (obey(*operation)) continue;
      refused_operations_.fetch_add(1, std::memory_order_relaxed);
      spdlog::warn("client {:x}: {} is refused at step {}, {}", operation->client, name(operation->kind),
                   emulator_.step(), name(emulator_.state()));
    }
    publish();
  }

  bool obey(const Operation& operation) {
    switch (operation.kind) {
      case OperationKind::advance:
        // Nobody who knows this unit asks it to wait in the past.
        if (operation.until_step < emulator_.step()) return false;
        until_ = operation.until_step;
        return true;
      case OperationKind::reset_trip:
        return emulator_.reset_trip();
      case OperationKind::start:
        return emulator_.start();
      case OperationKind::stop:
        return emulator_.stop();
    }
    return false;
  }

  void pause() {
    {
      const std::lock_guard lock(digest_mutex_);
      if (digest_text_.empty()) digest_text_ = digest_.hex();
    }
    const ServiceState before = state_;
    state_ = ServiceState::waiting;
    grid_.reset();
    while (!stopping_ && emulator_.step() >= until_) {
      // Who is silent for long gives way to another plant: the last word again, now and then.
      if (!wake_.wait_until(monotonic_after(std::chrono::seconds(1))) && last_)
        (void)measurements_.write(*last_);
      hear();
    }
    state_ = before;
    const std::lock_guard lock(digest_mutex_);
    digest_text_.clear();
  }

  // For the health thread.
  void publish() noexcept {
    step_.store(emulator_.step(), std::memory_order_relaxed);
    unit_state_.store(emulator_.state(), std::memory_order_relaxed);
    trip_.store(emulator_.trip(), std::memory_order_relaxed);
    trip_step_.store(emulator_.trip_step(), std::memory_order_relaxed);
    reference_id_.store(emulator_.newest_reference_id(), std::memory_order_relaxed);
    lease_ends_.store(emulator_.counters().lease_ends, std::memory_order_relaxed);
    holds_.store(emulator_.counters().holds, std::memory_order_relaxed);
    refused_modulations_.store(emulator_.counters().refused, std::memory_order_relaxed);
  }

  Health health() {
    Health health;
    health.state = state_;
    health.step = step_;
    health.reference_id = reference_id_;
    const Trip trip = trip_;
    const UnitState unit_state = unit_state_;
    if (trip != Trip::none) {
      if (health.state == ServiceState::running) health.state = ServiceState::blocked_by_trip;
      health.text = fmt::format("tripped: {} at step {}", name(trip), trip_step_.load());
      if (trip != logged_trip_) spdlog::error("{}", health.text);
    } else if (health.state == ServiceState::starting) {
      health.text = "waits for a controller";
    } else if (is_blocked(unit_state)) {
      health.text = name(unit_state);
    }
    logged_trip_ = trip;
    const std::lock_guard lock(digest_mutex_);
    health.digest = digest_text_;
    health.counters = {{"holds", holds_},
                       {"resends", resends_},
                       {"late_modulations", late_modulations_},
                       {"overruns", overruns_},
                       {"missed_steps", missed_steps_},
                       {"saturated", saturated_},
                       {"refused_modulations", refused_modulations_},
                       {"refused_references", refused_references_},
                       {"refused_operations", refused_operations_},
                       {"foreign_modulations", foreign_},
                       {"malformed", modulation_reader_.malformed() + reference_reader_.malformed() +
                                         operation_reader_.malformed()},
                       {"overflow", overflow_},
                       {"lease_ends", lease_ends_},
                       {"unit_state", static_cast<std::uint64_t>(unit_state)},
                       {"tripped", trip == Trip::none ? 0u : 1u},
                       {"trip_step", trip_step_}};
    return health;
  }

  const std::uint32_t unit_;
  const Pace pace_;
  const Overrun overrun_;
  const std::int64_t period_ns_;
  const std::chrono::nanoseconds patience_;
  Emulator emulator_;
  ModulationDigest digest_;
  std::uint64_t until_;
  bool controller_is_lost_ = false;
  std::optional<Measurement> last_;
  std::uint64_t unanswered_ = 0;  // the first step that no answer has come to, those before are repeats
  std::optional<TimeGrid> grid_;  // in real time, from the first answer on and not in a pause
  Trip logged_trip_ = Trip::none;

  Semaphore wake_;
  std::atomic<bool> stopping_{false};
  std::atomic<ServiceState> state_{ServiceState::starting};
  std::atomic<UnitState> unit_state_{UnitState::running};
  std::atomic<Trip> trip_{Trip::none};
  std::atomic<std::uint64_t> step_{0}, trip_step_{0}, holds_{0}, resends_{0}, saturated_{0}, lease_ends_{0};
  std::atomic<std::uint64_t> late_modulations_{0}, overruns_{0}, missed_steps_{0};
  std::atomic<std::uint64_t> refused_modulations_{0}, refused_references_{0}, refused_operations_{0},
      foreign_{0}, overflow_{0};
  std::atomic<std::uint32_t> reference_id_{0};
  std::mutex digest_mutex_;
  std::string digest_text_;
  OneWriter one_controller_;
  Mailbox<Modulation, 8> modulations_;
  Mailbox<Reference, 16> references_;
  Mailbox<Operation, 16> operations_;

  RealtimeSetup realtime_;  // bus and loop inherit it
  Bus bus_;
  Announcer announcer_;
  Writer<Measurement> measurements_;
  Reader<Modulation> modulation_reader_;
  Reader<Reference> reference_reader_;
  Reader<Operation> operation_reader_;
};

}  // namespace
}  // namespace weakgrid

int main(int argc, char** argv) {
  using namespace weakgrid;
  std::optional<std::uint64_t> until;
  return run_service(
      argc, argv, "weakgrid-plant",
      "Emulates converter, DC link, source and grid of one unit, in lockstep with its controller or in real "
      "time.",
      {{"--until", "wait at this step for an operation; default: go on for ever", &until}},
      [&](const Settings& settings, StopSignal& stop) {
        PlantService(settings, until.value_or(std::numeric_limits<std::uint64_t>::max())).serve(stop);
      });
}
