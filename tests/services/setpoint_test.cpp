// Setpoints asked for from outside, as a person and as a hostile peer would: on the paper's weak grid, X_g =
// 0.3.
#include <gtest/gtest.h>
#include <signal.h>

#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>

#include "gateway/envelope.hpp"
#include "services/runtime/settings.hpp"
#include "tests/services/bystander.hpp"

namespace weakgrid {
namespace {

using nlohmann::json;

constexpr double nan = std::numeric_limits<double>::quiet_NaN();
constexpr double inf = std::numeric_limits<double>::infinity();

class Setpoints : public testing::Test {
 protected:
  void SetUp() override {
    services_.start_all();
    bystander_.emplace(domain_);
    ASSERT_TRUE(bystander_->runs());
  }

  test::Ended weakgrid(std::vector<std::string> arguments) {
    arguments.insert(arguments.end(), {"--domain", domain_.text()});
    return test::run("weakgrid", arguments);
  }
  // A busy machine may take its time to find the gateway.
  test::Ended set(std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(), "set");
    arguments.insert(arguments.end(), {"--timeout", "60"});
    return weakgrid(std::move(arguments));
  }

  double margin(Limit limit, double p, double q) const {
    const Settings settings = load_settings(file_.path());
    const Arbiter::Configuration c = arbiter_configuration(settings);
    const Assessment assessment = assess(c.box, c.converter, c.limits, {p, q, c.initial.v_c});
    const LimitMargin* found = assessment.margins.find(limit);
    return found != nullptr ? found->margin : nan;
  }

