// Domain: see the header.
#include "tests/support/test_domain.hpp"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <filesystem>
#include <stdexcept>
#include <thread>

namespace weakgrid::test {

namespace {

constexpr milliseconds between_looks{2};

}  // namespace

bool wait_until(const std::function<bool()>& condition, milliseconds patience) {
  const auto deadline = std::chrono::steady_clock::now() + patience;
  while (!condition()) {
    if (std::chrono::steady_clock::now() >= deadline) return false;
    std::this_thread::sleep_for(between_looks);
  }
  return true;
}

Domain::Domain() {
  constexpr std::uint32_t first = 215, count = 15;
  static std::uint32_t taken = 0;
  const auto takes_one = [this] {
    number_ = first + (static_cast<std::uint32_t>(getpid()) * 7 + taken++) % count;
    const auto path = std::filesystem::temp_directory_path() / ("weakgrid-test-domain-" + text() + ".lock");
    // In two goes: the kernel may refuse O_CREAT for a file in /tmp that another user has made.
    lock_ = open(path.c_str(), O_RDONLY | O_CLOEXEC);
    if (lock_ < 0) lock_ = open(path.c_str(), O_RDONLY | O_CREAT | O_CLOEXEC, 0666);
    if (lock_ >= 0 && flock(lock_, LOCK_EX | LOCK_NB) == 0) return true;
    if (lock_ >= 0) close(lock_);
    return false;
  };
  if (!wait_until(takes_one)) throw std::runtime_error("no DDS domain is free for a test");
}

Domain::~Domain() { close(lock_); }

}  // namespace weakgrid::test
