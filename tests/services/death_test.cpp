// kill -9 of each service in a running loop: what the others do meanwhile, and that the restarted one joins
// without a restart of theirs.
#include <gtest/gtest.h>
#include <signal.h>

#include <thread>

#include "tests/services/bystander.hpp"

namespace weakgrid {
namespace {

class Death : public testing::Test {
 protected:
  void SetUp() override {
    services_.start_all();
    bystander_.emplace(domain_);
    ASSERT_TRUE(bystander_->runs());
    const auto reference = bystander_->order(0.5, 0.1);
    ASSERT_TRUE(reference);
    reference_id_ = reference->id;
    ASSERT_TRUE(bystander_->settles_at(0.5, 0.1));
    for (const char* service : {"plant", "controller", "gateway"})
      instance_[service] = bystander_->instance(service);
  }

  // As quick as a loop is; a plant that has lost its controller makes a step each 20 ms.
  ::testing::AssertionResult goes_quickly() {
    const auto pace = [&] {
      const auto from = bystander_->measurement();
      std::this_thread::sleep_for(test::milliseconds(200));
      const auto to = bystander_->measurement();
      return from && to && to->step >= from->step + 100;
    };
    if (test::wait_until(pace)) return ::testing::AssertionSuccess();
    return ::testing::AssertionFailure() << "the loop does not go on at its pace:" << bystander_->words();
  }

  void expect_untouched(const std::vector<std::string>& others) {
    for (const std::string& service : others) {
      EXPECT_TRUE(services_[service].runs()) << service;
      const auto health = bystander_->health(service);
      ASSERT_TRUE(health) << service;
      EXPECT_EQ(health->instance, instance_[service]) << service;
      EXPECT_NE(health->state, ServiceState::stopped) << service;
    }
  }

