// `weakgrid run` over DDS between processes, beside `weakgrid simulate` in one: the same verdict, the same
// bits.
#include <gtest/gtest.h>

#include <signal.h>

#include <nlohmann/json.hpp>

#include "tests/support/processes_under_test.hpp"

namespace weakgrid {
namespace {

using nlohmann::json;

struct Played {
  int status;
  json report;
  std::string digest() const { return report.value("modulation_digest", ""); }
  bool is_good() const { return report.value("good", false); }
};

Played played(const std::vector<std::string>& arguments) {
  const test::Ended ended = test::run("weakgrid", arguments, test::milliseconds(120'000));
  json report = json::parse(ended.out, nullptr, false);
  if (report.is_discarded()) {
    ADD_FAILURE() << "no JSON:\n" << ended.out << ended.err;
    report = json::object();
  }
  return {ended.status, report};
}

Played over_dds(const std::string& file) {
  const test::Domain domain;
  return played({"run", file, "--json", "--domain", domain.text()});
}

Played in_one_process(const std::string& file) { return played({"simulate", file, "--json"}); }

// Whatever comes of it, it comes of both.
void expect_same_path(const std::string& file) {
  Played run = over_dds(file), simulated = in_one_process(file);
  EXPECT_EQ(run.status, simulated.status) << run.report.dump(2);
  EXPECT_EQ(run.digest().size(), 64u);
  EXPECT_EQ(run.digest(), simulated.digest());
  EXPECT_EQ(run.report["trip_step"], simulated.report["trip_step"]);
  ASSERT_EQ(run.report["decisions"].size(), simulated.report["decisions"].size());
  for (std::size_t n = 0; n < run.report["decisions"].size(); ++n) {
    // Which sample a gateway has seen last is the bus's matter: on a busy machine not always the last.
    for (Played* one : {&run, &simulated}) {
      auto& decision = one->report["decisions"][n];
      decision.erase("decided_step");
      if (decision.contains("offer")) decision["offer"].erase("valid_until_step");
    }
    EXPECT_EQ(run.report["decisions"][n], simulated.report["decisions"][n]);
  }
}

class Settles : public testing::TestWithParam<const char*> {};

TEST_P(Settles, OverDdsTwiceAndInOneProcessWithTheSameBits) {
  const std::string file = test::shipped_settings(std::string(GetParam()) + ".toml");
  Played first = over_dds(file), second = over_dds(file), simulated = in_one_process(file);
  for (Played* one : {&first, &second, &simulated}) {
    EXPECT_EQ(one->status, 0) << one->report.dump(2);
    EXPECT_TRUE(one->is_good());
    EXPECT_EQ(one->report["verdict"], "SETTLED where the closed form says");
    EXPECT_EQ(one->report["saturated_steps"], 0);
    EXPECT_EQ(one->report["held_steps"], 0);
    EXPECT_EQ(one->report["trip"], "");
    for (const auto& [name, quantity] : one->report["quantities"].items())
      EXPECT_LE(quantity["relative_difference"].get<double>(), 1e-3) << name;
  }
  EXPECT_EQ(first.digest().size(), 64u);
  EXPECT_EQ(first.digest(), second.digest());
  EXPECT_EQ(first.digest(), simulated.digest());
}

INSTANTIATE_TEST_SUITE_P(Run, Settles,
                         testing::Values("paper-weak", "paper-strong", "weak-resistive", "filtered-x01"),
                         [](const auto& instance) {
                           std::string name = instance.param;
                           for (char& c : name)
                             if (c == '-') c = '_';
                           return name;
                         });

TEST(Run, TheUnfilteredLawLosesTheOperatingPointOverDdsAndInOneProcessAlike) {
  const std::string file = test::shipped_settings("unfiltered-x01.toml");
  Played run = over_dds(file), simulated = in_one_process(file);
  for (Played* one : {&run, &simulated}) {
    EXPECT_EQ(one->status, 1) << one->report.dump(2);
    EXPECT_FALSE(one->is_good());
    EXPECT_NE(one->report.value("trip", ""), "");
    EXPECT_EQ(one->report["verdict"].get<std::string>().find("LOST the operating point"), 0u);
  }
  EXPECT_EQ(run.report["trip_step"], simulated.report["trip_step"]);
  EXPECT_EQ(run.digest().size(), 64u);
  EXPECT_EQ(run.digest(), simulated.digest());
}

const char* const two_setpoints =
    "[scenario]\nend_s = 0.4\n"
    "[[scenario.setpoint]]\nat_s = 0.01\nactive_power = 0.707\n"
    "[[scenario.setpoint]]\nat_s = 0.11\nreactive_power = 0.707\n";

TEST(Run, FiftyMicrosecondsHeldStillWithMeansSettleWithTheSameBits) {
  const test::TextFile file(
      std::string("[grid]\nreactance = 0.3\n"
                  "[timing]\nperiod_us = 50\nhold = \"still\"\nsampling = \"period_mean\"\n") +
      two_setpoints);
  Played first = over_dds(file.path()), second = over_dds(file.path()),
         simulated = in_one_process(file.path());
  for (Played* one : {&first, &second, &simulated}) {
    EXPECT_EQ(one->status, 0) << one->report.dump(2);
    EXPECT_TRUE(one->is_good());
  }
  EXPECT_EQ(first.digest().size(), 64u);
  EXPECT_EQ(first.digest(), second.digest());
  EXPECT_EQ(first.digest(), simulated.digest());
}

TEST(Run, WithoutDelayTheBitsAreTheSame) {
  const test::TextFile file(std::string("[grid]\nreactance = 0.3\n[timing]\ndelay_steps = 0\n") +
                            two_setpoints);
  expect_same_path(file.path());
}

TEST(Run, GridEventsLeaveTheBitsTheSame) {
  const test::TextFile file(
      std::string("[grid]\nreactance = 0.1\n[gateway]\ngrid_reactance = 0.3\n") + two_setpoints +
      "[[scenario.event]]\nat_s = 0.15\nquantity = \"grid_reactance\"\nvalue = 0.3\nramp_s = 0.05\n"
      "[[scenario.event]]\nat_s = 0.25\nquantity = \"grid_voltage\"\nvalue = 0.95\nramp_s = 0.01\n"
      "[[scenario.event]]\nat_s = 0.3\nquantity = \"grid_resistance\"\nvalue = 0.02\nramp_s = 0.01\n"
      "[[scenario.event]]\nat_s = 0.3\nquantity = \"source_power\"\nvalue = 0.6\nramp_s = 0.01\n");
  expect_same_path(file.path());
}

TEST(Run, ARefusedSetpointIsRefusedAlikeAndTheRestGoesOn) {
  const test::TextFile file(
      "[grid]\nreactance = 0.3\n[scenario]\nend_s = 0.3\n"
      "[[scenario.setpoint]]\nat_s = 0.01\nactive_power = 0.707\nreactive_power = -0.5\n"
      "[[scenario.setpoint]]\nat_s = 0.02\nactive_power = 0.5\nramp_s = 0.05\n");
  expect_same_path(file.path());
  Played run = over_dds(file.path());
  EXPECT_EQ(run.status, 1);
  EXPECT_EQ(run.report["verdict"], "REFUSED: a setpoint was not accepted");
}

TEST(Run, ABadRequestIsNamedAlike) {
  // Nothing is asked for.
  const test::TextFile file("[scenario]\nend_s = 0.1\n[[scenario.setpoint]]\nat_s = 0.01\n");
  expect_same_path(file.path());
}

TEST(Run, ASetpointAtTheStartLeavesTheBitsTheSame) {
  const test::TextFile file(
      "[grid]\nreactance = 0.3\n[scenario]\nend_s = 0.2\n"
      "[[scenario.setpoint]]\nat_s = 0.0\nactive_power = 0.5\n"
      "[[scenario.setpoint]]\nat_s = 0.0\nreactive_power = 0.1\n");
  expect_same_path(file.path());
}

TEST(Run, LeavesNoServiceBehind) {
  const test::Domain domain;
  const test::TextFile file("[scenario]\nend_s = 1000.0\n");
  test::Program run("weakgrid", {"run", file.path(), "--domain", domain.text()});
  // Its children, from the kernel.
  const auto children = [&] { return run.children(); };
  ASSERT_TRUE(test::wait_until([&] { return children().size() == 3; })) << run.err();
  const auto services = children();
  run.send(SIGINT);
  EXPECT_EQ(run.wait(), 3);
  EXPECT_NE(run.err().find("stopped by a signal"), std::string::npos) << run.err();
  for (const pid_t service : services) EXPECT_FALSE(test::is_there(service));
}

TEST(Run, KilledLeavesNoServiceBehind) {
  const test::Domain domain;
  const test::TextFile file("[scenario]\nend_s = 1000.0\n");
  test::Program run("weakgrid", {"run", file.path(), "--domain", domain.text()});
  ASSERT_TRUE(test::wait_until([&] { return run.children().size() == 3; })) << run.err();
  const auto services = run.children();
  run.kill();
  for (const pid_t service : services)
    EXPECT_TRUE(test::wait_until([&] { return !test::is_there(service); })) << service;
}

}  // namespace
}  // namespace weakgrid
