// What a decision costs: the box search, the certificate and the nearest admissible setpoint included.
#include <benchmark/benchmark.h>

#include <random>
#include <string>

#include "controller/gains.hpp"
#include "gateway/arbiter.hpp"

namespace weakgrid {
namespace {

Arbiter::Configuration configuration() {
  Arbiter::Configuration c;
  const double omega = c.converter.omega;
  c.box = {{0.0, 0.05}, {0.2 / omega, 0.35 / omega}, {0.97, 1.03}};
  const Gains K = sampled_gains({0.001, 0.0011, 0.040}, 1e-4);
  c.loop = LoopModel{c.converter, K.k1, K.k2, K.k3, 92.0};
  return c;
}

Request request(double p, double q, std::uint32_t id) {
  Request r;
  r.client = 1;
  r.id = id;
  r.who.name.text = {'b'};
  r.given = given_p | given_q;
  r.p = p;
  r.q = q;
  return r;
}

void decide(benchmark::State& state, double p_low, double p_high, double q_low, double q_high) {
  Arbiter arbiter(configuration());
  std::mt19937_64 bits(1);
  std::uniform_real_distribution<double> p(p_low, p_high), q(q_low, q_high);
  std::uint32_t id = 0;
  std::uint64_t accepted = 0;
  for (auto _ : state) {
    ++id;
    const Decision d = arbiter.decide(request(p(bits), q(bits), id), 1000 + std::uint64_t{id} * 1000);
    accepted += d.verdict == Verdict::accepted;
  }
  // No counter: the CSV reporter aborts unless every benchmark has it.
  state.SetLabel(std::to_string(100 * accepted / id) + " % accepted");
}

BENCHMARK_CAPTURE(decide, accepted, 0.1, 0.6, 0.0, 0.2);
BENCHMARK_CAPTURE(decide, refused_with_offer, 0.9, 1.3, -0.9, -0.3);
BENCHMARK_CAPTURE(decide, anything, -1.2, 1.2, -1.0, 1.0);

// The larger part of a refusal: what it offers instead.
void offer(benchmark::State& state, Policy policy) {
  const Arbiter::Configuration c = configuration();
  AdmissibleArea area;
  std::mt19937_64 bits(1);
  std::uniform_real_distribution<double> p(0.9, 1.3), q(-0.9, -0.3);
  for (auto _ : state)
    benchmark::DoNotOptimize(
        nearest_admissible(area, c.box, c.converter, c.limits, {p(bits), q(bits), 1.84}, policy));
}

BENCHMARK_CAPTURE(offer, nearest, Policy::minimum_distance);
BENCHMARK_CAPTURE(offer, keep_p, Policy::keep_p);

void assess_a_box(benchmark::State& state) {
  const Arbiter::Configuration c = configuration();
  double p = 0.1;
  for (auto _ : state) {
    p = p < 0.9 ? p + 1e-6 : 0.1;
    benchmark::DoNotOptimize(assess(c.box, c.converter, c.limits, {p, 0.1, 1.84}));
  }
}
BENCHMARK(assess_a_box);

}  // namespace
}  // namespace weakgrid
