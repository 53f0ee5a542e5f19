// The summary of an MCAP file: what is in it and where, read from its end.
#pragma once

#include "services/recording/mcap_file.hpp"
#include "services/recording/mcap_records.hpp"

namespace weakgrid::mcap {

struct Summary {
  std::map<SchemaId, Schema> schemas;
  std::map<ChannelId, Channel> channels;
  Statistics statistics;
  std::vector<ChunkIndex> chunks;
  std::vector<AttachmentIndex> attachments;
  std::vector<MetadataIndex> metadata;
  bool crc_checked = false;  ///< the file carries a CRC of its summary, and it holds
  bool rebuilt = false;      ///< by a scan, because the file has no usable one
};

/// no_summary also where the summary is damaged or does not list every chunk; too_large beyond `bytes_max`.
/// Offsets in it are claims: whoever follows one finds out.
Status read_summary(InputFile& file, std::size_t bytes_max, Summary& summary);

}  // namespace weakgrid::mcap
