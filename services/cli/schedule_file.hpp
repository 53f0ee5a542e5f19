// Timed setpoints from a file: a settings file's [scenario], or a table.
#pragma once

#include <string>
#include <vector>

#include "services/runtime/settings.hpp"

namespace weakgrid {

/// In the order of at_s, at least one. A lease that the file does not give lasts until a second after the
/// next setpoint; the last one's until a second after the scenario's end, or is 0 in a table: the gateway's
/// default. Throws SettingsError: file, line, column and what is allowed.
std::vector<TimedSetpoint> load_schedule(const std::string& file);

}  // namespace weakgrid
