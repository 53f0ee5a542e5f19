// RealtimeSetup: see the header. To the calls of the scheduler, process 0 is the thread that calls.
#include "services/runtime/realtime.hpp"

#include <fcntl.h>
#include <malloc.h>
#include <spdlog/spdlog.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

namespace weakgrid {

RealtimeSetup::RealtimeSetup(const Settings& settings) : locks_memory_(settings.realtime.lock_memory) {
  policy_ = sched_getscheduler(0);
  sched_getparam(0, &parameters_);
  sched_getaffinity(0, sizeof processors_, &processors_);
  if (settings.realtime.priority > 0) schedule(static_cast<int>(settings.realtime.priority));
  if (settings.realtime.cpu >= 0) pin(settings.realtime.cpu);
  if (settings.realtime.dma_latency) hold_dma_latency();
}

RealtimeSetup::~RealtimeSetup() {
  if (dma_latency_ >= 0) close(dma_latency_);
}

void RealtimeSetup::schedule(int priority) {
  const sched_param wanted{.sched_priority = priority};
  if (sched_setscheduler(0, SCHED_FIFO, &wanted) == 0)
    spdlog::info("realtime: SCHED_FIFO {} for the loop", priority);
  else
    spdlog::warn(
        "realtime: priority {} is refused, {}: needs CAP_SYS_NICE or an rtprio limit of at least as much",
        priority, std::strerror(errno));
}

void RealtimeSetup::pin(int cpu) {
  cpu_set_t wanted;
  CPU_ZERO(&wanted);
  CPU_SET(static_cast<std::size_t>(cpu), &wanted);
  if (sched_setaffinity(0, sizeof wanted, &wanted) == 0)
    spdlog::info("realtime: the loop runs on processor {}", cpu);
  else
    spdlog::warn(
        "realtime: cpu {} is refused, {}: needs a processor of this machine's {} that its cpuset has", cpu,
        std::strerror(errno), sysconf(_SC_NPROCESSORS_ONLN));
}

void RealtimeSetup::hold_dma_latency() {
  constexpr const char* path = "/dev/cpu_dma_latency";
  const std::int32_t latency_us = 0;
  dma_latency_ = open(path, O_WRONLY | O_CLOEXEC);
  if (dma_latency_ >= 0 && write(dma_latency_, &latency_us, sizeof latency_us) == sizeof latency_us)
    spdlog::info("realtime: {} is held at 0", path);
  else
    spdlog::warn("realtime: dma_latency is refused, {}: needs leave to write {}, as root or by a udev rule",
                 std::strerror(errno), path);
}

void RealtimeSetup::loop_runs() {
  sched_setscheduler(0, policy_, &parameters_);
  sched_setaffinity(0, sizeof processors_, &processors_);
  if (locks_memory_) lock_memory();
}

// Last of all, so that a limit is met here and not by whoever needs memory later. Locked stacks are faulted
// in as a whole.
void RealtimeSetup::lock_memory() {
  // What is freed stays: getting it back from the kernel is a fault.
  mallopt(M_TRIM_THRESHOLD, -1);
  mallopt(M_MMAP_MAX, 0);
  if (mlockall(MCL_CURRENT | MCL_FUTURE) == 0)
    spdlog::info("realtime: memory is locked");
  else
    spdlog::warn("realtime: lock_memory is refused, {}: needs CAP_IPC_LOCK or an unlimited memlock limit",
                 std::strerror(errno));
}

void sharpen_timers() noexcept { prctl(PR_SET_TIMERSLACK, 1ul); }

}  // namespace weakgrid
