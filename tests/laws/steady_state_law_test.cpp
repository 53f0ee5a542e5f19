// Laws of the steady state and of the envelope over seeded random grids and setpoints.
// WEAKGRID_LAW_COUNT sets how many (default 20000), WEAKGRID_LAW_SEED which; a failure prints seed and input.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <iterator>
#include <limits>
#include <ostream>
#include <random>

#include "gateway/envelope.hpp"
#include "gateway/steady_state.hpp"

namespace weakgrid {
namespace {

std::uint64_t from_environment(const char* name, std::uint64_t otherwise) {
  const char* text = std::getenv(name);
  return text != nullptr ? std::strtoull(text, nullptr, 10) : otherwise;
}
std::uint64_t law_count() {
  static const std::uint64_t count = from_environment("WEAKGRID_LAW_COUNT", 20'000);
  return count;
}
std::uint64_t law_seed() {
  static const std::uint64_t seed = from_environment("WEAKGRID_LAW_SEED", 20'261'122);
  return seed;
}

struct Input {
  SpaceVector Z_g;
  double V;
  SpaceVector s;
  SpaceVector i;
};

std::ostream& operator<<(std::ostream& out, const Input& x) {
  out.precision(17);
  return out << "seed " << law_seed() << ", Z_g = " << x.Z_g.re << " + j" << x.Z_g.im << ", V = " << x.V
             << ", s = " << x.s.re << " + j" << x.s.im << ", i = " << x.i.re << " + j" << x.i.im;
}

class Draw {
 public:
  double uniform(double low, double high) {
    return low + (high - low) * static_cast<double>(bits_() >> 11) * 0x1p-53;
  }
  // Strong, inductive, resistive and mixed grids, a quarter each.
  SpaceVector impedance() {
    const SpaceVector Z_g{uniform(0.0, 0.6), uniform(0.0, 0.6)};
    switch (bits_() % 4) {
      case 0:
        return {0.0, 0.0};
      case 1:
        return {0.0, Z_g.im};
      case 2:
        return {Z_g.re, 0.0};
      default:
        return Z_g;
    }
  }
  SpaceVector vector(double bound) { return {uniform(-bound, bound), uniform(-bound, bound)}; }
  std::uint64_t bits() { return bits_(); }

 private:
  std::mt19937_64 bits_{law_seed()};
};

Input by_power(Draw& draw) { return {draw.impedance(), draw.uniform(0.5, 1.5), draw.vector(2.0), {}}; }

Input by_current(Draw& draw) {
  Input x{draw.impedance(), draw.uniform(0.5, 1.5), {}, draw.vector(2.0)};
  x.s = power(SpaceVector{x.V, 0.0} + x.Z_g * x.i, x.i);
  return x;
}

// √λ on the operating branch; negative on the other.
double half_plane(const Input& x, SpaceVector i) { return x.V + 2.0 * (x.Z_g * i).re; }

// As the paper prints it. eq:lambda
double lambda_printed(const Input& x) {
  const double R_g = x.Z_g.re, X_g = x.Z_g.im, p = x.s.re, q = x.s.im, V2 = x.V * x.V;
  return V2 - 4 * X_g * (X_g * p * p / V2 - q) + 4 * R_g * ((2 * X_g * p * q - R_g * q * q) / V2 + p);
}

// What rounding may do to sums of these magnitudes.
double rounding(const Input& x) {
  const double drop = (abs(x.Z_g) * abs(x.s)) / x.V;
  return 1e-14 * (1.0 + x.V * x.V + 4.0 * abs(x.Z_g) * abs(x.s) + 4.0 * drop * drop);
}

Converter converter_of(double X_L) {
  Converter converter;
  converter.L = X_L / converter.omega;
  return converter;
}

Assessment assess_input(const Input& x, const Converter& converter, const Limits& limits, double v_c) {
  return assess(Grid{x.Z_g.re, x.Z_g.im / converter.omega, x.V}, converter, limits, {x.s.re, x.s.im, v_c});
}

double margin(const Assessment& assessment, Limit limit) { return assessment.margins.find(limit)->margin; }

TEST(SteadyStateLaw, LambdaIsThePapersAndDecidesExistence) {
  Draw draw;
  for (std::uint64_t n = 0; n < law_count(); ++n) {
    const Input x = by_power(draw);
    const SteadyState ss = steady_state(x.Z_g, x.V, x.s);
    ASSERT_NEAR(ss.lambda, lambda_printed(x), rounding(x)) << x;
    ASSERT_EQ(ss.exists, ss.lambda >= 0.0) << x;
  }
}

TEST(SteadyStateLaw, SolutionSatisfiesThePapersEquations) {
  Draw draw;
  for (std::uint64_t n = 0; n < law_count(); ++n) {
    const Input x = by_power(draw);
    const SteadyState ss = steady_state(x.Z_g, x.V, x.s);
    if (!ss.exists) continue;
    const SpaceVector v_g{x.V, 0.0};
    const double tolerance = 10.0 * rounding(x) * std::max(1.0, 1.0 / x.V);
    ASSERT_LE(abs(abs2(ss.i) * x.Z_g + x.V * conj(ss.i) - x.s), tolerance * (1.0 + abs(x.Z_g) * abs(ss.i)))
        << "eq:i ss, " << x;
    ASSERT_LE(abs(v_g + x.Z_g * ss.i - ss.v_p), tolerance * (1.0 + abs(x.Z_g))) << "eq:vp ss, " << x;
    ASSERT_LE(abs(power(ss.v_p, ss.i) - x.s), tolerance) << "eq:s, " << x;
    ASSERT_GE(abs(ss.v_p), 0.5 * x.V * (1.0 - 1e-14)) << x;
  }
}

TEST(SteadyStateLaw, RootOfLambdaIsTheHalfPlane) {
  Draw draw;
  for (std::uint64_t n = 0; n < law_count(); ++n) {
    const Input x = by_power(draw);
    const SteadyState ss = steady_state(x.Z_g, x.V, x.s);
    if (!ss.exists) continue;
    const double tolerance = 10.0 * rounding(x) * (1.0 + abs(x.Z_g)) / x.V;
    ASSERT_NEAR(std::sqrt(ss.lambda), half_plane(x, ss.i), tolerance) << x;
  }
}

TEST(SteadyStateLaw, LambdaIsTheSquareOfTheHalfPlaneAtEveryCurrent) {
  Draw draw;
  for (std::uint64_t n = 0; n < law_count(); ++n) {
    const Input x = by_current(draw);
    const double side = half_plane(x, x.i);
    ASSERT_NEAR(steady_state(x.Z_g, x.V, x.s).lambda, side * side, 10.0 * rounding(x)) << x;
  }
}

TEST(SteadyStateLaw, OperatingBranchReturnsItsCurrentAndTheOtherBranchCarriesMore) {
  Draw draw;
  for (std::uint64_t n = 0; n < law_count(); ++n) {
    const Input x = by_current(draw);
    const double side = half_plane(x, x.i);
    if (std::abs(side) < 1e-3) continue;  // the two roots meet
    const SteadyState ss = steady_state(x.Z_g, x.V, x.s);
    ASSERT_TRUE(ss.exists) << x;
    if (side > 0.0) {
      ASSERT_LE(abs(ss.i - x.i), 1e-9) << x;
    } else {
      ASSERT_LT(abs(ss.i), abs(x.i)) << x;
    }
  }
}

// Each limit is a disc, or the outside of one, around a centre known beforehand in the plane of the current.
TEST(EnvelopeLaw, MarginsAreThoseOfDiscsInTheCurrentPlane) {
  Draw draw;
  for (std::uint64_t n = 0; n < law_count(); ++n) {
    const Input x = by_current(draw);
    if (half_plane(x, x.i) < 1e-3) continue;
    const double X_L = draw.uniform(0.0, 0.2), v_c = draw.uniform(1.0, 3.0);
    const Converter converter = converter_of(X_L);
    const Limits limits;
    const Assessment assessment = assess_input(x, converter, limits, v_c);
    ASSERT_EQ(assessment.margins.size(), limit_count) << x;
    const SpaceVector v_g{x.V, 0.0};
    const double V_p = abs(v_g + x.Z_g * x.i);
    const double V_bridge = abs(v_g + (x.Z_g + SpaceVector{0.0, X_L}) * x.i);
    const double mu_max = std::sqrt(0.5), tolerance = 1e-9;
    ASSERT_NEAR(margin(assessment, Limit::current), 1.0 - abs(x.i), tolerance) << x;
    ASSERT_NEAR(margin(assessment, Limit::control), v_c * mu_max - V_bridge, tolerance) << x;
    ASSERT_NEAR(margin(assessment, Limit::control_rough), v_c * mu_max - V_p, tolerance) << x;
    ASSERT_NEAR(margin(assessment, Limit::pcc_voltage_min), V_p - limits.v_p_min, tolerance) << x;
    ASSERT_NEAR(margin(assessment, Limit::pcc_voltage_max), limits.v_p_max - V_p, tolerance) << x;
    ASSERT_EQ(margin(assessment, Limit::dc_voltage_min), v_c - limits.v_c_min) << x;
    ASSERT_EQ(margin(assessment, Limit::dc_voltage_max), limits.v_c_max - v_c) << x;
  }
}

TEST(EnvelopeLaw, AdmissibleExactlyWhenNoEnforcedMarginIsNegative) {
  Draw draw;
  std::uint64_t admitted = 0;
  for (std::uint64_t n = 0; n < law_count(); ++n) {
    const Input x = by_power(draw);
    const Assessment assessment = assess_input(x, converter_of(0.02), {}, draw.uniform(1.4, 2.5));
    bool inside = true;
    for (const LimitMargin& m : assessment.margins) {
      ASSERT_EQ(m.enforced, m.limit != Limit::control_rough) << x;
      if (m.enforced && m.margin < 0.0) inside = false;
    }
    ASSERT_EQ(assessment.admissible, inside) << x;
    ASSERT_EQ(assessment.margins.size(), margin(assessment, Limit::steady_state) >= 0.0 ? limit_count : 3u)
        << x;
    admitted += assessment.admissible ? 1 : 0;
  }
  EXPECT_GT(admitted, law_count() / 100) << "the law must see both sides";
}

TEST(EnvelopeLaw, WiderLimitsNeverRefuseWhatNarrowerOnesAdmit) {
  Draw draw;
  for (std::uint64_t n = 0; n < law_count(); ++n) {
    const Input x = by_power(draw);
    const double v_c = draw.uniform(1.4, 2.5), more = draw.uniform(0.0, 0.5);
    const Limits narrow;
    const Limits wide{narrow.i_max + more,   narrow.v_p_min - more, narrow.v_p_max + more,
                      narrow.v_c_min - more, narrow.v_c_max + more, {}};
    const Assessment inner = assess_input(x, converter_of(0.02), narrow, v_c);
    const Assessment outer = assess_input(x, converter_of(0.02), wide, v_c);
    if (inner.admissible) {
      ASSERT_TRUE(outer.admissible) << x;
    }
    ASSERT_EQ(inner.margins.size(), outer.margins.size()) << x;
    for (const LimitMargin& m : inner.margins) ASSERT_GE(margin(outer, m.limit), m.margin) << x;
  }
}

TEST(EnvelopeLaw, MoreDcVoltageIsMoreControlAndNothingElseOfTheGridSide) {
  Draw draw;
  for (std::uint64_t n = 0; n < law_count(); ++n) {
    const Input x = by_power(draw);
    const double v_c = draw.uniform(1.4, 2.0), more = draw.uniform(0.01, 0.5);
    const Assessment low = assess_input(x, converter_of(0.02), {}, v_c);
    const Assessment high = assess_input(x, converter_of(0.02), {}, v_c + more);
    if (low.margins.size() < limit_count) continue;
    ASSERT_GT(margin(high, Limit::control), margin(low, Limit::control)) << x;
    for (const Limit same :
         {Limit::steady_state, Limit::current, Limit::pcc_voltage_min, Limit::pcc_voltage_max})
      ASSERT_EQ(margin(high, same), margin(low, same)) << x;
  }
}

TEST(EnvelopeLaw, ReactivePowerHelpsLambdaOnAnInductiveGrid) {
  Draw draw;
  for (std::uint64_t n = 0; n < law_count(); ++n) {
    Input x = by_power(draw);
    x.Z_g = {0.0, draw.uniform(0.01, 0.6)};
    Input more = x;
    more.s.im += draw.uniform(0.001, 1.0);
    const double rise = 4.0 * x.Z_g.im * (more.s.im - x.s.im);
    const double lambda = steady_state(x.Z_g, x.V, x.s).lambda;
    ASSERT_NEAR(steady_state(more.Z_g, more.V, more.s).lambda, lambda + rise, 2.0 * rounding(more)) << x;
  }
}

// Upper limits on |v_p| and control are not convex in the plane of the powers, so they are left out.
TEST(EnvelopeLaw, LambdaCurrentAndMinimumVoltageHoldBetweenTwoSetpointsWhereTheyHold) {
  Draw draw;
  constexpr double none = std::numeric_limits<double>::infinity();
  const Limits limits{1.0, 0.8, none, -none, none, {}};
  std::uint64_t pairs = 0;
  for (std::uint64_t n = 0; n < law_count(); ++n) {
    Input x = by_power(draw), y = x;
    y.s = draw.vector(2.0);
    Input between = x;
    const double w = draw.uniform(0.0, 1.0);
    between.s = w * x.s + (1.0 - w) * y.s;
    constexpr double v_c = 100.0;  // control never binds
    if (!assess_input(x, converter_of(0.02), limits, v_c).admissible) continue;
    if (!assess_input(y, converter_of(0.02), limits, v_c).admissible) continue;
    ++pairs;
    for (const LimitMargin& m : assess_input(between, converter_of(0.02), limits, v_c).margins)
      ASSERT_GE(m.margin, -1e-9) << x << "; towards p = " << y.s.re << ", q = " << y.s.im << ", w = " << w;
  }
  EXPECT_GT(pairs, law_count() / 200) << "the law must see enough pairs";
}

// Values that break arithmetic, in every place at once.
double hostile(Draw& draw) {
  constexpr double values[] = {0.0,
                               -0.0,
                               1.0,
                               -1.0,
                               0.3,
                               5e-324,
                               1e-160,
                               1e-300,
                               1e153,
                               1e300,
                               -1e300,
                               std::numeric_limits<double>::max(),
                               std::numeric_limits<double>::infinity(),
                               -std::numeric_limits<double>::infinity(),
                               std::numeric_limits<double>::quiet_NaN()};
  return values[draw.bits() % std::size(values)];
}

TEST(EnvelopeLaw, HostileValuesNeverGiveASteadyStateThatIsNotFiniteNorAdmitNaN) {
  Draw draw;
  for (std::uint64_t n = 0; n < law_count(); ++n) {
    double h[14];
    for (double& value : h) value = hostile(draw);
    const Input x{{h[0], h[1]}, h[2], {h[3], h[4]}, {}};
    const SteadyState ss = steady_state(x.Z_g, x.V, x.s);
    if (ss.exists) {
      ASSERT_TRUE(ss.lambda >= 0.0 && x.V > 0.0 && finite(ss.v_p) && finite(ss.i)) << x;
    } else {
      ASSERT_TRUE(std::isnan(ss.i.re) && std::isnan(ss.v_p.re)) << x;
    }

    const Converter converter{h[5], h[6], 1.0, h[7]};
    const Assessment assessment =
        assess(Grid{h[0], h[1], h[2]}, converter, {h[8], h[9], h[10], h[11], h[12], {}}, {h[3], h[4], h[13]});
    if (std::any_of(std::begin(h), std::end(h), [](double value) { return std::isnan(value); })) {
      ASSERT_FALSE(assessment.admissible) << x;
    }
    ASSERT_EQ(assessment.admissible,
              std::none_of(assessment.margins.begin(), assessment.margins.end(), violated));
  }
}

}  // namespace
}  // namespace weakgrid
