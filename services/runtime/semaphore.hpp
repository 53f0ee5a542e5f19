// A POSIX semaphore: wakes a waiting thread without a lock, with an absolute deadline.
// Not std::counting_semaphore: its timed wait may sleep through a release in GCC 12's library (GCC PR
// 104928).
#pragma once

#include <semaphore.h>

#include <chrono>
#include <ctime>

namespace weakgrid {

class Semaphore {
 public:
  Semaphore() { sem_init(&semaphore_, 0, 0); }
  ~Semaphore() { sem_destroy(&semaphore_); }
  Semaphore(const Semaphore&) = delete;
  Semaphore& operator=(const Semaphore&) = delete;

  void post() noexcept { sem_post(&semaphore_); }
  void wait() noexcept {
    while (sem_wait(&semaphore_) != 0) {
    }
  }
  /// Forgets what was posted.
  void drain() noexcept {
    while (sem_trywait(&semaphore_) == 0) {
    }
  }
  /// False: the deadline has come.
  bool wait_until(const timespec& deadline) noexcept {
    return sem_clockwait(&semaphore_, CLOCK_MONOTONIC, &deadline) == 0;
  }

 private:
  sem_t semaphore_;
};

/// The time on CLOCK_MONOTONIC in `span`.
inline timespec monotonic_after(std::chrono::nanoseconds span) noexcept {
  timespec now{};
  clock_gettime(CLOCK_MONOTONIC, &now);
  const std::int64_t ns = now.tv_nsec + span.count();
  return {.tv_sec = now.tv_sec + ns / 1'000'000'000, .tv_nsec = ns % 1'000'000'000};
}

}  // namespace weakgrid
