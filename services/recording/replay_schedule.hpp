// When what of a recording is due, how late it was, and the commands that change it. Reads no clock.
#pragma once

#include <cmath>
#include <cstdint>
#include <limits>
#include <optional>
#include <string>

namespace weakgrid {

/// Recorded seconds in a second; infinity = everything at once.
inline constexpr double rate_max = std::numeric_limits<double>::infinity();
/// "2", "0.5", "max"; nothing for anything else than a number above 0.
std::optional<double> parse_rate(const std::string& text);

/// Recorded time ↔ a steady clock, both in ns. Every due time is computed from the last change of pace, so
/// errors of single waits do not add up.
class ReplaySchedule {
 public:
  ReplaySchedule(double rate, bool paused) : rate_(rate), paused_(paused) {}

  /// `at_ns` of the recording is now.
  void start(std::int64_t at_ns, std::int64_t now_ns);
  /// Never of the schedule is due while paused, what is past at once.
  std::int64_t due_ns(std::int64_t at_ns) const;
  /// Where in the recording the schedule is.
  std::int64_t position_ns(std::int64_t now_ns) const;

  void pause(std::int64_t now_ns);
  void resume(std::int64_t now_ns);
  void set_rate(double rate, std::int64_t now_ns);
  bool is_paused() const { return paused_; }
  bool is_at_once() const { return std::isinf(rate_); }

  static constexpr std::int64_t at_once = std::numeric_limits<std::int64_t>::min();
  static constexpr std::int64_t never = std::numeric_limits<std::int64_t>::max();

 private:
  double rate_;
  bool paused_;
  std::int64_t at_ns_ = 0, clock_ns_ = 0;  // these two are the same instant
};

struct ReplayCommand {
  enum class Kind : std::uint8_t { pause, resume, step, rate, quit };
  Kind kind = Kind::pause;
  std::uint64_t steps = 1;
  double rate = 1.0;
};
inline constexpr const char* replay_commands = "pause, resume, step [N], rate X|max, quit";
/// A line of `replay_commands`; nothing for any other.
std::optional<ReplayCommand> parse_command(const std::string& line);

}  // namespace weakgrid
