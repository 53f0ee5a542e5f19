// What a run or simulation prints, as a table or as JSON.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include "services/decision_json.hpp"
#include "services/run_record.hpp"

namespace weakgrid {

struct Outcome {
  std::vector<Decision> decisions;
  RunRecord::Summary summary;
  std::string digest;
  std::string trip;  ///< empty = none
  std::uint64_t trip_step = 0;
  double wall_s = 0.0;  ///< spent stepping
  std::uint64_t holds = 0, resends = 0;
  bool over_dds = false;

  /// Every setpoint accepted, settled, no hold.
  bool is_good() const;
};

void print_table(const Settings& settings, const Outcome& outcome);
nlohmann::json to_json(const Settings& settings, const Outcome& outcome);

}  // namespace weakgrid
