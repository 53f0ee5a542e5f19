// One step of the emulated unit: sample, answer in, one period on.
#include <benchmark/benchmark.h>

#include "plant/emulator.hpp"

namespace weakgrid {
namespace {

void emulator_step(benchmark::State& state) {
  EmulatorConfiguration unit;
  unit.timing.period_ns = 50'000;
  unit.substeps = static_cast<unsigned>(state.range(0));
  unit.grid = {0.01, 0.3 / unit.converter.omega, 1.0};
  Emulator emulator(unit, {});
  // Idle is a steady state: the μ that holds it turns with the grid.
  const SpaceVector turn = unit_phasor(unit.converter.omega * period_s(unit.timing));
  SpaceVector mu = (turn * emulator.sample().v_p) / unit.v_c;
  for (auto _ : state) {
    benchmark::DoNotOptimize(emulator.sample());
    emulator.advance(mu);
    mu = turn * mu;
    mu = (1.5 - 0.5 * abs2(mu) * (unit.v_c * unit.v_c)) * mu;
  }
  if (emulator.trip() != Trip::none) state.SkipWithError("the unit has tripped");
}
BENCHMARK(emulator_step)->ArgName("substeps")->Arg(4)->Arg(10);

}  // namespace
}  // namespace weakgrid
