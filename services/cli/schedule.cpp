// weakgrid schedule: timed setpoints, checked as a whole before the first is sent.
#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "services/cli/client.hpp"
#include "services/cli/commands.hpp"
#include "services/cli/schedule_file.hpp"
#include "services/decision_json.hpp"
#include "services/decision_text.hpp"
#include "services/runtime/program.hpp"

namespace weakgrid {

namespace {

constexpr Patience long_enough{5000};

// What the gateway that runs goes by.
Settings settings_of_gateway(const Client& client, StopSignal& stop) {
  for (int patience = 100; patience > 0; --patience) {
    for (const Manifest& manifest : client.manifests())
      if (manifest.service == "gateway") return parse_settings(manifest.settings, "the gateway's manifest");
    if (stop.wait(Patience(50))) break;
  }
  throw std::runtime_error("the gateway's manifest does not come");
}

Envelope envelope_of_gateway(const Client& client, StopSignal& stop) {
  for (int patience = 100; patience > 0; --patience) {
    if (const auto envelope = client.envelope()) return *envelope;
    if (stop.wait(Patience(50))) break;
  }
  throw std::runtime_error("the gateway does not say what stands; is it of this version?");
}

}  // namespace

Command add_schedule(CLI::App& app) {
  struct Options {
    Where where;
    std::string file, name = "schedule";
    bool check = false, json = false;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand(
      "schedule", "Plays the timed setpoints of a file, all of them checked before the first.");
  command
      ->add_option("file", options->file, "table (.csv) or settings file with [scenario] and its setpoints")
      ->required();
  command->add_option("--name", options->name, "in whose name, at most 23 bytes")->capture_default_str();
  command->add_flag("--check", options->check, "check only");
  command->add_flag("--json", options->json, "print JSON, one line a decision");
  add_where(*command, options->where);
  command->footer(
      "Example: weakgrid schedule deploy/settings/paper-weak.toml --unit 1\n"
      "A table begins with a line of column names: at_s and some of active_power, reactive_power, "
      "dc_voltage,\n"
      "ramp_s, lease_s; an empty cell is not given. Its source is schedule: an operator may take over. A "
      "lease\n"
      "that is not given ends a second after the next setpoint is due, the last one's with the scenario or, "
      "of a\n"
      "table, as the gateway has it.\n"
      "Exit: 0 all accepted, 1 one is not, 2 bad file, 3 no gateway answers.");
  return [options] {
    StopSignal stop;
    const std::vector<TimedSetpoint> setpoints = load_schedule(options->file);
    const Settings settings = options->where.settings();
    Client client(settings.unit.domain, settings.unit.number, settings.dds);
    if (!client.wait_for("gateway", long_enough,
                         [](const Health& h) { return h.state == ServiceState::running; }))
      throw std::runtime_error(fmt::format("no gateway of unit {} in domain {}; is weakgrid-gateway running?",
                                           settings.unit.number, settings.unit.domain));
    const Settings known = settings_of_gateway(client, stop);
    const Timing unit_timing = timing(known);

    std::vector<Request> requests;
    for (std::size_t k = 0; k < setpoints.size(); ++k) {
      Request asked = request(known, setpoints[k], 1, static_cast<std::uint32_t>(k + 1));
      asked.lease_s = setpoints[k].lease_s;
      asked.who.source = Source::schedule;
      asked.who.name = {};
      std::copy_n(options->name.begin(), std::min(options->name.size(), asked.who.name.text.size() - 1),
                  asked.who.name.text.begin());
      requests.push_back(asked);
    }
    const auto print = [&](const Decision& decision, double at_s) {
      if (options->json)
        fmt::print("{}\n", to_json(decision, unit_timing).dump());
      else
        fmt::print("{:>10.3f} s  {}\n", at_s, describe(decision, unit_timing));
      std::fflush(stdout);
    };
    // From what stands, on the grid as the gateway knows it by now.
    Arbiter::Configuration configuration = arbiter_configuration(known);
    const double omega = configuration.converter.omega;
    const Envelope stands = envelope_of_gateway(client, stop);
    const KnownGrid& grid = stands.grid;
    configuration.box = {grid.R_g, {grid.X_g.low / omega, grid.X_g.high / omega}, grid.V};
    configuration.initial = stands.setpoint;
    Arbiter rehearsal(configuration);
    bool good = true;
    for (std::size_t k = 0; k < requests.size(); ++k) {
      Request asked = requests[k];
      asked.effective_step += 1000;
      const Decision decision = rehearsal.decide(asked, asked.effective_step - 1);
      if (decision.verdict == Verdict::accepted && !options->check) continue;
      print(decision, setpoints[k].at_s);
      good = good && decision.verdict == Verdict::accepted;
    }
    if (!good) fmt::print(stderr, "weakgrid: the schedule is not admissible; nothing was sent\n");
    if (!good || options->check) return good ? exit_done : exit_no;

    const auto step_of_unit = [&] {
      std::uint64_t step = 0;
      for (const auto& [key, health] : client.peers())
        if (key.first == "plant" && health.state != ServiceState::stopped) step = std::max(step, health.step);
      return step;
    };
    const std::uint64_t lead = std::uint64_t{200'000'000} / static_cast<std::uint64_t>(unit_timing.period_ns);
    const std::uint64_t begin = step_of_unit() + 5 * lead;
    for (std::size_t k = 0; k < requests.size(); ++k) {
      Request asked = requests[k];
      asked.effective_step += begin;
      while (step_of_unit() + 4 * lead < asked.effective_step)
        if (stop.wait(Patience(20))) return exit_no;
      auto answer = client.ask(asked, long_enough);
      if (answer && answer->decision.verdict == Verdict::stale_request) {
        asked.effective_step = 0;  // the unit runs faster than its health tells: as soon as possible
        answer = client.ask(asked, long_enough);
      }
      if (!answer) throw std::runtime_error("the gateway does not answer any more");
      print(answer->decision, setpoints[k].at_s);
      if (answer->decision.verdict != Verdict::accepted) return exit_no;
    }
    return exit_done;
  };
}

}  // namespace weakgrid
