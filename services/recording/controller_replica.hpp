// One recorded controller process, re-executed: its samples and references into the pure controller, every
// bit of its answers compared.
#pragma once

#include <deque>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "controller/controller.hpp"
#include "services/recording/differences.hpp"
#include "services/recording/unit_inputs.hpp"

namespace weakgrid {

struct ControllerFindings {
  std::uint32_t unit = 0;
  std::string writer, build;
  std::uint64_t first_step = 0, last_step = 0;
  std::uint64_t compared = 0, identical = 0;  ///< modulations
  std::uint64_t states_compared = 0, states_identical = 0;
  std::uint64_t resumed = 0;  ///< times from a recorded state
  std::vector<Unchecked> unchecked;
  /// Other settings than the recorded ones: how far the answers are apart.
  double mu_distance_max = 0.0, mu_distance_squares = 0.0;
  std::uint64_t mu_distance_max_step = 0;
  std::uint64_t saturated_recorded = 0, saturated_computed = 0;
};

class ControllerReplica {
 public:
  struct Options {
    std::uint64_t from_step = 0;  ///< begin at the first recorded state from here on; 0 = at the start
    bool other_settings = false;  ///< differences are expected: measured, not listed
  };

  ControllerReplica(std::uint32_t unit, const std::string& writer, const UnitInputs& inputs,
                    DifferenceLog& differences, const Options& options);

  /// Before the first answer is processed; without it nothing is compared.
  void configure(const ControllerConfiguration& configuration, const std::string& build);
  bool is_configured() const { return controller_.has_value(); }

  void see(std::uint64_t sequence, const Modulation& modulation);
  void see(const ControllerState& state);
  /// A sample has come, whoever answers it: what this one has answered waits no longer than samples are kept.
  void note_sample();
  /// Compares what is old enough that all its inputs have been seen; all = there is no more to come.
  void process(bool all);

  const ControllerFindings& findings() const { return findings_; }
  /// Called with each sample answered, and the controller after it; for whoever plots.
  std::function<void(const Measurement&, const Modulation&, const Controller&)> watch;

 private:
  struct Answer {
    std::uint64_t sequence;
    Modulation modulation;
  };
  void process(const Answer& answer);
  bool fill_gap(const Answer& answer);
  const Measurement* sample_of(const Modulation& recorded);
  bool is_over(std::size_t plant) const;
  bool is_twin(const PlantStream& plant) const;
  bool is_answered(const Measurement& sample) const;
  bool is_lost(const Measurement& sample) const;
  using References = std::map<std::uint32_t, Reference>::const_iterator;
  bool accept_references(const Modulation& recorded, const Measurement* sample);
  References first_heard(References first, References last, const Measurement& sample,
                         const Modulation& recorded) const;
  void compare(const Modulation& recorded, const Modulation& computed);
  void meet_state(const Modulation& answer);
  void lose(const std::string& why);

  const UnitInputs& inputs_;
  DifferenceLog& differences_;
  const Options options_;
  std::optional<Controller> controller_;
  std::deque<Answer> answers_;          // by sequence
  std::deque<ControllerState> states_;  // by step, not yet met
  std::vector<std::uint64_t> ends_before_;  // last step of each plant when the first answer came
  std::size_t plant_ = 0;               // index of the plant listened to; the first that may be, if none is
  bool listens_ = false, changes_plant_ = false;
  bool are_orders_known_ = true;  // not: it joined late or was cut off; until its next state tells
  bool is_synced_ = false;
  std::size_t samples_since_answer_ = 0;
  bool has_begun_ = false;
  std::string lost_because_;
  std::uint64_t last_sequence_ = 0, last_step_ = 0;
  Measurement last_sample_;  // that was answered
  ControllerFindings findings_;
};

}  // namespace weakgrid
