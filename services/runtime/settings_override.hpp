// Settings of which single keys are told otherwise than in their file.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "services/runtime/settings.hpp"

namespace weakgrid {

/// "grid.reactance", "controller.settling_times_s[2]" (counted from 0), "scenario.event[0].value"; the value
/// as TOML writes it.
struct Override {
  std::string key, value;
};

class SettingsBase {
 public:
  explicit SettingsBase(const Settings& settings);
  /// Read as strictly as a file; `name` stands for it in errors. Throws SettingsError. From any thread.
  Settings with(const std::vector<Override>& overrides, const std::string& name) const;

 private:
  struct Table;
  std::shared_ptr<const Table> table_;
};

}  // namespace weakgrid
