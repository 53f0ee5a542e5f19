// What a run is like: unit, grid, pace, weather, drawn from its seed.
#pragma once

#include "tests/deterministic/processes.hpp"

namespace weakgrid::deterministic {

Settings draw_settings(Dice& dice);
/// Of a grid that does not stay as it is known, in order.
std::vector<Event> draw_events(Dice& dice, const Settings& settings, std::uint64_t steps);
Weather draw_weather(Dice& dice, const Settings& settings);
/// The settings as a run with this bug has them.
Settings broken_by(Bug bug, Settings settings);

}  // namespace weakgrid::deterministic
