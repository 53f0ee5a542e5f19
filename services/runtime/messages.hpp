// What services tell each other besides the pure rooms' values: decisions in words, operations, health,
// manifest.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "gateway/arbiter.hpp"

namespace weakgrid {

/// A decision with the line for a person.
struct DecisionMessage {
  Decision decision;
  std::string text;  // at most 255 bytes
};

/// Per unit: X_g, not L_g.
struct KnownGrid {
  Interval R_g, X_g, V;
  friend constexpr bool operator==(const KnownGrid&, const KnownGrid&) = default;
};

/// What the gateway knows of the grid, what stands on it, and who may change that.
struct Envelope {
  std::uint64_t step = 0;
  std::uint32_t reference_id = 0;
  KnownGrid grid;
  Setpoint setpoint;
  std::uint64_t lease_end_step = 0;
  bool fallen_back = false;
  bool fallback_holds = true;
  Holder holder;
  std::uint64_t held_until_step = 0;
  Margins margins;
};

enum class OperationKind : std::uint8_t { advance, reset_trip, start, stop };

constexpr const char* name(OperationKind kind) noexcept {
  constexpr const char* names[] = {"advance", "reset", "start", "stop"};
  return names[static_cast<std::size_t>(kind)];
}

struct Operation {
  std::uint64_t client = 0;
  std::uint32_t id = 0;
  OperationKind kind = OperationKind::advance;
  std::uint64_t until_step = 0;
};

enum class ServiceState : std::uint8_t { starting, running, waiting, blocked_by_trip, stopped };

constexpr const char* name(ServiceState state) noexcept {
  constexpr const char* names[] = {"starting", "running", "waiting", "blocked by trip", "stopped"};
  return names[static_cast<std::size_t>(state)];
}

struct Counter {
  std::string name;  // at most 31 bytes
  std::uint64_t value = 0;
  friend bool operator==(const Counter&, const Counter&) = default;
};

/// What durations are compared with: 1, 2, 5, 10, … µs, the last 1 s.
inline constexpr std::array<std::uint64_t, 19> timing_bounds_ns = [] {
  std::array<std::uint64_t, 19> bounds{};
  std::uint64_t decade = 1000;
  for (std::size_t n = 0; n < bounds.size(); ++n) {
    constexpr std::uint64_t parts[] = {1, 2, 5};
    bounds[n] = parts[n % 3] * decade;
    if (n % 3 == 2) decade *= 10;
  }
  return bounds;
}();

/// How long one stage of a loop's step took, since the service started; all but count and max to 0.4 %.
struct StageTiming {
  std::string stage;  // at most 15 bytes
  std::uint64_t count = 0;
  std::uint64_t p50_ns = 0, p99_ns = 0, p999_ns = 0, max_ns = 0, sum_ns = 0;
  std::array<std::uint64_t, timing_bounds_ns.size()> at_most{};  // of timing_bounds_ns
};

struct Health {
  std::string service;  // at most 15 bytes
  std::uint64_t instance = 0;
  ServiceState state = ServiceState::starting;
  std::uint64_t step = 0;
  std::uint32_t reference_id = 0;
  std::int64_t wall_time_ns = 0;
  std::vector<Counter> counters;  // at most 32
  std::string digest;
  std::string text;                  // at most 255 bytes
  std::vector<StageTiming> timings;  // at most 8
};

struct Constant {
  std::string name;  // at most 31 bytes
  double value = 0.0;
};

struct Manifest {
  std::string service;
  std::uint64_t instance = 0;
  std::string build;
  std::string settings;             // at most 8191 bytes
  std::vector<Constant> constants;  // at most 64
  std::string digest;               // digest_of the rest
};

}  // namespace weakgrid
