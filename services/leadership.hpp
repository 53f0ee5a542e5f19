// Of the two controllers of a unit, which one answers: by epochs that rise, so that who was thought dead and
// comes back is told apart. Knows no bus or clock.
#pragma once

#include <algorithm>
#include <chrono>
#include <cstdint>

#include "plant/model.hpp"

namespace weakgrid {

enum class Redundancy : std::uint8_t {
  none,    ///< alone: epoch 0, listens to no other
  first,   ///< leads from its start, unless another does already
  second,  ///< follows, unless nobody answers
};

class Leadership {
 public:
  using Time = std::chrono::steady_clock::time_point;

  /// How long who has never heard another waits for it at start.
  static constexpr std::chrono::seconds start_patience{2};
  /// Higher ones are nobody's.
  static constexpr std::uint64_t epoch_max = ~std::uint64_t{0} >> 1;

  /// takeover: samples that go unanswered for so long have lost their controller.
  Leadership(Redundancy which, std::chrono::nanoseconds takeover)
      : takeover_(takeover),
        leads_(which != Redundancy::second),
        epoch_(which == Redundancy::first ? 1 : 0) {}

  bool leads() const noexcept { return leads_; }
  std::uint64_t epoch() const noexcept { return epoch_; }

  /// Another's answer. False: it does not lead either.
  bool hear(const Modulation& answer) noexcept {
    if (answer.epoch < heard_epoch_ || answer.epoch > epoch_max || (leads_ && answer.epoch <= epoch_))
      return false;
    leads_ = false;
    has_heard_ = true;
    heard_epoch_ = answer.epoch;
    if (answer.step >= unanswered_) waits_ = false;
    return true;
  }

  /// A sample has come, and what was heard until now is known. True: it is to be answered here.
  bool answers(std::uint64_t step, Time now) noexcept {
    if (leads_) return true;
    // Who was stopped itself cannot tell who is silent. In lockstep samples come 20 ms apart then.
    const bool was_away = now - seen_ > std::max<std::chrono::nanoseconds>(2 * takeover_, away_at_least);
    seen_ = now;
    if (!waits_ || was_away || step < unanswered_) {
      waits_ = true;
      unanswered_ = step;
      since_ = now;
      return false;
    }
    if (now - since_ < (has_heard_ ? takeover_ : std::chrono::nanoseconds(start_patience))) return false;
    leads_ = true;
    waits_ = false;
    epoch_ = std::max(epoch_, heard_epoch_) + 1;
    return true;
  }

 private:
  static constexpr std::chrono::milliseconds away_at_least{50};

  const std::chrono::nanoseconds takeover_;
  bool leads_;
  std::uint64_t epoch_;  // its own, of when it last led
  bool has_heard_ = false;
  std::uint64_t heard_epoch_ = 0;
  bool waits_ = false;  // for another's answer to sample unanswered_, since since_
  std::uint64_t unanswered_ = 0;
  Time since_{}, seen_{};
};

}  // namespace weakgrid
