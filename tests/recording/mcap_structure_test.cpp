// The bytes of our files against the specification, read here by nothing but a cursor.
#include "tests/recording/recording_support.hpp"

namespace weakgrid::mcap {
namespace {

struct Framed {
  Op op;
  std::uint64_t offset;
  ByteView whole;
  ByteView body;
};

std::vector<Framed> frames(ByteView bytes, std::uint64_t from, std::uint64_t until) {
  std::vector<Framed> list;
  for (std::uint64_t at = from; at < until;) {
    const auto length = load<std::uint64_t>(bytes.data() + at + 1);
    const ByteView whole = bytes.subspan(at, record_head_bytes + length);
    list.push_back(
        {static_cast<Op>(load<std::uint8_t>(whole.data())), at, whole, whole.subspan(record_head_bytes)});
    at += whole.size();
  }
  return list;
}

/// The records in a chunk, uncompressed, with what its head claims checked.
Bytes checked_chunk(const ChunkRecord& chunk) {
  Bytes records(chunk.uncompressed_bytes);
  Decompressor decompressor;
  EXPECT_TRUE(decompressor.decompress(*compression_named(chunk.compression), chunk.records, records));
  EXPECT_EQ(chunk.uncompressed_crc, crc32(records));
  std::uint64_t start_ns = ~std::uint64_t{0}, end_ns = 0;
  for (const Framed& record : frames(records, 0, records.size())) {
    if (record.op != Op::message) continue;
    const auto message = parse_message(record.body);
    start_ns = std::min(start_ns, message->log_time_ns);
    end_ns = std::max(end_ns, message->log_time_ns);
  }
  EXPECT_EQ(chunk.start_ns, start_ns);
  EXPECT_EQ(chunk.end_ns, end_ns);
  return records;
}

/// Every message of the chunk is in exactly one index, of its channel, in file order.
void check_message_indexes(ByteView records, const std::vector<Framed>& indexes) {
  std::map<ChannelId, std::vector<std::pair<std::uint64_t, std::uint64_t>>> expected, found;
  for (const Framed& record : frames(records, 0, records.size())) {
    if (record.op != Op::message) continue;
    const auto message = parse_message(record.body);
    expected[message->channel_id].emplace_back(message->log_time_ns, record.offset);
  }
  for (const Framed& index : indexes) {
    Cursor in{index.body};
    const auto channel = in.take<std::uint16_t>();
    EXPECT_FALSE(found.contains(channel)) << "one index for each channel";
    Cursor entries = in.take_prefixed();
    while (entries.left() > 0) {
      const auto time_ns = entries.take<std::uint64_t>();
      found[channel].emplace_back(time_ns, entries.take<std::uint64_t>());
    }
    EXPECT_EQ(in.left(), 0U);
  }
  EXPECT_EQ(found, expected);
}

class McapStructure : public testing::TestWithParam<Compression> {
 protected:
  void SetUp() override {
    const auto path = folder_ / "a.mcap";
    content_ = write_file(path, 31, {.records = 600}, small_chunks(GetParam()));
    bytes_ = file_bytes(path);
    view_ = bytes_;
    const ByteView end = view_.last(magic.size() + record_head_bytes + footer_bytes);
    footer_ = *parse_footer(end.subspan(record_head_bytes, footer_bytes));
  }

