// What services make of single messages, without a bus: cases that the simulation of the whole has found.
#include <gtest/gtest.h>

#include <limits>
#include <nlohmann/json.hpp>

#include "services/controller_dialogue.hpp"
#include "services/gateway_dialogue.hpp"
#include "services/plant_dialogue.hpp"

namespace weakgrid {
namespace {

struct Anybody {
  bool is_alive(WriterId) const { return true; }
};
constexpr std::uint64_t for_ever = std::numeric_limits<std::uint64_t>::max();

Reference order(std::uint32_t id, double p, double q, std::uint64_t effective_step) {
  return {.id = id, .p = p, .q = q, .v_c = 1.84, .effective_step = effective_step, .ramp_steps = 20};
}

// Plant and controller that hear each other, step by step.
struct Pair {
  PlantDialogue plant{{}, {}, for_ever};
  ControllerDialogue controller{{}};

  Measurement sample() {
    plant.hear([](const Operation&) {});
    return plant.emulator().sample();
  }
  Modulation step() {
    const Measurement m = sample();
    const Modulation answer = *controller.answer(m, {});
    plant.keep(answer);
    plant.advance(plant.answer_to(m));
    return answer;
  }
  void tell_both(const Reference& reference) {
    plant.keep(reference);
    controller.keep(reference);
  }
};

using Clock = std::chrono::steady_clock;
using std::chrono::microseconds;
using std::chrono::milliseconds;

// A plant in lockstep, and two controllers of which the second follows; a step takes 100 µs, an unanswered
// sample comes again after 20 ms.
struct Redundant {
  static constexpr WriterId ids[] = {1, 2};
  PlantDialogue plant{{}, {}, for_ever};
  ControllerDialogue first{{}, Redundancy::first}, second{{}, Redundancy::second};
  bool first_runs = true, second_hears = true;
  Clock::time_point now{std::chrono::hours(1)};

