// Preloaded into one process: its CLOCK_REALTIME is the machine's plus what a file says, so that a test can
// step it while the process runs. Waits until a time of that clock follow each step, as the kernel's do.
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <semaphore.h>
#include <sys/mman.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

#include <atomic>
#include <cstdint>
#include <cstdlib>

namespace {

constexpr std::int64_t second_ns = 1'000'000'000, look_every_ns = 20'000'000;

// 0 where no file is named.
std::int64_t offset_ns() {
  static const std::atomic<std::int64_t>* const offset = []() -> const std::atomic<std::int64_t>* {
    static const std::atomic<std::int64_t> none{0};
    const char* path = std::getenv("WEAKGRID_CLOCK_OFFSET_FILE");
    const int file = path != nullptr ? open(path, O_RDONLY | O_CLOEXEC) : -1;
    if (file < 0) return &none;
    const void* page = mmap(nullptr, sizeof none, PROT_READ, MAP_SHARED, file, 0);
    close(file);
    return page == MAP_FAILED ? &none : static_cast<const std::atomic<std::int64_t>*>(page);
  }();
  return offset->load(std::memory_order_relaxed);
}

template <class Function>
Function* next(const char* name) {
  return reinterpret_cast<Function*>(dlsym(RTLD_NEXT, name));
}

std::int64_t to_ns(const timespec& t) { return t.tv_sec * second_ns + t.tv_nsec; }
timespec to_timespec(std::int64_t ns) { return {ns / second_ns, ns % second_ns}; }

int machine_time(clockid_t clock, timespec* time) {
  static const auto real = next<int(clockid_t, timespec*)>("clock_gettime");
  return real(clock, time);
}

// wait(until) of the machine's clock, in short goes, so that a step is noticed.
template <class Wait>
int wait_in_goes(const timespec& until, Wait wait) {
  for (;;) {
    timespec now;
    machine_time(CLOCK_REALTIME, &now);
    const std::int64_t due = to_ns(until) - offset_ns(), look = to_ns(now) + look_every_ns;
    const timespec next_look = to_timespec(due < look ? (due > 0 ? due : 0) : look);
    const int result = wait(next_look);
    if (result != ETIMEDOUT || due <= look) return result;
  }
}

// A condition variable may have been made for CLOCK_MONOTONIC, whose times are those since the machine's
// start.
bool is_of_realtime(const timespec& time) { return time.tv_sec > second_ns; }

}  // namespace

extern "C" {

int clock_gettime(clockid_t clock, timespec* time) noexcept {
  const int result = machine_time(clock, time);
  if (result == 0 && clock == CLOCK_REALTIME) *time = to_timespec(to_ns(*time) + offset_ns());
  return result;
}

int gettimeofday(timeval* __restrict time, void* __restrict) noexcept {
  timespec now;
  clock_gettime(CLOCK_REALTIME, &now);
  *time = {now.tv_sec, now.tv_nsec / 1000};
  return 0;
}

time_t time(time_t* out) noexcept {
  timespec now;
  clock_gettime(CLOCK_REALTIME, &now);
  if (out != nullptr) *out = now.tv_sec;
  return now.tv_sec;
}

int pthread_cond_clockwait(pthread_cond_t* condition, pthread_mutex_t* mutex, clockid_t clock,
                           const timespec* until) {
  static const auto real =
      next<int(pthread_cond_t*, pthread_mutex_t*, clockid_t, const timespec*)>("pthread_cond_clockwait");
  if (clock != CLOCK_REALTIME) return real(condition, mutex, clock, until);
  return wait_in_goes(*until, [&](const timespec& go) { return real(condition, mutex, clock, &go); });
}

int pthread_cond_timedwait(pthread_cond_t* condition, pthread_mutex_t* mutex, const timespec* until) {
  return pthread_cond_clockwait(condition, mutex, is_of_realtime(*until) ? CLOCK_REALTIME : CLOCK_MONOTONIC,
                                until);
}

int pthread_mutex_timedlock(pthread_mutex_t* mutex, const timespec* until) noexcept {
  static const auto real = next<int(pthread_mutex_t*, const timespec*)>("pthread_mutex_timedlock");
  return wait_in_goes(*until, [&](const timespec& go) { return real(mutex, &go); });
}

int sem_timedwait(sem_t* semaphore, const timespec* until) {
  static const auto real = next<int(sem_t*, const timespec*)>("sem_timedwait");
  const int result =
      wait_in_goes(*until, [&](const timespec& go) { return real(semaphore, &go) == 0 ? 0 : errno; });
  if (result == 0) return 0;
  errno = result;
  return -1;
}

}  // extern "C"
