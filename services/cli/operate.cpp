// weakgrid operate: reset a trip, or let a waiting unit go on.
#include <fmt/format.h>

#include <limits>

#include "services/cli/client.hpp"
#include "services/cli/commands.hpp"
#include "services/runtime/program.hpp"

namespace weakgrid {

Command add_operate(CLI::App& app) {
  struct Options {
    Where where;
    std::optional<std::uint64_t> until;
    CLI::App* reset = nullptr;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand("operate", "Operates the plant of a unit.");
  command->require_subcommand(1);
  options->reset = command->add_subcommand("reset", "Closes again after a trip, from idle.");
  CLI::App* advance = command->add_subcommand("advance", "Lets a unit that waits go on.");
  advance->add_option("--until", options->until, "wait again at this step; default: go on for ever");
  for (CLI::App* verb : {options->reset, advance}) add_where(*verb, options->where);
  command->footer(
      "Example: weakgrid operate reset --unit 1\nExit: 0 sent, 2 bad usage, 3 no plant is there.");
  return [options] {
    const Settings settings = options->where.settings();
    Client client(settings.unit.domain, settings.unit.number, settings.dds.interfaces);
    const bool is_reset = options->reset->parsed();
    if (!client.operate(is_reset ? OperationKind::reset_trip : OperationKind::advance,
                        options->until.value_or(std::numeric_limits<std::uint64_t>::max()), Patience(5000)))
      throw std::runtime_error(fmt::format("no plant of unit {} in domain {}; is weakgrid-plant running?",
                                           settings.unit.number, settings.unit.domain));
    // Seen done, not only sent.
    const auto done = [&](const Health& h) {
      return is_reset ? counter(h, "tripped") == 0
                      : h.state != ServiceState::waiting || h.step >= options->until;
    };
    if (!client.wait_for("plant", Patience(5000), done))
      throw std::runtime_error("the plant does not follow");
    return exit_done;
  };
}

}  // namespace weakgrid
