// weakgrid sweep: a scenario played many times, with some keys of its file varied.
#include <fmt/format.h>
#include <pthread.h>
#include <signal.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <exception>
#include <map>
#include <mutex>
#include <thread>
#include <vector>

#include "services/cli/commands.hpp"
#include "services/cli/sweep_row.hpp"
#include "services/runtime/program.hpp"
#include "services/sweep_file.hpp"

namespace weakgrid {

namespace {

using std::chrono::steady_clock;

struct Options {
  std::string file, output;
  std::vector<std::string> axes;
  std::optional<std::uint64_t> draws, seed;
  unsigned jobs = std::max(std::thread::hardware_concurrency(), 1u);
};

// The runs that are missing in the file, by as many threads as it is told. Each writes its row before it
// takes the next run, so a kill loses only what is under way. Threads differ in when, never in what they
// write.
class Workers {
 public:
  Workers(const SweepPlan& plan, SweepFile& file, unsigned jobs)
      : plan_(plan), file_(file), done_(file.done()) {
    for (std::uint64_t n = 0; n < plan.runs(); ++n)
      if (!file.has(n)) missing_.push_back(n);
    jobs = static_cast<unsigned>(std::min<std::size_t>(jobs, missing_.size()));
    running_ = jobs;
    for (unsigned k = 0; k < jobs; ++k) threads_.emplace_back([this] { work(); });
  }
  ~Workers() { stop(); }

  std::uint64_t done() const { return done_; }
  bool are_running() const { return running_ > 0; }
  /// After the runs under way.
  void stop() {
    stopping_ = true;
    for (std::thread& thread : threads_)
      if (thread.joinable()) thread.join();
  }
  void rethrow() const {
    if (failure_) std::rethrow_exception(failure_);
  }

 private:
  void work() {
    try {
      for (std::size_t k; !stopping_ && (k = next_++) < missing_.size();) {
        const std::string cells = sweep_cells(simulated(plan_.settings(missing_[k])));
        const std::lock_guard lock(mutex_);
        file_.append(missing_[k], cells);
        ++done_;
      }
    } catch (...) {
      const std::lock_guard lock(mutex_);
      if (!failure_) failure_ = std::current_exception();
      stopping_ = true;
    }
    --running_;
  }

  const SweepPlan& plan_;
  SweepFile& file_;
  std::vector<std::uint64_t> missing_;
  std::atomic<std::size_t> next_ = 0;
  std::atomic<std::uint64_t> done_;
  std::atomic<unsigned> running_ = 0;
  std::atomic<bool> stopping_ = false;
  std::mutex mutex_;  // of file_ and failure_
  std::exception_ptr failure_;
  std::vector<std::thread> threads_;
};

// One line that is written over and over, where a person may be looking.
class ProgressLine {
 public:
  ProgressLine(std::uint64_t done, std::uint64_t all) : before_(done), all_(all) {}
  ~ProgressLine() {
    if (shown_) fmt::print(stderr, "\r\x1b[K");
  }
  void show(std::uint64_t done) {
    const auto now = steady_clock::now();
    if (!is_terminal_ || now - shown_at_ < std::chrono::milliseconds(200)) return;
    shown_at_ = now;
    shown_ = true;
    const double rate =
        static_cast<double>(done - before_) / std::chrono::duration<double>(now - start_).count();
    fmt::print(stderr, "\r\x1b[K{} of {} runs, {:.1f}/s", done, all_, rate);
    if (rate > 0.0) fmt::print(stderr, ", {:.0f} s to go", static_cast<double>(all_ - done) / rate);
  }

