// One gateway re-executed, fed by hand: what is compared of one that was restarted, whose journal nobody records.
#include "services/recording/gateway_replica.hpp"

#include <gtest/gtest.h>

#include "services/decision_text.hpp"

namespace weakgrid {
namespace {

constexpr std::uint64_t lease_steps = 100'000;

Reference order(std::uint32_t id, double p) {
  Reference r{.id = id, .p = p, .v_c = 1.84};
  r.ramp_steps = 200;
  r.lease_end_step = lease_steps;
  r.fallback_v_c = 1.84;
  return r;
}

// Goes on where a journal ends at order 4, and says what the replica is to say again.
struct Restarted {
  Arbiter::Configuration configuration = [] {
    Arbiter::Configuration c;
    c.initial.v_c = 1.84;
    return c;
  }();
  Arbiter arbiter{configuration};
  UnitInputs inputs;
  GatewayReplica::Requests requests;
  GatewayReplica replica{1, "gateway"};
  DifferenceLog differences;
  std::uint64_t sequence = 0;

  explicit Restarted(double p_before) {
    arbiter.adopt(order(4, p_before));
    arbiter.leave_room();
    inputs.references = {{4, order(4, p_before)}};
    replica.configure(configuration, true, "test");
  }
  void unit(UnitState state, std::uint64_t step) {
    if (inputs.plants.empty()) inputs.plants.push_back({"plant", 0, {}, {}, {}});
    inputs.plants.back().states.emplace_back(step, state);
    arbiter.note_unit(state);
    if (!is_blocked(state)) return arbiter.unblock();
    replica.see(arbiter.block());
  }
  Decision ask(RequestKind kind, std::uint64_t step, double p = 0.0) {
    Request request{.client = 1, .id = static_cast<std::uint32_t>(sequence + 1), .kind = kind};
    if (kind == RequestKind::set) request.given = given_p;
    request.p = p;
    request.who.name.text = {'a'};
    requests.emplace(std::pair{request.client, request.id}, request);
    const Decision decision = arbiter.decide(request, step);
    replica.see(++sequence, {decision, describe(decision, configuration.timing)}, inputs.plants.size());
    if (decision.reference) replica.see(*decision.reference);
    return decision;
  }
};

TEST(GatewayReplica, WhoWasRestartedOnATrippedUnitIsComparedFromItsFirstWord) {
  Restarted r(0.1);
  r.unit(UnitState::tripped, 0);
  EXPECT_EQ(r.ask(RequestKind::set, 1000, 0.1).verdict, Verdict::unit_blocked);
  EXPECT_EQ(r.ask(RequestKind::reset, 1010).verdict, Verdict::accepted);
  r.unit(UnitState::running, 1020);
  for (const double p : {0.05, -0.05, 0.1})
    EXPECT_EQ(r.ask(RequestKind::set, 1030, p).verdict, Verdict::accepted);
  r.replica.process(r.inputs, r.requests, {}, r.differences);
  EXPECT_EQ(r.differences.count(), 0u);
  EXPECT_EQ(r.replica.findings().decisions_identical, 5u);
  EXPECT_EQ(r.replica.findings().references_identical, 4u);
}

// What stands when a ramp begins is in the margins of its path.
TEST(GatewayReplica, UntilTheUnitIsWhereAnOrderLeadsAGuessThatFailsIsNoDifference) {
  Restarted r(0.1);
  r.inputs.references.clear();  // and so what stood is not known
  r.unit(UnitState::running, 0);
  const Decision first = r.ask(RequestKind::set, 1000, 0.3);
  ASSERT_EQ(first.verdict, Verdict::accepted);
  EXPECT_EQ(r.ask(RequestKind::set, 1060, 0.2).verdict, Verdict::accepted);
  EXPECT_EQ(r.ask(RequestKind::set, 1000 + first.steps_to_reach + 1000, 0.1).verdict, Verdict::accepted);
  r.replica.process(r.inputs, r.requests, {}, r.differences);
  EXPECT_EQ(r.differences.count(), 0u);
  EXPECT_GE(r.replica.findings().decisions_identical, 1u);
}

TEST(GatewayReplica, AnotherDecisionThanItWouldTakeIsADifference) {
  Restarted r(0.1);
  r.unit(UnitState::tripped, 0);
  EXPECT_EQ(r.ask(RequestKind::set, 1000, 0.1).verdict, Verdict::unit_blocked);
  r.unit(UnitState::running, 1020);
  ASSERT_EQ(r.ask(RequestKind::set, 1030, 0.05).verdict, Verdict::accepted);
  Decision forged = r.arbiter.decide({}, 1040);
  forged.client = 1;
  forged.id = 9;
  r.requests.emplace(std::pair{1u, 9u}, Request{.client = 1, .id = 9, .given = given_p, .p = 0.06});
  forged.request_fingerprint = fingerprint(r.requests.find({1u, 9u})->second);
  forged.verdict = Verdict::outside_envelope;
  r.replica.see(3, {forged, "refused"}, 1);
  r.replica.process(r.inputs, r.requests, {}, r.differences);
  EXPECT_GT(r.differences.count(), 0u);
}

}  // namespace
}  // namespace weakgrid
