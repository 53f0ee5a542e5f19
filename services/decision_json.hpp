// What the gateway says, as JSON, for terminals and the journal.
#pragma once

#include <nlohmann/json_fwd.hpp>

#include "services/runtime/messages.hpp"

namespace weakgrid {

nlohmann::json to_json(const Decision& decision, const Timing& timing);
nlohmann::json to_json(const Envelope& envelope);

}  // namespace weakgrid
