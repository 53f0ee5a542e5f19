// weakgrid set, accept, renew, authority, grid: what an operator asks of the gateway, and its decision.
#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <nlohmann/json.hpp>

#include "services/cli/client.hpp"
#include "services/cli/commands.hpp"
#include "services/cli/report.hpp"
#include "services/decision_text.hpp"
#include "services/runtime/program.hpp"

namespace weakgrid {

namespace {

// What every request has.
struct Asking {
  Where where;
  std::string name, source = "operation";
  double timeout_s = 5.0;
  double lease_s = 0.0;
  bool hold = false;
  bool json = false;
};

std::string own_name() {
  char host[64] = {};
  (void)::gethostname(host, sizeof host - 1);
  const char* user = std::getenv("USER");
  return fmt::format("{}@{}", user != nullptr ? user : "somebody", host).substr(0, 23);
}

void add_asking(CLI::App& command, Asking& asking) {
  asking.name = own_name();
  command.add_option("--name", asking.name, "in whose name, at most 23 bytes")
      ->check([](const std::string& text) {
        return text.empty() || text.size() > 23 ? std::string("allowed: 1 to 23 bytes") : std::string();
      })
      ->capture_default_str();
  command.add_option("--as", asking.source, "operation, schedule or test: who stands above may take over")
      ->check(CLI::IsMember({"operation", "schedule", "test"}))
      ->capture_default_str();
  command.add_option("--timeout", asking.timeout_s, "how long to wait for the gateway, seconds")
      ->check(CLI::Range(0.1, 3600.0))
      ->capture_default_str();
  command.add_flag("--json", asking.json, "print JSON");
  add_where(command, asking.where);
}

void add_lease(CLI::App& command, Asking& asking) {
  command.add_option("--lease", asking.lease_s,
                     "seconds until the unit falls back, unless renewed (default: the gateway's)");
  command.add_flag("--hold", asking.hold, "stay and renew until interrupted");
}

Holder holder_of(const Asking& asking) {
  Holder holder;
  holder.source = asking.source == "operation"  ? Source::operation
                  : asking.source == "schedule" ? Source::schedule
                                                : Source::test;
  std::copy_n(asking.name.begin(), std::min(asking.name.size(), holder.name.text.size() - 1),
              holder.name.text.begin());
  return holder;
}

void print(const DecisionMessage& answer, const Asking& asking, const Timing& timing) {
  const Decision& decision = answer.decision;
  if (asking.json) {
    fmt::print("{}\n", to_json(decision, timing).dump(2));
    return;
  }
  fmt::print("{}\n", describe(decision, timing));
  for (const LimitMargin& margin : decision.margins)
    fmt::print("  {:<34}{:>12.6f}{}\n", name(margin.limit), margin.margin,
               violated(margin)  ? "  violated"
               : margin.enforced ? ""
                                 : "  for information");
}

int ask(const Asking& asking, Request request) {
  StopSignal stop;
  const Settings settings = asking.where.settings();
  request.who = holder_of(asking);
  request.lease_s = asking.lease_s;
  Client client(settings.unit.domain, settings.unit.number, settings.dds.interfaces);
  const Patience patience(static_cast<std::int64_t>(asking.timeout_s * 1e3));
  const auto answered = [&](const Request& what) {
    const auto answer = client.ask(what, patience);
    if (!answer)
      throw std::runtime_error(
          fmt::format("no gateway of unit {} answers in domain {}; is weakgrid-gateway running?",
                      settings.unit.number, settings.unit.domain));
    return *answer;
  };
  DecisionMessage answer = answered(request);
  print(answer, asking, timing(settings));
  if (answer.decision.verdict != Verdict::accepted) return exit_no;
  if (!asking.hold) return exit_done;
  // A third of the lease: two renewals may be lost.
  Request renewal;
  renewal.kind = RequestKind::renew;
  renewal.who = request.who;
  renewal.lease_s = asking.lease_s != 0.0 ? asking.lease_s : settings.gateway.lease_s;
  while (!stop.wait(Patience(static_cast<std::int64_t>(renewal.lease_s * 1e3 / 3.0)))) {
    answer = answered(renewal);
    if (answer.decision.verdict == Verdict::accepted) continue;
    print(answer, asking, timing(settings));
    return exit_no;
  }
  return exit_done;
}

}  // namespace

Command add_set(CLI::App& app) {
  struct Options {
    Asking asking;
    TimedSetpoint setpoint;
    std::string keep = "nothing";
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand("set", "Asks for a setpoint; what is not given stays as it stands.");
  auto& setpoint = options->setpoint;
  command->add_option("--p", setpoint.active_power, "active power, per unit, into the grid");
  command->add_option("--q", setpoint.reactive_power, "reactive power at the PCC, per unit");
  command->add_option("--vc", setpoint.dc_voltage, "DC voltage, per unit");
  command->add_option("--ramp", setpoint.ramp_s, "ramp of at least so many seconds (default: the gateway's)");
  command->add_option("--keep", options->keep, "what an offer keeps, should the setpoint be refused")
      ->check(CLI::IsMember({"nothing", "p", "q", "power-factor"}))
      ->capture_default_str();
  add_lease(*command, options->asking);
  add_asking(*command, options->asking);
  command->footer(
      "Example: weakgrid set --p 0.5 --q 0.1 --ramp 0.05 --hold\n"
      "Exit: 0 accepted, 1 rejected, 2 bad usage, 3 no gateway answers.");
  return [options] {
    const TimedSetpoint& wanted = options->setpoint;
    if (!wanted.active_power && !wanted.reactive_power && !wanted.dc_voltage)
      throw SettingsError("set: nothing asked for; give at least one of --p, --q, --vc");
    Request asked = request({}, wanted, 0, 0);
    asked.policy = options->keep == "p"              ? Policy::keep_p
                   : options->keep == "q"            ? Policy::keep_q
                   : options->keep == "power-factor" ? Policy::keep_power_factor
                                                     : Policy::minimum_distance;
    return ask(options->asking, asked);
  };
}

Command add_accept(CLI::App& app) {
  struct Options {
    Asking asking;
    Request request;
  };
  auto options = std::make_shared<Options>();
  options->request.kind = RequestKind::accept;
  CLI::App* command = app.add_subcommand("accept", "Accepts what a refusal has offered, exactly.");
  command->add_option("token", options->request.token, "of the offer")->required();
  command->add_option("--ramp", options->request.ramp_s, "ramp of at least so many seconds");
  add_lease(*command, options->asking);
  add_asking(*command, options->asking);
  command->footer(
      "Example: weakgrid accept 3\nExit: 0 accepted, 1 rejected, 2 bad usage, 3 no gateway answers.");
  return [options] { return ask(options->asking, options->request); };
}

Command add_renew(CLI::App& app) {
  auto options = std::make_shared<Asking>();
  CLI::App* command = app.add_subcommand("renew", "Renews the lease of what stands.");
  add_lease(*command, *options);
  add_asking(*command, *options);
  command->footer(
      "Example: weakgrid renew --lease 600\nExit: 0 renewed, 1 rejected, 2 bad usage, 3 no gateway answers.");
  return [options] {
    Request request;
    request.kind = RequestKind::renew;
    return ask(*options, request);
  };
}

Command add_authority(CLI::App& app) {
  struct Options {
    Asking asking;
    CLI::App* take = nullptr;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand("authority", "Takes or releases the right to give orders.");
  command->require_subcommand(1);
  options->take = command->add_subcommand(
      "take", "Takes it if nobody holds it or the holder's source stands below: test, schedule, operation.");
  CLI::App* release =
      command->add_subcommand("release", "Gives it up; what stands stays until its lease ends.");
  for (CLI::App* verb : {options->take, release}) add_asking(*verb, options->asking);
  options->take->add_option("--lease", options->asking.lease_s, "seconds (default: the gateway's)");
  command->footer(
      "Example: weakgrid authority take --name ann\n"
      "Exit: 0 done, 1 rejected, 2 bad usage, 3 no gateway answers.");
  return [options] {
    Request request;
    request.kind = options->take->parsed() ? RequestKind::take : RequestKind::release;
    return ask(options->asking, request);
  };
}

Command add_grid(CLI::App& app) {
  struct Options {
    Asking asking;
    std::vector<double> resistance{0.0, 0.0}, reactance, voltage{1.0, 1.0};
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand(
      "grid", "Tells the gateway between what and what the grid is; it derates what no longer fits.");
  command->add_option("--reactance", options->reactance, "least and most, per unit")->required()->expected(2);
  command->add_option("--resistance", options->resistance, "least and most, per unit")->expected(2);
  command->add_option("--voltage", options->voltage, "least and most, per unit")->expected(2);
  add_asking(*command, options->asking);
  command->footer(
      "Example: weakgrid grid --reactance 0.2 0.4 --voltage 0.95 1.05\n"
      "Exit: 0 taken, 1 rejected, 2 bad usage, 3 no gateway answers.");
  return [options] {
    Request request;
    request.kind = RequestKind::set_grid;
    request.R_g = {options->resistance[0], options->resistance[1]};
    request.X_g = {options->reactance[0], options->reactance[1]};
    request.V = {options->voltage[0], options->voltage[1]};
    return ask(options->asking, request);
  };
}

}  // namespace weakgrid