  Folder folder_;
  Content content_;
  Bytes bytes_;
  ByteView view_;
  Footer footer_;
};

TEST_P(McapStructure, MagicStandsAtBothEndsAndTheHeaderFirst) {
  EXPECT_TRUE(std::equal(magic.begin(), magic.end(), bytes_.begin()));
  EXPECT_TRUE(
      std::equal(magic.begin(), magic.end(), bytes_.end() - static_cast<std::ptrdiff_t>(magic.size())));
  const auto records = frames(view_, magic.size(), footer_.summary_start);
  ASSERT_EQ(records.front().op, Op::header);
  const auto header = parse_header(records.front().body);
  EXPECT_EQ(header->profile, "");
  EXPECT_EQ(header->library, "weakgrid test");
  EXPECT_EQ(records.back().op, Op::data_end);
}

TEST_P(McapStructure, EachChunkIsFollowedByItsMessageIndexes) {
  const auto records = frames(view_, magic.size(), footer_.summary_start);
  std::uint64_t messages = 0;
  for (std::size_t k = 0; k < records.size(); ++k) {
    ASSERT_NE(records[k].op, Op::message) << "messages live in chunks only";
    if (records[k].op != Op::chunk) continue;
    const auto chunk = parse_chunk(records[k].body);
    ASSERT_TRUE(chunk);
    const Bytes inside = checked_chunk(*chunk);
    std::vector<Framed> indexes;
    while (records[k + 1].op == Op::message_index) indexes.push_back(records[++k]);
    check_message_indexes(inside, indexes);
    for (const Framed& record : frames(inside, 0, inside.size())) messages += record.op == Op::message;
  }
  EXPECT_EQ(messages, content_.messages.size());
}

TEST_P(McapStructure, TheCrcsAreThose) {
  const auto records = frames(view_, magic.size(), footer_.summary_start);
  const auto stored = load<std::uint32_t>(records.back().body.data());
  EXPECT_EQ(stored, crc32(view_.first(records.back().offset)));
  const std::size_t summary_crc_at = bytes_.size() - magic.size() - 4;
  EXPECT_EQ(footer_.summary_crc,
            crc32(view_.subspan(footer_.summary_start, summary_crc_at - footer_.summary_start)));
  EXPECT_NE(stored, 0U);
}

TEST_P(McapStructure, TheSummaryIsGroupedAndItsOffsetsHold) {
  const std::uint64_t footer_at = bytes_.size() - magic.size() - footer_bytes - record_head_bytes;
  std::map<Op, std::pair<std::uint64_t, std::uint64_t>> groups, offsets;
  std::vector<Op> sequence;
  for (const Framed& record : frames(view_, footer_.summary_start, footer_.summary_offset_start)) {
    if (sequence.empty() || sequence.back() != record.op) {
      EXPECT_FALSE(groups.contains(record.op)) << "records of an opcode stand together";
      sequence.push_back(record.op);
      groups[record.op] = {record.offset, 0};
    }
    groups[record.op].second += record.whole.size();
  }
  for (const Framed& record : frames(view_, footer_.summary_offset_start, footer_at)) {
    ASSERT_EQ(record.op, Op::summary_offset);
    Cursor in{record.body};
    const auto op = static_cast<Op>(in.take<std::uint8_t>());
    const auto start = in.take<std::uint64_t>();
    offsets[op] = {start, in.take<std::uint64_t>()};
  }
  EXPECT_EQ(groups, offsets);
  EXPECT_EQ(groups.size(), 6U) << "schemas, channels, statistics, chunk, attachment and metadata indexes";
}

TEST_P(McapStructure, IndexesPointAtWhatTheySay) {
  const auto data = frames(view_, magic.size(), footer_.summary_start);
  const auto at = [&](std::uint64_t offset) {
    const auto found =
        std::find_if(data.begin(), data.end(), [&](const Framed& f) { return f.offset == offset; });
    EXPECT_NE(found, data.end());
    return *found;
  };
  std::size_t chunks = 0;
  for (const Framed& record : frames(view_, footer_.summary_start, footer_.summary_offset_start)) {
    if (record.op == Op::chunk_index) {
      const auto index = parse_chunk_index(record.body);
      const Framed chunk = at(index->offset);
      EXPECT_EQ(chunk.op, Op::chunk);
      EXPECT_EQ(chunk.whole.size(), index->length);
      const auto head = parse_chunk(chunk.body);
      EXPECT_EQ(head->compression, index->compression);
      EXPECT_EQ(head->records.size(), index->compressed_bytes);
      EXPECT_EQ(head->uncompressed_bytes, index->uncompressed_bytes);
      std::uint64_t length = 0;
      for (const auto& [channel, offset] : index->message_index_offsets) {
        const Framed message_index = at(offset);
        EXPECT_EQ(message_index.op, Op::message_index);
        EXPECT_EQ(load<std::uint16_t>(message_index.body.data()), channel);
        length += message_index.whole.size();
      }
      EXPECT_EQ(length, index->message_index_bytes);
      ++chunks;
    } else if (record.op == Op::metadata_index) {
      const auto index = parse_metadata_index(record.body);
      EXPECT_EQ(parse_metadata(at(index->offset).body)->name, index->name);
      EXPECT_EQ(at(index->offset).whole.size(), index->length);
    } else if (record.op == Op::attachment_index) {
      const auto index = parse_attachment_index(record.body);
      bool crc_holds = false;
      EXPECT_EQ(parse_attachment(at(index->offset).body, crc_holds)->name, index->name);
      EXPECT_TRUE(crc_holds);
      EXPECT_EQ(at(index->offset).whole.size(), index->length);
    }
  }
  EXPECT_GT(chunks, 10U);
}

std::string test_name(const testing::TestParamInfo<Compression>& tested) {
  return tested.param == Compression::none ? "none" : std::string{name_of(tested.param)};
}
INSTANTIATE_TEST_SUITE_P(AllCompressions, McapStructure, testing::ValuesIn(compressions), test_name);

}  // namespace
}  // namespace weakgrid::mcap
