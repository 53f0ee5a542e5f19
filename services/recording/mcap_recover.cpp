// Recovery: the sequential reader feeds the writer.
#include "services/recording/mcap_recover.hpp"

namespace weakgrid::mcap {

namespace {

std::string_view text_of(const Bytes& bytes) {
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

/// Takes records of the broken file to the clean one; ids are looked up, because the writer gives its own.
class Copy {
 public:
  Copy(Writer& writer, Recovery& recovery) : writer_{writer}, recovery_{recovery} {}

  Status operator()(const Schema& schema) {
    const SchemaId id = writer_.add_schema(schema.name, schema.encoding, text_of(schema.data));
    schema_ids_[schema.id] = id;
    return id != 0 ? Status{} : Status{Fault::refused, 0, "a schema of the broken file is too large"};
  }

  Status operator()(const Channel& channel) {
    const SchemaId schema = channel.schema_id == 0 ? SchemaId{0} : schema_ids_[channel.schema_id];
    const ChannelId id =
        writer_.add_channel(schema, channel.topic, channel.message_encoding, channel.metadata);
    channel_ids_[channel.id] = id;
    return id != 0 ? Status{} : Status{Fault::refused, 0, "a channel of the broken file is too large"};
  }

  Status operator()(const Message& message) {
    return counted(recovery_.messages,
                   writer_.write_message(channel_ids_[message.channel_id], message.sequence,
                                         message.log_time_ns, message.publish_time_ns, message.data));
  }

  Status operator()(const Metadata& metadata) {
    return counted(recovery_.metadata, writer_.write_metadata(metadata.name, metadata.entries));
  }

  Status operator()(const Attachment& attachment) {
    return counted(recovery_.attachments, writer_.write_attachment(attachment));
  }

 private:
  static Status counted(std::uint64_t& count, const Status& status) {
    if (status.ok()) ++count;
    return status;
  }

  Writer& writer_;
  Recovery& recovery_;
  std::map<SchemaId, SchemaId> schema_ids_;
  std::map<ChannelId, ChannelId> channel_ids_;
};

StringMap about(const Recovery& recovery) {
  const ScanReport& scan = recovery.scan;
  return {{"found", scan.text()},
          {"source_bytes", std::to_string(scan.file_bytes)},
          {"source_bytes_understood", std::to_string(scan.offset)},
          {"source_intact", scan.intact() ? "true" : "false"},
          {"messages_known_lost",
           std::to_string(scan.messages_dropped + scan.messages_outside + scan.messages_without_channel)},
          {"records_refused", std::to_string(recovery.refused)}};
}

}  // namespace

Status recover(const std::string& broken, const std::string& clean, const RecoverOptions& options,
               Recovery& recovery) {
  recovery = {};
  Reader reader;
  if (const Status status = reader.open(broken, options.reader); !status.ok()) return status;

  // The header is only known once something behind it was asked for.
  auto record = reader.next();
  WriterOptions writer_options = options.writer;
  writer_options.profile = reader.header().profile;
  Writer writer;
  if (const Status status = writer.open(clean, writer_options); !status.ok()) return status;

  Copy copy{writer, recovery};
  for (; record; record = reader.next()) {
    const Status status = std::visit(copy, *record);
    if (status.ok()) continue;
    if (status.fault == Fault::refused) {
      ++recovery.refused;
      continue;
    }
    (void)writer.close();
    recovery.scan = reader.report();
    return status;
  }
  recovery.scan = reader.report();
  const Status noted = writer.write_metadata(recovery_metadata, about(recovery));
  const Status closed = writer.close();
  return noted.ok() ? closed : noted;
}

std::string Recovery::text() const {
  return "kept " + std::to_string(messages) + " messages, " + std::to_string(metadata) + " metadata, " +
         std::to_string(attachments) + " attachments" +
         (refused > 0 ? ", left out " + std::to_string(refused) + " records beyond the writer's limits"
                      : "") +
         "; the broken file: " + scan.text();
}

}  // namespace weakgrid::mcap
