// The replay without any bus: when what is due, what is understood, where it goes.
#include <gtest/gtest.h>

#include "services/recording/replay_schedule.hpp"
#include "services/recording/replay_source.hpp"
#include "tests/recording/recording_support.hpp"

namespace weakgrid {
namespace {

constexpr std::int64_t s = 1'000'000'000;

TEST(ReplaySchedule, AnHourAtAnyRateEndsWhereItShouldToTheNanosecond) {
  for (const double rate : {0.5, 1.0, 4.0}) {
    ReplaySchedule schedule(rate, false);
    schedule.start(5 * s, 1000 * s);
    EXPECT_EQ(schedule.due_ns(5 * s), 1000 * s);
    const auto hour = static_cast<std::int64_t>(3600.0 * static_cast<double>(s) / rate);
    EXPECT_EQ(schedule.due_ns(3605 * s), 1000 * s + hour);
    EXPECT_EQ(schedule.position_ns(1000 * s + hour), 3605 * s);
  }
}

TEST(ReplaySchedule, APauseMovesWhatComesByItsLengthAndNothingElse) {
  ReplaySchedule schedule(2.0, false);
  schedule.start(0, 100 * s);
  schedule.pause(101 * s);
  EXPECT_TRUE(schedule.is_paused());
  EXPECT_EQ(schedule.position_ns(150 * s), 2 * s);
  EXPECT_EQ(schedule.due_ns(2 * s), ReplaySchedule::never);
  schedule.pause(120 * s);
  schedule.resume(151 * s);
  EXPECT_EQ(schedule.due_ns(4 * s), 152 * s);
  schedule.resume(151 * s + 1);
  EXPECT_EQ(schedule.due_ns(4 * s), 152 * s) << "a second resume changes nothing";
}

TEST(ReplaySchedule, AnotherRateCountsFromWhereItIs) {
  ReplaySchedule schedule(1.0, false);
  schedule.start(0, 0);
  schedule.set_rate(10.0, 2 * s);
  EXPECT_EQ(schedule.due_ns(12 * s), 3 * s);
  schedule.set_rate(rate_max, 3 * s);
  EXPECT_EQ(schedule.due_ns(1'000'000 * s), ReplaySchedule::at_once);
  schedule.set_rate(1.0, 4 * s);
  EXPECT_EQ(schedule.due_ns(13 * s), 5 * s);
}

TEST(ReplayCommand, ALineIsUnderstoodOrRefusedAsAWhole) {
  using Kind = ReplayCommand::Kind;
  EXPECT_EQ(parse_command("pause")->kind, Kind::pause);
  EXPECT_EQ(parse_command(" resume ")->kind, Kind::resume);
  EXPECT_EQ(parse_command("step")->steps, 1u);
  EXPECT_EQ(parse_command("step 25")->steps, 25u);
  EXPECT_EQ(parse_command("rate 0.5")->rate, 0.5);
  EXPECT_EQ(parse_command("rate max")->rate, rate_max);
  EXPECT_EQ(parse_command("quit")->kind, Kind::quit);
  for (const char* line : {"", "stop", "step 0", "step -1", "step 2 3", "rate", "rate 0", "rate nan",
                           "rate -1", "rate inf", "pause 3", "step 99999999999999999999", "rate 2x"})
    EXPECT_FALSE(parse_command(line)) << line;
}

TEST(ReplayDomain, IsNeverTheRecordedOneAndAlwaysAllowed) {
  for (std::uint32_t recorded = 0; recorded <= 230; ++recorded) {
    EXPECT_NE(replay_domain(recorded), recorded);
    EXPECT_LE(replay_domain(recorded), 229u);
  }
  EXPECT_EQ(replay_domain(7), 107u);
  EXPECT_EQ(replay_domain(130), 30u);
}

TEST(ReplayCompany, WhoeverWritesAReplayedTopicIsInTheWayButNotWhoOnlyAnnouncesHimself) {
  std::vector<SourceWriter> replayed(2);
  replayed[0].topic = "weakgrid/health";
  replayed[1].topic = "weakgrid/measurement";
  const LiveWriter recorder_health{"01|1", "weakgrid/health"}, recorder_manifest{"01|2", "weakgrid/manifest"};
  const LiveWriter plant{"02|1", "weakgrid/measurement"}, gateway{"03|1", "weakgrid/reference"};
  const LiveWriter gateway_health{"03|2", "weakgrid/health"};
  EXPECT_EQ(writer_in_the_way({}, replayed), nullptr);
  EXPECT_EQ(writer_in_the_way({recorder_health, recorder_manifest, gateway}, replayed), nullptr);
  const std::vector<LiveWriter> with_plant{recorder_health, plant}, with_gateway{gateway_health, gateway};
  EXPECT_EQ(writer_in_the_way(with_plant, replayed)->topic, "weakgrid/measurement");
  EXPECT_EQ(writer_in_the_way(with_gateway, replayed)->topic, "weakgrid/health");
}

}  // namespace
}  // namespace weakgrid
