// The supervisor as people meet it, real processes over DDS: offers, authority, leases, a client and a
// gateway that die, and the journal that tells why.
#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <random>

#include "tests/services/bystander.hpp"

namespace weakgrid {
namespace {

using nlohmann::json;

class Supervised : public testing::Test {
 protected:
  void SetUp() override {
    for (const char* service : {"plant", "controller", "gateway"}) services_.start(service);
    bystander_.emplace(domain_);
    ASSERT_TRUE(bystander_->runs());
  }
  void TearDown() override { std::filesystem::remove(journal_); }

  test::Ended weakgrid(std::vector<std::string> arguments) {
    arguments.insert(arguments.end(), {"--domain", domain_.text()});
    return test::run("weakgrid", arguments);
  }
  // With --json; what it says, and how it ended.
  std::pair<json, int> ask(std::vector<std::string> arguments) {
    arguments.insert(arguments.end(), {"--timeout", "60", "--json"});
    const test::Ended ended = weakgrid(std::move(arguments));
    return {json::parse(ended.out, nullptr, false), ended.status};
  }
  std::uint64_t entries(const std::string& kind) {
    const test::Ended ended = test::run("weakgrid", {"journal", journal_, "--kind", kind});
    return static_cast<std::uint64_t>(std::count(ended.out.begin(), ended.out.end(), '\n'));
  }
  void expect_intact_journal() {
    const test::Ended ended = test::run("weakgrid", {"journal", journal_, "--verify"});
    EXPECT_EQ(ended.status, 0) << ended.out << ended.err;
  }

