// What the MCAP writer promises its callers.
#include <signal.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>

#include "tests/recording/recording_support.hpp"

namespace weakgrid::mcap {
namespace {

TEST(McapWriter, NeverOverwritesAFile) {
  const Folder folder;
  write_bytes(folder / "a.mcap", bytes_of("precious"));
  Writer writer;
  const Status status = writer.open(folder / "a.mcap", small_chunks());
  EXPECT_EQ(status.fault, Fault::system);
  EXPECT_EQ(status.error, EEXIST);
  EXPECT_EQ(file_bytes(folder / "a.mcap"), bytes_of("precious"));
}

TEST(McapWriter, AnEmptyRecordingIsAnIntactFile) {
  const Folder folder;
  Writer writer;
  ASSERT_TRUE(writer.open(folder / "a.mcap", small_chunks()).ok());
  const SchemaId schema = writer.add_schema("a::T", "omgidl", "module a { struct T { double x; }; };");
  EXPECT_EQ(writer.add_channel(schema, "t", "cdr", {}), 1);
  ASSERT_TRUE(writer.close().ok());
  ScanReport report;
  EXPECT_TRUE(content_of(folder / "a.mcap", report).messages.empty());
  EXPECT_TRUE(report.intact()) << report.text();

  IndexedReader reader;
  ASSERT_TRUE(reader.open(folder / "a.mcap").ok());
  EXPECT_FALSE(reader.summary().rebuilt);
  EXPECT_TRUE(reader.summary().channels.empty()) << "a channel without messages is not in the file";
  EXPECT_TRUE(reader.summary().schemas.empty());
  EXPECT_EQ(reader.summary().statistics.channels, 0U);
}

TEST(McapWriter, ChunksStayWithinTheirSize) {
  const Folder folder;
  write_file(folder / "a.mcap", 1, {.records = 2000, .payload_max = 50, .extras = false});
  IndexedReader reader;
  ASSERT_TRUE(reader.open(folder / "a.mcap").ok());
  EXPECT_GT(reader.summary().chunks.size(), 10U);
  for (const ChunkIndex& chunk : reader.summary().chunks) EXPECT_LE(chunk.uncompressed_bytes, 4096U);
}

TEST(McapWriter, AMessageLargerThanAChunkGetsItsOwn) {
  const Folder folder;
  Writer writer;
  ASSERT_TRUE(writer.open(folder / "a.mcap", small_chunks()).ok());
  const ChannelId channel = writer.add_channel(0, "t", "cdr", {});
  for (const std::size_t size : {10U, 100'000U, 10U})
    EXPECT_TRUE(writer.write_message(channel, 0, 1, 1, Bytes(size)).ok());
  ASSERT_TRUE(writer.close().ok());
  EXPECT_EQ(writer.counters().chunks, 3U);
  EXPECT_EQ(content_of(folder / "a.mcap").messages.at(1).data.size(), 100'000U);
}

TEST(McapWriter, WhatDoesNotCompressIsStoredAsItIs) {
  const Folder folder;
  for (const Compression compression : compressions) {
    Random random{7};
    Bytes noise(3000);
    for (std::byte& byte : noise) byte = static_cast<std::byte>(random());
    const auto path = folder / (std::string{"a"} + std::string{name_of(compression)}).c_str();
    Writer writer;
    ASSERT_TRUE(writer.open(path, small_chunks(compression)).ok());
    const ChannelId channel = writer.add_channel(0, "t", "cdr", {});
    EXPECT_TRUE(writer.write_message(channel, 0, 1, 1, noise).ok());
    EXPECT_TRUE(writer.write_message(channel, 0, 1, 1, Bytes(3000)).ok());
    ASSERT_TRUE(writer.close().ok());
    IndexedReader reader;
    ASSERT_TRUE(reader.open(path).ok());
    ASSERT_EQ(reader.summary().chunks.size(), 2U);
    EXPECT_EQ(reader.summary().chunks[0].compression, "");
    EXPECT_EQ(reader.summary().chunks[1].compression, name_of(compression));
  }
}

TEST(McapWriter, AChunkIsWrittenWhenItIsOld) {
  const Folder folder;
  Writer writer;
  WriterOptions options = small_chunks();
  options.chunk_age_ns = 250;
  ASSERT_TRUE(writer.open(folder / "a.mcap", options).ok());
  const ChannelId channel = writer.add_channel(0, "t", "cdr", {});
  EXPECT_TRUE(writer.flush_if_older(0).ok());
  EXPECT_TRUE(writer.write_message(channel, 0, 1, 1, {}).ok());
  EXPECT_TRUE(writer.flush_if_older(1000).ok());
  EXPECT_TRUE(writer.flush_if_older(1249).ok());
  EXPECT_EQ(writer.counters().chunks, 0U);
  EXPECT_TRUE(writer.flush_if_older(1250).ok());
  EXPECT_EQ(writer.counters().chunks, 1U);
  EXPECT_TRUE(writer.write_message(channel, 0, 1, 1, {}).ok());
  EXPECT_TRUE(writer.flush_if_older(1300).ok());
  EXPECT_EQ(writer.counters().chunks, 1U) << "the age of the next chunk counts anew";
}

TEST(McapWriter, RefusesWithoutWriting) {
  const Folder folder;
  Writer writer;
  EXPECT_EQ(writer.write_message(1, 0, 1, 1, {}).fault, Fault::closed);
  EXPECT_EQ(writer.flush().fault, Fault::closed);
  EXPECT_EQ(writer.close().fault, Fault::closed);
  WriterOptions options = small_chunks();
  options.chunk_bytes = 100;
  EXPECT_EQ(writer.open(folder / "a.mcap", options).fault, Fault::refused);
  ASSERT_TRUE(writer.open(folder / "a.mcap", small_chunks()).ok());
  EXPECT_EQ(writer.open(folder / "b.mcap", small_chunks()).fault, Fault::refused);
  EXPECT_EQ(writer.write_message(1, 0, 1, 1, {}).fault, Fault::refused);
  EXPECT_EQ(writer.write_message(0, 0, 1, 1, {}).fault, Fault::refused);
  EXPECT_EQ(writer.add_channel(1, "t", "cdr", {}), 0) << "there is no schema 1";
  const ChannelId channel = writer.add_channel(0, "t", "cdr", {});
  EXPECT_EQ(writer.write_message(channel, 0, 1, 1, Bytes(record_bytes_max + 1)).fault, Fault::refused);
  EXPECT_TRUE(writer.write_message(channel, 0, 1, 1, Bytes(record_bytes_max)).ok());
  EXPECT_TRUE(writer.close().ok());
  EXPECT_EQ(writer.counters().messages, 1U);
  ScanReport report;
  EXPECT_EQ(content_of(folder / "a.mcap", report).messages.size(), 1U) << "our reader reads what we wrote";
  EXPECT_TRUE(report.intact()) << report.text();
}

TEST(McapWriter, ARotatedFileStandsAlone) {
  const Folder folder;
  Writer writer;
  ASSERT_TRUE(writer.open(folder / "a.mcap", small_chunks()).ok());
  const SchemaId schema = writer.add_schema("a::T", "omgidl", "module a { struct T { double x; }; };");
  const ChannelId first = writer.add_channel(schema, "first", "cdr", {});
  const ChannelId second = writer.add_channel(schema, "second", "cdr", {});
  EXPECT_TRUE(writer.write_message(first, 0, 10, 10, {}).ok());
  EXPECT_TRUE(writer.write_message(second, 0, 11, 11, {}).ok());
  EXPECT_TRUE(writer.close().ok());
  ASSERT_TRUE(writer.open(folder / "b.mcap", small_chunks()).ok());
  EXPECT_TRUE(writer.write_message(second, 1, 12, 12, {}).ok());
  EXPECT_TRUE(writer.close().ok());

  IndexedReader reader;
  ASSERT_TRUE(reader.open(folder / "b.mcap").ok());
  EXPECT_EQ(reader.summary().schemas.at(schema).name, "a::T");
  EXPECT_EQ(reader.summary().channels.at(second).topic, "second");
  EXPECT_EQ(reader.summary().channels.size(), 1U);
  EXPECT_EQ(reader.summary().statistics.start_ns, 12U);
  ScanReport report;
  EXPECT_EQ(content_of(folder / "b.mcap", report).messages.size(), 1U);
  EXPECT_TRUE(report.intact()) << report.text();
}

/// Records as fast as it can until it is killed, and says in `flushed` how many messages must survive.
[[noreturn]] void record_until_killed(const std::string& path, std::atomic<std::uint32_t>& flushed) {
  Writer writer;
  WriterOptions options = small_chunks();
  options.chunk_age_ns = 5;
  if (!writer.open(path, options).ok()) ::_exit(1);
  (void)writer.write_metadata("run", {{"settings", "weak"}});
  const ChannelId channel = writer.add_channel(0, "t", "cdr", {});
  for (std::uint32_t k = 0; k < 10'000'000; ++k) {
    (void)writer.write_message(channel, k, k, k, Bytes(20, static_cast<std::byte>(k)));
    (void)writer.flush_if_older(k);
    flushed = static_cast<std::uint32_t>(writer.counters().messages);
  }
  ::_exit(1);
}

TEST(McapWriter, WhatWasFlushedSurvivesAKillAtAnyMoment) {
  void* shared = ::mmap(nullptr, sizeof(std::atomic<std::uint32_t>), PROT_READ | PROT_WRITE,
                        MAP_SHARED | MAP_ANONYMOUS, -1, 0);
  ASSERT_NE(shared, MAP_FAILED);
  auto& flushed = *new (shared) std::atomic<std::uint32_t>;
  Random random{41};
  for (std::uint32_t kill = 0; kill < 20; ++kill) {
    const Folder folder;
    flushed = 0;
    const pid_t child = ::fork();
    ASSERT_GE(child, 0);
    if (child == 0) record_until_killed(folder / "a.mcap", flushed);
    while (flushed == 0) ::usleep(100);
    ::usleep(static_cast<useconds_t>(below(random, 5000)));
    ::kill(child, SIGKILL);
    int state = 0;
    ASSERT_EQ(::waitpid(child, &state, 0), child);
    ASSERT_TRUE(WIFSIGNALED(state));

    ScanReport report;
    const Content content = content_of(folder / "a.mcap", report);
    EXPECT_EQ(report.ending, Ending::cut);
    EXPECT_EQ(report.chunks_undecodable + report.chunks_bad_crc, 0U) << report.text();
    EXPECT_EQ(content.metadata.at("run").at("settings"), "weak");
    EXPECT_GE(content.messages.size(), flushed);
    bool gapless = true;
    for (std::uint32_t k = 0; k < content.messages.size(); ++k) gapless &= content.messages[k].sequence == k;
    EXPECT_TRUE(gapless);
    EXPECT_EQ(by_time(folder / "a.mcap"), content.messages) << "a missing summary is made up for by a scan";
    Recovery recovery;
    EXPECT_TRUE(recover(folder / "a.mcap", folder / "b.mcap", {small_chunks(), {}}, recovery).ok());
    EXPECT_EQ(content_of(folder / "b.mcap", report).messages, content.messages);
    EXPECT_TRUE(report.intact()) << report.text();
  }
  ::munmap(shared, sizeof(std::atomic<std::uint32_t>));
}

}  // namespace
}  // namespace weakgrid::mcap
