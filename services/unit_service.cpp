// weakgrid-unit: plant and controller in one process, for where neither is to be replaced: what they tell
// each other never leaves it, but whoever listens on the bus hears it all the same.
#include <limits>

#include "services/controller_unit.hpp"
#include "services/plant_unit.hpp"
#include "services/runtime/program.hpp"
#include "services/runtime/realtime.hpp"
#include "services/runtime/service_manager.hpp"

int main(int argc, char** argv) {
  using namespace weakgrid;
  std::optional<std::uint64_t> until;
  return run_service(
      argc, argv, "weakgrid-unit",
      "weakgrid-plant and weakgrid-controller in one process: the fastest lockstep.",
      {{"--until", "wait at this step for an operation; default: go on for ever", &until}},
      [&](const Settings& settings, StopSignal& stop) {
        RealtimeSetup realtime(settings);
        Bus bus(settings.unit.domain, settings.dds, Role::unit);
        Controllers controllers(settings, bus);
        Plants plants(settings, until.value_or(std::numeric_limits<std::uint64_t>::max()), bus);
        plants.start();
        realtime.loop_runs();
        ServiceManager manager({.status = [&] { return plants.status(); },
                                .stuck = {[&] { return plants.stuck(); }, [&] { return bus.stuck(); }}});
        while (!stop.wait(std::chrono::milliseconds(5))) {
          plants.say();
          controllers.say();
          manager.tell();
        }
      });
}
