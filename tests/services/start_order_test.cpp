// Start order and start delay never matter, and whoever is asked to stop says goodbye.
#include <gtest/gtest.h>
#include <signal.h>

#include <algorithm>
#include <thread>

#include "tests/services/bystander.hpp"

namespace weakgrid {
namespace {

constexpr test::milliseconds to_run{15'000}, to_stop{5'000};

class StartOrder : public testing::Test {
 protected:
  // Three services that were just started: a loop that runs, takes a setpoint, and ends well.
  void expect_loop_and_goodbye(test::Services& services, const test::Domain& domain) {
    const auto start = std::chrono::steady_clock::now();
    test::Bystander bystander(domain);
    ASSERT_TRUE(bystander.runs(to_run));
    ASSERT_TRUE(bystander.order(0.1, 0.05));
    ASSERT_TRUE(bystander.goes_on());
    EXPECT_LE(std::chrono::steady_clock::now() - start, to_run);
    for (const char* service : {"plant", "controller", "gateway"}) services[service].send(SIGTERM);
    for (const char* service : {"plant", "controller", "gateway"}) {
      EXPECT_EQ(services[service].wait(to_stop), 0) << service;
      EXPECT_TRUE(test::wait_until([&] { return bystander.is(service, ServiceState::stopped); }, to_stop))
          << service << " says no goodbye:" << bystander.words();
    }
  }

  const test::TextFile settings_{"[grid]\nreactance = 0.3\n"};
};

TEST_F(StartOrder, TwentyStartsInARowWithAllServicesAtOnceReachARunningLoop) {
  const test::Domain domain;
  for (int n = 0; n < 20; ++n) {
    SCOPED_TRACE("start " + std::to_string(n));
    test::Services services(domain, settings_.path());
    services.start_all();
    expect_loop_and_goodbye(services, domain);
    if (HasFailure()) return;
  }
}

TEST_F(StartOrder, EveryOrderOfTheThreeReachesARunningLoop) {
  const test::Domain domain;
  std::vector<std::string> order{"controller", "gateway", "plant"};  // sorted: all permutations follow
  do {
    SCOPED_TRACE(order[0] + ", " + order[1] + ", " + order[2]);
    test::Services services(domain, settings_.path());
    for (const std::string& service : order) {
      services.start(service);
      std::this_thread::sleep_for(test::milliseconds(300));  // the delay under test, no wait for a condition
    }
    expect_loop_and_goodbye(services, domain);
    if (HasFailure()) return;
  } while (std::next_permutation(order.begin(), order.end()));
}

TEST_F(StartOrder, EachWaitsAloneAndSaysForWhom) {
  const test::Domain domain;
  test::Services services(domain, settings_.path());
  test::Bystander bystander(domain);
  const std::map<std::string, std::string> words{{"plant", "waits for a controller"},
                                                 {"controller", "waits for a plant"}};
  for (const auto& [service, text] : words) {
    services.start(service);
    ASSERT_TRUE(test::wait_until([&] { return bystander.is(service, ServiceState::starting); })) << service;
    EXPECT_TRUE(test::wait_until([&] { return bystander.health(service)->text == text; }))
        << bystander.words();
    services[service].send(SIGTERM);
    EXPECT_EQ(services[service].wait(to_stop), 0);
    EXPECT_TRUE(test::wait_until([&] { return bystander.is(service, ServiceState::stopped); })) << service;
  }
  EXPECT_FALSE(bystander.modulation());
}

TEST_F(StartOrder, InterruptedAtOnceEachStillEndsWell) {
  const test::Domain domain;
  for (const int signal : {SIGINT, SIGTERM})
    for (const char* service : {"plant", "controller", "gateway"}) {
      test::Services services(domain, settings_.path());
      services.start(service);
      // From when signals are held back for it, which a program says by blocking them.
      ASSERT_TRUE(test::wait_until([&] { return services[service].blocks(signal); })) << service;
      services[service].send(signal);
      EXPECT_EQ(services[service].wait(to_stop), 0) << service << ", signal " << signal;
    }
}

}  // namespace
}  // namespace weakgrid
