// Timed setpoints as a table: comma-separated, the first line names the columns.
#pragma once

#include <string>
#include <vector>

#include "services/runtime/settings.hpp"

namespace weakgrid {

/// In the order of at_s, which rises, at least one. `name` stands for the file in errors. Throws
/// SettingsError: file, line, column and what is allowed.
std::vector<TimedSetpoint> parse_table(const std::string& text, const std::string& name);

}  // namespace weakgrid
