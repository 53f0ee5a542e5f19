// weakgrid latency: what this machine can do: wake up, go round Fast DDS, go round the loop, hold a rate.
#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <thread>

#include "services/cli/client.hpp"
#include "services/cli/commands.hpp"
#include "services/cli/processes.hpp"
#include "services/cli/stage_text.hpp"
#include "services/runtime/ping_pong.hpp"
#include "services/runtime/program.hpp"
#include "services/runtime/realtime.hpp"
#include "services/runtime/semaphore.hpp"
#include "services/runtime/time_grid.hpp"

namespace weakgrid {

namespace {

constexpr Patience to_start{30'000};
constexpr std::uint32_t periods_us[] = {50, 100, 200, 500, 1000};  // 20, 10, 5, 2, 1 kHz

struct Options {
  Where where;
  std::uint32_t domain = 230;
  double seconds = 2.0;
  std::uint32_t rounds = 3;
  double tolerated = 0.001;
  bool json = false, echo = false;
};

// A file of settings as long as it lives.
class SettingsFile {
 public:
  explicit SettingsFile(const Settings& settings)
      : path_(std::filesystem::temp_directory_path() / fmt::format("weakgrid_latency_{}.toml", getpid())) {
    std::ofstream file(path_);
    if (!(file << to_toml(settings) << std::flush))
      throw std::runtime_error(path_.string() +
                               ": cannot be written; is the disk full? TMPDIR names another place");
  }
  ~SettingsFile() {
    std::error_code ignored;
    std::filesystem::remove(path_, ignored);
  }
  SettingsFile(const SettingsFile&) = delete;
  SettingsFile& operator=(const SettingsFile&) = delete;
  std::string path() const { return path_.string(); }

 private:
  std::filesystem::path path_;
};

struct Held {
  std::uint32_t period_us = 0;
  std::uint64_t steps = 0, late = 0, overruns = 0;
  double share() const { return steps == 0 ? 1.0 : static_cast<double>(late) / static_cast<double>(steps); }
};

class Measurements {
 public:
  Measurements(const Settings& settings, const Options& options, StopSignal& stop)
      : settings_(settings), span_ns_(static_cast<std::int64_t>(options.seconds * 1e9)), stop_(stop) {}

  // Nobody's loop shall meet this one.
  void expect_nobody() {
    Client client(settings_.unit.domain, settings_.unit.number, settings_.dds);
    const bool in_use = client.wait_for(Patience(1500), [](const Client::Peers& peers) {
      return std::any_of(peers.begin(), peers.end(),
                         [](const auto& peer) { return peer.second.state != ServiceState::stopped; });
    });
    if (in_use)
      throw std::runtime_error(
          fmt::format("domain {} is in use: give another --domain", settings_.unit.domain));
  }

  // As a plant's loop that finds nothing to do.
  StageTiming wake_up() {
    Stage stage{"wake"};
    with_realtime([&] {
      const std::int64_t begin = monotonic_ns(), period = timing(settings_).period_ns;
      for (std::int64_t due = begin + period; due < begin + span_ns_;) {
        sleep_until(due);
        const std::int64_t late = monotonic_ns() - due;
        stage.durations.add(late);
        due += period * (1 + late / period);
      }
    });
    return only(stage);
  }

  StageTiming raw_round_trip() {
    const SettingsFile file(settings_);
    Processes processes;
    processes.start("weakgrid", {"latency", "--echo", "--settings", file.path()});
    Stage stage{"raw"};
    with_realtime([&] {
      Ping ping(settings_);
      meet([&] { return ping.is_matched(); });
      std::uint64_t step = 1;
      for (const std::int64_t end = monotonic_ns() + span_ns_; monotonic_ns() < end; ++step) {
        const std::int64_t begin = monotonic_ns();
        if (ping.exchange(step, to_timespec(begin + 20'000'000))) stage.durations.add(monotonic_ns() - begin);
      }
    });
    return only(stage);
  }

  // Of plant and controller, in lockstep: the stages that they tell of themselves.
  std::vector<StageTiming> loop() {
    Settings lockstep = settings_;
    lockstep.plant.pace = Pace::lockstep;
    return with_loop(lockstep,
                     [&](Client& client) {
                       wait();
                       return last_word(client, "plant");
                     })
        .timings;
  }

  // With the bridge off: what is measured is time, and held steps shall not trip it.
  Held hold(std::uint32_t period_us) {
    Settings bench = settings_;
    bench.timing.period_us = period_us;
    bench.plant.pace = Pace::realtime;
    bench.plant.overrun = Overrun::hold;
    bench.plant.starts_running = false;
    Held held{.period_us = period_us};
    with_loop(bench, [&](Client& client) {
      const Health before = last_word(client, "plant");
      wait();
      const Health after = last_word(client, "plant");
      held.steps = after.step - before.step;
      // A unit that is off counts no holds.
      for (const char* name : {"late_modulations", "missed_steps"})
        held.late += counter(after, name) - counter(before, name);
      held.overruns = counter(after, "overruns") - counter(before, "overruns");
      return after;
    });
    return held;
  }

 private:
  static StageTiming only(const Stage& stage) {
    const auto timings = timings_of({&stage, 1});
    if (timings.empty())
      throw std::runtime_error(
          "nothing came back over DDS: are the interfaces of [dds] up? Or give more --seconds");
    return timings.front();
  }

  // On a thread with what [realtime] asks for, and all that it makes inherits it.
  template <class Work>
  void with_realtime(Work work) {
    std::exception_ptr fault;
    std::thread([&] {
      try {
        const RealtimeSetup setup(settings_);
        sharpen_timers();
        work();
      } catch (...) {
        fault = std::current_exception();
      }
    }).join();
    if (fault) std::rethrow_exception(fault);
  }

  void meet(const std::function<bool()>& have_met) {
    const auto deadline = std::chrono::steady_clock::now() + to_start;
    while (!have_met()) {
      if (stop_.wait(Patience(5))) throw std::runtime_error("stopped by a signal");
      if (std::chrono::steady_clock::now() > deadline)
        throw std::runtime_error("the other end was not heard in 30 s: are the interfaces of [dds] up?");
    }
  }
  void wait() {
    if (stop_.wait(Patience(span_ns_ / 1'000'000))) throw std::runtime_error("stopped by a signal");
  }

  template <class Work>
  Health with_loop(const Settings& settings, Work work) {
    const SettingsFile file(settings);
    Processes processes;
    for (const char* program : {"weakgrid-controller", "weakgrid-plant"})
      processes.start(program, {"--settings", file.path(), "--log", "error"});
    Client client(settings.unit.domain, settings.unit.number, settings.dds);
    meet([&] {
      if (const std::string name = processes.ended(); !name.empty())
        throw std::runtime_error(name + " has ended by itself; its reason is above");
      return client.wait_for("plant", Patience(10), [](const Health& h) {
        return h.step > 0 && (h.state == ServiceState::running || h.state == ServiceState::blocked_by_trip);
      });
    });
    return work(client);
  }

  // What it says once a second, from now on.
  Health last_word(Client& client, const std::string& service) {
    const std::int64_t asked_ns = wall_time_ns();
    Health word;
    meet([&] {
      return client.wait_for(service, Patience(100), [&](const Health& h) {
        word = h;
        return h.wall_time_ns >= asked_ns;
      });
    });
    return word;
  }

  const Settings& settings_;
  const std::int64_t span_ns_;
  StopSignal& stop_;
};

// Of some rounds, each figure's median.
StageTiming median(const std::vector<StageTiming>& rounds) {
  StageTiming out = rounds.front();
  const auto of = [&](std::uint64_t StageTiming::*figure) {
    std::vector<std::uint64_t> values;
    for (const StageTiming& round : rounds) values.push_back(round.*figure);
    std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2),
                     values.end());
    out.*figure = values[values.size() / 2];
  };
  for (const auto figure : {&StageTiming::count, &StageTiming::p50_ns, &StageTiming::p99_ns,
                            &StageTiming::p999_ns, &StageTiming::max_ns})
    of(figure);
  return out;
}

int serve_echo(const Settings& settings, StopSignal& stop) {
  RealtimeSetup setup(settings);
  const Pong pong(settings);
  setup.loop_runs();
  while (!stop.wait(Patience(1000))) {
  }
  return exit_done;
}

int measure(const Options& options) {
  StopSignal stop;
  Settings settings = options.where.settings();
  settings.scenario.reset();
  settings.unit.count = 1;
  if (options.echo) return serve_echo(settings, stop);
  settings.unit.domain = options.domain;

  Measurements machine(settings, options, stop);
  machine.expect_nobody();
  const bool talks = isatty(STDERR_FILENO) != 0;
  const auto tell = [&](const std::string& what) {
    if (talks) fmt::print(stderr, "weakgrid latency: {}\n", what);
  };
  std::vector<StageTiming> wake, raw;
  std::map<std::string, std::vector<StageTiming>> loop;
  for (std::uint32_t round = 1; round <= options.rounds; ++round) {
    tell(fmt::format("round {} of {}", round, options.rounds));
    wake.push_back(machine.wake_up());
    raw.push_back(machine.raw_round_trip());
    for (const StageTiming& timing : machine.loop()) loop[timing.stage].push_back(timing);
  }
  if (loop["round_trip"].empty())
    throw std::runtime_error("plant and controller finished no step: give more --seconds");
  std::vector<Held> held;
  for (const std::uint32_t period_us : periods_us) {
    tell(fmt::format("real time at {} µs", period_us));
    held.push_back(machine.hold(period_us));
    if (held.back().share() <= options.tolerated) break;
  }
  const Held& best = held.back();
  const bool holds_any = best.share() <= options.tolerated;
  const StageTiming raw_trip = median(raw), our_trip = median(loop["round_trip"]);
  const double ratio = static_cast<double>(our_trip.p50_ns) / static_cast<double>(raw_trip.p50_ns);

  if (options.json) {
    nlohmann::json out{
        {"wake", to_json({median(wake)})[0]},
        {"raw_round_trip", to_json({raw_trip})[0]},
        {"round_trip", to_json({our_trip})[0]},
        {"ratio_p50", ratio},
        {"rates", nlohmann::json::array()},
        {"highest_rate_hz", holds_any ? nlohmann::json(1e6 / best.period_us) : nlohmann::json()}};
    for (const Held& h : held)
      out["rates"].push_back(
          {{"rate_hz", 1e6 / h.period_us}, {"steps", h.steps}, {"late", h.late}, {"overruns", h.overruns}});
    fmt::print("{}\n", out.dump(2));
  } else {
    fmt::print("{}", stage_head());
    fmt::print("{}", stage_line(fmt::format("wake-up at {} µs", settings.timing.period_us), median(wake)));
    fmt::print("{}", stage_line("Fast DDS there and back", raw_trip));
    fmt::print("{}", stage_line("loop there and back", our_trip));
    fmt::print("medians of {} rounds in turn; the loop takes {:.2f} × Fast DDS\n\n", options.rounds, ratio);
    for (const Held& h : held)
      fmt::print("at {:>5.0f} Hz: {} of {} steps late ({:.3f} %), {} overruns\n", 1e6 / h.period_us, h.late,
                 h.steps, 100.0 * h.share(), h.overruns);
    fmt::print("\n{}\n",
               holds_any
                   ? fmt::format("This machine holds {:.0f} Hz: at most {} % of the steps late",
                                 1e6 / best.period_us, 100.0 * options.tolerated)
                   : fmt::format("This machine holds none of these rates with at most {} % of the steps "
                                 "late",
                                 100.0 * options.tolerated));
  }
  return holds_any && best.period_us <= settings.timing.period_us ? exit_done : exit_no;
}

}  // namespace

