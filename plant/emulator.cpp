// Emulator: see the header.
#include "plant/emulator.hpp"

namespace weakgrid {

Emulator::Emulator(const EmulatorConfiguration& configuration, std::span<const Event> events) noexcept
    : configuration_(configuration),
      plant_(configuration.converter, configuration.timing, configuration.substeps, configuration.grid,
             configuration.v_c),
      surroundings_(configuration.grid, events),
      mu_next_(plant_.mu_turned()) {
  enter_step();
}

Measurement Emulator::sample() const noexcept {
  const bool mean = configuration_.timing.sampling == Sampling::period_mean;
  return {.step = step_,
          .timing = configuration_.timing,
          .reference_id = track_.id(),
          .blocked = trip_ != Trip::none,
          .fallback = track_.fallen_back,
          .v_p = mean ? plant_.v_p_mean() : plant_.v_p(),
          .i = mean ? plant_.i_mean() : plant_.i(),
          .v_c = plant_.v_c(),
          .p_i = surroundings_.source_power()};
}

void Emulator::enter_step() noexcept {
  surroundings_.advance_to(step_);
  if (trip_ != Trip::none) surroundings_.open_source();
  follow_references();
}

// An order that comes while the source is open waits for the reset.
void Emulator::follow_references() noexcept {
  if (trip_ != Trip::none) return;
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
  const bool delayed = configuration_.timing.delay == 1;
  if (mu) {
    consecutive_holds_ = 0;
  } else if (trip_ == Trip::none) {
    ++counters_.holds;
    ++consecutive_holds_;
  }
  if (trip_ == Trip::none) {
    const SpaceVector continued = plant_.mu_turned();
    const SpaceVector in_force = delayed ? mu_next_ : mu.value_or(continued);
    plant_.advance(in_force, surroundings_.source_power(), surroundings_.grid());
    mu_next_ = delayed ? mu.value_or(plant_.mu_turned()) : plant_.mu_turned();
    trip_ = check(configuration_.protection, plant_.i(), plant_.v_c());
    if (trip_ == Trip::none && consecutive_holds_ > configuration_.protection.max_holds)
      trip_ = Trip::modulation_lost;
    if (trip_ != Trip::none) {
      trip_step_ = step_ + 1;
      track_.cancel();
      plant_.restart(configuration_.v_c, surroundings_.grid());
    }
  } else {
    plant_.advance_blocked(surroundings_.grid());
  }
  ++step_;
  enter_step();
}

bool Emulator::accept(const Reference& reference) noexcept {
  if (!track_.accept(reference)) return false;
  follow_references();
  return true;
}

void Emulator::reset_trip() noexcept {
  if (trip_ == Trip::none) return;
  trip_ = Trip::none;
  consecutive_holds_ = 0;
  plant_.restart(configuration_.v_c, surroundings_.grid());
  mu_next_ = plant_.mu_turned();
  follow_references();
}

}  // namespace weakgrid
