// Simulated time: what is due happens in the order of its time, and at one time in the order in which it was
// planned. And the dice that every choice of a run comes from.
#pragma once

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <functional>
#include <random>
#include <vector>

namespace weakgrid::deterministic {

using Time = std::chrono::steady_clock::time_point;
using std::chrono::nanoseconds;
using namespace std::chrono_literals;

class Scheduler {
 public:
  Time now() const { return now_; }

  void at(Time when, std::function<void()> what) {
    due_.push_back({std::max(when, now_), ++planned_, std::move(what)});
    std::push_heap(due_.begin(), due_.end(), is_later);
  }
  void after(nanoseconds delay, std::function<void()> what) { at(now_ + delay, std::move(what)); }

  /// False: nothing is due any more.
  bool run_next() {
    if (due_.empty()) return false;
    std::pop_heap(due_.begin(), due_.end(), is_later);
    const Due next = std::move(due_.back());
    due_.pop_back();
    now_ = next.when;
    next.what();
    return true;
  }

 private:
  struct Due {
    Time when;
    std::uint64_t number;
    std::function<void()> what;
  };
  static bool is_later(const Due& a, const Due& b) {
    return a.when != b.when ? a.when > b.when : a.number > b.number;
  }

  // Not at the beginning of time: a time of 0 means "never yet" to whoever counts silence.
  Time now_{std::chrono::hours(1)};
  std::uint64_t planned_ = 0;
  std::vector<Due> due_;
};

class Dice {
 public:
  explicit Dice(std::uint64_t seed) : bits_(seed * 0x9e3779b97f4a7c15u + 1) {}

  /// low … high.
  double uniform(double low, double high) {
    return low + (high - low) * static_cast<double>(bits_() >> 11) * 0x1p-53;
  }
  bool chance(double probability) { return uniform(0.0, 1.0) < probability; }
  bool one_in(std::uint64_t n) { return bits_() % n == 0; }
  /// 0 … n − 1.
  std::size_t below(std::size_t n) { return static_cast<std::size_t>(bits_() % n); }
  nanoseconds time(nanoseconds low, nanoseconds high) {
    return low + nanoseconds(static_cast<std::int64_t>(uniform(0.0, 1.0) *
                                                       static_cast<double>((high - low).count())));
  }
  template <class T, std::size_t n>
  const T& of(const T (&choices)[n]) {
    return choices[below(n)];
  }

 private:
  std::mt19937_64 bits_;
};

}  // namespace weakgrid::deterministic
