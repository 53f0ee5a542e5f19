// Bytes that nobody meant to be read: cut, flipped, zeroed, lied about. The reader answers, it never falls
// over. Random damage: tests/fuzz.
#include "tests/recording/recording_support.hpp"

namespace weakgrid::mcap {
namespace {

bool is_prefix(const Content& part, const Content& whole) {
  return part.messages.size() <= whole.messages.size() && part.order.size() <= whole.order.size() &&
         std::equal(part.messages.begin(), part.messages.end(), whole.messages.begin()) &&
         std::equal(part.order.begin(), part.order.end(), whole.order.begin());
}

/// Everything a reader can be asked on bytes of any kind; what it yields is at least looked at.
Content exercise(ByteView bytes, ScanReport& report, const ReaderOptions& options = {}) {
  Content content = content_of(bytes, report, options);
  EXPECT_NE(report.ending, Ending::running);
  EXPECT_LE(report.offset, bytes.size());
  IndexedReader indexed;
  if (!indexed.open(bytes, options).ok()) return content;
  for (const MetadataIndex& index : indexed.summary().metadata) (void)indexed.metadata(index);
  for (const AttachmentIndex& index : indexed.summary().attachments) (void)indexed.attachment(index);
  while (indexed.next()) continue;
  return content;
}

RandomRecording small_recording() { return {.records = 40, .payload_max = 30, .extras = true}; }

TEST(McapHostile, CutAtAnyByteItYieldsAPrefix) {
  const Folder folder;
  for (const Compression compression : compressions) {
    const auto path = folder / (std::string{"a"} + std::string{name_of(compression)}).c_str();
    WriterOptions options = small_chunks(compression);
    options.chunk_bytes = 1024;
    const Content whole = write_file(path, 11, small_recording(), options);
    const Bytes bytes = file_bytes(path);
    std::size_t messages = 0;
    for (std::size_t length = 0; length < bytes.size(); ++length) {
      SCOPED_TRACE("cut at " + std::to_string(length) + " of " + std::to_string(bytes.size()));
      ScanReport report;
      const Content part = exercise(ByteView{bytes}.first(length), report);
      ASSERT_TRUE(is_prefix(part, whole));
      ASSERT_NE(report.ending, Ending::complete);
      ASSERT_GE(part.messages.size(), messages) << "a longer file yields no less";
      messages = part.messages.size();
    }
    EXPECT_EQ(messages, whole.messages.size());
  }
}

TEST(McapHostile, ATailOfZerosIsACut) {
  const Folder folder;
  const Content whole = write_file(folder / "a", 12, small_recording());
  const Bytes bytes = file_bytes(folder / "a");
  for (std::size_t length = magic.size(); length < bytes.size(); ++length) {
    Bytes zeroed = bytes;
    std::fill(zeroed.begin() + static_cast<std::ptrdiff_t>(length), zeroed.end(), std::byte{0});
    ScanReport report;
    const Content part = exercise(zeroed, report);
    ASSERT_TRUE(is_prefix(part, whole)) << length;
    ASSERT_FALSE(report.intact()) << length;
    zeroed.resize(zeroed.size() + 100'000);
    ASSERT_TRUE(is_prefix(exercise(zeroed, report), whole)) << length;
  }
}

std::uint64_t messages_of_largest_chunk(ByteView bytes) {
  std::map<std::uint64_t, std::uint64_t> messages;
  Reader reader;
  if (!reader.open(bytes).ok()) return 0;
  while (const auto record = reader.next())
    if (std::holds_alternative<Message>(*record)) ++messages[reader.extent().offset];
  std::uint64_t largest = 0;
  for (const auto& [offset, count] : messages) largest = std::max(largest, count);
  EXPECT_GT(messages.size(), 3U);
  return largest;
}

TEST(McapHostile, NoFlippedBitGoesUnnoticedAndNoneCostsMoreThanItsChunk) {
  const Folder folder;
  for (const Compression compression : compressions) {
    const auto path = folder / (std::string{"a"} + std::string{name_of(compression)}).c_str();
    WriterOptions options = small_chunks(compression);
    options.chunk_bytes = 1024;
    const Content whole = write_file(path, 13, {.records = 80, .payload_max = 8}, options);
    Bytes bytes = file_bytes(path);
    const std::uint64_t chunk_messages_max = messages_of_largest_chunk(bytes);
    // Every seventh: some bit of every byte, and every place in a byte in turn.
    for (std::size_t bit = 8 * magic.size(); bit < 8 * bytes.size(); bit += 7) {
      const auto mask = static_cast<std::byte>(1U << (bit % 8));
      bytes[bit / 8] ^= mask;
      ScanReport report;
      const Content content = exercise(bytes, report);
      ASSERT_FALSE(report.intact()) << "bit " << bit;
      for (const Entry& entry : content.messages)
        ASSERT_NE(std::find(whole.messages.begin(), whole.messages.end(), entry), whole.messages.end())
            << "bit " << bit << ": a message that was never written";
      ASSERT_GE(content.messages.size() + chunk_messages_max, whole.messages.size()) << "bit " << bit;
      exercise(bytes, report, {.keep_bad_crc = true});
      bytes[bit / 8] ^= mask;
    }
  }
}

TEST(McapHostile, ADamagedFirstChunkDoesNotTakeTheDefinitionsAlong) {
  const Folder folder;
  const Content whole = write_file(folder / "a", 15, {.records = 500, .payload_max = 60, .extras = false});
  Bytes bytes = file_bytes(folder / "a");
  IndexedReader reader;
  ASSERT_TRUE(reader.open(ByteView{bytes}).ok());
  ASSERT_GT(reader.summary().chunks.size(), 3U);
  const ChunkIndex& first = reader.summary().chunks.front();
  bytes[first.offset + first.length - 1] ^= std::byte{1};
  ScanReport report;
  const Content content = content_of(ByteView{bytes}, report);
  EXPECT_EQ(report.messages_without_channel, 0U);
  EXPECT_EQ(report.messages_dropped, whole.messages.size() - content.messages.size());
  EXPECT_TRUE(std::equal(content.messages.rbegin(), content.messages.rend(), whole.messages.rbegin()));
}

/// A file of one chunk record that says what the test wants.
Bytes file_with_chunk(std::uint64_t uncompressed_bytes, std::string_view compression, ByteView records) {
  Bytes bytes{magic.begin(), magic.end()};
  append(bytes, Header{"", "test"});
  const RecordFrame frame{bytes, Op::chunk};
  put<std::uint64_t>(bytes, 0);
  put<std::uint64_t>(bytes, 0);
  put(bytes, uncompressed_bytes);
  put<std::uint32_t>(bytes, 0);
  put_string(bytes, compression);
  put(bytes, static_cast<std::uint64_t>(records.size()));
  put_bytes(bytes, records);
  return bytes;
}

TEST(McapHostile, ALieAboutTheUncompressedSizeIsRefused) {
  for (const std::uint64_t lie : {std::uint64_t{1} << 40, ~std::uint64_t{0}, std::uint64_t{1} << 25}) {
    for (const Compression compression : compressions) {
      Compressor compressor{compression};
      Bytes packed(compressor.bound(1000));
      const Bytes content(1000);
      packed.resize(compression == Compression::none ? 0 : compressor.compress(content, packed));
      ScanReport report;
      exercise(file_with_chunk(lie, name_of(compression), packed), report);
      EXPECT_EQ(report.messages, 0U);
      EXPECT_EQ(report.chunks_undecodable + report.records_too_large, 1U) << report.text();
    }
  }
}

TEST(McapHostile, DefinitionsTogetherStayWithinALimit) {
  Bytes records;
  for (SchemaId id = 1; id <= 10; ++id) append(records, Schema{id, "a::T", "omgidl", Bytes(1 << 20)});
  ScanReport report;
  exercise(file_with_chunk(records.size(), "", records), report, {.record_bytes_max = 12 << 20});
  EXPECT_EQ(report.records_too_large, 0U);
  Compressor compressor{Compression::zstd};
  Bytes packed(compressor.bound(records.size()));
  packed.resize(compressor.compress(records, packed));
  EXPECT_LT(packed.size(), 10'000U) << "a bomb";
  exercise(file_with_chunk(records.size(), "zstd", packed), report, {.record_bytes_max = 4 << 20});
  EXPECT_EQ(report.records_too_large, 7U);
}

TEST(McapHostile, AnUnknownCompressionIsCounted) {
  ScanReport report;
  exercise(file_with_chunk(4, "bz2", {}), report);
  EXPECT_EQ(report.chunks_undecodable, 1U);
}

TEST(McapHostile, UnknownRecordsAndLongerOnesAreRead) {
  Bytes bytes{magic.begin(), magic.end()};
  append(bytes, Header{"", "test"});
  for (const int op : {0x42, 0x80, 0xff}) {
    const RecordFrame frame{bytes, static_cast<Op>(op)};
    put_string(bytes, "from the future");
  }
  const auto grown = [&bytes](auto record) {
    Bytes one;
    append(one, record);
    put_string(one, "a field that we do not know");
    store(one.data() + 1, static_cast<std::uint64_t>(one.size() - record_head_bytes));
    put_bytes(bytes, one);
  };
  grown(Schema{7, "a::T", "omgidl", bytes_of("module a { struct T { double x; }; };")});
  grown(Channel{0, 7, "t", "cdr", {}});
  grown(Metadata{"m", {{"a", "b"}}});
  append(bytes, Message{0, 1, 2, 3, {}});  // outside of a chunk, as simple writers do
  ScanReport report;
  const Content content = exercise(bytes, report);
  ASSERT_EQ(content.messages.size(), 1U);
  EXPECT_EQ(content.messages[0].topic, "t");
  EXPECT_EQ(content.metadata.at("m").at("a"), "b");
  EXPECT_EQ(report.records_malformed, 0U);
}

TEST(McapHostile, AnIdWithTwoMeaningsEndsTheScan) {
  Bytes bytes{magic.begin(), magic.end()};
  append(bytes, Channel{1, 0, "t", "cdr", {}});
  append(bytes, Message{1, 1, 1, 1, {}});
  append(bytes, Channel{1, 0, "u", "cdr", {}});
  append(bytes, Message{1, 2, 2, 2, {}});
  ScanReport report;
  EXPECT_EQ(exercise(bytes, report).messages.size(), 1U);
  EXPECT_EQ(report.ending, Ending::cut);
}

TEST(McapHostile, WhatIsNoMcapIsRefused) {
  const Folder folder;
  Reader reader;
  EXPECT_EQ(reader.open(folder / "missing").fault, Fault::system);
  EXPECT_EQ(reader.open(folder / ".").fault, Fault::refused);
  write_bytes(folder / "empty", {});
  write_bytes(folder / "text", bytes_of("this is not a recording at all"));
  for (const char* name : {"empty", "text"}) {
    EXPECT_EQ(reader.open(folder / name).fault, Fault::not_mcap);
    EXPECT_FALSE(reader.next());
    IndexedReader indexed;
    EXPECT_EQ(indexed.open(folder / name).fault, Fault::not_mcap);
  }
}

}  // namespace
}  // namespace weakgrid::mcap
