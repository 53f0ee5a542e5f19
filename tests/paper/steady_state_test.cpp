// Section III in numbers: the paper's closed formulas and check values against the gateway's envelope.
#include "gateway/steady_state.hpp"

#include <gtest/gtest.h>

#include <cmath>

#include "gateway/envelope.hpp"

namespace weakgrid {
namespace {

constexpr double V = 1.0;
constexpr double X_g = 0.3;
constexpr double R_g = 0.3;
constexpr double p_nominal = 0.707;
const double v_c = 1.3 * std::sqrt(2.0);
constexpr double digits = 1e-12;   // the formulas agree to rounding
constexpr double printed = 6e-7;   // half a unit of the last digit that equations.md prints, and a little
constexpr double a_little = 1e-6;  // to either side of a limit

SteadyState inductive(double p, double q, double X = X_g) { return steady_state({0.0, X}, V, {p, q}); }
SteadyState resistive(double p, double q) { return steady_state({R_g, 0.0}, V, {p, q}); }

Assessment assess_at(double p, double q, const Limits& limits = {}) {
  const Converter converter;
  return assess(Grid{0.0, X_g / converter.omega, V}, converter, limits, {p, q, v_c});
}

// NaN if the limit was not assessed.
double margin(const Assessment& assessment, Limit limit) {
  const LimitMargin* found = assessment.margins.find(limit);
  return found != nullptr ? found->margin : std::nan("");
}

// The paper's formulas, as printed, |i| = 1.
double q_stable_inductive(double p) { return X_g * p * p / (V * V) - V * V / (4.0 * X_g); }
double q_control_inductive(double p) {
  return (v_c * v_c - std::sqrt(2.0) * std::sqrt(v_c * v_c * V * V - 2.0 * X_g * X_g * p * p)) / (2.0 * X_g);
}
double p_stable_resistive(double q) { return R_g * q * q / (V * V) - V * V / (4.0 * R_g); }
double p_control_resistive(double q) {
  return (v_c * v_c - std::sqrt(2.0) * std::sqrt(v_c * v_c * V * V - 2.0 * R_g * R_g * q * q)) / (2.0 * R_g);
}

TEST(PaperSteadyState, OperatingPointOnTheWeakGridHasThePrintedVoltageAndCurrent) {
  const SteadyState ss = inductive(p_nominal, 0.707);
  ASSERT_TRUE(ss.exists);
  EXPECT_NEAR(abs(ss.v_p), 1.16531, 6e-6);
  EXPECT_NEAR(abs(ss.i), 0.85801, 6e-6);
}

TEST(PaperSteadyState, StrongGridIsNotSingular) {
  const SteadyState ss = steady_state({0.0, 0.0}, V, {p_nominal, -0.2});
  ASSERT_TRUE(ss.exists);
  EXPECT_EQ(ss.lambda, 1.0);
  EXPECT_EQ(ss.v_p, (SpaceVector{1.0, 0.0}));
  EXPECT_EQ(ss.i, (SpaceVector{p_nominal, 0.2}));
}

TEST(PaperSteadyState, GridWithoutVoltageHasNone) {
  for (const double V_none : {0.0, -1.0, std::nan("")}) {
    const SteadyState ss = steady_state({0.0, X_g}, V_none, {0.0, -0.1});
    EXPECT_FALSE(ss.exists) << "V = " << V_none;
    EXPECT_TRUE(std::isnan(ss.lambda)) << "V = " << V_none;
  }
}

TEST(PaperSteadyState, NoPowerNoCurrentOnAnyGrid) {
  const SteadyState ss = steady_state({0.2, 0.5}, 0.9, {0.0, 0.0});
  ASSERT_TRUE(ss.exists);
  EXPECT_EQ(abs(ss.i), 0.0);
  EXPECT_NEAR(ss.v_p.re, 0.9, digits);
  EXPECT_EQ(ss.v_p.im, 0.0);
}

TEST(PaperSteadyState, LambdaEndsAtThePrintedReactivePower) {
  EXPECT_NEAR(q_stable_inductive(p_nominal), -0.683379, printed);
  for (const double p : {0.0, p_nominal, 0.9, 1.0, -0.5}) {
    const double q = q_stable_inductive(p);
    EXPECT_NEAR(inductive(p, q).lambda, 0.0, digits) << "p = " << p;
    EXPECT_TRUE(inductive(p, q + a_little).exists) << "p = " << p;
    EXPECT_FALSE(inductive(p, q - a_little).exists) << "p = " << p;
  }
}

TEST(PaperSteadyState, NominalCurrentIsReachedAtBothPrintedReactivePowers) {
  const double half = std::sqrt(V * V - p_nominal * p_nominal);
  EXPECT_NEAR(X_g - half, -0.407214, printed);
  EXPECT_NEAR(X_g + half, 1.007214, printed);
  for (const double p : {0.0, p_nominal, 0.9, 1.0, -0.5}) {
    const double h = std::sqrt(V * V - p * p);
    EXPECT_NEAR(abs(inductive(p, X_g - h).i), 1.0, digits) << "p = " << p;
    EXPECT_NEAR(abs(inductive(p, X_g + h).i), 1.0, digits) << "p = " << p;
  }
  EXPECT_LT(abs(inductive(p_nominal, X_g - half + a_little).i), 1.0);
  EXPECT_GT(abs(inductive(p_nominal, X_g - half - a_little).i), 1.0);
  EXPECT_GT(abs(inductive(p_nominal, X_g + half + a_little).i), 1.0);
}

TEST(PaperSteadyState, CurrentFormulaIsTheOtherRootBeyondItsRange) {
  const double half = std::sqrt(V * V - p_nominal * p_nominal);
  const double X_touch = V * V / (2.0 * half);
  EXPECT_NEAR(inductive(p_nominal, X_touch - half, X_touch).lambda, 0.0, digits);
  EXPECT_NEAR(abs(inductive(p_nominal, 0.95 * X_touch - half, 0.95 * X_touch).i), 1.0, digits);
  const SteadyState beyond = inductive(p_nominal, 1.5 * X_touch - half, 1.5 * X_touch);
  ASSERT_TRUE(beyond.exists);
  EXPECT_LT(abs(beyond.i), 0.99);
}

TEST(PaperSteadyState, RoughControlLimitIsThePrintedReactivePower) {
  EXPECT_NEAR(q_control_inductive(p_nominal), 1.358064, printed);
  for (const double p : {0.0, p_nominal, 0.9, 1.0, -0.5}) {
    const double q = q_control_inductive(p);
    EXPECT_NEAR(abs(inductive(p, q).v_p), v_c / std::sqrt(2.0), digits) << "p = " << p;
    EXPECT_NEAR(margin(assess_at(p, q), Limit::control_rough), 0.0, digits) << "p = " << p;
  }
}

TEST(PaperSteadyState, ResistiveLimitsAreTheInductiveOnesWithTheAxesSwapped) {
  for (const double q : {0.0, p_nominal, 0.9, 1.0, -0.5}) {
    const double p_0 = p_stable_resistive(q);
    EXPECT_NEAR(resistive(p_0, q).lambda, 0.0, digits) << "q = " << q;
    EXPECT_TRUE(resistive(p_0 + a_little, q).exists) << "q = " << q;
    EXPECT_FALSE(resistive(p_0 - a_little, q).exists) << "q = " << q;

    const double h = std::sqrt(V * V - q * q);
    EXPECT_NEAR(abs(resistive(R_g - h, q).i), 1.0, digits) << "q = " << q;
    EXPECT_NEAR(abs(resistive(R_g + h, q).i), 1.0, digits) << "q = " << q;

    EXPECT_NEAR(abs(resistive(p_control_resistive(q), q).v_p), v_c / std::sqrt(2.0), digits) << "q = " << q;
  }
}

TEST(PaperSteadyState, CurrentAndVoltageAreThePapersClosedFormulas) {
  const double V_low = 0.95, R = 0.1, X = 0.3;
  for (const double p : {-0.6, 0.0, 0.707})
    for (const double q : {-0.3, 0.0, 0.707}) {
      const SteadyState ss = steady_state({R, X}, V_low, {p, q});
      ASSERT_TRUE(ss.exists) << "p = " << p << ", q = " << q;
      const double root = std::sqrt(ss.lambda);
      const double i2 = (2 * R * p + 2 * X * q - V_low * root + V_low * V_low) / (2 * (R * R + X * X));
      const double v_p2 = R * p + X * q + V_low / 2 * (V_low + root);
      EXPECT_NEAR(abs2(ss.i), i2, digits) << "eq:mag_i2 at p = " << p << ", q = " << q;
      EXPECT_NEAR(abs2(ss.v_p), v_p2, digits) << "eq:|vp|^2 ss at p = " << p << ", q = " << q;
    }
}

TEST(PaperEnvelope, OperatingPointIsInsideEveryLimit) {
  const Assessment assessment = assess_at(p_nominal, 0.707);
  EXPECT_TRUE(assessment.admissible);
  EXPECT_EQ(assessment.margins.size(), limit_count);
  for (const LimitMargin& m : assessment.margins) EXPECT_GT(m.margin, 0.0) << static_cast<int>(m.limit);
}

TEST(PaperEnvelope, CurrentRefusesLongBeforeTheSteadyStateEnds) {
  const Assessment assessment = assess_at(p_nominal, -0.5);
  EXPECT_FALSE(assessment.admissible);
  EXPECT_GT(margin(assessment, Limit::steady_state), 0.0);
  EXPECT_LT(margin(assessment, Limit::current), 0.0);
  EXPECT_EQ(assessment.margins.size(), limit_count);
}

TEST(PaperEnvelope, CurrentIsTheFirstLimitDownwardsAtThePapersPower) {
  EXPECT_TRUE(assess_at(p_nominal, -0.407).admissible);
  const Assessment assessment = assess_at(p_nominal, -0.408);
  EXPECT_FALSE(assessment.admissible);
  for (const LimitMargin& m : assessment.margins) EXPECT_EQ(violated(m), m.limit == Limit::current);
}

TEST(PaperEnvelope, WithoutASteadyStateOnlyThatAndTheDcVoltageAreAssessed) {
  const Assessment assessment = assess_at(p_nominal, -0.7);
  EXPECT_FALSE(assessment.admissible);
  EXPECT_LT(margin(assessment, Limit::steady_state), 0.0);
  EXPECT_GT(margin(assessment, Limit::dc_voltage_min), 0.0);
  EXPECT_GT(margin(assessment, Limit::dc_voltage_max), 0.0);
  EXPECT_EQ(assessment.margins.size(), 3u);
}

TEST(PaperEnvelope, RoughControlIsReportedAndNeverRefuses) {
  Limits limits;
  limits.i_max = 10.0;
  limits.v_p_max = 10.0;
  // Absorbing reactive power, the bridge stands lower than the PCC: the estimate is too strict.
  const Converter converter;
  const Assessment assessment = assess(Grid{0.0, 0.0, 1.35}, converter, limits, {0.0, -2.0, 1.89});
  EXPECT_LT(margin(assessment, Limit::control_rough), 0.0);
  EXPECT_GT(margin(assessment, Limit::control), 0.0);
  EXPECT_FALSE(assessment.margins.find(Limit::control_rough)->enforced);
  EXPECT_TRUE(assessment.admissible);
}

}  // namespace
}  // namespace weakgrid
