// A sign of life that costs a thread one addition: no system call, no lock, fit for the loop.
#pragma once

#include <atomic>
#include <cstdint>
#include <utility>

namespace weakgrid {

/// Odd while there is work under way, and another number whenever that has moved.
class Pulse {
 public:
  /// For a thread that always has work: it goes round and beats each time.
  static constexpr std::uint64_t at_work = 1;
  explicit Pulse(std::uint64_t count = 0) : count_(count) {}

  void beat() noexcept { count_.fetch_add(2, std::memory_order_relaxed); }
  /// For work that comes and goes.
  void begin() noexcept { count_.fetch_add(1, std::memory_order_relaxed); }
  void end() noexcept { count_.fetch_add(1, std::memory_order_relaxed); }

  /// On one other thread: work is under way, and no further than when this was asked last.
  bool stands() noexcept {
    const std::uint64_t now = count_.load(std::memory_order_relaxed);
    return std::exchange(seen_, now) == now && now % 2 == 1;
  }

 private:
  std::atomic<std::uint64_t> count_;
  std::uint64_t seen_ = 0;
};

/// As long as it lives, work is under way.
class Working {
 public:
  explicit Working(Pulse& pulse) noexcept : pulse_(pulse) { pulse_.begin(); }
  ~Working() { pulse_.end(); }
  Working(const Working&) = delete;
  Working& operator=(const Working&) = delete;

 private:
  Pulse& pulse_;
};

}  // namespace weakgrid
