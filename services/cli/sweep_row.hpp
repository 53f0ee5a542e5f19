// What a sweep's CSV says of a run, beside what was varied. Per unit unless a name ends in its unit.
#pragma once

#include <string>
#include <vector>

#include "services/cli/report.hpp"

namespace weakgrid {

/// ending, then of the gateway: setpoint (1, 2, …: the first refused, else the last), verdict, and the limit
/// that it is furthest beyond, else the nearest, with what is left of the margin; then trip, what the run has
/// settled at, and the digest. For each quantity: the mean over the last grid period, the closed form, the
/// largest departure from the mean (relative, as `weakgrid simulate` says it) and from the closed form in
/// that period. A cell is empty where there is nothing to say.
std::vector<std::string> sweep_columns();
/// The cells, joined.
std::string sweep_cells(const Outcome& outcome);

/// Of such cells.
std::string ending_of(const std::string& cells);

}  // namespace weakgrid
