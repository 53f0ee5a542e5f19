// weakgrid operate: start, stop, reset a trip, or let a waiting unit go on.
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
    CLI::App *start = nullptr, *stop = nullptr, *reset = nullptr;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand("operate", "Operates the plant of a unit.");
  command->require_subcommand(1);
  options->start = command->add_subcommand("start", "Precharges a unit that is off, and closes.");
  options->stop = command->add_subcommand("stop", "Opens bridge and source at once, and discharges.");
  options->reset = command->add_subcommand("reset", "Closes again after a trip, from idle.");
  CLI::App* advance = command->add_subcommand("advance", "Lets a unit that waits go on.");
  advance->add_option("--until", options->until, "wait again at this step; default: go on for ever");
  for (CLI::App* verb : {options->start, options->stop, options->reset, advance})
    add_where(*verb, options->where);
  command->footer(
      "Example: weakgrid operate reset --unit 1\nExit: 0 sent, 2 bad usage, 3 no plant is there.");
  return [options] {
    const Settings settings = options->where.settings();
    Client client(settings.unit.domain, settings.unit.number, settings.dds.interfaces);
    const OperationKind kind = options->start->parsed()   ? OperationKind::start
                               : options->stop->parsed()  ? OperationKind::stop
                               : options->reset->parsed() ? OperationKind::reset_trip
                                                          : OperationKind::advance;
    if (!client.operate(kind, options->until.value_or(std::numeric_limits<std::uint64_t>::max()),
                        Patience(5000)))
      throw std::runtime_error(fmt::format("no plant of unit {} in domain {}; is weakgrid-plant running?",
                                           settings.unit.number, settings.unit.domain));
    // Seen done, not only sent.
    std::string state;
    const auto done = [&](const Health& h) {
      const auto is = static_cast<UnitState>(counter(h, "unit_state"));
      state = name(is);
      switch (kind) {
        case OperationKind::start:
          return is != UnitState::off && is != UnitState::tripped;
        case OperationKind::stop:
          return is == UnitState::off;
        case OperationKind::reset_trip:
          return is != UnitState::tripped;
        case OperationKind::advance:
          break;
      }
      return h.state != ServiceState::waiting || h.step >= options->until;
    };
    if (!client.wait_for("plant", Patience(5000), done))
      throw std::runtime_error(fmt::format("the plant does not follow: it is {}", state));
    return exit_done;
  };
}

}  // namespace weakgrid