  const test::Domain domain_;
  const test::TextFile file_{"[grid]\nreactance = 0.3\n"};
  test::Services services_{domain_, file_.path()};
  std::optional<test::Bystander> bystander_;
};

// The number after `before` in `text`.
double number_after(const std::string& before, const std::string& text) {
  const std::size_t at = text.find(before);
  return at == std::string::npos ? nan : std::stod(text.substr(at + before.size()));
}

TEST_F(Setpoints, BeyondTheCurrentLimitIsRefusedWithItsMargin) {
  const test::Ended ended = set({"--p", "0.707", "--q", "-0.5"});
  EXPECT_EQ(ended.status, 1) << ended.err;
  EXPECT_NE(ended.out.find("rejected: outside the envelope"), std::string::npos) << ended.out;
  const double expected = margin(Limit::current, 0.707, -0.5);
  ASSERT_LT(expected, 0.0);
  EXPECT_NEAR(number_after("current limit, margin ", ended.out), expected, 1e-6) << ended.out;
  EXPECT_EQ(ended.out.find("lambda), margin"), std::string::npos) << ended.out;
}

TEST_F(Setpoints, WithoutASteadyStateIsRefusedWithLambda) {
  const test::Ended ended = set({"--p", "0.707", "--q", "-0.7"});
  EXPECT_EQ(ended.status, 1) << ended.err;
  const double expected = margin(Limit::steady_state, 0.707, -0.7);
  ASSERT_LT(expected, 0.0);
  EXPECT_NEAR(number_after("no steady state exists (lambda), margin ", ended.out), expected, 1e-6)
      << ended.out;
}

TEST_F(Setpoints, InsideTheEnvelopeIsAcceptedAndTheUnitSettlesThere) {
  const test::Ended ended = set({"--p", "0.5", "--q", "0.1"});
  EXPECT_EQ(ended.status, 0) << ended.err << ended.out;
  EXPECT_EQ(ended.out.find("accepted as reference 1: p = 0.5, q = 0.1"), 0u) << ended.out;
  EXPECT_TRUE(bystander_->settles_at(0.5, 0.1));
}

TEST_F(Setpoints, WhatIsNotGivenStaysAsItStands) {
  ASSERT_EQ(set({"--p", "0.707", "--q", "0.1"}).status, 0);
  const test::Ended only_q = set({"--q", "0.3", "--json"});
  EXPECT_EQ(only_q.status, 0) << only_q.out;
  const json decision = json::parse(only_q.out, nullptr, false);
  ASSERT_FALSE(decision.is_discarded()) << only_q.out;
  EXPECT_EQ(decision["active_power"], 0.707);
  EXPECT_EQ(decision["reactive_power"], 0.3);
  EXPECT_TRUE(bystander_->settles_at(0.707, 0.3));
  // With the p that stands, there is no steady state for this q.
  const test::Ended refused = set({"--q", "-0.7"});
  EXPECT_EQ(refused.status, 1);
  EXPECT_NEAR(number_after("no steady state exists (lambda), margin ", refused.out),
              margin(Limit::steady_state, 0.707, -0.7), 1e-6);
  EXPECT_TRUE(bystander_->settles_at(0.707, 0.3)) << "a refused request has changed something";
}

TEST_F(Setpoints, TheDecisionIsTheSameInTextAndJson) {
  const test::Ended ended = set({"--p", "0.707", "--q", "-0.5", "--json"});
  EXPECT_EQ(ended.status, 1);
  const json decision = json::parse(ended.out, nullptr, false);
  ASSERT_FALSE(decision.is_discarded()) << ended.out;
  EXPECT_EQ(decision["verdict"], "outside the envelope");
  EXPECT_EQ(decision["reference_id"], 0);
  for (const json& limit : decision["margins"])
    if (limit["limit"] == "current limit") {
      EXPECT_DOUBLE_EQ(limit["margin"].get<double>(), margin(Limit::current, 0.707, -0.5));
    }
  const test::Ended bad = set({"--p", "11", "--json"});
  EXPECT_EQ(bad.status, 1);
  EXPECT_NE(bad.out.find("active_power; allowed: a number from -10 to 10"), std::string::npos) << bad.out;
}

TEST(Set, WithoutAGatewayExitsWithThree) {
  const test::Domain domain;
  const test::Ended ended =
      test::run("weakgrid", {"set", "--p", "0.1", "--timeout", "1", "--domain", domain.text()});
  EXPECT_EQ(ended.status, 3);
  EXPECT_NE(ended.err.find("no gateway of unit 1 answers in domain " + domain.text()), std::string::npos)
      << ended.err;
}

TEST(Set, BadUsageExitsWithTwo) {
  for (const std::vector<std::string>& arguments :
       std::vector<std::vector<std::string>>{{"set"},
                                             {"set", "--ramp", "0.1"},
                                             {"set", "--p"},
                                             {"set", "--p", "much"},
                                             {"set", "--p", "0.1", "--domain", "231"},
                                             {"set", "--p", "0.1", "--unit", "0"},
                                             {"set", "--p", "0.1", "--no-such-option"},
                                             {"sett", "--p", "0.1"},
                                             {}}) {
    const test::Ended ended = test::run("weakgrid", arguments);
    EXPECT_EQ(ended.status, 2) << testing::PrintToString(arguments) << ended.err;
    EXPECT_NE(ended.err, "") << testing::PrintToString(arguments);
  }
}

// Requests as the wire carries them.
class RawRequest : public Setpoints {
 protected:
  void SetUp() override {
    Setpoints::SetUp();
    if (HasFatalFailure()) return;
    requests_.emplace(bystander_->client().bus(), 1);
    decisions_.emplace(bystander_->client().bus(), 1, [this](const DecisionMessage& message, Arrival) {
      const std::lock_guard lock(mutex_);
      answers_.push_back(message);
    });
    ASSERT_TRUE(test::wait_until([&] { return requests_->matched() > 0 && decisions_->matched() > 0; }));
  }
  void TearDown() override {
    decisions_.reset();
    requests_.reset();
  }

  std::size_t answer_count() {
    const std::lock_guard lock(mutex_);
    return answers_.size();
  }

  // The next decision on this request. Asks again, as every client does: the gateway may have found the
  // writer of requests before it found the reader of decisions.
  std::optional<DecisionMessage> ask(Request request) {
    // The bystander's, who holds authority.
    if (request.who.name.empty()) request.who.name.text = {'s', 'o', 'm', 'e', 'b', 'o', 'd', 'y'};
    const std::size_t before = answer_count();
    std::optional<DecisionMessage> found;
    test::wait_until([&] {
      (void)requests_->write(request);
      return test::wait_until(
          [&] {
            const std::lock_guard lock(mutex_);
            for (std::size_t n = before; n < answers_.size(); ++n)
              if (answers_[n].decision.client == request.client && answers_[n].decision.id == request.id)
                found = answers_[n];
            return found.has_value();
          },
          test::milliseconds(500));
    });
    if (!found) ADD_FAILURE() << "no answer to request " << request.id << " of client " << request.client;
    return found;
  }

