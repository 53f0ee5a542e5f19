// Timed events of grid and source, and the quantities that they move.
#pragma once

#include <array>
#include <cstddef>
#include <span>

#include "plant/model.hpp"

namespace weakgrid {

enum class Quantity : std::uint8_t { source_power, grid_resistance, grid_inductance, grid_voltage };

/// From `step` on, `quantity` moves to `target` within `ramp_steps` (0 = a step), by raised cosine.
/// source_power overrides the dispatched power until the next reference takes effect.
struct Event {
  std::uint64_t step = 0;
  Quantity quantity = Quantity::source_power;
  double target = 0.0;  ///< per unit; grid_inductance in seconds
  std::uint32_t ramp_steps = 0;
};

inline constexpr std::size_t max_events = 256;

/// Plays events in the order of their steps. Heap-free.
class Surroundings {
 public:
  /// events: sorted by step, at most max_events (the caller checks both).
  Surroundings(const Grid& grid, std::span<const Event> events) noexcept;

  /// Takes what is due at `step`, which never falls; the source as well as the grid.
  void advance_to(std::uint64_t step) noexcept;

  /// Orders the source to p: what it does until the next order or event.
  void dispatch(double p, std::uint64_t step, std::uint32_t ramp_steps) noexcept;
  /// Opens the source at once.
  void open_source() noexcept;

  const Grid& grid() const noexcept { return grid_; }
  double source_power() const noexcept { return source_power_; }
  bool is_last_event_done() const noexcept { return next_ == count_; }

 private:
  Ramp& ramp(Quantity quantity) noexcept { return ramps_[static_cast<std::size_t>(quantity)]; }

  std::array<Event, max_events> events_{};
  std::size_t count_ = 0;
  std::size_t next_ = 0;
  std::array<Ramp, 4> ramps_{};
  Grid grid_;
  double source_power_ = 0.0;
};

}  // namespace weakgrid
