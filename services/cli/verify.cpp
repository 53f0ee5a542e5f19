// weakgrid verify: re-executes a recording and says where it differs.
#include <fmt/format.h>

#include <chrono>
#include <cmath>
#include <nlohmann/json.hpp>

#include "services/cli/commands.hpp"
#include "services/recording/reexecution.hpp"
#include "services/runtime/program.hpp"

namespace weakgrid {

namespace {

using nlohmann::json;

struct Options {
  std::vector<std::string> files;
  std::string settings;
  std::uint64_t from_step = 0;
  bool json = false;
};

struct Verdict {
  ReexecutionFindings findings;
  double recorded_s = 0.0, wall_s = 0.0;
  bool is_what_if = false;

  bool is_good() const { return findings.differences.count() == 0 && findings.compared() > 0; }
  double speed() const { return wall_s > 0.0 ? recorded_s / wall_s : 0.0; }
};

std::string describe(const Difference& d) {
  return fmt::format("unit {} step {}: {}{}{} field {}: recorded {} ({}), {} {} ({})", d.unit, d.step, d.what,
                     d.which.empty() ? "" : " of ", d.which, d.field, to_text(d.recorded), to_hex(d.recorded),
                     d.what == "sample" || d.what == "request" ? "what is in the file has" : "re-executed",
                     to_text(d.computed), to_hex(d.computed));
}

double mu_rms(const ControllerFindings& c) {
  return c.compared == 0 ? 0.0 : std::sqrt(c.mu_distance_squares / static_cast<double>(c.compared));
}

void print_unchecked(const std::vector<Unchecked>& list) {
  constexpr std::size_t printed_max = 8;
  for (std::size_t n = 0; n < list.size() && n < printed_max; ++n)
    fmt::print("  not compared: {} from step {} to {}: {}\n", list[n].count, list[n].first_step,
               list[n].last_step, list[n].why);
  if (list.size() > printed_max) fmt::print("  … and {} more stretches\n", list.size() - printed_max);
}

void print(const Verdict& v) {
  for (const ControllerFindings& c : v.findings.controllers) {
    fmt::print("unit {}, controller {} ({}), steps {} … {}\n", c.unit, c.writer,
               c.build.empty() ? "no manifest" : c.build, c.first_step, c.last_step);
    fmt::print("  {} of {} modulations identical", c.identical, c.compared);
    if (v.is_what_if)
      fmt::print("; |Δμ| at most {:.3g} (step {}), rms {:.3g}; saturated {} → {}", c.mu_distance_max,
                 c.mu_distance_max_step, mu_rms(c), c.saturated_recorded, c.saturated_computed);
    else
      fmt::print(", {} of {} states{}", c.states_identical, c.states_compared,
                 c.resumed == 0 ? "" : fmt::format(", resumed {} times from a recorded state", c.resumed));
    fmt::print("\n");
    print_unchecked(c.unchecked);
  }
  for (const GatewayFindings& g : v.findings.gateways) {
    fmt::print("unit {}, gateway {} ({})\n", g.unit, g.participant,
               g.build.empty() ? "no manifest" : g.build);
    fmt::print("  {} of {} decisions, {} of {} references identical", g.decisions_identical, g.decisions,
               g.references_identical, g.references);
    if (v.is_what_if) fmt::print("; accepted {} → {}", g.accepted_recorded, g.accepted_computed);
    fmt::print("\n");
    print_unchecked(g.unchecked);
  }
  constexpr std::size_t printed_max = 10;
  const auto& kept = v.findings.differences.kept();
  for (std::size_t n = 0; n < kept.size() && n < printed_max; ++n) fmt::print("{}\n", describe(kept[n]));
  if (v.findings.differences.count() > printed_max && !v.is_what_if)
    fmt::print("… and {} more differences\n", v.findings.differences.count() - printed_max);
  fmt::print("{}", v.findings.file_faults);
  fmt::print("{:.2f} s recorded, re-executed in {:.3f} s: {:.0f} × real time\n", v.recorded_s, v.wall_s,
             v.speed());
  if (v.findings.compared() == 0)
    fmt::print("NOTHING to compare\n");
  else if (v.findings.differences.count() > 0)
    fmt::print("DIFFERS\n");
  else
    fmt::print("IDENTICAL{}\n", v.findings.unchecked() == 0
                                    ? ""
                                    : fmt::format(", as far as compared: {} answers were not, see above",
                                                  v.findings.unchecked()));
}

json to_json(const std::vector<Unchecked>& list) {
  json out = json::array();
  for (const Unchecked& u : list)
    out.push_back(
        {{"first_step", u.first_step}, {"last_step", u.last_step}, {"count", u.count}, {"why", u.why}});
  return out;
}

json to_json(const Verdict& v) {
  json out{{"identical", v.is_good()},
           {"compared", v.findings.compared()},
           {"unchecked", v.findings.unchecked()},
           {"differences", v.findings.differences.count()},
           {"manifests", v.findings.manifests},
           {"file_faults", v.findings.file_faults},
           {"recorded_s", v.recorded_s},
           {"wall_s", v.wall_s},
           {"times_real_time", v.speed()},
           {"controllers", json::array()},
           {"gateways", json::array()},
           {"first_differences", json::array()}};
  for (const ControllerFindings& c : v.findings.controllers)
    out["controllers"].push_back({{"unit", c.unit},
                                  {"writer", c.writer},
                                  {"build", c.build},
                                  {"first_step", c.first_step},
                                  {"last_step", c.last_step},
                                  {"modulations", c.compared},
                                  {"identical", c.identical},
                                  {"states", c.states_compared},
                                  {"states_identical", c.states_identical},
                                  {"resumed", c.resumed},
                                  {"mu_distance_max", c.mu_distance_max},
                                  {"mu_distance_rms", mu_rms(c)},
                                  {"saturated_recorded", c.saturated_recorded},
                                  {"saturated_computed", c.saturated_computed},
                                  {"unchecked", to_json(c.unchecked)}});
  for (const GatewayFindings& g : v.findings.gateways)
    out["gateways"].push_back({{"unit", g.unit},
                               {"participant", g.participant},
                               {"build", g.build},
                               {"decisions", g.decisions},
                               {"decisions_identical", g.decisions_identical},
                               {"references", g.references},
                               {"references_identical", g.references_identical},
                               {"accepted_recorded", g.accepted_recorded},
                               {"accepted_computed", g.accepted_computed},
                               {"unchecked", to_json(g.unchecked)}});
  for (const Difference& d : v.findings.differences.kept())
    out["first_differences"].push_back({{"unit", d.unit},
                                        {"step", d.step},
                                        {"what", d.what},
                                        {"which", d.which},
                                        {"field", d.field},
                                        {"recorded", to_text(d.recorded)},
                                        {"recorded_hex", to_hex(d.recorded)},
                                        {"computed", to_text(d.computed)},
                                        {"computed_hex", to_hex(d.computed)}});
  return out;
}

int verify(const Options& options) {
  Verdict verdict;
  ReexecutionOptions how;
  how.from_step = options.from_step;
  if (!options.settings.empty()) how.other_settings = load_settings(options.settings);
  verdict.is_what_if = how.other_settings.has_value();
  how.watch = [&verdict](std::uint32_t, const Measurement& m, const Modulation&, const Controller&) {
    verdict.recorded_s += period_s(m.timing);
  };
  RecordingSource source(options.files);
  Reexecution reexecution(how);
  const auto start = std::chrono::steady_clock::now();
  reexecution.run(source);
  verdict.wall_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  verdict.findings = reexecution.findings();
  if (options.json)
    fmt::print("{}\n", to_json(verdict).dump(2, ' ', false, json::error_handler_t::replace));
  else
    print(verdict);
  return verdict.is_good() ? exit_done : exit_no;
}

}  // namespace

Command add_verify(CLI::App& app) {
  auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand(
      "verify", "Re-executes every controller and gateway of a recording and compares every bit.");
  command->add_option("RECORDING", options->files, "MCAP file, or the parts of one in order")->required();
  command->add_option("--settings", options->settings,
                      "what if: other settings than the recorded ones for controller and gateway");
  command->add_option("--from-step", options->from_step,
                      "begin at the first recorded state from this step on (default: at the start)");
  command->add_flag("--json", options->json, "print JSON");
  command->footer(
      "Example: weakgrid verify run.mcap\n"
      "Exit: 0 every answer that could be compared is identical, 1 one differs or none could be compared, "
      "2 not a recording.");
  return [options] { return verify(*options); };
}

}  // namespace weakgrid