  const test::Domain domain_;
  // Blocked within the 1.5 s that it takes until a killed peer gives way.
  const test::TextFile file_{
      "[grid]\nreactance = 0.3\n[plant]\npatience_s = 1.0\n[protection]\nholds_max = 7\n"};
  test::Services services_{domain_, file_.path()};
  std::optional<test::Bystander> bystander_;
  std::map<std::string, std::uint64_t> instance_;
  std::uint32_t reference_id_ = 0;
};

TEST_F(Death, OfTheControllerThePlantHoldsThenBlocksAndARestartedOneJoins) {
  services_["controller"].kill();
  ASSERT_TRUE(test::wait_until([&] { return bystander_->is("plant", ServiceState::blocked_by_trip); }))
      << bystander_->words();
  EXPECT_NE(bystander_->health("plant")->text.find("modulation lost"), std::string::npos)
      << bystander_->words();
  EXPECT_EQ(bystander_->count("plant", "holds"), 8u) << "holds_max and the one that was too much";
  ASSERT_TRUE(test::wait_until([&] { return bystander_->measurement()->blocked; }));
  const Measurement blocked = *bystander_->measurement();
  EXPECT_EQ(blocked.p_i, 0.0);
  EXPECT_EQ(abs(blocked.i), 0.0);
  // The gateway knows.
  const auto refused = bystander_->client().ask({.given = given_p, .p = 0.1}, test::long_enough);
  ASSERT_TRUE(refused);
  EXPECT_EQ(refused->decision.verdict, Verdict::unit_blocked) << refused->text;

  services_.start("controller");
  ASSERT_TRUE(goes_quickly());
  EXPECT_TRUE(test::wait_until([&] {
    return bystander_->is("controller", ServiceState::running, instance_["controller"]);
  })) << bystander_->words();
  expect_untouched({"plant", "gateway"});
  EXPECT_TRUE(bystander_->is("plant", ServiceState::blocked_by_trip)) << "closes again only when told to";

  const test::Ended reset = test::run("weakgrid", {"operate", "reset", "--domain", domain_.text()});
  EXPECT_EQ(reset.status, 0) << reset.err;
  ASSERT_TRUE(test::wait_until([&] { return bystander_->is("plant", ServiceState::running); }))
      << bystander_->words();
  ASSERT_TRUE(bystander_->settles_at(0.0, 0.0)) << "idle after a trip";
  // What was ordered before does not stand any more.
  const auto only_q = bystander_->client().ask({.given = given_q, .q = 0.2}, test::long_enough);
  ASSERT_TRUE(only_q && only_q->decision.reference) << (only_q ? only_q->text : "");
  EXPECT_EQ(only_q->decision.setpoint.p, 0.0);
  EXPECT_TRUE(bystander_->settles_at(0.0, 0.2));
  EXPECT_TRUE(bystander_->order(0.6, 0.2));
  EXPECT_TRUE(bystander_->settles_at(0.6, 0.2));
  expect_untouched({"plant", "gateway"});
}

TEST_F(Death, OfThePlantTheOthersGoOnWithANewOneAndNoOldSetpointStands) {
  const WriterId old_plant = bystander_->plant();
  services_["plant"].kill();
  services_.start("plant");
  ASSERT_TRUE(test::wait_until([&] { return bystander_->plant() != old_plant; })) << bystander_->words();
  ASSERT_TRUE(goes_quickly());
  ASSERT_TRUE(test::wait_until([&] {
    const auto known = bystander_->health("plant", instance_["plant"]);
    return known && known->state == ServiceState::running && known->reference_id > reference_id_;
  })) << bystander_->words();
  expect_untouched({"controller", "gateway"});
  const Reference standing = bystander_->references().back();
  EXPECT_GT(standing.id, reference_id_);
  EXPECT_EQ(standing.p, 0.0);
  EXPECT_EQ(standing.q, 0.0);
  EXPECT_TRUE(bystander_->settles_at(0.0, 0.0));
  EXPECT_EQ(bystander_->take_source_power_max(), 0.0) << "the old setpoint was in force for a while";
  const auto only_q = bystander_->client().ask({.given = given_q, .q = 0.2}, test::long_enough);
  ASSERT_TRUE(only_q && only_q->decision.reference) << (only_q ? only_q->text : "");
  EXPECT_EQ(only_q->decision.setpoint.p, 0.0);
  EXPECT_TRUE(bystander_->settles_at(0.0, 0.2));
  EXPECT_TRUE(bystander_->order(0.6, 0.2));
  EXPECT_TRUE(bystander_->settles_at(0.6, 0.2));
  expect_untouched({"controller", "gateway"});
}

TEST_F(Death, OfTheGatewayTheLoopGoesOnAndARestartedOneIsObeyed) {
  services_["gateway"].kill();
  ASSERT_TRUE(bystander_->goes_on());
  ASSERT_TRUE(bystander_->settles_at(0.5, 0.1));
  services_.start("gateway");
  // Whoever asks before it has looked around must not be told what does not come true.
  ASSERT_TRUE(bystander_->order(0.6, 0.2));
  EXPECT_GT(bystander_->references().back().id, reference_id_);
  EXPECT_TRUE(bystander_->settles_at(0.6, 0.2));
  EXPECT_EQ(bystander_->count("plant", "refused_references"), 0u);
  EXPECT_EQ(bystander_->count("controller", "refused_references"), 0u);
  expect_untouched({"plant", "controller"});
}

TEST_F(Death, OfTheGatewayARestartedOneAsksForAllThatItCannotKnow) {
  services_["gateway"].kill();
  services_.start("gateway");
  const auto incomplete = bystander_->client().ask({.given = given_q, .q = 0.2}, test::long_enough);
  ASSERT_TRUE(incomplete);
  EXPECT_EQ(incomplete->decision.verdict, Verdict::bad_request) << incomplete->text;
  EXPECT_NE(incomplete->text.find("given; allowed: "), std::string::npos) << incomplete->text;
  EXPECT_TRUE(bystander_->settles_at(0.5, 0.1));
}

}  // namespace
}  // namespace weakgrid
