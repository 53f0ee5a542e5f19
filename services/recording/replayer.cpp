// Replayer: see the header.
#include "services/recording/replayer.hpp"

#include <sys/prctl.h>
#include <time.h>

#include <algorithm>
#include <chrono>

namespace weakgrid {

namespace {

using namespace std::chrono_literals;

// Room for the largest message that our recorder writes (16 MiB), wherever in the ring it comes to lie.
constexpr std::size_t ahead_bytes = 40 << 20;
constexpr std::size_t payload_bytes_max = 16 << 20;
// How long a pause or a stop may take to be noticed in a long wait.
constexpr std::int64_t slice_ns = 20'000'000;
constexpr std::int64_t late_ns = 1'000'000;

std::int64_t clock_ns() {
  timespec now{};
  clock_gettime(CLOCK_MONOTONIC, &now);
  return std::int64_t{now.tv_sec} * 1'000'000'000 + now.tv_nsec;
}

void sleep_until(std::int64_t at_ns) {
  const timespec at{.tv_sec = at_ns / 1'000'000'000, .tv_nsec = at_ns % 1'000'000'000};
  clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &at, nullptr);
}

}  // namespace

Replayer::Replayer(ReplaySource& source, double rate, bool paused, Publish publish)
    : source_(source),
      publish_(std::move(publish)),
      ring_(ahead_bytes, source.writers().size()),
      schedule_(rate, paused),
      reader_([this] { read_ahead(); }) {}

Replayer::~Replayer() { end(); }

void Replayer::end() {
  stopping_ = true;
  if (reader_.joinable()) reader_.join();
  if (player_.joinable()) player_.join();
}

void Replayer::start() {
  player_ = std::thread([this] { play(); });
}

void Replayer::command(const ReplayCommand& command) {
  using Kind = ReplayCommand::Kind;
  const std::int64_t now = clock_ns();
  const std::lock_guard lock(mutex_);
  switch (command.kind) {
    case Kind::pause:
      schedule_.pause(now);
      break;
    case Kind::resume:
      schedule_.resume(now);
      break;
    case Kind::rate:
      schedule_.set_rate(command.rate, now);
      break;
    case Kind::step:
      schedule_.pause(now);
      break;
    case Kind::quit:
      stopping_ = true;
      break;
  }
  if (command.kind == Kind::step)
    steps_ += command.steps;
  else if (command.kind != Kind::rate)
    steps_ = 0;
}

bool Replayer::is_paused() const {
  const std::lock_guard lock(mutex_);
  return schedule_.is_paused();
}

bool Replayer::stands() const {
  const std::lock_guard lock(mutex_);
  return schedule_.is_paused() && steps_ == 0;
}

double Replayer::position_s() const {
  const std::lock_guard lock(mutex_);
  return static_cast<double>(schedule_.position_ns(clock_ns())) * 1e-9;
}

Replayer::Counters Replayer::counters() const {
  return {.messages = messages_, .bytes = bytes_, .late = late_, .unsent = unsent_};
}

void Replayer::read_ahead() {
  try {
    while (!stopping_) {
      const auto sample = source_.next();
      if (!sample) break;
      if (sample->payload.size() > payload_bytes_max)
        throw SettingsError(source_.writers()[sample->writer].topic + ": a message of " +
                            std::to_string(sample->payload.size()) + " bytes; at most " +
                            std::to_string(payload_bytes_max) + " are replayed");
      while (!stopping_ && !ring_.put(*sample)) std::this_thread::sleep_for(2ms);
    }
  } catch (const std::exception& error) {
    fault_ = error.what();
  }
  all_read_ = true;
}

void Replayer::play() {
  // The default slack of 50 us would be added to every wait.
  prctl(PR_SET_TIMERSLACK, 1);
  while (!stopping_) {
    pulse_.beat();
    const bool all_read = all_read_;  // asked before the ring: what was put before that is in it
    const auto sample = ring_.front();
    if (!sample) {
      if (all_read) break;
      std::this_thread::sleep_for(200us);
      continue;
    }
    if (begun_ns_ == 0) {
      const std::lock_guard lock(mutex_);
      begun_ns_ = last_ns_ = clock_ns();
      schedule_.start(sample->reception_ns, begun_ns_);
    }
    std::int64_t due = 0;
    if (!wait_until_due(*sample, due)) break;
    hand_out(*sample, due);
    ring_.drop_front();
    // Only now: who sees that it stands shall find the message counted.
    const std::lock_guard lock(mutex_);
    if (is_step_ && steps_ > 0) --steps_;
  }
  ended_ = true;
}

/// at_once also for a step.
std::int64_t Replayer::due_ns(std::int64_t at_ns) {
  const std::lock_guard lock(mutex_);
  const std::int64_t due = schedule_.due_ns(at_ns);
  const bool steps = due == ReplaySchedule::never && steps_ > 0;
  is_step_ = steps;
  if (!steps && due != ReplaySchedule::at_once) return due;
  schedule_.start(at_ns, clock_ns());  // there is where it stands now
  return ReplaySchedule::at_once;
}

bool Replayer::wait_until_due(const RawSample& sample, std::int64_t& due) {
  while (!stopping_) {
    pulse_.beat();
    due = due_ns(sample.reception_ns);
    const std::int64_t now = clock_ns();
    if (due <= now) return true;
    sleep_until(std::min(due, now + slice_ns));
  }
  return false;
}

void Replayer::hand_out(const RawSample& sample, std::int64_t due) {
  const bool in_time = due != ReplaySchedule::at_once;
  last_ns_ = clock_ns();
  if (in_time) {
    lateness_.add(std::max<std::int64_t>(last_ns_ - due, 0));
    if (last_ns_ - due > late_ns) late_.fetch_add(1, std::memory_order_relaxed);
  }
  if (!publish_(sample, in_time)) {
    unsent_.fetch_add(1, std::memory_order_relaxed);
    return;
  }
  messages_.fetch_add(1, std::memory_order_relaxed);
  bytes_.fetch_add(sample.payload.size(), std::memory_order_relaxed);
}

}  // namespace weakgrid