 private:
  const std::uint64_t before_, all_;
  const bool is_terminal_ = isatty(STDERR_FILENO) != 0;
  const steady_clock::time_point start_ = steady_clock::now();
  steady_clock::time_point shown_at_ = start_;
  bool shown_ = false;
};

SweepPlan plan_of(const Options& options) {
  if (options.seed && !options.draws) throw SettingsError("--seed: only with --random");
  std::vector<Axis> axes;
  for (const std::string& text : options.axes) axes.push_back(parse_axis(text));
  std::optional<Draws> draws;
  if (options.draws) draws = Draws{*options.draws, options.seed.value_or(1)};
  return {load_scenario(options.file), std::move(axes), draws};
}

void say_endings(const SweepFile& file, std::uint64_t runs, const std::string& path) {
  std::map<std::string, std::uint64_t> counts;
  for (std::uint64_t n = 0; n < runs; ++n) ++counts[ending_of(file.cells(n))];
  std::string text;
  for (const auto& [ending, count] : counts)
    text += fmt::format("{} {} {}", text.empty() ? ":" : ",", count, ending);
  fmt::print("{}: {} runs{}\n", path, runs, text);
}

int sweep(const Options& options) {
  // A disk that is full is an error of write(), not the end.
  signal(SIGXFSZ, SIG_IGN);
  const SweepPlan plan = plan_of(options);
  SweepFile file(options.output, plan, WEAKGRID_VERSION, sweep_columns());
  if (file.done() > 0)
    fmt::print(stderr, "weakgrid: {}: {} of {} runs are there\n", options.output, file.done(), plan.runs());
  {
    StopSignal stop;
    Workers workers(plan, file, options.jobs);
    {
      ProgressLine line(workers.done(), plan.runs());
      while (workers.are_running() && !stop.wait(std::chrono::milliseconds(10))) line.show(workers.done());
    }
    if (workers.are_running()) {
      // A second signal does not wait for a long run: what is in the file is whole at any time.
      sigset_t blocked;
      sigemptyset(&blocked);
      sigaddset(&blocked, SIGINT);
      sigaddset(&blocked, SIGTERM);
      pthread_sigmask(SIG_UNBLOCK, &blocked, nullptr);
      fmt::print(stderr, "weakgrid: stopping after the runs under way\n");
    }
    workers.stop();
    workers.rethrow();
  }
  if (file.done() < plan.runs()) {
    fmt::print(stderr, "weakgrid: {}: {} of {} runs are there; the same command goes on\n", options.output,
               file.done(), plan.runs());
    return exit_no;
  }
  file.finish();
  say_endings(file, plan.runs(), options.output);
  return exit_done;
}

}  // namespace

Command add_sweep(CLI::App& app) {
  auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand(
      "sweep",
      "Plays a scenario many times without DDS, with keys of its file varied; a CSV row for each run.");
  command->add_option("SCENARIO", options->file, "scenario file, TOML")->required();
  command
      ->add_option("--vary", options->axes,
                   "KEY=a,b,c or KEY=from:to:step, with --random also KEY=from:to; may be repeated: all "
                   "combinations, the last key fastest")
      ->required()
      ->allow_extra_args(false);
  command->add_option("-o,--output", options->output, "CSV file; if it is there, the sweep goes on in it")
      ->required();
  command->add_option("--random", options->draws, "so many random draws instead of all combinations")
      ->check(CLI::Range(std::uint64_t{1}, SweepPlan::runs_max));
  command->add_option("--seed", options->seed, "of the draws (default: 1)");
  command->add_option("--jobs", options->jobs, "threads; what is written does not depend on it")
      ->check(CLI::Range(1u, 1024u))
      ->capture_default_str();
  command->footer(
      "Example: weakgrid sweep deploy/settings/paper-weak.toml --vary grid.reactance=0:0.4:0.05\n"
      "           --vary setpoint.active_power=-0.7,0.7 --vary 'controller.settling_times_s[2]=0.02,0.04' -o "
      "sweep.csv\n"
      "KEY: any of the settings file (services/README.md), items of lists counted from 0:\n"
      "scenario.event[0].value. setpoint.active_power, .reactive_power, .dc_voltage: of the last setpoint "
      "that "
      "has it.\n"
      "What the gateway refuses is a result. Interrupted or killed, the same command goes on.\n"
      "Exit: 0 all runs are there, 1 interrupted, 2 bad usage or input, or a file of another sweep, 3 the "
      "world "
      "failed.");
  return [options] { return sweep(*options); };
}

}  // namespace weakgrid
