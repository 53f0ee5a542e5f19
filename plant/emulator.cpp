// Emulator: see the header.
#include "plant/emulator.hpp"

namespace weakgrid {

Emulator::Emulator(const EmulatorConfiguration& configuration, std::span<const Event> events) noexcept
    : configuration_(configuration),
      plant_(configuration.converter, configuration.timing, configuration.substeps, configuration.grid,
             configuration.v_c),
      surroundings_(configuration.grid, events),
      mu_next_(plant_.mu_turned()) {
  if (!configuration.starts_running) {
    const double v_c = discharged * configuration.v_c;
    state_ = UnitState::off;
    v_c_ = {v_c, v_c, 0.0, 0, 0};
    plant_.restart(v_c, surroundings_.grid());
  }
  enter_step();
}

UnitState Emulator::state() const noexcept {
  return state_ == UnitState::running && consecutive_holds_ > 0 ? UnitState::holding : state_;
}

Measurement Emulator::sample() const noexcept {
  const bool mean = configuration_.timing.sampling == Sampling::period_mean;
  return {.step = step_,
          .timing = configuration_.timing,
          .reference_id = track_.id(),
          .blocked = is_blocked(state_),
          .fallback = track_.fallen_back,
          .state = state(),
          .v_p = mean ? plant_.v_p_mean() : plant_.v_p(),
          .i = mean ? plant_.i_mean() : plant_.i(),
          .v_c = plant_.v_c(),
          .p_i = surroundings_.source_power()};
}

void Emulator::enter_step() noexcept {
  surroundings_.advance_to(step_);
  if (is_blocked(state_)) surroundings_.open_source();
  follow_references();
}

// An order that comes while the source is open waits until it closes.
void Emulator::follow_references() noexcept {
  if (is_blocked(state_)) return;
  while (const auto move = track_.advance_to(step_, false)) {
    surroundings_.dispatch(move->p, step_, move->ramp_steps);
    if (move->is_fallback) ++counters_.lease_ends;
  }
}

void Emulator::advance(std::optional<SpaceVector> mu) noexcept {
  constexpr double tolerance = 1.0 + 1e-9;  // |μ| is limited in floating point by the sender
  const double mu_max = configuration_.converter.mu_max * tolerance;
  if (mu && !(finite(*mu) && abs2(*mu) <= mu_max * mu_max)) {
    ++counters_.refused;
    mu.reset();
  }
  if (is_blocked(state_))
    wait_period(mu.has_value());
  else
    run_period(mu);
  ++step_;
  enter_step();
}

void Emulator::run_period(std::optional<SpaceVector> mu) noexcept {
  if (mu) {
    consecutive_holds_ = 0;
  } else {
    ++counters_.holds;
    ++consecutive_holds_;
  }
  const bool delayed = configuration_.timing.delay == 1;
  const SpaceVector continued = plant_.mu_turned();
  const SpaceVector in_force = delayed ? mu_next_ : mu.value_or(continued);
  plant_.advance(in_force, surroundings_.source_power(), surroundings_.grid());
  mu_next_ = delayed ? mu.value_or(plant_.mu_turned()) : plant_.mu_turned();
  if (const Trip cause = violated(); cause != Trip::none) open(cause, step_ + 1);
}

void Emulator::open(Trip cause, std::uint64_t step) noexcept {
  trip_ = cause;
  trip_step_ = step;
  state_ = UnitState::tripped;
  track_.cancel();
  plant_.restart(configuration_.v_c, surroundings_.grid());
}

Trip Emulator::violated() noexcept {
  const Protection& limits = configuration_.protection;
  const Trip at_once = check(limits, plant_.i(), plant_.v_c());
  if (at_once != Trip::none) return at_once;
  const Trip in_the_long_run = check_pcc_voltage(limits, plant_.v_p());
  outside_v_p_ = in_the_long_run == Trip::none ? 0 : outside_v_p_ + 1;
  if (outside_v_p_ >= limits.v_p_steps && outside_v_p_ > 0) return in_the_long_run;
  return consecutive_holds_ > limits.max_holds ? Trip::modulation_lost : Trip::none;
}

void Emulator::wait_period(bool is_answered) noexcept {
  plant_.advance_blocked(surroundings_.grid());
  if (state_ == UnitState::tripped) return;
  plant_.restart(v_c_.at(step_ + 1).value, surroundings_.grid());
  if (state_ == UnitState::precharge && step_ + 1 - v_c_.start >= v_c_.steps) {
    state_ = UnitState::ready;
    consecutive_answers_ = 0;
  } else if (state_ == UnitState::ready) {
    consecutive_answers_ = is_answered ? consecutive_answers_ + 1 : 0;
    if (consecutive_answers_ >= usable_answers) close();
  }
}

// Idle, in phase with the grid.
void Emulator::close() noexcept {
  trip_ = Trip::none;
  state_ = UnitState::running;
  consecutive_holds_ = 0;
  outside_v_p_ = 0;
  plant_.restart(configuration_.v_c, surroundings_.grid());
  mu_next_ = plant_.mu_turned();
}

bool Emulator::accept(const Reference& reference) noexcept {
  if (!track_.accept(reference)) return false;
  follow_references();
  return true;
}

bool Emulator::trip(Trip cause) noexcept {
  if (is_blocked(state_)) return false;
  open(cause, step_);
  surroundings_.open_source();
  return true;
}

bool Emulator::reset_trip() noexcept {
  if (state_ != UnitState::tripped) return false;
  close();
  follow_references();
  return true;
}

bool Emulator::start() noexcept {
  if (state_ != UnitState::off) return false;
  state_ = UnitState::precharge;
  v_c_ = {plant_.v_c(), configuration_.v_c, 0.0, step_, configuration_.precharge_steps};
  return true;
}

bool Emulator::stop() noexcept {
  if (state_ == UnitState::off) return false;
  trip_ = Trip::none;
  state_ = UnitState::off;
  track_.cancel();
  surroundings_.open_source();
  const double v_c = plant_.v_c();
  v_c_ = {v_c, discharged * configuration_.v_c, 0.0, step_, configuration_.precharge_steps};
  plant_.restart(v_c, surroundings_.grid());
  return true;
}

}  // namespace weakgrid
