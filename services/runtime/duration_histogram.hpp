// Durations counted in fixed memory, however many there are.
#pragma once

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace weakgrid {

/// Each to 0.4 %, the longest exactly. add() does not allocate.
class DurationHistogram {
 public:
  /// What is below 0 (two clocks) is counted apart.
  void add(std::int64_t ns) {
    if (ns < 0) {
      ++negative_;
      return;
    }
    const auto value = static_cast<std::uint64_t>(ns);
    ++counts_[index_of(value)];
    ++count_;
    max_ = std::max(max_, value);
    min_ = std::min(min_, value);
  }

  std::uint64_t count() const { return count_; }
  std::uint64_t negative() const { return negative_; }
  std::uint64_t max_ns() const { return max_; }
  std::uint64_t min_ns() const { return min_; }

  /// The least duration that a share of all, 0 … 1, do not exceed.
  std::uint64_t quantile_ns(double share) const {
    const auto wanted = static_cast<std::uint64_t>(std::ceil(share * static_cast<double>(count_)));
    std::uint64_t sum = 0;
    for (std::size_t n = 0; n < counts_.size(); ++n) {
      sum += counts_[n];
      if (sum >= wanted && sum > 0) return std::min(first_of(n + 1) - 1, max_);
    }
    return max_;
  }

  /// Calls with the middle of each range that is not empty, in ns, and its count.
  template <class Take>
  void each(Take take) const {
    for (std::size_t n = 0; n < counts_.size(); ++n)
      if (counts_[n] > 0)
        take(0.5 * (static_cast<double>(first_of(n)) + static_cast<double>(first_of(n + 1) - 1)), counts_[n]);
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

  std::vector<std::uint64_t> counts_ = std::vector<std::uint64_t>(index_of(~std::uint64_t{0} >> 1) + 1);
  std::uint64_t count_ = 0, negative_ = 0, max_ = 0, min_ = ~std::uint64_t{0};
};

}  // namespace weakgrid
