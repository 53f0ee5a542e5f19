// What figures show of a recording: signals of one unit over its steps, thinned as they are read, so that a
// recording may be of any length.
#pragma once

#include <limits>
#include <optional>
#include <string>
#include <vector>

#include "gateway/arbiter.hpp"
#include "services/recording/step_timings.hpp"
#include "services/recording/thinning.hpp"
#include "services/runtime/settings.hpp"

namespace weakgrid {

struct PlotSelection {
  std::vector<std::string> files;     ///< the parts of a recording in order
  std::optional<std::uint32_t> unit;  ///< none: the only one
  double from_s = 0.0;                ///< in the unit's time: step × period
  double until_s = std::numeric_limits<double>::infinity();
  bool reexecutes = true;  ///< what controllers do not publish is computed anew: v̂_p, p_r, q_r
};

struct PlotMark {
  double t_s;
  std::string text;
};

struct PlotSetpoint {
  double t_s;
  Setpoint setpoint;
  Verdict verdict;
};

/// Steps that are not in the recording.
struct PlotLoss {
  double from_s, until_s;
};

struct PlotData {
  static constexpr std::size_t losses_max = 200, marks_max = 24, setpoints_max = 200;

  std::uint32_t unit = 0;
  std::string title;           ///< of the scenario that was played, if one was
  double frequency_hz = 50.0;  ///< of the settings recorded
  std::uint64_t samples = 0;
  double first_s = 0.0, last_s = 0.0;  ///< of a sample
  double end_s = 0.0;                  ///< where the last one's period ends

  struct Signal {
    ThinnedSeries alpha, beta, magnitude;
    void add(std::uint64_t step, double t, SpaceVector value);
  };
  Signal v_p, v_p_hat, i;
  ThinnedSeries p, q, p_r, q_r, v_c;
  std::vector<PlotLoss> losses;  ///< the first ones
  std::vector<PlotMark> marks;   ///< trips and what the scenario did to the grid

  ThinnedPath path;  ///< p, q
  std::vector<PlotSetpoint> setpoints;
  std::optional<Settings> gateway;  ///< of the newest that has said them
  double standing_v_c = 0.0;        ///< of the newest reference, else of the settings

  StepTimings timings;

  std::vector<std::string> incomplete;  ///< what is missing or not drawn, a line each
};

/// Throws SettingsError for what is no recording, and where there is nothing to plot.
PlotData plot_data(const PlotSelection& selection);

}  // namespace weakgrid
