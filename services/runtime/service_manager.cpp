// ServiceManager: see the header.
#include "services/runtime/service_manager.hpp"

#include <spdlog/spdlog.h>
#include <systemd/sd-daemon.h>

#include <cstdlib>
#include <utility>

namespace weakgrid {

namespace {

constexpr auto between_statuses = std::chrono::milliseconds(100);

// systemd takes anything up to a newline.
std::string one_line(std::string text) {
  for (char& c : text)
    if (c == '\n') c = ' ';
  return text;
}

}  // namespace

ServiceManager::ServiceManager(Work work)
    : work_(std::move(work)), is_there_(std::getenv("NOTIFY_SOCKET") != nullptr) {
  std::uint64_t watchdog_us = 0;
  if (is_there_ && sd_watchdog_enabled(0, &watchdog_us) > 0)
    watchdog_ = std::chrono::microseconds(watchdog_us);
}

void ServiceManager::tell() {
  if (!is_there_) return;
  const auto now = Clock::now();
  if (!is_ready_) {
    is_ready_ = true;
    sd_notify(0, "READY=1");
    looked_ = now;
  }
  if (now - said_ >= between_statuses) say_status(now);
  if (watchdog_.count() > 0 && now - looked_ >= watchdog_ / 4) look(now);
}

void ServiceManager::say_status(Clock::time_point now) {
  said_ = now;
  std::string status = one_line(stuck_.empty() ? work_.status() : "stands still: " + stuck_);
  if (status == status_) return;
  status_ = std::move(status);
  sd_notify(0, ("STATUS=" + status_).c_str());
}

// Not told at one look may be told at the next, a quarter later: who stands for longer than the rest is
// stopped.
void ServiceManager::look(Clock::time_point now) {
  looked_ = now;
  std::string stuck;
  for (const auto& stuck_part : work_.stuck)  // each is asked: it remembers
    if (const std::string words = stuck_part(); !words.empty()) stuck = words;
  if (stuck != stuck_ && !stuck.empty()) spdlog::error("stands still: {}", stuck);
  stuck_ = std::move(stuck);
  if (stuck_.empty()) sd_notify(0, "WATCHDOG=1");
}

void tell_of_stopping() noexcept { sd_notify(0, "STOPPING=1\nSTATUS=stopping"); }

}  // namespace weakgrid