  const test::Domain domain_;
  const std::string journal_ = std::filesystem::temp_directory_path() /
                               ("weakgrid_supervised_" + std::to_string(::getpid()) + ".journal");
  const test::TextFile file_{
      "[grid]\nreactance = 0.3\n[gateway]\ngrid_reactance = [0.25, 0.35]\nfallback_ramp_s = 0.05\njournal = "
      "\"" +
      journal_ + "\"\n"};
  test::Services services_{domain_, file_.path()};
  std::optional<test::Bystander> bystander_;
};

TEST_F(Supervised, ARefusalIsExplainedAndItsOfferAcceptedByToken) {
  auto [refused, status] = ask({"set", "--p", "0.7", "--q", "-0.5", "--keep", "p"});
  ASSERT_EQ(status, 1) << refused.dump(2);
  EXPECT_EQ(refused["verdict"], "outside the envelope");
  const bool names_a_grid =
      std::any_of(refused["margins"].begin(), refused["margins"].end(),
                  [](const json& m) { return m["violated"] && m["grid_inductance_s"] > 0.0; });
  EXPECT_TRUE(names_a_grid) << refused["margins"].dump(2);
  ASSERT_TRUE(refused.contains("offer")) << refused.dump(2);
  EXPECT_EQ(refused["offer"]["active_power"], 0.7);
  const auto [accepted, done] = ask({"accept", std::to_string(refused["offer"]["token"].get<int>())});
  ASSERT_EQ(done, 0) << accepted.dump(2);
  EXPECT_EQ(accepted["reference"]["reactive_power"], refused["offer"]["reactive_power"]);
  EXPECT_TRUE(bystander_->settles_at(0.7, refused["offer"]["reactive_power"].get<double>()));
  EXPECT_EQ(ask({"accept", "4711"}).second, 1);
  expect_intact_journal();
  EXPECT_EQ(entries("decision"), 3u);
}

TEST_F(Supervised, WhoHasNoAuthorityIsToldWhoHasAndAHigherSourceTakesOver) {
  ASSERT_EQ(ask({"set", "--p", "0.3", "--as", "schedule", "--name", "plan"}).second, 0);
  auto [refused, status] = ask({"set", "--p", "0.2", "--name", "ann"});
  EXPECT_EQ(status, 1);
  EXPECT_EQ(refused["verdict"], "not authorised");
  EXPECT_EQ(refused["holder"]["name"], "plan");
  ASSERT_EQ(ask({"authority", "take", "--name", "ann"}).second, 0);
  ASSERT_EQ(ask({"set", "--p", "0.2", "--name", "ann"}).second, 0);
  EXPECT_TRUE(bystander_->settles_at(0.2, 0.0));
  const auto [lost, no] = ask({"renew", "--as", "schedule", "--name", "plan"});
  EXPECT_EQ(no, 1);
  EXPECT_EQ(lost["holder"]["name"], "ann") << "the loser is told";
  EXPECT_EQ(entries("authority"), 1u) << "and it is written down";
  ASSERT_EQ(ask({"authority", "release", "--name", "ann"}).second, 0);
  EXPECT_EQ(ask({"set", "--p", "0.25", "--name", "bob"}).second, 0);
}

TEST_F(Supervised, WatchShowsTheUnitAndWhatIsDecided) {
  test::Program watching("weakgrid", {"watch", "--every", "0.2", "--json", "--domain", domain_.text()});
  ASSERT_TRUE(test::wait_until([&] { return watching.out().find("\"active_power\"") != std::string::npos; }));
  ASSERT_EQ(ask({"set", "--p", "0.3"}).second, 0);
  EXPECT_TRUE(test::wait_until([&] {
    return watching.out().find("\"verdict\":\"accepted\"") != std::string::npos;
  })) << watching.out();
  watching.send(SIGINT);
  EXPECT_EQ(watching.wait(), 0);
}

TEST_F(Supervised, AKilledClientLeavesNoSetpointBehind) {
  test::Program holding("weakgrid",
                        {"set", "--p", "0.4", "--lease", "3", "--hold", "--domain", domain_.text()});
  ASSERT_TRUE(bystander_->settles_at(0.4, 0.0));
  // Longer than a lease: it is renewed, and the renewals move nothing.
  const std::uint64_t from = bystander_->measurement()->step;
  ASSERT_TRUE(test::wait_until([&] { return bystander_->measurement()->step > from + 45'000; }));
  ASSERT_TRUE(bystander_->settles_at(0.4, 0.0));
  EXPECT_EQ(bystander_->count("plant", "lease_ends"), 0u);
  holding.kill();
  ASSERT_TRUE(bystander_->settles_at(0.0, 0.0));
  EXPECT_TRUE(test::wait_until([&] { return bystander_->count("plant", "lease_ends") == 1; }));
  EXPECT_TRUE(test::wait_until([&] { return bystander_->count("controller", "lease_ends") == 1; }));
  EXPECT_TRUE(test::wait_until([&] { return entries("lease_end") == 1; })) << "the journal names the cause";
  expect_intact_journal();
}

TEST_F(Supervised, AKilledGatewayGoesOnWhereItsJournalEnds) {
  const std::uint32_t seed = std::random_device{}();
  SCOPED_TRACE("seed " + std::to_string(seed));
  std::mt19937 random(seed);
  ASSERT_EQ(ask({"set", "--p", "0.3", "--q", "0.1", "--name", "ann", "--lease", "3000"}).second, 0);
  for (int n = 0; n < 4; ++n) {
    std::this_thread::sleep_for(test::milliseconds(random() % 300));
    services_["gateway"].kill();
    ASSERT_TRUE(bystander_->goes_on());
    services_.start("gateway");
    // Who holds authority and what stands are known to the new one.
    const auto [refused, no] = ask({"set", "--q", "0.2", "--name", "bob"});
    ASSERT_EQ(no, 1);
    EXPECT_EQ(refused["verdict"], "not authorised") << refused.dump(2);
    EXPECT_EQ(refused["holder"]["name"], "ann");
    const double q = 0.1 + 0.02 * (n + 1);
    const auto [accepted, yes] = ask({"set", "--q", std::to_string(q), "--name", "ann", "--lease", "3000"});
    ASSERT_EQ(yes, 0) << accepted.dump(2);
    EXPECT_EQ(accepted["active_power"], 0.3) << "what was not asked for stays";
    ASSERT_TRUE(bystander_->settles_at(0.3, q));
  }
  expect_intact_journal();
  EXPECT_EQ(entries("started"), 5u);
  EXPECT_EQ(entries("decision"), 9u);
}

TEST_F(Supervised, AfterAllHaveDiedTheJournalBringsNoOldSetpointBack) {
  ASSERT_EQ(ask({"set", "--p", "0.3", "--q", "0.1", "--name", "ann", "--lease", "3000"}).second, 0);
  ASSERT_TRUE(bystander_->settles_at(0.3, 0.1));
  const WriterId old_plant = bystander_->plant();
  for (const char* service : {"plant", "controller", "gateway"}) services_[service].kill();
  for (const char* service : {"gateway", "plant", "controller"}) services_.start(service);
  ASSERT_TRUE(test::wait_until([&] { return bystander_->plant() != old_plant; })) << bystander_->words();
  bystander_->take_source_power_max();
  // Whoever is first: nobody holds authority over a unit that has begun anew, and nothing stands there.
  const auto [accepted, done] = ask({"set", "--p", "0.1", "--name", "bob"});
  ASSERT_EQ(done, 0) << accepted.dump(2);
  EXPECT_EQ(accepted["reactive_power"], 0.0);
  ASSERT_TRUE(bystander_->settles_at(0.1, 0.0));
  EXPECT_LT(bystander_->take_source_power_max(), 0.12) << "the old order was in force for a while";
  EXPECT_EQ(entries("restarted"), 1u);
}

TEST_F(Supervised, AGridToldWeakerDeratesAndTheNextGatewayKnowsIt) {
  ASSERT_EQ(ask({"set", "--p", "0.9", "--q", "0.1", "--name", "ann"}).second, 0);
  const auto [derated, done] = ask({"grid", "--reactance", "0.25", "0.62", "--name", "ann"});
  ASSERT_EQ(done, 0) << derated.dump(2);
  ASSERT_TRUE(derated.contains("reference")) << derated.dump(2);
  const double p = derated["reference"]["active_power"], q = derated["reference"]["reactive_power"];
  EXPECT_TRUE(bystander_->settles_at(p, q));
  services_["gateway"].kill();
  services_.start("gateway");
  const auto [refused, no] = ask({"set", "--p", "0.9", "--q", "0.1", "--name", "ann"});
  EXPECT_EQ(no, 1) << "the grid it was told of is remembered: " << refused.dump(2);
}

// The plant waits at step 2000 until something stands; then its grid gives way.
TEST_F(Supervised, AGridMeasuredToHaveGivenWayDeratesByItself) {
  const test::TextFile file(
      "[grid]\nreactance = 0.3\n[gateway]\ngrid_reactance = [0.25, 0.35]\njournal = \"" + journal_ +
      "\"\n[scenario]\nend_s = 1000.0\n"
      "[[scenario.event]]\nat_s = 0.5\nquantity = \"grid_voltage\"\nvalue = 0.88\nramp_s = 0.02\n");
  const test::Domain domain;
  for (const char* service : {"plant", "controller", "gateway"}) services_[service].kill();
  test::Services services(domain, file.path());
  services.start("plant", {"--until", "2000"});
  services.start("controller");
  services.start("gateway");
  test::Bystander bystander(domain);
  ASSERT_TRUE(test::wait_until([&] { return bystander.is("plant", ServiceState::waiting); }));
  ASSERT_TRUE(bystander.order(0.9, 0.1));
  ASSERT_TRUE(bystander.client().operate(OperationKind::advance, ~std::uint64_t{0}, test::long_enough));
  std::optional<Envelope> envelope;
  ASSERT_TRUE(test::wait_until([&] {
    envelope = bystander.client().envelope();
    return envelope && envelope->reference_id == 2;
  })) << bystander.words();
  EXPECT_LT(envelope->setpoint.p, 0.9);
  EXPECT_LT(envelope->grid.V.low, 0.9);
  EXPECT_EQ(envelope->grid.V.high, 1.0);
  EXPECT_GT(envelope->held_until_step, 0u) << "who holds authority still does";
  for (const LimitMargin& margin : envelope->margins) EXPECT_FALSE(violated(margin)) << int(margin.limit);
  EXPECT_TRUE(bystander.settles_at(envelope->setpoint.p, envelope->setpoint.q));
  const auto last = bystander.measurement();
  EXPECT_LT(abs(last->i), 1.001) << "the limit that the grid's voltage had broken";
  const test::Ended told = test::run("weakgrid", {"journal", journal_});
  EXPECT_NE(told.out.find("measured: |v_g|"), std::string::npos) << told.out;
}

TEST_F(Supervised, WhoIsOverruledIsToldAtOnce) {
  test::Program plan("weakgrid", {"set", "--p", "0.3", "--as", "schedule", "--name", "plan", "--lease",
                                  "3000", "--hold", "--domain", domain_.text()});
  ASSERT_TRUE(bystander_->settles_at(0.3, 0.0));
  ASSERT_EQ(ask({"authority", "take", "--name", "ann"}).second, 0);
  ASSERT_EQ(plan.wait(), 1) << plan.err();
  EXPECT_NE(plan.out().find("ann (operation) holds authority"), std::string::npos) << plan.out();
}

TEST_F(Supervised, StatusTellsWhatStandsAndWhoseItIs) {
  ASSERT_EQ(ask({"set", "--p", "0.3", "--q", "0.1", "--name", "ann"}).second, 0);
  const test::Ended status = weakgrid({"status", "--json"});
  ASSERT_EQ(status.status, 0) << status.out;
  const json envelope = json::parse(status.out, nullptr, false)["envelope"];
  EXPECT_EQ(envelope["standing"]["active_power"], 0.3) << status.out;
  EXPECT_EQ(envelope["holder"]["name"], "ann");
  EXPECT_EQ(envelope["grid_reactance"], json({0.25, 0.35})) << envelope.dump(2);
  EXPECT_EQ(envelope["fallback_holds"], true);
  EXPECT_NE(weakgrid({"status"}).out.find("authority: ann (operation)"), std::string::npos);
}

TEST_F(Supervised, ARestartedGatewayFallsBackIfThatIsWanted) {
  const test::TextFile file("[grid]\nreactance = 0.3\n[gateway]\nafter_restart = \"fallback\"\njournal = \"" +
                            journal_ + "\"\n");
  const test::Domain domain;
  for (const char* service : {"plant", "controller", "gateway"}) services_[service].kill();
  test::Services services(domain, file.path());
  services.start_all();
  test::Bystander bystander(domain);
  ASSERT_TRUE(bystander.runs());
  ASSERT_TRUE(bystander.order(0.4, 0.1));
  ASSERT_TRUE(bystander.settles_at(0.4, 0.1));
  services["gateway"].kill();
  ASSERT_TRUE(bystander.settles_at(0.4, 0.1)) << "without a gateway what was ordered stands";
  services.start("gateway");
  EXPECT_TRUE(bystander.settles_at(0.0, 0.0)) << bystander.words();
  EXPECT_EQ(bystander.count("plant", "tripped"), 0u);
  EXPECT_EQ(entries("fallback"), 1u);
}

TEST_F(Supervised, AScheduleMayBeATable) {
  const auto table = [](const std::string& text) {
    const std::string file =
        std::filesystem::temp_directory_path() / ("weakgrid_table_" + std::to_string(::getpid()) + ".csv");
    std::ofstream(file) << text;
    return file;
  };
  std::string file = table("at_s,active_power,reactive_power\n0.1,0.2,\n0.4,0.7,-0.7\n");
  const test::Ended refused = weakgrid({"schedule", file});
  EXPECT_EQ(refused.status, 1) << refused.out << refused.err;
  EXPECT_NE(refused.err.find("nothing was sent"), std::string::npos) << refused.err;
  file = table("at_s,active_power,reactive_power,lease_s\n0.1,0.2,,\n0.6,0.3,0.1,5\n");
  const test::Ended played = weakgrid({"schedule", file});
  EXPECT_EQ(played.status, 0) << played.out << played.err;
  EXPECT_TRUE(bystander_->settles_at(0.3, 0.1));
  EXPECT_TRUE(bystander_->settles_at(0.0, 0.0)) << "its lease ends";
  for (const auto& [text, complaint] : std::initializer_list<std::pair<const char*, const char*>>{
           {"active_power\n0.1\n", ":1: no column at_s"},
           {"at_s,p\n0,0.1\n", ":1: column 'p'; allowed: at_s"},
           {"at_s,active_power\n0,nan\n", ":2: active_power: 'nan'; allowed: a number from -10 to 10"},
           {"at_s,active_power\n0,0.1\n0,0.2\n", ":3: at_s: 0 is not after 0"},
           {"at_s,active_power\n0\n", ":2: 1 cells, the first line names 2"},
           {"at_s,active_power\n0,\n", ":2: nothing asked for"},
           {"at_s\n", ": no setpoint"}}) {
    const test::Ended bad = weakgrid({"schedule", table(text)});
    EXPECT_EQ(bad.status, 2) << text;
    EXPECT_NE(bad.err.find(complaint), std::string::npos) << bad.err;
  }
  std::filesystem::remove(file);
}

TEST_F(Supervised, AScheduleIsCheckedAsAWholeBeforeTheFirstIsSent) {
  const test::TextFile bad(
      "[scenario]\nend_s = 1.0\n[[scenario.setpoint]]\nat_s = 0.1\nactive_power = 0.2\n"
      "[[scenario.setpoint]]\nat_s = 0.4\nactive_power = 0.7\nreactive_power = -0.7\n");
  const test::Ended refused = weakgrid({"schedule", bad.path()});
  EXPECT_EQ(refused.status, 1) << refused.out << refused.err;
  EXPECT_NE(refused.err.find("nothing was sent"), std::string::npos) << refused.err;
  EXPECT_TRUE(bystander_->references().empty());
  const test::TextFile good(
      "[scenario]\nend_s = 2.0\n[[scenario.setpoint]]\nat_s = 0.1\nactive_power = 0.2\n"
      "[[scenario.setpoint]]\nat_s = 0.6\nactive_power = 0.3\nreactive_power = 0.1\n");
  const test::Ended played = weakgrid({"schedule", good.path()});
  EXPECT_EQ(played.status, 0) << played.out << played.err;
  EXPECT_TRUE(bystander_->settles_at(0.3, 0.1));
  EXPECT_TRUE(bystander_->settles_at(0.0, 0.0)) << "it ends, and so does its lease";
}

TEST(EnvelopeCommand, TellsMarginsAndTheAreaOfAGridOrABox) {
  const test::Ended point =
      test::run("weakgrid", {"envelope", "--reactance", "0.3", "--p", "0.707", "--q", "0.707"});
  EXPECT_EQ(point.status, 0) << point.out << point.err;
  EXPECT_NE(point.out.find("current limit"), std::string::npos);
  const test::Ended box =
      test::run("weakgrid", {"envelope", "--reactance", "0.2", "0.6", "--p", "0.9", "--q", "-0.2", "--json"});
  EXPECT_EQ(box.status, 1) << box.out;
  EXPECT_TRUE(json::parse(box.out, nullptr, false).contains("margins"));
  const auto lines = [](const std::string& text) { return std::count(text.begin(), text.end(), '\n'); };
  const test::Ended area = test::run("weakgrid", {"envelope", "--reactance", "0.3", "--csv"});
  const test::Ended smaller = test::run("weakgrid", {"envelope", "--reactance", "0.3", "0.5", "--csv"});
  EXPECT_GT(lines(area.out), 100);
  EXPECT_LT(lines(smaller.out), lines(area.out));
  EXPECT_EQ(test::run("weakgrid", {"envelope", "--reactance", "0.5", "0.3"}).status, 2);
}

}  // namespace
}  // namespace weakgrid
