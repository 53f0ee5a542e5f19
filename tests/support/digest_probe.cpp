// Prints the modulation digest of the paper's weak grid run, from defaults alone: built with several
// compilers and optimisation levels, it must print the same.
#include <cstdio>

#include "services/simulation.hpp"

int main() {
  using namespace weakgrid;
  Settings settings;
  settings.grid.reactance = 0.3;
  settings.controller.settling_times_s = {0.001, 0.0011, 0.020};
  settings.scenario.emplace();
  settings.scenario->end_s = 0.4;
  settings.scenario->setpoints = {{.at_s = 0.01, .active_power = 0.707},
                                  {.at_s = 0.11, .reactive_power = 0.707}};
  std::printf("%s\n", simulate(settings, {}).digest.c_str());
}
