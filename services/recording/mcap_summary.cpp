// Reading the summary from the end of an MCAP file.
#include "services/recording/mcap_summary.hpp"

#include <algorithm>

#include "services/recording/mcap_codec.hpp"

namespace weakgrid::mcap {

namespace {

constexpr std::size_t footer_record_bytes = record_head_bytes + footer_bytes;

template <class Id, class Definition>
bool keep(std::map<Id, Definition>& known, std::optional<Definition> definition) {
  if (definition) known.try_emplace(definition->id, std::move(*definition));
  return definition.has_value();
}

template <class Index>
bool keep(std::vector<Index>& known, std::optional<Index> index) {
  if (index) known.push_back(std::move(*index));
  return index.has_value();
}

bool keep_record(Op op, ByteView body, Summary& summary, bool& has_statistics) {
  switch (op) {
    case Op::schema:
      return keep(summary.schemas, parse_schema(body));
    case Op::channel:
      return keep(summary.channels, parse_channel(body));
    case Op::chunk_index:
      return keep(summary.chunks, parse_chunk_index(body));
    case Op::attachment_index:
      return keep(summary.attachments, parse_attachment_index(body));
    case Op::metadata_index:
      return keep(summary.metadata, parse_metadata_index(body));
    case Op::statistics: {
      auto statistics = parse_statistics(body);
      if (!statistics) return false;
      summary.statistics = std::move(*statistics);
      has_statistics = true;
      return true;
    }
    default:
      return op != Op::invalid;
  }
}

/// Chunks lie apart and before `end`. Else a small file could make its reader open one large chunk many
/// times.
bool chunks_disjoint(const std::vector<ChunkIndex>& chunks, std::uint64_t end) {
  std::vector<std::pair<std::uint64_t, std::uint64_t>> extents;
  extents.reserve(chunks.size());
  for (const ChunkIndex& chunk : chunks) extents.emplace_back(chunk.offset, chunk.length);
  std::sort(extents.begin(), extents.end());
  std::uint64_t free_from = magic.size();
  for (const auto& [offset, length] : extents) {
    if (offset < free_from || offset > end || length > end - offset || length == 0) return false;
    free_from = offset + length;
  }
  return true;
}

Status no_summary(const char* why) { return {Fault::no_summary, 0, why}; }

}  // namespace

Status read_summary(InputFile& file, std::size_t bytes_max, Summary& summary) {
  summary = {};
  constexpr std::size_t end_bytes = footer_record_bytes + magic.size();
  if (file.size() < magic.size() + end_bytes) return no_summary("the file has no footer");
  const std::uint64_t footer_offset = file.size() - end_bytes;
  const ByteView end = file.view(footer_offset, end_bytes);
  if (end.empty() || !std::equal(magic.begin(), magic.end(), end.end() - magic.size()))
    return no_summary("the file does not end as MCAP does");
  if (static_cast<Op>(load<std::uint8_t>(end.data())) != Op::footer ||
      load<std::uint64_t>(end.data() + 1) != footer_bytes)
    return no_summary("the file has no footer");
  const auto footer = parse_footer(end.subspan(record_head_bytes, footer_bytes));
  if (!footer || footer->summary_start == 0) return no_summary("the file was written without a summary");
  if (footer->summary_start < magic.size() || footer->summary_start > footer_offset)
    return no_summary("the footer points outside the file");

  // With the footer's first fields behind it, because the CRC covers them too.
  const std::uint64_t size = footer_offset - footer->summary_start;
  constexpr std::size_t footer_in_crc = footer_record_bytes - sizeof footer->summary_crc;
  if (size > bytes_max) return {Fault::too_large, 0, "the summary is too large"};
  const ByteView bytes = file.view(footer->summary_start, size + footer_in_crc);
  if (bytes.empty()) return no_summary("cannot read the summary");
  if (footer->summary_crc != 0 && footer->summary_crc != crc32(bytes))
    return no_summary("the summary is damaged");

  bool has_statistics = false;
  Cursor records{bytes.first(bytes.size() - footer_in_crc)};
  while (records.left() > 0) {
    const auto op = static_cast<Op>(records.take<std::uint8_t>());
    const ByteView body = records.take_bytes(records.take<std::uint64_t>());
    if (!records.ok() || !keep_record(op, body, summary, has_statistics))
      return no_summary("the summary is damaged");
  }
  if (!has_statistics || summary.statistics.chunks != summary.chunks.size())
    return no_summary("the summary does not list every chunk");
  if (!chunks_disjoint(summary.chunks, footer->summary_start))
    return no_summary("the chunk indexes are wrong");
  summary.crc_checked = footer->summary_crc != 0;
  return {};
}

}  // namespace weakgrid::mcap
