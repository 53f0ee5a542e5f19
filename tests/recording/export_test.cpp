// weakgrid export: what is in a recording is in the tables, what is not is said. No network.
#include <signal.h>
#include <sys/resource.h>

#include "services/recording/idl_text.hpp"
#include "tests/recording/payload_of.hpp"
#include "tests/recording/recording_support.hpp"
#include "tests/support/processes_under_test.hpp"

namespace weakgrid {
namespace {

using mcap::Folder;

/// Writes a recording message by message; equal topics are of one channel.
class Recording {
 public:
  explicit Recording(const std::string& path) {
    EXPECT_TRUE(writer_.open(path, mcap::small_chunks()).ok());
    schemas_[""] = 0;
  }
  void put(const std::string& topic, const std::string& type, const mcap::Bytes& payload,
           const std::string& idl = std::string(idl_text())) {
    if (!schemas_.contains(type)) schemas_[type] = writer_.add_schema(type, "omgidl", idl);
    if (!channels_.contains(topic))
      channels_[topic] = writer_.add_channel(schemas_[type], topic, "cdr", {{"writer", "01|2"}});
    ++count_;
    EXPECT_TRUE(writer_.write_message(channels_[topic], count_, 1000 + count_, 900 + count_, payload).ok());
  }
  void close() { EXPECT_TRUE(writer_.close().ok()); }

