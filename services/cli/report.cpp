// Report: see the header.
#include "services/cli/report.hpp"

#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "services/decision_text.hpp"

namespace weakgrid {

const char* name(Ending ending) {
  constexpr const char* names[] = {"tripped",         "refused", "interrupted",
                                   "no_steady_state", "settled", "not_settled"};
  return names[static_cast<std::size_t>(ending)];
}

Ending Outcome::ending() const {
  if (!trip.empty()) return Ending::tripped;
  for (const Decision& decision : decisions)
    if (decision.verdict != Verdict::accepted) return Ending::refused;
  if (in_lockstep && holds > 0) return Ending::interrupted;
  if (!summary.has_steady_state) return Ending::no_steady_state;
  return summary.settled ? Ending::settled : Ending::not_settled;
}

namespace {

double rate(const Settings& settings, const Outcome& outcome) {
  return outcome.wall_s > 0.0 ? settings.scenario->end_s / outcome.wall_s : 0.0;
}

std::string verdict(const Settings& settings, const Outcome& outcome) {
  switch (outcome.ending()) {
    case Ending::tripped:
      return fmt::format("LOST the operating point: {} at t = {:.4f} s (step {})", outcome.trip,
                         static_cast<double>(outcome.trip_step) * period_s(timing(settings)),
                         outcome.trip_step);
    case Ending::refused:
      return "REFUSED: a setpoint was not accepted";
    case Ending::interrupted:
      return fmt::format("INTERRUPTED: {} steps without a modulation", outcome.holds);
    case Ending::no_steady_state:
      return "LOST: the grid at the end has no steady state for this setpoint";
    case Ending::settled:
      return "SETTLED where the closed form says";
    case Ending::not_settled:
      break;
  }
  return "NOT SETTLED";
}

}  // namespace

void print_table(const Settings& settings, const Outcome& outcome) {
  const auto& s = outcome.summary;
  for (const Decision& decision : outcome.decisions) fmt::print("{}\n", describe(decision, timing(settings)));
  fmt::print("\n{:<20}{:>14}{:>14}{:>14}{:>12}\n", "", "settled", "closed form", "rel. diff.", "swing");
  for (const auto& q : s.quantities)
    fmt::print("{:<20}{:>14.6f}{:>14.6f}{:>14.1e}{:>12.1e}  {}\n", q.name, q.settled, q.closed_form,
               q.difference, q.swing, q.agrees ? "agrees" : "DIFFERS");
  fmt::print("\nv_c {:.4f} … {:.4f}, {} steps saturated", s.v_c_min, s.v_c_max, s.saturated);
  if (outcome.over_dds) {
    fmt::print(", {} steps held, {} samples sent again, {} not seen by this observer\n", outcome.holds,
               outcome.resends, s.missed);
    fmt::print("{:.2f} s at {} µs in {:.2f} s: {:.2f} × real time over DDS, {:.0f} steps/s\n",
               settings.scenario->end_s, settings.timing.period_us, outcome.wall_s, rate(settings, outcome),
               rate(settings, outcome) * 1e6 / settings.timing.period_us);
  } else {
    fmt::print("\n{:.2f} s at {} µs in {:.4f} s: {:.0f} × real time\n", settings.scenario->end_s,
               settings.timing.period_us, outcome.wall_s, rate(settings, outcome));
  }
  fmt::print("modulation digest {}\n", outcome.digest);
  fmt::print("{}\n", verdict(settings, outcome));
}

nlohmann::json to_json(const Settings& settings, const Outcome& outcome) {
  const auto& s = outcome.summary;
  nlohmann::json decisions = nlohmann::json::array();
  for (const Decision& decision : outcome.decisions) decisions.push_back(to_json(decision, timing(settings)));
  nlohmann::json quantities;
  for (const auto& q : s.quantities)
    quantities[q.name] = {{"settled", q.settled},
                          {"closed_form", q.closed_form},
                          {"relative_difference", q.difference},
                          {"relative_swing", q.swing},
                          {"agrees", q.agrees}};
  return {{"title", settings.scenario->title},
          {"good", outcome.is_good()},
          {"verdict", verdict(settings, outcome)},
          {"decisions", decisions},
          {"quantities", quantities},
          {"dc_voltage_min", s.v_c_min},
          {"dc_voltage_max", s.v_c_max},
          {"saturated_steps", s.saturated},
          {"held_steps", outcome.holds},
          {"resent_samples", outcome.resends},
          {"unobserved_samples", s.missed},
          {"trip", outcome.trip},
          {"trip_step", outcome.trip_step},
          {"modulation_digest", outcome.digest},
          {"wall_s", outcome.wall_s},
          {"times_real_time", rate(settings, outcome)}};
}

}  // namespace weakgrid
