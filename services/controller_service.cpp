// weakgrid-controller: the flatness law on the bus.
#include "services/controller_unit.hpp"
#include "services/runtime/program.hpp"
#include "services/runtime/realtime.hpp"
#include "services/runtime/service_manager.hpp"

int main(int argc, char** argv) {
  using namespace weakgrid;
  return run_service(argc, argv, "weakgrid-controller",
                     "Answers each sample of its units' plants with a modulation: the filtered flatness law.",
                     {}, [](const Settings& settings, StopSignal& stop) {
                       RealtimeSetup realtime(settings);  // the bus inherits it
                       Bus bus(settings.unit.domain, settings.dds, Role::controller);
                       Controllers controllers(settings, bus);
                       realtime.loop_runs();
                       ServiceManager manager({.status = [&] { return controllers.status(); },
                                               .stuck = {[&] { return bus.stuck(); }}});
                       while (!stop.wait(std::chrono::milliseconds(5))) {
                         controllers.say();
                         manager.tell();
                       }
                     });
}
