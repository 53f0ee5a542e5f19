// What services say of their loops, for people and programs.
#pragma once

#include <fmt/format.h>

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "services/runtime/messages.hpp"

namespace weakgrid {

inline double us(std::uint64_t ns) { return static_cast<double>(ns) * 1e-3; }

inline nlohmann::json to_json(const std::vector<StageTiming>& timings) {
  nlohmann::json out = nlohmann::json::array();
  for (const StageTiming& t : timings)
    out.push_back({{"stage", t.stage},
                   {"count", t.count},
                   {"p50_us", us(t.p50_ns)},
                   {"p99_us", us(t.p99_ns)},
                   {"p999_us", us(t.p999_ns)},
                   {"max_us", us(t.max_ns)}});
  return out;
}

inline std::string stage_head() {
  return fmt::format("{:<24}{:>12}{:>10}{:>10}{:>10}{:>12}\n", "µs", "count", "p50", "p99", "p99.9", "max");
}

inline std::string stage_line(const std::string& name, const StageTiming& t) {
  return fmt::format("{:<23}{:>12}{:>10.1f}{:>10.1f}{:>10.1f}{:>12.1f}\n", name, t.count, us(t.p50_ns),
                     us(t.p99_ns), us(t.p999_ns), us(t.max_ns));
}

/// What a loop counts when it is late.
inline constexpr const char* lateness_counters[] = {"holds", "late_modulations", "overruns", "missed_steps",
                                                    "resends"};

}  // namespace weakgrid
