// One round of one kind: both ends started, so many round trips, both ended.
#pragma once

#include <array>
#include <cstdint>

#include "tests/bench/roundtrip/link.hpp"

namespace weakgrid::bench {

/// Microseconds; from when the sample is handed to the middleware to when the thread that waits has the
/// answer.
struct Figures {
  double p50 = 0.0, p99 = 0.0, p999 = 0.0, max = 0.0;
  std::uint64_t count = 0;
  std::uint64_t resends = 0;  ///< samples sent again after 20 ms; their time includes the wait
};

/// How each of the two processes runs, as [realtime] of the settings.
struct Conditions {
  std::uint64_t count = 20'000;
  std::uint32_t priority = 0;
  bool dma_latency = false;
  std::array<int, 2> cpus{-1, -1};  ///< of who asks and who answers
};

/// Throws LinkError.
Figures link_round(const Kind& kind, const Place& place, const Conditions& conditions);
/// The child that link_round starts: answers until stdin ends.
void serve_echo(const Kind& kind, const Place& place, const Conditions& conditions);

/// The real weakgrid-plant and weakgrid-controller of this program's folder, in lockstep. `loop`: for
/// [dds] loop, empty for its default. The figures are the plant's own, from its health. Throws LinkError.
Figures services_round(const std::string& loop, const Place& place, const Conditions& conditions);

/// The folder of this program.
std::string program_folder();

}  // namespace weakgrid::bench
