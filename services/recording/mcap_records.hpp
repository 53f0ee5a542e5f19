// The records of an MCAP file as plain structs, and their translation to and from bytes.
#pragma once

#include <optional>
#include <utility>

#include "services/recording/mcap_format.hpp"

namespace weakgrid::mcap {

using SchemaId = std::uint16_t;   ///< 1 …; 0 = no schema
using ChannelId = std::uint16_t;  ///< ours begin at 1, other writers' at 0

struct Header {
  std::string profile;
  std::string library;
};

struct Schema {
  SchemaId id = 0;
  std::string name;      ///< `a::b::Type` for omgidl, without leading ::
  std::string encoding;  ///< "omgidl" for ours
  Bytes data;            ///< for omgidl one self-contained text without preprocessor lines
  friend bool operator==(const Schema&, const Schema&) = default;
};

struct Channel {
  ChannelId id = 0;
  SchemaId schema_id = 0;
  std::string topic;
  std::string message_encoding;  ///< "cdr" for ours: the payload with its 4-byte encapsulation header
  StringMap metadata;
  friend bool operator==(const Channel&, const Channel&) = default;
};

/// The payload is a view: it holds until the reader's next call.
struct Message {
  ChannelId channel_id = 0;
  std::uint32_t sequence = 0;
  std::uint64_t log_time_ns = 0;  ///< since the Unix epoch, as the next
  std::uint64_t publish_time_ns = 0;
  ByteView data;
};

struct Metadata {
  std::string name;
  StringMap entries;
};

struct Attachment {
  std::uint64_t log_time_ns = 0;
  std::uint64_t create_time_ns = 0;  ///< 0 = not known
  std::string name;
  std::string media_type;
  Bytes data;
};

/// A chunk as it stands in the file; the views lie in the record.
struct ChunkRecord {
  std::uint64_t start_ns = 0;
  std::uint64_t end_ns = 0;
  std::uint64_t uncompressed_bytes = 0;
  std::uint32_t uncompressed_crc = 0;  ///< 0 = not checked
  std::string_view compression;
  ByteView records;
};

/// Where a chunk is. Offsets count from the start of the file.
struct ChunkIndex {
  std::uint64_t start_ns = 0;
  std::uint64_t end_ns = 0;
  std::uint64_t offset = 0;
  std::uint64_t length = 0;  ///< with opcode and length field, here and below
  std::vector<std::pair<ChannelId, std::uint64_t>> message_index_offsets;  ///< empty = not known
  std::uint64_t message_index_bytes = 0;
  std::string compression;
  std::uint64_t compressed_bytes = 0;
  std::uint64_t uncompressed_bytes = 0;
};

struct AttachmentIndex {
  std::uint64_t offset = 0;
  std::uint64_t length = 0;
  std::uint64_t log_time_ns = 0;
  std::uint64_t create_time_ns = 0;
  std::uint64_t data_bytes = 0;
  std::string name;
  std::string media_type;
};

struct MetadataIndex {
  std::uint64_t offset = 0;
  std::uint64_t length = 0;
  std::string name;
};

struct Statistics {
  std::uint64_t messages = 0;
  std::uint16_t schemas = 0;
  std::uint32_t channels = 0;
  std::uint32_t attachments = 0;
  std::uint32_t metadata = 0;
  std::uint32_t chunks = 0;
  std::uint64_t start_ns = 0;  ///< 0 and 0 where the file has no message
  std::uint64_t end_ns = 0;
  std::map<ChannelId, std::uint64_t> channel_messages;
};

struct Footer {
  std::uint64_t summary_start = 0;         ///< 0 = no summary
  std::uint64_t summary_offset_start = 0;  ///< 0 = none
  std::uint32_t summary_crc = 0;
};

/// Appends the whole record, opcode and length included.
void append(Bytes& out, const Header& header);
void append(Bytes& out, const Schema& schema);
void append(Bytes& out, const Channel& channel);
void append(Bytes& out, const Message& message);
void append(Bytes& out, const Metadata& metadata);
void append(Bytes& out, const Attachment& attachment);  ///< with its CRC
void append(Bytes& out, const ChunkIndex& index);
void append(Bytes& out, const AttachmentIndex& index);
void append(Bytes& out, const MetadataIndex& index);
void append(Bytes& out, const Statistics& statistics);

/// A record's body to its struct; nothing if the fields do not fit. Unknown bytes behind the fields are fine,
/// except where the specification rules them out (Message, Footer).
std::optional<Header> parse_header(ByteView body);
std::optional<Schema> parse_schema(
    ByteView body);  ///< also nothing for id 0, which the specification forbids
std::optional<Channel> parse_channel(ByteView body);
std::optional<Message> parse_message(ByteView body);
std::optional<Metadata> parse_metadata(ByteView body);
std::optional<Attachment> parse_attachment(ByteView body, bool& crc_holds);
std::optional<ChunkRecord> parse_chunk(ByteView body);
std::optional<ChunkIndex> parse_chunk_index(ByteView body);
std::optional<AttachmentIndex> parse_attachment_index(ByteView body);
std::optional<MetadataIndex> parse_metadata_index(ByteView body);
std::optional<Statistics> parse_statistics(ByteView body);
std::optional<Footer> parse_footer(ByteView body);

/// What a parser answers: the record if every field fitted.
template <class Record>
std::optional<Record> if_whole(const Cursor& in, Record record) {
  if (!in.ok()) return std::nullopt;
  return record;
}

}  // namespace weakgrid::mcap
