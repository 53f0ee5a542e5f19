// What a gateway writes into its journal, and what a restarted one reads there: which reference stood, who
// held authority, what was known of the grid.
#pragma once

#include <optional>
#include <string>

#include "services/journal/journal.hpp"
#include "services/runtime/messages.hpp"
#include "services/runtime/settings.hpp"

namespace weakgrid {

struct GatewayMemory {
  std::optional<Reference> reference;  ///< the last issued
  Authority authority;
  std::uint64_t step = 0;         ///< the unit's, when the last entry was written
  std::optional<KnownGrid> grid;  ///< if an operator or the measurements have told
};

/// Of this unit. An empty memory if there is no such file yet; throws as read_journal does.
GatewayMemory recall(const std::string& path, std::uint32_t unit);

/// The bodies of entries that recall() understands.
/// request: none of a revalidation. grid: as known after the decision.
nlohmann::json entry(std::uint32_t unit, const Request* request, const Decision& decision,
                     const KnownGrid& grid, const Timing& timing);
nlohmann::json entry(std::uint32_t unit, const std::string& text, const std::optional<Reference>& reference,
                     std::uint64_t step);

}  // namespace weakgrid
