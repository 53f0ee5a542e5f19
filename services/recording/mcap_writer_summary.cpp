// The end of a recording: data end, summary, summary offsets, footer.
#include <algorithm>

#include "services/recording/mcap_writer.hpp"

namespace weakgrid::mcap {

Status Writer::close() {
  if (!is_open()) return {Fault::closed, 0, "no recording is open"};
  Status first = flush();
  const auto keep = [&first](const Status& status) {
    if (first.ok()) first = status;
  };
  keep(remember(file_.append(encode_end())));
  keep(remember(file_.sync()));
  keep(remember(file_.close()));
  return first;
}

/// Only what the data section holds: a schema or channel without a message is not in the file.
Bytes Writer::encode_end() const {
  Bytes out;
  {
    const RecordFrame frame{out, Op::data_end};
    put(out, data_crc_);
  }
  const std::size_t summary = out.size();
  Bytes offsets;
  const auto put_group = [&](Op op, const auto& put_records) {
    const std::size_t begin = out.size();
    put_records();
    if (out.size() == begin) return;
    const RecordFrame frame{offsets, Op::summary_offset};
    put(offsets, static_cast<std::uint8_t>(op));
    put(offsets, file_.size() + begin);
    put(offsets, static_cast<std::uint64_t>(out.size() - begin));
  };
  const auto put_definitions = [&out](const std::vector<Definition>& definitions) {
    for (const Definition& definition : definitions)
      if (definition.place == Place::file) put_bytes(out, definition.record);
  };
  put_group(Op::schema, [&] { put_definitions(schemas_); });
  put_group(Op::channel, [&] { put_definitions(channels_); });
  put_group(Op::statistics, [&] { mcap::append(out, statistics()); });
  put_group(Op::chunk_index, [&] { put_bytes(out, chunk_indexes_); });
  put_group(Op::attachment_index, [&] { put_bytes(out, attachment_indexes_); });
  put_group(Op::metadata_index, [&] { put_bytes(out, metadata_indexes_); });

  const std::uint64_t summary_offset_start = file_.size() + out.size();
  put_bytes(out, offsets);
  put(out, static_cast<std::uint8_t>(Op::footer));
  put<std::uint64_t>(out, footer_bytes);
  put(out, static_cast<std::uint64_t>(file_.size() + summary));
  put(out, summary_offset_start);
  put(out, crc32(ByteView{out}.subspan(summary)));
  put_bytes(out, magic);
  return out;
}

Statistics Writer::statistics() const {
  const auto in_file = [](const std::vector<Definition>& definitions) {
    return std::count_if(definitions.begin(), definitions.end(),
                         [](const Definition& definition) { return definition.place == Place::file; });
  };
  Statistics statistics{.messages = counters_.messages,
                        .schemas = static_cast<std::uint16_t>(in_file(schemas_)),
                        .channels = static_cast<std::uint32_t>(in_file(channels_)),
                        .attachments = attachments_,
                        .metadata = metadata_,
                        .chunks = counters_.chunks,
                        .start_ns = start_ns_,
                        .end_ns = end_ns_,
                        .channel_messages = {}};
  for (std::size_t k = 0; k < channels_.size(); ++k)
    if (channels_[k].messages > 0)
      statistics.channel_messages.emplace(static_cast<ChannelId>(k + 1), channels_[k].messages);
  return statistics;
}

}  // namespace weakgrid::mcap
