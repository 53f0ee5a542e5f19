// The sequential MCAP reader. Every length is compared with the bytes there are before anything is done with
// it.
#include "services/recording/mcap_reader.hpp"

#include <algorithm>

namespace weakgrid::mcap {

Status Reader::open(const std::string& path, const ReaderOptions& options) {
  if (const Status status = file_.open(path); !status.ok()) return status;
  return begin(options);
}

Status Reader::open(ByteView bytes, const ReaderOptions& options) {
  file_.open(bytes);
  return begin(options);
}

Status Reader::begin(const ReaderOptions& options) {
  options_ = options;
  opener_ = ChunkOpener{options.chunk_bytes_max};
  records_ = Cursor{};
  in_chunk_ = false;
  met_ = indexed_ = 0;
  definition_bytes_ = 0;
  header_ = {};
  schemas_.clear();
  channels_.clear();
  channel_known_.reset();
  pending_.clear();
  extent_ = {};
  report_ = {};
  report_.file_bytes = file_.size();
  const ByteView begin = file_.view(0, magic.size());
  if (!std::equal(begin.begin(), begin.end(), magic.begin(), magic.end())) {
    stop(Ending::cut, "not an MCAP file");
    return {Fault::not_mcap, 0, "not an MCAP file"};
  }
  data_crc_ = crc32(begin);
  report_.offset = magic.size();
  if (!read_summary(file_, options.record_bytes_max, summary_).ok() || !summary_.crc_checked) summary_ = {};
  find_chunks();
  return {};
}

std::optional<Record> Reader::next() {
  if (!pending_.empty()) {
    auto record = std::move(pending_.back());
    pending_.pop_back();
    return record;
  }
  while (report_.ending == Ending::running) {
    auto record = in_chunk_ ? next_in_chunk() : next_in_file();
    if (record) return record;
  }
  return std::nullopt;
}

std::optional<Record> Reader::next_in_chunk() {
  if (records_.left() == 0) {
    in_chunk_ = false;
    return std::nullopt;
  }
  const auto op = static_cast<Op>(records_.take<std::uint8_t>());
  const ByteView body = records_.take_bytes(records_.take<std::uint64_t>());
  if (!records_.ok() || op == Op::invalid) {
    ++report_.chunks_malformed;
    in_chunk_ = false;
    return std::nullopt;
  }
  // Attachments and metadata have no place in a chunk.
  if (op != Op::schema && op != Op::channel && op != Op::message) return std::nullopt;
  return take(op, body);
}

/// Why the record that seems to begin here cannot be one; nothing if it can.
const char* Reader::fault_of_frame(Op op, std::uint64_t length) const {
  if (op == Op::invalid) return "zeros or garbage instead of a record";
  if (length > file_.size() - report_.offset - record_head_bytes)
    return "the file ends inside a record, or a length is wrong";
  if (chunks_ahead_.empty()) return nullptr;
  if (report_.offset > chunks_ahead_.back()) return "a length is wrong";
  if (op == Op::data_end || op == Op::footer) return "an opcode is wrong";
  return nullptr;
}

std::optional<Record> Reader::next_in_file() {
  const ByteView head = file_.view(report_.offset, record_head_bytes);
  if (head.empty()) {
    const bool ends_here = report_.offset == file_.size();
    lose_way(ends_here ? "the file ends without DataEnd" : "the file ends inside a record");
    return std::nullopt;
  }
  const auto op = static_cast<Op>(load<std::uint8_t>(head.data()));
  const auto length = load<std::uint64_t>(head.data() + 1);
  if (const char* fault = fault_of_frame(op, length)) {
    lose_way(fault);
    return std::nullopt;
  }
  if (!chunks_ahead_.empty() && report_.offset == chunks_ahead_.back()) chunks_ahead_.pop_back();
  extent_ = {report_.offset, record_head_bytes + length};
  if (length > options_.record_bytes_max) {
    if (!skip_large(extent_.length)) stop(Ending::cut, "cannot read on");
    return std::nullopt;
  }
  const ByteView record = file_.view(extent_.offset, extent_.length);
  if (record.empty()) {
    stop(Ending::cut, "cannot read on");
    return std::nullopt;
  }
  const ByteView body = record.subspan(record_head_bytes);
  if (op == Op::data_end || op == Op::footer) {
    finish_data(op, body);
    return std::nullopt;
  }
  data_crc_ = crc32(record, data_crc_);
  report_.offset += extent_.length;
  return take(op, body);
}

std::optional<Record> Reader::take(Op op, ByteView body) {
  switch (op) {
    case Op::schema:
      return take_schema(body);
    case Op::channel:
      return take_channel(body);
    case Op::message:
      return take_message(body);
    case Op::attachment:
      return take_attachment(body);
    case Op::chunk:
      open_chunk(body);
      break;
    case Op::message_index:
      count_indexed(body);
      break;
    case Op::header:
      if (auto header = parse_header(body)) header_ = std::move(*header);
      break;
    case Op::metadata:
      if (auto metadata = parse_metadata(body)) return std::move(*metadata);
      ++report_.records_malformed;
      break;
    default:
      break;  // unknown and private records are to be skipped
  }
  return std::nullopt;
}

std::optional<Record> Reader::take_schema(ByteView body) {
  auto schema = parse_schema(body);
  if (!schema) {
    ++report_.records_malformed;
    return std::nullopt;
  }
  const auto known = schemas_.find(schema->id);
  if (known != schemas_.end()) {
    if (known->second != *schema) stop(Ending::cut, "one schema id stands for two schemas");
    return std::nullopt;
  }
  if (!grant_definition(body.size())) return std::nullopt;
  return schemas_.emplace(schema->id, std::move(*schema)).first->second;
}

std::optional<Record> Reader::take_channel(ByteView body) {
  auto channel = parse_channel(body);
  if (!channel || (channel->schema_id != 0 && !schemas_.contains(channel->schema_id))) {
    ++report_.records_malformed;
    return std::nullopt;
  }
  const auto known = channels_.find(channel->id);
  if (known != channels_.end()) {
    if (known->second != *channel) stop(Ending::cut, "one channel id stands for two channels");
    return std::nullopt;
  }
  if (!grant_definition(body.size())) return std::nullopt;
  channel_known_.set(channel->id);
  return channels_.emplace(channel->id, std::move(*channel)).first->second;
}

std::optional<Record> Reader::take_message(ByteView body) {
  const auto message = parse_message(body);
  if (!message) {
    ++report_.records_malformed;
    return std::nullopt;
  }
  if (in_chunk_) ++met_;
  if (!in_chunk_ && report_.chunks > 0 && !options_.keep_bad_crc) {
    ++report_.messages_outside;
    return std::nullopt;
  }
  if (!channel_known_.test(message->channel_id)) return define_from_summary(*message);
  ++report_.messages;
  return *message;
}

std::optional<Record> Reader::take_attachment(ByteView body) {
  bool crc_holds = false;
  auto attachment = parse_attachment(body, crc_holds);
  if (!attachment) {
    ++report_.records_malformed;
    return std::nullopt;
  }
  if (!crc_holds) ++report_.attachments_bad_crc;
  if (!crc_holds && !options_.keep_bad_crc) return std::nullopt;
  return std::move(*attachment);
}

void Reader::open_chunk(ByteView body) {
  settle_chunk();
  ++report_.chunks;
  const ChunkState state = opener_.open(body);
  if (state == ChunkState::bad_crc) ++report_.chunks_bad_crc;
  if (state == ChunkState::undecodable) ++report_.chunks_undecodable;
  if (state == ChunkState::too_large) ++report_.records_too_large;
  in_chunk_ = state == ChunkState::good || (state == ChunkState::bad_crc && options_.keep_bad_crc);
  if (!in_chunk_) return;
  records_ = Cursor{opener_.records()};
  const ChunkRecord& head = opener_.head();
  chunk_.start_ns = head.start_ns;
  chunk_.end_ns = head.end_ns;
  chunk_.offset = extent_.offset;
  chunk_.length = extent_.length;
  chunk_.compression = head.compression;
  chunk_.compressed_bytes = head.records.size();
  chunk_.uncompressed_bytes = head.uncompressed_bytes;
}

void Reader::stop(Ending ending, const char* reason) {
  settle_chunk();
  report_.ending = ending;
  report_.reason = reason;
  in_chunk_ = false;
}

}  // namespace weakgrid::mcap
