// weakgrid set, accept, renew, authority, grid: what an operator asks of the gateway.
#include "services/cli/asking.hpp"
#include "services/cli/commands.hpp"

namespace weakgrid {

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
