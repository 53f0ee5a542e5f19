// What a network does to the unit's packets, plant, controller, gateway and observer each on a host of its
// own: they are lost, late, there twice, overtaken, and a link goes down for a while.
#include <thread>

#include "tests/faults/campaign.hpp"
#include "tests/faults/relayed_hosts.hpp"

namespace weakgrid::faults {
namespace {

enum : unsigned { plant_host, controller_host, gateway_host, observer_host, host_count };

unsigned host_of(const std::string& service) {
  if (service == "plant") return plant_host;
  if (service == "controller") return controller_host;
  return service == "gateway" ? gateway_host : observer_host;
}

class NetworkFaults : public testing::TestWithParam<const char*> {
 protected:
  void SetUp() override {
    if (const std::string why = RelayedHosts::refused(); !why.empty()) GTEST_SKIP() << "skipped: " << why;
    hosts_.emplace(host_count, fault_seed());
    campaign_.emplace(
        Surroundings{.pace = GetParam(),
                     .dds =
                         [](const std::string& s) {
                           return "interfaces = [\"" + RelayedHosts::address(host_of(s)) + "\"]\n";
                         },
                     .at = [this](const std::string& s,
                                  const std::function<void()>& start) { hosts_->on(host_of(s), start); }});
    ASSERT_TRUE(campaign_->is_sound());
  }

  /// For some tenths of a second, and what of it has happened.
  RelayedHosts::Counts weather(const Weather& weather) {
    const RelayedHosts::Counts before = hosts_->counts();
    campaign_->wait_for_any_phase();
    hosts_->set(weather);
    std::this_thread::sleep_for(test::milliseconds(100 + campaign_->random()() % 900));
    hosts_->set({});
    const RelayedHosts::Counts after = hosts_->counts();
    return {after.relayed - before.relayed, after.lost - before.lost, after.doubled - before.doubled,
            after.late - before.late};
  }

  std::optional<RelayedHosts> hosts_;
  std::optional<Campaign> campaign_;
};

TEST_P(NetworkFaults, PacketsAreLostLateDoubledAndOvertaken) {
  using std::chrono::microseconds;
  Campaign& campaign = *campaign_;
  for (std::uint64_t n = 0; n < injections(); ++n) {
    EXPECT_GT(weather({.lost = campaign.uniform(0.05, 0.5)}).lost, 0u);
    campaign.expect_recovery("loss of 5 … 50 % of all packets");
    EXPECT_GT(weather({.doubled = campaign.uniform(0.1, 1.0)}).doubled, 0u);
    campaign.expect_recovery("duplication of 10 … 100 %");
    EXPECT_GT(weather({.delay = microseconds(static_cast<int>(campaign.uniform(100, 30'000)))}).relayed, 0u);
    campaign.expect_recovery("delay of 0.1 … 30 ms");
    EXPECT_GT(weather({.late = campaign.uniform(0.1, 0.9), .late_max = microseconds(20'000)}).late, 0u);
    campaign.expect_recovery("reordering, up to 20 ms");
    const auto all = weather({.lost = 0.1,
                              .doubled = 0.1,
                              .delay = microseconds(500),
                              .late = 0.3,
                              .late_max = microseconds(5000)});
    EXPECT_GT(std::min({all.lost, all.doubled, all.late}), 0u);
    campaign.expect_recovery("loss, duplication, delay, reordering at once");
  }
  campaign.expect_proof();
}

TEST_P(NetworkFaults, ALinkGoesDownAndComesUp) {
  for (std::uint64_t n = 0; n < injections(); ++n)
    for (const char* service : {"controller", "gateway", "plant"}) {
      campaign_->wait_for_any_phase();
      hosts_->link(host_of(service), false);
      std::this_thread::sleep_for(campaign_->some_pause());
      hosts_->link(host_of(service), true);
      campaign_->expect_recovery(std::string("link down of ") + service);
    }
  campaign_->expect_proof();
}

INSTANTIATE_TEST_SUITE_P(Paces, NetworkFaults, testing::ValuesIn(paces()),
                         [](const auto& pace) { return std::string(pace.param); });

}  // namespace
}  // namespace weakgrid::faults
