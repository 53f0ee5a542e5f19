// Of the gateways of one unit that have no journal in common, which one serves: who does already; of two that
// begin in one moment, the one with the lower instance. Knows no bus or clock.
#pragma once

#include <chrono>

#include "services/runtime/messages.hpp"
#include "services/runtime/one_writer.hpp"

namespace weakgrid {

class Precedence {
 public:
  using Time = std::chrono::steady_clock::time_point;

  /// Who has not been asked for so long has stood still, and may have been replaced: a health comes every
  /// second, so that another begins 0.5 s after a service has stopped, at the earliest.
  static constexpr std::chrono::milliseconds absence{400};
  /// So long whoever starts or comes back listens first. Where it came back, its last order and authority stand.
  static constexpr std::chrono::milliseconds listening{200};

  Precedence(std::uint64_t instance, Time now) : instance_(instance), asked_(now), acts_from_(now + listening) {}

  void hear(const Health& health, Time now) noexcept {
    if (health.service != "gateway" || health.instance == instance_) return;
    if (health.state == ServiceState::running) {
      if (is_another_there(now) && health.instance > other_) return;
      other_ = health.instance;
      heard_ = now;
    } else if (health.instance == other_) {
      other_ = 0;
    }
  }

  enum class Change : std::uint8_t { none, begins, ends };

  /// To be asked at whatever happens. is_ready: nothing else keeps it from serving.
  Change ask(bool is_ready, Time now) noexcept {
    if (now - asked_ > absence) {
      acts_from_ = now + listening;
      if (serves_ && heard_ <= asked_) other_ = 0;             // heard before, it tells nothing of now
      if (!serves_ && is_another_there(asked_)) heard_ = now;  // it may have stood still, too
    }
    asked_ = now;
    const bool listens = now < acts_from_;
    if (serves_ && is_another_there(now) && (listens || other_ < instance_)) {
      serves_ = false;
      return Change::ends;
    }
    if (serves_ || listens || !is_ready || is_another_there(now)) return Change::none;
    serves_ = true;
    return Change::begins;
  }

  /// Since it was asked last.
  bool acts() const noexcept { return serves_ && asked_ >= acts_from_; }
  bool is_another_there(Time now) const noexcept { return other_ != 0 && now - heard_ < OneWriter::silence_max; }

 private:
  std::uint64_t instance_;
  std::uint64_t other_ = 0;  // that serves, 0: nobody
  Time heard_{}, asked_, acts_from_;
  bool serves_ = false;
};

}  // namespace weakgrid
