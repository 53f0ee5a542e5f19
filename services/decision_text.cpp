// Decision text: see the header.
#include "services/decision_text.hpp"

#include <fmt/format.h>

#include <iterator>

namespace weakgrid {

namespace {

const char* name(Field field) {
  constexpr const char* names[] = {
      "none",           "client",     "id",     "given",          "active_power",
      "reactive_power", "dc_voltage", "ramp_s", "effective_step", "source or name",
      "lease_s",        "grid",       "kind"};
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
    case Field::source:
      return "source test, schedule or operation and a name that is not empty";
    case Field::lease_s:
      return "0 (default) or 0.001 to 86400";
    case Field::grid:
      return "intervals, the lower first: resistance and reactance 0 to 10, voltage 0.1 to 2";
    case Field::kind:
      return "set, accept, renew, take, release, grid, start, stop, reset";
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
                                   "DC voltage maximum",
                                   "decay of disturbances (1/s)",
                                   "transient voltage ratio"};
  return names[static_cast<std::size_t>(limit)];
}

const char* name(Verdict verdict) {
  constexpr const char* names[] = {"accepted",
                                   "outside the envelope",
                                   "bad request",
                                   "stale request",
                                   "unit blocked",
                                   "not authorised",
                                   "the way there leaves the envelope",
                                   "not stable",
                                   "no such offer",
                                   "nothing stands to renew",
                                   "interlocked"};
  return names[static_cast<std::size_t>(verdict)];
}

const char* name(RequestKind kind) {
  constexpr const char* names[] = {"set",  "accept", "renew", "take",  "release",
                                   "grid", "start",  "stop",  "reset", "revalidate"};
  return names[static_cast<std::size_t>(kind)];
}

const char* name(Source source) {
  constexpr const char* names[] = {"test", "schedule", "operation", "protection"};
  return names[static_cast<std::size_t>(source)];
}

std::string text_of(const Holder& holder) {
  return fmt::format("{} ({})", holder.name.text.data(), name(holder.source));
}

namespace {

std::string text_of(const Setpoint& s) {
  return fmt::format("p = {:.6g}, q = {:.6g}, v_c = {:.6g}", s.p, s.q, s.v_c);
}

std::string accepted_text(const Decision& d, const Timing& timing) {
  const double T = period_s(timing);
  if (d.kind == RequestKind::release) return "authority released";
  if (d.kind == RequestKind::take)
    return fmt::format("authority taken by {} until step {}", text_of(d.holder), d.held_until_step);
  if (d.kind == RequestKind::start || d.kind == RequestKind::reset)
    return fmt::format("the plant is told to {}", name(d.kind));
  if (d.kind == RequestKind::stop) return "the plant is told to stop; authority released";
  const std::string grid =
      d.kind == RequestKind::revalidate
          ? fmt::format("measured: |v_g| from {:.4g} to {:.4g}, the grid is not what was known",
                        d.measured_V.low, d.measured_V.high)
          : "grid taken";
  if (!d.reference) return grid + "; what stands stays";
  const Reference& r = *d.reference;
  if (r.renews != 0)
    return fmt::format("reference {} renewed as {}: lease to step {}", r.renews, r.id, r.lease_end_step);
  if (d.kind == RequestKind::set_grid || d.kind == RequestKind::revalidate)
    return fmt::format("{}; what stood is not admissible on it: reference {} derates to {} from step {}",
                       grid, r.id, text_of(Setpoint{r.p, r.q, r.v_c}), r.effective_step);
  return fmt::format(
      "accepted as reference {}: {}, ramp {:.6g} s from step {}, reached after {:.6g} s, lease {:.6g} s",
      r.id, text_of(d.setpoint), r.ramp_steps * T, r.effective_step, d.steps_to_reach * T,
      static_cast<double>(r.lease_end_step - r.effective_step) * T);
}

std::string interlock_text(const Decision& d) {
  if (d.kind == RequestKind::stop) return "the unit is off";
  const UnitState from = d.kind == RequestKind::start ? UnitState::off : UnitState::tripped;
  if (d.unit_state != from)
    return fmt::format("the unit is {}, {} needs {}", name(d.unit_state), name(d.kind), name(from));
  return "idle may not stand on every grid known: tell a narrower one (weakgrid grid) or lower "
         "decay_min_per_s";
}

}  // namespace

std::string describe(const Decision& d, const Timing& timing) {
  if (d.verdict == Verdict::accepted) return accepted_text(d, timing);
  std::string text = fmt::format("rejected: {}", name(d.verdict));
  const auto add = std::back_inserter(text);
  if (d.verdict == Verdict::bad_request || d.verdict == Verdict::stale_request)
    fmt::format_to(add, ": {}; allowed: {}", name(d.field), allowed(d.field));
  if (d.verdict == Verdict::unit_blocked)
    fmt::format_to(add, ": it is {}{}", name(d.unit_state),
                   d.unit_state == UnitState::tripped ? ": weakgrid operate reset"
                   : d.unit_state == UnitState::off   ? ": weakgrid operate start"
                                                      : "");
  if (d.verdict == Verdict::interlocked) fmt::format_to(add, ": {}", interlock_text(d));
  if (d.verdict == Verdict::not_authorised)
    fmt::format_to(add, ": {} holds authority until step {}", text_of(d.holder), d.held_until_step);
  if (d.verdict == Verdict::path_outside) fmt::format_to(add, " at {}", text_of(d.leaves_at));
  const char* separator = ": ";
  for (const LimitMargin& margin : d.margins) {
    if (!violated(margin)) continue;
    fmt::format_to(add, "{}{}, margin {:.6f}", separator, name(margin.limit), margin.margin);
    if (margin.required != 0.0) fmt::format_to(add, " of {:g} required", margin.required);
    separator = "; ";
  }
  if (d.offer)
    fmt::format_to(add, "; {} {}: weakgrid accept {}",
                   d.offer->is_detour ? "go first to" : "would be accepted:", text_of(d.offer->setpoint),
                   d.offer->token);
  return text;
}

}  // namespace weakgrid