  ControllerDialogue& of(WriterId id) { return id == 1 ? first : second; }
  void tell_all(const Reference& reference) {
    plant.keep(reference);
    first.keep(reference);
    second.keep(reference);
  }
  // What each makes of the sample, and hears of the other.
  void send(const Measurement& m) {
    for (const WriterId id : ids) {
      if (id == 1 ? !first_runs : !second_hears) continue;
      ControllerDialogue& self = of(id);
      const auto answer = self.answer(m, now);
      if (!answer) continue;
      if (id == 1 || first_runs) {
        of(3 - id).hear(*answer);
        if (m.step % 50 == 0) of(3 - id).hear(self.controller().state());
      }
      if (plant.admit(id, answer->epoch, Anybody{}, now)) plant.keep(*answer);
    }
  }
  // Time from when the sample was first sent to its answer; none: nobody answers for a second.
  std::optional<milliseconds> step() {
    plant.hear([](const Operation&) {});
    const Measurement m = plant.emulator().sample();
    const Clock::time_point sent = now;
    for (; now - sent < std::chrono::seconds(1); now += milliseconds(20)) {
      send(m);
      if (const auto answer = plant.answer_to(m)) {
        plant.advance(answer);
        driver = *answer;
        const auto waited = std::chrono::duration_cast<milliseconds>(now - sent);
        now += microseconds(100);
        return waited;
      }
    }
    return std::nullopt;
  }
  Modulation driver;
};

TEST(Standby, TakesOverToTheBitAndWhoComesBackFollows) {
  Redundant two;
  Pair one;
  for (int k = 0; k < 400; ++k) {
    if (k == 20) {
      two.tell_all(order(1, 0.5, 0.1, 30));
      one.tell_both(order(1, 0.5, 0.1, 30));
    }
    if (k == 130) two.first_runs = false;
    if (k == 300) two.first_runs = true;  // stopped, not killed: it goes on where it was
    const auto waited = two.step();
    ASSERT_TRUE(waited) << k;
    EXPECT_EQ(waited->count(), k == 130 ? 20 : 0) << k;
    const Modulation alone = one.step();
    EXPECT_EQ(two.driver.epoch, k < 130 ? 1u : 2u) << k;
    EXPECT_EQ(two.driver.mu.re, alone.mu.re) << k;
    EXPECT_EQ(two.driver.mu.im, alone.mu.im) << k;
    EXPECT_EQ(two.driver.status, alone.status) << k;
  }
  EXPECT_FALSE(two.first.leads());
  EXPECT_TRUE(two.first.is_in_step()) << "it has taken the state of who leads";
  EXPECT_EQ(two.second.takeovers(), 1u);
  EXPECT_GT(two.plant.foreign(), 0u) << "it answered before it heard";
  two.second_hears = false;
  EXPECT_EQ(two.step()->count(), 20) << "and takes over in turn";
  EXPECT_EQ(two.driver.epoch, 3u);
}

TEST(Standby, ASampleFromFarAheadCostsNoMoreThanAnother) {
  Redundant two;
  two.tell_all(order(1, 0.5, 0.1, 30));
  two.second_hears = false;
  for (int k = 0; k < 60; ++k) ASSERT_TRUE(two.step());
  two.second_hears = true;
  for (int k = 60; k < 63; ++k) ASSERT_TRUE(two.step());
  ASSERT_FALSE(two.second.is_in_step());
  Measurement far = two.plant.emulator().sample();
  far.step = std::uint64_t{1} << 60;
  two.second.hear(two.first.controller().state());
  (void)two.second.answer(far, two.now);  // to do all again in between would take for ever
  EXPECT_FALSE(two.second.leads());
}

TEST(Standby, AnEpochThatNobodyCouldReplaceIsNobodys) {
  Redundant two;
  ASSERT_TRUE(two.step());
  EXPECT_FALSE(two.plant.admit(3, ~std::uint64_t{0}, Anybody{}, two.now));
  EXPECT_TRUE(two.plant.admit(3, 7, Anybody{}, two.now)) << "another may take over";
}

TEST(Standby, WhoJoinsLateIsInStepWithinAState) {
  Redundant two;
  two.tell_all(order(1, 0.5, 0.1, 30));
  two.second_hears = false;
  for (int k = 0; k < 160; ++k) ASSERT_TRUE(two.step());
  two.second_hears = true;
  for (int k = 160; k < 200; ++k) ASSERT_TRUE(two.step());
  EXPECT_FALSE(two.second.is_in_step());
  for (int k = 200; k < 203; ++k) ASSERT_TRUE(two.step());
  EXPECT_TRUE(two.second.is_in_step());
  EXPECT_FALSE(two.second.leads());
}

TEST(Standby, OutOfStepItStartsAnewAndNotFromAGuess) {
  Redundant two;
  two.tell_all(order(1, 0.5, 0.1, 30));
  two.second_hears = false;
  for (int k = 0; k < 160; ++k) ASSERT_TRUE(two.step());
  two.second_hears = true;
  for (int k = 160; k < 180; ++k) ASSERT_TRUE(two.step());
  two.first_runs = false;
  ASSERT_TRUE(two.step());
  EXPECT_EQ(two.driver.epoch, 2u);
  EXPECT_NE(two.driver.status & started, 0u);
  EXPECT_EQ(two.driver.reference_id, 1u) << "what is in force it knows";
}

TEST(Standby, WaitsForAFirstThatNeverComesAndThenLeads) {
  Redundant two;
  two.first_runs = false;
  EXPECT_FALSE(two.step()) << "1 s";
  EXPECT_FALSE(two.step()) << "2 s";
  EXPECT_TRUE(two.step());
  EXPECT_EQ(two.driver.epoch, 1u);
}

TEST(Standby, WhoWasStoppedItselfDoesNotTakeOver) {
  Redundant two;
  for (int k = 0; k < 60; ++k) ASSERT_TRUE(two.step());
  two.second_hears = false;
  for (int k = 60; k < 70; ++k) ASSERT_TRUE(two.step());
  two.now += milliseconds(300);
  two.second_hears = true;
  for (int k = 70; k < 200; ++k) ASSERT_TRUE(two.step());
  EXPECT_EQ(two.second.takeovers(), 0u);
  EXPECT_TRUE(two.first.leads());
}

TEST(Dialogue, AnAnswerToAnotherPlantsSampleOfThatStepIsNotUsed) {
  Pair pair;
  for (int k = 0; k < 10; ++k) (void)pair.step();
  const Measurement own = pair.sample();
  Measurement other = own;
  other.i = {0.1, 0.0};
  const Modulation answer_to_other = *ControllerDialogue({}).answer(other, {});
  ASSERT_EQ(answer_to_other.step, own.step);
  pair.plant.keep(answer_to_other);
  EXPECT_FALSE(pair.plant.answer_to(own));
  EXPECT_EQ(pair.plant.foreign(), 1u);
  pair.plant.keep(*pair.controller.answer(own, {}));
  EXPECT_TRUE(pair.plant.answer_to(own)) << "and its own answer still comes in time";
}

TEST(Dialogue, AnAnswerThatNamesNoSampleIsTakenAtItsStep) {
  Pair pair;
  const Measurement own = pair.sample();
  Modulation answer = *pair.controller.answer(own, {});
  answer.measurement_fingerprint = 0;
  pair.plant.keep(answer);
  EXPECT_TRUE(pair.plant.answer_to(own));
}

TEST(Dialogue, HoweverManyOrdersWaitTheNewestIsNotLost) {
  Pair pair;
  for (std::uint32_t id = 1; id <= 100; ++id) pair.tell_both(order(id, 0.001 * id, 0.0, 0));
  const Modulation answer = pair.step();
  EXPECT_EQ(pair.sample().reference_id, 100u);
  EXPECT_EQ(answer.reference_id, 100u);
  EXPECT_GT(pair.plant.overflow(), 0u);
  EXPECT_EQ(pair.controller.overflow(), pair.plant.overflow());
}

TEST(Dialogue, WhatIsDueBeginsInTheLawAsInTheSourceEvenIfTheNextOrderIsKnownByThen) {
  Pair pair;
  pair.tell_both(order(1, 0.0, 0.3, 5));
  for (int k = 0; k < 100; ++k) (void)pair.step();
  // Both come between two samples; the second waits for its step.
  pair.tell_both(order(2, 0.0, 0.0, 0));
  pair.tell_both(order(3, 0.1, 0.1, 1000));
  const Modulation answer = pair.step();
  EXPECT_EQ(answer.reference_id, 2u);
  EXPECT_EQ(pair.sample().reference_id, 2u);
  EXPECT_EQ(answer.newest_reference_id, 3u);
}

// All that a gateway says.
struct Heard : GatewayOutlet {
  std::vector<Reference> references;
  std::vector<Decision> decisions;
  bool write(const Reference& r) override { return references.push_back(r), true; }
  bool write(const Operation&) override { return true; }
  bool write(const DecisionMessage& d) override { return decisions.push_back(d.decision), true; }
  bool write(const Envelope&) override { return true; }
  bool keeps() const override { return false; }
  bool keep(std::string_view, nlohmann::json) override { return false; }
};

// A gateway that was started again with a journal that ends at order 4, on a running unit at step 1000.
struct Restarted {
  Heard said;
  GatewayDialogue::Time now{std::chrono::hours(1)};
  GatewayDialogue gateway{Settings{}, 5, "", memory(), said, now};
  Measurement sample = [] {
    Measurement m;
    m.step = 1000;
    m.reference_id = 4;
    m.v_p = {1.0, 0.0};
    m.v_c = 1.84;
    return m;
  }();

