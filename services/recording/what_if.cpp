// What if: see the header.
#include "services/recording/what_if.hpp"

#include <algorithm>
#include <cmath>

#include "plant/emulator.hpp"

namespace weakgrid {

void OutcomeGauge::see(const Measurement& m, const Modulation& answer,
                       const ReferenceShaper::State& references, double omega) {
  const std::uint64_t k = sums_.steps;
  const double q_error = std::abs(power(m.v_p, m.i).im - references.q.at(m.step).value);
  const double v_c_error = std::abs(m.v_c - references.v_c.at(m.step).value);
  if (k == 0) {
    sums_.v_c_min = sums_.v_c_max = m.v_c;
    last_.resize(static_cast<std::size_t>(std::lround(2.0 * pi / omega / period_s(m.timing))));
  }
  ++sums_.steps;
  if ((answer.status & saturated) != 0) ++sums_.saturated;
  sums_.v_c_min = std::min(sums_.v_c_min, m.v_c);
  sums_.v_c_max = std::max(sums_.v_c_max, m.v_c);
  sums_.i_max = std::max(sums_.i_max, abs(m.i));
  if (m.blocked && !sums_.blocked_at) sums_.blocked_at = m.step;
  sums_.q_error += q_error;
  sums_.v_c_error += v_c_error;
  last_[k % last_.size()] = {q_error, v_c_error};
}

LoopOutcome OutcomeGauge::outcome() const {
  LoopOutcome outcome = sums_;
  if (outcome.steps == 0) return outcome;
  outcome.q_error /= static_cast<double>(outcome.steps);
  outcome.v_c_error /= static_cast<double>(outcome.steps);
  const std::size_t n = std::min<std::size_t>(last_.size(), outcome.steps);
  for (std::size_t k = 0; k < n; ++k) {
    outcome.q_error_last += last_[k].first / static_cast<double>(n);
    outcome.v_c_error_last += last_[k].second / static_cast<double>(n);
  }
  return outcome;
}

std::string why_not(const RecordedLoop& loop) {
  if (!loop.plant) return "no manifest tells the plant's settings";
  if (loop.plants > 1) return "the plant was restarted";
  if (loop.first_step != 0) return "the recording does not begin with the plant's first step";
  if (!loop.plant->plant.starts_running) return "the unit was started by an operation";
  return {};
}

namespace {

bool is_in(const std::vector<StepRange>& ranges, std::uint64_t step) {
  const auto at = std::upper_bound(ranges.begin(), ranges.end(), step,
                                   [](std::uint64_t k, const StepRange& r) { return k < r.first; });
  return at != ranges.begin() && step <= std::prev(at)->last;
}

}  // namespace

LoopOutcome emulate(const RecordedLoop& loop, const ControllerConfiguration& configuration) {
  const std::vector<Event> timeline = events(*loop.plant);
  Emulator emulator(emulator_configuration(*loop.plant), timeline);
  Controller controller(configuration);
  OutcomeGauge gauge;
  auto next = loop.accepted.begin();
  for (std::uint64_t k = 0; k <= loop.last_step; ++k) {
    for (; next != loop.accepted.end() && next->first <= k; ++next) {
      emulator.accept(next->second);
      controller.accept(next->second);
    }
    const bool is_held = is_in(loop.held, k);
    if (is_held && is_in(loop.unanswered, k)) {
      emulator.advance(std::nullopt);
      continue;
    }
    const Measurement sample = emulator.sample();
    const Modulation answer = controller.step(sample);
    gauge.see(sample, answer, controller.state().references, configuration.converter.omega);
    emulator.advance(is_held ? std::nullopt : command(answer));
  }
  return gauge.outcome();
}

}  // namespace weakgrid
