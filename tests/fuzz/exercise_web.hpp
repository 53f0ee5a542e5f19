// What strangers send to the console's door, with the claims that hold whatever it is: as exercise.hpp.
#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace weakgrid::fuzz {

/// As one connection to a real server, which goes on serving.
void exercise_http(std::string_view bytes);
/// Lines, each a message of one Foxglove client.
void exercise_foxglove(std::string_view text);

std::vector<std::string> http_seeds();
std::vector<std::string> foxglove_seeds();

}  // namespace weakgrid::fuzz
