// The law that ties the rooms together: what the envelope admits, the closed loop settles at, unsaturated and
// within limits; what lies beyond λ it does not. And where the loop's own dynamics ask for more than the
// envelope. WEAKGRID_LAW_COUNT sets how many random cases (default 60), WEAKGRID_LAW_SEED which; a failure
// prints the input.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <ostream>
#include <random>

#include "gateway/envelope.hpp"
#include "gateway/steady_state.hpp"
#include "tests/support/loop.hpp"

namespace weakgrid {
namespace {

using test::LoopCase;
using test::Outcome;

std::uint64_t from_environment(const char* variable, std::uint64_t otherwise) {
  const char* text = std::getenv(variable);
  return text != nullptr ? std::strtoull(text, nullptr, 10) : otherwise;
}
std::uint64_t law_count() { return from_environment("WEAKGRID_LAW_COUNT", 60); }
std::uint64_t law_seed() { return from_environment("WEAKGRID_LAW_SEED", 20'261'122); }

class Draw {
 public:
  double uniform(double low, double high) {
    return low + (high - low) * static_cast<double>(bits_() >> 11) * 0x1p-53;
  }
  template <typename T, std::size_t n>
  T one_of(const T (&choices)[n]) {
    return choices[bits_() % n];
  }

 private:
  std::mt19937_64 bits_{law_seed()};
};

struct Input {
  Timing timing;
  SpaceVector Z_g;
  Setpoint setpoint;
};

std::ostream& operator<<(std::ostream& out, const Input& x) {
  out.precision(17);
  return out << "seed " << law_seed() << ": Z_g = " << x.Z_g.re << " + j" << x.Z_g.im
             << ", p = " << x.setpoint.p << ", q = " << x.setpoint.q << ", v_c = " << x.setpoint.v_c
             << ", T = " << x.timing.period_ns << " ns, delay " << int{x.timing.delay}
             << (x.timing.hold == Hold::still ? ", still" : ", turning");
}

Timing draw_timing(Draw& draw) {
  const bool still = draw.uniform(0.0, 1.0) < 0.25;
  return {.period_ns = draw.one_of<std::int64_t>({50'000, 100'000}),
          .delay = draw.one_of<std::uint8_t>({0, 1}),
          .hold = still ? Hold::still : Hold::turning,
          .sampling = still ? Sampling::period_mean : Sampling::instantaneous};
}

// p ≥ 0 mostly.
Input draw_input(Draw& draw) {
  Input x;
  x.timing = draw_timing(draw);
  x.Z_g = {draw.uniform(0.0, 0.2), draw.uniform(0.0, 0.4)};
  x.setpoint.p = draw.uniform(-0.15, 1.0);
  x.setpoint.q = draw.uniform(-0.8, 1.0);
  x.setpoint.v_c = draw.uniform(1.7, 2.2);
  return x;
}

Grid grid_of(const Input& x) { return {x.Z_g.re, x.Z_g.im / Converter{}.omega, 1.0}; }

LoopCase case_of(const Input& x) {
  LoopCase loop_case;
  loop_case.timing = x.timing;
  loop_case.grid = grid_of(x);
  loop_case.substeps = 4;
  loop_case.orders = test::paper_profile(x.setpoint.p, x.setpoint.q);
  for (test::Order& order : loop_case.orders) order.v_c = x.setpoint.v_c;
  loop_case.end_s = 0.6;
  return loop_case;
}

// The envelope is static. The loop is damped by K̂_2r of eq:K2_est, and by what a slow v̂_p leaves in e_vp: of
// ė_ξ1 = ê_ξ2 − Re(ĩ e_vp) the term L_g di/dt makes ê_ξ2 + τ dê_ξ2/dt with τ = L_g p/|v_p|². Power that is
// delivered damps; power that is drawn takes damping away. 1/s.
double damping(const Input& x, const SteadyState& ss) {
  const Converter converter;
  const Grid grid = grid_of(x);
  const Gains K = sampled_gains(ControllerConfiguration{}.settling_times_s, period_s(x.timing));
  const double tau = grid.L_g * x.setpoint.p / abs2(ss.v_p);
  return (grid.R_g + converter.L * (K.k2 + K.k1 * tau)) / (converter.L + grid.L_g);
}

// Where the loop follows the envelope. Nearer to λ = 0 or less damped it may not: of 4385 admitted setpoints
// with p ≥ −0.3 (100 µs, delay 1, ρ = 0.6) 155 did not settle, 6 of them with p ≥ 0; of those with λ ≥ 0.55
// the best damped had 332/s (363/s at 50 µs). This leaves out 5 % of the setpoints with p ≥ 0.
bool is_damped(const Input& x, const SteadyState& ss) { return damping(x, ss) >= 450.0 && ss.lambda >= 0.55; }

TEST(ClosedLoopLaw, WhatTheEnvelopeAdmitsTheLoopSettlesAtUnsaturatedAndWithinLimits) {
  Draw draw;
  const Limits limits;
  for (std::uint64_t n = 0; n < law_count();) {
    const Input x = draw_input(draw);
    if (!assess(grid_of(x), Converter{}, limits, x.setpoint).admissible) continue;
    const SteadyState ss = steady_state(x.Z_g, 1.0, {x.setpoint.p, x.setpoint.q});
    if (!is_damped(x, ss)) continue;
    ++n;
    const auto [settled, seen, trip] = run(case_of(x));
    // The ripple of a still hold is in the samples, and its power in p.
    const double tolerance = x.timing.hold == Hold::still ? 1e-3 : 1e-4;
    EXPECT_EQ(trip, Trip::none) << x << ": " << name(trip);
    EXPECT_EQ(settled.saturated_steps, 0u) << x;
    EXPECT_NEAR(settled.p, x.setpoint.p, tolerance) << x;
    EXPECT_NEAR(settled.q, x.setpoint.q, tolerance) << x;
    EXPECT_NEAR(settled.v_c, x.setpoint.v_c, tolerance) << x;
    EXPECT_NEAR(settled.v_p, abs(ss.v_p), tolerance) << x;
    EXPECT_NEAR(settled.i, abs(ss.i), tolerance) << x;
    EXPECT_LE(settled.i, limits.i_max + tolerance) << x;
    EXPECT_GE(settled.v_p, limits.v_p_min - tolerance) << x;
    EXPECT_LE(settled.v_p, limits.v_p_max + tolerance) << x;
    if (HasFailure()) return;
  }
}

TEST(ClosedLoopLaw, WhatLiesBeyondLambdaTheLoopDoesNotSettleAt) {
  Draw draw;
  for (std::uint64_t n = 0; n < law_count();) {
    Input x = draw_input(draw);
    x.Z_g.im = draw.uniform(0.2, 0.4);
    x.setpoint.q = draw.uniform(-1.5, -0.4);
    const SteadyState ss = steady_state(x.Z_g, 1.0, {x.setpoint.p, x.setpoint.q});
    if (!(ss.lambda < -0.05)) continue;
    ++n;
    ASSERT_FALSE(assess(grid_of(x), Converter{}, Limits{}, x.setpoint).admissible) << x;
    const auto [settled, seen, trip] = run(case_of(x));
    const double error = std::max(std::abs(settled.p - x.setpoint.p), std::abs(settled.q - x.setpoint.q));
    EXPECT_TRUE(trip != Trip::none || !(error < 0.01)) << x << ": error " << error;
    if (HasFailure()) return;
  }
}

// The stretch of grids on which a unit may wait for its first setpoint.
class IdleUnit : public ::testing::TestWithParam<std::uint8_t> {};
INSTANTIATE_TEST_SUITE_P(Delay, IdleUnit, ::testing::Values(0, 1));

void expect_stays_idle(std::int64_t period_ns, std::uint8_t delay, double X_g) {
  LoopCase loop_case;
  loop_case.timing.period_ns = period_ns;
  loop_case.timing.delay = delay;
  loop_case.grid = test::inductive_grid(X_g);
  loop_case.orders.clear();
  loop_case.end_s = 1.0;
  const Outcome outcome = run(loop_case);
  EXPECT_EQ(outcome.trip, Trip::none) << "X_g = " << X_g;
  EXPECT_NEAR(outcome.settled.v_c, test::v_c_nominal, 1e-9) << "X_g = " << X_g;
  EXPECT_NEAR(outcome.settled.i, 0.0, 1e-9) << "X_g = " << X_g;
}

TEST_P(IdleUnit, KeepsItsOperatingPointUpToXg035At100Microseconds) {
  for (const double X_g : {0.0, 0.1, 0.2, 0.3, 0.35}) expect_stays_idle(100'000, GetParam(), X_g);
}

TEST_P(IdleUnit, KeepsItsOperatingPointUpToXg04At50Microseconds) {
  for (const double X_g : {0.0, 0.1, 0.2, 0.3, 0.4}) expect_stays_idle(50'000, GetParam(), X_g);
}

}  // namespace
}  // namespace weakgrid
