// Sweep row: see the header.
#include "services/cli/sweep_row.hpp"

#include <fmt/format.h>

#include <array>

#include "services/csv_text.hpp"
#include "services/decision_text.hpp"

namespace weakgrid {

namespace {

// In the order of RunRecord::Summary::quantities; the last two have a closed form only in a steady state.
constexpr std::array quantities{"active_power", "reactive_power", "dc_voltage", "pcc_voltage", "current"};
constexpr std::size_t quantities_by_reference = 3;

// The decision that a run stands or falls with, counted from 1; 0: none.
std::size_t telling(const std::vector<Decision>& decisions) {
  for (std::size_t n = 0; n < decisions.size(); ++n)
    if (decisions[n].verdict != Verdict::accepted) return n + 1;
  return decisions.size();
}

// Decay and transient count only where they refuse: their margins have other units.
const LimitMargin* worst(const Margins& margins) {
  const LimitMargin* found = nullptr;
  for (const LimitMargin& m : margins) {
    if (!m.enforced || (static_cast<std::size_t>(m.limit) >= limit_count && !violated(m))) continue;
    // A NaN is violated and stays.
    const bool is_worse =
        found == nullptr || violated(m) > violated(*found) ||
        (violated(m) == violated(*found) && m.margin - m.required < found->margin - found->required);
    if (is_worse) found = &m;
  }
  return found;
}

}  // namespace

std::vector<std::string> sweep_columns() {
  std::vector<std::string> columns{"ending",       "setpoint", "verdict",   "limit",
                                   "limit_margin", "trip",     "trip_step", "tolerance"};
  for (const std::string quantity : quantities)
    for (const char* what : {"", "_closed_form", "_relative_swing", "_deviation_max"})
      columns.push_back(quantity + what);
  columns.insert(columns.end(), {"dc_voltage_min", "dc_voltage_max", "saturated_steps", "modulation_digest"});
  return columns;
}

std::string sweep_cells(const Outcome& outcome) {
  std::string text = name(outcome.ending());
  const auto add = [&](const auto& value) { put_csv_text(text += ',', fmt::format("{}", value)); };
  const auto skip = [&](int cells) { text.append(static_cast<std::size_t>(cells), ','); };
  if (const std::size_t n = telling(outcome.decisions); n > 0) {
    const Decision& decision = outcome.decisions[n - 1];
    add(n);
    add(name(decision.verdict));
    if (const LimitMargin* margin = worst(decision.margins)) {
      add(name(margin->limit));
      add(margin->margin - margin->required);
    } else {
      skip(2);
    }
  } else {
    skip(4);
  }
  if (outcome.trip.empty()) {
    skip(2);
  } else {
    add(outcome.trip);
    add(outcome.trip_step);
  }
  const auto& s = outcome.summary;
  add(s.tolerance);
  for (std::size_t k = 0; k < quantities.size(); ++k) {
    const RunRecord::Quantity& quantity = s.quantities.at(k);
    const bool has_closed_form = s.has_steady_state || k < quantities_by_reference;
    add(quantity.settled);
    has_closed_form ? add(quantity.closed_form) : skip(1);
    has_closed_form ? add(quantity.swing) : skip(1);
    has_closed_form ? add(quantity.deviation) : skip(1);
  }
  add(s.v_c_min);
  add(s.v_c_max);
  add(s.saturated);
  add(outcome.digest);
  return text;
}

std::string ending_of(const std::string& cells) { return cells.substr(0, cells.find(',')); }

}  // namespace weakgrid
