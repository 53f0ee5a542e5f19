// Surroundings: each quantity is a ramp; an event or an order starts the next one from where it stands.
#include "plant/scenario.hpp"

#include <algorithm>

namespace weakgrid {

namespace {
Ramp standing(double value) { return {value, value, 0.0, 0, 0}; }
}  // namespace

Surroundings::Surroundings(const Grid& grid, std::span<const Event> events) noexcept
    : count_(std::min(events.size(), max_events)), grid_(grid) {
  std::copy_n(events.begin(), count_, events_.begin());
  ramp(Quantity::source_power) = standing(0.0);
  ramp(Quantity::grid_resistance) = standing(grid.R_g);
  ramp(Quantity::grid_inductance) = standing(grid.L_g);
  ramp(Quantity::grid_voltage) = standing(grid.V);
}

void Surroundings::advance_to(std::uint64_t step) noexcept {
  for (; next_ < count_ && events_[next_].step <= step; ++next_) {
    const Event& event = events_[next_];
    ramp(event.quantity) = ramp(event.quantity).towards(event.target, step, event.ramp_steps);
  }
  source_power_ = ramp(Quantity::source_power).at(step).value;
  grid_.R_g = ramp(Quantity::grid_resistance).at(step).value;
  grid_.L_g = ramp(Quantity::grid_inductance).at(step).value;
  grid_.V = ramp(Quantity::grid_voltage).at(step).value;
}

void Surroundings::dispatch(double p, std::uint64_t step, std::uint32_t ramp_steps) noexcept {
  ramp(Quantity::source_power) = ramp(Quantity::source_power).towards(p, step, ramp_steps);
  source_power_ = ramp(Quantity::source_power).at(step).value;
}

void Surroundings::open_source() noexcept {
  ramp(Quantity::source_power) = standing(0.0);
  source_power_ = 0.0;
}

}  // namespace weakgrid
