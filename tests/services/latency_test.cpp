// weakgrid latency, that it measures what it says and says what it measured. How quick the machine is, no
// test tells.
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "tests/support/processes_under_test.hpp"

namespace weakgrid {
namespace {

test::Ended latency(const test::Domain& domain, const std::vector<std::string>& further) {
  std::vector<std::string> arguments{"latency",  "--domain", domain.text(), "--seconds", "0.3",
                                     "--rounds", "1"};
  arguments.insert(arguments.end(), further.begin(), further.end());
  return test::run("weakgrid", arguments);
}

TEST(Latency, WakeUpFastDdsAndTheLoopSideBySideAndARate) {
  const test::Domain domain;
  // Whatever is held at 20 kHz is tolerated: one rate is tried.
  const test::Ended ended = latency(domain, {"--tolerated", "1", "--json"});
  ASSERT_EQ(ended.status, 0) << ended.out << ended.err;
  const auto told = nlohmann::json::parse(ended.out);
  for (const char* what : {"wake", "raw_round_trip", "round_trip"}) {
    EXPECT_GT(told.at(what).at("count"), 50) << what;
    EXPECT_GT(told.at(what).at("p50_us"), 0.0) << what;
    EXPECT_LE(told.at(what).at("p50_us"), told.at(what).at("max_us")) << what;
  }
  ASSERT_EQ(told.at("rates").size(), 1u);
  EXPECT_EQ(told.at("rates")[0].at("rate_hz"), 20'000);
  EXPECT_GT(told.at("rates")[0].at("steps"), 1000);
  EXPECT_EQ(told.at("highest_rate_hz"), 20'000);
}

TEST(Latency, ARateThatIsNotHeldIsTheAnswerNo) {
  const test::Domain domain;
  const test::TextFile file("[timing]\nperiod_us = 10\n");  // 100 kHz: more than it ever tries
  const test::Ended ended = latency(domain, {"--tolerated", "1", "--settings", file.path()});
  EXPECT_EQ(ended.status, 1) << ended.out << ended.err;
  EXPECT_NE(ended.out.find("This machine holds 20000 Hz"), std::string::npos) << ended.out;
}

TEST(Latency, ADomainInUseIsRefused) {
  const test::Domain domain;
  const test::TextFile file("");
  test::Services services(domain, file.path());
  services.start("plant");
  services.start("controller");
  test::wait_until([&] {
    return test::run("weakgrid", {"status", "--domain", domain.text()}).out.find("running") !=
           std::string::npos;
  });
  const test::Ended ended = latency(domain, {});
  EXPECT_EQ(ended.status, 3) << ended.out << ended.err;
  EXPECT_NE(ended.err.find("is in use"), std::string::npos) << ended.err;
}

}  // namespace
}  // namespace weakgrid
