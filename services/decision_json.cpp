// Decision as JSON: words and units of the wire.
#include "services/decision_json.hpp"

#include <nlohmann/json.hpp>

#include "services/decision_text.hpp"

namespace weakgrid {

namespace {

nlohmann::json to_json(const Setpoint& s) {
  return {{"active_power", s.p}, {"reactive_power", s.q}, {"dc_voltage", s.v_c}};
}

nlohmann::json to_json(const Holder& holder, std::uint64_t until_step) {
  return {{"name", holder.name.text.data()}, {"source", name(holder.source)}, {"until_step", until_step}};
}

}  // namespace

nlohmann::json to_json(const Margins& margins) {
  nlohmann::json out = nlohmann::json::array();
  for (const LimitMargin& margin : margins)
    out.push_back({{"limit", name(margin.limit)},
                   {"enforced", margin.enforced},
                   {"margin", margin.margin},
                   {"required", margin.required},
                   {"violated", violated(margin)},
                   {"grid_resistance", margin.grid.R_g},
                   {"grid_inductance_s", margin.grid.L_g},
                   {"grid_voltage", margin.grid.V}});
  return out;
}

nlohmann::json to_json(const Decision& decision, const Timing& timing) {
  nlohmann::json out = to_json(decision.setpoint);
  out["request"] = name(decision.kind);
  out["verdict"] = name(decision.verdict);
  out["margins"] = to_json(decision.margins);
  out["text"] = describe(decision, timing);
  out["decided_step"] = decision.decided_step;
  out["unit_state"] = name(decision.unit_state);
  if (decision.kind == RequestKind::revalidate)
    out["measured_grid_voltage"] = {decision.measured_V.low, decision.measured_V.high};
  out["reference_id"] = decision.reference ? decision.reference->id : 0;
  if (decision.reference) {
    const Reference& r = *decision.reference;
    out["reference"] = to_json(Setpoint{r.p, r.q, r.v_c});
    out["effective_step"] = r.effective_step;
    out["ramp_steps"] = r.ramp_steps;
    out["lease_end_step"] = r.lease_end_step;
    out["steps_to_reach"] = decision.steps_to_reach;
  }
  if (decision.offer) {
    out["offer"] = to_json(decision.offer->setpoint);
    out["offer"]["token"] = decision.offer->token;
    out["offer"]["is_detour"] = decision.offer->is_detour;
    out["offer"]["valid_until_step"] = decision.offer->valid_until_step;
  }
  if (decision.verdict == Verdict::path_outside) out["leaves_at"] = to_json(decision.leaves_at);
  if (decision.held_until_step != 0) out["holder"] = to_json(decision.holder, decision.held_until_step);
  return out;
}

nlohmann::json to_json(const Envelope& e) {
  nlohmann::json out{{"step", e.step},
                     {"reference_id", e.reference_id},
                     {"standing", to_json(e.setpoint)},
                     {"lease_end_step", e.lease_end_step},
                     {"fallen_back", e.fallen_back},
                     {"fallback_holds", e.fallback_holds},
                     {"grid_resistance", {e.grid.R_g.low, e.grid.R_g.high}},
                     {"grid_reactance", {e.grid.X_g.low, e.grid.X_g.high}},
                     {"grid_voltage", {e.grid.V.low, e.grid.V.high}},
                     {"margins", to_json(e.margins)}};
  if (e.held_until_step != 0) out["holder"] = to_json(e.holder, e.held_until_step);
  return out;
}

}  // namespace weakgrid
