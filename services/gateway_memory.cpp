// Gateway's memory: see the header.
#include "services/gateway_memory.hpp"

#include <algorithm>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "services/decision_json.hpp"
#include "services/decision_text.hpp"

namespace weakgrid {

namespace {

nlohmann::json order(const Reference& r) {
  return {{"id", r.id},
          {"renews", r.renews},
          {"active_power", r.p},
          {"reactive_power", r.q},
          {"dc_voltage", r.v_c},
          {"effective_step", r.effective_step},
          {"ramp_steps", r.ramp_steps},
          {"lease_end_step", r.lease_end_step},
          {"fallback_active_power", r.fallback_p},
          {"fallback_reactive_power", r.fallback_q},
          {"fallback_dc_voltage", r.fallback_v_c},
          {"fallback_ramp_steps", r.fallback_ramp_steps}};
}

Reference order(const nlohmann::json& j) {
  return {.id = j.at("id"),
          .p = j.at("active_power"),
          .q = j.at("reactive_power"),
          .v_c = j.at("dc_voltage"),
          .effective_step = j.at("effective_step"),
          .ramp_steps = j.at("ramp_steps"),
          .renews = j.at("renews"),
          .lease_end_step = j.at("lease_end_step"),
          .fallback_p = j.at("fallback_active_power"),
          .fallback_q = j.at("fallback_reactive_power"),
          .fallback_v_c = j.at("fallback_dc_voltage"),
          .fallback_ramp_steps = j.at("fallback_ramp_steps")};
}

nlohmann::json range(Interval x) { return {x.low, x.high}; }
Interval range(const nlohmann::json& j) { return {j.at(0), j.at(1)}; }

nlohmann::json to_json(const KnownGrid& g) {
  return {{"resistance", range(g.R_g)}, {"reactance", range(g.X_g)}, {"voltage", range(g.V)}};
}

nlohmann::json asked(const Request& r) {
  nlohmann::json out{{"id", r.id},
                     {"kind", name(r.kind)},
                     {"name", r.who.name.text.data()},
                     {"source", name(r.who.source)},
                     {"given", r.given},
                     {"active_power", r.p},
                     {"reactive_power", r.q},
                     {"dc_voltage", r.v_c},
                     {"ramp_s", r.ramp_s},
                     {"lease_s", r.lease_s},
                     {"token", r.token},
                     {"effective_step", r.effective_step}};
  if (r.kind == RequestKind::set_grid) out["grid"] = to_json(KnownGrid{r.R_g, r.X_g, r.V});
  return out;
}

}  // namespace

GatewayMemory recall(const std::string& path, std::uint32_t unit) {
  GatewayMemory memory;
  if (!std::filesystem::exists(path)) return memory;
  read_journal(path, [&](const JournalEntry& entry, const JournalPlace&) {
    const nlohmann::json& body = entry.body;
    if (body.value("unit", 0u) != unit) return;
    // An entry of a start knows no step yet.
    if (const std::uint64_t step = body.value("step", std::uint64_t{0}); step != 0) memory.step = step;
    if (entry.kind == "blocked" || entry.kind == "restarted") memory.authority.release();
    if (body.contains("order")) memory.reference = order(body["order"]);
    if (body.contains("authority")) {
      const nlohmann::json& held = body["authority"];
      Holder holder;
      const std::string text = held.at("name");
      std::copy_n(text.begin(), std::min(text.size(), holder.name.text.size() - 1), holder.name.text.begin());
      holder.source = static_cast<Source>(std::min(held.at("priority").get<int>(), int(Source::protection)));
      memory.authority.give(holder, held.at("until_step"));
    }
    if (body.contains("grid")) {
      const nlohmann::json& grid = body["grid"];
      memory.grid = {range(grid.at("resistance")), range(grid.at("reactance")), range(grid.at("voltage"))};
    }
  });
  return memory;
}

nlohmann::json entry(std::uint32_t unit, const Request* request, const Decision& decision,
                     const KnownGrid& grid, const Timing& timing) {
  const bool is_accepted = decision.verdict == Verdict::accepted;
  nlohmann::json body{{"unit", unit},
                      {"client", decision.client},
                      {"step", decision.decided_step},
                      {"accepted", is_accepted},
                      {"decision", to_json(decision, timing)},
                      {"text", describe(decision, timing)}};
  if (request != nullptr) body["request"] = asked(*request);
  if (decision.reference) body["order"] = order(*decision.reference);
  if (is_accepted && (decision.kind == RequestKind::set_grid || decision.kind == RequestKind::revalidate))
    body["grid"] = to_json(grid);
  body["authority"] = {{"name", decision.holder.name.text.data()},
                       {"priority", static_cast<int>(decision.holder.source)},
                       {"until_step", decision.held_until_step}};
  return body;
}

nlohmann::json entry(std::uint32_t unit, const std::string& text, const std::optional<Reference>& reference,
                     std::uint64_t step) {
  nlohmann::json body{{"unit", unit}, {"step", step}, {"text", text}};
  if (reference) body["order"] = order(*reference);
  return body;
}

}  // namespace weakgrid
