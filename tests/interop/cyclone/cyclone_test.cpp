// Another DDS, another language, its own compiler of the same IDL: joins a running unit, reads every topic and
// orders a setpoint that the unit then follows.
#include <nlohmann/json.hpp>
#include <sstream>

#include "tests/services/bystander.hpp"

namespace weakgrid::test {
namespace {

TEST(Cyclone, ReadsEveryTopicAndItsSetpointIsFollowed) {
  const Domain domain;
  Services services(domain, shipped_settings("weak-grid.toml"));
  services.start_all();
  Bystander bystander(domain);
  ASSERT_TRUE(bystander.runs());
  Program peer("cyclone_peer", {std::to_string(domain.number()), "1", "0.3", "0.1", "30"});
  // Somebody must say something on the topic of operations while the peer listens.
  for (int k = 0; k < 300 && peer.runs(); ++k) {
    (void)bystander.client().operate(OperationKind::advance, ~std::uint64_t{0}, milliseconds(1000));
    std::this_thread::sleep_for(milliseconds(100));
  }
  ASSERT_EQ(peer.wait(), 0) << peer.out() << peer.err() << bystander.words();
  std::istringstream lines(peer.out());
  int topics = 0;
  for (std::string line; std::getline(lines, line);) {
    const auto said = nlohmann::json::parse(line);
    if (said.contains("topic")) {
      ++topics;
      EXPECT_GT(said["count"], 0) << line;
    } else {
      EXPECT_TRUE(said["accepted"]) << line;
      EXPECT_NEAR(said["p"], 0.3, 1e-3);
      EXPECT_NEAR(said["q"], 0.1, 1e-3);
    }
  }
  EXPECT_EQ(topics, 10);
  EXPECT_EQ(bystander.count("controller", "refused_references"), 0u);
}

TEST(Cyclone, IsRefusedLikeAnybodyElse) {
  const Domain domain;
  Services services(domain, shipped_settings("weak-grid.toml"));
  services.start_all();
  Bystander bystander(domain);
  ASSERT_TRUE(bystander.runs());
  Program peer("cyclone_peer", {std::to_string(domain.number()), "1", "0.707", "-0.9", "5"});
  EXPECT_EQ(peer.wait(milliseconds(20'000)), 1);
  EXPECT_NE(peer.out().find("\"answered\": true, \"accepted\": false"), std::string::npos) << peer.out();
  EXPECT_TRUE(bystander.references().empty() || bystander.references().back().p == 0.0);
}

}  // namespace
}  // namespace weakgrid::test
