// The loop's two messages there and back over bare Fast DDS: what the middleware alone takes on this machine,
// laid out as plant and controller are.
#pragma once

#include <ctime>
#include <memory>

#include "services/runtime/bus.hpp"

namespace weakgrid {

/// Asks as a plant does: writes from its thread, sleeps, is woken by the answer. Throws BusError.
class Ping {
 public:
  explicit Ping(const Settings& settings);
  ~Ping();
  bool is_matched() const;
  /// Sends message number `step` and waits for its echo; false: none until the deadline, on CLOCK_MONOTONIC.
  bool exchange(std::uint64_t step, const timespec& deadline);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// Answers as a controller does, where the message arrives, as long as it lives. Throws BusError.
class Pong {
 public:
  explicit Pong(const Settings& settings);
  ~Pong();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace weakgrid
