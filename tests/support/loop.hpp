// A unit and its controller closed into a loop in one process, and what is seen of it: for tests of both
// together.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <optional>
#include <vector>

#include "controller/controller.hpp"
#include "plant/emulator.hpp"

namespace weakgrid::test {

inline constexpr double v_c_nominal = 1.8384776310850235;  // 1.3·√2
inline constexpr double grid_period_s = 0.020;
inline constexpr SettlingTimes paper_settling_times_s{0.001, 0.0011, 0.020};

// In seconds and not in steps: the same profile runs at every sampling period.
struct Order {
  double at_s = 0.0;
  double p = 0.0;
  double q = 0.0;
  double ramp_s = 0.020;
  double v_c = v_c_nominal;
};

struct TimedEvent {
  double at_s = 0.0;
  Quantity quantity = Quantity::source_power;
  double target = 0.0;
  double ramp_s = 0.0;
};

/// The paper's simulation, with the ramps of equations.md (trap 4): p first, then q.
inline std::vector<Order> paper_profile(double p = 0.707, double q = 0.707) {
  return {{.at_s = 0.01, .p = p}, {.at_s = 0.11, .p = p, .q = q}};
}

/// Limits that only a lost operating point reaches.
inline constexpr Protection wide_protection{
    .i_max = 100.0, .v_c_max = 100.0, .v_c_min = 0.1, .max_holds = 20};

struct LoopCase {
  Timing timing{};
  Grid grid{};
  double C = 4.8e-4;
  double rho = 0.6;
  Law law = Law::filtered;
  SettlingTimes settling_times_s = ControllerConfiguration{}.settling_times_s;
  Protection protection{};
  unsigned substeps = 10;
  std::vector<Order> orders = paper_profile();
  std::uint32_t first_reference_id = 1;
  std::vector<TimedEvent> events{};
  double end_s = 0.40;
};

inline Grid inductive_grid(double X_g) { return {0.0, X_g / Converter{}.omega, 1.0}; }

/// Means over one grid period, taken from the samples.
struct Settled {
  double p = 0.0;
  double q = 0.0;
  double v_c = 0.0;
  double v_p = 0.0;        ///< of |v_p|
  double i = 0.0;          ///< of |i|
  double p_balance = 0.0;  ///< p by the energy balance: the source's, less what L and C took up
  std::uint64_t saturated_steps = 0;
};

/// Extremes and counts since the start.
struct Seen {
  double v_c_min = 1e9;
  double v_c_max = -1e9;
  double p_max = -1e9;
  double q_max = -1e9;
  double i_max = 0.0;
  std::uint64_t saturated_steps = 0;
  std::uint64_t last_saturated_step = 0;
};

inline EmulatorConfiguration emulator_configuration(const LoopCase& loop_case) {
  EmulatorConfiguration configuration;
  configuration.converter.C = loop_case.C;
  configuration.timing = loop_case.timing;
  configuration.grid = loop_case.grid;
  configuration.protection = loop_case.protection;
  configuration.substeps = loop_case.substeps;
  configuration.v_c = v_c_nominal;
  return configuration;
}

inline ControllerConfiguration controller_configuration(const LoopCase& loop_case) {
  ControllerConfiguration configuration;
  configuration.converter.C = loop_case.C;
  configuration.timing = loop_case.timing;
  configuration.law = loop_case.law;
  configuration.rho = loop_case.rho;
  configuration.settling_times_s = loop_case.settling_times_s;
  configuration.v_c = v_c_nominal;
  return configuration;
}

class Loop {
 public:
  explicit Loop(const LoopCase& loop_case)
      : case_(loop_case),
        unit_(emulator_configuration(loop_case), events()),
        controller_(controller_configuration(loop_case)) {
    take_orders();
  }

  /// One period.
  Modulation step() { return step_seeing(unit_.sample()); }

  /// One period in which the controller is shown `sample` instead of the unit's own.
  Modulation step_seeing(const Measurement& sample) {
    const Modulation answer = controller_.step(sample);
    note(unit_.sample(), answer);
    advance(answer.mu);
    return answer;
  }

  /// One period whose sample never reaches the controller: the unit holds.
  void step_missed() { advance(std::nullopt); }

  void run(std::uint64_t steps) {
    for (; steps > 0; --steps) step();
  }
  void run_to(double t_s) {
    while (unit_.step() < steps_of(t_s)) step();
  }

