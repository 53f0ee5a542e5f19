// The paper's simulations (Section V) in the sampled form that we ship: unit and controller in one process.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <string>
#include <tuple>

#include "gateway/steady_state.hpp"
#include "tests/support/loop.hpp"

namespace weakgrid {
namespace {

using test::inductive_grid;
using test::LoopCase;
using test::Outcome;
using test::Settled;

constexpr Timing turning(std::int64_t period_ns, std::uint8_t delay) {
  return {period_ns, delay, Hold::turning, Sampling::instantaneous};
}
constexpr Timing still(std::int64_t period_ns, std::uint8_t delay) {
  return {period_ns, delay, Hold::still, Sampling::period_mean};
}
constexpr std::array timings{turning(50'000, 0), turning(50'000, 1), turning(100'000, 0), turning(100'000, 1),
                             still(50'000, 0),   still(50'000, 1),   still(100'000, 0),   still(100'000, 1)};

double relative(double value, double expected) { return std::abs(value / expected - 1.0); }

// The largest relative error of p against the energy balance, q and v_c against their references.
double settled_error(const Settled& settled, double q_r) {
  return std::max({relative(settled.p, settled.p_balance), relative(settled.q, q_r),
                   relative(settled.v_c, test::v_c_nominal)});
}

void expect_settles(const LoopCase& loop_case, double tolerance) {
  const Outcome outcome = run(loop_case);
  EXPECT_EQ(outcome.trip, Trip::none) << name(outcome.trip);
  EXPECT_EQ(outcome.settled.saturated_steps, 0u);
  EXPECT_LT(settled_error(outcome.settled, loop_case.orders.back().q), tolerance);
  EXPECT_LT(relative(outcome.settled.p_balance, loop_case.orders.back().p), tolerance);
}

// The paper's poles, and those we ship, whose slowest is slower.
constexpr SettlingTimes paper_poles = test::paper_settling_times_s;
const SettlingTimes shipped_poles = ControllerConfiguration{}.settling_times_s;

using Sampled = std::tuple<Timing, SettlingTimes>;

std::string sampled_name(const ::testing::TestParamInfo<Sampled>& instance) {
  const auto& [timing, poles] = instance.param;
  return std::to_string(timing.period_ns / 1000) + "us_delay" + std::to_string(timing.delay) +
         (timing.hold == Hold::still ? "_still" : "_turning") +
         (poles == paper_poles ? "" : "_shipped_poles");
}

class PaperLoop : public ::testing::TestWithParam<Sampled> {
 protected:
  Timing timing = std::get<0>(GetParam());
  LoopCase loop_case{.timing = timing, .settling_times_s = std::get<1>(GetParam())};
};
INSTANTIATE_TEST_SUITE_P(Timings, PaperLoop,
                         ::testing::Combine(::testing::ValuesIn(timings),
                                            ::testing::Values(paper_poles, shipped_poles)),
                         sampled_name);

// What we promise, and a closer bound that a change of the law must not lose unseen.
struct Bounds {
  double promised, measured;
};
Bounds bounds_for(const Timing& timing) {
  return timing.hold == Hold::turning ? Bounds{1e-3, 1e-9} : Bounds{1e-2, 2e-4};
}

void expect_tracks_the_paper_profile(const LoopCase& loop_case) {
  const Outcome outcome = run(loop_case);
  const Bounds bounds = bounds_for(loop_case.timing);
  const double error = settled_error(outcome.settled, 0.707);
  EXPECT_LT(error, bounds.promised);
  EXPECT_LT(error, bounds.measured);
  EXPECT_LT(relative(outcome.settled.p_balance, 0.707), bounds.measured);
  EXPECT_EQ(outcome.seen.saturated_steps, 0u);
  EXPECT_EQ(outcome.trip, Trip::none);
  EXPECT_GT(outcome.seen.v_c_min, 0.96 * test::v_c_nominal);
  EXPECT_LT(outcome.seen.v_c_max, 1.04 * test::v_c_nominal);
}

TEST_P(PaperLoop, StrongGridTracksBothPowersWithoutSaturation) { expect_tracks_the_paper_profile(loop_case); }

TEST_P(PaperLoop, WeakGridXg03TracksBothPowersWithoutSaturation) {
  loop_case.grid = inductive_grid(0.3);
  expect_tracks_the_paper_profile(loop_case);
}

// Z_b = 1 Ω in place of 10 Ω: a tenth of the energy, so the ramps saturate μ on the weak grid.
TEST_P(PaperLoop, TenthOfTheCapacitanceStillSettlesOnTheStrongGrid) {
  loop_case.C = 4.8e-5;
  expect_settles(loop_case, bounds_for(timing).promised);
}

TEST_P(PaperLoop, TenthOfTheCapacitanceRecoversFromSaturationOnTheWeakGrid) {
  loop_case.C = 4.8e-5;
  loop_case.grid = inductive_grid(0.3);
  expect_settles(loop_case, bounds_for(timing).promised);
}

TEST_P(PaperLoop, OperatingPointIsTheOneOfTheClosedForm) {
  loop_case.grid = inductive_grid(0.3);
  const Settled settled = run(loop_case).settled;
  const SteadyState expected = steady_state({0.0, 0.3}, 1.0, {0.707, 0.707});
  ASSERT_TRUE(expected.exists);
  const double measured = timing.hold == Hold::turning ? 1e-9 : 1e-4;
  EXPECT_NEAR(settled.v_p, abs(expected.v_p), measured);
  EXPECT_NEAR(settled.i, abs(expected.i), measured);
}

LoopCase paper_case(double X_g) {
  return {.grid = inductive_grid(X_g), .settling_times_s = test::paper_settling_times_s};
}

TEST(PaperLoopWeakGrid, OperatingPointHasThePrintedVoltageAndCurrent) {
  const Settled settled = run(paper_case(0.3)).settled;
  EXPECT_NEAR(settled.v_p, 1.16531, 0.000'006);
  EXPECT_NEAR(settled.i, 0.85801, 0.000'006);
}

// The two figures: perfect tracking on the strong grid, coupling that dies out on the weak one.
TEST(PaperLoopStrongGrid, PowersNeverOvershootVisibly) {
  const Outcome outcome = run(paper_case(0.0));
  EXPECT_LT(outcome.seen.p_max, 0.7075);
  EXPECT_LT(outcome.seen.q_max, 0.7075);
}

TEST(PaperLoopWeakGrid, CouplingOfThePowersStaysAsMeasured) {
  const Outcome outcome = run(paper_case(0.3));
  EXPECT_NEAR(outcome.seen.p_max, 0.719, 0.001);
  EXPECT_NEAR(outcome.seen.q_max, 0.779, 0.001);
}

class PaperGrids : public ::testing::TestWithParam<int> {};
INSTANTIATE_TEST_SUITE_P(HundredthsOfXg, PaperGrids, ::testing::Range(0, 41, 5));

TEST_P(PaperGrids, OneRhoSettlesAt100MicrosecondsWithOneStepOfDelay) {
  LoopCase loop_case = paper_case(0.01 * GetParam());
  expect_settles(loop_case, 1e-6);  // X_g = 0.40 still converges, at 3e-7; the others are below 1e-9
  loop_case.settling_times_s = ControllerConfiguration{}.settling_times_s;
  expect_settles(loop_case, 1e-6);
}

TEST(PaperLoopGrids, ResistiveGridSettlesWhereTheClosedFormSays) {
  LoopCase loop_case = paper_case(0.25);
  loop_case.grid.R_g = 0.15;
  loop_case.orders = test::paper_profile(0.6, 0.2);
  const Outcome outcome = run(loop_case);
  const SteadyState expected = steady_state({0.15, 0.25}, 1.0, {0.6, 0.2});
  EXPECT_LT(settled_error(outcome.settled, 0.2), 1e-9);
  EXPECT_NEAR(outcome.settled.v_p, abs(expected.v_p), 1e-9);
  EXPECT_NEAR(outcome.settled.i, abs(expected.i), 1e-9);
  EXPECT_EQ(outcome.seen.saturated_steps, 0u);
}

// The paper's reason to exist.
class PaperNotch : public PaperLoop {};
INSTANTIATE_TEST_SUITE_P(Timings, PaperNotch,
                         ::testing::Combine(::testing::ValuesIn(timings),
                                            ::testing::Values(paper_poles, shipped_poles)),
                         sampled_name);

TEST_P(PaperNotch, WithoutItXg01LosesTheOperatingPoint) {
  loop_case.law = Law::unfiltered;
  loop_case.grid = inductive_grid(0.1);
  EXPECT_NE(run(loop_case).trip, Trip::none);
}

TEST_P(PaperNotch, WithItXg01KeepsTheOperatingPoint) {
  loop_case.grid = inductive_grid(0.1);
  expect_settles(loop_case, bounds_for(timing).measured);
}

TEST_P(PaperNotch, WithoutItXg001IsStillStable) {
  loop_case.law = Law::unfiltered;
  loop_case.grid = inductive_grid(0.01);
  expect_settles(loop_case, bounds_for(timing).measured);
}

TEST_P(PaperNotch, WithoutItTheStrongGridIsStable) {
  loop_case.law = Law::unfiltered;
  expect_settles(loop_case, bounds_for(timing).measured);
}

}  // namespace
}  // namespace weakgrid
