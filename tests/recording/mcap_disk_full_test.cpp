// A disk that is full: the writer says so, stays usable, and leaves a readable file.
#include <signal.h>
#include <sys/resource.h>

#include "tests/recording/recording_support.hpp"

namespace weakgrid::mcap {
namespace {

/// Lets files grow to `bytes` only: write() then comes back short, and after that fails with EFBIG.
class FileSizeLimit {
 public:
  FileSizeLimit() {
    ::signal(SIGXFSZ, SIG_IGN);
    ::getrlimit(RLIMIT_FSIZE, &before_);
  }
  ~FileSizeLimit() { lift(); }
  FileSizeLimit(const FileSizeLimit&) = delete;
  FileSizeLimit& operator=(const FileSizeLimit&) = delete;
  void set(rlim_t bytes) {
    const rlimit limit{bytes, before_.rlim_max};
    ASSERT_EQ(::setrlimit(RLIMIT_FSIZE, &limit), 0);
  }
  void lift() { ::setrlimit(RLIMIT_FSIZE, &before_); }

 private:
  rlimit before_{};
};

/// One chunk of ten messages each time.
Status write_ten(Writer& writer, ChannelId channel, std::uint32_t first) {
  for (std::uint32_t k = first; k < first + 10; ++k)
    (void)writer.write_message(channel, k, 1000 + k, 1000 + k, Bytes(100, static_cast<std::byte>(k)));
  return writer.flush();
}

TEST(McapDiskFull, TheFileIsReadableUpToTheFaultAndTheLossIsCounted) {
  for (const rlim_t room : {0U, 1U, 50U, 700U, 1000U, 1500U}) {
    const Folder folder;
    FileSizeLimit limit;
    Writer writer;
    ASSERT_TRUE(writer.open(folder / "a.mcap", small_chunks(Compression::none)).ok());
    const ChannelId channel = writer.add_channel(0, "t", "cdr", {});
    ASSERT_TRUE(write_ten(writer, channel, 0).ok());
    const auto good_bytes = writer.file_bytes();
    limit.set(good_bytes + room);
    const Status full = write_ten(writer, channel, 10);
    EXPECT_TRUE(full.disk_full()) << full.text();
    EXPECT_EQ(std::filesystem::file_size(folder / "a.mcap"), good_bytes) << "no torn record stays";
    EXPECT_TRUE(writer.write_metadata("m", {{"text", std::string(2000, 'x')}}).disk_full());
    EXPECT_EQ(writer.counters().messages, 10U);
    EXPECT_EQ(writer.counters().messages_lost, 10U);
    EXPECT_TRUE(writer.first_fault().disk_full());
    const bool closed = writer.close().ok();
    limit.lift();
    ScanReport report;
    EXPECT_EQ(content_of(folder / "a.mcap", report).messages.size(), 10U);
    EXPECT_EQ(report.intact(), closed) << "a summary that had room is there, else the file just ends";
    EXPECT_EQ(report.chunks_undecodable, 0U);
  }
}

TEST(McapDiskFull, RecordingGoesOnWhenThereIsSpaceAgain) {
  const Folder folder;
  FileSizeLimit limit;
  Writer writer;
  ASSERT_TRUE(writer.open(folder / "a.mcap", small_chunks(Compression::none)).ok());
  limit.set(writer.file_bytes() + 20);
  const SchemaId schema = writer.add_schema("a::T", "omgidl", "module a { struct T { double x; }; };");
  const ChannelId channel = writer.add_channel(schema, "t", "cdr", {});
  EXPECT_FALSE(write_ten(writer, channel, 0).ok());
  limit.lift();
  EXPECT_TRUE(write_ten(writer, channel, 10).ok()) << "the definitions lost with the first chunk come again";
  EXPECT_TRUE(writer.sync().ok());
  EXPECT_TRUE(writer.close().ok());
  EXPECT_EQ(writer.counters().messages_lost, 10U);
  ScanReport report;
  const Content content = content_of(folder / "a.mcap", report);
  EXPECT_TRUE(report.intact()) << report.text();
  ASSERT_EQ(content.messages.size(), 10U);
  EXPECT_EQ(content.messages[0].sequence, 10U);
}

TEST(McapDiskFull, AFileThatCannotBeBegunIsNotLeftBehind) {
  const Folder folder;
  FileSizeLimit limit;
  limit.set(3);
  Writer writer;
  EXPECT_TRUE(writer.open(folder / "a.mcap", small_chunks()).disk_full());
  limit.lift();
  EXPECT_FALSE(writer.is_open());
  EXPECT_FALSE(std::filesystem::exists(folder / "a.mcap"));
  EXPECT_TRUE(writer.open(folder / "a.mcap", small_chunks()).ok());
}

TEST(McapDiskFull, RecoveryOntoAFullDiskSaysSo) {
  const Folder folder;
  write_file(folder / "a.mcap", 3, {.records = 3000});
  FileSizeLimit limit;
  limit.set(20'000);
  Recovery recovery;
  const Status status = recover(folder / "a.mcap", folder / "b.mcap", {small_chunks(), {}}, recovery);
  EXPECT_TRUE(status.disk_full()) << status.text();
}

}  // namespace
}  // namespace weakgrid::mcap
