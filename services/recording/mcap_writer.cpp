// The MCAP writer. Order of the file: header, chunks with metadata and attachments between them, data end,
// summary.
#include "services/recording/mcap_writer.hpp"

#include <unistd.h>

#include <algorithm>

namespace weakgrid::mcap {

namespace {

constexpr std::size_t chunk_bytes_min = 1024;
constexpr std::size_t id_max = 0xffff;

// Chunk indexes of an hour at four chunks a second; more grows. Untouched pages cost nothing.
constexpr std::size_t chunk_indexes_reserve = 4 << 20;

}  // namespace

Writer::~Writer() {
  if (is_open()) (void)close();
}

Status Writer::open(const std::string& path, const WriterOptions& options) {
  if (is_open()) return {Fault::refused, 0, "a recording is already open"};
  if (options.chunk_bytes < chunk_bytes_min || options.chunk_bytes > record_bytes_max)
    return {Fault::refused, 0, "chunk size out of range: 1 KiB to 16 MiB"};
  if (const Status status = file_.create(path); !status.ok()) return status;

  options_ = options;
  first_fault_ = {};
  counters_ = {};
  attachments_ = metadata_ = 0;
  start_ns_ = end_ns_ = 0;
  data_crc_ = 0;
  chunk_indexes_.clear();
  chunk_indexes_.reserve(chunk_indexes_reserve);
  attachment_indexes_.clear();
  metadata_indexes_.clear();
  for (auto* definitions : {&schemas_, &channels_})
    for (Definition& definition : *definitions) {
      definition.place = Place::nowhere;
      definition.messages = 0;
    }
  chunk_.prepare(options.chunk_bytes, options.compression);
  chunk_seen_ns_.reset();

  out_.assign(magic.begin(), magic.end());
  mcap::append(out_, Header{options.profile, "weakgrid " + options.version});
  const Status status = append(out_);
  if (!status.ok()) {
    (void)file_.close();
    (void)::unlink(path.c_str());  // ours alone, and empty: a later try may have the name
  }
  return status;
}

SchemaId Writer::add_schema(std::string_view name, std::string_view encoding, std::string_view text) {
  if (schemas_.size() >= id_max || name.size() + encoding.size() + text.size() > record_bytes_max) return 0;
  const auto id = static_cast<SchemaId>(schemas_.size() + 1);
  const ByteView data = std::as_bytes(std::span{text});
  Definition& schema = schemas_.emplace_back();
  mcap::append(schema.record,
               Schema{id, std::string{name}, std::string{encoding}, Bytes{data.begin(), data.end()}});
  return id;
}

ChannelId Writer::add_channel(SchemaId schema, std::string_view topic, std::string_view message_encoding,
                              const StringMap& metadata) {
  if (channels_.size() >= id_max || schema > schemas_.size()) return 0;
  const auto id = static_cast<ChannelId>(channels_.size() + 1);
  Definition channel;
  mcap::append(channel.record,
               Channel{id, schema, std::string{topic}, std::string{message_encoding}, metadata});
  if (channel.record.size() > record_bytes_max) return 0;
  channel.schema = schema;
  channels_.push_back(std::move(channel));
  chunk_.allow_channel(id);
  return id;
}

Status Writer::write_message(ChannelId channel, std::uint32_t sequence, std::uint64_t log_time_ns,
                             std::uint64_t publish_time_ns, ByteView data) {
  if (!is_open()) return {Fault::closed, 0, "no recording is open"};
  if (channel == 0 || channel > channels_.size()) return {Fault::refused, 0, "no such channel"};
  if (data.size() > record_bytes_max) return {Fault::refused, 0, "the message is larger than 16 MiB"};

  Definition& definition = channels_[channel - 1U];
  const std::size_t size =
      record_head_bytes + message_head_bytes + data.size() + announcement_bytes(definition);
  Status status;
  if (!chunk_.empty() && chunk_.size() + size > options_.chunk_bytes) status = flush();
  announce(definition);
  chunk_.add({channel, sequence, log_time_ns, publish_time_ns, data});
  return status;
}

std::size_t Writer::announcement_bytes(const Definition& channel) const {
  std::size_t size = channel.place == Place::nowhere ? channel.record.size() : 0;
  if (channel.schema != 0 && schemas_[channel.schema - 1U].place == Place::nowhere)
    size += schemas_[channel.schema - 1U].record.size();
  return size;
}

void Writer::announce(Definition& channel) {
  const auto put_once = [this](Definition& definition) {
    if (definition.place != Place::nowhere) return;
    chunk_.add_definition(definition.record);
    definition.place = Place::open_chunk;
  };
  if (channel.schema != 0) put_once(schemas_[channel.schema - 1U]);
  put_once(channel);
}

Status Writer::flush() {
  if (!is_open()) return {Fault::closed, 0, "no recording is open"};
  if (chunk_.empty()) return {};
  out_.clear();
  chunk_.encode(file_.size(), out_, index_);
  const Status status = append(out_);
  settle_chunk(status.ok());
  return status;
}

/// The chunk has reached the file or is lost; with it its messages, and the definitions that it announced.
void Writer::settle_chunk(bool written) {
  for (auto* definitions : {&schemas_, &channels_})
    for (Definition& definition : *definitions)
      if (definition.place == Place::open_chunk) definition.place = written ? Place::file : Place::nowhere;
  if (written) {
    for (std::size_t k = 0; k < channels_.size(); ++k) channels_[k].messages += chunk_.messages_of()[k + 1];
    start_ns_ = counters_.messages == 0 ? index_.start_ns : std::min(start_ns_, index_.start_ns);
    end_ns_ = counters_.messages == 0 ? index_.end_ns : std::max(end_ns_, index_.end_ns);
    counters_.messages += chunk_.messages();
    counters_.uncompressed_bytes += index_.uncompressed_bytes;
    counters_.compressed_bytes += index_.compressed_bytes;
    ++counters_.chunks;
    mcap::append(chunk_indexes_, index_);
  } else {
    counters_.messages_lost += chunk_.messages();
  }
  chunk_.clear();
  chunk_seen_ns_.reset();
}

Status Writer::flush_if_older(std::int64_t now_ns) {
  if (chunk_.empty()) return {};
  if (!chunk_seen_ns_) chunk_seen_ns_ = now_ns;
  return now_ns - *chunk_seen_ns_ >= options_.chunk_age_ns ? flush() : Status{};
}

Status Writer::write_metadata(std::string_view name, const StringMap& entries) {
  if (!is_open()) return {Fault::closed, 0, "no recording is open"};
  Bytes record;
  mcap::append(record, Metadata{std::string{name}, entries});
  if (record.size() > record_bytes_max) return {Fault::refused, 0, "the metadata are larger than 16 MiB"};
  const Status flushed = flush();
  const MetadataIndex index{file_.size(), record.size(), std::string{name}};
  if (const Status status = append(record); !status.ok()) return status;
  mcap::append(metadata_indexes_, index);
  ++metadata_;
  return flushed;
}

Status Writer::write_attachment(const Attachment& attachment) {
  if (!is_open()) return {Fault::closed, 0, "no recording is open"};
  if (attachment.data.size() > record_bytes_max)
    return {Fault::refused, 0, "the attachment is larger than 16 MiB"};
  Bytes record;
  mcap::append(record, attachment);
  const Status flushed = flush();
  const AttachmentIndex index{.offset = file_.size(),
                              .length = record.size(),
                              .log_time_ns = attachment.log_time_ns,
                              .create_time_ns = attachment.create_time_ns,
                              .data_bytes = attachment.data.size(),
                              .name = attachment.name,
                              .media_type = attachment.media_type};
  if (const Status status = append(record); !status.ok()) return status;
  mcap::append(attachment_indexes_, index);
  ++attachments_;
  return flushed;
}

Status Writer::append(ByteView bytes) {
  const Status status = file_.append(bytes);
  if (status.ok()) data_crc_ = crc32(bytes, data_crc_);
  return remember(status);
}

Status Writer::remember(const Status& status) {
  if (first_fault_.ok()) first_fault_ = status;
  return status;
}

}  // namespace weakgrid::mcap
