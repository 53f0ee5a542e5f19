// What a sweep runs: a base scenario and, for each run, what some of its keys are told instead. Pure: run n
// of a plan is the same whenever and wherever it is asked for.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "services/runtime/settings_override.hpp"

namespace weakgrid {

/// What one key goes through.
struct Axis {
  std::string text;                 ///< as told: "grid.reactance=0:0.4:0.05"
  std::string key;                  ///< as in Override, or "setpoint.…": see below
  std::vector<std::string> values;  ///< words without quotes; none: any number from … to
  double from = 0.0, to = 0.0;
};

/// KEY=a,b,c (numbers, words, or lists in []), KEY=from:to:step (`to` included if a step ends there) or
/// KEY=from:to, which only draws can use. Throws SettingsError.
Axis parse_axis(const std::string& text);

/// N draws instead of the product.
struct Draws {
  std::uint64_t count = 0;
  std::uint64_t seed = 0;
};

class SweepPlan {
 public:
  static constexpr std::uint64_t runs_max = 1'000'000;

  /// The full product, in which the last axis moves fastest; or draws, each axis by itself and all values
  /// alike. `base` must have a scenario. The key "setpoint.active_power" (reactive_power, dc_voltage) is that
  /// of the scenario's last setpoint that has it; if none has, the last setpoint gets it. Throws
  /// SettingsError if a key, a value or a pair of them is not allowed in any run.
  SweepPlan(const Settings& base, std::vector<Axis> axes, std::optional<Draws> draws);

  std::uint64_t runs() const { return runs_; }
  const std::vector<Axis>& axes() const { return axes_; }
  /// One for each axis, as in Axis::values; n < runs().
  std::vector<std::string> values(std::uint64_t n) const;
  Settings settings(std::uint64_t n) const;
  /// Lines that two plans share only if all their runs are the same.
  std::vector<std::string> identity() const;

 private:
  std::string in_force_;  // all settings of the base
  SettingsBase base_;
  std::vector<Axis> axes_;
  std::vector<std::string> keys_;  // of the file, one for each axis
  std::optional<Draws> draws_;
  std::uint64_t runs_ = 1;
};

}  // namespace weakgrid
