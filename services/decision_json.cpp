// Decision as JSON: words and units of the wire.
#include "services/decision_json.hpp"

#include <nlohmann/json.hpp>

#include "services/decision_text.hpp"

namespace weakgrid {

namespace {

nlohmann::json to_json(const Setpoint& s) {
  return {{"active_power", s.p}, {"reactive_power", s.q}, {"dc_voltage", s.v_c}};
}

}  // namespace

nlohmann::json to_json(const Decision& decision, const Timing& timing) {
  nlohmann::json margins = nlohmann::json::array();
  for (const LimitMargin& margin : decision.margins)
    margins.push_back({{"limit", name(margin.limit)},
                       {"enforced", margin.enforced},
                       {"margin", margin.margin},
                       {"required", margin.required},
                       {"violated", violated(margin)},
                       {"grid_resistance", margin.grid.R_g},
                       {"grid_inductance_s", margin.grid.L_g},
                       {"grid_voltage", margin.grid.V}});
  nlohmann::json out = to_json(decision.setpoint);
  out["request"] = name(decision.kind);
  out["verdict"] = name(decision.verdict);
  out["margins"] = margins;
  out["text"] = describe(decision, timing);
  out["decided_step"] = decision.decided_step;
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
  if (decision.held_until_step != 0)
    out["holder"] = {{"name", decision.holder.name.text.data()},
                     {"source", name(decision.holder.source)},
                     {"until_step", decision.held_until_step}};
  return out;
}

}  // namespace weakgrid
