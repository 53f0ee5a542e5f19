// One emulated unit on a bus, in lockstep with its controller or on a grid of time; and all that one process
// serves.
#pragma once

#include <atomic>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

#include "services/modulation_digest.hpp"
#include "services/plant_dialogue.hpp"
#include "services/runtime/announcer.hpp"
#include "services/runtime/pulse.hpp"
#include "services/runtime/semaphore.hpp"
#include "services/runtime/stage_timings.hpp"
#include "services/runtime/time_grid.hpp"

namespace weakgrid {

class PlantUnit {
 public:
  PlantUnit(const Settings& settings, std::uint64_t until, Bus& bus);

  // On threads of the bus.
  void take(const Modulation& modulation, const Arrival& from, const Reader<Modulation>& reader);
  void take(const Reference& reference) { keep(reference); }
  void take(const Operation& operation) { keep(operation); }

  /// The loop has its own thread from here on. `answers` says whether anybody answers this unit.
  void start(const Reader<Modulation>& answers);
  /// And ends it.
  void stop();
  void say(std::uint64_t malformed);
  const Health& said() const { return announcer_.said(); }
  /// Its loop has not gone round since this was asked last; it does within 1 s.
  bool stands() { return pulse_.stands(); }

 private:
  static constexpr std::chrono::milliseconds resend_after{20};
  static constexpr std::chrono::milliseconds repeat_after{
      500};  // while it waits; well within OneWriter::silence_max
  // Steps made up at once; before the next ones it hears operations and writes a sample.
  static constexpr std::uint64_t catch_up_max = 1000;
  static constexpr std::uint64_t yield_every = 1024;  // steps

  template <class Message>
  void keep(const Message& message) {
    dialogue_.keep(message);
    wake_.post();
  }

  // On the loop thread.
  void run();
  void send(const Measurement& measurement);
  std::optional<Modulation> exchange_in_time(const Measurement& measurement);
  std::optional<Modulation> exchange(const Measurement& measurement);
  void make_up_for_missed();
  void hear();
  void pause();
  void publish() noexcept;
  const Emulator& emulator() const noexcept { return dialogue_.emulator(); }

  Health health(std::uint64_t malformed);

  const std::uint32_t unit_;
  const std::string who_;  // in the log
  const Pace pace_;
  const Overrun overrun_;
  const std::int64_t period_ns_;
  const std::chrono::nanoseconds patience_;
  PlantDialogue dialogue_;
  ModulationDigest digest_;
  bool controller_is_lost_ = false;
  std::optional<Measurement> last_;
  std::optional<TimeGrid> grid_;  // in real time, from the first answer on and not in a pause
  Trip logged_trip_ = Trip::none;

  Semaphore wake_;
  Pulse pulse_{Pulse::at_work};
  std::atomic<bool> stopping_{false};
  std::atomic<ServiceState> state_{ServiceState::starting};
  std::atomic<UnitState> unit_state_{UnitState::running};
  std::atomic<Trip> trip_{Trip::none};
  std::atomic<std::uint64_t> step_{0}, trip_step_{0}, holds_{0}, resends_{0}, lease_ends_{0};
  std::atomic<std::uint64_t> overruns_{0}, missed_steps_{0}, refused_modulations_{0};
  std::atomic<std::int64_t> sent_ns_{0};  // when the sample was first written
  std::mutex digest_mutex_;
  std::string digest_text_;
  enum { wake, emulate, write, answer, round_trip, stage_count };
  std::array<Stage, stage_count> stages_{Stage{"wake"}, Stage{"emulate"}, Stage{"write"}, Stage{"answer"},
                                         Stage{"round_trip"}};

  Announcer announcer_;
  Writer<Measurement> measurements_;
  const Reader<Modulation>* answers_ = nullptr;
  std::thread loop_;
};

/// Units number … number + count − 1 of the settings.
class Plants {
 public:
  /// until: the step at which each waits for an operation.
  Plants(const Settings& settings, std::uint64_t until, Bus& bus);
  /// Stops what runs.
  ~Plants();
  void start();
  void say();
  /// For the service manager, on the thread that says.
  std::string status() const;
  std::string stuck();

 private:
  PlantUnit& unit(const Arrival& from) { return *units_[from.unit - served_.first]; }

  const Units served_;
  std::vector<std::unique_ptr<PlantUnit>> units_;
  std::optional<Reader<Modulation>> modulations_;
  std::optional<Reader<Reference>> references_;
  std::optional<Reader<Operation>> operations_;
};

}  // namespace weakgrid
