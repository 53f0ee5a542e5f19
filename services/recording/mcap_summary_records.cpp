// The small records of the summary (attachment, metadata index, statistics, footer) to bytes and back.
#include "services/recording/mcap_records.hpp"

namespace weakgrid::mcap {

namespace {

using std::uint16_t, std::uint32_t, std::uint64_t;

}  // namespace

void append(Bytes& out, const AttachmentIndex& index) {
  const RecordFrame frame{out, Op::attachment_index};
  put(out, index.offset);
  put(out, index.length);
  put(out, index.log_time_ns);
  put(out, index.create_time_ns);
  put(out, index.data_bytes);
  put_string(out, index.name);
  put_string(out, index.media_type);
}

std::optional<AttachmentIndex> parse_attachment_index(ByteView body) {
  Cursor in{body};
  AttachmentIndex index;
  index.offset = in.take<uint64_t>();
  index.length = in.take<uint64_t>();
  index.log_time_ns = in.take<uint64_t>();
  index.create_time_ns = in.take<uint64_t>();
  index.data_bytes = in.take<uint64_t>();
  index.name = in.take_string();
  index.media_type = in.take_string();
  return if_whole(in, std::move(index));
}

void append(Bytes& out, const MetadataIndex& index) {
  const RecordFrame frame{out, Op::metadata_index};
  put(out, index.offset);
  put(out, index.length);
  put_string(out, index.name);
}

std::optional<MetadataIndex> parse_metadata_index(ByteView body) {
  Cursor in{body};
  MetadataIndex index;
  index.offset = in.take<uint64_t>();
  index.length = in.take<uint64_t>();
  index.name = in.take_string();
  return if_whole(in, std::move(index));
}

void append(Bytes& out, const Statistics& statistics) {
  const RecordFrame frame{out, Op::statistics};
  put(out, statistics.messages);
  put(out, statistics.schemas);
  put(out, statistics.channels);
  put(out, statistics.attachments);
  put(out, statistics.metadata);
  put(out, statistics.chunks);
  put(out, statistics.start_ns);
  put(out, statistics.end_ns);
  const LengthPrefix length{out};
  for (const auto& [channel, messages] : statistics.channel_messages) {
    put(out, channel);
    put(out, messages);
  }
}

std::optional<Statistics> parse_statistics(ByteView body) {
  Cursor in{body};
  Statistics statistics;
  statistics.messages = in.take<uint64_t>();
  statistics.schemas = in.take<uint16_t>();
  statistics.channels = in.take<uint32_t>();
  statistics.attachments = in.take<uint32_t>();
  statistics.metadata = in.take<uint32_t>();
  statistics.chunks = in.take<uint32_t>();
  statistics.start_ns = in.take<uint64_t>();
  statistics.end_ns = in.take<uint64_t>();
  Cursor counts = in.take_prefixed();
  while (counts.ok() && counts.left() > 0) {
    const auto channel = counts.take<uint16_t>();
    const auto messages = counts.take<uint64_t>();
    if (counts.ok()) statistics.channel_messages.emplace(channel, messages);
  }
  if (!counts.ok()) in.fail();
  return if_whole(in, std::move(statistics));
}

std::optional<Footer> parse_footer(ByteView body) {
  if (body.size() != footer_bytes) return std::nullopt;
  return Footer{.summary_start = load<uint64_t>(body.data()),
                .summary_offset_start = load<uint64_t>(body.data() + 8),
                .summary_crc = load<uint32_t>(body.data() + 16)};
}

}  // namespace weakgrid::mcap