  Restarted() { now += Precedence::listening; }
  static GatewayMemory memory() {
    GatewayMemory memory;
    memory.reference = order(4, 0.2, 0.0, 500);
    memory.step = 600;
    return memory;
  }
  void hear(const char* service, std::uint32_t newest) {
    Health health;
    health.service = service;
    health.reference_id = newest;
    gateway.hear(health, now);
  }
  void pass(GatewayDialogue::Time::duration time) {
    for (const auto end = now + time; now < end; now += std::chrono::milliseconds(100)) gateway.look_after(now);
  }
  void hear_another(std::uint64_t instance, ServiceState state = ServiceState::running) {
    Health health;
    health.service = "gateway";
    health.instance = instance;
    health.state = state;
    gateway.hear(health, now);
  }
  void watch() {
    ++sample.step;
    gateway.watch(sample, false, now);
  }
  Decision ask(std::uint32_t id, std::uint32_t given) {
    Request request;
    request.client = 1;
    request.id = id;
    request.given = given;
    request.p = 0.1;
    request.v_c = 1.84;
    request.who.name.text = {'a'};
    gateway.decide(request, now);
    return said.decisions.empty() ? Decision{} : said.decisions.back();
  }
};

// Knows the unit and what stands, and has decided one request.
struct Serving : Restarted {
  Serving() {
    hear("plant", 4);
    hear("controller", 4);
    watch();
    EXPECT_EQ(ask(1, given_p).verdict, Verdict::accepted);
  }
  bool answers(std::uint32_t id) {
    const std::size_t before = said.decisions.size();
    (void)ask(id, given_p | given_q | given_v_c);
    return said.decisions.size() > before;
  }
};

TEST(Dialogue, AFirstGatewayKnowsThatNothingStands) {
  Heard said;
  GatewayDialogue::Time now{std::chrono::hours(1)};
  GatewayDialogue gateway{Settings{}, 1, "", {}, said, now};
  now += Precedence::listening;
  for (const char* service : {"plant", "controller"}) {
    Health health;
    health.service = service;
    gateway.hear(health, now);
  }
  Request request;
  request.client = 1;
  request.id = 1;
  request.who.name.text = {'a'};
  request.given = given_p;
  request.p = 0.1;
  gateway.decide(request, now);
  ASSERT_EQ(said.references.size(), 1u);
  EXPECT_EQ(said.references[0].id, 1u);
}

TEST(Dialogue, ARestartedGatewaySaysNothingBeforeItHasHeardWhatPlantAndControllerKnow) {
  Restarted r;
  r.sample.blocked = true;
  r.sample.state = UnitState::tripped;
  r.watch();
  r.hear("plant", 5);
  r.watch();
  EXPECT_TRUE(r.said.references.empty()) << "it might have given the id of theirs to another";
  r.hear("controller", 5);
  r.watch();
  ASSERT_EQ(r.said.references.size(), 1u) << "and the trip is not forgotten";
  EXPECT_GT(r.said.references[0].id, 5u);
}

TEST(Dialogue, AfterARestartNoIdIsGivenThatALostEndOfTheJournalMayHaveGiven) {
  Restarted r;
  r.hear("plant", 4);
  r.hear("controller", 4);
  r.watch();
  ASSERT_EQ(r.said.references.size(), 1u);
  EXPECT_EQ(r.said.references[0].id, 4u) << "what stands is said again";
  const Decision decision = r.ask(1, given_p);
  ASSERT_EQ(decision.verdict, Verdict::accepted) << "and known";
  EXPECT_GT(decision.reference->id, 4u + Arbiter::room);
}

// Found by seed 8578 of tests/deterministic.
TEST(Dialogue, WhatStandsIsKnownAfterARestartThoughARequestComesBeforeTheFirstSample) {
  Restarted r;
  r.hear("plant", 4);
  r.hear("controller", 4);
  r.pass(std::chrono::seconds(4));  // the unit stands still
  EXPECT_EQ(r.ask(1, given_p).field, Field::given) << "nor is it guessed";
  r.watch();
  ASSERT_EQ(r.said.references.size(), 1u);
  EXPECT_EQ(r.said.references[0].id, 4u);
  const Decision decision = r.ask(2, given_p);
  ASSERT_EQ(decision.verdict, Verdict::accepted);
  EXPECT_GT(decision.reference->id, 4u + Arbiter::room);
}

TEST(Dialogue, ARestartedGatewayThatLearnsOfANewerOrderThanItsJournalsDoesNotGuess) {
  for (const bool late : {false, true}) {
    Restarted r;
    r.hear("plant", late ? 4 : 7);
    r.hear("controller", 4);
    r.watch();
    if (late) r.hear("controller", 7);
    EXPECT_EQ(r.ask(1, given_p).field, Field::given);
    const Decision decision = r.ask(2, given_p | given_q | given_v_c);
    ASSERT_EQ(decision.verdict, Verdict::accepted);
    EXPECT_GT(decision.reference->id, 7u);
    EXPECT_EQ(r.ask(3, given_p).verdict, Verdict::accepted) << "now it knows";
    r.hear("plant", 7);  // is behind
    EXPECT_EQ(r.ask(4, given_p).verdict, Verdict::accepted);
  }
}

TEST(OneGateway, WhoComesWhileAnotherServesStandsByUntilThatIsSilent) {
  Restarted r;
  r.hear("plant", 7);
  r.hear("controller", 7);
  r.hear_another(9);
  r.watch();
  (void)r.ask(1, given_p | given_q | given_v_c);
  EXPECT_TRUE(r.said.decisions.empty());
  EXPECT_TRUE(r.said.references.empty());
  EXPECT_EQ(r.gateway.health(r.now).service, "standby gateway");
  r.pass(std::chrono::seconds(1));
  r.hear_another(9);
  r.pass(OneWriter::silence_max - std::chrono::milliseconds(100));
  (void)r.ask(2, given_p | given_q | given_v_c);
  EXPECT_TRUE(r.said.decisions.empty());
  r.pass(std::chrono::milliseconds(200));
  r.watch();
  EXPECT_TRUE(r.said.references.empty()) << "what its own journal tells is old";
  EXPECT_EQ(r.ask(3, given_p).field, Field::given) << "what the other has ordered is not known";
  const Decision decision = r.ask(4, given_p | given_q | given_v_c);
  ASSERT_EQ(decision.verdict, Verdict::accepted);
  EXPECT_GT(decision.reference->id, 7u + Arbiter::room) << "the other's last ids may not have been heard of";
  EXPECT_EQ(r.gateway.health(r.now).service, "");
}

TEST(OneGateway, WhoSaysGoodbyeIsFollowedAtOnce) {
  Restarted r;
  r.hear("plant", 7);
  r.hear("controller", 7);
  r.hear_another(9);
  r.watch();
  r.hear_another(9, ServiceState::stopped);
  r.watch();
  EXPECT_EQ(r.ask(1, given_p | given_q | given_v_c).verdict, Verdict::accepted);
}

TEST(OneGateway, OfTwoThatServeTheLowerInstanceGoesOn) {
  Serving higher, lower;
  higher.hear_another(4);
  EXPECT_FALSE(higher.answers(2));
  lower.hear_another(6);
  EXPECT_TRUE(lower.answers(2));
}

TEST(OneGateway, WhoComesBackFromAStopGoesOnWhereNobodyHasReplacedIt) {
  Serving alone, replaced;
  for (Serving* g : {&alone, &replaced}) {
    g->now += std::chrono::seconds(3);
    EXPECT_FALSE(g->answers(2)) << "it listens first";
  }
  replaced.hear_another(9);
  for (Serving* g : {&alone, &replaced}) {
    g->pass(Precedence::listening);
    g->watch();
  }
  EXPECT_FALSE(replaced.answers(3));
  EXPECT_EQ(alone.ask(3, given_p).verdict, Verdict::accepted) << "and knows what stands";
}

TEST(OneGateway, WhoTookOverFromTheDeadDoesNotTakeItForAliveAfterAStop) {
  Serving g;
  g.hear_another(9);  // in vain: it is the higher
  EXPECT_TRUE(g.answers(2));
  for (const auto quiet : {std::chrono::milliseconds(500), std::chrono::milliseconds(60'000)}) {
    g.pass(quiet);
    g.now += std::chrono::seconds(1);
    g.pass(Precedence::listening + std::chrono::milliseconds(100));
    g.watch();
    EXPECT_EQ(g.gateway.health(g.now).service, "");
  }
  EXPECT_EQ(g.ask(3, given_p).verdict, Verdict::accepted) << "and knows what stands";
}

TEST(OneGateway, WhoStoodStillWithTheOtherDoesNotTakeItForSilent) {
  Restarted r;
  r.hear("plant", 7);
  r.hear("controller", 7);
  r.hear_another(9);
  r.watch();
  r.now += std::chrono::seconds(10);
  r.pass(OneWriter::silence_max - std::chrono::milliseconds(100));
  (void)r.ask(1, given_p | given_q | given_v_c);
  EXPECT_TRUE(r.said.decisions.empty());
}

}  // namespace
}  // namespace weakgrid
