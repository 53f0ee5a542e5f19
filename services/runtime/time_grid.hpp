// An absolute grid of time on CLOCK_MONOTONIC: each step has its time, and none of them drifts.
#pragma once

#include <cerrno>
#include <cstdint>
#include <ctime>

namespace weakgrid {

inline std::int64_t monotonic_ns() noexcept {
  timespec now{};
  clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec * 1'000'000'000 + now.tv_nsec;
}

/// A time on CLOCK_MONOTONIC as the system's calls take it.
constexpr timespec to_timespec(std::int64_t ns) noexcept {
  return {.tv_sec = ns / 1'000'000'000, .tv_nsec = ns % 1'000'000'000};
}

inline void sleep_until(std::int64_t ns) noexcept {
  const timespec time = to_timespec(ns);
  while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &time, nullptr) == EINTR) {
  }
}

/// Times in ns; steps from the first one on.
struct TimeGrid {
  std::uint64_t first_step = 0;
  std::int64_t first_ns = 0;
  std::int64_t period_ns = 1;

  constexpr std::int64_t time_of(std::uint64_t step) const noexcept {
    return first_ns + static_cast<std::int64_t>(step - first_step) * period_ns;
  }
  /// Steps whose time is over when `step` is entered at `now_ns`: 0 as long as it is its own turn.
  constexpr std::uint64_t missed(std::uint64_t step, std::int64_t now_ns) const noexcept {
    const std::int64_t late_ns = now_ns - time_of(step);
    return late_ns < period_ns ? 0 : static_cast<std::uint64_t>(late_ns / period_ns);
  }
};

}  // namespace weakgrid
