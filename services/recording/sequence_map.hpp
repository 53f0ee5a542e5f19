// Which of a writer's samples have come: the statement "no gaps" in numbers.
#pragma once

#include <cstdint>
#include <utility>
#include <vector>

namespace weakgrid {

/// The number whose low 32 bits are these, nearest to `last`.
inline std::uint64_t unwrap(std::uint32_t low, std::uint64_t last) {
  const auto difference = static_cast<std::int32_t>(low - static_cast<std::uint32_t>(last));
  return last + static_cast<std::uint64_t>(static_cast<std::int64_t>(difference));
}

/// Fed with sequence numbers in the order of arrival; late ones fill the gap they had left.
class SequenceMap {
 public:
  static constexpr std::size_t gaps_listed_max = 64;

  /// False: it has been here before.
  bool see(std::uint64_t sequence) {
    if (count_ == 0) {
      first_ = last_ = sequence;
    } else if (sequence > last_) {
      if (sequence > last_ + 1) open_gap(last_ + 1, sequence - 1);
      last_ = sequence;
    } else if (!fill(sequence)) {
      ++repeated_;
      return false;
    }
    ++count_;
    return true;
  }

  std::uint64_t first() const { return first_; }
  std::uint64_t last() const { return last_; }
  std::uint64_t count() const { return count_; }        ///< different ones
  std::uint64_t missing() const { return missing_; }    ///< between first and last
  std::uint64_t repeated() const { return repeated_; }  ///< came again, or before first, or too late to tell
  /// First and last number of each, the earliest ones.
  const std::vector<std::pair<std::uint64_t, std::uint64_t>>& gaps() const { return gaps_; }

 private:
  void open_gap(std::uint64_t from, std::uint64_t to) {
    missing_ += to - from + 1;
    if (gaps_.size() < gaps_listed_max) gaps_.emplace_back(from, to);
  }

  bool fill(std::uint64_t sequence) {
    for (std::size_t n = 0; n < gaps_.size(); ++n) {
      auto& [from, to] = gaps_[n];
      if (sequence < from || sequence > to) continue;
      --missing_;
      const std::uint64_t after = to;
      to = sequence - 1;
      const bool is_empty = to + 1 == from;
      if (sequence < after) {
        if (is_empty)
          gaps_[n] = {sequence + 1, after};
        else if (gaps_.size() < gaps_listed_max)
          gaps_.insert(gaps_.begin() + static_cast<std::ptrdiff_t>(n) + 1, {sequence + 1, after});
      } else if (is_empty) {
        gaps_.erase(gaps_.begin() + static_cast<std::ptrdiff_t>(n));
      }
      return true;
    }
    return false;
  }

  std::uint64_t first_ = 0, last_ = 0, count_ = 0, missing_ = 0, repeated_ = 0;
  std::vector<std::pair<std::uint64_t, std::uint64_t>> gaps_;
};

}  // namespace weakgrid
