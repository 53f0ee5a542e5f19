// Durations counted in fixed memory, however many there are.
#pragma once

#include <algorithm>
#include <atomic>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace weakgrid {

/// Each to 0.4 %, the longest exactly. add() does not allocate; one thread may add while others read.
class DurationHistogram {
 public:
  /// What is below 0 (two clocks) is counted apart.
  void add(std::int64_t ns) {
    if (ns < 0) {
      negative_ = negative_ + 1;
      return;
    }
    const auto value = static_cast<std::uint64_t>(ns);
    Count& count = counts_[index_of(value)];
    count = count + 1;
    count_ = count_ + 1;
    if (value > max_) max_ = value;
    if (value < min_) min_ = value;
  }

  std::uint64_t count() const { return count_; }
  std::uint64_t negative() const { return negative_; }
  std::uint64_t max_ns() const { return max_; }
  std::uint64_t min_ns() const { return min_; }

  /// The least duration that a share of all, 0 … 1, do not exceed.
  std::uint64_t quantile_ns(double share) const {
    const auto wanted = static_cast<std::uint64_t>(std::ceil(share * static_cast<double>(count())));
    std::uint64_t sum = 0;
    for (std::size_t n = 0; n < counts_.size(); ++n) {
      sum += counts_[n];
      if (sum >= wanted && sum > 0) return std::min(first_of(n + 1) - 1, max_ns());
    }
    return max_ns();
  }

  /// Calls with the middle of each range that is not empty, in ns, and its count.
  template <class Take>
  void each(Take take) const {
    for (std::size_t n = 0; n < counts_.size(); ++n)
      if (const std::uint64_t count = counts_[n]; count > 0)
        take(0.5 * (static_cast<double>(first_of(n)) + static_cast<double>(first_of(n + 1) - 1)), count);
  }

 private:
  // Each octave in 256 equal parts; below 256 ns exactly.
  static constexpr int bits = 8;
  static constexpr std::size_t index_of(std::uint64_t value) {
    const int shift = std::max(0, static_cast<int>(std::bit_width(value)) - bits - 1);
    return (static_cast<std::size_t>(shift) << bits) + static_cast<std::size_t>(value >> shift);
  }
  static constexpr std::uint64_t first_of(std::size_t index) {
    if (index < std::size_t{2} << bits) return index;
    const std::size_t shift = (index >> bits) - 1;
    return static_cast<std::uint64_t>(index - (shift << bits)) << shift;
  }

  // Only one thread writes: no locked instruction is needed.
  class Count {
   public:
    Count(std::uint64_t value = 0) : value_(value) {}
    Count(const Count& other) : value_(other) {}
    Count& operator=(const Count& other) { return *this = std::uint64_t{other}; }
    Count& operator=(std::uint64_t value) {
      value_.store(value, std::memory_order_relaxed);
      return *this;
    }
    operator std::uint64_t() const { return value_.load(std::memory_order_relaxed); }

   private:
    std::atomic<std::uint64_t> value_;
  };

  std::vector<Count> counts_ = std::vector<Count>(index_of(~std::uint64_t{0} >> 1) + 1);
  Count count_, negative_, max_, min_{~std::uint64_t{0}};
};

}  // namespace weakgrid
