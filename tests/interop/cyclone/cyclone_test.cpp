// Another DDS, another language, its own compiler of the same IDL: joins a running unit, reads every topic
// and orders a setpoint that the unit then follows.
#include <nlohmann/json.hpp>
#include <sstream>

#include "tests/services/bystander.hpp"

namespace weakgrid::test {
namespace {

class Cyclone : public ::testing::Test {
 protected:
  Cyclone() { services_.start_all(); }
  void SetUp() override { ASSERT_TRUE(bystander_.runs()); }
  const Domain domain_;
  Services services_{domain_, shipped_settings("weak-grid.toml")};
  Bystander bystander_{domain_};
};

TEST_F(Cyclone, ReadsEveryTopicAndItsSetpointIsFollowed) {
  Program peer("cyclone_peer", {std::to_string(domain_.number()), "1", "0.3", "0.1", "30"});
  // Somebody must say something on the topic of operations while the peer listens.
  for (int k = 0; k < 300 && peer.runs(); ++k) {
    (void)bystander_.client().operate(OperationKind::advance, ~std::uint64_t{0}, milliseconds(1000));
    std::this_thread::sleep_for(milliseconds(100));
  }
  ASSERT_EQ(peer.wait(), 0) << peer.out() << peer.err() << bystander_.words();
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
  EXPECT_EQ(bystander_.count("controller", "refused_references"), 0u);
}

TEST_F(Cyclone, IsRefusedLikeAnybodyElse) {
  Program peer("cyclone_peer", {std::to_string(domain_.number()), "1", "0.707", "-0.9", "5"});
  EXPECT_EQ(peer.wait(milliseconds(20'000)), 1);
  EXPECT_NE(peer.out().find("\"answered\": true, \"accepted\": false"), std::string::npos) << peer.out();
  EXPECT_TRUE(bystander_.references().empty() || bystander_.references().back().p == 0.0);
}

}  // namespace
}  // namespace weakgrid::test
