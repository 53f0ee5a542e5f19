// The gains of Section IV in numbers: the paper's, and those of equations.md for the sampled design.
#include "controller/gains.hpp"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>

#include "controller/controller.hpp"

namespace weakgrid {
namespace {

constexpr SettlingTimes paper_s{0.001, 0.0011, 0.020};

// Digits that a page prints: `printed` is `exact` cut off, not rounded, at a unit in the last place of
// `unit`.
void expect_cut_off(double exact, double printed, double unit) {
  EXPECT_EQ(std::floor(exact / unit), std::round(printed / unit))
      << exact << " is not printed as " << printed;
}

// Half a unit of the ninth significant digit.
void expect_nine_digits(double exact, double printed) {
  const double unit = std::pow(10.0, std::floor(std::log10(printed)) - 8.0);
  EXPECT_NEAR(exact, printed, 0.500001 * unit);
}

TEST(PaperGains, SettlingIn1And1point1And20MillisecondsGivesThePrintedGains) {
  const Gains k = continuous_gains(paper_s);
  expect_cut_off(k.k1, 21.25e6, 0.01e6);
  expect_cut_off(k.k2, 9011.0, 1.0);
  expect_cut_off(k.k3, 4424e6, 1e6);
}

TEST(PaperGains, ContinuousGainsAreTheCoefficientsOfThePolynomialWithTheAskedRoots) {
  const double a = 4.6 / 0.001, b = 4.6 / 0.0011, c = 4.6 / 0.020;
  const Gains k = continuous_gains(paper_s);
  EXPECT_NEAR(k.k1 / (a * b + a * c + b * c), 1.0, 1e-13);
  EXPECT_NEAR(k.k2 / (a + b + c), 1.0, 1e-13);
  EXPECT_NEAR(k.k3 / (a * b * c), 1.0, 1e-13);
}

TEST(PaperGains, NotchThatSettlesIn50MillisecondsHasKappa92) {
  EXPECT_NEAR(settling_factor / 0.050, 92.0, 1e-12);
  EXPECT_EQ(ControllerConfiguration{}.kappa, (SpaceVector{92.0, 0.0}));
}

TEST(SampledGains, AgreeWithTheTableOfEquationsToAllPrintedDigits) {
  struct Row {
    double T, k1, k2, k3;
  };
  for (const Row& row : {Row{50e-6, 1.71322128e7, 7.68179811e3, 3.54614349e9},
                         Row{100e-6, 1.39300786e7, 6.63083409e3, 2.86519002e9},
                         Row{200e-6, 9.45161006e6, 5.10784711e3, 1.91560209e9}}) {
    SCOPED_TRACE(row.T);
    const Gains K = sampled_gains(paper_s, row.T);
    expect_nine_digits(K.k1, row.k1);
    expect_nine_digits(K.k2, row.k2);
    expect_nine_digits(K.k3, row.k3);
  }
}

TEST(SampledGains, TendToTheContinuousOnesAsThePeriodShrinks) {
  const Gains k = continuous_gains(paper_s);
  const Gains K = sampled_gains(paper_s, 1e-8);
  EXPECT_NEAR(K.k1 / k.k1, 1.0, 1e-4);
  EXPECT_NEAR(K.k2 / k.k2, 1.0, 1e-4);
  EXPECT_NEAR(K.k3 / k.k3, 1.0, 1e-4);
}

// One period of the triple under the gains, δu held: the integrator chain written out.
Eigen::Vector3d one_period(const Eigen::Vector3d& x, const Gains& K, double T) {
  const double e1 = x(0), e2 = x(1), y = x(2);
  const double u = -(K.k1 * e1 + K.k2 * e2 + K.k3 * y);
  return {e1 + e2 * T + u * T * T / 2.0, e2 + u * T, y + e1 * T + e2 * T * T / 2.0 + u * T * T * T / 6.0};
}

TEST(SampledGains, PutThePolesOfTheHeldTripleWhereAsked) {
  for (const SettlingTimes& times_s :
       {paper_s, SettlingTimes{0.002, 0.003, 0.050}, SettlingTimes{0.0008, 0.005, 0.1}})
    for (const double T : {50e-6, 100e-6, 200e-6}) {
      const Gains K = sampled_gains(times_s, T);
      Eigen::Matrix3d closed;
      for (int n = 0; n < 3; ++n) closed.col(n) = one_period(Eigen::Vector3d::Unit(n), K, T);
      const Eigen::Vector3cd poles = closed.eigenvalues();
      for (const double t : times_s) {
        const double asked = std::exp(-4.6 * T / t);
        EXPECT_LT((poles.array() - asked).abs().minCoeff(), 1e-10) << "T = " << T << ", settling time " << t;
      }
    }
}

TEST(ExpMinus, AgreesWithTheStandardLibrary) {
  double worst = 0.0;
  for (double x = 0.0; x < 30.0; x += 0.000'37)
    worst = std::max(worst, std::abs(exp_minus(x) / std::exp(-x) - 1.0));
  // Each halving of the argument doubles the relative error: 2⁶ up to 30, from a rounding or two.
  EXPECT_LT(worst, 128 * std::numeric_limits<double>::epsilon());
}

TEST(ExpMinus, IsOneAtZeroAndNothingAtInfinity) {
  EXPECT_EQ(exp_minus(0.0), 1.0);
  EXPECT_EQ(exp_minus(1e4), 0.0);
  EXPECT_EQ(exp_minus(1e15), 0.0);
}

TEST(ExpMinus, IsPreciseWhereTheDesignUsesIt) {
  for (const double t : {0.001, 0.0011, 0.020, 0.050})
    for (const double T : {50e-6, 100e-6, 200e-6}) {
      const double x = 4.6 * T / t;
      EXPECT_NEAR(exp_minus(x) / std::exp(-x), 1.0, 1e-15) << "x = " << x;
    }
}

TEST(Notch, TakesInWhatItsTimeConstantLets) {
  const double T = 100e-6, omega = Converter{}.omega;
  const Notch notch = make_notch({92.0, 30.0}, omega, T);
  EXPECT_NEAR(notch.turn.re, std::cos(omega * T), 1e-15);
  EXPECT_NEAR(notch.turn.im, std::sin(omega * T), 1e-15);
  EXPECT_NEAR(notch.intake.re, 1.0 - std::exp(-92.0 * T) * std::cos(30.0 * T), 1e-15);
  EXPECT_NEAR(notch.intake.im, std::exp(-92.0 * T) * std::sin(30.0 * T), 1e-15);
}

}  // namespace
}  // namespace weakgrid
