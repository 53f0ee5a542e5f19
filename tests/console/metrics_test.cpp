// What Prometheus is told, whatever the domain says.
#include <gtest/gtest.h>

#include <regex>
#include <set>
#include <sstream>

#include "services/console/metrics.hpp"
#include "services/runtime/stage_timings.hpp"

namespace weakgrid {
namespace {

constexpr std::int64_t s = 1'000'000'000;

// Series → value; each line as the text format has it.
std::map<std::string, double> series_of(const std::string& page) {
  static const std::regex line_of_a_series(R"re(([a-z_]+(?:\{(?:[a-z_]+="(?:[^"\\\n]|\\.)*",?)*\})?) (\S+))re");
  std::map<std::string, double> series;
  std::istringstream lines(page);
  for (std::string line; std::getline(lines, line);) {
    std::smatch parts;
    if (line.starts_with("#")) continue;
    if (!std::regex_match(line, parts, line_of_a_series)) {
      ADD_FAILURE() << line;
      continue;
    }
    EXPECT_TRUE(series.emplace(parts[1], std::stod(parts[2])).second) << "twice: " << line;
  }
  return series;
}

std::map<std::string, double> told(const Metrics& metrics, std::int64_t now_ns) {
  return series_of(metrics.text(now_ns));
}

Health plant(std::uint64_t instance, std::int64_t wall_ns) {
  Health health;
  health.service = "plant";
  health.instance = instance;
  health.state = ServiceState::running;
  health.wall_time_ns = wall_ns;
  health.counters = {{"holds", 3}, {"tripped", 1}};
  return health;
}

TEST(Metrics, CountersAreTotalsAndConditionsAreGauges) {
  Metrics metrics;
  metrics.hear(7, plant(1, 0), 0, 0);
  const std::string page = metrics.text(0);
  EXPECT_NE(page.find("# TYPE weakgrid_holds_total counter\n"), std::string::npos) << page;
  EXPECT_NE(page.find("# TYPE weakgrid_tripped gauge\n"), std::string::npos) << page;
  const auto series = series_of(page);
  EXPECT_EQ(series.at("weakgrid_holds_total{unit=\"7\",service=\"plant\"}"), 3.0);
  EXPECT_EQ(series.at("weakgrid_service_state{unit=\"7\",service=\"plant\",state=\"running\"}"), 1.0);
  EXPECT_EQ(series.at("weakgrid_service_state{unit=\"7\",service=\"plant\",state=\"stopped\"}"), 0.0);
}

TEST(Metrics, AServiceIsUpWhileItSpeaks) {
  const std::string up = "weakgrid_service_up{unit=\"1\",service=\"plant\"}";
  Metrics metrics;
  // What a plant said before it died an hour ago is the first that is heard of it.
  metrics.hear(1, plant(1, 0), 100 * s, 3600 * s);
  EXPECT_EQ(told(metrics, 100 * s).at(up), 0.0);
  // A new start; the clock of its host is an hour behind, which the second word makes up for.
  metrics.hear(1, plant(2, 1 * s), 101 * s, 3601 * s);
  metrics.hear(1, plant(2, 2 * s), 102 * s, 3602 * s);
  EXPECT_EQ(told(metrics, 106 * s).at(up), 1.0);
  EXPECT_EQ(told(metrics, 107 * s).at(up), 0.0);
  Health goodbye = plant(2, 8 * s);
  goodbye.state = ServiceState::stopped;
  metrics.hear(1, goodbye, 108 * s, 3608 * s);
  EXPECT_EQ(told(metrics, 108 * s).at(up), 0.0);
}

TEST(Metrics, StagesAreHistogramsThatAddUp) {
  Stage stage{"write"};
  for (const std::int64_t ns : {500L, 999L, 1'500L, 19'000L, 2'000'000L, 3'000'000'000L})
    stage.durations.add(ns);
  Health health = plant(1, 0);
  health.timings = timings_of({&stage, 1});
  Metrics metrics;
  metrics.hear(1, health, 0, 0);
  const auto series = told(metrics, 0);
  const auto of = [&](const std::string& what, const std::string& le = "") {
    return series.at("weakgrid_stage_duration_seconds_" + what + "{unit=\"1\",service=\"plant\",stage=\"write\"" +
                     (le.empty() ? "" : ",le=\"" + le + "\"") + "}");
  };
  EXPECT_EQ(of("bucket", "1e-06"), 2.0);
  EXPECT_EQ(of("bucket", "2e-06"), 3.0);
  EXPECT_EQ(of("bucket", "1e-05"), 3.0);
  EXPECT_EQ(of("bucket", "2e-05"), 4.0);
  EXPECT_EQ(of("bucket", "1"), 5.0);
  EXPECT_EQ(of("bucket", "+Inf"), 6.0);
  EXPECT_EQ(of("count"), 6.0);
  EXPECT_NEAR(of("sum"), 3.002022, 0.004 * 3.0);
}

TEST(Metrics, DecisionsAreCountedByVerdictAndByTheLimitsThatWouldBeViolated) {
  Metrics metrics;
  Decision accepted, rejected, repeated;
  accepted.verdict = Verdict::accepted;
  rejected.verdict = Verdict::outside_envelope;
  rejected.margins.add({Limit::current, true, -0.1});
  rejected.margins.add({Limit::control, true, 0.1});
  repeated = rejected;
  repeated.repeated = true;
  for (const Decision& decision : {accepted, rejected, rejected, repeated}) metrics.hear(3, decision);
  const auto series = told(metrics, 0);
  EXPECT_EQ(series.at("weakgrid_decisions_total{unit=\"3\",verdict=\"accepted\"}"), 1.0);
  EXPECT_EQ(series.at("weakgrid_decisions_total{unit=\"3\",verdict=\"outside the envelope\"}"), 2.0);
  double limits = 0.0;
  for (const auto& [name, value] : series)
    if (name.starts_with("weakgrid_violated_limits_total")) limits += value;
  EXPECT_EQ(limits, 2.0) << "only what is violated, once a request";
}

TEST(Metrics, WhateverADomainSaysThePageIsOne) {
  Metrics metrics;
  Health hostile = plant(1, 0);
  hostile.service = "pl\"a\\n\nt\xff\xc3";
  hostile.counters = {{"holds", 1}, {"holds", 2}, {"no such\n# TYPE x", 3}, {"", 4}};
  StageTiming timing{"st\"\n", 5, 1, 2, 3, 4};
  hostile.timings = {timing, timing};
  Manifest manifest;
  manifest.service = hostile.service;
  manifest.build = "b\n\"\\";
  Measurement absurd;
  absurd.v_p = {NAN, INFINITY};
  for (std::uint32_t unit = 0; unit < 5000; ++unit) {
    metrics.hear(unit, hostile, 0, 0);
    metrics.hear(unit, manifest);
    metrics.hear(unit, absurd, 0);
    metrics.hear(unit, Decision{});
  }
  const auto series = told(metrics, 0);
  EXPECT_GT(series.size(), 1000u);
  EXPECT_LT(metrics.text(0).size(), 10u << 20);
}

}  // namespace
}  // namespace weakgrid
