// MCAP records to bytes and back. Field order is the specification's.
#include "services/recording/mcap_records.hpp"

#include "services/recording/mcap_codec.hpp"

namespace weakgrid::mcap {

namespace {

using std::uint16_t, std::uint32_t, std::uint64_t;

void put_map(Bytes& out, const StringMap& map) {
  const LengthPrefix length{out};
  for (const auto& [key, value] : map) {
    put_string(out, key);
    put_string(out, value);
  }
}

/// Of a key that stands there twice the first counts; the specification leaves it open.
StringMap take_map(Cursor& in) {
  StringMap map;
  Cursor entries = in.take_prefixed();
  while (entries.ok() && entries.left() > 0) {
    std::string key{entries.take_string()};
    std::string value{entries.take_string()};
    if (entries.ok()) map.emplace(std::move(key), std::move(value));
  }
  if (!entries.ok()) in.fail();
  return map;
}

Bytes copy(ByteView bytes) { return {bytes.begin(), bytes.end()}; }

}  // namespace

void append(Bytes& out, const Header& header) {
  const RecordFrame frame{out, Op::header};
  put_string(out, header.profile);
  put_string(out, header.library);
}

std::optional<Header> parse_header(ByteView body) {
  Cursor in{body};
  Header header;
  header.profile = in.take_string();
  header.library = in.take_string();
  return if_whole(in, std::move(header));
}

void append(Bytes& out, const Schema& schema) {
  const RecordFrame frame{out, Op::schema};
  put(out, schema.id);
  put_string(out, schema.name);
  put_string(out, schema.encoding);
  put(out, static_cast<uint32_t>(schema.data.size()));
  put_bytes(out, schema.data);
}

std::optional<Schema> parse_schema(ByteView body) {
  Cursor in{body};
  Schema schema;
  schema.id = in.take<uint16_t>();
  schema.name = in.take_string();
  schema.encoding = in.take_string();
  schema.data = copy(in.take_bytes(in.take<uint32_t>()));
  if (schema.id == 0) in.fail();
  return if_whole(in, std::move(schema));
}

void append(Bytes& out, const Channel& channel) {
  const RecordFrame frame{out, Op::channel};
  put(out, channel.id);
  put(out, channel.schema_id);
  put_string(out, channel.topic);
  put_string(out, channel.message_encoding);
  put_map(out, channel.metadata);
}

std::optional<Channel> parse_channel(ByteView body) {
  Cursor in{body};
  Channel channel;
  channel.id = in.take<uint16_t>();
  channel.schema_id = in.take<uint16_t>();
  channel.topic = in.take_string();
  channel.message_encoding = in.take_string();
  channel.metadata = take_map(in);
  return if_whole(in, std::move(channel));
}

void append(Bytes& out, const Message& message) {
  std::byte* at = extend(out, record_head_bytes + message_head_bytes);
  store(at, static_cast<std::uint8_t>(Op::message));
  store(at + 1, static_cast<uint64_t>(message_head_bytes + message.data.size()));
  store(at + 9, message.channel_id);
  store(at + 11, message.sequence);
  store(at + 15, message.log_time_ns);
  store(at + 23, message.publish_time_ns);
  put_bytes(out, message.data);
}

std::optional<Message> parse_message(ByteView body) {
  if (body.size() < message_head_bytes) return std::nullopt;
  const std::byte* at = body.data();
  return Message{.channel_id = load<uint16_t>(at),
                 .sequence = load<uint32_t>(at + 2),
                 .log_time_ns = load<uint64_t>(at + 6),
                 .publish_time_ns = load<uint64_t>(at + 14),
                 .data = body.subspan(message_head_bytes)};
}

void append(Bytes& out, const Metadata& metadata) {
  const RecordFrame frame{out, Op::metadata};
  put_string(out, metadata.name);
  put_map(out, metadata.entries);
}

std::optional<Metadata> parse_metadata(ByteView body) {
  Cursor in{body};
  Metadata metadata;
  metadata.name = in.take_string();
  metadata.entries = take_map(in);
  return if_whole(in, std::move(metadata));
}

void append(Bytes& out, const Attachment& attachment) {
  const RecordFrame frame{out, Op::attachment};
  const std::size_t body = out.size();
  put(out, attachment.log_time_ns);
  put(out, attachment.create_time_ns);
  put_string(out, attachment.name);
  put_string(out, attachment.media_type);
  put(out, static_cast<uint64_t>(attachment.data.size()));
  put_bytes(out, attachment.data);
  put(out, crc32(ByteView{out}.subspan(body)));
}

std::optional<Attachment> parse_attachment(ByteView body, bool& crc_holds) {
  Cursor in{body};
  Attachment attachment;
  attachment.log_time_ns = in.take<uint64_t>();
  attachment.create_time_ns = in.take<uint64_t>();
  attachment.name = in.take_string();
  attachment.media_type = in.take_string();
  attachment.data = copy(in.take_bytes(in.take<uint64_t>()));
  const std::size_t before_crc = body.size() - in.left();
  const auto crc = in.take<uint32_t>();
  crc_holds = in.ok() && (crc == 0 || crc == crc32(body.first(before_crc)));
  return if_whole(in, std::move(attachment));
}

std::optional<ChunkRecord> parse_chunk(ByteView body) {
  Cursor in{body};
  ChunkRecord chunk;
  chunk.start_ns = in.take<uint64_t>();
  chunk.end_ns = in.take<uint64_t>();
  chunk.uncompressed_bytes = in.take<uint64_t>();
  chunk.uncompressed_crc = in.take<uint32_t>();
  chunk.compression = in.take_string();
  chunk.records = in.take_bytes(in.take<uint64_t>());
  return if_whole(in, chunk);
}

void append(Bytes& out, const ChunkIndex& index) {
  const RecordFrame frame{out, Op::chunk_index};
  put(out, index.start_ns);
  put(out, index.end_ns);
  put(out, index.offset);
  put(out, index.length);
  {
    const LengthPrefix length{out};
    for (const auto& [channel, offset] : index.message_index_offsets) {
      put(out, channel);
      put(out, offset);
    }
  }
  put(out, index.message_index_bytes);
  put_string(out, index.compression);
  put(out, index.compressed_bytes);
  put(out, index.uncompressed_bytes);
}

std::optional<ChunkIndex> parse_chunk_index(ByteView body) {
  Cursor in{body};
  ChunkIndex index;
  index.start_ns = in.take<uint64_t>();
  index.end_ns = in.take<uint64_t>();
  index.offset = in.take<uint64_t>();
  index.length = in.take<uint64_t>();
  Cursor offsets = in.take_prefixed();
  while (offsets.ok() && offsets.left() > 0) {
    const auto channel = offsets.take<uint16_t>();
    const auto offset = offsets.take<uint64_t>();
    if (offsets.ok()) index.message_index_offsets.emplace_back(channel, offset);
  }
  index.message_index_bytes = in.take<uint64_t>();
  index.compression = in.take_string();
  index.compressed_bytes = in.take<uint64_t>();
  index.uncompressed_bytes = in.take<uint64_t>();
  if (!offsets.ok()) in.fail();
  return if_whole(in, std::move(index));
}

}  // namespace weakgrid::mcap
