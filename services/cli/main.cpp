// weakgrid: the one command line.
#include <utility>
#include <vector>

#include "services/cli/commands.hpp"
#include "services/runtime/announcer.hpp"
#include "services/runtime/program.hpp"

namespace weakgrid {

Settings Where::settings() const {
  Settings settings = file.empty() ? Settings{} : load_settings(file);
  settings.unit.domain = domain.value_or(settings.unit.domain);
  settings.unit.number = unit.value_or(settings.unit.number);
  return settings;
}

void add_where(CLI::App& command, Where& where) {
  command.add_option("--settings", where.file,
                     "the unit's settings file, for its domain, number and [dds]");
  command.add_option("--domain", where.domain, "DDS domain (default: of the settings, else 0)")
      ->check(CLI::Range(0, 230));
  command.add_option("--unit", where.unit, "unit number (default: of the settings, else 1)")
      ->check(CLI::Range(1u, 4294967295u));
}

Settings load_scenario(const std::string& file) {
  Settings settings = load_settings(file);
  if (!settings.scenario)
    throw SettingsError(file + ": scenario: missing; this command needs a table [scenario]");
  return settings;
}

}  // namespace weakgrid

int main(int argc, char** argv) {
  using namespace weakgrid;
  CLI::App app("Runs a power converter on a weak grid over DDS.", "weakgrid");
  app.set_version_flag("--version", build_text());
  app.require_subcommand(1);
  app.footer("Exit: 0 done, 1 the answer is no, 2 bad usage or input, 3 the world failed.");
  std::vector<std::pair<CLI::App*, Command>> commands;
  for (Command (*add)(CLI::App&) :
       {add_run,     add_simulate, add_sweep,    add_set,    add_accept,  add_renew,   add_authority,
        add_grid,    add_envelope, add_schedule, add_status, add_watch,   add_operate, add_info,
        add_recover, add_verify,   add_export,   add_plot,   add_journal, add_latency}) {
    Command command = add(app);
    commands.emplace_back(app.get_subcommands({}).back(), std::move(command));
  }
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? exit_done : exit_usage;
  }
  try {
    set_up_log("weakgrid", "warning");
    for (const auto& [subcommand, command] : commands)
      if (subcommand->parsed()) return command();
    return exit_usage;
  } catch (...) {
    return report_exception("weakgrid");
  }
}
