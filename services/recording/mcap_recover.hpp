// Rewrites a broken MCAP file as a clean one, and says what was lost.
#pragma once

#include "services/recording/mcap_reader.hpp"
#include "services/recording/mcap_writer.hpp"

namespace weakgrid::mcap {

struct RecoverOptions {
  WriterOptions writer;  ///< the profile is taken from the broken file
  /// `keep_bad_crc`: rather a damaged message than none. Off by default, because the clean file gets new
  /// CRCs, under which nobody sees the damage any more.
  ReaderOptions reader;
};

struct Recovery {
  ScanReport scan;  ///< of the broken file: what was dropped, and where it ends
  std::uint64_t messages = 0;
  std::uint64_t metadata = 0;
  std::uint64_t attachments = 0;
  std::uint64_t refused = 0;  ///< beyond the writer's limits, so not in the clean file
  std::string text() const;   ///< one line a person reads
};

/// The name of the metadata record that a recovered file ends with: what was found and lost, in words and
/// numbers.
inline constexpr std::string_view recovery_metadata = "weakgrid_recovery";

/// Everything in the data section that is whole, in its order; indexes and statistics are made anew from
/// that, the summary of the broken file is not believed (Reader::next() says where it helps). Never touches
/// `broken`, never overwrites `clean`.
/// Channel ids may change: they follow the order of the first messages.
Status recover(const std::string& broken, const std::string& clean, const RecoverOptions& options,
               Recovery& recovery);

}  // namespace weakgrid::mcap
