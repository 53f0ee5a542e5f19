// The schema of a settings file, once, for reading and for writing: every key with its unit, range and place.
#pragma once

#include "services/runtime/settings.hpp"

namespace weakgrid {

template <class Value>
struct Choice {
  const char* word;
  Value value;
};

inline constexpr Choice<Hold> holds[] = {{"turning", Hold::turning}, {"still", Hold::still}};
inline constexpr Choice<Sampling> samplings[] = {{"instantaneous", Sampling::instantaneous},
                                                 {"period_mean", Sampling::period_mean}};
inline constexpr Choice<Law> laws[] = {{"filtered", Law::filtered}, {"unfiltered", Law::unfiltered}};
inline constexpr Choice<bool> starts[] = {{"running", true}, {"off", false}};
inline constexpr Choice<AfterRestart> after_restarts[] = {{"resume", AfterRestart::resume},
                                                          {"fallback", AfterRestart::fallback}};
inline constexpr Choice<Pace> paces[] = {{"lockstep", Pace::lockstep}, {"realtime", Pace::realtime}};
inline constexpr Choice<LoopTransport> loop_transports[] = {{"udp", LoopTransport::udp},
                                                            {"data_sharing", LoopTransport::data_sharing}};
inline constexpr Choice<Redundancy> redundancies[] = {
    {"none", Redundancy::none}, {"first", Redundancy::first}, {"second", Redundancy::second}};
inline constexpr Choice<Overrun> overruns[] = {{"hold", Overrun::hold}, {"block", Overrun::block}};
inline constexpr Choice<Quantity> quantities[] = {{"source_power", Quantity::source_power},
                                                  {"grid_resistance", Quantity::grid_resistance},
                                                  {"grid_reactance", Quantity::grid_inductance},
                                                  {"grid_voltage", Quantity::grid_voltage}};

/// File has: section(name, fn), list(name, items, fn), number / count / flag / word / optional / text /
/// texts / numbers.
template <class File, class SettingsOrConst>
void visit(File& file, SettingsOrConst& s) {
  file.section("unit", [&](auto& f) {
    f.count("number", s.unit.number, 1, 4294967232);
    f.count("count", s.unit.count, 1, 64);
    f.count("domain", s.unit.domain, 0, 230);
  });
  file.section("converter", [&](auto& f) {
    f.number("frequency_hz", s.converter.frequency_hz, 10.0, 400.0);
    f.number("filter_reactance_pu", s.converter.filter_reactance_pu, 0.001, 1.0);
    f.number("dc_capacitance_s", s.converter.dc_capacitance_s, 1e-6, 1.0);
    f.number("dc_voltage", s.converter.dc_voltage, 0.1, 10.0);
  });
  file.section("timing", [&](auto& f) {
    f.count("period_us", s.timing.period_us, 10, 1000);
    f.count("delay_steps", s.timing.delay_steps, 0, 1);
    f.word("hold", s.timing.hold, holds);
    f.word("sampling", s.timing.sampling, samplings);
  });
  file.section("grid", [&](auto& f) {
    f.number("resistance", s.grid.resistance, 0.0, 10.0);
    f.number("reactance", s.grid.reactance, 0.0, 10.0);
    f.number("voltage", s.grid.voltage, 0.1, 2.0);
  });
  file.section("plant", [&](auto& f) {
    f.count("substeps", s.plant.substeps, 1, 1000);
    f.number("patience_s", s.plant.patience_s, 0.001, 3600.0);
    f.word("start", s.plant.starts_running, starts);
    f.number("precharge_s", s.plant.precharge_s, 0.001, 60.0);
    f.word("pace", s.plant.pace, paces);
    f.word("overrun", s.plant.overrun, overruns);
  });
  file.section("protection", [&](auto& f) {
    f.number("current_max", s.protection.current_max, 0.1, 50.0);
    f.number("dc_voltage_min", s.protection.dc_voltage_min, 0.05, 10.0);
    f.number("dc_voltage_max", s.protection.dc_voltage_max, 0.1, 10.0);
    f.number("pcc_voltage_min", s.protection.pcc_voltage_min, 0.0, 2.0);
    f.number("pcc_voltage_max", s.protection.pcc_voltage_max, 0.1, 10.0);
    f.count("pcc_voltage_steps", s.protection.pcc_voltage_steps, 1, 100000);
    f.count("holds_max", s.protection.holds_max, 0, 100000);
  });
  file.section("controller", [&](auto& f) {
    f.word("law", s.controller.law, laws);
    f.numbers("settling_times_s", s.controller.settling_times_s, 3, 1e-4, 10.0);
    f.number("notch_settling_time_s", s.controller.notch_settling_time_s, 1e-3, 100.0);
    f.number("predictor_rho", s.controller.predictor_rho, 0.0, 1.0);
    f.word("redundancy", s.controller.redundancy, redundancies);
    f.number("takeover_s", s.controller.takeover_s, 0.001, 10.0);
  });
  file.section("gateway", [&](auto& f) {
    f.interval("grid_resistance", s.gateway.grid_resistance, 0.0, 10.0);
    f.interval("grid_reactance", s.gateway.grid_reactance, 0.0, 10.0);
    f.interval("grid_voltage", s.gateway.grid_voltage, 0.1, 2.0);
    f.number("current_max", s.gateway.current_max, 0.01, 10.0);
    f.number("pcc_voltage_min", s.gateway.pcc_voltage_min, 0.0, 2.0);
    f.number("pcc_voltage_max", s.gateway.pcc_voltage_max, 0.1, 5.0);
    f.number("dc_voltage_min", s.gateway.dc_voltage_min, 0.1, 10.0);
    f.number("dc_voltage_max", s.gateway.dc_voltage_max, 0.1, 10.0);
    f.number("steady_state_reserve", s.gateway.steady_state_reserve, 0.0, 1.0);
    f.number("current_reserve", s.gateway.current_reserve, 0.0, 1.0);
    f.number("control_reserve", s.gateway.control_reserve, 0.0, 1.0);
    f.number("pcc_voltage_reserve", s.gateway.pcc_voltage_reserve, 0.0, 1.0);
    f.number("dc_voltage_reserve", s.gateway.dc_voltage_reserve, 0.0, 1.0);
    f.number("decay_min_per_s", s.gateway.decay_min_per_s, 0.0, 1000.0);
    f.number("ramp_s", s.gateway.ramp_s, 0.001, 60.0);
    f.number("lease_s", s.gateway.lease_s, 0.01, 86400.0);
    f.number("offer_s", s.gateway.offer_s, 0.1, 3600.0);
    f.number("revalidate_s", s.gateway.revalidate_s, 0.0, 3600.0);
    f.number("grid_voltage_tolerance", s.gateway.grid_voltage_tolerance, 0.001, 1.0);
    f.word("after_restart", s.gateway.after_restart, after_restarts);
    f.number("fallback_active_power", s.gateway.fallback_active_power, -10.0, 10.0);
    f.number("fallback_reactive_power", s.gateway.fallback_reactive_power, -10.0, 10.0);
    f.optional("fallback_dc_voltage", s.gateway.fallback_dc_voltage, 0.1, 10.0);
    f.number("fallback_ramp_s", s.gateway.fallback_ramp_s, 0.001, 60.0);
    f.count("lead_steps", s.gateway.lead_steps, 1, 1000000);
    f.text("journal", s.gateway.journal);
  });
  file.section("dds", [&](auto& f) {
    f.texts("interfaces", s.dds.interfaces, 1, 16);
    f.texts("peers", s.dds.peers, 0, 16);
    f.text("discovery_server", s.dds.discovery_server);
    f.text("security", s.dds.security);
    f.word("loop", s.dds.loop, loop_transports);
  });
  file.section("console", [&](auto& f) {
    f.text("address", s.console.address);
    f.count("port", s.console.port, 0, 65535);
    f.text("certificate", s.console.certificate);
    f.text("key", s.console.key);
    f.text("tokens", s.console.tokens);
    f.texts("hosts", s.console.hosts, 0, 16);
    f.texts("origins", s.console.origins, 0, 16);
  });
  file.section("realtime", [&](auto& f) {
    f.count("priority", s.realtime.priority, 0, 99);
    f.count("cpu", s.realtime.cpu, -1, 1023);
    f.flag("lock_memory", s.realtime.lock_memory);
    f.flag("dma_latency", s.realtime.dma_latency);
  });
  file.optional_section("scenario", s.scenario, [](auto& f, auto& scenario) {
    f.text("title", scenario.title);
    f.required("end_s", scenario.end_s, 1e-3, 1e6);
    f.list("setpoint", scenario.setpoints, [](auto& item, auto& setpoint) {
      item.required("at_s", setpoint.at_s, 0.0, 1e6);
      item.optional("active_power", setpoint.active_power, -10.0, 10.0);
      item.optional("reactive_power", setpoint.reactive_power, -10.0, 10.0);
      item.optional("dc_voltage", setpoint.dc_voltage, 0.01, 10.0);
      item.number("ramp_s", setpoint.ramp_s, 0.0, 60.0);
      item.number("lease_s", setpoint.lease_s, 0.0, 86400.0);
    });
    f.list("event", scenario.events, [](auto& item, auto& event) {
      item.required("at_s", event.at_s, 0.0, 1e6);
      item.word("quantity", event.quantity, quantities);
      item.required("value", event.value, -10.0, 10.0);
      item.number("ramp_s", event.ramp_s, 0.0, 3600.0);
    });
  });
}

}  // namespace weakgrid
