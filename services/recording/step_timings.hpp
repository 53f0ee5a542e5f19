// How long the loop's messages took, by the stamps in a recording: one unit's samples and their answers.
#pragma once

#include <cstdint>
#include <vector>

#include "services/runtime/duration_histogram.hpp"

namespace weakgrid {

class StepTimings {
 public:
  DurationHistogram interval;    ///< from one sample's publication to the next step's
  DurationHistogram turnaround;  ///< from a sample's publication to its answer's
  DurationHistogram arrival;     ///< from the publication of either to its arrival at the recorder

  /// Stamps in ns since the Unix epoch, of hosts whose clocks agree. Sent again: the first one counts.
  void see_sample(std::uint64_t step, std::uint64_t publish_ns, std::uint64_t log_ns) {
    arrival.add(static_cast<std::int64_t>(log_ns - publish_ns));
    Stamps& stamps = of(step);
    if (stamps.sample_ns != 0) return;
    stamps.sample_ns = publish_ns;
    note(stamps);
    const Stamps& before = stamps_[(step - 1) % kept];
    if (step > 0 && before.step == step - 1 && before.sample_ns != 0)
      interval.add(static_cast<std::int64_t>(publish_ns - before.sample_ns));
  }
  void see_answer(std::uint64_t step, std::uint64_t publish_ns, std::uint64_t log_ns) {
    arrival.add(static_cast<std::int64_t>(log_ns - publish_ns));
    Stamps& stamps = of(step);
    if (stamps.answer_ns != 0) return;
    stamps.answer_ns = publish_ns;
    note(stamps);
  }

 private:
  struct Stamps {
    std::uint64_t step = ~std::uint64_t{0};
    std::uint64_t sample_ns = 0, answer_ns = 0;
  };
  static constexpr std::size_t kept = 1 << 12;

  Stamps& of(std::uint64_t step) {
    Stamps& stamps = stamps_[step % kept];
    if (stamps.step != step) stamps = {step, 0, 0};
    return stamps;
  }
  // Sample and answer come by two readers, in either order.
  void note(const Stamps& stamps) {
    if (stamps.sample_ns != 0 && stamps.answer_ns != 0)
      turnaround.add(static_cast<std::int64_t>(stamps.answer_ns - stamps.sample_ns));
  }

  std::vector<Stamps> stamps_ = std::vector<Stamps>(kept);
};

}  // namespace weakgrid
