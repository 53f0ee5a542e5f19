// What a service tells who manages it, by systemd's sd_notify protocol. Without NOTIFY_SOCKET nothing
// happens.
#pragma once

#include <chrono>
#include <functional>
#include <string>
#include <vector>

namespace weakgrid {

class ServiceManager {
 public:
  /// What there is to tell of a service; called by tell() alone.
  struct Work {
    std::function<std::string()> status;  ///< one line
    /// Each: what is under way and has not moved since the last call, in words; empty: all goes on.
    std::vector<std::function<std::string()>> stuck;
  };
  explicit ServiceManager(Work work);

  /// On the main loop, each time round, once the service serves: the first call says READY=1, later ones
  /// STATUS= when that has changed. WATCHDOG=1 four times in WATCHDOG_USEC, but only while nothing is stuck;
  /// this thread is not stuck while it calls.
  void tell();

 private:
  using Clock = std::chrono::steady_clock;
  void say_status(Clock::time_point now);
  void look(Clock::time_point now);

  const Work work_;
  const bool is_there_;
  Clock::duration watchdog_{};  // 0: none is set
  bool is_ready_ = false;
  std::string stuck_, status_;
  Clock::time_point said_{}, looked_{};
};

/// STOPPING=1.
void tell_of_stopping() noexcept;

}  // namespace weakgrid
