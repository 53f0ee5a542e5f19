// Laws of the plant's room: integration, steady state, energy, PCC voltage, delay, hold, events, orders and
// trips.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <limits>
#include <optional>
#include <random>
#include <string>
#include <tuple>

#include "gateway/steady_state.hpp"
#include "plant/emulator.hpp"

namespace weakgrid {
namespace {

constexpr double nan = std::numeric_limits<double>::quiet_NaN();
constexpr double inf = std::numeric_limits<double>::infinity();
constexpr double v_c_start = 1.8384776310850235;
constexpr std::uint32_t seed = 20'261'122;
const Converter converter;

Grid grid_of(double R_g, double X_g, double V = 1.0) { return {R_g, X_g / converter.omega, V}; }

Timing timing_of(std::int64_t period_ns, std::uint8_t delay = 1, Hold hold = Hold::turning) {
  return {period_ns, delay, hold, Sampling::instantaneous};
}

// |i|, |v_c| and v_p of two samples: the largest difference.
double distance(const Plant& x, const Plant& y) {
  return std::max({abs(x.i() - y.i()), std::abs(x.v_c() - y.v_c()), abs(x.v_p() - y.v_p())});
}
double distance_of_means(const Plant& x, const Plant& y) {
  return std::max(abs(x.i_mean() - y.i_mean()), abs(x.v_p_mean() - y.v_p_mean()));
}

// A disturbed unit: power flows in while μ turns on from idle.
Plant disturbed(Hold hold, unsigned substeps, const Grid& grid) {
  Plant plant(converter, timing_of(200'000, 1, hold), substeps, grid, v_c_start);
  for (int k = 0; k < 20; ++k) plant.advance(plant.mu_turned(), 0.5, grid);
  return plant;
}

TEST(PlantIntegration, HalvingTheSubstepDividesTheErrorBy16) {
  for (const Hold hold : {Hold::turning, Hold::still})
    for (const Grid& grid : {grid_of(0.0, 0.0), grid_of(0.05, 0.1), grid_of(0.0, 0.3)}) {
      const Plant exact = disturbed(hold, 1000, grid);
      double before = distance(disturbed(hold, 4, grid), exact);
      for (const unsigned substeps : {8u, 16u}) {
        const double after = distance(disturbed(hold, substeps, grid), exact);
        EXPECT_NEAR(before / after, 16.0, 3.0) << substeps << " substeps, L_g = " << grid.L_g;
        before = after;
      }
    }
}

std::string hold_name(Hold hold) { return hold == Hold::still ? "still" : "turning"; }
std::string name_of_hold(const ::testing::TestParamInfo<Hold>& instance) { return hold_name(instance.param); }

// At the defaults, in a transient.
class PlantAccuracy : public ::testing::TestWithParam<Hold> {
 protected:
  // The largest distance over 10 ms between ten substeps and a thousand.
  template <typename Distance>
  static double worst(Distance distance_of) {
    double largest = 0.0;
    for (const Grid& grid : {grid_of(0.0, 0.0), grid_of(0.05, 0.1), grid_of(0.0, 0.3)}) {
      Plant usual(converter, timing_of(100'000, 1, GetParam()), 10, grid, v_c_start);
      Plant fine(converter, timing_of(100'000, 1, GetParam()), 1000, grid, v_c_start);
      for (int k = 0; k < 100; ++k) {
        usual.advance(usual.mu_turned(), 0.5, grid);
        fine.advance(fine.mu_turned(), 0.5, grid);
        largest = std::max(largest, distance_of(usual, fine));
      }
    }
    return largest;
  }
};
INSTANTIATE_TEST_SUITE_P(Holds, PlantAccuracy, ::testing::Values(Hold::turning, Hold::still), name_of_hold);

TEST_P(PlantAccuracy, TenSubstepsIn100MicrosecondsLeaveAnErrorBelow1em7) { EXPECT_LT(worst(distance), 1e-7); }

TEST_P(PlantAccuracy, TenSubstepsIn100MicrosecondsLeaveAnErrorOfTheMeansBelow1em6) {
  EXPECT_LT(worst(distance_of_means), 1e-6);
}

// R_g damps the open loop, so that it settles by itself. 1 s is a whole number of grid periods: v_g = V.
class PlantAtRest : public ::testing::TestWithParam<double> {
 protected:
  static constexpr double R_g = 0.15, V = 0.95, p_i = 0.4;
  double X_g = GetParam();
  Grid grid = grid_of(R_g, X_g, V);
  Plant plant{converter, timing_of(100'000), 10, grid, v_c_start};

  void SetUp() override {
    for (int k = 0; k < 10'000; ++k) plant.advance(plant.mu_turned(), p_i, grid);
  }
};
INSTANTIATE_TEST_SUITE_P(Reactance, PlantAtRest, ::testing::Values(0.0, 0.1, 0.25));

TEST_P(PlantAtRest, SatisfiesThePhasorEquations) {
  const SpaceVector i = plant.i(), v_p = plant.v_p(), mu = plant.mu_turned();
  const SpaceVector v_g{V, 0.0}, Z_g{R_g, X_g};
  EXPECT_LT(abs(v_p - (v_g + Z_g * i)), 1e-9);
  EXPECT_LT(abs(plant.v_c() * mu - (v_p + converter.omega * converter.L * times_j(i))), 1e-9);
  EXPECT_NEAR(power(v_p, i).re, p_i, 1e-9);
}

TEST_P(PlantAtRest, TurnsWithTheGridAndKeepsItsMagnitudes) {
  const SpaceVector i = plant.i(), v_p = plant.v_p(), turn = unit_phasor(converter.omega * 100e-6);
  const double v_c = plant.v_c();
  plant.advance(plant.mu_turned(), p_i, grid);
  EXPECT_LT(abs(plant.i() - turn * i), 1e-9);
  EXPECT_LT(abs(plant.v_p() - turn * v_p), 1e-9);
  EXPECT_NEAR(plant.v_c(), v_c, 1e-9);
  // The mean of what turns lies half a period back, shortened to sinc(ωT/2).
  const SpaceVector half = unit_phasor(0.5 * converter.omega * 100e-6);
  const double sinc = half.im / (0.5 * converter.omega * 100e-6);
  EXPECT_LT(abs(plant.i_mean() - sinc * (half * i)), 1e-8);
  EXPECT_LT(abs(plant.v_p_mean() - sinc * (half * v_p)), 1e-8);
}

TEST_P(PlantAtRest, IsTheSteadyStateOfTheGateway) {
  const SpaceVector i = plant.i(), v_p = plant.v_p();
  const SteadyState expected = steady_state({R_g, X_g}, V, power(v_p, i));
  ASSERT_TRUE(expected.exists);
  EXPECT_LT(abs(expected.v_p - v_p), 1e-9);
  EXPECT_LT(abs(expected.i - i), 1e-9);
}

TEST(PlantEnergy, WhatTheSourceGivesIsDeliveredOrStored) {
  for (const Grid& grid : {grid_of(0.0, 0.0), grid_of(0.1, 0.0), grid_of(0.05, 0.3)}) {
    // Periods so short that Simpson's rule over their ends integrates the power at the PCC.
    const double T = 10e-6, p_i = 0.5;
    Plant plant(converter, timing_of(10'000), 2, grid, v_c_start);
    const auto stored = [&plant] {
      return 0.5 * (converter.L * abs2(plant.i()) + converter.C * plant.v_c() * plant.v_c());
    };
    const auto p = [&plant] { return power(plant.v_p(), plant.i()).re; };
    for (int grid_period = 0; grid_period < 2; ++grid_period) {
      const double before = stored();
      double delivered = 0.0;
      for (int k = 0; k < 1000; ++k) {
        const double start = p();
        plant.advance(plant.mu_turned(), p_i, grid);
        const double middle = p();
        plant.advance(plant.mu_turned(), p_i, grid);
        delivered += 2.0 * T / 6.0 * (start + 4.0 * middle + p());
      }
      EXPECT_NEAR(p_i * 2000 * T, delivered + stored() - before, 1e-10) << "L_g = " << grid.L_g;
    }
  }
}

TEST(PlantPccVoltage, IsTheGridVoltageOnAStrongGridWhateverFlows) {
  const Grid grid = grid_of(0.0, 0.0);
  Plant plant(converter, timing_of(100'000), 10, grid, v_c_start);
  const SpaceVector turn = unit_phasor(converter.omega * 100e-6);
  SpaceVector v_g{1.0, 0.0};
  for (int k = 0; k < 50; ++k) {
    plant.advance(1.01 * plant.mu_turned(), 0.3, grid);
    v_g = turn * v_g;
    EXPECT_LT(abs(plant.v_p() - v_g), 1e-14);
  }
  EXPECT_GT(abs(plant.i()), 0.1);
}

TEST(PlantPccVoltage, WithoutInductanceIsTheDropAtTheResistance) {
  const Grid grid = grid_of(0.2, 0.0);
  Plant plant(converter, timing_of(100'000), 10, grid, v_c_start);
  for (int k = 0; k < 200; ++k) plant.advance(plant.mu_turned(), 0.3, grid);
  const SpaceVector v_g = plant.v_p() - grid.R_g * plant.i();
  EXPECT_GT(abs(plant.i()), 0.1);
  EXPECT_LT(abs(v_g - SpaceVector{1.0, 0.0}), 1e-12);
}

TEST(PlantPccVoltage, JumpsByTheGridsShareOfWhatTheBridgeJumps) {
  for (const double X_g : {0.0, 0.02, 0.3})
    for (const double R_g : {0.0, 0.1}) {
      const Grid grid = grid_of(R_g, X_g);
      // Within a period of 1 ns nothing else moves.
      Plant on(converter, timing_of(1), 1, grid, v_c_start);
      Plant changed = on;
      const SpaceVector mu = on.mu_turned(), delta_mu{0.05, -0.1};
      on.advance(mu, 0.0, grid);
      changed.advance(mu + delta_mu, 0.0, grid);
      const double share = grid.L_g / (converter.L + grid.L_g);
      const SpaceVector expected = share * (v_c_start * delta_mu);
      EXPECT_LT(abs(changed.v_p() - on.v_p() - expected), 1e-6) << "X_g = " << X_g << ", R_g = " << R_g;
    }
}

// Two half periods are what one is made of.
TEST(PlantHold, TurningModulationTurnsAtOmegaWithinThePeriod) {
  const Grid grid = grid_of(0.02, 0.2);
  Plant whole(converter, timing_of(200'000, 0, Hold::turning), 20, grid, v_c_start);
  Plant halves(converter, timing_of(100'000, 0, Hold::turning), 10, grid, v_c_start);
  const SpaceVector mu{0.5, 0.1};
  whole.advance(mu, 0.3, grid);
  halves.advance(mu, 0.3, grid);
  halves.advance(unit_phasor(converter.omega * 100e-6) * mu, 0.3, grid);
  EXPECT_LT(distance(whole, halves), 1e-13);
}

TEST(PlantHold, StillModulationStandsWithinThePeriod) {
  const Grid grid = grid_of(0.02, 0.2);
  Plant whole(converter, timing_of(200'000, 0, Hold::still), 20, grid, v_c_start);
  Plant halves(converter, timing_of(100'000, 0, Hold::still), 10, grid, v_c_start);
  const SpaceVector mu{0.5, 0.1};
  whole.advance(mu, 0.3, grid);
  halves.advance(mu, 0.3, grid);
  halves.advance(mu, 0.3, grid);
  EXPECT_LT(distance(whole, halves), 1e-13);
}

TEST(PlantHold, GridPhasorKeepsItsLengthThroughAMillionPeriods) {
  const Grid grid = grid_of(0.0, 0.0);
  Plant plant(converter, timing_of(100'000), 1, grid, v_c_start);
  for (int k = 0; k < 1'000'000; ++k) plant.advance_blocked(grid);
  EXPECT_NEAR(abs(plant.v_p()), 1.0, 1e-14);
  EXPECT_NEAR(plant.v_p().re, 1.0, 1e-9);  // 5000 turns
}

EmulatorConfiguration weak_unit(std::uint8_t delay = 1, Hold hold = Hold::turning) {
  EmulatorConfiguration configuration;
  configuration.timing = timing_of(100'000, delay, hold);
  configuration.grid = grid_of(0.1, 0.3);
  return configuration;
}

// In limits and different at every step.
SpaceVector some_mu(std::uint64_t step) {
  const double x = static_cast<double>(step % 97) / 97.0;
  return {0.4 + 0.1 * x, 0.2 - 0.1 * x * x};
}

bool same_bits(double x, double y) {
  return std::bit_cast<std::uint64_t>(x) == std::bit_cast<std::uint64_t>(y);
}
bool same(const Measurement& x, const Measurement& y) {
  return x.step == y.step && x.timing == y.timing && x.reference_id == y.reference_id &&
         x.blocked == y.blocked && x.state == y.state && same_bits(x.v_p.re, y.v_p.re) &&
         same_bits(x.v_p.im, y.v_p.im) && same_bits(x.i.re, y.i.re) && same_bits(x.i.im, y.i.im) &&
         same_bits(x.v_c, y.v_c) && same_bits(x.p_i, y.p_i);
}

// One that holds says so.
Measurement but_for_the_state(Measurement m) {
  m.state = UnitState::running;
  return m;
}

TEST(EmulatorDelay, WithoutItTheModulationWorksFromItsOwnSampleOn) {
  Emulator one(weak_unit(0), {}), other(weak_unit(0), {});
  one.advance(some_mu(1));
  other.advance(some_mu(2));
  EXPECT_NE(one.sample().i, other.sample().i);
}

TEST(EmulatorDelay, WithOneStepTheModulationWorksFromTheNextSampleOn) {
  Emulator one(weak_unit(1), {}), other(weak_unit(1), {});
  one.advance(some_mu(1));
  other.advance(some_mu(2));
  EXPECT_TRUE(same(one.sample(), other.sample()));
  one.advance(some_mu(3));
  other.advance(some_mu(3));
  EXPECT_NE(one.sample().i, other.sample().i);
}

TEST(EmulatorDelay, OneStepLaterIsTheSameModulationSentOneStepEarlier) {
  Emulator at_once(weak_unit(0), {}), delayed(weak_unit(1), {});
  at_once.advance(std::nullopt);  // from idle the delayed unit goes on for a step of its own
  delayed.advance(some_mu(1));
  EXPECT_EQ(at_once.sample().i, delayed.sample().i);
  for (std::uint64_t k = 1; k < 100; ++k) {
    at_once.advance(some_mu(k));
    delayed.advance(some_mu(k + 1));
    ASSERT_EQ(at_once.sample().i, delayed.sample().i) << "step " << k;
    ASSERT_EQ(at_once.sample().v_p, delayed.sample().v_p) << "step " << k;
  }
}

using DelayAndHold = std::tuple<std::uint8_t, Hold>;
class EmulatorHold : public ::testing::TestWithParam<DelayAndHold> {
 protected:
  EmulatorConfiguration configuration = weak_unit(std::get<0>(GetParam()), std::get<1>(GetParam()));
};
std::string name_of_delay_and_hold(const ::testing::TestParamInfo<DelayAndHold>& instance) {
  return "delay" + std::to_string(std::get<0>(instance.param)) + "_" + hold_name(std::get<1>(instance.param));
}
INSTANTIATE_TEST_SUITE_P(All, EmulatorHold,
                         ::testing::Combine(::testing::Values(0, 1),
                                            ::testing::Values(Hold::turning, Hold::still)),
                         name_of_delay_and_hold);

TEST_P(EmulatorHold, MissingModulationIsTheLastOneTurnedOn) {
  Emulator held(configuration, {}), told(configuration, {});
  const SpaceVector turn = unit_phasor(configuration.converter.omega * 100e-6);
  SpaceVector mu = some_mu(1);
  held.advance(mu);
  told.advance(mu);
  for (int k = 0; k < 10; ++k) {
    mu = mu * turn;
    held.advance(std::nullopt);
    told.advance(mu);
    ASSERT_TRUE(same(but_for_the_state(held.sample()), told.sample())) << "after " << k + 1 << " holds";
  }
  EXPECT_EQ(held.counters().holds, 10u);
  EXPECT_EQ(told.counters().holds, 0u);
}

TEST_P(EmulatorHold, IdleUnitHeldStaysIdle) {
  Emulator emulator(configuration, {});
  for (int k = 0; k < 20; ++k) emulator.advance(std::nullopt);
  EXPECT_LT(abs(emulator.sample().i), configuration.timing.hold == Hold::turning ? 1e-12 : 0.1);
  EXPECT_EQ(emulator.trip(), Trip::none);
}

TEST_P(EmulatorHold, BlocksAfterMoreThanMaxHoldsInARow) {
  configuration.protection.max_holds = 5;
  Emulator emulator(configuration, {});
  for (int k = 0; k < 5; ++k) emulator.advance(std::nullopt);
  EXPECT_EQ(emulator.trip(), Trip::none);
  emulator.advance(std::nullopt);
  EXPECT_EQ(emulator.trip(), Trip::modulation_lost);
  EXPECT_EQ(emulator.trip_step(), 6u);
  EXPECT_TRUE(emulator.sample().blocked);
}

TEST_P(EmulatorHold, OneModulationInBetweenKeepsItRunning) {
  configuration.protection = {.i_max = 100.0, .v_c_max = 100.0, .v_c_min = 0.1, .max_holds = 5};
  Emulator emulator(configuration, {});
  for (int round = 0; round < 20; ++round) {
    for (int k = 0; k < 5; ++k) emulator.advance(std::nullopt);
    const Measurement m = emulator.sample();
    emulator.advance((1.0 / m.v_c) * m.v_p);
  }
  EXPECT_EQ(emulator.trip(), Trip::none);
  EXPECT_EQ(emulator.counters().holds, 100u);
}

TEST_P(EmulatorHold, ModulationOutOfLimitsIsRefusedCountedAndHeld) {
  const double mu_max = configuration.converter.mu_max;
  for (const SpaceVector bad : {SpaceVector{nan, 0.0}, SpaceVector{0.0, nan}, SpaceVector{inf, 0.0},
                                SpaceVector{0.0, -inf}, SpaceVector{1.0, 0.0}, SpaceVector{0.6, 0.6},
                                SpaceVector{mu_max * (1.0 + 2e-9), 0.0}, SpaceVector{1e300, 1e300}}) {
    Emulator refusing(configuration, {}), missing(configuration, {});
    refusing.advance(bad);
    missing.advance(std::nullopt);
    EXPECT_EQ(refusing.counters().refused, 1u);
    EXPECT_EQ(refusing.counters().holds, 1u);
    EXPECT_EQ(missing.counters().refused, 0u);
    refusing.advance(some_mu(1));
    missing.advance(some_mu(1));
    EXPECT_TRUE(same(refusing.sample(), missing.sample())) << bad.re << ", " << bad.im;
  }
}

TEST_P(EmulatorHold, ModulationOnTheLimitIsTakenDespiteItsRounding) {
  Emulator emulator(configuration, {});
  emulator.advance(SpaceVector{0.0, configuration.converter.mu_max * (1.0 + 1e-10)});
  EXPECT_EQ(emulator.counters().refused, 0u);
  EXPECT_EQ(emulator.counters().holds, 0u);
}

double raised_cosine(double from, double to, std::uint64_t start, std::uint32_t steps, std::uint64_t step) {
  if (step <= start) return from;
  if (step >= start + steps) return to;
  return from + (to - from) * 0.5 * (1.0 - std::cos(pi * static_cast<double>(step - start) / steps));
}

double value_of(Quantity quantity, const Emulator& emulator) {
  switch (quantity) {
    case Quantity::source_power:
      return emulator.sample().p_i;
    case Quantity::grid_resistance:
      return emulator.grid().R_g;
    case Quantity::grid_inductance:
      return emulator.grid().L_g;
    case Quantity::grid_voltage:
      return emulator.grid().V;
  }
  return nan;
}

// Small changes only: the unit has no controller.
struct Change {
  const char* name;
  Quantity quantity;
  double from, to;
};
class EmulatorEvent : public ::testing::TestWithParam<Change> {
 protected:
  static EmulatorConfiguration patient_unit() {
    EmulatorConfiguration configuration = weak_unit();
    configuration.protection.max_holds = 1000;
    return configuration;
  }
};
INSTANTIATE_TEST_SUITE_P(Quantities, EmulatorEvent,
                         ::testing::Values(Change{"source_power", Quantity::source_power, 0.0, 0.02},
                                           Change{"grid_resistance", Quantity::grid_resistance, 0.1, 0.3},
                                           Change{"grid_inductance", Quantity::grid_inductance,
                                                  0.3 / Converter{}.omega, 1e-4},
                                           Change{"grid_voltage", Quantity::grid_voltage, 1.0, 0.98}),
                         [](const auto& instance) { return std::string(instance.param.name); });

TEST_P(EmulatorEvent, AsAStepActsFromItsStepOn) {
  const auto [changed, quantity, from, to] = GetParam();
  const std::array events{Event{7, quantity, to, 0}};
  Emulator emulator(patient_unit(), events);
  for (std::uint64_t k = 0; k < 20; ++k) {
    EXPECT_EQ(value_of(quantity, emulator), k < 7 ? from : to) << "step " << k;
    emulator.advance(std::nullopt);
  }
}

TEST_P(EmulatorEvent, AtStepZeroActsFromTheStart) {
  const auto [changed, quantity, from, to] = GetParam();
  const std::array events{Event{0, quantity, to, 0}};
  EXPECT_EQ(value_of(quantity, Emulator(patient_unit(), events)), to);
}

TEST_P(EmulatorEvent, AsARampFollowsTheRaisedCosine) {
  const auto [changed, quantity, from, to] = GetParam();
  const std::array events{Event{7, quantity, to, 20}};
  Emulator emulator(patient_unit(), events);
  for (std::uint64_t k = 0; k < 40; ++k) {
    EXPECT_NEAR(value_of(quantity, emulator), raised_cosine(from, to, 7, 20, k), 1e-15) << "step " << k;
    emulator.advance(std::nullopt);
  }
}

TEST_P(EmulatorEvent, ThatInterruptsAnotherLeavesFromWhereThatStands) {
  const auto [changed, quantity, from, to] = GetParam();
  const std::array events{Event{5, quantity, to, 20}, Event{12, quantity, from, 20}};
  Emulator emulator(patient_unit(), events);
  double before = from, largest_change = 0.0;
  for (std::uint64_t k = 0; k < 40; ++k) {
    emulator.advance(std::nullopt);
    largest_change = std::max(largest_change, std::abs(value_of(quantity, emulator) - before));
    before = value_of(quantity, emulator);
  }
  EXPECT_EQ(before, from);
  EXPECT_LT(largest_change, 0.5 * pi * std::abs(to - from) / 20.0);
}

TEST(EmulatorEvents, OfDifferentQuantitiesRunSideBySide) {
  const std::array events{Event{2, Quantity::grid_resistance, 0.3, 10},
                          Event{2, Quantity::grid_voltage, 0.99, 0},
                          Event{4, Quantity::grid_inductance, 1e-4, 10}};
  EmulatorConfiguration configuration = weak_unit();
  configuration.protection.max_holds = 1000;
  Emulator emulator(configuration, events);
  for (int k = 0; k < 20; ++k) emulator.advance(std::nullopt);
  EXPECT_EQ(emulator.grid().R_g, 0.3);
  EXPECT_EQ(emulator.grid().L_g, 1e-4);
  EXPECT_EQ(emulator.grid().V, 0.99);
}

TEST(EmulatorEvents, OfTheSourceStandUntilTheNextReference) {
  const std::array events{Event{3, Quantity::source_power, 0.02, 0}};
  Emulator emulator(weak_unit(), events);
  ASSERT_TRUE(emulator.accept({.id = 1, .p = 0.01, .v_c = v_c_start}));
  EXPECT_EQ(emulator.sample().p_i, 0.01);
  for (int k = 0; k < 5; ++k) emulator.advance(std::nullopt);
  EXPECT_EQ(emulator.sample().p_i, 0.02);
  EXPECT_EQ(emulator.sample().reference_id, 1u);
  ASSERT_TRUE(emulator.accept({.id = 2, .p = 0.03, .v_c = v_c_start}));
  EXPECT_EQ(emulator.sample().p_i, 0.03);
}

TEST(EmulatorEvents, InductanceThatVanishesLeavesTheCurrentWhereItIs) {
  const std::array events{Event{50, Quantity::grid_inductance, 0.0, 0}};
  EmulatorConfiguration configuration = weak_unit();
  configuration.protection = {100.0, 100.0, 0.1, 1000};
  Emulator emulator(configuration, events);
  ASSERT_TRUE(emulator.accept({.id = 1, .p = 0.1, .v_c = v_c_start}));
  for (int k = 0; k < 100; ++k) {
    const SpaceVector before = emulator.sample().i;
    emulator.advance(std::nullopt);
    const Measurement m = emulator.sample();
    ASSERT_TRUE(finite(m.i) && finite(m.v_p) && std::isfinite(m.v_c)) << "step " << k;
    ASSERT_LT(abs(m.i - before), 0.3) << "step " << k;
  }
  EXPECT_EQ(emulator.grid().L_g, 0.0);
  EXPECT_EQ(emulator.trip(), Trip::none);
}

TEST(EmulatorReference, RampsTheSourceFromItsStepOn) {
  Emulator emulator(weak_unit(), {});
  ASSERT_TRUE(emulator.accept({.id = 4, .p = 0.02, .v_c = v_c_start, .effective_step = 5, .ramp_steps = 10}));
  for (std::uint64_t k = 0; k < 18; ++k) {
    EXPECT_NEAR(emulator.sample().p_i, raised_cosine(0.0, 0.02, 5, 10, k), 1e-16) << "step " << k;
    EXPECT_EQ(emulator.sample().reference_id, k < 5 ? 0u : 4u) << "step " << k;
    emulator.advance(std::nullopt);
  }
}

TEST(EmulatorReference, ThatIsLateStartsAtOnceWithItsWholeRamp) {
  Emulator emulator(weak_unit(), {});
  for (int k = 0; k < 10; ++k) emulator.advance(std::nullopt);
  ASSERT_TRUE(emulator.accept({.id = 1, .p = 0.02, .v_c = v_c_start, .effective_step = 3, .ramp_steps = 4}));
  EXPECT_EQ(emulator.sample().reference_id, 1u);
  EXPECT_EQ(emulator.sample().p_i, 0.0);
  for (int k = 0; k < 4; ++k) emulator.advance(std::nullopt);
  EXPECT_EQ(emulator.sample().p_i, 0.02);
}

TEST(EmulatorReference, NewerOneReplacesWhatIsPending) {
  Emulator emulator(weak_unit(), {});
  ASSERT_TRUE(emulator.accept({.id = 1, .p = 0.02, .v_c = v_c_start, .effective_step = 5}));
  ASSERT_TRUE(emulator.accept({.id = 2, .p = 0.01, .v_c = v_c_start, .effective_step = 8}));
  EXPECT_EQ(emulator.newest_reference_id(), 2u);
  for (std::uint64_t k = 0; k < 12; ++k) {
    EXPECT_EQ(emulator.sample().reference_id, k < 8 ? 0u : 2u) << "step " << k;
    EXPECT_EQ(emulator.sample().p_i, k < 8 ? 0.0 : 0.01) << "step " << k;
    emulator.advance(std::nullopt);
  }
}

TEST(EmulatorReference, StaleAndAbsurdOnesAreRefusedAndChangeNothing) {
  Emulator emulator(weak_unit(), {});
  ASSERT_TRUE(emulator.accept({.id = 5, .p = 0.01, .v_c = v_c_start}));
  const Measurement before = emulator.sample();
  EXPECT_FALSE(emulator.accept({.id = 5, .p = 0.02, .v_c = v_c_start}));
  EXPECT_FALSE(emulator.accept({.id = 4, .p = 0.02, .v_c = v_c_start}));
  EXPECT_FALSE(emulator.accept({.id = 0, .p = 0.02, .v_c = v_c_start}));
  for (const double p : {nan, inf, -inf, 10.001, -10.001, 1e300})
    EXPECT_FALSE(emulator.accept({.id = 6, .p = p, .v_c = v_c_start})) << p;
  EXPECT_EQ(emulator.newest_reference_id(), 5u);
  EXPECT_TRUE(same(emulator.sample(), before));
  EXPECT_TRUE(emulator.accept({.id = 6, .p = 0.02, .v_c = v_c_start}));
}

// What trips a unit, and how it is brought about.
struct Cause {
  const char* name;
  Trip trip;
  double p_i;  // from step 0 on
  double i_max;
  std::optional<SpaceVector> mu;  // at every step
};
class EmulatorTrip : public ::testing::TestWithParam<Cause> {
 protected:
  // Trips, at the latest within 200 steps.
  Emulator tripped(EmulatorConfiguration configuration = weak_unit()) const {
    configuration.protection.i_max = GetParam().i_max;
    const std::array events{Event{0, Quantity::source_power, GetParam().p_i, 0}};
    Emulator emulator(configuration, events);
    if (GetParam().trip == Trip::overrun) emulator.trip(Trip::overrun);
    for (int k = 0; k < 200 && emulator.trip() == Trip::none; ++k) emulator.advance(GetParam().mu);
    return emulator;
  }
};
INSTANTIATE_TEST_SUITE_P(
    Causes, EmulatorTrip,
    ::testing::Values(Cause{"overcurrent", Trip::overcurrent, 0.0, 2.0, SpaceVector{}},
                      Cause{"dc_overvoltage", Trip::dc_overvoltage, 1.0, 100.0, SpaceVector{}},
                      Cause{"dc_undervoltage", Trip::dc_undervoltage, -1.0, 100.0, SpaceVector{}},
                      Cause{"modulation_lost", Trip::modulation_lost, 0.0, 2.0, std::nullopt},
                      Cause{"from_outside", Trip::overrun, 0.5, 2.0, SpaceVector{}},
                      Cause{"infinite_source", Trip::not_finite, inf, 2.0, SpaceVector{}},
                      Cause{"source_not_a_number", Trip::not_finite, nan, 2.0, SpaceVector{}}),
    [](const auto& instance) { return std::string(instance.param.name); });

TEST_P(EmulatorTrip, IsNamedAndDated) {
  const Emulator emulator = tripped();
  EXPECT_EQ(emulator.trip(), GetParam().trip) << name(emulator.trip());
  EXPECT_EQ(emulator.trip_step(), emulator.step());
}

TEST_P(EmulatorTrip, OpensBridgeAndSourceAndStaysSo) {
  Emulator emulator = tripped();
  EXPECT_FALSE(emulator.trip(Trip::overrun)) << "of a unit that is open";
  const std::uint64_t trip_step = emulator.trip_step();
  for (int k = 0; k < 50; ++k) {
    const Measurement m = emulator.sample();
    EXPECT_TRUE(m.blocked);
    EXPECT_EQ(m.reference_id, 0u);
    EXPECT_EQ(m.i, SpaceVector{});
    EXPECT_EQ(m.p_i, 0.0);
    EXPECT_NEAR(abs(m.v_p), 1.0, 1e-12);
    EXPECT_EQ(m.v_c, v_c_start);
    emulator.advance(some_mu(emulator.step()));
  }
  EXPECT_EQ(emulator.trip(), GetParam().trip);
  EXPECT_EQ(emulator.trip_step(), trip_step);
}

TEST_P(EmulatorTrip, ResetBringsBackAnIdleUnitInPhaseWithTheGrid) {
  Emulator emulator = tripped();
  for (int k = 0; k < 33; ++k) emulator.advance(std::nullopt);
  emulator.reset_trip();
  EXPECT_EQ(emulator.trip(), Trip::none);
  for (int k = 0; k < 20; ++k) {
    const Measurement m = emulator.sample();
    EXPECT_FALSE(m.blocked);
    EXPECT_LT(abs(m.i), 1e-12);
    EXPECT_EQ(m.p_i, 0.0);
    EXPECT_NEAR(m.v_c, v_c_start, 1e-12);
    emulator.advance(std::nullopt);
  }
  EXPECT_EQ(emulator.trip(), Trip::none);
}

TEST_P(EmulatorTrip, NewOrderWaitsForTheReset) {
  EmulatorConfiguration configuration = weak_unit();
  Emulator emulator = tripped(configuration);
  ASSERT_TRUE(emulator.accept({.id = 1, .p = 0.01, .v_c = v_c_start}));
  for (int k = 0; k < 10; ++k) {
    EXPECT_EQ(emulator.sample().p_i, 0.0);
    EXPECT_EQ(emulator.sample().reference_id, 0u);
    emulator.advance(std::nullopt);
  }
  emulator.reset_trip();
  EXPECT_EQ(emulator.sample().reference_id, 1u);
  EXPECT_EQ(emulator.sample().p_i, 0.01);
}

// Runs a unit that is off until it is in `state`; the number of steps.
std::uint64_t run_until(Emulator& emulator, UnitState state, std::optional<SpaceVector> mu) {
  const std::uint64_t from = emulator.step();
  while (emulator.state() != state && emulator.step() < from + 10'000) emulator.advance(mu);
  return emulator.step() - from;
}

EmulatorConfiguration unit_that_is_off() {
  EmulatorConfiguration configuration = weak_unit();
  configuration.starts_running = false;
  configuration.precharge_steps = 100;
  return configuration;
}

TEST(EmulatorStart, FromOffThroughPrechargeAndReadyToRunning) {
  Emulator emulator(unit_that_is_off(), {});
  for (int k = 0; k < 20; ++k) {
    const Measurement m = emulator.sample();
    EXPECT_EQ(m.state, UnitState::off);
    EXPECT_TRUE(m.blocked);
    EXPECT_EQ(m.i, SpaceVector{});
    EXPECT_NEAR(abs(m.v_p), 1.0, 1e-12);
    EXPECT_EQ(m.v_c, 0.1 * v_c_start);
    emulator.advance(SpaceVector{});
  }
  ASSERT_TRUE(emulator.start());
  for (std::uint64_t k = 20; k < 120; ++k) {
    const Measurement m = emulator.sample();
    EXPECT_EQ(m.state, UnitState::precharge);
    EXPECT_TRUE(m.blocked);
    EXPECT_EQ(m.p_i, 0.0);
    EXPECT_NEAR(m.v_c, raised_cosine(0.1 * v_c_start, v_c_start, 20, 100, k), 1e-14) << "step " << k;
    emulator.advance(SpaceVector{});
  }
  // Answers in a row, not altogether.
  for (const bool answered : {false, true, false, true, true}) {
    EXPECT_EQ(emulator.state(), UnitState::ready);
    EXPECT_EQ(emulator.sample().v_c, v_c_start);
    EXPECT_TRUE(emulator.sample().blocked);
    emulator.advance(answered ? std::optional(SpaceVector{}) : std::nullopt);
  }
  EXPECT_EQ(emulator.state(), UnitState::running);
  EXPECT_FALSE(emulator.sample().blocked);
  EXPECT_EQ(emulator.counters().holds, 0u) << "nobody misses an answer to a unit that is open";
  for (int k = 0; k < 10; ++k) emulator.advance(std::nullopt);
  EXPECT_LT(abs(emulator.sample().i), 1e-12) << "it closes in phase with the grid";
}

TEST(EmulatorStart, UnusableAnswersKeepItReady) {
  Emulator emulator(unit_that_is_off(), {});
  emulator.start();
  run_until(emulator, UnitState::ready, std::nullopt);
  for (int k = 0; k < 50; ++k) emulator.advance(SpaceVector{nan, 0.0});
  for (int k = 0; k < 50; ++k) emulator.advance(SpaceVector{0.9, 0.0});
  EXPECT_EQ(emulator.state(), UnitState::ready);
}

TEST(EmulatorStart, OrderThatComesBeforeWaitsUntilItRuns) {
  Emulator emulator(unit_that_is_off(), {});
  ASSERT_TRUE(emulator.accept({.id = 1, .p = 0.01, .v_c = v_c_start, .lease_end_step = 10'000}));
  emulator.start();
  while (emulator.state() != UnitState::running) {
    ASSERT_EQ(emulator.sample().p_i, 0.0);
    ASSERT_EQ(emulator.sample().reference_id, 0u);
    emulator.advance(SpaceVector{});
  }
  EXPECT_EQ(emulator.sample().reference_id, 1u);
  EXPECT_EQ(emulator.sample().p_i, 0.01);
}

TEST(EmulatorHolding, AsLongAsAnswersAreMissing) {
  Emulator emulator(weak_unit(), {});
  for (const bool answered : {true, false, false, true, true, false}) {
    emulator.advance(answered ? std::optional(some_mu(0)) : std::nullopt);
    EXPECT_EQ(emulator.sample().state, answered ? UnitState::running : UnitState::holding);
    EXPECT_FALSE(emulator.sample().blocked);
  }
}

TEST(EmulatorStop, OpensAtOnceCancelsTheOrderAndDischarges) {
  EmulatorConfiguration configuration = weak_unit();
  configuration.precharge_steps = 100;
  Emulator emulator(configuration, {});
  ASSERT_TRUE(emulator.accept({.id = 1, .p = 0.02, .v_c = v_c_start}));
  for (int k = 0; k < 30; ++k) emulator.advance(std::nullopt);
  ASSERT_EQ(emulator.trip(), Trip::modulation_lost);
  ASSERT_TRUE(emulator.reset_trip());
  ASSERT_TRUE(emulator.accept({.id = 2, .p = 0.02, .v_c = v_c_start}));
  for (int k = 0; k < 5; ++k) emulator.advance(std::nullopt);
  const double v_c = emulator.sample().v_c;
  const std::uint64_t stop_step = emulator.step();
  ASSERT_TRUE(emulator.stop());
  for (std::uint64_t k = stop_step; k < stop_step + 200; ++k) {
    const Measurement m = emulator.sample();
    ASSERT_EQ(m.state, UnitState::off);
    ASSERT_TRUE(m.blocked);
    ASSERT_EQ(m.i, SpaceVector{});
    ASSERT_EQ(m.p_i, 0.0);
    ASSERT_EQ(m.reference_id, 0u);
    ASSERT_NEAR(m.v_c, raised_cosine(v_c, 0.1 * v_c_start, stop_step, 100, k), 1e-14) << "step " << k;
    emulator.advance(some_mu(k));
  }
  ASSERT_TRUE(emulator.start());
  run_until(emulator, UnitState::running, SpaceVector{});
  EXPECT_EQ(emulator.sample().reference_id, 0u) << "the order of before the stop";
  EXPECT_EQ(emulator.sample().p_i, 0.0);
}

// In every state, each operation: obeyed or not, and then nothing has happened.
TEST(EmulatorInterlocks, StartOnlyFromOffResetOnlyAfterATripStopFromAllButOff) {
  struct Case {
    UnitState state;
    bool start, reset, stop;
  };
  for (const Case& c :
       {Case{UnitState::off, true, false, false}, Case{UnitState::precharge, false, false, true},
        Case{UnitState::ready, false, false, true}, Case{UnitState::running, false, false, true},
        Case{UnitState::holding, false, false, true}, Case{UnitState::tripped, false, true, true}}) {
    Emulator unit(unit_that_is_off(), {});
    if (c.state != UnitState::off) unit.start();
    if (c.state == UnitState::ready) run_until(unit, c.state, std::nullopt);
    if (!is_blocked(c.state) || c.state == UnitState::tripped)
      run_until(unit, UnitState::running, SpaceVector{});
    if (c.state == UnitState::holding || c.state == UnitState::tripped)
      run_until(unit, c.state, std::nullopt);
    ASSERT_EQ(unit.state(), c.state) << name(unit.state());
    const auto expect = [&](bool obeys, UnitState after, bool (Emulator::*operate)() noexcept) {
      Emulator copy = unit;
      EXPECT_EQ((copy.*operate)(), obeys) << name(c.state);
      EXPECT_EQ(copy.state(), obeys ? after : c.state) << name(c.state);
      EXPECT_TRUE(obeys || same(copy.sample(), unit.sample())) << name(c.state);
    };
    expect(c.start, UnitState::precharge, &Emulator::start);
    expect(c.reset, UnitState::running, &Emulator::reset_trip);
    expect(c.stop, UnitState::off, &Emulator::stop);
  }
}

TEST(EmulatorStop, EndsATrip) {
  Emulator emulator(weak_unit(), {});
  for (int k = 0; k < 30; ++k) emulator.advance(std::nullopt);
  ASSERT_EQ(emulator.sample().state, UnitState::tripped);
  ASSERT_TRUE(emulator.stop());
  EXPECT_EQ(emulator.trip(), Trip::none);
  EXPECT_FALSE(emulator.reset_trip());
}

// The grid's voltage beyond a limit for as long, and for one step less.
TEST(EmulatorPccVoltage, OutsideItsBandForLongEnoughTripsAndIsNamed) {
  for (const auto& [voltage, trip] :
       {std::pair{1.61, Trip::pcc_overvoltage}, {0.29, Trip::pcc_undervoltage}}) {
    for (const std::uint64_t steps : {49u, 50u}) {
      const std::array events{Event{20, Quantity::grid_voltage, voltage, 0},
                              Event{20 + steps, Quantity::grid_voltage, 1.0, 0}};
      EmulatorConfiguration configuration;
      configuration.protection = {
          .i_max = 1e3, .v_c_max = 100.0, .v_c_min = 0.01, .max_holds = 1000, .v_p_steps = 50};
      configuration.grid.L_g = 0.001;    // the PCC is the converter's as well
      configuration.converter.L = 10.0;  // and now all the grid's
      Emulator emulator(configuration, events);
      for (int k = 0; k < 200; ++k) emulator.advance(std::nullopt);
      EXPECT_EQ(emulator.trip(), steps == 50 ? trip : Trip::none) << voltage << " " << name(emulator.trip());
      EXPECT_EQ(emulator.trip_step(), steps == 50 ? 70u : 0u);
    }
  }
}

TEST(EmulatorTrips, ResetWithoutOneDoesNothing) {
  Emulator emulator(weak_unit(), {}), untouched(weak_unit(), {});
  for (std::uint64_t k = 0; k < 20; ++k) {
    emulator.advance(some_mu(k));
    untouched.advance(some_mu(k));
    emulator.reset_trip();
    ASSERT_TRUE(same(emulator.sample(), untouched.sample())) << "step " << k;
  }
}

TEST(EmulatorTrips, OrderThatWasPendingIsForgotten) {
  EmulatorConfiguration configuration = weak_unit();
  configuration.protection.max_holds = 3;
  Emulator emulator(configuration, {});
  ASSERT_TRUE(emulator.accept({.id = 1, .p = 0.01, .v_c = v_c_start, .effective_step = 10}));
  for (int k = 0; k < 20; ++k) emulator.advance(std::nullopt);
  ASSERT_EQ(emulator.trip(), Trip::modulation_lost);
  emulator.reset_trip();
  EXPECT_EQ(emulator.sample().reference_id, 0u);
  EXPECT_EQ(emulator.sample().p_i, 0.0);
}

TEST(EmulatorTrips, FirstLimitThatIsViolatedIsNamed) {
  const Protection limits;
  EXPECT_EQ(check(limits, {2.0, 0.0}, 2.6), Trip::none);
  EXPECT_EQ(check(limits, {0.0, 0.0}, 1.2), Trip::none);
  EXPECT_EQ(check(limits, {2.01, 0.0}, 3.0), Trip::overcurrent);
  EXPECT_EQ(check(limits, {1.0, -1.0}, 2.61), Trip::dc_overvoltage);
  EXPECT_EQ(check(limits, {1.0, -1.0}, 1.19), Trip::dc_undervoltage);
  EXPECT_EQ(check(limits, {nan, 0.0}, 1.8), Trip::not_finite);
  EXPECT_EQ(check(limits, {0.0, inf}, 1.8), Trip::not_finite);
  EXPECT_EQ(check(limits, {3.0, 0.0}, nan), Trip::not_finite);
}

TEST(Emulator, SameInputsGiveTheSameBits) {
  const std::array events{Event{40, Quantity::grid_voltage, 0.9, 10},
                          Event{90, Quantity::source_power, 0.2, 0}};
  Emulator one(weak_unit(), events), other(weak_unit(), events);
  for (std::uint64_t k = 0; k < 300; ++k) {
    if (k == 20) {
      const Reference reference{.id = 1, .p = 0.1, .v_c = v_c_start, .effective_step = 30, .ramp_steps = 7};
      ASSERT_EQ(one.accept(reference), other.accept(reference));
    }
    const std::optional<SpaceVector> mu = k % 5 == 0 ? std::nullopt : std::optional(some_mu(k));
    one.advance(mu);
    other.advance(mu);
    ASSERT_TRUE(same(one.sample(), other.sample())) << "step " << k;
  }
}

TEST(Emulator, AnyModulationAndOrderLeaveAFiniteSample) {
  std::mt19937_64 bits(seed);
  const auto any = [&bits] { return std::bit_cast<double>(bits()); };
  const auto usual = [&bits] { return -1.0 + 2.0 * static_cast<double>(bits() >> 11) * 0x1p-53; };
  Emulator emulator(weak_unit(), {});
  std::uint64_t trips = 0;
  for (int k = 0; k < 20'000; ++k) {
    switch (bits() % 4) {
      case 0:
        emulator.advance(std::nullopt);
        break;
      case 1:
        emulator.advance(SpaceVector{any(), any()});
        break;
      default:
        emulator.advance(SpaceVector{usual(), usual()});
    }
    if (bits() % 16 == 0)
      emulator.accept({.id = static_cast<std::uint32_t>(k),
                       .p = bits() % 2 == 0 ? any() : 10.0 * usual(),
                       .q = any(),
                       .v_c = any(),
                       .effective_step = bits() >> (bits() % 64),
                       .ramp_steps = static_cast<std::uint32_t>(bits() >> (32 + bits() % 32))});
    const Measurement m = emulator.sample();
    ASSERT_TRUE(finite(m.i) && finite(m.v_p) && std::isfinite(m.v_c) && std::isfinite(m.p_i)) << "step " << k;
    if (emulator.trip() != Trip::none && bits() % 8 == 0) {
      ++trips;
      emulator.reset_trip();
    }
  }
  EXPECT_GT(trips, 100u);
}

}  // namespace
}  // namespace weakgrid
