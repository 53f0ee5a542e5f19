// What a tap hands to a recorder and a recording to a replayer: writers, and samples nobody has parsed.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

namespace weakgrid {

/// A writer as discovery describes it.
struct SourceWriter {
  std::uint32_t index = 0;  ///< 0, 1, … in the order of discovery
  std::string guid;         ///< "01.0f.…|0.0.1.3", as eProsima's tools print it
  std::string topic;
  std::string type;
  bool keyed = false;
  bool reliable = false;
  bool transient_local = false;  ///< or more durable
  bool exclusive = false;        ///< ownership
  std::vector<std::string> partitions;
  std::string qos_full;  ///< JSON: what discovery says beyond that
};

/// Somebody who writes now.
struct LiveWriter {
  std::string guid;  ///< "participant|entity"
  std::string topic;
};

/// One sample as the middleware brought it. A view: it holds as long as whoever hands it out says.
struct RawSample {
  std::uint32_t writer = 0;    ///< index, counted from 0 in the order of discovery
  bool has_data = true;        ///< false: the writer spent a sequence number on something else than data
  std::uint64_t sequence = 0;  ///< the writer's own count
  std::int64_t source_ns = 0;  ///< CLOCK_REALTIME, as the next
  std::int64_t reception_ns = 0;
  std::span<const std::byte> payload{};  ///< serialized, with the 4-byte encapsulation header
};

}  // namespace weakgrid
