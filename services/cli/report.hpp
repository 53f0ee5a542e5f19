// What a run or simulation prints, as a table or as JSON.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include "services/decision_json.hpp"
#include "services/run_record.hpp"

namespace weakgrid {

/// How a scenario ended; the first that holds.
enum class Ending : std::uint8_t { tripped, refused, interrupted, no_steady_state, settled, not_settled };
/// As in CSV.
const char* name(Ending ending);

struct Outcome {
  std::vector<Decision> decisions;
  RunRecord::Summary summary;
  std::string digest;
  std::string trip;  ///< empty = none
  std::uint64_t trip_step = 0;
  double wall_s = 0.0;  ///< spent stepping
  std::uint64_t holds = 0, resends = 0;
  bool over_dds = false;
  bool in_lockstep = true;  ///< where a hold is a fault; in real time the machine may do that

  Ending ending() const;
  /// Every setpoint accepted, settled, no hold in lockstep.
  bool is_good() const { return ending() == Ending::settled; }
};

/// Plays the scenario in this process.
Outcome simulated(const Settings& settings);

void print_table(const Settings& settings, const Outcome& outcome);
nlohmann::json to_json(const Settings& settings, const Outcome& outcome);

}  // namespace weakgrid
