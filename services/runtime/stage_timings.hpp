// How long the stages of a loop's step take: one thread counts, another tells.
#pragma once

#include <span>
#include <vector>

#include "services/runtime/duration_histogram.hpp"
#include "services/runtime/messages.hpp"

namespace weakgrid {

/// One stage: services/README.md tells from when to when each goes.
struct Stage {
  const char* name;  ///< at most 15 bytes
  DurationHistogram durations{};
};

/// Of stages that have happened at all.
inline std::vector<StageTiming> timings_of(std::span<const Stage> stages) {
  std::vector<StageTiming> timings;
  for (const Stage& stage : stages) {
    const DurationHistogram& d = stage.durations;
    if (d.count() == 0) continue;
    StageTiming& timing = timings.emplace_back();
    timing.stage = stage.name;
    timing.p50_ns = d.quantile_ns(0.5);
    timing.p99_ns = d.quantile_ns(0.99);
    timing.p999_ns = d.quantile_ns(0.999);
    timing.max_ns = d.max_ns();
    // One pass, so that these agree whatever is added meanwhile.
    double sum_ns = 0.0;
    d.each([&](double middle_ns, std::uint64_t count) {
      timing.count += count;
      sum_ns += middle_ns * static_cast<double>(count);
      for (std::size_t n = 0; n < timing_bounds_ns.size(); ++n)
        if (middle_ns <= static_cast<double>(timing_bounds_ns[n])) timing.at_most[n] += count;
    });
    timing.sum_ns = static_cast<std::uint64_t>(sum_ns);
  }
  return timings;
}

}  // namespace weakgrid
