// Patterns on the command line that pick topics by name.
#pragma once

#include <fnmatch.h>

#include <algorithm>
#include <string>
#include <vector>

namespace weakgrid {

/// Patterns as of fnmatch(3), where a * also spans a slash.
inline bool matches_any(const std::string& topic, const std::vector<std::string>& patterns) {
  return std::any_of(patterns.begin(), patterns.end(), [&](const std::string& pattern) {
    return fnmatch(pattern.c_str(), topic.c_str(), 0) == 0;
  });
}

}  // namespace weakgrid
