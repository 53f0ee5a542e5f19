// weakgrid simulate: a scenario in one process, the same bits as over DDS.
#include <fmt/format.h>

#include <chrono>
#include <nlohmann/json.hpp>

#include "services/cli/commands.hpp"
#include "services/cli/report.hpp"
#include "services/runtime/program.hpp"
#include "services/simulation.hpp"

namespace weakgrid {

Outcome simulated(const Settings& settings) {
  RunRecord record(settings);
  const auto start = std::chrono::steady_clock::now();
  const SimulationResult result = simulate(settings, [&](const Measurement& m, const Modulation& mu) {
    record.see(m);
    record.see(mu);
  });
  Outcome outcome;
  outcome.wall_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  for (const Decision& decision : result.decisions) record.see(decision);
  outcome.decisions = result.decisions;
  outcome.summary = record.summary();
  outcome.digest = result.digest;
  outcome.trip = result.trip == Trip::none ? "" : name(result.trip);
  outcome.trip_step = result.trip_step;
  return outcome;
}

Command add_simulate(CLI::App& app) {
  struct Options {
    std::string file;
    bool json = false;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand("simulate", "Plays a scenario in one process, without DDS.");
  command->add_option("SCENARIO", options->file, "scenario file, TOML")->required();
  command->add_flag("--json", options->json, "print JSON");
  command->footer(
      "Example: weakgrid simulate deploy/settings/unfiltered-x01.toml\n"
      "Exit: 0 settled where the closed form says, 1 not, 2 bad usage or input.");
  return [options] {
    const Settings settings = load_scenario(options->file);
    const Outcome outcome = simulated(settings);
    if (options->json)
      fmt::print("{}\n", to_json(settings, outcome).dump(2));
    else
      print_table(settings, outcome);
    return outcome.is_good() ? exit_done : exit_no;
  };
}

}  // namespace weakgrid
