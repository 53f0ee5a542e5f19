// A settings file as the table that toml++ has read, for who changes it before it becomes settings.
#pragma once

#include <toml++/toml.h>

#include <string>

#include "services/runtime/settings.hpp"

namespace weakgrid {

/// As parse_settings; an error names the line of what has one.
Settings settings_of(const toml::table& table, const std::string& name);

}  // namespace weakgrid
