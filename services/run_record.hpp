// What a run showed, from its measurements and modulations alone, beside what the closed form says.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "services/runtime/settings.hpp"

namespace weakgrid {

/// Gathers while a scenario runs; a sample that was missed is counted, not guessed.
class RunRecord {
 public:
  explicit RunRecord(const Settings& settings);

  void see(const Measurement& measurement);
  void see(const Modulation& modulation);
  /// The gateway's answer to the scenario's next setpoint.
  void see(const Decision& decision);

  struct Quantity {
    std::string name;
    double settled = 0.0;  ///< mean over the last grid period
    double closed_form = 0.0;
    double difference = 0.0;  ///< relative; to 0.1 where the closed form is smaller
    double swing = 0.0;       ///< largest departure from the mean in that period, relative alike
    double deviation = 0.0;   ///< largest departure from the closed form in that period, per unit
    bool agrees = false;
  };
  struct Summary {
    std::vector<Quantity> quantities;  ///< p, q, v_c, |v_p|, |i|
    double tolerance = 0.0;
    bool has_steady_state = false;
    bool settled = false;  ///< all quantities agree and the unit has not tripped
    double v_c_min = 0.0, v_c_max = 0.0;
    std::uint64_t saturated = 0;  ///< modulations seen that were limited
    std::uint64_t missed = 0;     ///< measurements not seen, of end_step
    std::optional<std::uint64_t> blocked_at;
  };
  Summary summary() const;

  std::uint64_t end_step() const { return end_step_; }

 private:
  struct Sample {
    double p, q, v_c, v_p, i;
  };

  const Settings& settings_;
  std::uint64_t end_step_, window_;
  double mean_gain_;  // of a period mean's magnitude, undone here
  std::vector<Sample> samples_;
  std::vector<Reference> accepted_;
  std::uint64_t seen_ = 0, saturated_ = 0;
  double v_c_min_, v_c_max_;
  std::optional<std::uint64_t> blocked_at_;
};

}  // namespace weakgrid
