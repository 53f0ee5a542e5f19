// Replay schedule: see the header.
#include "services/recording/replay_schedule.hpp"

#include <algorithm>
#include <charconv>
#include <sstream>

namespace weakgrid {

namespace {

template <class Number>
std::optional<Number> number_of(const std::string& text) {
  Number number{};
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
  if (error != std::errc{} || end != text.data() + text.size()) return std::nullopt;
  return number;
}

}  // namespace

std::optional<double> parse_rate(const std::string& text) {
  if (text == "max") return rate_max;
  const auto rate = number_of<double>(text);
  // Beyond these the nanoseconds of a long recording would not fit.
  if (!rate || !(*rate >= 1e-6) || !(*rate <= 1e6)) return std::nullopt;
  return rate;
}

void ReplaySchedule::start(std::int64_t at_ns, std::int64_t now_ns) {
  at_ns_ = at_ns;
  clock_ns_ = now_ns;
}

std::int64_t ReplaySchedule::due_ns(std::int64_t at_ns) const {
  if (paused_) return never;
  if (is_at_once()) return at_once;
  return clock_ns_ + static_cast<std::int64_t>(static_cast<double>(at_ns - at_ns_) / rate_);
}

std::int64_t ReplaySchedule::position_ns(std::int64_t now_ns) const {
  if (paused_ || is_at_once()) return at_ns_;
  return at_ns_ + static_cast<std::int64_t>(static_cast<double>(now_ns - clock_ns_) * rate_);
}

void ReplaySchedule::pause(std::int64_t now_ns) {
  start(position_ns(now_ns), now_ns);
  paused_ = true;
}

void ReplaySchedule::resume(std::int64_t now_ns) {
  start(position_ns(now_ns), now_ns);
  paused_ = false;
}

void ReplaySchedule::set_rate(double rate, std::int64_t now_ns) {
  start(position_ns(now_ns), now_ns);
  rate_ = rate;
}

std::optional<ReplayCommand> parse_command(const std::string& line) {
  using Kind = ReplayCommand::Kind;
  std::istringstream words(line);
  std::string verb, value, more;
  words >> verb >> value >> more;
  if (!more.empty()) return std::nullopt;
  if (verb == "step") {
    const auto steps = value.empty() ? 1 : number_of<std::uint64_t>(value);
    if (!steps || *steps == 0) return std::nullopt;
    return ReplayCommand{.kind = Kind::step, .steps = *steps};
  }
  if (verb == "rate") {
    const auto rate = parse_rate(value);
    if (!rate) return std::nullopt;
    return ReplayCommand{.kind = Kind::rate, .rate = *rate};
  }
  if (!value.empty()) return std::nullopt;
  if (verb == "pause") return ReplayCommand{.kind = Kind::pause};
  if (verb == "resume") return ReplayCommand{.kind = Kind::resume};
  if (verb == "quit") return ReplayCommand{.kind = Kind::quit};
  return std::nullopt;
}

}  // namespace weakgrid
