// Simulation: see the header.
#include "services/simulation.hpp"

#include "services/modulation_digest.hpp"

namespace weakgrid {

SimulationResult simulate(const Settings& settings,
                          const std::function<void(const Measurement&, const Modulation&)>& watch) {
  const std::vector<Event> timeline = events(settings);
  Emulator emulator(emulator_configuration(settings), timeline);
  Controller controller(controller_configuration(settings));
  Arbiter arbiter(arbiter_configuration(settings));
  ModulationDigest digest;
  SimulationResult result;
  const auto& setpoints = settings.scenario->setpoints;
  auto next = setpoints.begin();
  const auto issue = [&](const Reference& reference) {
    emulator.accept(reference);
    controller.accept(reference);
  };
  const std::uint64_t end = step_at(settings, settings.scenario->end_s);
  bool blocked = false;
  for (std::uint64_t k = 0; k < end; ++k) {
    for (; next != setpoints.end() && step_at(settings, next->at_s) <= k; ++next) {
      const auto id = static_cast<std::uint32_t>(result.decisions.size() + 1);
      const Decision decision = arbiter.decide(request(settings, *next, 1, id), k == 0 ? 0 : k - 1);
      if (decision.reference) issue(*decision.reference);
      result.decisions.push_back(decision);
    }
    const Measurement measurement = emulator.sample();
    if (measurement.blocked && !blocked) issue(arbiter.block());
    blocked = measurement.blocked;
    arbiter.note_unit(measurement.state);
    const Modulation modulation = controller.step(measurement);
    digest.add(settings.unit.number, modulation);
    if (watch) watch(measurement, modulation);
    emulator.advance(command(modulation));
  }
  result.digest = digest.hex();
  result.trip = emulator.trip();
  result.trip_step = emulator.trip_step();
  return result;
}

}  // namespace weakgrid
