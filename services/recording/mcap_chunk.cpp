// Chunks: filling, encoding with their message indexes, and opening from hostile bytes.
#include "services/recording/mcap_chunk.hpp"

#include <algorithm>

namespace weakgrid::mcap {

namespace {

constexpr std::size_t chunk_head_bytes = 8 + 8 + 8 + 4 + (4 + 4) + 8;  // at most: the longest name is "zstd"
constexpr std::size_t index_entry_bytes = 8 + 8;
constexpr std::size_t index_head_bytes = record_head_bytes + 2 + 4;

// Below this a chunk is stored as it is: opening it then costs nothing.
constexpr std::size_t saving_percent_min = 2;

}  // namespace

void ChunkBuilder::prepare(std::size_t chunk_bytes, Compression compression) {
  if (compression != compressor_.compression()) compressor_ = Compressor{compression};
  clear();
  records_.reserve(chunk_bytes);
  places_.reserve(chunk_bytes / (record_head_bytes + message_head_bytes) + 1);
  // The first compression is the one that allocates: let it be now.
  records_.resize(chunk_bytes);
  Bytes packed(compressor_.bound(chunk_bytes));
  compressor_.compress(records_, packed);
  clear();
}

void ChunkBuilder::allow_channel(ChannelId id) {
  if (messages_of_.size() > id) return;
  messages_of_.resize(id + std::size_t{1});
  cursor_of_.resize(id + std::size_t{1});
}

void ChunkBuilder::add(const Message& message) {
  const std::uint64_t time_ns = message.log_time_ns;
  start_ns_ = empty() ? time_ns : std::min(start_ns_, time_ns);
  end_ns_ = empty() ? time_ns : std::max(end_ns_, time_ns);
  places_.push_back({time_ns, records_.size(), message.channel_id});
  ++messages_of_[message.channel_id];
  append(records_, message);
}

void ChunkBuilder::encode(std::uint64_t offset, Bytes& out, ChunkIndex& index) {
  const std::size_t out_begin = out.size();
  // For the largest chunk at once: neither a reallocation later, nor one between compressing and indexing.
  const std::size_t largest = records_.capacity();
  out.reserve(out_begin + record_head_bytes + chunk_head_bytes +
              std::max(compressor_.bound(largest), largest) + messages_of_.size() * index_head_bytes +
              places_.capacity() * index_entry_bytes);
  index.offset = offset;
  index.start_ns = start_ns_;
  index.end_ns = end_ns_;
  put_records(out, index);
  index.length = out.size() - out_begin;
  put_message_indexes(out, out_begin, index);
  index.message_index_bytes = out.size() - out_begin - index.length;
}

void ChunkBuilder::put_records(Bytes& out, ChunkIndex& index) {
  const RecordFrame frame{out, Op::chunk};
  put(out, start_ns_);
  put(out, end_ns_);
  put(out, static_cast<std::uint64_t>(records_.size()));
  put(out, crc32(records_));

  const std::size_t head = out.size();
  const auto name = name_of(compressor_.compression());
  put_string(out, name);
  put<std::uint64_t>(out, 0);
  const std::size_t body = out.size();
  const std::size_t room = compressor_.bound(records_.size());
  std::size_t packed = compressor_.compress(records_, {extend(out, room), room});
  index.compression = name;
  if (packed == 0 || packed * 100 > records_.size() * (100 - saving_percent_min)) {
    out.resize(head);
    put_string(out, "");
    put(out, static_cast<std::uint64_t>(records_.size()));
    put_bytes(out, records_);
    packed = records_.size();
    index.compression.clear();
  } else {
    out.resize(body + packed);
    store(out.data() + body - sizeof(std::uint64_t), static_cast<std::uint64_t>(packed));
  }
  index.compressed_bytes = packed;
  index.uncompressed_bytes = records_.size();
}

void ChunkBuilder::put_message_indexes(Bytes& out, std::size_t out_begin, ChunkIndex& index) {
  index.message_index_offsets.clear();
  for (std::size_t id = 0; id < messages_of_.size(); ++id) {
    if (messages_of_[id] == 0) continue;
    const auto channel = static_cast<ChannelId>(id);
    index.message_index_offsets.emplace_back(channel, index.offset + out.size() - out_begin);
    const RecordFrame frame{out, Op::message_index};
    put(out, channel);
    const LengthPrefix length{out};
    cursor_of_[id] = out.size();
    extend(out, messages_of_[id] * index_entry_bytes);
  }
  for (const Place& place : places_) {
    std::byte* entry = out.data() + cursor_of_[place.channel];
    store(entry, place.log_time_ns);
    store(entry + 8, place.offset);
    cursor_of_[place.channel] += index_entry_bytes;
  }
}

void ChunkBuilder::clear() {
  records_.clear();
  places_.clear();
  std::fill(messages_of_.begin(), messages_of_.end(), 0U);
}

ChunkState ChunkOpener::open(ByteView body) {
  size_ = 0;
  const auto chunk = parse_chunk(body);
  if (!chunk) return ChunkState::undecodable;
  head_ = *chunk;
  const auto compression = compression_named(chunk->compression);
  if (!compression) return ChunkState::undecodable;
  compression_ = *compression;
  if (chunk->uncompressed_bytes == 0) return ChunkState::good;
  if (!Decompressor::plausible(compression_, chunk->records, chunk->uncompressed_bytes))
    return ChunkState::undecodable;
  if (chunk->uncompressed_bytes > limit_) return ChunkState::too_large;

  const auto size = static_cast<std::size_t>(chunk->uncompressed_bytes);
  if (size > capacity_) {
    buffer_.reset(
        new std::byte[size]);  // uninitialised: a lie about the size costs address space, not memory
    capacity_ = size;
  }
  if (!decompressor_.decompress(compression_, chunk->records, {buffer_.get(), size}))
    return ChunkState::undecodable;
  size_ = size;
  const bool crc_holds = chunk->uncompressed_crc == 0 || chunk->uncompressed_crc == crc32(records());
  return crc_holds ? ChunkState::good : ChunkState::bad_crc;
}

std::unique_ptr<std::byte[]> ChunkOpener::release() {
  capacity_ = 0;
  size_ = 0;
  return std::move(buffer_);
}

}  // namespace weakgrid::mcap