 private:
  mcap::Writer writer_;
  std::map<std::string, mcap::SchemaId> schemas_;
  std::map<std::string, mcap::ChannelId> channels_;
  std::uint32_t count_ = 0;
};

const char* const reference_type = "weakgrid::wire::Reference";
mcap::Bytes reference(std::uint32_t id) {
  return payload_of(
      3, Reference{.id = id, .p = 0.1, .q = -0.0, .v_c = 1e300, .effective_step = 9, .ramp_steps = 7});
}

std::string text_of(const std::string& path) {
  const mcap::Bytes bytes = mcap::file_bytes(path);
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

test::Ended run_export(const std::vector<std::string>& recordings, const std::string& folder,
                       const std::vector<std::string>& more = {}) {
  std::vector<std::string> arguments{"export"};
  arguments.insert(arguments.end(), recordings.begin(), recordings.end());
  arguments.insert(arguments.end(), {"-o", folder});
  arguments.insert(arguments.end(), more.begin(), more.end());
  return test::run("weakgrid", arguments);
}

std::size_t files_in(const std::string& folder) {
  const auto files = std::filesystem::directory_iterator(folder);
  return static_cast<std::size_t>(std::distance(begin(files), end(files)));
}

const std::string reference_head =
    "log_time_ns,publish_time_ns,writer,sequence,unit,id,renews,ramp_steps,active_power,reactive_power,dc_"
    "voltage,"
    "effective_step,lease_end_step,fallback_active_power,fallback_reactive_power,fallback_dc_voltage,"
    "fallback_ramp_steps\n";
// Of a reference without a lease, from its ramp on.
const std::string reference_tail = ",0,7,0.1,-0,1e+300,9,0,0,0,1.8384776310850235,0\n";

TEST(Export, EveryFieldIsAColumnAndNumbersAreExact) {
  const Folder folder;
  Recording recording(folder / "a.mcap");
  recording.put("weakgrid/reference", reference_type, reference(1));
  recording.put("weakgrid/reference", reference_type, reference(2));
  recording.close();
  const test::Ended ended = run_export({folder / "a.mcap"}, folder / "new/csv");
  EXPECT_EQ(ended.status, 0) << ended.err;
  EXPECT_EQ(ended.err, "");
  EXPECT_EQ(text_of(folder / "new/csv/weakgrid_reference.csv"),
            reference_head + "1001,901,01|2,1,3,1" + reference_tail + "1002,902,01|2,2,3,2" + reference_tail);
}

TEST(Export, TextsAreQuotedWhereRfc4180AsksForIt) {
  const Folder folder;
  Recording recording(folder / "a.mcap");
  Health health;
  health.service = "pl,ant";
  health.counters = {{"a", 1}, {"b", 2}};
  health.text = "says \"no\"\r\nand stops";
  health.timings = {{"write", 5, 1, 2, 3, 4, 5, {6}}};
  recording.put("h", "weakgrid::wire::Health", payload_of(1, health));
  recording.close();
  EXPECT_EQ(run_export({folder / "a.mcap"}, folder / "csv").status, 0);
  const std::string text = text_of(folder / "csv/h.csv");
  EXPECT_EQ(text.substr(text.find('\n') + 1),
            "1001,901,01|2,1,1,\"pl,ant\",0,STARTING,0,0,0,a:1;b:2,,\"says \"\"no\"\"\r\nand stops\",write:5:1:2:3:4:5:6/0/0/0/0/0/0/0/0/0/0/0/0/0/0/0/0/0/0\n");
}

TEST(Export, OfOtherTypesThePayloadIsThereAndNamesStayInTheFolderAndApart) {
  const Folder folder;
  Recording recording(folder / "a.mcap");
  const mcap::Bytes payload{std::byte{0x00}, std::byte{0xff}, std::byte{0x1a}};
  for (const char* topic : {"a/b", "a_b", "../../up", "", "a\nb"})
    recording.put(topic, "their::Blob", payload, "");
  recording.put("none", "", {});
  recording.close();
  EXPECT_EQ(run_export({folder / "a.mcap"}, folder / "csv").status, 0);
  EXPECT_EQ(files_in(folder / "."), 2u);
  EXPECT_EQ(files_in(folder / "csv"), 6u);
  const std::string head = "log_time_ns,publish_time_ns,writer,sequence,payload\n";
  EXPECT_EQ(text_of(folder / "csv/a_b.csv"), head + "1001,901,01|2,1,00ff1a\n");
  EXPECT_EQ(text_of(folder / "csv/a_b_2.csv"), head + "1002,902,01|2,2,00ff1a\n");
  EXPECT_EQ(text_of(folder / "csv/.._.._up.csv"), head + "1003,903,01|2,3,00ff1a\n");
  EXPECT_EQ(text_of(folder / "csv/none.csv"), head + "1006,906,01|2,6,\n");
}

TEST(Export, PartsFollowEachOtherInOneTable) {
  const Folder folder;
  for (const char* name : {"a.mcap", "a_0002.mcap"}) {
    Recording recording(folder / name);
    recording.put("r", reference_type, reference(5));
    recording.close();
  }
  EXPECT_EQ(run_export({folder / "a.mcap", folder / "a_0002.mcap"}, folder / "csv").status, 0);
  const std::string row = "1001,901,01|2,1,3,5" + reference_tail;
  EXPECT_EQ(text_of(folder / "csv/r.csv"), reference_head + row + row);
}

TEST(Export, TopicsAreChosenByPattern) {
  const Folder folder;
  Recording recording(folder / "a.mcap");
  for (const char* topic : {"x/a", "x/b", "y/a"}) recording.put(topic, reference_type, reference(5));
  recording.close();
  EXPECT_EQ(run_export({folder / "a.mcap"}, folder / "csv", {"--topic", "x/*", "--exclude", "*/b"}).status,
            0);
  EXPECT_EQ(files_in(folder / "csv"), 1u);
  EXPECT_TRUE(std::filesystem::exists(folder / "csv/x_a.csv"));
  const test::Ended none = run_export({"--topic", "z", folder / "a.mcap"}, folder / "none");
  EXPECT_EQ(none.status, 1);
  EXPECT_NE(none.err.find("no message"), std::string::npos);
}

TEST(Export, NothingIsOverwrittenAndNothingHalfLeft) {
  const Folder folder;
  Recording recording(folder / "a.mcap");
  for (const char* topic : {"a", "b"}) recording.put(topic, reference_type, reference(5));
  recording.close();
  std::filesystem::create_directory(folder / "csv");
  mcap::write_bytes(folder / "csv/b.csv", mcap::bytes_of("mine"));
  const test::Ended ended = run_export({folder / "a.mcap"}, folder / "csv");
  EXPECT_EQ(ended.status, 3);
  EXPECT_NE(ended.err.find("b.csv: is there already"), std::string::npos) << ended.err;
  EXPECT_EQ(text_of(folder / "csv/b.csv"), "mine");
  EXPECT_EQ(files_in(folder / "csv"), 1u);
  EXPECT_EQ(run_export({folder / "a.mcap"}, folder / "csv/b.csv").status, 3);
}

TEST(Export, AFullDiskIsSaidAndLeavesNothing) {
  const Folder folder;
  Recording recording(folder / "a.mcap");
  for (std::uint32_t id = 1; id < 5000; ++id) recording.put("r", reference_type, reference(id));
  recording.close();
  rlimit before{};
  getrlimit(RLIMIT_FSIZE, &before);
  const rlimit small{100'000, before.rlim_max};
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &small), 0);
  const test::Ended ended = run_export({folder / "a.mcap"}, folder / "csv");
  setrlimit(RLIMIT_FSIZE, &before);
  EXPECT_EQ(ended.status, 3);
  EXPECT_NE(ended.err.find("r.csv: File too large"), std::string::npos) << ended.err;
  EXPECT_FALSE(std::filesystem::exists(folder / "csv"));
}

TEST(Export, WhatIsNoRecordingIsRefusedBeforeAnythingIsMade) {
  const Folder folder;
  mcap::write_bytes(folder / "text", mcap::bytes_of("not a recording at all"));
  Recording recording(folder / "a.mcap");
  recording.put("a", reference_type, reference(5));
  recording.close();
  EXPECT_EQ(run_export({folder / "a.mcap", folder / "text"}, folder / "csv").status, 2);
  EXPECT_EQ(run_export({folder / "missing"}, folder / "csv").status, 2);
  EXPECT_FALSE(std::filesystem::exists(folder / "csv"));
}

TEST(Export, OfACutRecordingWhatIsThereComesAndTheRestIsSaid) {
  const Folder folder;
  Recording recording(folder / "a.mcap");
  for (std::uint32_t id = 1; id <= 1000; ++id) recording.put("r", reference_type, reference(id));
  recording.close();
  const mcap::Bytes bytes = mcap::file_bytes(folder / "a.mcap");
  mcap::write_bytes(folder / "cut.mcap", mcap::ByteView{bytes}.first(bytes.size() / 2));
  mcap::ScanReport report;
  const auto messages = mcap::content_of(folder / "cut.mcap", report).messages.size();
  ASSERT_GT(messages, 100u);
  const test::Ended ended = run_export({folder / "cut.mcap"}, folder / "csv");
  EXPECT_EQ(ended.status, 1);
  EXPECT_NE(ended.err.find(report.text()), std::string::npos) << ended.err;
  const std::string text = text_of(folder / "csv/r.csv");
  EXPECT_EQ(static_cast<std::size_t>(std::count(text.begin(), text.end(), '\n')), 1 + messages);
}

TEST(Export, WhatIsNotOfItsTypeIsLeftOutAndCounted) {
  const Folder folder;
  Recording recording(folder / "a.mcap");
  mcap::Bytes cut = reference(2);
  cut.resize(cut.size() - 1);
  for (const mcap::Bytes& payload : {reference(1), cut, mcap::Bytes{}})
    recording.put("r", reference_type, payload);
  recording.close();
  const test::Ended ended = run_export({folder / "a.mcap"}, folder / "csv");
  EXPECT_EQ(ended.status, 1);
  EXPECT_NE(ended.err.find("r: 2 messages are not of the type"), std::string::npos) << ended.err;
  EXPECT_EQ(text_of(folder / "csv/r.csv"), reference_head + "1001,901,01|2,1,3,1" + reference_tail);
}

TEST(Export, AnotherIdlIsSaidCommentsDoNotMatter) {
  const Folder folder;
  const std::string same = "// moved\n" + std::string(idl_text()) + "\n// end\n";
  std::string other = same;
  other.replace(other.find("double"), 6, "float");
  for (const char* name : {"same.mcap", "other.mcap"}) {
    Recording recording(folder / name);
    recording.put("r", reference_type, reference(1), *name == 's' ? same : other);
    recording.close();
  }
  EXPECT_EQ(run_export({folder / "same.mcap"}, folder / "same").err, "");
  EXPECT_NE(run_export({folder / "other.mcap"}, folder / "other").err.find("another weakgrid.idl"),
            std::string::npos);
}

}  // namespace
}  // namespace weakgrid
