// What a recording holds of one unit's inputs: the samples of each plant that served it, and its references.
#pragma once

#include <algorithm>
#include <cstdint>
#include <deque>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "plant/model.hpp"

namespace weakgrid {

/// The samples of one plant process: the last ones, and every change of state.
struct PlantStream {
  std::string writer;
  std::uint64_t first_step = 0;
  std::deque<Measurement> samples;                          // steps rise
  std::vector<std::pair<std::uint64_t, UnitState>> states;  // from this step on

  std::vector<std::pair<std::uint64_t, std::uint64_t>> holes;  // steps never heard, from … to

  std::uint64_t last_step() const { return samples.empty() ? first_step : samples.back().step; }
  bool is_hole(std::uint64_t step) const { return holes_near(step, 0) > 0; }
  /// Within so many steps.
  std::size_t holes_near(std::uint64_t step, std::uint64_t distance) const {
    return static_cast<std::size_t>(std::count_if(holes.begin(), holes.end(), [&](const auto& hole) {
      return hole.first <= step + distance && step <= hole.second + distance;
    }));
  }
  const Measurement* find(std::uint64_t step) const {
    if (samples.empty() || step < samples.front().step) return nullptr;
    const std::uint64_t guess = step - samples.front().step;
    if (guess < samples.size() && samples[guess].step == step) return &samples[guess];
    const auto at = std::lower_bound(samples.begin(), samples.end(), step,
                                     [](const Measurement& m, std::uint64_t k) { return m.step < k; });
    return at != samples.end() && at->step == step ? &*at : nullptr;
  }
};

struct UnitInputs {
  static constexpr std::size_t samples_max = 1 << 15;

  std::deque<PlantStream> plants;  // in the order of appearance
  std::map<std::uint32_t, Reference> references;

  void see(const std::string& writer, const Measurement& m) {
    if (plants.empty() || plants.back().writer != writer) {
      // An old plant's last samples may come after a new one's first.
      const auto known = std::find_if(plants.begin(), plants.end(),
                                      [&](const PlantStream& plant) { return plant.writer == writer; });
      if (known == plants.end())
        plants.push_back({writer, m.step, {}, {}, {}});
      else
        return see(*known, m);
    }
    see(plants.back(), m);
  }

 private:
  static void see(PlantStream& plant, const Measurement& m) {
    std::deque<Measurement>& samples = plant.samples;
    if (samples.empty() || m.step > samples.back().step) {
      if (plant.states.empty() || plant.states.back().second != m.state)
        plant.states.emplace_back(m.step, m.state);
      if (!samples.empty() && m.step > samples.back().step + 1)
        plant.holes.emplace_back(samples.back().step + 1, m.step - 1);
      samples.push_back(m);
      if (samples.size() > samples_max) samples.pop_front();
      return;
    }
    // Sent again, or late.
    const auto at = std::lower_bound(samples.begin(), samples.end(), m.step,
                                     [](const Measurement& x, std::uint64_t k) { return x.step < k; });
    if (at->step != m.step) samples.insert(at, m);
  }
};

}  // namespace weakgrid
