// Where the loop's two ends are makes no difference but in speed: apart over UDP or shared memory, in one
// process, alone or among other units.
#include <gtest/gtest.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "tests/services/bystander.hpp"

namespace weakgrid {
namespace {

constexpr const char* scenario =
    "[grid]\nreactance = 0.1\n[scenario]\ntitle = \"a grid that weakens\"\nend_s = 0.3\n"
    "[[scenario.event]]\nat_s = 0.02\nquantity = \"source_power\"\nvalue = 0.3\nramp_s = 0.02\n"
    "[[scenario.event]]\nat_s = 0.1\nquantity = \"grid_reactance\"\nvalue = 0.25\nramp_s = 0.05\n";

// The digest that a unit's plant tells once it waits at step 3000.
std::string digest_at_the_end(const test::Domain& domain, std::uint32_t unit) {
  test::Bystander bystander(domain, unit);
  EXPECT_TRUE(test::wait_until([&] {
    const auto plant = bystander.health("plant");
    return plant && plant->state == ServiceState::waiting && plant->step == 3000 && !plant->digest.empty();
  })) << bystander.words();
  const auto plant = bystander.health("plant");
  return plant ? plant->digest : "";
}

std::string digest_of_a_run(const std::string& settings, const std::vector<std::string>& programs,
                            std::uint32_t unit = 1) {
  const test::Domain domain;
  const test::TextFile file(settings);
  std::vector<std::unique_ptr<test::Program>> running;
  for (const std::string& program : programs) {
    std::vector<std::string> arguments{"--settings", file.path(), "--domain", domain.text()};
    if (program != "weakgrid-controller") arguments.insert(arguments.end(), {"--until", "3000"});
    running.push_back(std::make_unique<test::Program>(program, arguments));
  }
  return digest_at_the_end(domain, unit);
}

const std::vector<std::string> apart{"weakgrid-plant", "weakgrid-controller"};

TEST(Hosting, TheSameBitsOverUdpOverSharedMemoryAndInOneProcess) {
  const std::string settings = scenario;
  const std::string over_udp = digest_of_a_run(settings, apart);
  EXPECT_EQ(over_udp.size(), 64u);
  EXPECT_EQ(digest_of_a_run(settings + "[dds]\nloop = \"data_sharing\"\n", apart), over_udp);
  EXPECT_EQ(digest_of_a_run(settings, {"weakgrid-unit"}), over_udp);
  EXPECT_NE(digest_of_a_run("[timing]\nperiod_us = 50\n" + settings, apart), over_udp);
}

TEST(Hosting, AUnitAmongOthersDoesWhatItDoesAlone) {
  const std::string three = std::string("[unit]\nnumber = 7\ncount = 3\n") + scenario;
  for (const std::uint32_t unit : {7u, 9u}) {
    const std::string alone = "[unit]\nnumber = " + std::to_string(unit) + "\n" + scenario;
    const std::string digest = digest_of_a_run(alone, apart, unit);
    EXPECT_EQ(digest_of_a_run(three, apart, unit), digest) << unit;
    EXPECT_EQ(digest_of_a_run(three, {"weakgrid-unit"}, unit), digest) << unit;
  }
}

TEST(Hosting, OneGatewayKeepsItsUnitsApart) {
  const test::Domain domain;
  const test::TextFile file("[unit]\ncount = 3\n[grid]\nreactance = 0.1\n");
  test::Services services(domain, file.path());
  services.start_all();
  const auto setpoint = [](std::uint32_t unit) { return 0.05 * unit; };
  for (const std::uint32_t unit : {1u, 2u, 3u}) {
    const test::Ended set = test::run(
        "weakgrid", {"set", "--unit", std::to_string(unit), "--domain", domain.text(), "--p",
                     std::to_string(setpoint(unit)), "--q", "0", "--vc", "1.8385", "--timeout", "60"});
    EXPECT_EQ(set.status, 0) << set.out << set.err;
  }
  for (const std::uint32_t unit : {1u, 2u, 3u}) {
    test::Bystander bystander(domain, unit);
    EXPECT_TRUE(test::wait_until([&] {
      const auto envelope = bystander.client().envelope();
      return envelope && std::abs(envelope->setpoint.p - setpoint(unit)) < 1e-6;
    })) << "unit "
        << unit;
  }
  const test::Ended none = test::run(
      "weakgrid", {"set", "--unit", "4", "--domain", domain.text(), "--p", "0.1", "--timeout", "1"});
  EXPECT_EQ(none.status, 3) << none.out << none.err;
}

TEST(Hosting, EachStageOfTheStepsIsTimedAndToldAndRecorded) {
  const test::Domain domain;
  const test::TextFile file(scenario);
  const test::TextFile recording("");
  const test::Ended run = test::run(
      "weakgrid", {"run", file.path(), "--domain", domain.text(), "--record", recording.path() + ".mcap"});
  EXPECT_LE(run.status, 1) << run.out << run.err;  // nobody has asked for what the source does
  const test::Ended info = test::run("weakgrid", {"info", recording.path() + ".mcap", "--json"});
  std::filesystem::remove(recording.path() + ".mcap");
  const auto told = nlohmann::json::parse(info.out, nullptr, false);
  ASSERT_FALSE(told.is_discarded()) << info.out << info.err;
  std::map<std::string, std::uint64_t> counts;
  for (const auto& service : told.at("services"))
    for (const auto& timing : service.at("timings")) {
      counts[service.at("service").get<std::string>() + " " + timing.at("stage").get<std::string>()] =
          timing.at("count");
      EXPECT_LE(timing.at("p50_us"), timing.at("p99_us"));
      EXPECT_LE(timing.at("p99_us"), timing.at("p999_us"));
      EXPECT_LE(timing.at("p999_us"), timing.at("max_us"));
    }
  for (const char* stage : {"plant write", "plant answer", "plant round_trip", "plant emulate",
                            "controller sample", "controller compute", "controller write"})
    EXPECT_GE(counts[stage], 3000u) << stage;
  EXPECT_EQ(counts["plant round_trip"], 3000u);
  EXPECT_EQ(counts.count("plant wake"), 0u) << "there is no grid of time in lockstep";
}

}  // namespace
}  // namespace weakgrid
