// Processes that die, that stop for a while and come back, and that are there twice.
#include <signal.h>

#include <thread>

#include "tests/faults/campaign.hpp"

namespace weakgrid::faults {
namespace {

class ProcessFaults : public testing::TestWithParam<const char*> {
 protected:
  void SetUp() override { ASSERT_TRUE(campaign_.is_sound()); }

  void two_gateways(const std::optional<std::string>& journal_of_the_second, const std::string& kind) {
    for (std::uint64_t n = 0; n < injections(); ++n) {
      campaign_.wait_for_any_phase();
      campaign_.start_as("second", "gateway", journal_of_the_second);
      campaign_.wait_for_any_phase();
      campaign_.wait_for_any_phase();
      EXPECT_TRUE(campaign_.is_sound()) << "with two gateways";
      if (campaign_.random()() % 2 == 0) {
        campaign_["gateway"].kill();
        campaign_.takes_the_place("second", "gateway");
      } else {
        campaign_["second"].kill();
        campaign_.end("second");
      }
      campaign_.expect_recovery(kind);
    }
    campaign_.expect_proof();
  }

  Campaign campaign_{{.pace = GetParam()}};
};

TEST_P(ProcessFaults, OneThatIsKilledIsMissedNoLongerThanItsSuccessorTakesToStart) {
  for (std::uint64_t n = 0; n < injections(); ++n)
    for (const char* service : {"controller", "gateway", "plant"}) {
      campaign_.wait_for_any_phase();
      campaign_[service].kill();
      campaign_.wait_for_any_phase();
      campaign_.start(service);
      campaign_.expect_recovery(std::string("kill -9 of ") + service);
    }
  campaign_.expect_proof();
}

TEST_P(ProcessFaults, OfAClientThatIsKilledTheOrderEndsWithItsLease) {
  for (std::uint64_t n = 0; n < injections(); ++n) {
    test::Program client("weakgrid", {"set", "--p", std::to_string(campaign_.uniform(0.1, 0.2)), "--q",
                                      "0.05", "--vc", "1.8385", "--name", Campaign::who, "--timeout", "10",
                                      "--lease", std::to_string(campaign_.lease_s() / 3.0), "--hold",
                                      "--domain", campaign_.domain().text()});
    campaign_.wait_for_any_phase();
    campaign_.wait_for_any_phase();
    client.kill();
    const auto fell_back = [&] {
      const Measurement m = *campaign_.watch().sample();
      return m.fallback || m.blocked;
    };
    EXPECT_TRUE(test::wait_until(fell_back, test::milliseconds(30'000))) << campaign_.watch().words();
    campaign_.expect_recovery("kill -9 of a client");
  }
  campaign_.expect_proof();
}

TEST_P(ProcessFaults, OneThatWasStoppedForAWhileComesBack) {
  for (std::uint64_t n = 0; n < injections(); ++n)
    for (const char* service : {"controller", "gateway", "plant", "recorder"}) {
      campaign_.wait_for_any_phase();
      campaign_[service].send(SIGSTOP);
      std::this_thread::sleep_for(campaign_.some_pause());
      campaign_[service].send(SIGCONT);
      campaign_.expect_recovery(std::string("pause of ") + service);
    }
  campaign_.expect_proof();
}

TEST_P(ProcessFaults, OfTwoControllersEitherMayDie) {
  for (std::uint64_t n = 0; n < injections(); ++n) {
    campaign_.wait_for_any_phase();
    campaign_.start_as("second", "controller");
    campaign_.wait_for_any_phase();
    campaign_.wait_for_any_phase();
    if (campaign_.random()() % 2 == 0) {
      campaign_["controller"].kill();
      campaign_.takes_the_place("second", "controller");
    } else {
      campaign_["second"].kill();
      campaign_.end("second");
    }
    campaign_.expect_recovery("two controllers, one killed");
  }
  campaign_.expect_proof();
}

// The second waits for the journal, 5 s at most: who holds that is the gateway.
TEST_P(ProcessFaults, OfTwoGatewaysEitherMayDie) {
  two_gateways(std::nullopt, "two gateways, one journal, one killed");
}

// The second hears that the first serves, and stands by.
TEST_P(ProcessFaults, OfTwoGatewaysWithoutAJournalInCommonEitherMayDie) {
  two_gateways("", "two gateways, one killed");
}

INSTANTIATE_TEST_SUITE_P(Paces, ProcessFaults, testing::ValuesIn(paces()),
                         [](const auto& pace) { return std::string(pace.param); });

}  // namespace
}  // namespace weakgrid::faults
