// weakgrid operate: start, stop, reset through the gateway; or let an emulated unit that waits go on.
#include <fmt/format.h>

#include <limits>

#include "services/cli/asking.hpp"
#include "services/cli/commands.hpp"
#include "services/runtime/program.hpp"

namespace weakgrid {

namespace {

struct Operating {
  Asking asking;
  std::optional<std::uint64_t> until;
  bool direct = false;
  CLI::App *start = nullptr, *stop = nullptr, *reset = nullptr;
};

// Seen done, not only sent.
void wait_for(const Client& client, RequestKind kind) {
  std::string state = "not heard";
  const auto done = [&](const Health& h) {
    const auto is = static_cast<UnitState>(counter(h, "unit_state"));
    state = name(is);
    if (kind == RequestKind::start) return is != UnitState::off && is != UnitState::tripped;
    return kind == RequestKind::stop ? is == UnitState::off : is != UnitState::tripped;
  };
  if (!client.wait_for("plant", Patience(5000), done))
    throw std::runtime_error(
        fmt::format("the plant does not follow, it is {}: weakgrid status tells who is there", state));
}

void send(Client& client, const Settings& settings, OperationKind kind, std::uint64_t until = 0) {
  if (!client.operate(kind, until, Patience(5000)))
    throw std::runtime_error(fmt::format("no plant of unit {} in domain {}; is weakgrid-plant running?",
                                         settings.unit.number, settings.unit.domain));
}

OperationKind operation(RequestKind kind) {
  return kind == RequestKind::start  ? OperationKind::start
         : kind == RequestKind::stop ? OperationKind::stop
                                     : OperationKind::reset_trip;
}

// Not an order but a matter of emulated time, between client and plant.
int advance(Client& client, const Settings& settings, std::optional<std::uint64_t> until) {
  send(client, settings, OperationKind::advance, until.value_or(std::numeric_limits<std::uint64_t>::max()));
  if (!client.wait_for("plant", Patience(5000),
                       [&](const Health& h) { return h.state != ServiceState::waiting || h.step >= until; }))
    throw std::runtime_error("the plant does not go on: weakgrid status tells who is there");
  return exit_done;
}

}  // namespace

Command add_operate(CLI::App& app) {
  auto options = std::make_shared<Operating>();
  CLI::App* command = app.add_subcommand("operate", "Starts, stops and resets a unit.");
  command->require_subcommand(1);
  options->start =
      command->add_subcommand("start", "Precharges a unit that is off, and closes, if idle may stand.");
  options->stop =
      command->add_subcommand("stop", "Opens bridge and source at once, and discharges; anybody may.");
  options->reset =
      command->add_subcommand("reset", "Closes again after a trip, from idle, if idle may stand.");
  CLI::App* advance_verb = command->add_subcommand("advance", "Lets an emulated unit that waits go on.");
  advance_verb->add_option("--until", options->until, "wait again at this step; default: go on for ever");
  add_where(*advance_verb, options->asking.where);
  for (CLI::App* verb : {options->start, options->stop, options->reset}) {
    add_asking(*verb, options->asking);
    verb->add_flag("--direct", options->direct, "straight to the plant, past the gateway and its interlocks");
  }
  command->footer(
      "Example: weakgrid operate reset --unit 1\n"
      "Exit: 0 done, 1 rejected, 2 bad usage, 3 nobody answers or follows.");
  return [options] {
    const Settings settings = options->asking.where.settings();
    Client client(settings.unit.domain, settings.unit.number, settings.dds);
    Request request;
    if (options->start->parsed())
      request.kind = RequestKind::start;
    else if (options->stop->parsed())
      request.kind = RequestKind::stop;
    else if (options->reset->parsed())
      request.kind = RequestKind::reset;
    else
      return advance(client, settings, options->until);
    if (options->direct) {
      send(client, settings, operation(request.kind));
      wait_for(client, request.kind);
      return exit_done;
    }
    const int answer = ask(client, settings, options->asking, request);
    if (answer == exit_done) wait_for(client, request.kind);
    return answer;
  };
}

}  // namespace weakgrid
