// Recovery: of a broken file everything whole is kept, the result is clean, and the loss is in it.
#include "tests/recording/recording_support.hpp"

namespace weakgrid::mcap {
namespace {

TEST(McapRecover, AFileCutAnywhereBecomesACleanOne) {
  const Folder folder;
  WriterOptions options = small_chunks();
  options.chunk_bytes = 1024;
  write_file(folder / "whole", 21, {.records = 40, .payload_max = 30}, options);
  const Bytes bytes = file_bytes(folder / "whole");
  for (std::size_t length = magic.size(); length < bytes.size(); ++length) {
    SCOPED_TRACE("cut at " + std::to_string(length));
    write_bytes(folder / "broken", ByteView{bytes}.first(length));
    std::filesystem::remove(folder / "clean");
    Recovery recovery;
    const Status status = recover(folder / "broken", folder / "clean", {options, {}}, recovery);
    ASSERT_TRUE(status.ok()) << status.text();
    const Content found = content_of(folder / "broken");
    ScanReport report;
    Content clean = content_of(folder / "clean", report);
    ASSERT_TRUE(report.intact()) << report.text();
    ASSERT_EQ(clean.metadata.at(std::string{recovery_metadata}).at("source_intact"), "false");
    ASSERT_EQ(recovery.messages, found.messages.size());
    clean.metadata.erase(std::string{recovery_metadata});
    clean.order.pop_back();
    ASSERT_TRUE(clean == found);
  }
}

TEST(McapRecover, OfAnIntactFileNothingIsLost) {
  const Folder folder;
  const Content whole = write_file(folder / "whole", 22);
  Recovery recovery;
  ASSERT_TRUE(recover(folder / "whole", folder / "clean", {small_chunks(), {}}, recovery).ok());
  EXPECT_TRUE(recovery.scan.intact()) << recovery.text();
  EXPECT_TRUE(content_of(folder / "clean").messages == whole.messages);
}

TEST(McapRecover, ADamagedChunkIsDroppedUnlessAskedFor) {
  const Folder folder;
  const WriterOptions options = small_chunks(Compression::none);
  const Content whole = write_file(folder / "broken", 23, {.records = 500, .extras = false}, options);
  Bytes bytes = file_bytes(folder / "broken");
  IndexedReader reader;
  ASSERT_TRUE(reader.open(ByteView{bytes}).ok());
  const auto& chunks = reader.summary().chunks;
  const ChunkIndex& chunk = chunks.at(chunks.size() / 2);
  bytes[chunk.offset + chunk.length - 1] ^= std::byte{1};  // the last byte of a payload, or of a time
  write_bytes(folder / "broken", bytes);

  Recovery dropped;
  ASSERT_TRUE(recover(folder / "broken", folder / "dropped", {options, {}}, dropped).ok());
  EXPECT_EQ(dropped.scan.chunks_bad_crc, 1U);
  EXPECT_GT(dropped.scan.messages_dropped, 0U);
  EXPECT_EQ(dropped.messages + dropped.scan.messages_dropped, whole.messages.size()) << "the loss is exact";
  const Content clean = content_of(folder / "dropped");
  EXPECT_EQ(clean.metadata.at(std::string{recovery_metadata}).at("messages_known_lost"),
            std::to_string(dropped.scan.messages_dropped));

  Recovery kept;
  ASSERT_TRUE(recover(folder / "broken", folder / "kept", {options, {.keep_bad_crc = true}}, kept).ok());
  EXPECT_EQ(kept.messages, whole.messages.size());
}

TEST(McapRecover, TouchesNeitherTheBrokenFileNorAnExistingOne) {
  const Folder folder;
  write_file(folder / "a", 24);
  const Bytes before = file_bytes(folder / "a");
  Recovery recovery;
  EXPECT_EQ(recover(folder / "a", folder / "a", {small_chunks(), {}}, recovery).error, EEXIST);
  EXPECT_EQ(file_bytes(folder / "a"), before);
  EXPECT_EQ(recover(folder / "missing", folder / "b", {small_chunks(), {}}, recovery).error, ENOENT);
  EXPECT_FALSE(std::filesystem::exists(folder / "b"));
}

}  // namespace
}  // namespace weakgrid::mcap
