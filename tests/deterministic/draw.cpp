// Drawing: see the header.
#include "tests/deterministic/draw.hpp"

namespace weakgrid::deterministic {

Settings draw_settings(Dice& dice) {
  Settings s;
  s.plant.substeps = 4;
  s.plant.patience_s = 0.2;
  s.plant.precharge_s = 0.02;
  s.plant.starts_running = !dice.one_in(5);
  s.plant.overrun = dice.one_in(4) ? Overrun::block : Overrun::hold;
  s.timing.delay_steps = dice.one_in(4) ? 0 : 1;
  s.gateway.after_restart = dice.one_in(4) ? AfterRestart::fallback : AfterRestart::resume;
  s.gateway.fallback_ramp_s = 0.05;
  s.gateway.revalidate_s = dice.one_in(3) ? 0.1 : 0.2;
  if (dice.one_in(2)) {
    const double reactances[] = {0.0, 0.1, 0.2, 0.3};
    s.grid.reactance = dice.of(reactances);
  } else {
    // Slow enough for steps of 0.5 ms, and for holds of a machine that is busy.
    s.timing.period_us = 500;
    s.plant.pace = dice.one_in(3) ? Pace::lockstep : Pace::realtime;
    s.grid.reactance = 0.1;
    s.protection.holds_max = 100;
    s.controller.settling_times_s = {0.005, 0.0055, 0.2};
    s.controller.notch_settling_time_s = 0.25;
    s.gateway.decay_min_per_s = 1.0;
    s.gateway.ramp_s = 0.1;
    s.gateway.fallback_ramp_s = 0.1;
  }
  if (dice.one_in(2)) s.controller.redundancy = Redundancy::first;
  s.gateway.grid_reactance = Interval{0.8 * s.grid.reactance, 1.2 * s.grid.reactance};
  s.gateway.grid_voltage = Interval{0.97, 1.02};
  return s;
}

std::vector<Event> draw_events(Dice& dice, const Settings& s, std::uint64_t steps) {
  std::vector<Event> events;
  const auto at = [&](std::uint64_t least) {
    return least + static_cast<std::uint64_t>(dice.uniform(0.0, 0.4) * static_cast<double>(steps));
  };
  std::uint64_t step = 0;
  for (std::size_t n = dice.below(4); n > 0; --n) {
    step = at(step);
    const bool is_voltage = dice.one_in(2);
    const double X = s.grid.reactance * dice.uniform(0.5, 1.5);
    events.push_back({.step = step,
                      .quantity = is_voltage ? Quantity::grid_voltage : Quantity::grid_inductance,
                      .target = is_voltage ? dice.uniform(0.85, 1.08) : X / converter(s).omega,
                      .ramp_steps = static_cast<std::uint32_t>(dice.uniform(0.0, 400.0))});
  }
  return events;
}

Weather draw_weather(Dice& dice, const Settings& s) {
  const double often[] = {0.0, 0.0, 0.001, 0.02};
  Weather w{.lost = dice.of(often), .doubled = dice.of(often), .slow = dice.of(often)};
  if (s.plant.pace == Pace::realtime) {
    // There a loss is a hold, and a unit that only ever trips shows little.
    w.lost = 0.1 * w.lost;
  } else {
    w.least = 50us;
    w.most = 200us;
    w.slow_most = dice.one_in(2) ? 5ms : 100ms;
  }
  return w;
}

Settings broken_by(Bug bug, Settings s) {
  if (bug == Bug::no_envelope) {
    s.gateway.current_max = 3.0;
    s.gateway.pcc_voltage_min = 0.1;
    s.gateway.pcc_voltage_max = 3.0;
    s.gateway.dc_voltage_max = 2.5;
  }
  if (bug == Bug::no_protection) {
    s.protection.current_max = 100.0;
    s.protection.dc_voltage_min = 0.2;
    s.protection.dc_voltage_max = 9.0;
    s.protection.pcc_voltage_max = 9.0;
    s.protection.pcc_voltage_min = 0.0;
  }
  return s;
}

}  // namespace weakgrid::deterministic
