// Laws of references, leases and fallbacks (plant/reference.hpp), in source and controller alike.
// WEAKGRID_LAW_COUNT sets how many random cases (default 500), WEAKGRID_LAW_SEED which.
#include <gtest/gtest.h>

#include <bit>
#include <cstdint>
#include <cstdlib>
#include <limits>
#include <ostream>
#include <random>

#include "tests/support/loop.hpp"

namespace weakgrid {

// For GoogleTest's messages.
static void PrintTo(const Reference& r, std::ostream* out) {
  out->precision(17);
  *out << "reference " << r.id << " renews " << r.renews << ": p " << r.p << " q " << r.q << " v_c " << r.v_c
       << " within " << r.ramp_steps << " from " << r.effective_step << ", lease to " << r.lease_end_step
       << ", then p " << r.fallback_p << " q " << r.fallback_q << " within " << r.fallback_ramp_steps;
}

namespace {

using test::Loop;
using test::LoopCase;
using test::v_c_nominal;

std::uint64_t from_environment(const char* variable, std::uint64_t otherwise) {
  const char* text = std::getenv(variable);
  return text != nullptr ? std::strtoull(text, nullptr, 10) : otherwise;
}
std::uint64_t law_count() { return from_environment("WEAKGRID_LAW_COUNT", 500); }

class Draw {
 public:
  double uniform(double low, double high) {
    return low + (high - low) * static_cast<double>(bits_() >> 11) * 0x1p-53;
  }
  std::uint32_t whole(std::uint32_t low, std::uint32_t high) {
    return low + static_cast<std::uint32_t>(bits_() % (std::uint64_t{high} - low + 1));
  }
  bool one_in(std::uint32_t n) { return bits_() % n == 0; }

  /// Begins within 50 steps, its lease ends up to 150 steps later. As little power as a unit without a
  /// controller survives.
  Reference order(std::uint32_t id) {
    Reference r{.id = id,
                .p = uniform(-0.02, 0.02),
                .q = uniform(-1.0, 1.0),
                .v_c = uniform(1.5, 2.4),
                .effective_step = whole(0, 50),
                .ramp_steps = whole(1, 60)};
    r.lease_end_step = r.effective_step + whole(1, 150);
    r.fallback_p = uniform(-0.02, 0.02);
    r.fallback_q = uniform(-1.0, 1.0);
    r.fallback_v_c = uniform(1.5, 2.4);
    r.fallback_ramp_steps = whole(1, 60);
    return r;
  }

 private:
  std::mt19937_64 bits_{from_environment("WEAKGRID_LAW_SEED", 20'261'122)};
};

Reference renewal(const Reference& order, std::uint32_t id, std::uint64_t lease_end_step) {
  Reference r = order;
  r.id = id;
  r.renews = order.id;
  r.lease_end_step = lease_end_step;
  return r;
}

std::uint64_t bits(double x) { return std::bit_cast<std::uint64_t>(x); }

EmulatorConfiguration tolerant_unit() {
  EmulatorConfiguration configuration;
  configuration.substeps = 1;
  configuration.protection = {.i_max = 100.0, .v_c_max = 100.0, .v_c_min = 0.1, .max_holds = 1'000'000};
  return configuration;
}

// Source and controller beside each other; nobody switches the bridge.
struct Both {
  Emulator source{tolerant_unit(), {}};
  ReferenceShaper shaper{v_c_nominal, 1.0};

  void accept(const Reference& reference) {
    EXPECT_TRUE(source.accept(reference));
    EXPECT_TRUE(shaper.accept(reference));
  }
  void go_on() {
    source.advance(std::nullopt);
    shaper.advance_to(source.step(), false);
  }
  const ReferenceTrack& track() const { return shaper.state().track; }
};

// What the three quantities must do, from rest.
struct Expected {
  Ramp p{};
  Ramp q{};
  Ramp v_c{v_c_nominal, v_c_nominal, 0.0, 0, 0};

