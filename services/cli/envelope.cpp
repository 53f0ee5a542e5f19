// weakgrid envelope: limits and margins of a setpoint, or the admissible area, for a grid or a box of grids.
#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "services/cli/commands.hpp"
#include "services/cli/envelope_curves.hpp"
#include "services/decision_json.hpp"
#include "services/decision_text.hpp"
#include "services/runtime/program.hpp"

namespace weakgrid {

namespace {

// Judged as the gateway would, from rest at what it starts with.
Decision judge(const Arbiter::Configuration& configuration, const Setpoint& setpoint) {
  Arbiter arbiter(configuration);
  Request request;
  request.client = request.id = 1;
  request.who.name.text = {'e', 'n', 'v', 'e', 'l', 'o', 'p', 'e'};
  request.given = given_p | given_q | given_v_c;
  request.p = setpoint.p;
  request.q = setpoint.q;
  request.v_c = setpoint.v_c;
  return arbiter.decide(request, 1);
}

void print_areas(const Arbiter::Configuration& c, double v_c, bool json) {
  const Grid corner{c.box.R_g.low, c.box.L_g.high, c.box.V.low};
  const EnvelopeSlice envelope{c.box, corner, c.converter, c.limits, v_c};
  nlohmann::json rows = nlohmann::json::array();
  if (!json) fmt::print("active_power,reactive_power_min,reactive_power_max\n");
  for (const auto& area : admissible_areas(envelope, 1.2 * c.limits.i_max * c.limits.v_p_max))
    for (const AdmissibleSpan& span : area) {
      if (json)
        rows.push_back({span.p, span.q_min, span.q_max});
      else
        fmt::print("{:.6f},{:.9f},{:.9f}\n", span.p, span.q_min, span.q_max);
    }
  if (json) fmt::print("{}\n", rows.dump());
}

}  // namespace

Command add_envelope(CLI::App& app) {
  struct Options {
    Where where;
    std::vector<double> resistance, reactance, voltage;
    std::optional<double> p, q, v_c;
    bool csv = false, json = false;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand(
      "envelope", "Limits and margins of a setpoint on a grid or a box of grids, or the admissible area.");
  command->add_option("--reactance", options->reactance, "of the grid; two: least and most")->expected(1, 2);
  command->add_option("--resistance", options->resistance, "of the grid; two: least and most")
      ->expected(1, 2);
  command->add_option("--voltage", options->voltage, "of the grid; two: least and most")->expected(1, 2);
  command->add_option("--p", options->p, "active power of the setpoint judged");
  command->add_option("--q", options->q, "its reactive power");
  command->add_option("--vc", options->v_c, "its DC voltage (default: the settings')");
  command->add_flag("--csv", options->csv,
                    "the admissible area: active power, least and most reactive power");
  command->add_flag("--json", options->json, "print JSON");
  add_where(*command, options->where);
  command->footer(
      "Example: weakgrid envelope --reactance 0.2 0.35 --p 0.7 --q 0.1\n"
      "The area is that of the steady state; decay and the way there are judged for a setpoint only.\n"
      "Exit: 0 admissible or printed, 1 not admissible, 2 bad usage.");
  return [options] {
    Settings settings = options->where.settings();
    const auto tell = [](std::optional<Interval>& known, const std::vector<double>& told, const char* what,
                         double least, double most) {
      if (told.empty()) return;
      known = Interval{told.front(), told.back()};
      if (!(known->low >= least && known->low <= known->high && known->high <= most))
        throw SettingsError(fmt::format("--{}: {} {}; allowed: from {} to {}, the lower first", what,
                                        known->low, known->high, least, most));
    };
    tell(settings.gateway.grid_resistance, options->resistance, "resistance", 0.0, 10.0);
    tell(settings.gateway.grid_reactance, options->reactance, "reactance", 0.0, 10.0);
    tell(settings.gateway.grid_voltage, options->voltage, "voltage", 0.1, 2.0);
    const Arbiter::Configuration configuration = arbiter_configuration(settings);
    const double v_c = options->v_c.value_or(settings.converter.dc_voltage);
    if (options->csv || (!options->p && !options->q)) {
      print_areas(configuration, v_c, options->json);
      return exit_done;
    }
    const Decision decision = judge(configuration, {options->p.value_or(0.0), options->q.value_or(0.0), v_c});
    if (options->json) {
      fmt::print("{}\n", to_json(decision, timing(settings)).dump(2));
    } else {
      const double omega = configuration.converter.omega;
      fmt::print("{}\n", decision.verdict == Verdict::accepted
                             ? fmt::format("admissible, ramp {:.6g} s",
                                           decision.reference->ramp_steps * period_s(timing(settings)))
                             : describe(decision, timing(settings)));
      for (const LimitMargin& m : decision.margins)
        fmt::print("  {:<34}{:>12.6f}  at R_g {:.4f}, X_g {:.4f}, V {:.4f}{}\n", name(m.limit), m.margin,
                   m.grid.R_g, m.grid.L_g * omega, m.grid.V, violated(m) ? "  violated" : "");
    }
    return decision.verdict == Verdict::accepted ? exit_done : exit_no;
  };
}

}  // namespace weakgrid
