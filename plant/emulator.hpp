// The emulated unit as its controller meets it: sample, modulation in, one period on. Plant, source, grid
// events, delay, hold and trips in one value.
#pragma once

#include <optional>
#include <span>

#include "plant/plant.hpp"
#include "plant/protection.hpp"
#include "plant/scenario.hpp"

namespace weakgrid {

struct EmulatorConfiguration {
  Converter converter;
  Timing timing;
  Grid grid;
  Protection protection;
  unsigned substeps = 10;           ///< RK4 steps per period, 1 … 1000
  double v_c = 1.8384776310850235;  ///< nominal DC voltage, 1.3·√2
  bool starts_running = true;       ///< idle, at the nominal DC voltage; else off
  std::uint32_t precharge_steps =
      1000;  ///< that the DC link takes to be charged and to be discharged, at least 1
};

struct EmulatorCounters {
  std::uint64_t holds = 0;       ///< periods without a modulation
  std::uint64_t refused = 0;     ///< modulations not finite or beyond 1/√2: held instead
  std::uint64_t lease_ends = 0;  ///< times that a fallback began since a lease was over
};

/// off ─start→ precharge → ready → running ⇄ holding; a limit violated, or trip() → tripped ─reset_trip→
/// running; ─stop→ off from everywhere. In ready it waits for `usable_answers` modulations in a row. Pure,
/// heap-free, noexcept: the same inputs give the same bits.
class Emulator {
 public:
  Emulator(const EmulatorConfiguration& configuration, std::span<const Event> events) noexcept;

  static constexpr std::uint32_t usable_answers = 2;
  /// Of the nominal DC voltage, what a discharged link stands at: 0 is no voltage that the model knows.
  static constexpr double discharged = 0.1;

  /// Sample k, just before μ is updated.
  Measurement sample() const noexcept;

  /// Ends step k: mu answers sample k and takes effect `delay` steps later; none = hold, counted.
  void advance(std::optional<SpaceVector> mu) noexcept;

  /// A new order: the source ramps to p from effective_step on (at once if that has passed), and to the
  /// fallback from lease_end_step on. The last one counts. Refused (false) as ReferenceTrack::accept says.
  bool accept(const Reference& reference) noexcept;

  /// Opens bridge and source for a cause that lies outside of the unit. False: they are open, nothing
  /// happens.
  bool trip(Trip cause) noexcept;

  /// After a trip: idle again, source at 0 until the next reference. False: there is none, nothing happens.
  bool reset_trip() noexcept;

  /// Charges the DC link and closes as soon as a controller answers. False: not off, nothing happens.
  bool start() noexcept;

  /// Opens bridge and source at once, whatever flows, cancels what is ordered, and discharges the DC link. A
  /// trip is over with it. False: off already.
  bool stop() noexcept;

  UnitState state() const noexcept;

  std::uint64_t step() const noexcept { return step_; }
  Trip trip() const noexcept { return trip_; }
  std::uint64_t trip_step() const noexcept { return trip_step_; }
  const EmulatorCounters& counters() const noexcept { return counters_; }
  std::uint32_t newest_reference_id() const noexcept { return track_.newest_id; }
  const Grid& grid() const noexcept { return surroundings_.grid(); }

 private:
  void enter_step() noexcept;
  void follow_references() noexcept;
  void close() noexcept;
  void run_period(std::optional<SpaceVector> mu) noexcept;
  void wait_period(bool is_answered) noexcept;
  Trip violated() noexcept;
  void open(Trip cause, std::uint64_t step) noexcept;

  EmulatorConfiguration configuration_;
  Plant plant_;
  Surroundings surroundings_;
  std::uint64_t step_ = 0;
  SpaceVector mu_next_;  // in force from the next step on, with delay 1
  ReferenceTrack track_;
  UnitState state_ = UnitState::running;  // or what else there is but holding
  Ramp v_c_;                              // off, precharge, ready
  std::uint32_t consecutive_holds_ = 0;
  std::uint32_t consecutive_answers_ = 0;  // while ready
  std::uint32_t outside_v_p_ = 0;          // samples in a row
  Trip trip_ = Trip::none;
  std::uint64_t trip_step_ = 0;
  EmulatorCounters counters_;
};

}  // namespace weakgrid
