// What the pure rooms get of the settings: words and units of the file turned into the paper's symbols.
#include <algorithm>
#include <cmath>

#include "services/runtime/settings.hpp"

namespace weakgrid {

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
  c.grid = {s.gateway.grid_resistance.value_or(s.grid.resistance),
            s.gateway.grid_reactance.value_or(s.grid.reactance) / c.converter.omega,
            s.gateway.grid_voltage.value_or(s.grid.voltage)};
  c.limits = {.i_max = s.gateway.current_max,
              .v_p_min = s.gateway.pcc_voltage_min,
              .v_p_max = s.gateway.pcc_voltage_max,
              .v_c_min = s.gateway.dc_voltage_min,
              .v_c_max = s.gateway.dc_voltage_max};
  c.timing = timing(s);
  c.initial = {0.0, 0.0, s.converter.dc_voltage};
  c.default_ramp_s = s.gateway.ramp_s;
  c.lead_steps = s.gateway.lead_steps;
  return c;
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
  return {.client = client,
          .id = id,
          .given = (setpoint.active_power ? given_p : 0u) | (setpoint.reactive_power ? given_q : 0u) |
                   (setpoint.dc_voltage ? given_v_c : 0u),
          .p = setpoint.active_power.value_or(0.0),
          .q = setpoint.reactive_power.value_or(0.0),
          .v_c = setpoint.dc_voltage.value_or(0.0),
          .ramp_s = setpoint.ramp_s,
          .effective_step = step_at(s, setpoint.at_s)};
}

}  // namespace weakgrid
