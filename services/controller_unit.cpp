// ControllerUnit: see the header.
#include "services/controller_unit.hpp"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>

#include "services/manifest_constants.hpp"
#include "services/runtime/time_grid.hpp"

namespace weakgrid {

ControllerUnit::ControllerUnit(const Settings& settings, Bus& bus)
    : who_(name_in_log(settings)),
      is_redundant_(settings.controller.redundancy != Redundancy::none),
      dialogue_(controller_configuration(settings), settings.controller.redundancy,
                std::chrono::nanoseconds(static_cast<std::int64_t>(settings.controller.takeover_s * 1e9))),
      state_every_(std::max<std::uint64_t>(50'000'000 / std::uint64_t{settings.timing.period_us * 1000u}, 1)),
      announcer_(bus, settings, "controller", constants_of(dialogue_.controller().constants())),
      modulations_(bus, settings.unit.number),
      states_(bus, settings.unit.number) {}

void ControllerUnit::note_end() const { spdlog::info("{}stopped at step {}", who_, step_.load()); }

void ControllerUnit::say(std::uint64_t malformed) { announcer_.say(health(malformed), stages_); }

// The whole hot path of this process.
void ControllerUnit::answer(const Measurement& measurement, const Arrival& from,
                            const Reader<Measurement>& reader) {
  const std::int64_t begun_ns = monotonic_ns();
  const std::int64_t travelled_ns = wall_time_ns() - from.sent_ns;
  const auto now = std::chrono::steady_clock::now();
  if (!dialogue_.admit(from.writer, reader, now)) return;
  const bool led = dialogue_.leads();
  const std::optional<Modulation> modulation = dialogue_.answer(measurement, now);
  if (!modulation) {
    if (dialogue_.leads()) return;
    step_.store(measurement.step, std::memory_order_relaxed);
    running_.store(true, std::memory_order_relaxed);
    return;
  }
  const std::int64_t computed_ns = monotonic_ns();
  if (!modulations_.write(*modulation)) unsent_.fetch_add(1, std::memory_order_relaxed);
  stages_[write].durations.add(monotonic_ns() - computed_ns);
  stages_[compute].durations.add(computed_ns - begun_ns);
  stages_[sample].durations.add(travelled_ns);
  // Whoever follows, or verifies a recording, can go on from the first answer.
  const bool has_taken_over = is_redundant_ && !led;
  const bool is_repeat = measurement.step == step_.load(std::memory_order_relaxed) && running_;
  if (is_repeat && !has_taken_over) return;
  if ((measurement.step % state_every_ == 0 || has_taken_over) &&
      !states_.write(dialogue_.controller().state()))
    unsent_.fetch_add(1, std::memory_order_relaxed);
  step_.store(measurement.step, std::memory_order_relaxed);
  running_.store(true, std::memory_order_relaxed);
  count(*modulation);
}

void ControllerUnit::count(const Modulation& modulation) noexcept {
  const std::uint32_t status = modulation.status;
  const std::uint32_t fallen_back = (status & fallback) != 0 ? modulation.reference_id : 0;
  if (fallen_back != 0 && fallen_back != fallen_back_) lease_ends_.fetch_add(1, std::memory_order_relaxed);
  fallen_back_ = fallen_back;
  status_.store(status, std::memory_order_relaxed);
  if (status == 0) return;
  for (std::size_t bit = 0; bit < counts_.size(); ++bit)
    if ((status >> bit & 1u) != 0) counts_[bit].fetch_add(1, std::memory_order_relaxed);
}

Health ControllerUnit::health(std::uint64_t malformed) {
  Health health;
  const std::uint32_t status = status_;
  const bool running = running_;
  health.state = running ? ServiceState::running : ServiceState::starting;
  health.step = step_;
  health.reference_id = dialogue_.newest_heard();
  const bool leads = dialogue_.leads();
  // Who leads is the controller; the other must not be taken for it.
  if (!leads) health.service = "standby";
  if (!running)
    health.text = "waits for a plant";
  else if (!leads)
    health.text = dialogue_.is_in_step() ? "stands by, in step" : "stands by, not in step";
  else if ((status & wrong_timing) != 0)
    health.text = "the plant's period, delay, hold or sampling is not mine";
  else if ((status & bad_measurement) != 0)
    health.text = "bad measurement";
  if (health.text != logged_ && (status & (wrong_timing | bad_measurement)) != 0)
    spdlog::error("{}{}", who_, health.text);
  logged_ = health.text;
  constexpr const char* names[] = {"saturated",    "bad_measurement", "low_voltage", "gap",
                                   "wrong_timing", "started",         "fallback"};
  for (std::size_t bit = 0; bit < counts_.size(); ++bit)
    health.counters.push_back({names[bit], counts_[bit]});
  health.counters.push_back({"lease_ends", lease_ends_});
  health.counters.push_back({"stale", dialogue_.stale()});
  health.counters.push_back({"unsent", unsent_});
  health.counters.push_back({"refused_references", dialogue_.refused_references()});
  health.counters.push_back({"foreign_measurements", dialogue_.foreign()});
  health.counters.push_back({"overflow", dialogue_.overflow()});
  if (is_redundant_) {
    health.counters.push_back({"epoch", dialogue_.epoch()});
    health.counters.push_back({"takeovers", dialogue_.takeovers()});
  }
  health.counters.push_back({"malformed", malformed});
  return health;
}

Controllers::Controllers(const Settings& settings, Bus& bus)
    : served_(settings.unit.number, settings.unit.count) {
  for (std::uint32_t n = 0; n < settings.unit.count; ++n)
    units_.push_back(std::make_unique<ControllerUnit>(numbered(settings, n), bus));
  if (settings.controller.redundancy != Redundancy::none) {
    answers_.emplace(bus, served_, [this](const Modulation& m, Arrival a) { unit(a).hear(m, a); });
    states_.emplace(bus, served_, [this](const ControllerState& s, Arrival a) { unit(a).hear(s, a); });
  }
  references_.emplace(bus, served_, [this](const Reference& r, Arrival a) { unit(a).keep(r); });
  measurements_.emplace(bus, served_,
                        [this](const Measurement& m, Arrival a) { unit(a).answer(m, a, *measurements_); });
}

Controllers::~Controllers() {
  say();
  for (const auto& unit : units_) unit->note_end();
}

void Controllers::say() {
  for (std::uint32_t n = 0; n < served_.count; ++n)
    units_[n]->say(measurements_->malformed(served_.first + n) + references_->malformed(served_.first + n));
}

std::string Controllers::status() const {
  std::vector<const Health*> said;
  for (const auto& unit : units_) said.push_back(&unit->said());
  return one_line(said);
}

}  // namespace weakgrid
