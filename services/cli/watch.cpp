// weakgrid watch: the unit at a terminal, one line at a time, and every decision as it is taken.
#include <fmt/format.h>

#include <cstdio>
#include <nlohmann/json.hpp>

#include "services/cli/client.hpp"
#include "services/cli/commands.hpp"
#include "services/decision_json.hpp"
#include "services/decision_text.hpp"
#include "services/runtime/program.hpp"

namespace weakgrid {

namespace {

void print(const Measurement& m, std::size_t peers, bool json) {
  const SpaceVector s = power(m.v_p, m.i);
  if (json)
    fmt::print("{}\n", nlohmann::json{{"step", m.step},
                                      {"state", name(m.state)},
                                      {"active_power", s.re},
                                      {"reactive_power", s.im},
                                      {"dc_voltage", m.v_c},
                                      {"pcc_voltage", abs(m.v_p)},
                                      {"current", abs(m.i)},
                                      {"reference_id", m.reference_id},
                                      {"fallback", m.fallback}}
                           .dump());
  else
    fmt::print(
        "step {:<12} {:<9} p {:>8.4f}  q {:>8.4f}  v_c {:.4f}  |v_p| {:.4f}  |i| {:.4f}  reference {}{}  {} "
        "services\n",
        m.step, name(m.state), s.re, s.im, m.v_c, abs(m.v_p), abs(m.i), m.reference_id,
        m.fallback ? ", fallen back" : "", peers);
}

}  // namespace

Command add_watch(CLI::App& app) {
  struct Options {
    Where where;
    double every_s = 1.0, duration_s = 0.0;
    bool json = false;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command =
      app.add_subcommand("watch", "Shows what a unit does, line by line, and what is decided.");
  command->add_option("--every", options->every_s, "seconds between lines")
      ->check(CLI::Range(0.05, 3600.0))
      ->capture_default_str();
  command->add_option("--for", options->duration_s, "seconds to watch; 0: until interrupted")
      ->check(CLI::Range(0.0, 1e9))
      ->capture_default_str();
  command->add_flag("--json", options->json, "print JSON, one line each");
  add_where(*command, options->where);
  command->footer("Example: weakgrid watch --every 0.5\nExit: 0 a unit was seen, 1 none was, 2 bad usage.");
  return [options] {
    StopSignal stop;
    const Settings settings = options->where.settings();
    Client client(settings.unit.domain, settings.unit.number, settings.dds);
    std::mutex mutex;
    std::optional<Measurement> last;
    std::vector<Decision> decisions;
    const Reader<Measurement> samples(client.bus(), settings.unit.number, [&](const Measurement& m, Arrival) {
      const std::lock_guard lock(mutex);
      last = m;
    });
    const Reader<DecisionMessage> answers(client.bus(), settings.unit.number,
                                          [&](const DecisionMessage& m, Arrival) {
                                            const std::lock_guard lock(mutex);
                                            decisions.push_back(m.decision);
                                          });
    const auto begin = std::chrono::steady_clock::now();
    const auto every = std::chrono::milliseconds(static_cast<std::int64_t>(options->every_s * 1e3));
    bool seen = false;
    while (!stop.wait(every)) {
      std::optional<Measurement> now;
      std::vector<Decision> decided;
      {
        const std::lock_guard lock(mutex);
        now = std::exchange(last, std::nullopt);
        decided.swap(decisions);
      }
      for (const Decision& d : decided) {
        if (options->json)
          fmt::print("{}\n", to_json(d, timing(settings)).dump());
        else
          fmt::print("decision     {}\n", describe(d, timing(settings)));
      }
      seen = seen || now;
      if (now)
        print(*now, client.peers().size(), options->json);
      else if (!options->json)
        fmt::print("no sample of unit {}\n", settings.unit.number);
      std::fflush(stdout);
      if (options->duration_s > 0.0 &&
          std::chrono::steady_clock::now() - begin >= std::chrono::duration<double>(options->duration_s))
        break;
    }
    return seen ? exit_done : exit_no;
  };
}

}  // namespace weakgrid
