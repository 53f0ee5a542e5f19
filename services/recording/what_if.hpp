// What if the controller had been set up otherwise: the recorded unit emulated once more, with other gains.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "controller/controller.hpp"
#include "services/runtime/settings.hpp"

namespace weakgrid {

/// How a unit fared. Per unit; errors are means of magnitudes over the steps.
struct LoopOutcome {
  std::uint64_t steps = 0, saturated = 0;
  double v_c_min = 0.0, v_c_max = 0.0, i_max = 0.0;
  double q_error = 0.0, v_c_error = 0.0;            ///< over all steps
  double q_error_last = 0.0, v_c_error_last = 0.0;  ///< over the last grid period
  std::optional<std::uint64_t> blocked_at;          ///< the first step at which the bridge was blocked
};

/// Fed with each step once, in order; what comes again is passed over.
class OutcomeGauge {
 public:
  void see(const Measurement& sample, const Modulation& answer, const ReferenceShaper::State& references,
           double omega);
  LoopOutcome outcome() const;

 private:
  LoopOutcome sums_;
  std::vector<std::pair<double, double>> last_;  // errors of q and v_c, a ring over one grid period
};

/// Steps, both included.
struct StepRange {
  std::uint64_t first = 0, last = 0;
};

/// What a recording tells of one unit's loop.
struct RecordedLoop {
  std::optional<Settings> plant;  ///< of the plant's manifest
  std::size_t plants = 0;         ///< processes that served as its plant
  std::uint64_t first_step = 0, last_step = 0;
  std::vector<std::pair<std::uint64_t, Reference>> accepted;  ///< from which step on the controller knew it
  /// In the order of steps: that the plant held, whether or not an answer came late, and that no answer is
  /// recorded of.
  std::vector<StepRange> held, unanswered;
};

/// Why that loop cannot be emulated once more; empty if it can.
std::string why_not(const RecordedLoop& loop);
/// The recorded plant, grid events, references and holds with another controller, which is shown what that
/// one was shown. The same bits as recorded if it is that one, no sample was lost, and the plant has not
/// blocked for a step that it missed itself.
LoopOutcome emulate(const RecordedLoop& loop, const ControllerConfiguration& controller);

}  // namespace weakgrid
