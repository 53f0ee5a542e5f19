// Writes an MCAP recording: compressed chunks with message indexes, metadata, attachments, and at the end a
// summary. No clock and no thread of its own: the caller says when. Not thread-safe.
#pragma once

#include <optional>

#include "services/recording/mcap_chunk.hpp"
#include "services/recording/mcap_file.hpp"

namespace weakgrid::mcap {

struct WriterOptions {
  std::string version;  ///< of this software, into the header: "weakgrid <version>"
  std::string profile;  ///< "" unless a file with another is rewritten
  Compression compression = Compression::zstd;
  std::size_t chunk_bytes = 256 << 10;  ///< 1 KiB … 16 MiB; a chunk is closed before it would exceed this
  std::int64_t chunk_age_ns = 250'000'000;  ///< what flush_if_older() lets a chunk reach
};

struct WriterCounters {
  std::uint64_t messages = 0;            ///< in the file
  std::uint64_t messages_lost = 0;       ///< accepted, but their chunk could not be written
  std::uint64_t uncompressed_bytes = 0;  ///< of the chunks in the file
  std::uint64_t compressed_bytes = 0;
  std::uint32_t chunks = 0;
};

/// Largest message, schema, attachment and so on. What is larger is refused, so that our reader reads what we
/// wrote.
inline constexpr std::size_t record_bytes_max = 16 << 20;

/// What fails is not written, and the file is as if it had never been tried: it stays readable up to there,
/// and a later call may succeed again when there is space again. Losses are counted, the first fault is kept.
class Writer {
 public:
  Writer() = default;
  ~Writer();  ///< closes; whoever wants to know how that went calls close()
  Writer(const Writer&) = delete;
  Writer& operator=(const Writer&) = delete;

  /// Creates the file, never overwrites one. Schemas and channels outlive close(): a file opened next
  /// (rotation) uses the same ids and repeats the definitions.
  Status open(const std::string& path, const WriterOptions& options);
  /// Writes the open chunk, the summary and the footer, syncs and closes. The summary is tried even after
  /// losses; the status is the first fault of closing.
  Status close();
  bool is_open() const { return file_.is_open(); }

  /// New ids 1, 2, …; 0 = refused: too large, unknown schema, or no id left. Both reach the file with the
  /// first message that needs them. `schema` 0 = none.
  [[nodiscard]] SchemaId add_schema(std::string_view name, std::string_view encoding, std::string_view text);
  [[nodiscard]] ChannelId add_channel(SchemaId schema, std::string_view topic,
                                      std::string_view message_encoding, const StringMap& metadata);

  /// Allocates nothing while messages fit the chunk. The message is taken unless the status is closed or
  /// refused; any other fault is that of the chunk before, which had to be written to make room.
  Status write_message(ChannelId channel, std::uint32_t sequence, std::uint64_t log_time_ns,
                       std::uint64_t publish_time_ns, ByteView data);
  /// These two close the open chunk first. Manifest and settings belong at the start: a crash takes the end.
  Status write_metadata(std::string_view name, const StringMap& entries);
  Status write_attachment(const Attachment& attachment);

  Status flush();  ///< closes the open chunk, if there is one: what is flushed survives kill -9
  /// flush() once the open chunk is older than the option says. `now_ns` is from any steady clock; the age
  /// counts from the first call that sees the chunk, so call this several times within the age.
  Status flush_if_older(std::int64_t now_ns);
  /// What is synced survives a power cut. Blocks, so about once a second and in no DDS callback.
  Status sync() { return file_.sync(); }

  const WriterCounters& counters() const { return counters_; }
  const Status& first_fault() const { return first_fault_; }  ///< of this file
  /// Of the file if it were flushed now, at most; for rotation by size.
  std::uint64_t file_bytes() const { return file_.size() + chunk_.size(); }

 private:
  enum class Place : std::uint8_t { nowhere, open_chunk, file };
  struct Definition {
    Bytes record;  // encoded once, repeated in each file's first chunk that needs it and in its summary
    SchemaId schema = 0;
    Place place = Place::nowhere;
    std::uint64_t messages = 0;
  };

  Status append(ByteView bytes);
  Status remember(const Status& status);
  std::size_t announcement_bytes(const Definition& channel) const;
  void announce(Definition& channel);
  void settle_chunk(bool written);
  Bytes encode_end() const;
  Statistics statistics() const;

  OutputFile file_;
  WriterOptions options_;
  ChunkBuilder chunk_;
  Bytes out_;
  ChunkIndex index_;
  std::vector<Definition> schemas_;   // id - 1
  std::vector<Definition> channels_;  // id - 1
  Bytes chunk_indexes_;               // encoded for the summary, as the next two
  Bytes attachment_indexes_;
  Bytes metadata_indexes_;
  std::uint32_t attachments_ = 0;
  std::uint32_t metadata_ = 0;
  std::uint64_t start_ns_ = 0;
  std::uint64_t end_ns_ = 0;
  std::uint32_t data_crc_ = 0;
  std::optional<std::int64_t> chunk_seen_ns_;
  WriterCounters counters_;
  Status first_fault_;
};

}  // namespace weakgrid::mcap
