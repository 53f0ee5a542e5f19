// Decision text: see the header.
#include "services/decision_text.hpp"

#include <fmt/format.h>

#include <iterator>

namespace weakgrid {

namespace {

const char* name(Field field) {
  constexpr const char* names[] = {"none",           "client",     "id",     "given",         "active_power",
                                   "reactive_power", "dc_voltage", "ramp_s", "effective_step"};
  return names[static_cast<std::size_t>(field)];
}

const char* allowed(Field field) {
  switch (field) {
    case Field::client:
      return "a random number, not 0";
    case Field::id:
      return "1, 2, … rising for each client";
    case Field::given:
      return "at least one of active_power, reactive_power, dc_voltage; all three after a restart of the "
             "gateway";
    case Field::p:
    case Field::q:
      return "a number from -10 to 10";
    case Field::v_c:
      return "a number above 0, at most 10";
    case Field::ramp_s:
      return "0 (default) or 0.001 to 60";
    case Field::effective_step:
      return "0 (as soon as possible) or a step still to come";
    case Field::none:
      break;
  }
  return "";
}

}  // namespace

const char* name(Limit limit) {
  constexpr const char* names[] = {"no steady state exists (lambda)",
                                   "current limit",
                                   "control limit",
                                   "control limit (rough)",
                                   "PCC voltage minimum",
                                   "PCC voltage maximum",
                                   "DC voltage minimum",
                                   "DC voltage maximum"};
  return names[static_cast<std::size_t>(limit)];
}

const char* name(Verdict verdict) {
  constexpr const char* names[] = {"accepted", "outside the envelope", "bad request", "stale request",
                                   "unit blocked"};
  return names[static_cast<std::size_t>(verdict)];
}

std::string describe(const Decision& d, const Timing& timing) {
  if (d.verdict == Verdict::accepted && d.reference)
    return fmt::format(
        "accepted as reference {}: p = {:.6g}, q = {:.6g}, v_c = {:.6g}, ramp {:.6g} s from step {}",
        d.reference->id, d.setpoint.p, d.setpoint.q, d.setpoint.v_c,
        d.reference->ramp_steps * period_s(timing), d.reference->effective_step);
  std::string text = fmt::format("rejected: {}", name(d.verdict));
  if (d.verdict == Verdict::bad_request || d.verdict == Verdict::stale_request)
    fmt::format_to(std::back_inserter(text), ": {}; allowed: {}", name(d.field), allowed(d.field));
  if (d.verdict == Verdict::unit_blocked) text += " by a trip: weakgrid operate reset";
  const char* separator = ": ";
  for (const LimitMargin& margin : d.margins) {
    if (!violated(margin)) continue;
    fmt::format_to(std::back_inserter(text), "{}{}, margin {:.6f}", separator, name(margin.limit),
                   margin.margin);
    separator = "; ";
  }
  return text;
}

}  // namespace weakgrid