  std::mutex mutex_;
  std::vector<DecisionMessage> answers_;
  std::optional<Writer<Request>> requests_;
  std::optional<Reader<DecisionMessage>> decisions_;
};

TEST_F(RawRequest, ARepeatGetsTheSameDecisionAndIssuesNothingNew) {
  const Request first{.client = 7, .id = 1, .given = given_p | given_q, .p = 0.5, .q = 0.1};
  const auto decision = ask(first);
  ASSERT_TRUE(decision && decision->decision.reference);
  Request other = first;  // (client, id) names it, whatever else it says
  other.p = 0.2;
  for (const Request& repeat : {first, other, first}) {
    const auto again = ask(repeat);
    ASSERT_TRUE(again && again->decision.reference);
    EXPECT_EQ(again->text, decision->text);
    EXPECT_EQ(again->decision.verdict, Verdict::accepted);
    EXPECT_EQ(again->decision.setpoint.p, 0.5);
    EXPECT_EQ(again->decision.reference->id, decision->decision.reference->id);
    EXPECT_EQ(again->decision.reference->effective_step, decision->decision.reference->effective_step);
  }
  const auto next = ask({.client = 7, .id = 2, .given = given_q, .q = 0.2});
  ASSERT_TRUE(next && next->decision.reference);
  EXPECT_EQ(next->decision.reference->id, decision->decision.reference->id + 1);
  EXPECT_EQ(next->decision.setpoint.p, 0.5);
  const auto stale = ask({.client = 7, .id = 1, .given = given_q, .q = 0.3});
  ASSERT_TRUE(stale);
  EXPECT_EQ(stale->decision.verdict, Verdict::stale_request);
  EXPECT_TRUE(bystander_->settles_at(0.5, 0.2));
  for (const Reference& reference : bystander_->references())
    EXPECT_LE(reference.id, next->decision.reference->id);
}

TEST_F(RawRequest, AHostileOneIsRefusedAndChangesNothing) {
  ASSERT_TRUE(bystander_->order(0.5, 0.1));
  ASSERT_TRUE(bystander_->settles_at(0.5, 0.1));
  const std::uint32_t standing = bystander_->references().back().id;

  const std::uint32_t all = given_p | given_q | given_v_c;
  const Request good{.client = 666, .id = 0, .given = all, .p = 0.2, .q = 0.0, .v_c = 1.8};
  std::vector<Request> hostile;
  for (const double wrong : {nan, inf, -inf, 1e300, -1e300, 10.1, -10.1}) {
    hostile.push_back(good);
    hostile.back().p = wrong;
    hostile.push_back(good);
    hostile.back().q = wrong;
    hostile.push_back(good);
    hostile.back().v_c = wrong;
  }
  for (const double wrong : {0.0, -1.0}) {
    hostile.push_back(good);
    hostile.back().v_c = wrong;
  }
  for (const double wrong : {nan, inf, -0.1, 1e-9, 61.0}) {
    hostile.push_back(good);
    hostile.back().ramp_s = wrong;
  }
  for (const double wrong : {nan, inf, -1.0, 1e9}) {
    hostile.push_back(good);
    hostile.back().lease_s = wrong;
    hostile.push_back(good);
    hostile.back().kind = RequestKind::set_grid;
    hostile.back().V = {1.0, 1.0};
    hostile.back().X_g = {0.1, wrong};
  }
  hostile.push_back(good);
  hostile.back().who.source = Source::protection;
  for (const std::uint32_t wrong : {0u, 8u, 15u, 0x8000'0001u, 0xffff'ffffu}) {
    hostile.push_back(good);
    hostile.back().given = wrong;
  }
  hostile.push_back(good);
  hostile.back().effective_step = std::numeric_limits<std::uint64_t>::max();
  std::uint32_t id = 0;
  for (Request& request : hostile) request.id = ++id;
  hostile.push_back(good);  // id 0
  hostile.push_back(good);
  hostile.back().id = 1;
  hostile.back().client = 0;

  for (const Request& request : hostile) {
    const auto answer = ask(request);
    ASSERT_TRUE(answer);
    EXPECT_EQ(answer->decision.verdict, Verdict::bad_request) << answer->text << ", id " << request.id;
    EXPECT_FALSE(answer->decision.reference);
    EXPECT_NE(answer->text.find("rejected: bad request: "), std::string::npos) << answer->text;
    EXPECT_NE(answer->text.find("; allowed: "), std::string::npos) << answer->text;
  }
  // The next that is good has the next id, and finds standing what stood.
  const auto next = ask({.client = 8, .id = 1, .given = given_q, .q = 0.15});
  ASSERT_TRUE(next && next->decision.reference);
  EXPECT_EQ(next->decision.reference->id, standing + 1);
  EXPECT_EQ(next->decision.setpoint.p, 0.5);
  EXPECT_TRUE(bystander_->settles_at(0.5, 0.15));
  EXPECT_EQ(bystander_->count("plant", "refused_references"), 0u);
}

TEST_F(RawRequest, AStepThatHasPassedIsStale) {
  const auto answer = ask({.client = 9, .id = 1, .given = given_p, .p = 0.1, .effective_step = 1});
  ASSERT_TRUE(answer);
  EXPECT_EQ(answer->decision.verdict, Verdict::stale_request);
  EXPECT_FALSE(answer->decision.reference);
}

TEST_F(RawRequest, AnotherUnitsRequestIsNotAnswered) {
  Writer<Request> to_another(bystander_->client().bus(), 2);
  ASSERT_TRUE(test::wait_until([&] { return to_another.matched() > 0; }));
  ASSERT_TRUE(to_another.write({.client = 10, .id = 1, .given = given_p, .p = 0.1}));
  // Reliable and in order from one writer: once the second is answered, the first has been seen.
  const auto answer = ask({.client = 11, .id = 1, .given = given_p, .p = 0.2});
  ASSERT_TRUE(answer && answer->decision.reference);
  const std::lock_guard lock(mutex_);
  for (const DecisionMessage& message : answers_) EXPECT_NE(message.decision.client, 10u);
}

TEST_F(Setpoints, StatusIsZeroWithAllThreeAndOneWithoutTheController) {
  // How long `status` listens is given, how long discovery takes is not.
  test::Ended ended;
  EXPECT_TRUE(test::wait_until([&] {
    ended = weakgrid({"status", "--wait", "3"});
    return ended.status == 0;
  })) << ended.status
      << ended.out << ended.err;
  for (const char* word : {"plant", "controller", "gateway", "running", "step "})
    EXPECT_NE(ended.out.find(word), std::string::npos) << word << " is not in\n" << ended.out;
  services_["controller"].send(SIGTERM);
  ASSERT_EQ(services_["controller"].wait(), 0);
  ended = weakgrid({"status", "--wait", "3"});
  EXPECT_EQ(ended.status, 1);
  EXPECT_NE(ended.out.find("controller: none that works in domain " + domain_.text()), std::string::npos)
      << ended.out;
}

TEST_F(Setpoints, StatusInJsonNamesServicesAndMeasurement) {
  ASSERT_EQ(set({"--p", "0.5", "--q", "0.1"}).status, 0);
  ASSERT_TRUE(bystander_->settles_at(0.5, 0.1));
  json status;
  EXPECT_TRUE(test::wait_until([&] {
    const test::Ended ended = weakgrid({"status", "--wait", "3", "--json"});
    status = json::parse(ended.out, nullptr, false);
    return ended.status == 0 && !status.is_discarded() && status["services"].size() == 3 &&
           status.contains("measurement");
  })) << status.dump(2);
  EXPECT_NEAR(status["measurement"]["active_power"].get<double>(), 0.5, 1e-3);
  EXPECT_NEAR(status["measurement"]["reactive_power"].get<double>(), 0.1, 1e-3);
  EXPECT_EQ(status["measurement"]["blocked"], false);
}

TEST(Status, WithNobodyThereIsOne) {
  const test::Domain domain;
  const test::Ended ended = test::run("weakgrid", {"status", "--wait", "0.5", "--domain", domain.text()});
  EXPECT_EQ(ended.status, 1);
  for (const char* service : {"plant", "controller", "gateway"})
    EXPECT_NE(ended.out.find(std::string(service) + ": none that works"), std::string::npos) << ended.out;
}

TEST(Operate, WithNobodyThereExitsWithThree) {
  const test::Domain domain;
  const test::Ended ended =
      test::run("weakgrid", {"operate", "reset", "--timeout", "0.5", "--domain", domain.text()});
  EXPECT_EQ(ended.status, 3);
  EXPECT_NE(ended.err.find("no gateway of unit 1 answers in domain " + domain.text()), std::string::npos)
      << ended.err;
  const test::Ended advance = test::run("weakgrid", {"operate", "advance", "--domain", domain.text()});
  EXPECT_EQ(advance.status, 3);
  EXPECT_NE(advance.err.find("no plant of unit 1 in domain " + domain.text()), std::string::npos)
      << advance.err;
}

}  // namespace
}  // namespace weakgrid
