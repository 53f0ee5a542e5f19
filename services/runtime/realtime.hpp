// What a loop asks of the machine so that its threads wake in time. All of it is optional, none of it can
// stop a service: what is refused is said once, with what would help.
#pragma once

#include <sched.h>

#include "services/runtime/settings.hpp"

namespace weakgrid {

/// Scheduling is inherited by threads and cannot be given to those of Fast DDS otherwise: make it before the
/// bus, on the thread that makes the bus.
class RealtimeSetup {
 public:
  /// From here on this thread, and those that it starts, have the priority and the processor of the settings.
  /// Holds /dev/cpu_dma_latency at 0 as long as it lives: waking a processor that sleeps deeply takes
  /// longest.
  explicit RealtimeSetup(const Settings& settings);
  ~RealtimeSetup();
  RealtimeSetup(const RealtimeSetup&) = delete;
  RealtimeSetup& operator=(const RealtimeSetup&) = delete;

  /// All threads of the loop run: this one, which only tells of them, has again what it had before; memory is
  /// locked with every stack in it.
  void loop_runs();

 private:
  void schedule(int priority);
  void pin(int cpu);
  void hold_dma_latency();
  void lock_memory();

  const bool locks_memory_;
  int dma_latency_ = -1;  // file
  int policy_ = SCHED_OTHER;
  sched_param parameters_{};
  cpu_set_t processors_{};
};

/// For a thread that sleeps by absolute times: timers end within 1 ns of it, not within the usual 50 µs.
void sharpen_timers() noexcept;

}  // namespace weakgrid
