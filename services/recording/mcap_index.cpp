// The indexed MCAP reader: chunks that overlap in time are open together and merged.
#include "services/recording/mcap_index.hpp"

#include <algorithm>
#include <numeric>

namespace weakgrid::mcap {

namespace {

// Times chunk_bytes_max: what the open chunks may hold together.
constexpr std::size_t overlap_max = 4;

}  // namespace

Status IndexedReader::open(const std::string& path, const ReaderOptions& options) {
  if (const Status status = file_.open(path); !status.ok()) return status;
  if (const Status status = begin(options); status.fault != Fault::no_summary) return status;
  Reader reader;
  if (const Status status = reader.open(path, options); !status.ok()) return status;
  rebuild(reader);
  return {};
}

Status IndexedReader::open(ByteView bytes, const ReaderOptions& options) {
  file_.open(bytes);
  if (const Status status = begin(options); status.fault != Fault::no_summary) return status;
  Reader reader;
  if (const Status status = reader.open(bytes, options); !status.ok()) return status;
  rebuild(reader);
  return {};
}

Status IndexedReader::begin(const ReaderOptions& options) {
  options_ = options;
  opener_ = ChunkOpener{options.chunk_bytes_max};
  const ByteView begin = file_.view(0, magic.size());
  if (!std::equal(begin.begin(), begin.end(), magic.begin(), magic.end()))
    return {Fault::not_mcap, 0, "not an MCAP file"};
  const Status status = read_summary(file_, options.record_bytes_max, summary_);
  if (status.ok()) select({});
  return status;
}

void IndexedReader::rebuild(Reader& reader) {
  summary_ = {};
  summary_.rebuilt = true;
  Statistics& statistics = summary_.statistics;
  while (const auto record = reader.next()) {
    const Extent extent = reader.extent();
    if (const auto* message = std::get_if<Message>(&*record)) {
      const std::uint64_t time_ns = message->log_time_ns;
      const bool first = statistics.messages++ == 0;
      statistics.start_ns = first ? time_ns : std::min(statistics.start_ns, time_ns);
      statistics.end_ns = first ? time_ns : std::max(statistics.end_ns, time_ns);
      ++statistics.channel_messages[message->channel_id];
      if (!reader.in_chunk()) continue;
      const bool known = !summary_.chunks.empty() && summary_.chunks.back().offset == extent.offset;
      if (!known) {
        ChunkIndex& chunk = summary_.chunks.emplace_back(reader.chunk());
        chunk.start_ns = chunk.end_ns = time_ns;
      }
      ChunkIndex& chunk = summary_.chunks.back();
      chunk.start_ns = std::min(chunk.start_ns, time_ns);
      chunk.end_ns = std::max(chunk.end_ns, time_ns);
    } else if (const auto* metadata = std::get_if<Metadata>(&*record)) {
      summary_.metadata.push_back({extent.offset, extent.length, metadata->name});
    } else if (const auto* attachment = std::get_if<Attachment>(&*record)) {
      summary_.attachments.push_back({extent.offset, extent.length, attachment->log_time_ns,
                                      attachment->create_time_ns, attachment->data.size(), attachment->name,
                                      attachment->media_type});
    }
  }
  summary_.schemas = reader.schemas();
  summary_.channels = reader.channels();
  statistics.schemas = static_cast<std::uint16_t>(summary_.schemas.size());
  statistics.channels = static_cast<std::uint32_t>(summary_.channels.size());
  statistics.chunks = static_cast<std::uint32_t>(summary_.chunks.size());
  statistics.attachments = static_cast<std::uint32_t>(summary_.attachments.size());
  statistics.metadata = static_cast<std::uint32_t>(summary_.metadata.size());
  select({});
}

/// The body of the record that stands at `offset`, nothing if it is another kind or does not fit the file.
ByteView IndexedReader::body_at(std::uint64_t offset, Op op) {
  const ByteView head = file_.view(offset, record_head_bytes);
  if (head.empty() || static_cast<Op>(load<std::uint8_t>(head.data())) != op) return {};
  const auto length = load<std::uint64_t>(head.data() + 1);
  if (length > options_.record_bytes_max) return {};
  return file_.view(offset + record_head_bytes, length);
}

std::optional<Metadata> IndexedReader::metadata(const MetadataIndex& index) {
  return parse_metadata(body_at(index.offset, Op::metadata));
}

std::optional<Attachment> IndexedReader::attachment(const AttachmentIndex& index) {
  bool crc_holds = false;
  auto attachment = parse_attachment(body_at(index.offset, Op::attachment), crc_holds);
  if (!crc_holds && !options_.keep_bad_crc) return std::nullopt;
  return attachment;
}

void IndexedReader::select(TimeRange range, const std::vector<ChannelId>& channels) {
  range_ = range;
  channels_wanted_.reset();
  if (channels.empty()) channels_wanted_.set();
  for (const ChannelId id : channels) channels_wanted_.set(id);
  order_.resize(summary_.chunks.size());
  std::iota(order_.begin(), order_.end(), std::size_t{0});
  const auto key = [this](std::size_t k) {
    return std::pair{summary_.chunks[k].start_ns, summary_.chunks[k].offset};
  };
  std::sort(order_.begin(), order_.end(), [&](std::size_t a, std::size_t b) { return key(a) < key(b); });
  next_chunk_ = 0;
  open_.clear();
  open_bytes_ = 0;
  chunks_skipped_ = 0;
  status_ = {};
}

bool IndexedReader::wanted(const ChunkIndex& chunk) const {
  if (chunk.start_ns > range_.until_ns || chunk.end_ns < range_.from_ns) return false;
  const auto& offsets = chunk.message_index_offsets;
  return offsets.empty() || std::any_of(offsets.begin(), offsets.end(), [this](const auto& place) {
           return channels_wanted_.test(place.first);
         });
}

bool IndexedReader::wanted(const Message& message) const {
  return channels_wanted_.test(message.channel_id) && message.log_time_ns >= range_.from_ns &&
         message.log_time_ns <= range_.until_ns;
}

namespace {

/// Heap order: the chunk with the earliest message comes to the front.
constexpr auto later = [](const auto& a, const auto& b) {
  const auto key = [](const auto& chunk) {
    return std::pair{chunk.places[chunk.next].log_time_ns, chunk.offset};
  };
  return key(a) > key(b);
};

}  // namespace

std::optional<Message> IndexedReader::next() {
  spent_ = {};
  open_overlapping();
  if (open_.empty()) return std::nullopt;
  std::pop_heap(open_.begin(), open_.end(), later);
  OpenChunk& chunk = open_.back();
  const ByteView records{chunk.records.get(), chunk.bytes};
  const Place place = chunk.places[chunk.next++];
  if (chunk.next < chunk.places.size()) {
    std::push_heap(open_.begin(), open_.end(), later);
  } else {
    open_bytes_ -= chunk.memory();
    spent_ = std::move(chunk);  // the message returned now lies in it
    open_.pop_back();
  }
  return parse_message(records.subspan(place.offset, place.length));
}

/// Also those that begin at the very time of the earliest message: they may stand before it in the file.
void IndexedReader::open_overlapping() {
  for (; next_chunk_ < order_.size(); ++next_chunk_) {
    const ChunkIndex& chunk = summary_.chunks[order_[next_chunk_]];
    if (!wanted(chunk)) continue;
    if (!open_.empty() && chunk.start_ns > open_.front().places[open_.front().next].log_time_ns) return;
    open_chunk(chunk);
    if (open_bytes_ / overlap_max <= options_.chunk_bytes_max) continue;
    status_ = {Fault::too_large, 0, "too many chunks overlap in time"};
    open_.clear();
    next_chunk_ = order_.size();
    return;
  }
}

void IndexedReader::open_chunk(const ChunkIndex& index) {
  const ByteView body = body_at(index.offset, Op::chunk);
  const ChunkState state =
      body.size() + record_head_bytes == index.length ? opener_.open(body) : ChunkState::undecodable;
  if (state != ChunkState::good && !(state == ChunkState::bad_crc && options_.keep_bad_crc)) {
    ++chunks_skipped_;
    return;
  }
  OpenChunk chunk;
  chunk.bytes = opener_.records().size();
  chunk.offset = index.offset;
  chunk.places = places_of(opener_.records());
  if (chunk.places.empty()) return;
  chunk.records = opener_.release();
  open_bytes_ += chunk.memory();
  open_.push_back(std::move(chunk));
  std::push_heap(open_.begin(), open_.end(), later);
}

/// Of the messages that are wanted. Read from the chunk, not from its message indexes: one source of truth
/// less.
std::vector<IndexedReader::Place> IndexedReader::places_of(ByteView records) {
  std::vector<Place> places;
  Cursor in{records};
  while (in.left() > 0) {
    const auto op = static_cast<Op>(in.take<std::uint8_t>());
    const ByteView body = in.take_bytes(in.take<std::uint64_t>());
    if (!in.ok() || op == Op::invalid) break;
    const auto message = op == Op::message ? parse_message(body) : std::nullopt;
    if (!message || !wanted(*message)) continue;
    places.push_back(
        {message->log_time_ns, static_cast<std::size_t>(body.data() - records.data()), body.size()});
  }
  std::stable_sort(places.begin(), places.end(),
                   [](const Place& a, const Place& b) { return a.log_time_ns < b.log_time_ns; });
  return places;
}

}  // namespace weakgrid::mcap
