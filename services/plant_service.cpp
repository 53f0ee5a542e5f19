// weakgrid-plant: emulated units on the bus, in lockstep with their controllers or on a grid of time.
#include <spdlog/spdlog.h>

#include <limits>

#include "services/plant_unit.hpp"
#include "services/runtime/program.hpp"
#include "services/runtime/realtime.hpp"
#include "services/runtime/service_manager.hpp"

int main(int argc, char** argv) {
  using namespace weakgrid;
  std::optional<std::uint64_t> until;
  return run_service(
      argc, argv, "weakgrid-plant",
      "Emulates converter, DC link, source and grid of one unit or several, in lockstep with "
      "their controllers "
      "or in real time.",
      {{"--until", "wait at this step for an operation; default: go on for ever", &until}},
      [&](const Settings& settings, StopSignal& stop) {
        RealtimeSetup realtime(settings);  // bus and loops inherit it
        Bus bus(settings.unit.domain, settings.dds, Role::plant);
        Plants plants(settings, until.value_or(std::numeric_limits<std::uint64_t>::max()), bus);
        plants.start();
        realtime.loop_runs();
        ServiceManager manager({.status = [&] { return plants.status(); },
                                .stuck = {[&] { return plants.stuck(); }, [&] { return bus.stuck(); }}});
        // An answer within 5 ms of a change is what whoever waits for an acknowledgement sees.
        while (!stop.wait(std::chrono::milliseconds(5))) {
          plants.say();
          manager.tell();
        }
      });
}
