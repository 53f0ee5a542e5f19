// The indexed reader where the index and the file disagree, or memory is short.
#include "tests/recording/recording_support.hpp"

namespace weakgrid::mcap {
namespace {

TEST(McapIndex, ADamagedChunkIsSkippedAndCounted) {
  const Folder folder;
  const Content whole = write_file(folder / "a", 51, {.records = 500, .extras = false});
  Bytes bytes = file_bytes(folder / "a");
  IndexedReader reader;
  ASSERT_TRUE(reader.open(ByteView{bytes}).ok());
  const ChunkIndex& chunk = reader.summary().chunks.at(2);
  bytes[chunk.offset + chunk.length / 2] ^= std::byte{8};
  reader.select({});
  std::size_t messages = 0;
  while (reader.next()) ++messages;
  EXPECT_EQ(reader.chunks_skipped(), 1U);
  EXPECT_LT(messages, whole.messages.size());
  EXPECT_GT(messages, whole.messages.size() / 2);
  EXPECT_TRUE(reader.status().ok());
}

TEST(McapIndex, ChunksThatAllOverlapEndInAStatusNotInMemory) {
  const Folder folder;
  Writer writer;
  ASSERT_TRUE(writer.open(folder / "a", small_chunks()).ok());
  const ChannelId channel = writer.add_channel(0, "t", "cdr", {});
  for (std::uint32_t k = 0; k < 1000; ++k)
    ASSERT_TRUE(writer.write_message(channel, k, std::uint64_t{k % 2} * 1'000'000, 0, Bytes(100)).ok());
  ASSERT_TRUE(writer.close().ok());
  IndexedReader reader;
  ASSERT_TRUE(reader.open(folder / "a", {.chunk_bytes_max = 8192}).ok());
  EXPECT_FALSE(reader.next());
  EXPECT_EQ(reader.status().fault, Fault::too_large);
  ASSERT_TRUE(reader.open(folder / "a").ok());
  std::size_t messages = 0;
  while (reader.next()) ++messages;
  EXPECT_EQ(messages, 1000U);
}

TEST(McapIndex, AnIndexThatPointsElsewhereGivesNothing) {
  const Folder folder;
  write_file(folder / "a", 52, {.records = 600});
  IndexedReader reader;
  ASSERT_TRUE(reader.open(folder / "a").ok());
  ASSERT_FALSE(reader.summary().metadata.empty());
  ASSERT_FALSE(reader.summary().attachments.empty());
  MetadataIndex metadata = reader.summary().metadata.front();
  AttachmentIndex attachment = reader.summary().attachments.front();
  EXPECT_TRUE(reader.metadata(metadata));
  EXPECT_TRUE(reader.attachment(attachment));
  for (const std::uint64_t offset :
       {metadata.offset + 1, std::uint64_t{0}, ~std::uint64_t{0}, ~std::uint64_t{7}}) {
    metadata.offset = attachment.offset = offset;
    EXPECT_FALSE(reader.metadata(metadata));
    EXPECT_FALSE(reader.attachment(attachment));
  }
}

/// A file whose summary lists one chunk twice, with a CRC that holds.
Bytes with_a_chunk_listed_twice(ByteView bytes) {
  const std::size_t end_bytes = record_head_bytes + footer_bytes + magic.size();
  const auto footer = *parse_footer(bytes.last(end_bytes).subspan(record_head_bytes, footer_bytes));
  Bytes out{bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(footer.summary_start)};
  const ChunkIndex chunk{.offset = 50, .length = 20, .message_index_offsets = {}, .compression = ""};
  append(out, Statistics{.chunks = 2, .channel_messages = {}});
  append(out, chunk);
  append(out, chunk);
  put(out, static_cast<std::uint8_t>(Op::footer));
  put<std::uint64_t>(out, footer_bytes);
  put(out, footer.summary_start);
  put<std::uint64_t>(out, 0);
  put(out, crc32(ByteView{out}.subspan(footer.summary_start)));
  put_bytes(out, magic);
  return out;
}

TEST(McapIndex, ASummaryThatListsAChunkTwiceIsNotBelieved) {
  const Folder folder;
  const Content whole = write_file(folder / "a", 53, {.extras = false});
  const Bytes bytes = with_a_chunk_listed_twice(file_bytes(folder / "a"));
  IndexedReader reader;
  ASSERT_TRUE(reader.open(ByteView{bytes}).ok());
  EXPECT_TRUE(reader.summary().rebuilt);
  EXPECT_EQ(reader.summary().statistics.messages, whole.messages.size());
}

}  // namespace
}  // namespace weakgrid::mcap
