// Hands out the samples of a recording when they are due: one thread reads ahead, one keeps the time. Knows
// no DDS.
#pragma once

#include <atomic>
#include <functional>
#include <mutex>
#include <string>
#include <thread>

#include "services/recording/replay_schedule.hpp"
#include "services/recording/replay_source.hpp"
#include "services/recording/ring.hpp"
#include "services/runtime/duration_histogram.hpp"
#include "services/runtime/pulse.hpp"

namespace weakgrid {

class Replayer {
 public:
  struct Counters {
    std::uint64_t messages = 0;  ///< handed out and sent
    std::uint64_t bytes = 0;     ///< of their payloads
    std::uint64_t late = 0;      ///< by more than 1 ms
    std::uint64_t unsent = 0;    ///< handed out, but refused
  };
  /// One call at a time, on one thread, in the order of the source; `in_time` = false: nobody keeps a pace,
  /// so the call may wait for those who read. False: not sent.
  using Publish = std::function<bool(const RawSample&, bool in_time)>;

  /// Begins to read, but not to hand out.
  Replayer(ReplaySource& source, double rate, bool paused, Publish publish);
  /// No call of publish is under way or comes after this.
  ~Replayer();
  Replayer(const Replayer&) = delete;
  Replayer& operator=(const Replayer&) = delete;

  /// Begins to hand out; once.
  void start();
  /// Asks it to end before the next message.
  void stop() { stopping_ = true; }
  /// Stops and waits until nothing is handed out or read any more.
  void end();
  bool is_stopping() const { return stopping_; }
  void command(const ReplayCommand& command);
  /// Within publish: it waits for somebody, and that is all right.
  void waits() noexcept { pulse_.beat(); }
  /// The thread that hands out has not moved since this was asked last.
  bool stands_still() { return pulse_.stands(); }

  bool has_ended() const { return ended_; }
  bool is_paused() const;
  /// Paused, and no step is left to be made.
  bool stands() const;
  /// In the recordings, from their first message.
  double position_s() const;
  Counters counters() const;

  // After end().
  const DurationHistogram& lateness() const { return lateness_; }  ///< of what was due at a time
  double duration_s() const { return static_cast<double>(last_ns_ - begun_ns_) * 1e-9; }
  /// Why the source gave out early; empty = it did not.
  const std::string& fault() const { return fault_; }

 private:
  void read_ahead();
  void play();
  std::int64_t due_ns(std::int64_t at_ns);
  bool wait_until_due(const RawSample& sample, std::int64_t& due);
  void hand_out(const RawSample& sample, std::int64_t due);

  ReplaySource& source_;
  const Publish publish_;
  SampleRing ring_;
  Pulse pulse_{Pulse::at_work};
  std::atomic<bool> stopping_{false}, all_read_{false}, ended_{false};
  std::atomic<std::uint64_t> messages_{0}, bytes_{0}, late_{0}, unsent_{0};
  std::string fault_;  // written before all_read_

  mutable std::mutex mutex_;
  ReplaySchedule schedule_;
  std::uint64_t steps_ = 0;  // to make though it is paused
  bool is_step_ = false;     // the message under way, of the playing thread

  // Of the thread that plays.
  DurationHistogram lateness_;
  std::int64_t begun_ns_ = 0, last_ns_ = 0;
  std::thread reader_, player_;
};

}  // namespace weakgrid
