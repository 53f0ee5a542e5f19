// What a unit does by itself: it starts, stops, and outlives a gateway by the lease of what that has ordered.
#include <gtest/gtest.h>

#include "tests/services/bystander.hpp"

namespace weakgrid {
namespace {

TEST(Unit, WithNoGatewayPlantAndControllerGoToTheFallbackWhenTheLeaseEnds) {
  const test::Domain domain;
  const test::TextFile settings("[grid]\nreactance = 0.3\n");
  test::Services services(domain, settings.path());
  services.start("plant");
  services.start("controller");
  test::Bystander bystander(domain);
  ASSERT_TRUE(test::wait_until([&] { return bystander.measurement() && bystander.modulation(); }));
  Writer<Reference> gateway(bystander.client().bus(), 1);
  ASSERT_TRUE(test::wait_until([&] { return gateway.matched() >= 3; }));
  const std::uint64_t now = bystander.measurement()->step;
  Reference order{.id = 1,
                  .p = 0.5,
                  .q = 0.1,
                  .v_c = 1.8384776310850235,
                  .effective_step = now + 1000,
                  .ramp_steps = 200,
                  .lease_end_step = now + 60'000,
                  .fallback_p = 0.2,
                  .fallback_q = 0.3,
                  .fallback_ramp_steps = 300};
  ASSERT_TRUE(gateway.write(order));
  ASSERT_TRUE(bystander.settles_at(0.5, 0.1));
  EXPECT_FALSE(bystander.measurement()->fallback);
  ASSERT_TRUE(bystander.settles_at(0.2, 0.3));
  EXPECT_TRUE(bystander.measurement()->fallback);
  EXPECT_NE(bystander.modulation()->status & fallback, 0u);
  for (const char* service : {"plant", "controller"})
    EXPECT_TRUE(test::wait_until([&] { return bystander.count(service, "lease_ends") == 1; })) << service;
  // Somebody renews it after all.
  order.id = 2;
  order.renews = 1;
  order.lease_end_step = 0;
  ASSERT_TRUE(gateway.write(order));
  EXPECT_TRUE(bystander.settles_at(0.5, 0.1));
  EXPECT_FALSE(bystander.measurement()->fallback);
}

TEST(Unit, ThatStartsOffIsStartedAndStoppedThroughTheGateway) {
  const test::Domain domain;
  const test::TextFile settings("[grid]\nreactance = 0.3\n[plant]\nstart = \"off\"\nprecharge_s = 0.05\n");
  test::Services services(domain, settings.path());
  services.start_all();
  test::Bystander bystander(domain);
  const auto is = [&](UnitState state) {
    return test::wait_until(
        [&] { return bystander.measurement() && bystander.measurement()->state == state; });
  };
  const auto operate = [&](const char* verb, int status = 0, const char* word = "the plant is told to") {
    const test::Ended ended = test::run(
        "weakgrid", {"operate", verb, "--name", "somebody", "--timeout", "60", "--domain", domain.text()});
    EXPECT_EQ(ended.status, status) << verb << ": " << ended.out << ended.err;
    EXPECT_NE(ended.out.find(word), std::string::npos) << ended.out;
  };
  ASSERT_TRUE(bystander.runs());
  EXPECT_TRUE(is(UnitState::off)) << bystander.words();
  EXPECT_TRUE(bystander.measurement()->blocked);
  EXPECT_TRUE(test::wait_until([&] { return bystander.health("plant")->text == "off"; }))
      << bystander.words();
  operate("start");
  ASSERT_TRUE(is(UnitState::running)) << bystander.words();
  ASSERT_TRUE(bystander.order(0.5, 0.1));
  ASSERT_TRUE(bystander.settles_at(0.5, 0.1));
  operate("start", 1, "interlocked: the unit is running, start needs off");
  operate("reset", 1, "interlocked: the unit is running, reset needs tripped");
  // Who goes round the gateway meets the plant's own.
  ASSERT_TRUE(bystander.client().operate(OperationKind::start, 0, test::long_enough));
  EXPECT_TRUE(test::wait_until([&] { return bystander.count("plant", "refused_operations") == 1; }));
  operate("stop");
  ASSERT_TRUE(is(UnitState::off));
  EXPECT_EQ(bystander.measurement()->p_i, 0.0);
  operate("start");
  ASSERT_TRUE(is(UnitState::running)) << bystander.words();
  EXPECT_TRUE(bystander.settles_at(0.0, 0.0)) << "nothing of what was ordered before stands";
}

TEST(Unit, IsStoppedWithoutAGatewayToo) {
  const test::Domain domain;
  const test::TextFile settings("[grid]\nreactance = 0.3\n");
  test::Services services(domain, settings.path());
  services.start("plant");
  services.start("controller");
  test::Bystander bystander(domain);
  ASSERT_TRUE(test::wait_until([&] { return bystander.measurement() && bystander.modulation(); }));
  const test::Ended stop = test::run("weakgrid", {"operate", "stop", "--direct", "--domain", domain.text()});
  EXPECT_EQ(stop.status, 0) << stop.err;
  EXPECT_TRUE(test::wait_until([&] { return bystander.measurement()->state == UnitState::off; }));
}

}  // namespace
}  // namespace weakgrid
