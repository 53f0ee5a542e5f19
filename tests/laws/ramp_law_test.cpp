// Laws of the ramp and of unit_phasor (plant/model.hpp): what source, references and grid events move along.
// WEAKGRID_LAW_COUNT sets how many random ramps (default 20000), WEAKGRID_LAW_SEED which.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <limits>
#include <ostream>
#include <random>

#include "plant/model.hpp"

namespace weakgrid {

// For GoogleTest's messages.
static void PrintTo(const Ramp& ramp, std::ostream* out) {
  out->precision(17);
  *out << "from " << ramp.from << " to " << ramp.to << " within " << ramp.steps << " steps of step "
       << ramp.start << ", slope at the start " << ramp.slope;
}

namespace {

std::uint64_t from_environment(const char* variable, std::uint64_t otherwise) {
  const char* text = std::getenv(variable);
  return text != nullptr ? std::strtoull(text, nullptr, 10) : otherwise;
}
std::uint64_t law_count() { return from_environment("WEAKGRID_LAW_COUNT", 20'000); }
std::uint64_t law_seed() { return from_environment("WEAKGRID_LAW_SEED", 20'261'122); }

class Draw {
 public:
  double uniform(double low, double high) {
    return low + (high - low) * static_cast<double>(bits_() >> 11) * 0x1p-53;
  }
  std::uint32_t steps(std::uint32_t low, std::uint32_t high) {
    return low + static_cast<std::uint32_t>(bits_() % (high - low + 1));
  }
  // From rest, anywhere in time.
  Ramp ramp() { return {uniform(-1.0, 1.0), uniform(-1.0, 1.0), 0.0, bits_() >> 20, steps(1, 2000)}; }
  std::uint64_t bits() { return bits_(); }

 private:
  std::mt19937_64 bits_{law_seed()};
};

TEST(UnitPhasor, AgreesWithTheStandardLibraryOnTheRightHalfPlane) {
  double worst = 0.0;
  for (int k = -100'000; k <= 100'000; ++k) {
    const double angle = 0.5 * pi * k / 100'000.0;
    const SpaceVector u = unit_phasor(angle);
    worst = std::max({worst, std::abs(u.re - std::cos(angle)), std::abs(u.im - std::sin(angle))});
  }
  EXPECT_LT(worst, 1e-15);
}

TEST(UnitPhasor, HasUnitLengthAndTurnsBackExactly) {
  for (int k = 0; k <= 1000; ++k) {
    const double angle = 0.5 * pi * k / 1000.0;
    EXPECT_NEAR(abs2(unit_phasor(angle)), 1.0, 1e-15) << angle;
    EXPECT_EQ(unit_phasor(-angle), conj(unit_phasor(angle))) << angle;
  }
  EXPECT_EQ(unit_phasor(0.0), (SpaceVector{1.0, 0.0}));
}

TEST(Ramp, IsTheRaisedCosineFromRest) {
  Draw draw;
  for (std::uint64_t n = 0; n < law_count(); ++n) {
    const Ramp ramp = draw.ramp();
    const std::uint32_t k = draw.steps(0, ramp.steps);
    const double s = static_cast<double>(k) / ramp.steps;
    const double expected = ramp.from + (ramp.to - ramp.from) * 0.5 * (1.0 - std::cos(pi * s));
    ASSERT_NEAR(ramp.at(ramp.start + k).value, expected, 1e-15)
        << ::testing::PrintToString(ramp) << " at " << k;
  }
}

TEST(Ramp, EndsExactlyAtItsTargetWithoutSlopeAndStaysThere) {
  Draw draw;
  for (std::uint64_t n = 0; n < law_count(); ++n) {
    const Ramp first = draw.ramp();
    const Ramp second =
        first.towards(draw.uniform(-1.0, 1.0), first.start + draw.steps(0, first.steps), draw.steps(0, 2000));
    for (const Ramp& ramp : {first, second})
      for (const std::uint64_t after : {std::uint64_t{0}, std::uint64_t{1}, std::uint64_t{1} << 40}) {
        const Ramp::Point end = ramp.at(ramp.start + ramp.steps + after);
        ASSERT_EQ(end.value, ramp.to) << ::testing::PrintToString(ramp);
        ASSERT_EQ(end.slope, 0.0) << ::testing::PrintToString(ramp);
      }
  }
}

TEST(Ramp, NewOneLeavesWithTheValueAndSlopeOfTheOldOne) {
  Draw draw;
  for (std::uint64_t n = 0; n < law_count(); ++n) {
    Ramp ramp = draw.ramp();
    // A chain, each interrupted by the next: slopes are carried over a slope that was carried over.
    for (int link = 0; link < 4; ++link) {
      const std::uint64_t step = ramp.start + draw.steps(0, ramp.steps);
      const Ramp next = ramp.towards(draw.uniform(-1.0, 1.0), step, draw.steps(1, 2000));
      const Ramp::Point before = ramp.at(step), after = next.at(step);
      ASSERT_NEAR(after.value, before.value, 1e-15 * std::max(1.0, std::abs(before.value)))
          << ::testing::PrintToString(ramp);
      ASSERT_NEAR(after.slope, before.slope, 1e-15) << ::testing::PrintToString(ramp);
      ramp = next;
    }
  }
}

TEST(Ramp, ValueApproachesItsTargetWithoutAJump) {
  Draw draw;
  for (int n = 0; n < 200; ++n) {
    Ramp ramp = draw.ramp();
    ramp =
        ramp.towards(draw.uniform(-1.0, 1.0), ramp.start + draw.steps(0, ramp.steps), draw.steps(100, 2000));
    double steepest = 0.0;
    for (std::uint64_t k = 0; k <= ramp.steps; ++k)
      steepest = std::max(steepest, std::abs(ramp.at(ramp.start + k).slope));
    for (std::uint64_t k = 0; k < ramp.steps; ++k) {
      const double change = ramp.at(ramp.start + k + 1).value - ramp.at(ramp.start + k).value;
      ASSERT_LE(std::abs(change), steepest * (1.0 + 1e-3) + 1e-15)
          << ::testing::PrintToString(ramp) << " at " << k;
    }
  }
}

TEST(Ramp, SlopeIsTheDerivativeOfTheValue) {
  Draw draw;
  constexpr std::uint32_t length = 1'000'000;
  for (std::uint64_t n = 0; n < law_count(); ++n) {
    const Ramp first{draw.uniform(-1.0, 1.0), draw.uniform(-1.0, 1.0), 0.0, draw.bits() >> 20, length};
    const Ramp second = first.towards(draw.uniform(-1.0, 1.0), first.start + draw.steps(0, length), length);
    // Central difference over ±1000 steps: its error is (1e-3)²/6 of the third derivative.
    for (const Ramp& ramp : {first, second}) {
      const std::uint64_t k = ramp.start + draw.steps(1000, length - 1000);
      const double numerical = (ramp.at(k + 1000).value - ramp.at(k - 1000).value) / 2000.0;
      ASSERT_NEAR(ramp.at(k).slope * length, numerical * length, 3e-5) << ::testing::PrintToString(ramp);
    }
  }
}

// Changes of mind while a fast ramp moves: its slope has to go somewhere, but not further than a fast ramp
// goes.
TEST(Ramp, SlowOneThatInterruptsAFastOneStaysNearBoth) {
  Draw draw;
  for (std::uint64_t n = 0; n < law_count(); ++n) {
    const Ramp fast = draw.ramp();
    const std::uint32_t slow_steps = fast.steps * draw.steps(1, 1000);
    const Ramp slow =
        fast.towards(draw.uniform(-1.0, 1.0), fast.start + draw.steps(0, fast.steps), slow_steps);
    // And once more, soon after.
    const Ramp again =
        slow.towards(draw.uniform(-1.0, 1.0), slow.start + draw.steps(0, fast.steps), slow_steps);
    const double stray = 0.5 * (std::abs(fast.to - fast.from) + std::abs(slow.to - fast.to));
    for (const Ramp& ramp : {slow, again}) {
      const double low = std::min({fast.from, fast.to, slow.to, again.to}) - stray;
      const double high = std::max({fast.from, fast.to, slow.to, again.to}) + stray;
      for (std::uint64_t part = 0; part <= 100; ++part) {
        const double value = ramp.at(ramp.start + ramp.steps * part / 100).value;
        ASSERT_TRUE(value >= low && value <= high)
            << value << " is not in " << low << " … " << high << ": " << ::testing::PrintToString(fast)
            << "; then " << ::testing::PrintToString(slow) << "; then " << ::testing::PrintToString(again);
      }
    }
  }
}

TEST(Ramp, OfNoStepsIsAStep) {
  const Ramp ramp = Ramp{0.3, 0.3, 0.0, 0, 0}.towards(0.9, 100, 0);
  EXPECT_EQ(ramp.at(100).value, 0.9);
  EXPECT_EQ(ramp.at(100).slope, 0.0);
  EXPECT_EQ(ramp.at(101).value, 0.9);
}

TEST(Ramp, BeforeItsStartStandsWhereItWillStart) {
  const Ramp ramp{0.2, 0.8, 0.0, 1000, 50};
  EXPECT_EQ(ramp.at(0).value, 0.2);
  EXPECT_EQ(ramp.at(999).value, 0.2);
}

TEST(Ramp, AnyStepAndLengthLeaveItFinite) {
  constexpr std::uint64_t last = std::numeric_limits<std::uint64_t>::max();
  constexpr std::uint32_t longest = std::numeric_limits<std::uint32_t>::max();
  for (const std::uint64_t start : {std::uint64_t{0}, std::uint64_t{1}, last - longest, last - 1, last})
    for (const std::uint32_t steps : {0u, 1u, 2u, longest - 1, longest})
      for (const std::uint64_t step :
           {std::uint64_t{0}, std::uint64_t{1}, start, start + 1, start + steps, last - 1, last}) {
        const Ramp ramp{-1.0, 1.0, 0.0, start, steps};
        const Ramp::Point point = ramp.at(step);
        EXPECT_TRUE(std::isfinite(point.value) && std::isfinite(point.slope))
            << ::testing::PrintToString(ramp);
        const Ramp::Point turned = ramp.towards(0.5, step, longest).at(step + 1);
        EXPECT_TRUE(std::isfinite(turned.value) && std::isfinite(turned.slope))
            << ::testing::PrintToString(ramp);
      }
}

TEST(Ramp, RandomChainsOfRampsStayFinite) {
  Draw draw;
  Ramp ramp;
  std::uint64_t step = 0;
  for (std::uint64_t n = 0; n < law_count(); ++n) {
    step += draw.bits() >> draw.steps(32, 63);
    ramp = ramp.towards(draw.uniform(-10.0, 10.0), step,
                        static_cast<std::uint32_t>(draw.bits() >> draw.steps(32, 63)));
    for (const std::uint64_t k : {step, step + 1, step + ramp.steps / 2, step + ramp.steps}) {
      const Ramp::Point point = ramp.at(k);
      ASSERT_TRUE(std::isfinite(point.value) && std::isfinite(point.slope)) << ::testing::PrintToString(ramp);
    }
  }
}

}  // namespace
}  // namespace weakgrid
