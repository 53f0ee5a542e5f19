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
  double v_c = 1.8384776310850235;  ///< DC voltage at the start, 1.3·√2
};

struct EmulatorCounters {
  std::uint64_t holds = 0;       ///< periods without a modulation
  std::uint64_t refused = 0;     ///< modulations not finite or beyond 1/√2: held instead
  std::uint64_t lease_ends = 0;  ///< times that a fallback began since a lease was over
};

/// Pure, heap-free, noexcept: the same inputs give the same bits.
class Emulator {
 public:
  Emulator(const EmulatorConfiguration& configuration, std::span<const Event> events) noexcept;

  /// Sample k, just before μ is updated.
  Measurement sample() const noexcept;

  /// Ends step k: mu answers sample k and takes effect `delay` steps later; none = hold, counted.
  void advance(std::optional<SpaceVector> mu) noexcept;

  /// A new order: the source ramps to p from effective_step on (at once if that has passed), and to the
  /// fallback from lease_end_step on. The last one counts. Refused (false) as ReferenceTrack::accept says.
  bool accept(const Reference& reference) noexcept;

  /// After a trip: idle again, source at 0 until the next reference. Nothing happens without a trip.
  void reset_trip() noexcept;

  std::uint64_t step() const noexcept { return step_; }
  Trip trip() const noexcept { return trip_; }
  std::uint64_t trip_step() const noexcept { return trip_step_; }
  const EmulatorCounters& counters() const noexcept { return counters_; }
  std::uint32_t newest_reference_id() const noexcept { return track_.newest_id; }
  const Grid& grid() const noexcept { return surroundings_.grid(); }

 private:
  void enter_step() noexcept;
  void follow_references() noexcept;

  EmulatorConfiguration configuration_;
  Plant plant_;
  Surroundings surroundings_;
  std::uint64_t step_ = 0;
  SpaceVector mu_next_;  // in force from the next step on, with delay 1
  ReferenceTrack track_;
  std::uint32_t consecutive_holds_ = 0;
  Trip trip_ = Trip::none;
  std::uint64_t trip_step_ = 0;
  EmulatorCounters counters_;
};

}  // namespace weakgrid
