// weakgrid-recorder over real DDS: nothing is missed, nothing is lost but the last second, and it says so.
#include <signal.h>
#include <sys/resource.h>

#include <nlohmann/json.hpp>

#include "services/recording/recorder.hpp"
#include "services/runtime/announcer.hpp"
#include "services/runtime/raw_writer.hpp"
#include "tests/recording/recording_support.hpp"
#include "tests/services/bystander.hpp"

namespace weakgrid {
namespace {

using mcap::Content;
using mcap::Folder;
using nlohmann::json;

const char* const scenario =
    "[grid]\nreactance = 0.3\n[scenario]\nend_s = 0.3\n"
    "[[scenario.setpoint]]\nat_s = 0.01\nactive_power = 0.5\n"
    "[[scenario.setpoint]]\nat_s = 0.1\nreactive_power = 0.1\n";
constexpr std::uint64_t scenario_steps = 3000;

struct Info {
  int status;
  json report;
  json topic(const std::string& name) const {
    for (const json& topic : report["topics"])
      if (topic["topic"] == name) return topic;
    return {};
  }
};

Info info_of(const std::string& file) {
  const test::Ended ended = test::run("weakgrid", {"info", file, "--json"});
  json report = json::parse(ended.out, nullptr, false);
  EXPECT_FALSE(report.is_discarded()) << ended.out << ended.err;
  return {ended.status, report};
}

template <class Message>
std::vector<Message> messages_of(const Content& content, const std::string& topic) {
  std::vector<Message> messages;
  for (const mcap::Entry& entry : content.messages) {
    if (entry.topic != topic) continue;
    const auto message = from_payload<Message>(entry.data);
    if (message)
      messages.push_back(message->message);
    else
      ADD_FAILURE() << "a payload of " << topic << " does not decode";
  }
  return messages;
}

/// In order from 0, each once but for `repeats`.
template <class Message>
void expect_every_step(const Content& content, const std::string& topic, std::uint64_t steps,
                       std::uint64_t repeats) {
  std::uint64_t next = 0, repeated = 0;
  for (const Message& message : messages_of<Message>(content, topic)) {
    if (next > 0 && message.step + 1 == next) {
      ++repeated;
      continue;
    }
    ASSERT_EQ(message.step, next) << topic;
    ++next;
  }
  EXPECT_EQ(next, steps) << topic;
  EXPECT_LE(repeated, repeats) << topic;
}

/// A recorder that records a domain by itself, and what it says of itself.
class Recording {
 public:
  Recording(const test::Domain& domain, const std::string& file, std::vector<std::string> more = {})
      : client_(domain.number(), 1, {}) {
    more.insert(more.begin(), {"--domain", domain.text(), "--output", file});
    program_.emplace("weakgrid-recorder", more);
  }
  test::Program& program() { return *program_; }
  Health health() const {
    Health newest;
    for (const auto& [key, health] : client_.peers())
      if (key.first == "recorder") newest = health;
    return newest;
  }
  bool is_running() const { return health().state == ServiceState::running; }