  void move(double to_p, double to_q, double to_v_c, std::uint64_t step, std::uint32_t steps) {
    p = p.towards(to_p, step, steps);
    q = q.towards(to_q, step, steps);
    v_c = v_c.towards(to_v_c, step, steps);
  }
  void order(const Reference& r, std::uint64_t step) { move(r.p, r.q, r.v_c, step, r.ramp_steps); }
  void fall_back(const Reference& r, std::uint64_t step) {
    move(r.fallback_p, r.fallback_q, r.fallback_v_c, step, r.fallback_ramp_steps);
  }
  void check(const Both& both) const {
    const std::uint64_t k = both.source.step();
    const ShapedReference shaped = both.shaper.at(k);
    ASSERT_EQ(bits(both.source.sample().p_i), bits(p.at(k).value)) << "step " << k;
    ASSERT_EQ(bits(shaped.q_r), bits(q.at(k).value)) << "step " << k;
    ASSERT_EQ(bits(shaped.dq_r), bits(q.at(k).slope)) << "step " << k;
    ASSERT_EQ(bits(shaped.v_cr), bits(v_c.at(k).value)) << "step " << k;
    ASSERT_EQ(bits(shaped.dv_cr), bits(v_c.at(k).slope)) << "step " << k;
  }
};

TEST(Lease, EndsExactlyAtItsStepInSourceAndControllerAlikeByTheFallbacksRamp) {
  Draw draw;
  for (std::uint64_t n = 0; n < law_count(); ++n) {
    const Reference order = draw.order(1);
    SCOPED_TRACE(::testing::PrintToString(order));
    Both both;
    Expected expected;
    both.accept(order);
    both.shaper.advance_to(0, false);
    for (std::uint64_t k = 0; k < order.lease_end_step + 100; ++k) {
      if (k == order.effective_step) expected.order(order, k);
      if (k == order.lease_end_step) expected.fall_back(order, k);
      expected.check(both);
      const bool is_over = k >= order.lease_end_step;
      ASSERT_EQ(both.source.sample().fallback, is_over) << "step " << k;
      ASSERT_EQ(both.track().fallen_back, is_over) << "step " << k;
      ASSERT_EQ(both.source.sample().reference_id, k < order.effective_step ? 0u : 1u) << "whose fallback";
      ASSERT_EQ(both.source.counters().lease_ends, is_over ? 1u : 0u);
      ASSERT_FALSE(HasFatalFailure());
      both.go_on();
    }
  }
}

TEST(Lease, RenewedInTimeLeavesEveryBitAsItWasWithoutOne) {
  Draw draw;
  for (std::uint64_t n = 0; n < law_count(); ++n) {
    const Reference order = draw.order(1);
    Reference unlimited = order;
    unlimited.lease_end_step = 0;
    Both renewed, other;
    renewed.accept(order);
    other.accept(unlimited);
    std::uint32_t id = 1;
    std::uint64_t lease_end = order.lease_end_step;
    for (std::uint64_t k = 0; k < 400; ++k) {
      // At the latest at the last step before its end; pending, mid-ramp or at rest.
      if (k + 1 == lease_end || draw.one_in(20)) {
        lease_end = std::max(lease_end, k) + draw.whole(2, 40);
        ++id;
        renewed.accept(renewal(order, id, lease_end));
      }
      const ShapedReference a = renewed.shaper.at(k), b = other.shaper.at(k);
      ASSERT_EQ(bits(renewed.source.sample().p_i), bits(other.source.sample().p_i)) << "step " << k;
      ASSERT_EQ(bits(a.q_r), bits(b.q_r)) << "step " << k;
      ASSERT_EQ(bits(a.dq_r), bits(b.dq_r)) << "step " << k;
      ASSERT_EQ(bits(a.v_cr), bits(b.v_cr)) << "step " << k;
      ASSERT_EQ(renewed.track().newest_id, id);
      ASSERT_EQ(renewed.source.sample().reference_id, k < order.effective_step ? 0u : id) << "step " << k;
      renewed.go_on();
      other.go_on();
    }
    ASSERT_EQ(renewed.source.counters().lease_ends, 0u) << ::testing::PrintToString(order);
  }
}

TEST(Lease, RenewalsMayNameTheOrderOrTheRenewalBefore) {
  for (const bool names_order : {true, false}) {
    ReferenceTrack track;
    const Reference order{.id = 3, .p = 0.1, .v_c = 1.8, .lease_end_step = 10};
    ASSERT_TRUE(track.accept(order));
    ASSERT_TRUE(track.advance_to(0, false));
    for (std::uint32_t id = 4; id < 10; ++id) {
      Reference next = renewal(order, id, std::uint64_t{id} * 10);
      if (!names_order) next.renews = id - 1;
      ASSERT_TRUE(track.accept(next));
      ASSERT_FALSE(track.pending) << id;
      ASSERT_EQ(track.in_force->lease_end_step, std::uint64_t{id} * 10);
    }
    EXPECT_EQ(track.in_force->id, 9u);
    EXPECT_FALSE(track.advance_to(89, false));
    EXPECT_TRUE(track.advance_to(90, false)->is_fallback);
  }
}

TEST(Lease, OneThatIsMissedBetweenTwoRenewalsOfTheOrderDoesNoHarm) {
  ReferenceTrack track;
  const Reference order{.id = 1, .p = 0.1, .v_c = 1.8, .lease_end_step = 10};
  track.accept(order);
  track.advance_to(0, false);
  ASSERT_TRUE(track.accept(renewal(order, 5, 50)));
  EXPECT_FALSE(track.pending) << "two to four have not come";
  EXPECT_EQ(track.in_force->lease_end_step, 50u);
}

TEST(Lease, IsNeverShortenedByARenewal) {
  ReferenceTrack track;
  const Reference order{.id = 1, .p = 0.1, .v_c = 1.8, .lease_end_step = 100};
  track.accept(order);
  track.advance_to(50, false);
  ASSERT_TRUE(track.accept(renewal(order, 2, 20)));
  EXPECT_FALSE(track.advance_to(99, false)) << "no ramp begins in the past";
  EXPECT_TRUE(track.advance_to(100, false));
}

TEST(Lease, LateRenewalRampsBackToTheOrder) {
  Draw draw;
  for (std::uint64_t n = 0; n < law_count(); ++n) {
    const Reference order = draw.order(1);
    const std::uint64_t late = order.lease_end_step + draw.whole(0, 90);
    Both both;
    Expected expected;
    both.accept(order);
    both.shaper.advance_to(0, false);
    for (std::uint64_t k = 0; k < late + 70; ++k) {
      if (k == order.effective_step) expected.order(order, k);
      if (k == order.lease_end_step) expected.fall_back(order, k);
      if (k == late) {
        both.accept(renewal(order, 2, late + 1000));
        both.shaper.advance_to(k, false);
        expected.order(order, k);
      }
      expected.check(both);
      ASSERT_FALSE(HasFatalFailure()) << ::testing::PrintToString(order) << " late at " << late;
      both.go_on();
    }
    ASSERT_EQ(both.source.sample().p_i, order.p);
    ASSERT_FALSE(both.source.sample().fallback);
  }
}

TEST(Lease, JoinerThatOnlySeesTheRenewalFindsTheSameRamp) {
  Draw draw;
  for (std::uint64_t n = 0; n < law_count(); ++n) {
    const Reference order = draw.order(1);
    const Reference renewed = renewal(order, 2, order.lease_end_step + draw.whole(1, 100));
    const std::uint64_t join = draw.whole(0, 350);
    ReferenceShaper standing(v_c_nominal, 1.0), joiner(v_c_nominal, 1.0);
    standing.accept(order);
    joiner.accept(renewed);
    for (std::uint64_t k = 0; k < 400; ++k) {
      if (k == std::min(order.effective_step + 1, order.lease_end_step - 1)) standing.accept(renewed);
      standing.advance_to(k, false);
      if (k < join) continue;
      joiner.advance_to(k, k == join);
      const ShapedReference a = standing.at(k), b = joiner.at(k);
      ASSERT_EQ(bits(a.q_r), bits(b.q_r)) << ::testing::PrintToString(renewed) << " step " << k;
      ASSERT_EQ(bits(a.dq_r), bits(b.dq_r)) << ::testing::PrintToString(renewed) << " step " << k;
      ASSERT_EQ(bits(a.v_cr), bits(b.v_cr)) << ::testing::PrintToString(renewed) << " step " << k;
      ASSERT_EQ(standing.state().track.fallen_back, joiner.state().track.fallen_back) << "step " << k;
    }
    // The next renewal finds both alike.
    const Reference next = renewal(order, 3, 2000);
    ASSERT_TRUE(standing.accept(next) && joiner.accept(next));
    ASSERT_EQ(standing.state().track.pending.has_value(), joiner.state().track.pending.has_value());
  }
}

TEST(Lease, OrderWhoseLeaseIsOverNeverBegins) {
  const Reference order{.id = 1,
                        .p = 0.02,
                        .q = 0.9,
                        .v_c = 2.0,
                        .effective_step = 10,
                        .ramp_steps = 5,
                        .lease_end_step = 30,
                        .fallback_p = 0.001,
                        .fallback_q = 0.1,
                        .fallback_ramp_steps = 8};
  // It comes at 40, when it would begin at once.
  Both both;
  for (int k = 0; k < 40; ++k) both.go_on();
  both.accept(order);
  both.shaper.advance_to(40, false);
  EXPECT_TRUE(both.source.sample().fallback);
  EXPECT_EQ(both.source.counters().lease_ends, 1u);
  Expected expected;
  expected.fall_back(order, 40);
  for (int k = 0; k < 20; ++k) {
    expected.check(both);
    both.go_on();
  }
  EXPECT_EQ(both.source.sample().p_i, 0.001);
  EXPECT_EQ(both.shaper.at(60).q_r, 0.1);
}

TEST(Lease, NextOrderAtItsLastStepIsInTime) {
  ReferenceTrack track;
  track.accept({.id = 1, .p = 0.1, .v_c = 1.8, .lease_end_step = 100});
  track.advance_to(0, false);
  track.accept({.id = 2, .p = 0.2, .v_c = 1.8, .effective_step = 100});
  EXPECT_FALSE(track.advance_to(99, false));
  const auto move = track.advance_to(100, false);
  ASSERT_TRUE(move);
  EXPECT_EQ(move->p, 0.2);
  EXPECT_FALSE(move->is_fallback);
  EXPECT_FALSE(track.advance_to(100, false));
}

TEST(Lease, EndsAtItsStepAlsoForWhoMissedThatSample) {
  ReferenceTrack track;
  track.accept({.id = 1, .p = 0.1, .v_c = 1.8, .lease_end_step = 100});
  track.advance_to(0, false);
  const auto move = track.advance_to(107, false);
  ASSERT_TRUE(move && move->is_fallback);
  EXPECT_EQ(move->start, 100u);
}

TEST(Lease, OfAnOrderThatWasCancelledIsNotBroughtBackByARenewal) {
  ReferenceTrack track;
  const Reference order{.id = 1, .p = 0.1, .v_c = 1.8, .lease_end_step = 100};
  track.accept(order);
  track.advance_to(0, false);
  track.cancel();
  EXPECT_TRUE(track.accept(renewal(order, 2, 200)));
  EXPECT_TRUE(track.accept(renewal(order, 3, 300)));
  EXPECT_EQ(track.newest_id, 3u);
  for (const std::uint64_t k : {1u, 150u, 400u}) EXPECT_FALSE(track.advance_to(k, false));
  EXPECT_EQ(track.id(), 0u);
  EXPECT_TRUE(track.accept({.id = 4, .p = 0.2, .v_c = 1.8}));
  EXPECT_EQ(track.advance_to(401, false)->p, 0.2);
  // Another unit knows nothing of it all.
  track.forget();
  Reference next = renewal(order, 6, 900);
  next.renews = 4;
  EXPECT_TRUE(track.accept(next));
  EXPECT_TRUE(track.advance_to(402, false));
}

TEST(Lease, FallbackThatNoUnitCouldFollowIsRefused) {
  constexpr double nan = std::numeric_limits<double>::quiet_NaN();
  const Reference good{.id = 1, .p = 0.1, .v_c = 1.8, .lease_end_step = 100};
  ReferenceTrack track;
  for (double Reference::*field : {&Reference::fallback_p, &Reference::fallback_q, &Reference::fallback_v_c})
    for (const double wrong : {nan, 1e300, -10.001, std::numeric_limits<double>::infinity()}) {
      Reference bad = good;
      bad.*field = wrong;
      EXPECT_FALSE(track.accept(bad)) << wrong;
      bad.lease_end_step = 0;
      EXPECT_TRUE(is_plausible(bad)) << "nobody will look at it";
    }
  Reference of_the_future = good;
  of_the_future.renews = 1;
  EXPECT_FALSE(track.accept(of_the_future));
  EXPECT_TRUE(track.accept(good));
}

TEST(Lease, WhateverComesNothingJumpsAndEveryLeaseEnds) {
  Draw draw;
  std::uint64_t fallbacks = 0, orders = 0;
  for (std::uint64_t n = 0; n < law_count(); ++n) {
    ReferenceTrack track;
    Expected ramps;
    std::uint32_t id = 0;
    std::uint64_t last = 0;
    Reference newest;
    for (std::uint64_t k = 1; k < 1500; last = k, k += draw.one_in(50) ? draw.whole(1, 16) : 1) {
      if (draw.one_in(15)) {
        Reference next = draw.order(id += draw.whole(1, 2));
        const std::uint64_t from = k < 30 ? 0 : k - 30;
        next.effective_step += from;
        next.lease_end_step = draw.one_in(4) ? 0 : from + draw.whole(0, 200);
        if (draw.one_in(2) && newest.id != 0) {
          next = renewal(newest, id, next.lease_end_step);
        } else {
          newest = next;
        }
        ASSERT_TRUE(track.accept(next)) << ::testing::PrintToString(next);
      }
      if (draw.one_in(300)) track.idle();
      int moves = 0;
      while (const auto move = track.advance_to(k, false)) {
        ++(move->is_fallback ? fallbacks : orders);
        ASSERT_LE(++moves, 3);
        ASSERT_LE(move->start, k);
        ASSERT_GT(move->start, last) << "would change what was already commanded";
        const Expected before = ramps;
        ramps.move(move->p, move->q, move->v_c, move->start, move->ramp_steps);
        for (Ramp Expected::*r : {&Expected::p, &Expected::q, &Expected::v_c}) {
          const Ramp::Point was = (before.*r).at(move->start), is = (ramps.*r).at(move->start);
          ASSERT_NEAR(is.value, was.value, 1e-14) << "step " << k;
          ASSERT_NEAR(is.slope, was.slope, 1e-14) << "step " << k;
        }
      }
      for (const Ramp& r : {ramps.p, ramps.q, ramps.v_c}) ASSERT_TRUE(std::isfinite(r.at(k).value));
      const bool is_over =
          track.in_force && track.in_force->lease_end_step != 0 && track.in_force->lease_end_step <= k;
      ASSERT_EQ(track.fallen_back, is_over) << "step " << k;
      ASSERT_TRUE(!track.pending || track.pending->effective_step > k);
    }
  }
  EXPECT_GT(fallbacks, law_count());
  EXPECT_GT(orders, law_count());
}

TEST(Lease, ClosedLoopSettlesAtTheFallbackWithBothSidesInStep) {
  for (const double X_g : {0.0, 0.3}) {
    LoopCase loop_case;
    loop_case.grid = test::inductive_grid(X_g);
    loop_case.orders = {};
    Loop loop(loop_case);
    const Reference order{.id = 1,
                          .p = 0.6,
                          .q = 0.3,
                          .v_c = v_c_nominal,
                          .effective_step = 100,
                          .ramp_steps = 200,
                          .lease_end_step = 3000,
                          .fallback_p = 0.2,
                          .fallback_q = 0.1,
                          .fallback_v_c = 1.9,
                          .fallback_ramp_steps = 400};
    ASSERT_TRUE(loop.unit().accept(order) && loop.controller().accept(order));
    while (loop.unit().step() < 2800) loop.step();
    const test::Settled at_order = loop.settled();
    EXPECT_NEAR(at_order.p, 0.6, 2e-3) << X_g;
    EXPECT_NEAR(at_order.q, 0.3, 2e-3) << X_g;
    while (loop.unit().step() < 6000) {
      const bool is_over = loop.unit().step() >= 3000;
      ASSERT_EQ(loop.unit().sample().fallback, is_over) << loop.unit().step();
      ASSERT_EQ((loop.step().status & fallback) != 0, is_over) << loop.unit().step();
    }
    const test::Settled at_fallback = loop.settled();
    EXPECT_NEAR(at_fallback.p, 0.2, 2e-3) << X_g;
    EXPECT_NEAR(at_fallback.q, 0.1, 2e-3) << X_g;
    EXPECT_NEAR(at_fallback.v_c, 1.9, 2e-3) << X_g;
    EXPECT_EQ(loop.unit().trip(), Trip::none);
  }
}

TEST(Lease, RestoredControllerGoesOnWithTheSameBits) {
  LoopCase loop_case;
  loop_case.orders = {};
  Loop loop(loop_case);
  const Reference order{.id = 1,
                        .p = 0.5,
                        .q = 0.2,
                        .v_c = 1.9,
                        .ramp_steps = 300,
                        .lease_end_step = 500,
                        .fallback_ramp_steps = 100};
  loop.unit().accept(order);
  loop.controller().accept(order);
  Controller other{ControllerConfiguration{}};
  for (int k = 0; k < 1000; ++k) {
    if (k % 97 == 0) other.restore(loop.controller().state());
    const Modulation expected = other.step(loop.unit().sample());
    const Modulation answer = loop.step();
    ASSERT_EQ(answer.mu, expected.mu) << "step " << k;
    ASSERT_EQ(answer.status, expected.status) << "step " << k;
  }
}

TEST(Reference, ThatWaitedForABlockedUnitBeginsInSourceAndControllerAtOnce) {
  LoopCase loop_case;
  loop_case.orders = {};
  Loop loop(loop_case);
  for (int k = 0; k < 40; ++k) loop.step_missed();
  ASSERT_EQ(loop.unit().trip(), Trip::modulation_lost);
  loop.run(10);
  const Reference order{
      .id = 1, .p = 0.5, .q = 0.4, .v_c = v_c_nominal, .effective_step = 55, .ramp_steps = 200};
  ASSERT_TRUE(loop.unit().accept(order) && loop.controller().accept(order));
  loop.run(500);
  loop.unit().reset_trip();
  const std::uint64_t start = loop.unit().step();
  loop.step();
  const Ramp expected = Ramp{}.towards(0.4, start, 200);
  const ReferenceShaper::State shaped = loop.controller().state().references;
  EXPECT_EQ(shaped.q.start, start) << "and not where a joiner would find it";
  EXPECT_EQ(shaped.q.at(start + 50).value, expected.at(start + 50).value);
  loop.run(3000);
  const test::Settled settled = loop.settled();
  EXPECT_NEAR(settled.p, 0.5, 2e-3);
  EXPECT_NEAR(settled.q, 0.4, 2e-3);
}

}  // namespace
}  // namespace weakgrid
