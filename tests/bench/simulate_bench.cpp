// A whole scenario in one process, as `weakgrid simulate` plays it: unit, controller, supervisor, digest.
// 50 µs and 4 substeps; x_real_time is emulated over elapsed time on one processor.
#include <benchmark/benchmark.h>

#include "services/simulation.hpp"

namespace weakgrid {
namespace {

constexpr double end_s = 2.0;

void simulate_paper_weak(benchmark::State& state) {
  Settings settings;
  settings.grid.reactance = 0.3;
  settings.timing.period_us = 50;
  settings.plant.substeps = 4;
  settings.scenario.emplace();
  settings.scenario->end_s = end_s;
  settings.scenario->setpoints = {
      TimedSetpoint{.at_s = 0.01, .active_power = 0.707, .reactive_power = {}, .dc_voltage = {}},
      TimedSetpoint{.at_s = 0.11, .active_power = {}, .reactive_power = 0.707, .dc_voltage = {}}};
  for (auto _ : state) {
    const SimulationResult result = simulate(settings, {});
    if (result.trip != Trip::none) state.SkipWithError("the unit has tripped");
    benchmark::DoNotOptimize(result.digest.data());
  }
  const double runs = static_cast<double>(state.iterations());
  state.counters["x_real_time"] = benchmark::Counter(end_s * runs, benchmark::Counter::kIsRate);
  state.counters["steps"] = benchmark::Counter(end_s / 50e-6 * runs, benchmark::Counter::kIsRate);
}
BENCHMARK(simulate_paper_weak)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace weakgrid
