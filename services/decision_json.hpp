// A decision as JSON, for terminals and the journal.
#pragma once

#include <nlohmann/json_fwd.hpp>

#include "gateway/arbiter.hpp"

namespace weakgrid {

nlohmann::json to_json(const Decision& decision, const Timing& timing);

}  // namespace weakgrid
