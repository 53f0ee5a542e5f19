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
  std::map<std::uint32_t, OutcomeGauge> recorded;  // by unit; what if: how it fared
  std::optional<Settings> other;
  bool is_what_if = false;

  bool is_good() const { return findings.differences.count() == 0 && findings.compared() > 0; }
  double speed() const { return wall_s > 0.0 ? recorded_s / wall_s : 0.0; }
};

// The bits of a number; of a text there is no more to see.
std::string shown(const WireField::Value& value) {
  if (std::holds_alternative<std::string>(value)) return '"' + to_text(value) + '"';
  return fmt::format("{} ({})", to_text(value), to_hex(value));
}

std::string describe(const Difference& d) {
  const bool is_input = d.what == "sample" || d.what == "request";
  return fmt::format("unit {} step {}: {}{}{} field {}: recorded {}, {} {}", d.unit, d.step, d.what,
                     d.which.empty() ? "" : " of ", d.which, d.field, shown(d.recorded),
                     is_input ? "what is in the file has" : "re-executed", shown(d.computed));
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

/// Units: how they fared, and how they would have, or why that cannot be told.
struct WhatIf {
  LoopOutcome recorded;
  std::optional<LoopOutcome> other;
  std::string why_not;
};
std::map<std::uint32_t, WhatIf> what_ifs(const Verdict& v) {
  std::map<std::uint32_t, WhatIf> all;
  if (!v.other) return all;
  for (const auto& [unit, gauge] : v.recorded) {
    WhatIf& w = all[unit];
    w.recorded = gauge.outcome();
    const auto loop = v.findings.loops.find(unit);
    w.why_not = loop == v.findings.loops.end() ? "nothing is known of its loop" : why_not(loop->second);
    if (w.why_not.empty()) w.other = emulate(loop->second, controller_configuration(*v.other));
  }
  return all;
}

/// A line for each figure of an outcome.
std::vector<std::pair<const char*, double>> figures(const LoopOutcome& o) {
  const auto blocked = o.blocked_at ? static_cast<double>(*o.blocked_at) : -1.0;
  return {{"v_c min", o.v_c_min},
          {"v_c max", o.v_c_max},
          {"|i| max", o.i_max},
          {"mean |q - q_r|", o.q_error},
          {"mean |v_c - v_cr|", o.v_c_error},
          {"the same over the last period, q", o.q_error_last},
          {"the same over the last period, v_c", o.v_c_error_last},
          {"saturated steps", static_cast<double>(o.saturated)},
          {"blocked at step (-1: never)", blocked}};
}

void print(const std::map<std::uint32_t, WhatIf>& all) {
  for (const auto& [unit, w] : all) {
    if (!w.other) {
      fmt::print("unit {} cannot be emulated once more: {}\n", unit, w.why_not);
      continue;
    }
    fmt::print("\nunit {}, emulated once more{:>27}{:>16}\n", unit, "recorded", "what if");
    const auto was = figures(w.recorded), would = figures(*w.other);
    for (std::size_t n = 0; n < was.size(); ++n)
      fmt::print("  {:<36}{:>16.6g}{:>16.6g}\n", was[n].first, was[n].second, would[n].second);
  }
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
  print(what_ifs(v));
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
  for (const auto& [unit, w] : what_ifs(v)) {
    json& item = out["what_if"].emplace_back(json{{"unit", unit}, {"why_not", w.why_not}});
    for (const auto& [name, value] : figures(w.recorded)) item["recorded"][name] = value;
    if (!w.other) continue;
    for (const auto& [name, value] : figures(*w.other)) item["other"][name] = value;
  }
  return out;
}

int verify(const Options& options) {
  Verdict verdict;
  ReexecutionOptions how;
  how.from_step = options.from_step;
  if (!options.settings.empty()) how.other_settings = load_settings(options.settings);
  verdict.is_what_if = how.other_settings.has_value();
  verdict.other = how.other_settings;
  const double omega = converter(how.other_settings.value_or(Settings{})).omega;
  std::map<std::uint32_t, std::uint64_t> next;  // by unit: repeats count once
  how.watch = [&](std::uint32_t unit, const Measurement& m, const Modulation& answer,
                  const Controller& controller) {
    verdict.recorded_s += period_s(m.timing);
    if (!verdict.other || m.step < next[unit]) return;
    next[unit] = m.step + 1;
    verdict.recorded[unit].see(m, answer, controller.state().references, omega);
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
