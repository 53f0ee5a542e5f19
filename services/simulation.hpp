// A scenario in one process without DDS: the pure rooms passed the same values in the same order as over the
// bus.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "gateway/arbiter.hpp"
#include "services/runtime/settings.hpp"

namespace weakgrid {

struct SimulationResult {
  std::vector<Decision> decisions;  ///< one for each setpoint of the scenario
  std::string digest;               ///< ModulationDigest over the run
  Trip trip = Trip::none;
  std::uint64_t trip_step = 0;
};

/// settings must have a scenario. `watch` is called with each step's measurement and modulation.
SimulationResult simulate(const Settings& settings,
                          const std::function<void(const Measurement&, const Modulation&)>& watch);

}  // namespace weakgrid