  /// Runs on for one grid period.
  Settled settled() {
    const std::uint64_t steps = steps_of(grid_period_s);
    const double n = static_cast<double>(steps);
    // A mean over a period T shortens what turns at ω to sinc(ωT/2): undone in the product of two means.
    const double half_angle = 0.5 * Converter{}.omega * period_s(case_.timing);
    const double sinc =
        case_.timing.sampling == Sampling::period_mean ? std::sin(half_angle) / half_angle : 1.0;
    const std::uint64_t saturated_before = seen_.saturated_steps;
    const double stored_before = stored_energy();
    Settled mean;
    for (std::uint64_t k = 0; k < steps; ++k) {
      step();
      const Measurement m = unit_.sample();
      const SpaceVector s = power(m.v_p, m.i) / (sinc * sinc);
      mean.p += s.re / n;
      mean.q += s.im / n;
      mean.v_c += m.v_c / n;
      mean.v_p += abs(m.v_p) / sinc / n;
      mean.i += abs(m.i) / sinc / n;
      mean.p_balance += m.p_i / n;
    }
    mean.p_balance -= (stored_energy() - stored_before) / (n * period_s(case_.timing));
    mean.saturated_steps = seen_.saturated_steps - saturated_before;
    return mean;
  }

  Emulator& unit() { return unit_; }
  Controller& controller() { return controller_; }
  const Seen& seen() const { return seen_; }
  double seconds(std::uint64_t step) const { return static_cast<double>(step) * period_s(case_.timing); }
  std::uint64_t steps_of(double t_s) const {
    return static_cast<std::uint64_t>(std::llround(t_s / period_s(case_.timing)));
  }

  /// A fresh controller that is told the newest order, as a process that starts anew.
  void replace_controller() {
    controller_ = Controller(controller_configuration(case_));
    if (next_order_ > 0) controller_.accept(reference(next_order_ - 1));
  }

 private:
  std::vector<Event> events() const {
    std::vector<Event> in_steps;
    for (const TimedEvent& event : case_.events)
      in_steps.push_back({steps_of(event.at_s), event.quantity, event.target,
                          static_cast<std::uint32_t>(steps_of(event.ramp_s))});
    return in_steps;
  }

  Reference reference(std::size_t n) const {
    const Order& order = case_.orders[n];
    return {.id = case_.first_reference_id + static_cast<std::uint32_t>(n),
            .p = order.p,
            .q = order.q,
            .v_c = order.v_c,
            .effective_step = steps_of(order.at_s),
            .ramp_steps = static_cast<std::uint32_t>(steps_of(order.ramp_s))};
  }

  void advance(std::optional<SpaceVector> mu) {
    unit_.advance(mu);
    take_orders();
  }

  // Each at the step at which it takes effect: neither side remembers more than one that is to come.
  void take_orders() {
    for (; next_order_ < case_.orders.size(); ++next_order_) {
      if (steps_of(case_.orders[next_order_].at_s) > unit_.step()) return;
      unit_.accept(reference(next_order_));
      controller_.accept(reference(next_order_));
    }
  }

  void note(const Measurement& m, const Modulation& answer) {
    const SpaceVector s = power(m.v_p, m.i);
    seen_.v_c_min = std::min(seen_.v_c_min, m.v_c);
    seen_.v_c_max = std::max(seen_.v_c_max, m.v_c);
    seen_.p_max = std::max(seen_.p_max, s.re);
    seen_.q_max = std::max(seen_.q_max, s.im);
    seen_.i_max = std::max(seen_.i_max, abs(m.i));
    if ((answer.status & saturated) != 0) {
      ++seen_.saturated_steps;
      seen_.last_saturated_step = m.step;
    }
  }

  double stored_energy() const {
    const Measurement m = unit_.sample();
    return 0.5 * (Converter{}.L * abs2(m.i) + case_.C * m.v_c * m.v_c);
  }

  LoopCase case_;
  Emulator unit_;
  Controller controller_;
  std::size_t next_order_ = 0;
  Seen seen_;
};

struct Outcome {
  Settled settled;
  Seen seen;
  Trip trip = Trip::none;
};

/// The whole case; settled over the grid period that ends at end_s.
inline Outcome run(const LoopCase& loop_case) {
  Loop loop(loop_case);
  loop.run_to(loop_case.end_s - grid_period_s);
  const Settled settled = loop.settled();
  return {settled, loop.seen(), loop.unit().trip()};
}

}  // namespace weakgrid::test
