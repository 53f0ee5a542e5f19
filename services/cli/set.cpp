// weakgrid set: asks the gateway for a setpoint and prints its decision.
#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "services/cli/client.hpp"
#include "services/cli/commands.hpp"
#include "services/cli/report.hpp"
#include "services/decision_text.hpp"
#include "services/runtime/program.hpp"

namespace weakgrid {

Command add_set(CLI::App& app) {
  struct Options {
    Where where;
    TimedSetpoint setpoint;
    double timeout_s = 5.0;
    bool json = false;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand("set", "Asks for a setpoint; what is not given stays as it stands.");
  auto& setpoint = options->setpoint;
  command->add_option("--p", setpoint.active_power, "active power, per unit, into the grid");
  command->add_option("--q", setpoint.reactive_power, "reactive power at the PCC, per unit");
  command->add_option("--vc", setpoint.dc_voltage, "DC voltage, per unit");
  command->add_option("--ramp", setpoint.ramp_s, "duration of the ramp, seconds (default: the gateway's)");
  command->add_option("--timeout", options->timeout_s, "how long to wait for the gateway, seconds")
      ->check(CLI::Range(0.1, 3600.0))
      ->capture_default_str();
  command->add_flag("--json", options->json, "print JSON");
  add_where(*command, options->where);
  command->footer(
      "Example: weakgrid set --p 0.5 --q 0.1 --ramp 0.05\n"
      "Exit: 0 accepted, 1 rejected, 2 bad usage, 3 no gateway answers.");
  return [options] {
    const Settings settings = options->where.settings();
    if (!options->setpoint.active_power && !options->setpoint.reactive_power && !options->setpoint.dc_voltage)
      throw SettingsError("set: nothing asked for; give at least one of --p, --q, --vc");
    Client client(settings.unit.domain, settings.unit.number, settings.dds.interfaces);
    const auto answer = client.ask(request(settings, options->setpoint, 0, 0),
                                   Patience(static_cast<std::int64_t>(options->timeout_s * 1e3)));
    if (!answer)
      throw std::runtime_error(
          fmt::format("no gateway of unit {} answers in domain {}; is weakgrid-gateway running?",
                      settings.unit.number, settings.unit.domain));
    if (options->json)
      fmt::print("{}\n", to_json(answer->decision, timing(settings)).dump(2));
    else
      fmt::print("{}\n", answer->text);
    if (!options->json)
      for (const LimitMargin& margin : answer->decision.margins)
        fmt::print("  {:<34}{:>12.6f}{}\n", name(margin.limit), margin.margin,
                   violated(margin)  ? "  violated"
                   : margin.enforced ? ""
                                     : "  for information");
    return answer->decision.verdict == Verdict::accepted ? exit_done : exit_no;
  };
}

}  // namespace weakgrid
