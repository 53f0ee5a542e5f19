// What a gateway concludes from measurements: never against a grid that it knows, always against one that it
// does not.
#include "gateway/grid_evidence.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <optional>

#include "gateway/steady_state.hpp"
#include "tests/support/law_input.hpp"

namespace weakgrid {
namespace {

const double omega = Converter{}.omega;

// A unit that stands at s on this grid, if one can.
std::optional<Measurement> may_stand_at(const Grid& grid, SpaceVector s) {
  const SteadyState at = steady_state({grid.R_g, omega * grid.L_g}, grid.V, s);
  if (!at.exists) return std::nullopt;
  Measurement m;
  m.v_p = at.v_p;
  m.i = at.i;
  return m;
}
Measurement standing(const Grid& grid, SpaceVector s) { return may_stand_at(grid, s).value(); }

OperatingPoint point(const Measurement& m) { return {abs2(m.v_p), abs2(m.i), power(m.v_p, m.i)}; }

TEST(GridEvidence, TheImpliedVoltagesAreThoseOfAllImpedancesOfTheBoxAndNoOthers) {
  for (std::uint64_t n = 0; n < law_count(10'000); ++n) {
    LawInput input(n);
    const GridBox box = input.box();
    const auto m = may_stand_at(input.within(box), {input.uniform(-0.7, 0.9), input.uniform(-0.4, 0.7)});
    if (!m) continue;
    const Interval implied = implied_voltage(box, omega, point(*m));
    double low = 9.0, high = 0.0;
    constexpr int raster = 20;
    for (int j = 0; j <= raster; ++j)
      for (int k = 0; k <= raster; ++k) {
        const SpaceVector Z{box.R_g.low + (box.R_g.high - box.R_g.low) * j / raster,
                            omega * (box.L_g.low + (box.L_g.high - box.L_g.low) * k / raster)};
        const double V = abs(m->v_p - Z * m->i);
        low = std::min(low, V);
        high = std::max(high, V);
      }
    ASSERT_LE(implied.low, low + 1e-12) << n << ": " << box;
    ASSERT_GE(implied.high, high - 1e-12) << n << ": " << box;
    ASSERT_NEAR(implied.low, low, 2e-3) << n << ": " << box;
    ASSERT_NEAR(implied.high, high, 1e-12) << n << ": the most is at a corner; " << box;
  }
}

TEST(GridEvidence, AGridOfTheBoxIsNeverContradicted) {
  for (std::uint64_t n = 0; n < law_count(2'000); ++n) {
    LawInput input(n);
    const GridBox box = input.box();
    GridEvidence evidence({.cycle_steps = 4, .cycles = 1, .tolerance = 1e-9});
    const auto m = may_stand_at(input.within(box), {input.uniform(-0.7, 0.9), input.uniform(-0.4, 0.7)});
    if (!m) continue;
    for (int k = 0; k < 16; ++k) ASSERT_FALSE(evidence.add(box, omega, *m)) << n << ": " << box;
  }
}

class GridEvidenceOfAWeakerGrid : public testing::Test {
 protected:
  std::optional<Interval> see(const Grid& grid, int samples) {
    std::optional<Interval> last;
    for (int k = 0; k < samples; ++k)
      if (const auto V = evidence_.add(box_, omega, standing(grid, {0.8, 0.0}))) last = V;
    return last;
  }
  const GridBox box_{{0.0, 0.0}, {0.1 / omega, 0.15 / omega}, {1.0, 1.0}};
  const Grid known_{0.0, 0.12 / omega, 1.0}, weaker_{0.0, 0.5 / omega, 1.0};
  GridEvidence evidence_{{.cycle_steps = 10, .cycles = 5, .tolerance = 0.02}};
};

TEST_F(GridEvidenceOfAWeakerGrid, IsToldAfterSoManyCyclesInARowAndExplainsWhatIsMeasured) {
  EXPECT_FALSE(see(weaker_, 49));
  const auto V = see(weaker_, 1);
  ASSERT_TRUE(V);
  for (const Grid& grid : {Grid{0.0, box_.L_g.low, V->low}, Grid{0.0, box_.L_g.high, V->low}}) {
    const double v_p = abs(standing(grid, {0.8, 0.0}).v_p);
    EXPECT_NEAR(v_p, abs(standing(weaker_, {0.8, 0.0}).v_p), 0.03);
  }
}

TEST_F(GridEvidenceOfAWeakerGrid, WhatPassesIsRiddenThrough) {
  EXPECT_FALSE(see(weaker_, 40));
  EXPECT_FALSE(see(known_, 10));
  EXPECT_FALSE(see(weaker_, 49));
}

TEST_F(GridEvidenceOfAWeakerGrid, ABlockedUnitAndNumbersThatAreNoneAreNoEvidence) {
  EXPECT_FALSE(see(weaker_, 45));
  Measurement blocked = standing(weaker_, {0.8, 0.0});
  blocked.blocked = true;
  EXPECT_FALSE(evidence_.add(box_, omega, blocked));
  EXPECT_FALSE(see(weaker_, 45));
  Measurement nonsense = blocked;
  nonsense.blocked = false;
  nonsense.v_p.re = std::numeric_limits<double>::quiet_NaN();
  for (int k = 0; k < 200; ++k) EXPECT_FALSE(evidence_.add(box_, omega, nonsense));
  EXPECT_FALSE(see(known_, 50));
  EXPECT_TRUE(see(weaker_, 50)) << "and it still sees";
}

}  // namespace
}  // namespace weakgrid
