// The envelope over a box of grids against brute force: sampled densely, no grid of the box has less margin
// than is told, and the grid that is named has just that.
#include <gtest/gtest.h>

#include "gateway/envelope.hpp"
#include "gateway/steady_state.hpp"
#include "tests/support/law_input.hpp"

namespace weakgrid {
namespace {

bool contains(Interval x, double value) { return value >= x.low && value <= x.high; }

TEST(GridBoxLaw, AnAcceptedSetpointIsWithinEveryLimitOnEveryGridAndARefusalNamesAGridThatRefuses) {
  const Converter converter;
  std::uint64_t admitted = 0, refused = 0;
  for (std::uint64_t n = 0; n < law_count(100'000); ++n) {
    LawInput input(n);
    const GridBox box = input.box();
    const Limits limits = input.limits();
    const Setpoint setpoint = input.setpoint();
    const Assessment whole = assess(box, converter, limits, setpoint);
    ++(whole.admissible ? admitted : refused);
    ASSERT_EQ(whole.admissible, slack(box, converter, limits, setpoint) >= 0.0)
        << n << ": " << box << ", " << setpoint;
    for (const LimitMargin& m : whole.margins) {
      const Assessment there = assess(m.grid, converter, limits, setpoint);
      const LimitMargin* found = there.margins.find(m.limit);
      ASSERT_TRUE(contains(box.R_g, m.grid.R_g) && contains(box.L_g, m.grid.L_g) && contains(box.V, m.grid.V))
          << n << ": " << box;
      // Without a steady state on some other grid the rest is not told.
      if (found != nullptr) {
        ASSERT_NEAR(found->margin, m.margin, 1e-12)
            << n << ": limit " << int(m.limit) << ", " << box << ", " << setpoint;
      }
    }
    // Corners and edges are where it binds; random grids look for what that would miss.
    for (int k = 0; k < 40; ++k) {
      Grid grid = input.within(box);
      if (k % 3 == 0) grid.V = box.V.high;
      if (k % 4 == 0) grid.R_g = input.one_in(2) ? box.R_g.low : box.R_g.high;
      if (k % 4 == 1) grid.L_g = input.one_in(2) ? box.L_g.low : box.L_g.high;
      const Assessment one = assess(grid, converter, limits, setpoint);
      for (const LimitMargin& m : whole.margins) {
        const LimitMargin* here = one.margins.find(m.limit);
        ASSERT_NE(here, nullptr) << n << ": " << box << ", " << setpoint;
        ASSERT_GE(here->margin, m.margin - 1e-12)
            << n << ": limit " << int(m.limit) << ", " << box << ", " << setpoint;
      }
      if (whole.admissible) {
        ASSERT_TRUE(one.admissible) << n << ": " << box << ", " << setpoint;
      }
    }
  }
  EXPECT_GT(admitted, law_count(100'000) / 20);
  EXPECT_GT(refused, law_count(100'000) / 20);
}

TEST(GridBoxLaw, ABoxThatGrowsAdmitsNothingMore) {
  for (std::uint64_t n = 0; n < law_count(20'000); ++n) {
    LawInput input(n);
    const GridBox box = input.box();
    GridBox wider = box;
    wider.R_g.high += input.uniform(0.0, 0.1);
    wider.L_g.low *= input.uniform(0.0, 1.0);
    wider.V.low -= input.uniform(0.0, 0.05);
    const Setpoint setpoint = input.setpoint();
    const double before = slack(box, {}, {}, setpoint), after = slack(wider, {}, {}, setpoint);
    ASSERT_TRUE(after <= before + 1e-12 || (after < 0.0 && before < 0.0))
        << n << ": " << box << ", " << setpoint;
  }
}

TEST(GridBoxLaw, ThePointEstimateAdmitsWhatAWeakerGridCannotCarry) {
  // equations.md: about 10 % of the setpoints admissible at X_g = 0.3 are not at 0.45.
  const Converter converter;
  const auto at = [&](double low, double high) {
    return GridBox{{}, {low / converter.omega, high / converter.omega}, {1.0, 1.0}};
  };
  int at_point = 0, on_box = 0;
  for (int a = -60; a <= 60; ++a)
    for (int b = -60; b <= 60; ++b) {
      const Setpoint setpoint{a / 50.0, b / 50.0, 1.8384776310850235};
      if (!assess(at(0.3, 0.3), converter, {}, setpoint).admissible) continue;
      ++at_point;
      on_box += assess(at(0.3, 0.45), converter, {}, setpoint).admissible;
    }
  EXPECT_GT(at_point - on_box, at_point / 12);
  EXPECT_GT(on_box, 0);
}

TEST(GridBoxLaw, HostileNumbersAreNeverAdmitted) {
  const double strange[] = {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity(),
                            -std::numeric_limits<double>::infinity(), 1e300, -1e300};
  for (const double x : strange) {
    for (int field = 0; field < 9; ++field) {
      double h[9] = {0.0, 0.1, 0.0, 0.001, 0.95, 1.05, 0.3, 0.1, 1.84};
      h[field] = x;
      const Setpoint setpoint{h[6], h[7], h[8]};
      const Assessment found = assess(GridBox{{h[0], h[1]}, {h[2], h[3]}, {h[4], h[5]}}, {}, {}, setpoint);
      // An infinitely low bound of a box is refused where boxes come in: is_valid.
      const GridBox box{{h[0], h[1]}, {h[2], h[3]}, {h[4], h[5]}};
      EXPECT_FALSE(found.admissible && is_valid(box)) << field << ' ' << x;
      EXPECT_EQ(found.admissible, slack(box, {}, {}, setpoint) >= 0.0) << field << ' ' << x;
    }
  }
}

}  // namespace
}  // namespace weakgrid