Command add_latency(CLI::App& app) {
  auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand(
      "latency",
      "Tells what this machine can do: wake-up, Fast DDS and the loop side by side, the rate it holds.");
  command->add_option("--settings", options->where.file,
                      "settings, TOML: period, [realtime] and [dds] count");
  command->add_option("--domain", options->domain, "a DDS domain that nobody uses")
      ->check(CLI::Range(0, 230))
      ->capture_default_str();
  command->add_option("--seconds", options->seconds, "that each measurement lasts")
      ->check(CLI::Range(0.2, 3600.0))
      ->capture_default_str();
  command->add_option("--rounds", options->rounds, "that medians are taken of")
      ->check(CLI::Range(1, 1000))
      ->capture_default_str();
  command->add_option("--tolerated", options->tolerated, "share of late steps at a rate that is held")
      ->check(CLI::Range(0.0, 1.0))
      ->capture_default_str();
  command->add_flag("--json", options->json, "print JSON");
  command->add_flag("--echo", options->echo, "")->group("");  // the other end of a measurement
  command->footer(
      "Example: weakgrid latency --settings deploy/settings/realtime.toml\n"
      "Exit: 0 the rate of the settings is held, 1 it is not, 2 bad usage, 3 the world failed.");
  return [options] { return measure(*options); };
}

}  // namespace weakgrid
