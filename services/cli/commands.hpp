// The subcommands of `weakgrid`: each adds itself to the command line and, if chosen, gives the exit status.
#pragma once

#include <CLI/CLI.hpp>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "services/runtime/settings.hpp"

namespace weakgrid {

using Command = std::function<int()>;

Command add_run(CLI::App& app);
Command add_simulate(CLI::App& app);
Command add_sweep(CLI::App& app);
Command add_set(CLI::App& app);
Command add_accept(CLI::App& app);
Command add_renew(CLI::App& app);
Command add_authority(CLI::App& app);
Command add_grid(CLI::App& app);
Command add_envelope(CLI::App& app);
Command add_schedule(CLI::App& app);
Command add_status(CLI::App& app);
Command add_watch(CLI::App& app);
Command add_operate(CLI::App& app);
Command add_info(CLI::App& app);
Command add_recover(CLI::App& app);
Command add_verify(CLI::App& app);
Command add_export(CLI::App& app);
Command add_plot(CLI::App& app);
Command add_journal(CLI::App& app);
Command add_latency(CLI::App& app);

/// Where to look for a unit: --settings, or --domain and --unit.
struct Where {
  std::string file;
  std::optional<std::uint32_t> domain, unit;
  /// Throws SettingsError.
  Settings settings() const;
};
void add_where(CLI::App& command, Where& where);

/// load_settings, for a file that must have a scenario.
Settings load_scenario(const std::string& file);

}  // namespace weakgrid
