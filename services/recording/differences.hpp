// Where a recording and its re-execution part: each difference by unit, step and field, and what could not be
// compared.
#pragma once

#include <algorithm>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "services/runtime/wire_fields.hpp"

namespace weakgrid {

struct Difference {
  std::uint32_t unit = 0;
  std::uint64_t step = 0;
  std::string
      what;  ///< "modulation", "decision", "reference", "state", "sample", "request", "manifest", "message"
  std::string which;  ///< of several at that step: a client and id, a service
  std::string field;
  WireField::Value recorded, computed;
};

/// Of two lists of the same fields.
inline bool is_same(const WireFields& a, const WireFields& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(),
                    [](const WireField& x, const WireField& y) { return is_same(x.value, y.value); });
}

/// Counts all, keeps the first of each kind in the order of their steps.
class DifferenceLog {
 public:
  static constexpr std::size_t kept_max = 20;

  void add(Difference difference) {
    ++count_;
    const auto same_kind = std::count_if(kept_.begin(), kept_.end(),
                                         [&](const Difference& d) { return d.what == difference.what; });
    if (static_cast<std::size_t>(same_kind) >= kept_max) return;
    const auto after =
        std::upper_bound(kept_.begin(), kept_.end(), difference,
                         [](const Difference& a, const Difference& b) { return a.step < b.step; });
    kept_.insert(after, std::move(difference));
  }
  /// Of two lists of the same fields the first that differs.
  void add_first(Difference difference, const WireFields& recorded, const WireFields& computed) {
    for (std::size_t n = 0; n < recorded.size() && n < computed.size(); ++n) {
      if (is_same(recorded[n].value, computed[n].value)) continue;
      difference.field = recorded[n].name;
      difference.recorded = recorded[n].value;
      difference.computed = computed[n].value;
      return add(std::move(difference));
    }
  }
  std::uint64_t count() const { return count_; }
  const std::vector<Difference>& kept() const { return kept_; }

 private:
  std::vector<Difference> kept_;
  std::uint64_t count_ = 0;
};

/// Steps that could not be compared, and why.
struct Unchecked {
  std::uint64_t first_step = 0, last_step = 0, count = 0;
  std::string why;
};

inline void add_unchecked(std::vector<Unchecked>& list, std::uint64_t step, const std::string& why) {
  constexpr std::size_t listed_max = 1000;
  if (!list.empty() && (list.back().why == why || list.size() >= listed_max)) {
    list.back().last_step = step;
    ++list.back().count;
  } else {
    list.push_back({step, step, 1, why});
  }
}

}  // namespace weakgrid
