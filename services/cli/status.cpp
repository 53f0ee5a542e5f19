// weakgrid status: the last word of every service of a unit, and how it measures now.
#include <fmt/format.h>

#include <chrono>
#include <nlohmann/json.hpp>
#include <thread>

#include "services/cli/client.hpp"
#include "services/cli/commands.hpp"
#include "services/cli/stage_text.hpp"
#include "services/decision_json.hpp"
#include "services/decision_text.hpp"
#include "services/runtime/program.hpp"

namespace weakgrid {

namespace {

nlohmann::json to_json(const Health& h, double age_s) {
  nlohmann::json counters = nlohmann::json::object();
  for (const Counter& counter : h.counters) counters[counter.name] = counter.value;
  return {{"service", h.service}, {"state", name(h.state)},
          {"step", h.step},       {"reference_id", h.reference_id},
          {"age_s", age_s},       {"text", h.text},
          {"counters", counters}, {"timings", to_json(h.timings)}};
}

void print(const Health& h, double age_s) {
  fmt::print("{:<16}{:<17}step {:<12} reference {:<6} heard {:.1f} s ago  {}\n", h.service, name(h.state),
             h.step, h.reference_id, age_s, h.text);
  for (const Counter& counter : h.counters)
    if (counter.value != 0) fmt::print("            {} {}\n", counter.name, counter.value);
  if (!h.timings.empty()) fmt::print("            {}", stage_head());
  for (const StageTiming& timing : h.timings) fmt::print("            {}", stage_line(timing.stage, timing));
}

void print(const Envelope& e) {
  fmt::print("standing: {}p {:.6g}, q {:.6g}, v_c {:.6g}{}{}\n",
             e.reference_id != 0 ? fmt::format("reference {}, ", e.reference_id) : "", e.setpoint.p,
             e.setpoint.q, e.setpoint.v_c,
             e.fallen_back           ? ", fallen back"
             : e.lease_end_step != 0 ? fmt::format(", lease to step {}", e.lease_end_step)
                                     : "",
             e.fallback_holds ? "" : "; the fallback does not hold on every grid that may be");
  fmt::print("authority: {}\n", e.held_until_step != 0
                                    ? fmt::format("{} until step {}", text_of(e.holder), e.held_until_step)
                                    : "nobody");
  fmt::print("grid known: R_g {:.4g} to {:.4g}, X_g {:.4g} to {:.4g}, |v_g| {:.4g} to {:.4g}\n",
             e.grid.R_g.low, e.grid.R_g.high, e.grid.X_g.low, e.grid.X_g.high, e.grid.V.low, e.grid.V.high);
}

}  // namespace

Command add_status(CLI::App& app) {
  struct Options {
    Where where;
    double wait_s = 2.0;
    bool json = false;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand(
      "status",
      "Shows who serves a unit, in what state, what stands, who holds authority, and what it measures.");
  command->add_option("--wait", options->wait_s, "how long to listen, seconds")
      ->check(CLI::Range(0.1, 3600.0))
      ->capture_default_str();
  command->add_flag("--json", options->json, "print JSON");
  add_where(*command, options->where);
  command->footer(
      "Example: weakgrid status --domain 0 --unit 1\n"
      "Exit: 0 plant, controller and gateway run, 1 one is missing or tripped, 2 bad usage.");
  return [options] {
    const Settings settings = options->where.settings();
    Client client(settings.unit.domain, settings.unit.number, settings.dds);
    std::mutex mutex;
    std::optional<Measurement> last;
    const Reader<Measurement> reader(client.bus(), settings.unit.number, [&](const Measurement& m, Arrival) {
      const std::lock_guard lock(mutex);
      last = m;
    });
    std::this_thread::sleep_for(std::chrono::duration<double>(options->wait_s));
    nlohmann::json services = nlohmann::json::array();
    std::map<std::string, bool> works{{"plant", false}, {"controller", false}, {"gateway", false}};
    for (const auto& [key, health] : client.peers()) {
      const double age_s = static_cast<double>(wall_time_ns() - health.wall_time_ns) * 1e-9;
      const bool lives = health.state != ServiceState::stopped && age_s < 5.0;
      if (lives && health.state != ServiceState::blocked_by_trip && counter(health, "tripped") == 0)
        works[health.service] = true;
      if (options->json)
        services.push_back(to_json(health, age_s));
      else
        print(health, age_s);
    }
    const std::lock_guard lock(mutex);
    nlohmann::json out{{"services", services}};
    if (last) {
      const SpaceVector s = power(last->v_p, last->i);
      if (options->json)
        out["measurement"] = {
            {"step", last->step},        {"active_power", s.re},          {"reactive_power", s.im},
            {"dc_voltage", last->v_c},   {"pcc_voltage", abs(last->v_p)}, {"current", abs(last->i)},
            {"source_power", last->p_i}, {"blocked", last->blocked}};
      else
        fmt::print("step {}: p {:.4f}, q {:.4f}, v_c {:.4f}, |v_p| {:.4f}, |i| {:.4f}{}\n", last->step, s.re,
                   s.im, last->v_c, abs(last->v_p), abs(last->i), last->blocked ? ", blocked" : "");
    }
    if (const auto envelope = client.envelope()) {
      if (options->json)
        out["envelope"] = to_json(*envelope);
      else
        print(*envelope);
    }
    bool all_work = true;
    for (const auto& [service, is_well] : works) {
      all_work = all_work && is_well;
      if (!is_well && !options->json)
        fmt::print("{}: none that works in domain {}\n", service, settings.unit.domain);
    }
    if (options->json) fmt::print("{}\n", out.dump(2));
    return all_work ? exit_done : exit_no;
  };
}

}  // namespace weakgrid
