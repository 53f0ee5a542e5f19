// RunRecord: see the header.
#include "services/run_record.hpp"

#include <algorithm>
#include <cmath>

#include "gateway/steady_state.hpp"

namespace weakgrid {

RunRecord::RunRecord(const Settings& settings)
    : settings_(settings),
      end_step_(step_at(settings, settings.scenario ? settings.scenario->end_s : 0.0)),
      window_(step_at(settings, 1.0 / settings.converter.frequency_hz)),
      mean_gain_(1.0),
      v_c_min_(settings.converter.dc_voltage),
      v_c_max_(settings.converter.dc_voltage) {
  if (settings.timing.sampling == Sampling::period_mean) {
    // The mean of a turning vector over a period is shorter by sinc(ωT/2).
    const double half = 0.5 * converter(settings).omega * period_s(timing(settings));
    mean_gain_ = half / unit_phasor(half).im;
  }
  samples_.reserve(window_);
}

void RunRecord::see(const Measurement& m) {
  if (m.step >= end_step_) return;
  ++seen_;
  v_c_min_ = std::min(v_c_min_, m.v_c);
  v_c_max_ = std::max(v_c_max_, m.v_c);
  if (m.blocked && !blocked_at_) blocked_at_ = m.step;
  if (m.step + window_ < end_step_) return;
  const SpaceVector v_p = mean_gain_ * m.v_p, i = mean_gain_ * m.i;
  const SpaceVector s = power(v_p, i);
  samples_.push_back({s.re, s.im, m.v_c, abs(v_p), abs(i)});
}

void RunRecord::see(const Modulation& modulation) {
  if ((modulation.status & saturated) != 0) ++saturated_;
}

void RunRecord::see(const Decision& decision) {
  if (decision.reference) accepted_.push_back(*decision.reference);
}

RunRecord::Summary RunRecord::summary() const {
  // Where grid and source stand at the end, from the scenario and the references alone.
  const std::vector<Event> timeline = events(settings_);
  Surroundings surroundings(grid(settings_), timeline);
  Setpoint standing{0.0, 0.0, settings_.converter.dc_voltage};
  for (const Reference& reference : accepted_) {
    surroundings.advance_to(reference.effective_step);
    surroundings.dispatch(reference.p, reference.effective_step, reference.ramp_steps);
    standing = {reference.p, reference.q, reference.v_c};
  }
  surroundings.advance_to(end_step_);
  const Grid& g = surroundings.grid();
  const double omega = converter(settings_).omega;
  const SteadyState expected =
      steady_state({g.R_g, omega * g.L_g}, g.V, {surroundings.source_power(), standing.q});

  Summary summary;
  summary.tolerance = settings_.timing.hold == Hold::turning ? 1e-3 : 1e-2;
  summary.has_steady_state = expected.exists;
  summary.v_c_min = v_c_min_;
  summary.v_c_max = v_c_max_;
  summary.saturated = saturated_;
  summary.missed = end_step_ - std::min(seen_, end_step_);
  summary.blocked_at = blocked_at_;
  bool all_agree = expected.exists && 2 * samples_.size() > window_ && !blocked_at_;
  const auto add = [&](const char* name, double Sample::*field, double closed_form) {
    Quantity quantity{.name = name, .closed_form = closed_form};
    for (const Sample& sample : samples_) quantity.settled += sample.*field;
    quantity.settled /= static_cast<double>(std::max<std::size_t>(samples_.size(), 1));
    const double scale = std::max(std::abs(closed_form), 0.1);
    for (const Sample& sample : samples_) {
      quantity.swing = std::max(quantity.swing, std::abs(sample.*field - quantity.settled) / scale);
      quantity.deviation = std::max(quantity.deviation, std::abs(sample.*field - closed_form));
    }
    quantity.difference = std::abs(quantity.settled - closed_form) / scale;
    quantity.agrees = quantity.difference <= summary.tolerance && quantity.swing <= 10.0 * summary.tolerance;
    all_agree = all_agree && quantity.agrees;
    summary.quantities.push_back(quantity);
  };
  add("active power p", &Sample::p, surroundings.source_power());
  add("reactive power q", &Sample::q, standing.q);
  add("DC voltage v_c", &Sample::v_c, standing.v_c);
  add("PCC voltage |v_p|", &Sample::v_p, expected.exists ? abs(expected.v_p) : 0.0);
  add("current |i|", &Sample::i, expected.exists ? abs(expected.i) : 0.0);
  summary.settled = all_agree;
  return summary;
}

}  // namespace weakgrid
