// Reads an MCAP file record by record from its start: needs no index, and takes any bytes whatsoever.
#pragma once

#include <bitset>
#include <variant>

#include "services/recording/mcap_chunk.hpp"
#include "services/recording/mcap_summary.hpp"

namespace weakgrid::mcap {

struct ReaderOptions {
  std::size_t chunk_bytes_max = 64 << 20;    ///< uncompressed; a larger chunk is skipped and counted
  std::size_t record_bytes_max = 256 << 20;  ///< in the file; likewise
  /// Yield also what decodes but does not match its CRC, and messages outside of chunks in a file that has
  /// chunks: there no CRC vouches for them, and one flipped bit makes a message of a message index.
  bool keep_bad_crc = false;
};

enum class Ending : std::uint8_t {
  running,     ///< next() has not come to the end yet
  complete,    ///< data section, summary and footer are all there
  no_summary,  ///< the data section is whole, what should follow is not
  cut,         ///< the data section stops early, or what follows cannot be framed: see offset and reason
};

/// What a scan has seen so far. Everything that was not yielded is counted here.
struct ScanReport {
  Ending ending = Ending::running;
  const char* reason = "";  ///< why it is not complete
  std::uint64_t file_bytes = 0;
  std::uint64_t offset = 0;    ///< everything before was understood
  std::uint64_t messages = 0;  ///< yielded
  std::uint64_t chunks = 0;    ///< met, the bad ones included
  std::uint64_t chunks_bad_crc = 0;
  std::uint64_t chunks_undecodable = 0;  ///< compressed bytes make no sense, or unknown compression
  std::uint64_t chunks_malformed = 0;    ///< decoded; from some record on, the content makes no sense
  std::uint64_t messages_dropped = 0;    ///< that the message indexes name and their chunks did not yield
  std::uint64_t messages_outside = 0;    ///< of the chunks: not yielded, see keep_bad_crc
  std::uint64_t messages_without_channel = 0;  ///< not yielded
  std::uint64_t resumed = 0;  ///< times that the scan lost its way and the summary knew the next chunk
  std::uint64_t records_malformed = 0;  ///< framed, but the fields do not fit: skipped
  std::uint64_t records_too_large = 0;  ///< beyond the reader's limits: skipped
  std::uint64_t attachments_bad_crc = 0;
  bool data_crc_bad = false;  ///< some byte before DataEnd is wrong; metadata have no other check
  bool summary_crc_bad = false;

  bool intact() const;       ///< complete, and nothing was dropped
  std::string text() const;  ///< one line a person reads
};

using Record = std::variant<Schema, Channel, Message, Metadata, Attachment>;

/// Bytes of the file: a record with opcode and length.
struct Extent {
  std::uint64_t offset = 0;
  std::uint64_t length = 0;
};

class Reader {
 public:
  /// Refuses only what does not begin as MCAP; all else shows in the records and the report.
  Status open(const std::string& path, const ReaderOptions& options = {});
  Status open(ByteView bytes, const ReaderOptions& options = {});  ///< `bytes` must outlive the reader

  /// The next record in file order; nothing at the end, and from then on. A schema or channel comes once,
  /// before the first message that uses it, however often the file repeats it. What a Message points to holds
  /// until the next call. A summary whose CRC holds helps out in two cases only: where the chunk that defines
  /// a channel is damaged, and where a wrong length would lead the scan astray, it knows the next chunk.
  std::optional<Record> next();

  const Header& header() const { return header_; }
  const std::map<SchemaId, Schema>& schemas() const { return schemas_; }      ///< met so far
  const std::map<ChannelId, Channel>& channels() const { return channels_; }  ///< likewise
  const ScanReport& report() const { return report_; }
  /// Where the record yielded last stands: of a message in a chunk, the chunk.
  Extent extent() const { return extent_; }
  bool in_chunk() const { return in_chunk_; }
  const ChunkIndex& chunk() const { return chunk_; }  ///< of such a message; without message index offsets

 private:
  Status begin(const ReaderOptions& options);
  std::optional<Record> next_in_chunk();
  std::optional<Record> next_in_file();
  const char* fault_of_frame(Op op, std::uint64_t length) const;
  std::optional<Record> take(Op op, ByteView body);
  std::optional<Record> take_schema(ByteView body);
  std::optional<Record> take_channel(ByteView body);
  std::optional<Record> take_message(ByteView body);
  std::optional<Record> take_attachment(ByteView body);
  std::optional<Record> define_from_summary(const Message& message);
  void open_chunk(ByteView body);
  void count_indexed(ByteView message_index);
  void settle_chunk();
  bool grant_definition(std::size_t bytes);
  bool skip_large(std::uint64_t length);
  void find_chunks();
  void lose_way(const char* reason);
  void finish_data(Op op, ByteView body);
  void finish_file();
  void stop(Ending ending, const char* reason);

  InputFile file_;
  ReaderOptions options_;
  ChunkOpener opener_;
  Cursor records_;  // what is left of the open chunk
  bool in_chunk_ = false;
  std::uint64_t met_ = 0;      // messages in the last chunk
  std::uint64_t indexed_ = 0;  // messages that the indexes behind it name
  Header header_;
  std::map<SchemaId, Schema> schemas_;
  std::map<ChannelId, Channel> channels_;
  std::size_t definition_bytes_ = 0;
  std::bitset<0x10000> channel_known_;       // asked for every message
  Summary summary_;                          // empty unless its CRC holds
  std::vector<std::uint64_t> chunks_ahead_;  // offsets by that summary, the next one at the back
  std::vector<Record> pending_;              // next() yields these first, from the back
  Extent extent_;
  ChunkIndex chunk_;
  std::uint32_t data_crc_ = 0;
  ScanReport report_;
};

}  // namespace weakgrid::mcap
