// PlantUnit: see the header.
#include "services/plant_unit.hpp"

#include <fmt/format.h>
#include <pthread.h>
#include <spdlog/spdlog.h>

#include <algorithm>

#include "services/runtime/realtime.hpp"

namespace weakgrid {

PlantUnit::PlantUnit(const Settings& settings, std::uint64_t until, Bus& bus)
    : unit_(settings.unit.number),
      who_(name_in_log(settings)),
      pace_(settings.plant.pace),
      overrun_(settings.plant.overrun),
      period_ns_(timing(settings).period_ns),
      patience_(static_cast<std::int64_t>(settings.plant.patience_s * 1e9)),
      dialogue_(emulator_configuration(settings), events(settings), until),
      announcer_(bus, settings, "plant", {}),
      measurements_(bus, unit_) {
  publish();
}

void PlantUnit::take(const Modulation& modulation, const Arrival& from, const Reader<Modulation>& reader) {
  if (!dialogue_.admit(from.writer, modulation.epoch, reader, std::chrono::steady_clock::now())) return;
  stages_[answer].durations.add(wall_time_ns() - from.sent_ns);
  // In real time the loop does not wait for it.
  if (pace_ == Pace::realtime && modulation.step == step_)
    stages_[round_trip].durations.add(monotonic_ns() - sent_ns_);
  keep(modulation);
}

void PlantUnit::start(const Reader<Modulation>& answers) {
  answers_ = &answers;
  loop_ = std::thread([this] { run(); });
}

void PlantUnit::stop() {
  stopping_ = true;
  wake_.post();
  if (!loop_.joinable()) return;
  loop_.join();
  spdlog::info("{}stopped at step {}", who_, emulator().step());
}

void PlantUnit::say(std::uint64_t malformed) { announcer_.say(health(malformed), stages_); }

void PlantUnit::run() {
  pthread_setname_np(pthread_self(), fmt::format("loop {}", unit_).c_str());
  if (pace_ == Pace::realtime) sharpen_timers();
  while (!stopping_) {
    pulse_.beat();
    hear();
    if (dialogue_.waits()) {
      pause();
      continue;
    }
    if (pace_ == Pace::realtime && state_ == ServiceState::running && !grid_)
      grid_ = TimeGrid{emulator().step(), monotonic_ns(), period_ns_};
    // In lockstep within one process it never sleeps: first in line it would starve the threads of the bus.
    if (emulator().step() % yield_every == 0) std::this_thread::yield();
    last_ = emulator().sample();
    const std::optional<Modulation> modulation = grid_ ? exchange_in_time(*last_) : exchange(*last_);
    if (stopping_) break;
    const std::int64_t begun_ns = monotonic_ns();
    if (modulation && pace_ == Pace::lockstep) stages_[round_trip].durations.add(begun_ns - sent_ns_);
    if (modulation) digest_.add(unit_, *modulation);
    dialogue_.advance(modulation);
    stages_[emulate].durations.add(monotonic_ns() - begun_ns);
    if (grid_) make_up_for_missed();
    publish();
  }
}

// Not sent is as good as lost: sent again in lockstep, a hold in real time.
void PlantUnit::send(const Measurement& measurement) {
  const std::int64_t begun_ns = monotonic_ns();
  (void)measurements_.write(measurement);
  stages_[write].durations.add(monotonic_ns() - begun_ns);
}

// Sends the sample once, at its time, and sleeps until the next one's: an answer acts if it is there by then,
// and to be woken by it would take a timer, a wake-up and a switch more at every step.
std::optional<Modulation> PlantUnit::exchange_in_time(const Measurement& measurement) {
  sent_ns_ = monotonic_ns();
  send(measurement);
  const std::int64_t due_ns = grid_->time_of(measurement.step + 1);
  sleep_until(due_ns);
  stages_[wake].durations.add(monotonic_ns() - due_ns);
  wake_.drain();
  return dialogue_.answer_to(measurement);
}

// Steps whose time is over when theirs begins are held at once, so that the ones after them come in time. The
// first of them is still written: it tells a recording whether the answer before it was used. The others are
// not, nobody can answer them in time.
void PlantUnit::make_up_for_missed() {
  const std::uint64_t missed = grid_->missed(emulator().step(), monotonic_ns());
  if (missed == 0 || dialogue_.waits()) return;
  overruns_.fetch_add(1, std::memory_order_relaxed);
  if (overrun_ == Overrun::block) dialogue_.trip(Trip::overrun);
  send(emulator().sample());
  const std::uint64_t n = std::min({missed, catch_up_max, dialogue_.until() - emulator().step()});
  for (std::uint64_t k = 0; k < n; ++k) dialogue_.advance(std::nullopt);
  missed_steps_.fetch_add(n, std::memory_order_relaxed);
}

// Sends the sample until its answer is there: best effort loses a packet now and then, lockstep must not.
// None: patience is over. Until the first answer there is no hurry.
std::optional<Modulation> PlantUnit::exchange(const Measurement& measurement) {
  const bool patient = state_ == ServiceState::starting;
  const auto patience = controller_is_lost_ ? resend_after : patience_;
  sent_ns_ = monotonic_ns();
  for (std::chrono::nanoseconds waited{0}; patient || waited < patience; waited += resend_after) {
    if (waited.count() > 0 && !patient) resends_.fetch_add(1, std::memory_order_relaxed);
    pulse_.beat();
    // Before the first answer the time that a peer takes to come is none of the loop's.
    if (patient) sent_ns_ = monotonic_ns();
    if (measurements_.matched() > 0 && answers_->matched() > 0) send(measurement);
    const timespec resend_at = monotonic_after(resend_after);
    while (wake_.wait_until(resend_at)) {
      if (stopping_) return std::nullopt;
      if (const auto modulation = dialogue_.answer_to(measurement)) {
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
void PlantUnit::hear() {
  dialogue_.hear([this](const Operation& operation) {
    spdlog::warn("{}client {:x}: {} is refused at step {}, {}", who_, operation.client, name(operation.kind),
                 emulator().step(), name(emulator().state()));
  });
  publish();
}

void PlantUnit::pause() {
  {
    const std::lock_guard lock(digest_mutex_);
    if (digest_text_.empty()) digest_text_ = digest_.hex();
  }
  const ServiceState before = state_;
  state_ = ServiceState::waiting;
  grid_.reset();
  while (!stopping_ && dialogue_.waits()) {
    pulse_.beat();
    // Who is silent for long gives way to another plant: the last word again, now and then.
    if (!wake_.wait_until(monotonic_after(repeat_after)) && last_) send(*last_);
    hear();
  }
  state_ = before;
  const std::lock_guard lock(digest_mutex_);
  digest_text_.clear();
}

// For the health thread.
void PlantUnit::publish() noexcept {
  step_.store(emulator().step(), std::memory_order_relaxed);
  unit_state_.store(emulator().state(), std::memory_order_relaxed);
  trip_.store(emulator().trip(), std::memory_order_relaxed);
  trip_step_.store(emulator().trip_step(), std::memory_order_relaxed);
  lease_ends_.store(emulator().counters().lease_ends, std::memory_order_relaxed);
  holds_.store(emulator().counters().holds, std::memory_order_relaxed);
  refused_modulations_.store(emulator().counters().refused, std::memory_order_relaxed);
}

Health PlantUnit::health(std::uint64_t malformed) {
  Health health;
  health.state = state_;
  health.step = step_;
  health.reference_id = dialogue_.newest_heard();
  const Trip trip = trip_;
  const UnitState unit_state = unit_state_;
  if (trip != Trip::none) {
    if (health.state == ServiceState::running) health.state = ServiceState::blocked_by_trip;
    health.text = fmt::format("tripped: {} at step {}", name(trip), trip_step_.load());
    if (trip != logged_trip_) spdlog::error("{}{}", who_, health.text);
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
                     {"late_modulations", dialogue_.late_modulations()},
                     {"overruns", overruns_},
                     {"missed_steps", missed_steps_},
                     {"saturated", dialogue_.saturated_answers()},
                     {"refused_modulations", refused_modulations_},
                     {"refused_references", dialogue_.refused_references()},
                     {"refused_operations", dialogue_.refused_operations()},
                     {"foreign_modulations", dialogue_.foreign()},
                     {"controller_changes", dialogue_.controller_changes()},
                     {"malformed", malformed},
                     {"overflow", dialogue_.overflow()},
                     {"lease_ends", lease_ends_},
                     {"unit_state", static_cast<std::uint64_t>(unit_state)},
                     {"tripped", trip == Trip::none ? 0u : 1u},
                     {"trip_step", trip_step_}};
  return health;
}

Plants::Plants(const Settings& settings, std::uint64_t until, Bus& bus)
    : served_(settings.unit.number, settings.unit.count) {
  for (std::uint32_t n = 0; n < settings.unit.count; ++n)
    units_.push_back(std::make_unique<PlantUnit>(numbered(settings, n), until, bus));
  modulations_.emplace(bus, served_,
                       [this](const Modulation& m, Arrival a) { unit(a).take(m, a, *modulations_); });
  references_.emplace(bus, served_, [this](const Reference& r, Arrival a) { unit(a).take(r); });
  operations_.emplace(bus, served_, [this](const Operation& o, Arrival a) { unit(a).take(o); });
}

Plants::~Plants() {
  for (const auto& unit : units_) unit->stop();
  say();
}

void Plants::start() {
  for (const auto& unit : units_) unit->start(*modulations_);
}

void Plants::say() {
  for (std::uint32_t n = 0; n < served_.count; ++n) {
    const std::uint32_t number = served_.first + n;
    units_[n]->say(modulations_->malformed(number) + references_->malformed(number) +
                   operations_->malformed(number));
  }
}

std::string Plants::status() const {
  std::vector<const Health*> said;
  for (const auto& unit : units_) said.push_back(&unit->said());
  return one_line(said);
}

std::string Plants::stuck() {
  std::string words;
  for (std::uint32_t n = 0; n < served_.count; ++n)
    if (units_[n]->stands()) words = fmt::format("the loop of unit {}", served_.first + n);  // each is asked
  return words;
}

}  // namespace weakgrid
