// A chunk, the unit of compression and of loss: how one is filled and encoded, and how one is opened again.
#pragma once

#include <memory>

#include "services/recording/mcap_codec.hpp"
#include "services/recording/mcap_records.hpp"

namespace weakgrid::mcap {

/// Collects records, then encodes the Chunk and, directly behind it, its Message Indexes. Fixed buffers: as
/// long as size() stays within the bytes announced, nothing is allocated after prepare().
class ChunkBuilder {
 public:
  void prepare(std::size_t chunk_bytes, Compression compression);

  /// Of messages: a chunk is begun by the first of them, schemas and channels alone make none.
  bool empty() const { return places_.empty(); }
  std::size_t size() const { return records_.size(); }
  /// Messages by channel id; shorter than the ids in use where the rest have none.
  const std::vector<std::uint32_t>& messages_of() const { return messages_of_; }
  std::uint64_t messages() const { return places_.size(); }

  void allow_channel(ChannelId id);  ///< before the first message of that channel
  void add_definition(ByteView record) { put_bytes(records_, record); }
  void add(const Message& message);
  /// Appends to `out`, which will stand at `offset` of the file, and describes it in `index`.
  void encode(std::uint64_t offset, Bytes& out, ChunkIndex& index);
  void clear();

 private:
  struct Place {
    std::uint64_t log_time_ns;
    std::uint64_t offset;
    ChannelId channel;
  };
  void put_records(Bytes& out, ChunkIndex& index);
  void put_message_indexes(Bytes& out, std::size_t out_begin, ChunkIndex& index);

  Compressor compressor_;
  Bytes records_;
  std::vector<Place> places_;
  std::vector<std::uint32_t> messages_of_;
  std::vector<std::size_t> cursor_of_;  // where in `out` the next entry of a channel goes
  std::uint64_t start_ns_ = 0;
  std::uint64_t end_ns_ = 0;
};

enum class ChunkState : std::uint8_t { good, bad_crc, undecodable, too_large };

/// Opens chunks from hostile bytes into a buffer of its own.
class ChunkOpener {
 public:
  explicit ChunkOpener(std::size_t uncompressed_bytes_max = 0) : limit_{uncompressed_bytes_max} {}

  /// `body` is the record without opcode and length. records() holds for good and bad_crc.
  ChunkState open(ByteView body);
  ByteView records() const { return {buffer_.get(), size_}; }
  /// Of the last chunk, as it says of itself.
  const ChunkRecord& head() const { return head_; }
  Compression compression() const { return compression_; }
  /// The buffer with its records leaves; the next open() gets a new one.
  std::unique_ptr<std::byte[]> release();

 private:
  Decompressor decompressor_;
  std::size_t limit_;
  ChunkRecord head_;
  Compression compression_ = Compression::none;
  std::unique_ptr<std::byte[]> buffer_;
  std::size_t capacity_ = 0;
  std::size_t size_ = 0;
};

}  // namespace weakgrid::mcap
