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
    timings.push_back(
        {stage.name, d.count(), d.quantile_ns(0.5), d.quantile_ns(0.99), d.quantile_ns(0.999), d.max_ns()});
  }
  return timings;
}

}  // namespace weakgrid
