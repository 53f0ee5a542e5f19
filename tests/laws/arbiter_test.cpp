// Laws of the arbiter: freshness, repeats, ranges, the envelope, bounded memory, and whatever a network may
// bring. WEAKGRID_LAW_COUNT sets how many random requests (default 20000); a failure prints seed and number.
#include "gateway/arbiter.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <iterator>
#include <limits>
#include <random>
#include <vector>

namespace weakgrid {
namespace {

constexpr double nan = std::numeric_limits<double>::quiet_NaN();
constexpr double inf = std::numeric_limits<double>::infinity();
constexpr std::uint64_t alice = 0xA11CE, bob = 0xB0B;
constexpr std::uint64_t step_now = 1000;

Arbiter::Configuration weak_grid() {
  Arbiter::Configuration configuration;
  configuration.box = box_of({0.0, 0.3 / configuration.converter.omega, 1.0});
  return configuration;
}

Request ask(std::uint64_t client, std::uint32_t id, double p, double q) {
  Request request;
  request.client = client;
  request.id = id;
  request.who.name.text = {'a', 'n', 'n'};
  request.given = given_p | given_q;
  request.p = p;
  request.q = q;
  return request;
}

// Wire-visible equality: everything but `repeated`.
::testing::AssertionResult same(const Decision& x, const Decision& y) {
  const auto number = [](double a, double b) { return a == b || (std::isnan(a) && std::isnan(b)); };
  const auto margin = [&number](const LimitMargin& a, const LimitMargin& b) {
    return a.limit == b.limit && a.enforced == b.enforced && number(a.margin, b.margin);
  };
  bool equal = x.client == y.client && x.id == y.id && x.verdict == y.verdict && x.field == y.field &&
               number(x.setpoint.p, y.setpoint.p) && number(x.setpoint.q, y.setpoint.q) &&
               number(x.setpoint.v_c, y.setpoint.v_c) &&
               std::equal(x.margins.begin(), x.margins.end(), y.margins.begin(), y.margins.end(), margin) &&
               x.reference.has_value() == y.reference.has_value();
  if (equal && x.reference)
    equal = x.reference->id == y.reference->id && x.reference->p == y.reference->p &&
            x.reference->q == y.reference->q && x.reference->v_c == y.reference->v_c &&
            x.reference->effective_step == y.reference->effective_step &&
            x.reference->ramp_steps == y.reference->ramp_steps;
  return equal ? ::testing::AssertionSuccess() : ::testing::AssertionFailure() << "decisions differ";
}

void expect_bad(Request request, Field field) {
  Arbiter arbiter{weak_grid()};
  const Decision decision = arbiter.decide(request, step_now);
  EXPECT_EQ(decision.verdict, Verdict::bad_request);
  EXPECT_EQ(decision.field, field);
  EXPECT_FALSE(decision.reference);
  EXPECT_EQ(decision.margins.size(), 0u);
  EXPECT_FALSE(arbiter.standing());
}

TEST(Arbiter, NothingStandsBeforeTheFirstRequest) { EXPECT_FALSE(Arbiter{weak_grid()}.standing()); }

TEST(Arbiter, AdmissibleRequestBecomesTheStandingReference) {
  Arbiter arbiter{weak_grid()};
  const Decision decision = arbiter.decide(ask(alice, 1, 0.707, 0.707), step_now);
  EXPECT_EQ(decision.client, alice);
  EXPECT_EQ(decision.id, 1u);
  EXPECT_EQ(decision.verdict, Verdict::accepted);
  EXPECT_EQ(decision.field, Field::none);
  EXPECT_FALSE(decision.repeated);
  EXPECT_EQ(decision.margins.size(), limit_count);
  ASSERT_TRUE(decision.reference);
  EXPECT_EQ(decision.reference->id, 1u);
  EXPECT_EQ(decision.reference->p, 0.707);
  EXPECT_EQ(decision.reference->q, 0.707);
  EXPECT_EQ(decision.reference->v_c, Setpoint{}.v_c);
  EXPECT_EQ(decision.reference->effective_step, step_now + 50);
  EXPECT_EQ(decision.reference->ramp_steps, 200u) << "20 ms of 100 us";
  ASSERT_TRUE(arbiter.standing());
  EXPECT_EQ(arbiter.standing()->id, 1u);
}

TEST(Arbiter, WhatIsNotGivenStaysAsItStands) {
  Arbiter arbiter{weak_grid()};
  arbiter.decide(ask(alice, 1, 0.5, 0.2), step_now);
  Request request = ask(bob, 1, nan, 0.3);
  request.given = given_q;
  request.v_c = inf;
  const Decision decision = arbiter.decide(request, step_now);
  ASSERT_EQ(decision.verdict, Verdict::accepted) << "what is not given is not read";
  EXPECT_EQ(decision.reference->p, 0.5);
  EXPECT_EQ(decision.reference->q, 0.3);
  EXPECT_EQ(decision.reference->v_c, Setpoint{}.v_c);
}

TEST(Arbiter, RefusalOutsideTheEnvelopeNamesTheLimitAndIssuesNothing) {
  Arbiter arbiter{weak_grid()};
  arbiter.decide(ask(alice, 1, 0.707, 0.0), step_now);
  const Decision current = arbiter.decide(ask(alice, 2, 0.707, -0.5), step_now);
  EXPECT_EQ(current.verdict, Verdict::outside_envelope);
  EXPECT_FALSE(current.reference);
  EXPECT_EQ(current.margins.size(), limit_count);
  EXPECT_TRUE(violated(*current.margins.find(Limit::current)));
  EXPECT_FALSE(violated(*current.margins.find(Limit::steady_state)));

  const Decision lambda = arbiter.decide(ask(alice, 3, 0.707, -0.7), step_now);
  EXPECT_EQ(lambda.verdict, Verdict::outside_envelope);
  EXPECT_EQ(lambda.margins.size(), 3u);
  EXPECT_TRUE(violated(*lambda.margins.find(Limit::steady_state)));
  EXPECT_EQ(arbiter.standing()->id, 1u);
  EXPECT_EQ(arbiter.standing()->q, 0.0);
}

TEST(Arbiter, ReferencesCountAcceptancesOnly) {
  Arbiter arbiter{weak_grid()};
  EXPECT_EQ(arbiter.decide(ask(alice, 1, 0.1, 0.0), step_now).reference->id, 1u);
  EXPECT_FALSE(arbiter.decide(ask(alice, 2, 0.0, -5.0), step_now).reference);
  EXPECT_FALSE(arbiter.decide(ask(alice, 3, nan, 0.0), step_now).reference);
  EXPECT_EQ(arbiter.decide(ask(bob, 1, 0.2, 0.0), step_now).reference->id, 2u);
}

TEST(Arbiter, ARestartedGatewayCountsOnAndSkipsZeroAndWantsTheWholeSetpoint) {
  Arbiter arbiter{weak_grid()};
  arbiter.note_foreign_reference(std::numeric_limits<std::uint32_t>::max() - 1);
  const Decision part = arbiter.decide(ask(alice, 1, 0.1, 0.0), step_now);
  EXPECT_EQ(part.verdict, Verdict::bad_request);
  EXPECT_EQ(part.field, Field::given);
  Request whole = ask(alice, 2, 0.1, 0.0);
  whole.given |= given_v_c;
  whole.v_c = 1.8;
  EXPECT_EQ(arbiter.decide(whole, step_now).reference->id, 0xFFFF'FFFFu);
  EXPECT_EQ(arbiter.decide(ask(alice, 3, 0.1, 0.0), step_now).reference->id, 1u);
}

TEST(Arbiter, ATripLeavesNoSetpointBehindAndNothingIsAcceptedUntilTheReset) {
  Arbiter arbiter{weak_grid()};
  ASSERT_EQ(arbiter.decide(ask(alice, 1, 0.5, 0.1), step_now).verdict, Verdict::accepted);
  const Reference idle = arbiter.block();
  EXPECT_EQ(idle.id, 2u);
  EXPECT_EQ(idle.p, 0.0);
  EXPECT_EQ(idle.q, 0.0);
  EXPECT_EQ(idle.effective_step, 0u);
  EXPECT_EQ(arbiter.decide(ask(alice, 2, 0.5, 0.1), step_now).verdict, Verdict::unit_blocked);
  arbiter.unblock();
  EXPECT_EQ(arbiter.decide(ask(alice, 3, 0.5, 0.1), step_now).verdict, Verdict::accepted);
}

TEST(Arbiter, RepeatGetsTheVerySameDecisionAndIssuesNothing) {
  Arbiter arbiter{weak_grid()};
  std::uint32_t id = 0;
  for (const double q : {0.2, -0.5, -0.7, nan}) {  // accepted, current, lambda, bad
    const Request request = ask(alice, ++id, 0.707, q);
    const Decision first = arbiter.decide(request, step_now);
    arbiter.decide(ask(bob, id, 0.1, 0.1), step_now);  // the standing setpoint moves on in between
    const std::uint32_t standing = arbiter.standing()->id;
    const Decision again = arbiter.decide(request, step_now + 12345);
    EXPECT_FALSE(first.repeated);
    EXPECT_TRUE(again.repeated);
    EXPECT_TRUE(same(first, again)) << "q = " << q;
    EXPECT_EQ(arbiter.standing()->id, standing);
  }
}

TEST(Arbiter, RequestIsItsClientAndIdWhateverElseARepeatSays) {
  Arbiter arbiter{weak_grid()};
  const Decision first = arbiter.decide(ask(alice, 1, 0.5, 0.0), step_now);
  EXPECT_TRUE(same(first, arbiter.decide(ask(alice, 1, nan, 9.0), step_now)));
  EXPECT_EQ(arbiter.standing()->p, 0.5);
}

TEST(Arbiter, LowerIdIsStaleAndLeavesTheLastDecisionRepeatable) {
  Arbiter arbiter{weak_grid()};
  const Decision last = arbiter.decide(ask(alice, 7, 0.5, 0.0), step_now);
  const Decision stale = arbiter.decide(ask(alice, 6, 0.1, 0.0), step_now);
  EXPECT_EQ(stale.verdict, Verdict::stale_request);
  EXPECT_EQ(stale.field, Field::id);
  EXPECT_FALSE(stale.reference);
  EXPECT_EQ(arbiter.standing()->p, 0.5);
  EXPECT_TRUE(same(last, arbiter.decide(ask(alice, 7, 0.5, 0.0), step_now)));
  EXPECT_EQ(arbiter.decide(ask(alice, 100, 0.1, 0.0), step_now).verdict, Verdict::accepted)
      << "gaps are fine";
}

TEST(Arbiter, ClientsDoNotDisturbEachOthersIds) {
  Arbiter arbiter{weak_grid()};
  arbiter.decide(ask(alice, 100, 0.5, 0.0), step_now);
  EXPECT_EQ(arbiter.decide(ask(bob, 1, 0.1, 0.0), step_now).verdict, Verdict::accepted);
}

TEST(Arbiter, EffectiveStepIsStaleOnceItsSampleWasSeenAndInTimeBefore) {
  Arbiter arbiter{weak_grid()};
  std::uint32_t id = 0;
  const auto at = [&](std::uint64_t effective_step) {
    Request request = ask(alice, ++id, 0.1, 0.0);
    request.effective_step = effective_step;
    return arbiter.decide(request, step_now);
  };
  for (const std::uint64_t passed : {std::uint64_t{1}, step_now - 1, step_now}) {
    const Decision decision = at(passed);
    EXPECT_EQ(decision.verdict, Verdict::stale_request) << passed;
    EXPECT_EQ(decision.field, Field::effective_step);
    EXPECT_FALSE(decision.reference);
  }
  for (const std::uint64_t ahead : {step_now + 1, step_now + 2, step_max}) {
    const Decision decision = at(ahead);
    ASSERT_EQ(decision.verdict, Verdict::accepted) << "a unit waiting at k has published k - 1";
    EXPECT_EQ(decision.reference->effective_step, ahead);
  }
}

TEST(Arbiter, BadFieldIsNamed) {
  expect_bad(ask(0, 1, 0.1, 0.1), Field::client);
  expect_bad(ask(alice, 0, 0.1, 0.1), Field::id);
  Request request = ask(alice, 1, 0.1, 0.1);
  for (const std::uint32_t given : {0u, 8u, 15u, 0xFFFF'FFFFu}) {
    request.given = given;
    expect_bad(request, Field::given);
  }
  for (const double x : {nan, inf, -inf, 10.001, -10.001, 1e300}) {
    expect_bad(ask(alice, 1, x, 0.1), Field::p);
    expect_bad(ask(alice, 1, 0.1, x), Field::q);
  }
  request.given = given_v_c;
  for (const double v_c : {nan, inf, -inf, 0.0, -0.0, -1.8, 10.001}) {
    request.v_c = v_c;
    expect_bad(request, Field::v_c);
  }
  request.v_c = 1.8;
  for (const double ramp_s : {nan, inf, -inf, -0.02, 1e-300, 0.000999, 60.001}) {
    request.ramp_s = ramp_s;
    expect_bad(request, Field::ramp_s);
  }
  request.ramp_s = 0.0;
  for (const std::uint64_t step : {step_max + 1, ~std::uint64_t{0}}) {
    request.effective_step = step;
    expect_bad(request, Field::effective_step);
  }
}

TEST(Arbiter, EndsOfTheRangesAreNotBad) {
  Arbiter arbiter{weak_grid()};
  Request request = ask(alice, 1, 10.0, -10.0);
  request.given |= given_v_c;
  request.v_c = 10.0;
  request.ramp_s = 60.0;
  EXPECT_EQ(arbiter.decide(request, step_now).verdict, Verdict::outside_envelope);
}

TEST(Arbiter, BadRequestIsAnsweredOnceItsIdIsSpent) {
  Arbiter arbiter{weak_grid()};
  EXPECT_EQ(arbiter.decide(ask(alice, 1, nan, 0.0), step_now).verdict, Verdict::bad_request);
  EXPECT_EQ(arbiter.decide(ask(alice, 1, 0.1, 0.0), step_now).verdict, Verdict::bad_request);
  EXPECT_EQ(arbiter.decide(ask(alice, 2, 0.1, 0.0), step_now).verdict, Verdict::accepted);
}

TEST(Arbiter, RampIsCountedInStepsOfTheUnit) {
  for (const std::int64_t period_ns : {10'000, 50'000, 100'000, 1'000'000}) {
    Arbiter::Configuration configuration = weak_grid();
    configuration.timing.period_ns = period_ns;
    Arbiter arbiter{configuration};
    std::uint32_t id = 0;
    for (const double ramp_s : {0.001, 0.00127, 0.02, 0.3, 60.0}) {
      Request request = ask(alice, ++id, 0.1, 0.0);
      request.ramp_s = ramp_s;
      EXPECT_EQ(arbiter.decide(request, step_now).reference->ramp_steps,
                std::llround(ramp_s * 1e9 / static_cast<double>(period_ns)));
    }
  }
}

TEST(Arbiter, RampOfAnAbsurdConfigurationIsTheLongest) {
  for (const double ramp_s : {nan, inf}) {
    Arbiter::Configuration configuration = weak_grid();
    configuration.default_ramp_s = ramp_s;
    Arbiter arbiter{configuration};
    EXPECT_EQ(arbiter.decide(ask(alice, 1, 0.1, 0.0), step_now).reference->ramp_steps, 0xFFFF'FFFFu);
  }
  Arbiter::Configuration configuration = weak_grid();
  configuration.timing.period_ns = 0;
  Arbiter arbiter{configuration};
  EXPECT_EQ(arbiter.decide(ask(alice, 1, 0.1, 0.0), step_now).reference->ramp_steps, 0xFFFF'FFFFu);
}

TEST(Arbiter, ReferenceNeverStartsInThePastNorWrapsAround) {
  Arbiter::Configuration configuration = weak_grid();
  configuration.lead_steps = 0;
  Arbiter arbiter{configuration};
  EXPECT_EQ(arbiter.decide(ask(alice, 1, 0.1, 0.0), 0).reference->effective_step, 1u);
  EXPECT_EQ(arbiter.decide(ask(alice, 2, 0.1, 0.0), ~std::uint64_t{0}).reference->effective_step,
            step_max + 1);
}

TEST(Arbiter, UnknowableGridRefusesEverySetpoint) {
  Arbiter::Configuration configuration = weak_grid();
  configuration.box.L_g = {nan, nan};
  Arbiter arbiter{configuration};
  const Decision decision = arbiter.decide(ask(alice, 1, 0.0, 0.0), step_now);
  EXPECT_EQ(decision.verdict, Verdict::outside_envelope);
  EXPECT_TRUE(violated(*decision.margins.find(Limit::steady_state)));
}

TEST(Arbiter, LeastRecentlyHeardClientIsForgottenAndNoOther) {
  Arbiter arbiter{weak_grid()};
  for (std::uint64_t client = 1; client <= Arbiter::client_max; ++client)
    arbiter.decide(ask(client, 5, 0.1, 0.0), step_now);
  EXPECT_TRUE(arbiter.decide(ask(1, 5, 0.1, 0.0), step_now).repeated) << "a repeat is heard too";
  const std::uint32_t standing = arbiter.standing()->id;
  EXPECT_FALSE(arbiter.decide(ask(1000, 1, 0.2, 0.0), step_now).repeated);  // takes the place of client 2
  EXPECT_EQ(arbiter.standing()->id, standing + 1);
  EXPECT_TRUE(arbiter.decide(ask(1000, 1, 0.2, 0.0), step_now).repeated);
  EXPECT_TRUE(arbiter.decide(ask(1, 5, 0.1, 0.0), step_now).repeated);
  for (std::uint64_t client = 3; client <= Arbiter::client_max; ++client)
    EXPECT_TRUE(arbiter.decide(ask(client, 5, 0.1, 0.0), step_now).repeated) << client;
  EXPECT_EQ(arbiter.standing()->id, standing + 1);
  EXPECT_FALSE(arbiter.decide(ask(2, 5, 0.1, 0.0), step_now).repeated) << "forgotten: judged anew";
  EXPECT_EQ(arbiter.standing()->id, standing + 2);
}

TEST(Arbiter, NamelessRequestsTakeNobodysPlace) {
  Arbiter arbiter{weak_grid()};
  arbiter.decide(ask(alice, 1, 0.1, 0.0), step_now);
  for (std::uint32_t n = 0; n < 2 * Arbiter::client_max; ++n) {
    arbiter.decide(ask(0, n, 0.1, 0.0), step_now);
    arbiter.decide(ask(bob + n, 0, 0.1, 0.0), step_now);
  }
  EXPECT_TRUE(arbiter.decide(ask(alice, 1, 0.1, 0.0), step_now).repeated);
}

// A stream of requests as bad as a network can bring: every rule at once, and twice the same bits.
Request hostile(std::mt19937_64& bits) {
  constexpr double values[] = {0.0,  0.1,   -0.3, 0.5,   0.707,  1.8, 1.9, 2.3, -0.7,
                               10.0, -10.0, 11.0, 1e300, 5e-324, nan, inf, -inf};
  const auto value = [&] { return values[bits() % std::size(values)]; };
  Request request;
  request.who.name.text = {'a', 'n', 'n'};
  request.client = bits() % 80;
  request.id = static_cast<std::uint32_t>(bits() % 3 == 0 ? bits() : bits() % 300);
  request.given = static_cast<std::uint32_t>(bits() % 9);
  request.p = value();
  request.q = value();
  request.v_c = value();
  request.ramp_s = bits() % 2 == 0 ? 0.0 : value();
  request.effective_step = bits() % 2 == 0 ? 0 : bits() % 4 == 0 ? bits() : bits() % 40'000;
  return request;
}

TEST(ArbiterLaw, HostileStreamOnlyEverIssuesWhatTheEnvelopeAdmitsAndRepeatsItself) {
  constexpr std::uint64_t seed = 20'261'122;
  const char* text = std::getenv("WEAKGRID_LAW_COUNT");
  const std::uint64_t count = text != nullptr ? std::strtoull(text, nullptr, 10) : 20'000;
  const Arbiter::Configuration configuration = weak_grid();
  Arbiter arbiter{configuration}, twin{configuration};
  std::mt19937_64 bits{seed};
  std::uint32_t issued = 0;
  std::vector<std::uint64_t> seen(4);
  for (std::uint64_t n = 0; n < count; ++n) {
    const Request request = hostile(bits);
    const Decision decision = arbiter.decide(request, n);
    const Decision twins = twin.decide(request, n);
    ASSERT_TRUE(same(decision, twins)) << "seed " << seed << ", request " << n;
    ASSERT_EQ(decision.repeated, twins.repeated) << "seed " << seed << ", request " << n;
    ASSERT_EQ(decision.reference.has_value(), decision.verdict == Verdict::accepted) << "request " << n;
    ASSERT_EQ(decision.client, request.client);
    ASSERT_EQ(decision.id, request.id);
    const bool refused = std::any_of(decision.margins.begin(), decision.margins.end(), violated);
    ASSERT_EQ(refused,
              decision.verdict == Verdict::outside_envelope || decision.verdict == Verdict::not_stable)
        << "seed " << seed << ", request " << n;
    ASSERT_EQ(decision.field != Field::none,
              decision.verdict == Verdict::bad_request || decision.verdict == Verdict::stale_request);
    if (!decision.repeated) ++seen[static_cast<std::size_t>(decision.verdict)];
    if (decision.reference && !decision.repeated) {
      const Reference& reference = *decision.reference;
      ASSERT_EQ(reference.id, ++issued) << "seed " << seed << ", request " << n;
      ASSERT_GT(reference.effective_step, n);
      ASSERT_GE(reference.ramp_steps, 10u);
      ASSERT_LE(reference.ramp_steps, 600'000u);
      ASSERT_TRUE(assess(configuration.box, configuration.converter, configuration.limits,
                         {reference.p, reference.q, reference.v_c})
                      .admissible)
          << "seed " << seed << ", request " << n;
    }
    ASSERT_EQ(arbiter.standing() ? arbiter.standing()->id : 0u, issued)
        << "seed " << seed << ", request " << n;
  }
  for (const std::uint64_t verdicts : seen)
    EXPECT_GT(verdicts, count / 1000) << "the law must see every verdict";
}

}  // namespace
}  // namespace weakgrid
