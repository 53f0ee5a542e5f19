// The sequential scan in trouble and at its end: what it takes from the summary, leaves out, checks and
// reports.
#include <algorithm>

#include "services/recording/mcap_reader.hpp"

namespace weakgrid::mcap {

namespace {

constexpr std::uint64_t skip_window_bytes = 1 << 20;

}  // namespace

void Reader::count_indexed(ByteView message_index) {
  Cursor in{message_index};
  in.take<std::uint16_t>();
  indexed_ += in.take_prefixed().left() / (8 + 8);
}

/// A chunk that was dropped, broke off or is not even recognised leaves its message indexes behind.
void Reader::settle_chunk() {
  if (indexed_ > met_) report_.messages_dropped += indexed_ - met_;
  met_ = indexed_ = 0;
}

/// A damaged chunk may have held the only definition of a channel.
std::optional<Record> Reader::define_from_summary(const Message& message) {
  const auto channel = summary_.channels.find(message.channel_id);
  if (channel == summary_.channels.end() ||
      (channel->second.schema_id != 0 && !summary_.schemas.contains(channel->second.schema_id))) {
    ++report_.messages_without_channel;
    return std::nullopt;
  }
  ++report_.messages;
  pending_.push_back(message);
  channels_.emplace(*channel);
  channel_known_.set(message.channel_id);
  const auto schema = summary_.schemas.find(channel->second.schema_id);
  if (schema == summary_.schemas.end() || !schemas_.emplace(*schema).second) return channel->second;
  pending_.push_back(channel->second);
  return schema->second;
}

void Reader::find_chunks() {
  chunks_ahead_.clear();
  for (const ChunkIndex& chunk : summary_.chunks) chunks_ahead_.push_back(chunk.offset);
  std::sort(chunks_ahead_.rbegin(), chunks_ahead_.rend());
}

/// Each chunk is gone to at most once, so the scan ends whatever the summary says.
void Reader::lose_way(const char* reason) {
  if (!chunks_ahead_.empty() && report_.offset == chunks_ahead_.back()) chunks_ahead_.pop_back();
  if (chunks_ahead_.empty()) return stop(Ending::cut, reason);
  settle_chunk();
  ++report_.resumed;
  report_.offset = chunks_ahead_.back();
}

/// Definitions are kept, and chunks may unpack to a thousand times their size: so together they have a limit
/// too.
bool Reader::grant_definition(std::size_t bytes) {
  const bool fits = bytes <= options_.record_bytes_max - definition_bytes_;
  if (fits) definition_bytes_ += bytes;
  if (!fits) ++report_.records_too_large;
  return fits;
}

bool Reader::skip_large(std::uint64_t length) {
  ++report_.records_too_large;
  while (length > 0) {
    const ByteView part = file_.view(report_.offset, std::min(length, skip_window_bytes));
    if (part.empty()) return false;
    data_crc_ = crc32(part, data_crc_);
    report_.offset += part.size();
    length -= part.size();
  }
  return true;
}

/// The data section ends with DataEnd, or, in files of the simplest writers, straight with the footer.
void Reader::finish_data(Op op, ByteView body) {
  if (op == Op::data_end) {
    Cursor in{body};
    const auto crc = in.take<std::uint32_t>();
    report_.data_crc_bad = crc != 0 && crc != data_crc_;
    report_.offset += extent_.length;
  }
  finish_file();
}

/// Nothing of the summary is believed here: a half-written one must not add to what the data section says.
void Reader::finish_file() {
  std::uint64_t offset = report_.offset;
  const std::uint64_t summary = offset;
  std::uint32_t crc = 0;
  while (true) {
    const ByteView head = file_.view(offset, record_head_bytes);
    if (head.empty()) return stop(Ending::no_summary, "the file ends without a footer");
    const auto op = static_cast<Op>(load<std::uint8_t>(head.data()));
    const auto length = load<std::uint64_t>(head.data() + 1);
    const std::uint64_t left = file_.size() - offset - record_head_bytes;
    if (op == Op::invalid || length > std::min<std::uint64_t>(left, options_.record_bytes_max))
      return stop(Ending::no_summary, "the summary is cut off or damaged");
    const ByteView record = file_.view(offset, record_head_bytes + length);
    if (record.empty()) return stop(Ending::no_summary, "cannot read on");
    offset += record.size();
    if (op != Op::footer) {
      crc = crc32(record, crc);
      continue;
    }
    const auto footer = parse_footer(record.subspan(record_head_bytes));
    if (!footer) return stop(Ending::no_summary, "the footer is damaged");
    crc = crc32(record.first(record.size() - sizeof footer->summary_crc), crc);
    const bool empty = offset - record.size() == summary && footer->summary_start == 0;
    if (!empty && footer->summary_start != summary)
      return stop(Ending::no_summary, "the footer points elsewhere");
    report_.summary_crc_bad = footer->summary_crc != 0 && footer->summary_crc != crc;
    break;
  }
  const ByteView end = file_.view(offset, magic.size());
  if (!std::equal(end.begin(), end.end(), magic.begin(), magic.end()))
    return stop(Ending::no_summary, "the closing magic is missing");
  report_.offset = offset + magic.size();
  stop(Ending::complete, "");
}

bool ScanReport::intact() const {
  return ending == Ending::complete && chunks_bad_crc == 0 && chunks_undecodable == 0 &&
         chunks_malformed == 0 && messages_dropped == 0 && messages_outside == 0 &&
         messages_without_channel == 0 && resumed == 0 && records_malformed == 0 && records_too_large == 0 &&
         attachments_bad_crc == 0 && !data_crc_bad && !summary_crc_bad && offset == file_bytes;
}

std::string ScanReport::text() const {
  std::string text = std::to_string(messages) + " messages in " + std::to_string(chunks) + " chunks";
  if (intact()) return text + ", intact";
  const auto add = [&text](std::uint64_t count, const char* what) {
    if (count > 0) text += ", " + std::to_string(count) + " " + what;
  };
  add(chunks_bad_crc, "chunks with a wrong CRC");
  add(chunks_undecodable, "undecodable chunks");
  add(chunks_malformed, "chunks that turn malformed");
  add(messages_dropped, "messages of damaged chunks");
  add(messages_outside, "messages outside of chunks");
  add(messages_without_channel, "messages of unknown channels");
  add(resumed, "places where the scan had to skip to the next chunk");
  add(records_malformed, "malformed records");
  add(records_too_large, "records too large");
  add(attachments_bad_crc, "attachments with a wrong CRC");
  if (data_crc_bad) text += ", data section CRC wrong";
  if (summary_crc_bad) text += ", summary CRC wrong";
  if (ending != Ending::complete) text += ", " + std::string{reason};
  add(file_bytes - offset, "bytes not read at the end");
  return text;
}

}  // namespace weakgrid::mcap
