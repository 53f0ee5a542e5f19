// A round of a link between this process and a child of the same program.
#include <fmt/format.h>
#include <unistd.h>

#include <exception>
#include <filesystem>
#include <optional>
#include <thread>

#include "services/runtime/duration_histogram.hpp"
#include "services/runtime/realtime.hpp"
#include "services/runtime/time_grid.hpp"
#include "tests/bench/roundtrip/child.hpp"
#include "tests/bench/roundtrip/round.hpp"

namespace weakgrid::bench {

namespace {

constexpr std::chrono::milliseconds resend_after{20};  // as the plant in lockstep
constexpr std::chrono::seconds to_match{15};

Settings settings_of(const Conditions& conditions, int cpu) {
  Settings settings;
  settings.realtime.priority = conditions.priority;
  settings.realtime.cpu = cpu;
  settings.realtime.dma_latency = conditions.dma_latency;
  return settings;
}

// As the plant's exchange. False: the echo is gone.
bool round_trip(Caller& caller, std::uint64_t step, std::uint64_t& resends) {
  for (int n = 0; n < 250; ++n) {
    if (n > 0) ++resends;
    if (caller.exchange(step, monotonic_after(resend_after))) return true;
  }
  return false;
}

Figures measure(Caller& caller, const Conditions& conditions) {
  DurationHistogram histogram;
  Figures figures;
  const std::uint64_t warm_up = std::min<std::uint64_t>(conditions.count / 10 + 10, 1000);
  for (std::uint64_t step = 1; step <= warm_up + conditions.count; ++step) {
    if (step == warm_up + 1) figures.resends = 0;  // one end may have met the other before the other has
    const std::int64_t start = monotonic_ns();
    if (!round_trip(caller, step, figures.resends)) throw LinkError("no answer any more");
    if (step > warm_up) histogram.add(monotonic_ns() - start);
  }
  const auto us = [&](double share) { return static_cast<double>(histogram.quantile_ns(share)) * 1e-3; };
  figures.count = histogram.count();
  figures.p50 = us(0.5);
  figures.p99 = us(0.99);
  figures.p999 = us(0.999);
  figures.max = static_cast<double>(histogram.max_ns()) * 1e-3;
  return figures;
}

}  // namespace

std::string program_folder() {
  return std::filesystem::read_symlink("/proc/self/exe").parent_path().string();
}

Figures link_round(const Kind& kind, const Place& place, const Conditions& conditions) {
  Child echo({program_folder() + "/bench_roundtrip", "--echo", kind.name, "--domain",
              std::to_string(place.domain), "--memory", place.name, "--fifo",
              std::to_string(conditions.priority), "--cpu", std::to_string(conditions.cpus[0]),
              std::to_string(conditions.cpus[1])});
  RealtimeSetup realtime(settings_of(conditions, conditions.cpus[0]));
  const std::unique_ptr<Caller> caller = kind.make_caller(place);
  std::exception_ptr failure;
  Figures figures;
  std::thread loop([&] {
    try {
      const auto deadline = std::chrono::steady_clock::now() + to_match;
      while (!caller->is_matched()) {
        if (const auto status = echo.wait(std::chrono::milliseconds(5)))
          throw LinkError(fmt::format("the echo has ended with {}: {}", *status, echo.err()));
        if (std::chrono::steady_clock::now() >= deadline) throw LinkError("the two ends never met");
      }
      figures = measure(*caller, conditions);
    } catch (...) {
      failure = std::current_exception();
    }
  });
  realtime.loop_runs();
  loop.join();
  if (failure) std::rethrow_exception(failure);
  return figures;
}

void serve_echo(const Kind& kind, const Place& place, const Conditions& conditions) {
  RealtimeSetup realtime(settings_of(conditions, conditions.cpus[1]));
  const std::unique_ptr<Echo> echo = kind.make_echo(place);
  realtime.loop_runs();
  char byte = 0;
  while (read(STDIN_FILENO, &byte, 1) > 0) {
  }
}

}  // namespace weakgrid::bench
