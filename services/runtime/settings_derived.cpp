// What the pure rooms get of the settings: words and units of the file turned into the paper's symbols.
#include <algorithm>
#include <cmath>

#include "services/runtime/settings.hpp"

namespace weakgrid {

Settings numbered(const Settings& settings, std::uint32_t n) {
  Settings own = settings;
  own.unit.number += n;
  return own;
}

Timing timing(const Settings& s) {
  return {.period_ns = std::int64_t{s.timing.period_us} * 1000,
          .delay = static_cast<std::uint8_t>(s.timing.delay_steps),
          .hold = s.timing.hold,
          .sampling = s.timing.sampling};
}

Converter converter(const Settings& s) {
  Converter c;
  c.omega = 2.0 * pi * s.converter.frequency_hz;
  c.L = s.converter.filter_reactance_pu / c.omega;
  c.C = s.converter.dc_capacitance_s;
  return c;
}

Grid grid(const Settings& s) {
  return {s.grid.resistance, s.grid.reactance / converter(s).omega, s.grid.voltage};
}

EmulatorConfiguration emulator_configuration(const Settings& s) {
  return {.converter = converter(s),
          .timing = timing(s),
          .grid = grid(s),
          .protection = {.i_max = s.protection.current_max,
                         .v_c_max = s.protection.dc_voltage_max,
                         .v_c_min = s.protection.dc_voltage_min,
                         .max_holds = s.protection.holds_max,
                         .v_p_max = s.protection.pcc_voltage_max,
                         .v_p_min = s.protection.pcc_voltage_min,
                         .v_p_steps = s.protection.pcc_voltage_steps},
          .substeps = s.plant.substeps,
          .v_c = s.converter.dc_voltage,
          .starts_running = s.plant.starts_running,
          .precharge_steps = static_cast<std::uint32_t>(step_at(s, s.plant.precharge_s))};
}

ControllerConfiguration controller_configuration(const Settings& s) {
  ControllerConfiguration c;
  c.converter = converter(s);
  c.timing = timing(s);
  c.law = s.controller.law;
  std::copy_n(s.controller.settling_times_s.begin(), 3, c.settling_times_s.begin());
  c.kappa = {settling_factor / s.controller.notch_settling_time_s, 0.0};
  c.rho = s.controller.predictor_rho;
  c.v_c = s.converter.dc_voltage;
  return c;
}

Arbiter::Configuration arbiter_configuration(const Settings& s) {
  Arbiter::Configuration c;
  c.converter = converter(s);
  const auto known = [](const std::optional<Interval>& told, double otherwise) {
    return told.value_or(Interval{otherwise, otherwise});
  };
  const Interval X_g = known(s.gateway.grid_reactance, s.grid.reactance);
  c.box = {known(s.gateway.grid_resistance, s.grid.resistance),
           {X_g.low / c.converter.omega, X_g.high / c.converter.omega},
           known(s.gateway.grid_voltage, s.grid.voltage)};
  c.limits = {.i_max = s.gateway.current_max,
              .v_p_min = s.gateway.pcc_voltage_min,
              .v_p_max = s.gateway.pcc_voltage_max,
              .v_c_min = s.gateway.dc_voltage_min,
              .v_c_max = s.gateway.dc_voltage_max,
              .reserve = {.steady_state = s.gateway.steady_state_reserve,
                          .current = s.gateway.current_reserve,
                          .control = s.gateway.control_reserve,
                          .pcc_voltage = s.gateway.pcc_voltage_reserve,
                          .dc_voltage = s.gateway.dc_voltage_reserve}};
  c.timing = timing(s);
  const ControllerConfiguration law = controller_configuration(s);
  if (law.law == Law::filtered) {
    const Gains K = sampled_gains(law.settling_times_s, period_s(c.timing));
    c.loop = LoopModel{c.converter, K.k1, K.k2, K.k3, law.kappa.re};
  }
  c.decay_min = s.gateway.decay_min_per_s;
  c.settling_s = std::max(*std::max_element(law.settling_times_s.begin(), law.settling_times_s.end()),
                          s.controller.notch_settling_time_s);
  c.initial = {0.0, 0.0, s.converter.dc_voltage};
  c.fallback = {s.gateway.fallback_active_power, s.gateway.fallback_reactive_power,
                s.gateway.fallback_dc_voltage.value_or(s.converter.dc_voltage)};
  c.default_ramp_s = s.gateway.ramp_s;
  c.fallback_ramp_s = s.gateway.fallback_ramp_s;
  c.default_lease_s = s.gateway.lease_s;
  c.offer_s = s.gateway.offer_s;
  c.lead_steps = s.gateway.lead_steps;
  return c;
}

GridEvidence::Configuration evidence_configuration(const Settings& s) {
  const double cycle_s = 1.0 / s.converter.frequency_hz;
  return {.cycle_steps = static_cast<std::uint32_t>(std::lround(cycle_s / period_s(timing(s)))),
          .cycles = static_cast<std::uint32_t>(std::ceil(s.gateway.revalidate_s / cycle_s - 1e-9)),
          .tolerance = s.gateway.grid_voltage_tolerance};
}

std::uint64_t step_at(const Settings& s, double t_s) {
  // A millionth of a step forgives the rounding of t/T.
  return static_cast<std::uint64_t>(std::ceil(t_s / period_s(timing(s)) - 1e-6));
}

std::vector<Event> events(const Settings& s) {
  std::vector<Event> out;
  if (!s.scenario) return out;
  const double omega = converter(s).omega;
  for (const auto& event : s.scenario->events)
    out.push_back({.step = step_at(s, event.at_s),
                   .quantity = event.quantity,
                   .target = event.quantity == Quantity::grid_inductance ? event.value / omega : event.value,
                   .ramp_steps = static_cast<std::uint32_t>(step_at(s, event.ramp_s))});
  return out;
}

Request request(const Settings& s, const TimedSetpoint& setpoint, std::uint64_t client, std::uint32_t id) {
  Request r;
  r.client = client;
  r.id = id;
  r.who.name.text = {'s', 'c', 'e', 'n', 'a', 'r', 'i', 'o'};
  r.given = (setpoint.active_power ? given_p : 0u) | (setpoint.reactive_power ? given_q : 0u) |
            (setpoint.dc_voltage ? given_v_c : 0u);
  r.p = setpoint.active_power.value_or(0.0);
  r.q = setpoint.reactive_power.value_or(0.0);
  r.v_c = setpoint.dc_voltage.value_or(0.0);
  r.ramp_s = setpoint.ramp_s;
  // What a scenario asks for shall not fall back before its end.
  const double to_end = s.scenario ? s.scenario->end_s - setpoint.at_s + 1.0 : 0.0;
  r.lease_s =
      setpoint.lease_s != 0.0 ? setpoint.lease_s : std::min(to_end, Arbiter::Configuration{}.max_lease_s);
  r.effective_step = step_at(s, setpoint.at_s);
  return r;
}

}  // namespace weakgrid
