// What a service says of itself: its health at each change and at least once a second, its manifest once.
#pragma once

#include <chrono>
#include <cstdint>
#include <string>
#include <vector>

#include "services/runtime/bus.hpp"
#include "services/runtime/messages.hpp"
#include "services/runtime/settings.hpp"
#include "services/runtime/stage_timings.hpp"

namespace weakgrid {

/// A random number, not 0, that tells one start of a program from another.
std::uint64_t random_identity();
/// CLOCK_REALTIME, ns since 1970.
std::int64_t wall_time_ns();
/// Version and compiler of this program.
std::string build_text();
/// SHA-256, hexadecimal, over all fields but the digest, the unit's number included.
std::string digest_of(std::uint32_t unit, const Manifest& manifest);

/// What a unit's lines in the log begin with: nothing where it is its process's only one.
std::string name_in_log(const Settings& settings);

/// What units are at, in one line: "running", or "3 running, 1 tripped: overcurrent at step 12".
std::string one_line(const std::vector<const Health*>& units);

/// A topic that an Announcer writes, and so every program.
bool is_announced(const std::string& topic);

class Announcer {
 public:
  Announcer(Bus& bus, const Settings& settings, const std::string& service, std::vector<Constant> constants);
  /// Says goodbye.
  ~Announcer();

  /// Fills in service, if it has none, instance and time; writes what differs from the last word in more than
  /// step and counters, or in a step that stands still between two calls, or is a second old.
  void say(Health health, std::span<const Stage> stages = {}) noexcept;

  /// What it has said last; of the thread that says it.
  const Health& said() const { return last_; }
  /// As its health and manifest say.
  std::uint64_t instance() const { return instance_; }

 private:
  Writer<Health> health_;
  Writer<Manifest> manifest_;
  std::string service_;
  std::uint64_t instance_;
  Health last_;
  std::uint64_t seen_step_ = 0;  // at the last call
  std::chrono::steady_clock::time_point said_{};
};

}  // namespace weakgrid
