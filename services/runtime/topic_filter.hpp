// Which topics somebody asks for, by patterns as of fnmatch(3).
#pragma once

#include <fnmatch.h>

#include <algorithm>
#include <string>
#include <vector>

namespace weakgrid {

struct TopicFilter {
  std::vector<std::string> topics;    ///< empty = all
  std::vector<std::string> excluded;  ///< wins over topics

  bool wants(const std::string& topic) const {
    const auto matches = [&](const std::string& pattern) {
      return fnmatch(pattern.c_str(), topic.c_str(), 0) == 0;
    };
    return (topics.empty() || std::any_of(topics.begin(), topics.end(), matches)) &&
           std::none_of(excluded.begin(), excluded.end(), matches);
  }
};

}  // namespace weakgrid
