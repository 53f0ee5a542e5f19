// Reads an MCAP file by its index: what is in it without reading it all, and messages in the order of time.
#pragma once

#include <limits>

#include "services/recording/mcap_reader.hpp"
#include "services/recording/mcap_summary.hpp"

namespace weakgrid::mcap {

/// Both ends belong to it.
struct TimeRange {
  std::uint64_t from_ns = 0;
  std::uint64_t until_ns = std::numeric_limits<std::uint64_t>::max();
};

/// Messages outside of chunks are not indexed, so this reader does not see them. Reader does, and recover()
/// makes chunks of them.
class IndexedReader {
 public:
  /// A file without a usable summary is scanned once from end to end, and a summary made of what was found.
  Status open(const std::string& path, const ReaderOptions& options = {});
  Status open(ByteView bytes, const ReaderOptions& options = {});  ///< `bytes` must outlive the reader

  const Summary& summary() const { return summary_; }
  /// By the index; nothing if that is not what stands there, or its CRC is wrong.
  std::optional<Metadata> metadata(const MetadataIndex& index);
  std::optional<Attachment> attachment(const AttachmentIndex& index);

  /// From here on next() yields these; no channels = all. Before the first call: everything.
  void select(TimeRange range, const std::vector<ChannelId>& channels = {});
  /// The next message by log time; of equal times, in the order of the file. Holds until the next call. The
  /// time ranges that the index gives for chunks are believed.
  std::optional<Message> next();
  std::uint64_t chunks_skipped() const { return chunks_skipped_; }  ///< damaged, since select()
  /// too_large if next() ended early because too many chunks overlap in time for `chunk_bytes_max` × 4.
  const Status& status() const { return status_; }

 private:
  struct Place {
    std::uint64_t log_time_ns;
    std::size_t offset;  // of the message's body in the chunk
    std::size_t length;
  };
  struct OpenChunk {
    std::unique_ptr<std::byte[]> records;
    std::size_t bytes = 0;
    std::uint64_t offset = 0;   // in the file: decides between equal times
    std::vector<Place> places;  // in order of time
    std::size_t next = 0;
    std::size_t memory() const { return bytes + places.capacity() * sizeof(Place); }
  };

  Status begin(const ReaderOptions& options);
  void rebuild(Reader& reader);
  ByteView body_at(std::uint64_t offset, Op op);
  bool wanted(const ChunkIndex& chunk) const;
  bool wanted(const Message& message) const;
  void open_chunk(const ChunkIndex& chunk);
  std::vector<Place> places_of(ByteView records);
  void open_overlapping();

  InputFile file_;
  ReaderOptions options_;
  Summary summary_;
  ChunkOpener opener_;
  TimeRange range_;
  std::bitset<0x10000> channels_wanted_;
  std::vector<std::size_t> order_;  // of summary_.chunks, by start
  std::size_t next_chunk_ = 0;      // in order_
  std::vector<OpenChunk> open_;     // a heap: the one with the earliest message in front
  OpenChunk spent_;                 // of the message yielded last
  std::size_t open_bytes_ = 0;
  std::uint64_t chunks_skipped_ = 0;
  Status status_;
};

}  // namespace weakgrid::mcap
