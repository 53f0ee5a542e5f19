// The decay of small disturbances, against eigenvalues, and against the loop that runs.
#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <complex>

#include "controller/controller.hpp"
#include "gateway/loop_decay.hpp"
#include "gateway/steady_state.hpp"
#include "plant/emulator.hpp"
#include "tests/support/law_input.hpp"

namespace weakgrid {
namespace {

LoopModel model_of(std::int64_t period_ns, double slowest_s) {
  const Gains K = sampled_gains({0.001, 0.0011, slowest_s}, static_cast<double>(period_ns) * 1e-9);
  return {Converter{}, K.k1, K.k2, K.k3, 92.0};
}

// The same equations written once more, with complex numbers and unknowns by name.
double slowest_by_eigenvalues(const LoopModel& m, const Grid& grid, SpaceVector v_p, SpaceVector current) {
  using C = std::complex<double>;
  const double L = m.converter.L, L_g = grid.L_g;
  const C j{0, 1}, v{v_p.re, v_p.im}, i{current.re, current.im}, Z = grid.R_g + j * m.converter.omega * L_g;
  Eigen::Matrix<double, 8, 8> A;
  for (int k = 0; k < 8; ++k) {
    double x[8] = {};
    x[k] = 1.0;
    const C di{x[0], x[1]}, w{x[2], x[3]}, e1{x[4], x[5]}, y{x[6], x[7]};
    const C e2 = -std::conj(v) * di - std::conj(w) * i;
    const C slope = (w + L * (m.k1 * e1 + m.k2 * e2 + m.k3 * y) / std::conj(v) - Z * di) / (L + L_g);
    const C dv = L_g * slope + Z * di;
    const C filter = m.kappa * (dv - w);
    const double energy =
        -std::real(dv * std::conj(i) + v * std::conj(di)) + L * std::norm(i) * std::real(filter / v);
    A.col(k) << slope.real(), slope.imag(), filter.real(), filter.imag(), energy, e2.imag(), e1.real(),
        e1.imag();
  }
  return -A.eigenvalues().real().maxCoeff();
}

double decay_at(const LoopModel& model, const Grid& grid, SpaceVector v_p, SpaceVector i) {
  return loop_decay(loop_polynomial(model, grid, v_p, i));
}

TEST(LoopDecayLaw, IsThatOfTheSlowestEigenvalue) {
  for (std::uint64_t n = 0; n < law_count(5'000); ++n) {
    LawInput input(n);
    const GridBox box = input.box(0.2, 0.45);
    const Grid grid = input.within(box);
    const SteadyState at = steady_state({grid.R_g, Converter{}.omega * grid.L_g}, grid.V,
                                        {input.uniform(-1.1, 1.1), input.uniform(-1.1, 1.1)});
    if (!at.exists || at.lambda < 0.01) continue;
    const LoopModel model = model_of(input.one_in(2) ? 50'000 : 100'000, input.one_in(2) ? 0.02 : 0.04);
    const double slowest = slowest_by_eigenvalues(model, grid, at.v_p, at.i);
    const LoopPolynomial loop = loop_polynomial(model, grid, at.v_p, at.i);
    ASSERT_NEAR(loop_decay(loop), slowest, 0.1) << n;
    ASSERT_TRUE(decays(loop, slowest - 0.1)) << n;
    ASSERT_FALSE(decays(loop, slowest + 0.1)) << n;
  }
}

// Kicked by a ramp of 0.1 s, watched for 1.2 s: is v_c at rest, or on its way there?
bool settles(const Grid& grid, const Setpoint& setpoint, std::int64_t period_ns) {
  ControllerConfiguration law;
  law.timing.period_ns = period_ns;
  Controller controller(law);
  EmulatorConfiguration unit;
  unit.timing = law.timing;
  unit.grid = grid;
  unit.substeps = 4;
  unit.protection.i_max = 3.0;
  Emulator emulator(unit, {});
  Reference reference;
  reference.id = 1;
  reference.p = setpoint.p;
  reference.q = setpoint.q;
  reference.v_c = setpoint.v_c;
  reference.effective_step = 200;
  reference.ramp_steps = static_cast<std::uint32_t>(100'000'000 / period_ns);
  controller.accept(reference);
  (void)emulator.accept(reference);
  const int steps = static_cast<int>(1'200'000'000 / period_ns);
  double early = 0.0, late = 0.0;
  for (int k = 0; k < steps; ++k) {
    const Measurement sample = emulator.sample();
    emulator.advance(command(controller.step(sample)));
    if (emulator.trip() != Trip::none) return false;
    double& largest = k > steps * 4 / 5 ? late : early;
    if (k > steps * 2 / 5 && (k < steps * 3 / 5 || k > steps * 4 / 5))
      largest = std::max(largest, std::abs(sample.v_c - setpoint.v_c));
  }
  return late < 1e-4 || late < 0.5 * early;
}

TEST(LoopDecayLaw, WhatDecaysByThirtyASecondTheRunningLoopHoldsAndWhatGrowsItLoses) {
  const Limits limits;
  int held = 0, lost = 0;
  for (std::uint64_t n = 0; n < law_count(600); ++n) {
    LawInput input(n);
    const Grid grid{input.one_in(2) ? 0.0 : input.uniform(0.0, 0.2),
                    input.uniform(0.0, 0.45) / Converter{}.omega, input.uniform(0.9, 1.1)};
    const Setpoint setpoint{input.uniform(-1.1, 1.1), input.uniform(-1.1, 1.1), 1.8384776310850235};
    if (!assess(grid, {}, limits, setpoint).admissible) continue;
    const SteadyState at =
        steady_state({grid.R_g, Converter{}.omega * grid.L_g}, grid.V, {setpoint.p, setpoint.q});
    const std::int64_t period_ns = input.one_in(2) ? 50'000 : 100'000;
    const double decay = decay_at(model_of(period_ns, 0.04), grid, at.v_p, at.i);
    if (decay >= 35.0) {
      ++held;
      ASSERT_TRUE(settles(grid, setpoint, period_ns)) << n << ": decay " << decay << ", " << setpoint;
    } else if (decay < -5.0) {
      ++lost;
      ASSERT_FALSE(settles(grid, setpoint, period_ns)) << n << ": decay " << decay << ", " << setpoint;
    }
  }
  EXPECT_GT(held, 50);
  EXPECT_GT(lost, 10);
}

TEST(LoopDecayLaw, NoNumberGivesNoHope) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_LT(decay_at(model_of(100'000, 0.04), {0.0, 0.001, 1.0}, {nan, 0.0}, {0.0, 0.0}), -1e6);
  EXPECT_LT(decay_at(model_of(100'000, 0.04), {0.0, nan, 1.0}, {1.0, 0.0}, {0.0, 0.0}), -1e6);
  EXPECT_FALSE(
      decays(loop_polynomial(model_of(100'000, 0.04), {0.0, 0.001, 1.0}, {1.0, 0.0}, {0.5, 0.0}), nan));
}

}  // namespace
}  // namespace weakgrid