 private:
  Client client_;
  std::optional<test::Program> program_;
};

TEST(Recorder, OfARunEveryStepIsInTheFileOnceInOrderFromTheFirst) {
  const test::Domain domain;
  const test::TextFile file(scenario);
  const Folder folder;
  const test::Ended run = test::run(
      "weakgrid", {"run", file.path(), "--json", "--domain", domain.text(), "--record", folder / "a.mcap"});
  ASSERT_EQ(run.status, 0) << run.out << run.err;
  const json verdict = json::parse(run.out, nullptr, false);

  mcap::ScanReport report;
  const Content content = mcap::content_of(folder / "a.mcap", report);
  EXPECT_TRUE(report.intact()) << report.text();
  // Lockstep repeats a sample whose answer does not come in time: then it is in the file as often as it was
  // sent. So does, every half second, a plant that waits.
  const std::uint64_t resent = verdict["resent_samples"].get<std::uint64_t>() + 4;
  expect_every_step<Measurement>(content, "weakgrid/measurement", scenario_steps, resent);
  expect_every_step<Modulation>(content, "weakgrid/modulation", scenario_steps, resent);
  EXPECT_EQ(messages_of<Request>(content, "weakgrid/setpoint_request").size(), 2u);
  EXPECT_EQ(messages_of<DecisionMessage>(content, "weakgrid/setpoint_decision").size(), 2u);
  EXPECT_EQ(messages_of<Reference>(content, "weakgrid/reference").size(), 2u);
  EXPECT_EQ(messages_of<Operation>(content, "weakgrid/operation").size(), 3u);
  EXPECT_EQ(messages_of<Manifest>(content, "weakgrid/manifest").size(), 5u);  // recorder, run and the three
  EXPECT_EQ(content.order.front(), "version") << "what is at the start survives a crash";
  EXPECT_EQ(content.metadata.at(recording_metadata).at("build"), build_text());
  EXPECT_TRUE(content.attachments.count(settings_attachment));

  const Info info = info_of(folder / "a.mcap");
  EXPECT_EQ(info.status, 0) << info.report.dump(2);
  EXPECT_EQ(info.report["state"], "complete");
  EXPECT_EQ(info.report["missing"], 0);
  EXPECT_EQ(info.report["dropped"], 0);
  ASSERT_EQ(info.report["loops"].size(), 1u);
  for (const auto& [name, count] : {std::pair{"sample to answer", scenario_steps},
                                    std::pair{"sample to next sample", scenario_steps - 1}}) {
    const json& durations = info.report["loops"][0][name];
    EXPECT_EQ(durations["count"], count) << name;
    EXPECT_GT(durations["p50_us"], 1.0) << name;
    EXPECT_LE(durations["p50_us"], durations["p99_us"]) << name;
    EXPECT_LE(durations["p999_us"], durations["max_us"]) << name;
  }
  for (const json& writer : info.report["writers"])
    if (writer["topic"] != "weakgrid/health") {
      EXPECT_EQ(writer["first"], 1) << writer.dump();
    }
  std::set<std::string> services;
  for (const json& manifest : info.report["manifests"]) services.insert(manifest["service"]);
  EXPECT_EQ(services, (std::set<std::string>{"plant", "controller", "gateway", "recorder", "run"}));
}

TEST(Recorder, RecordsTopicsOfOtherProgramsAlsoInPartitions) {
  const test::Domain domain;
  const Folder folder;
  Recording recording(domain, folder / "a.mcap", {"--exclude", "*/secret"});
  ASSERT_TRUE(test::wait_until([&] { return recording.is_running(); }));
  RawBus bus(domain.number(), {});
  RawWriter::Options of{.topic = "some/thing", .type = "their::Blob"};
  RawWriter plain(bus, of);
  of.reliable = false;
  RawWriter also_best_effort(bus, of);
  of.reliable = true;
  of.topic = "some/secret";
  RawWriter excluded(bus, of);
  of.topic = "other/thing";
  of.partitions = {"there"};
  RawWriter in_partition(bus, of);
  // The reader of the best-effort writer matches the reliable one as well.
  ASSERT_TRUE(test::wait_until([&] {
    return plain.matched() == 2 && also_best_effort.matched() == 1 && in_partition.matched() == 1;
  }));
  for (int n = 0; n < 50; ++n) {
    mcap::Bytes payload{std::byte{0}, std::byte{1}, std::byte{0}, std::byte{0}};
    payload.resize(4 + static_cast<std::size_t>(n) * 8, static_cast<std::byte>(n));
    for (RawWriter* writer : {&plain, &also_best_effort, &in_partition, &excluded})
      ASSERT_TRUE(writer->write(payload));
  }
  recording.program().send(SIGTERM);
  EXPECT_EQ(recording.program().wait(), 0) << recording.program().err();

  const Info info = info_of(folder / "a.mcap");
  EXPECT_EQ(info.status, 0) << info.report.dump(2);
  EXPECT_EQ(info.topic("some/thing")["messages"], 100) << "once each, though two readers match";
  EXPECT_EQ(info.topic("some/thing")["type"], "their::Blob");
  EXPECT_EQ(info.topic("other/thing")["messages"], 50);
  EXPECT_TRUE(info.topic("some/secret").is_null());
  std::size_t n = 0;
  for (const mcap::Entry& entry : mcap::content_of(folder / "a.mcap").messages)
    if (entry.topic == "other/thing") {
      EXPECT_EQ(std::to_integer<int>(entry.data.at(1)), 1) << "the encapsulation header is part of it";
      EXPECT_EQ(entry.data.size(), 4 + n * 8);
      EXPECT_TRUE(std::all_of(entry.data.begin() + 4, entry.data.end(),
                              [n](std::byte byte) { return byte == static_cast<std::byte>(n); }));
      ++n;
    }
  mcap::IndexedReader reader;
  ASSERT_TRUE(reader.open(folder / "a.mcap").ok());
  for (const auto& [id, channel] : reader.summary().channels) {
    for (const char* key : {"reliability: ", "durability: ", "ownership: ", "keyed: "})
      EXPECT_NE(channel.metadata.at("qos").find(key), std::string::npos);
    EXPECT_EQ(channel.metadata.at("ros2-types"), "false");
    EXPECT_EQ(channel.metadata.at("partitions").empty(), channel.topic != "other/thing");
  }
}

TEST(Recorder, WhatFindsNoRoomInTheRingIsCountedForItsTopicAndSaidInTheFile) {
  const test::Domain domain;
  const Folder folder;
  Recording recording(domain, folder / "a.mcap", {"--ring-bytes", "65536", "--topic", "some/*"});
  ASSERT_TRUE(test::wait_until([&] { return recording.is_running(); }));
  RawBus bus(domain.number(), {});
  RawWriter writer(bus, {.topic = "some/burst", .type = "their::Blob"});
  ASSERT_TRUE(test::wait_until([&] { return writer.matched() == 1; }));
  // Three fit; the thread that writes looks every 5 ms.
  constexpr std::uint64_t sent = 200;
  mcap::Bytes payload{std::byte{0}, std::byte{1}, std::byte{0}, std::byte{0}};
  payload.resize(20'000);
  for (std::uint64_t n = 0; n < sent; ++n) ASSERT_TRUE(writer.write(payload));
  const auto all = [&] {
    const Health h = recording.health();
    return counter(h, "messages") + counter(h, "dropped") == sent;
  };
  EXPECT_TRUE(test::wait_until(all)) << "every one is either written or counted";
  recording.program().send(SIGTERM);
  ASSERT_EQ(recording.program().wait(), 0) << recording.program().err();
  const Info info = info_of(folder / "a.mcap");
  EXPECT_EQ(info.status, 1) << "something is missing";
  const json topic = info.topic("some/burst");
  EXPECT_GT(topic["dropped"], 0);
  EXPECT_EQ(topic["messages"].get<std::uint64_t>() + topic["dropped"].get<std::uint64_t>(), sent);
}

TEST(Recorder, BeginsAnotherFileByTimeAndCompressesAsAsked) {
  const test::Domain domain;
  const test::TextFile settings("[grid]\nreactance = 0.3\n");
  for (const std::string compression : {"lz4", "none"}) {
    SCOPED_TRACE(compression);
    const Folder folder;
    Recording recording(domain, folder / "a.mcap", {"--max-seconds", "1", "--compression", compression});
    test::Services services(domain, settings.path());
    services.start_all();
    ASSERT_TRUE(test::wait_until([&] { return counter(recording.health(), "files") >= 3; }));
    recording.program().send(SIGTERM);
    ASSERT_EQ(recording.program().wait(), 0) << recording.program().err();
    mcap::IndexedReader reader;
    ASSERT_TRUE(reader.open(folder / "a_0002.mcap").ok());
    EXPECT_FALSE(reader.summary().chunks.empty());
    for (const mcap::ChunkIndex& chunk : reader.summary().chunks) {
      constexpr std::uint64_t enough = 10'000;  // bytes; one with few messages is not made smaller
      if (chunk.uncompressed_bytes > enough) {
        EXPECT_EQ(chunk.compression, compression == "none" ? "" : compression);
      }
    }
    const double duration_s = info_of(folder / "a_0002.mcap").report["duration_s"];
    EXPECT_GT(duration_s, 0.8);
    EXPECT_LT(duration_s, 1.5);
  }
}

TEST(Recorder, KilledAtAnyMomentItLosesASecondAtMostAndRecoverMakesACleanFile) {
  const test::Domain domain;
  const test::TextFile settings("[grid]\nreactance = 0.3\n");
  test::Services services(domain, settings.path());
  services.start_all();
  mcap::Random random{7};
  for (std::uint32_t k = 0; k < mcap::law_count(3); ++k) {
    SCOPED_TRACE("kill " + std::to_string(k));
    const Folder folder;
    Recording recording(domain, folder / "broken.mcap", {"--await", "weakgrid/measurement"});
    ASSERT_TRUE(test::wait_until([&] { return recording.is_running(); })) << recording.health().text;
    std::this_thread::sleep_for(test::milliseconds(1200 + mcap::below(random, 800)));
    const auto killed_ns = static_cast<std::uint64_t>(wall_time_ns());
    recording.program().kill();

    const Content broken = mcap::content_of(folder / "broken.mcap");
    ASSERT_FALSE(broken.messages.empty());
    EXPECT_GE(broken.messages.back().log_time_ns + 1'000'000'000, killed_ns);
    EXPECT_TRUE(broken.metadata.count(recording_metadata));
    EXPECT_TRUE(broken.metadata.count(manifest_metadata));
    const Info before = info_of(folder / "broken.mcap");
    EXPECT_EQ(before.status, 1);
    EXPECT_EQ(before.report["state"], "cut");
    EXPECT_EQ(before.report["missing"], 0);

    const test::Ended recover =
        test::run("weakgrid", {"recover", folder / "broken.mcap", "-o", folder / "clean.mcap"});
    EXPECT_EQ(recover.status, 0) << recover.out << recover.err;
    mcap::ScanReport report;
    EXPECT_TRUE(mcap::content_of(folder / "clean.mcap", report).messages == broken.messages);
    EXPECT_TRUE(report.intact()) << report.text();
    EXPECT_EQ(info_of(folder / "clean.mcap").report["state"], "recovered");
  }
}

TEST(Recorder, AFullDiskStopsRecordingAndIsSaidInHealthAndByTheExitStatus) {
  const test::Domain domain;
  const test::TextFile settings("[grid]\nreactance = 0.3\n");
  const Folder folder;
  rlimit before{};
  getrlimit(RLIMIT_FSIZE, &before);
  const rlimit small{300'000, before.rlim_max};
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &small), 0);
  Recording recording(domain, folder / "a.mcap");
  setrlimit(RLIMIT_FSIZE, &before);
  test::Services services(domain, settings.path());
  services.start_all();
  ASSERT_TRUE(test::wait_until([&] { return recording.health().text.starts_with("recording stopped"); }))
      << recording.health().text;
  EXPECT_EQ(recording.health().state, ServiceState::waiting);
  EXPECT_TRUE(recording.program().runs());
  recording.program().send(SIGTERM);
  EXPECT_EQ(recording.program().wait(), 3);
  EXPECT_NE(recording.program().err().find("recording stopped"), std::string::npos);
  const Content content = mcap::content_of(folder / "a.mcap");
  EXPECT_GT(content.messages.size(), 100u) << "what came before is readable";
}

TEST(Recorder, StopsCleanlyBeforeTheDiskIsFull) {
  const test::Domain domain;
  const Folder folder;
  Recording recording(domain, folder / "a.mcap", {"--min-free-bytes", "1000000000000000000"});
  ASSERT_TRUE(test::wait_until([&] { return recording.health().text.starts_with("recording stopped"); }));
  mcap::ScanReport report;
  mcap::content_of(folder / "a.mcap", report);
  EXPECT_TRUE(report.intact()) << report.text();
  recording.program().send(SIGTERM);
  EXPECT_EQ(recording.program().wait(), 3);
}

TEST(Recorder, BeginsAnotherFileBySizeAndLosesNothingBetween) {
  const test::Domain domain;
  const test::TextFile settings("[grid]\nreactance = 0.3\n");
  const Folder folder;
  Recording recording(domain, folder / "a.mcap",
                      {"--max-bytes", "600000", "--await", "weakgrid/measurement"});
  test::Services services(domain, settings.path());
  services.start_all();
  ASSERT_TRUE(test::wait_until([&] { return counter(recording.health(), "files") >= 4; }));
  recording.program().send(SIGTERM);
  ASSERT_EQ(recording.program().wait(), 0) << recording.program().err();
  std::uint32_t next = 0;
  for (const char* part : {"a.mcap", "a_0002.mcap", "a_0003.mcap", "a_0004.mcap"}) {
    const Info info = info_of(folder / part);
    EXPECT_EQ(info.status, 0) << info.report.dump(2);
    EXPECT_LT(info.report["file_bytes"], 750'000) << "the last chunk's index and the summary come on top";
    EXPECT_EQ(info.report["manifests"].size(), 4u) << "each part stands for itself";
    for (const json& writer : info.report["writers"])
      if (writer["topic"] == "weakgrid/measurement") {
        if (next != 0) {
          EXPECT_EQ(writer["first"], next + 1);
        }
        next = writer["last"];
      }
  }
  EXPECT_EQ(test::run("weakgrid-recorder", {"--output", folder / "a.mcap", "--domain", domain.text()}).status,
            3)
      << "an existing file is never overwritten";
}

TEST(Recorder, WaitsForATripAndKeepsWhatWasBefore) {
  const test::Domain domain;
  // A source event that the DC link does not survive.
  const test::TextFile settings(
      "[grid]\nreactance = 0.3\n[scenario]\nend_s = 100.0\n"
      "[[scenario.event]]\nat_s = 2.0\nquantity = \"source_power\"\nvalue = 5.0\n");
  const Folder folder;
  Recording recording(domain, folder / "a.mcap",
                      {"--before", "200ms", "--on", "trip", "--await", "weakgrid/measurement"});
  ASSERT_TRUE(test::wait_until([&] { return recording.health().service == "recorder"; }));
  test::Services services(domain, settings.path());
  services.start_all();
  ASSERT_TRUE(test::wait_until([&] { return recording.is_running(); }));
  EXPECT_NE(recording.health().text.find("waits for a trip"), std::string::npos);
  ASSERT_TRUE(test::wait_until([&] { return counter(recording.health(), "messages") > 1000; }));
  recording.program().send(SIGTERM);
  ASSERT_EQ(recording.program().wait(), 0) << recording.program().err();
  const Content content = mcap::content_of(folder / "a.mcap");
  const auto measurements = messages_of<Measurement>(content, "weakgrid/measurement");
  ASSERT_FALSE(measurements.empty());
  EXPECT_FALSE(measurements.front().blocked);
  EXPECT_TRUE(measurements.back().blocked);
  const auto trip =
      std::find_if(content.messages.begin(), content.messages.end(), [](const mcap::Entry& entry) {
        const auto m = from_payload<Measurement>(entry.data);
        return entry.topic == "weakgrid/measurement" && m && m->message.blocked;
      });
  ASSERT_NE(trip, content.messages.end());
  const double before_s =
      static_cast<double>(trip->log_time_ns - content.messages.front().log_time_ns) * 1e-9;
  EXPECT_GT(before_s, 0.15);
  EXPECT_LT(before_s, 0.25);
  EXPECT_EQ(info_of(folder / "a.mcap").report["missing"], 0);
}

TEST(Recorder, InfoAndRecoverRefuseWhatIsNoRecording) {
  const Folder folder;
  mcap::write_bytes(folder / "text", mcap::bytes_of("not a recording at all"));
  EXPECT_EQ(test::run("weakgrid", {"info", folder / "text"}).status, 2);
  EXPECT_EQ(test::run("weakgrid", {"info", folder / "missing"}).status, 2);
  EXPECT_EQ(test::run("weakgrid", {"recover", folder / "text", "-o", folder / "clean"}).status, 2);
  EXPECT_FALSE(std::filesystem::exists(folder / "clean"));
}

}  // namespace
}  // namespace weakgrid
