// One controller step, against the same arithmetic as one straight function. Both go over the same samples,
// from the same state; that they give the same bits is checked before anything is measured.
#include <benchmark/benchmark.h>

#include <array>
#include <cstdlib>
#include <vector>

#include "plant/emulator.hpp"
#include "tests/bench/straight_law.hpp"

namespace weakgrid {
namespace {

constexpr std::size_t laps_of = 2048;  // samples: 200 kB, within the second cache

// A unit at 50 µs on X_g = 0.3 whose source and grid move, while the controller's reference stands.
struct Course {
  ControllerConfiguration configuration;
  ControllerState start;
  std::vector<Measurement> samples;
  std::vector<SpaceVector> answers;
};

Course make_course() {
  Course course;
  course.configuration.timing.period_ns = 50'000;
  const double omega = course.configuration.converter.omega;
  EmulatorConfiguration unit;
  unit.timing = course.configuration.timing;
  unit.substeps = 4;
  unit.grid = {0.0, 0.3 / omega, 1.0};
  const std::array events{Event{200, Quantity::source_power, 0.5, 400},
                          Event{700, Quantity::grid_voltage, 0.97, 10},
                          Event{1200, Quantity::grid_inductance, 0.25 / omega, 300},
                          Event{1700, Quantity::source_power, -0.3, 1200}};
  Emulator emulator(unit, events);
  Controller controller(course.configuration);
  controller.accept({.id = 1, .q = 0.2, .v_c = 1.84, .effective_step = 1, .ramp_steps = 50});
  for (std::size_t k = 0; k < 100 + laps_of; ++k) {
    if (k == 100) course.start = controller.state();
    const Measurement sample = emulator.sample();
    const Modulation answer = controller.step(sample);
    emulator.advance(command(answer));
    if (k < 100) continue;
    course.samples.push_back(sample);
    course.answers.push_back(answer.mu);
  }
  return course;
}

bench::StraightLaw straight_law(const Course& course) {
  return {course.configuration, derive_constants(course.configuration), course.start.law};
}

// The reference stands throughout.
std::array<ShapedReference, 3> references(const Course& course) {
  const Ramp& q = course.start.references.q;
  const Ramp& v_c = course.start.references.v_c;
  const ShapedReference stands{q.to, 0.0, v_c.to, 0.0};
  return {stands, stands, stands};
}

const Course& course() {
  static const Course course = [] {
    Course made = make_course();
    bench::StraightLaw straight = straight_law(made);
    const auto given = references(made);
    for (std::size_t k = 0; k < laps_of; ++k)
      if (!(straight.step(made.samples[k], given) == made.answers[k])) {
        std::fprintf(stderr, "bench_controller: the straight function differs at step %zu\n", k);
        std::abort();
      }
    return made;
  }();
  return course;
}

void controller_step(benchmark::State& state) {
  const Course& c = course();
  Controller controller(c.configuration);
  controller.restore(c.start);
  std::size_t k = 0;
  for (auto _ : state) {
    benchmark::DoNotOptimize(controller.step(c.samples[k]));
    if (++k < laps_of) continue;
    k = 0;
    controller.restore(c.start);
  }
}
BENCHMARK(controller_step);

void straight_function(benchmark::State& state) {
  const Course& c = course();
  bench::StraightLaw straight = straight_law(c);
  const auto given = references(c);
  std::size_t k = 0;
  for (auto _ : state) {
    benchmark::DoNotOptimize(straight.step(c.samples[k], given));
    if (++k < laps_of) continue;
    k = 0;
    straight.restore(c.start.law);
  }
}
BENCHMARK(straight_function);

// What an answer carries besides μ: the name of the sample that it answers.
void straight_function_and_fingerprint(benchmark::State& state) {
  const Course& c = course();
  bench::StraightLaw straight = straight_law(c);
  const auto given = references(c);
  std::size_t k = 0;
  for (auto _ : state) {
    benchmark::DoNotOptimize(fingerprint(c.samples[k]));
    benchmark::DoNotOptimize(straight.step(c.samples[k], given));
    if (++k < laps_of) continue;
    k = 0;
    straight.restore(c.start.law);
  }
}
BENCHMARK(straight_function_and_fingerprint);

}  // namespace
}  // namespace weakgrid
