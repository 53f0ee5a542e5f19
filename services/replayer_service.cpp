// weakgrid-replayer: recordings, back into a DDS domain with their spacing.
#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <charconv>
#include <nlohmann/json.hpp>

#include "services/recording/command_lines.hpp"
#include "services/recording/replay_target.hpp"
#include "services/recording/replayer.hpp"
#include "services/runtime/announcer.hpp"
#include "services/runtime/program.hpp"
#include "services/runtime/service_manager.hpp"

namespace weakgrid {
namespace {

using Clock = std::chrono::steady_clock;
using std::chrono::milliseconds;

constexpr milliseconds to_look_around{1500};
constexpr milliseconds tick{20};
constexpr milliseconds readers_stand_for{300};
constexpr milliseconds to_be_taken{2000};

struct Options {
  std::vector<std::string> files;
  ReplaySelection selection;
  double until_s = 0.0;
  double wait_s = 2.0;
  std::string rate = "1";
  bool step = false, interactive = false, mix = false, json = false;
  const CLI::Option* domain = nullptr;
  const CLI::Option* loop = nullptr;
  const CLI::Option* unit = nullptr;
  const CLI::Option* settings = nullptr;
};

std::string rate_fault(const std::string& text) {
  return parse_rate(text) ? "" : text + ": allowed is 0.000001 … 1000000, or max";
}

std::string loop_fault(const std::string& text) {
  std::uint64_t passes = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), passes);
  const bool good = error == std::errc{} && end == text.data() + text.size() && passes > 0;
  return good ? "" : text + ": allowed is 1, 2, … or nothing for ever";
}

// How often to play. For an option without its value CLI11 asks no check.
std::uint64_t passes_of(const CLI::Option& loop) {
  if (loop.count() == 0) return 1;
  const std::string& text = loop.results().front();
  return loop_fault(text).empty() ? std::stoull(text) : 0;
}

void add(CLI::App& app, Options& o) {
  const auto seconds = CLI::Range(0.0, 1e8);
  app.add_option("RECORDING", o.files, "MCAP files; several are played as one, by their times")->required();
  app.add_option("--topic", o.selection.filter.topics,
                 "replay these recorded topics only; pattern with * and ?, may be repeated")
      ->allow_extra_args(false);
  app.add_option("--exclude", o.selection.filter.excluded, "do not replay these; wins over --topic")
      ->allow_extra_args(false);
  app.add_option("--remap", o.selection.remaps, "FROM=TO: write recorded topic FROM as TO, may be repeated")
      ->allow_extra_args(false);
  app.add_option("--rate", o.rate,
                 "recorded seconds in a second; max: as fast as readers of reliable topics take it, others "
                 "may lose")
      ->check(rate_fault)
      ->capture_default_str();
  app.add_option("--start", o.selection.start_s, "leave out what comes before, s from the first message")
      ->check(seconds);
  app.add_option_function<double>(
         "--until", [&o](double s) { o.selection.until_s = s; },
         "leave out what comes then and later, likewise")
      ->check(seconds);
  o.loop = app.add_option("--loop", "play so many times; without a number, for ever")
               ->expected(0, 1)
               ->type_name("[N]")
               ->check(loop_fault);
  app.add_flag("--step", o.step, "begin paused, and read commands from stdin");
  app.add_flag("--interactive", o.interactive, fmt::format("read commands from stdin: {}", replay_commands));
  app.add_flag("--mix", o.mix, "write also where somebody else writes the same topics");
  app.add_option("--wait", o.wait_s, "at most so many seconds for readers before the first message")
      ->check(CLI::Range(0.0, 3600.0))
      ->capture_default_str();
  app.add_flag("--json", o.json, "print JSON");
  o.domain =
      app.get_option("--domain")
          ->description("DDS domain to write into, instead of the recorded one + 100 (- 100 beyond 229)");
  o.unit = app.get_option("--unit")->description("unit of its own health, instead of the recorded one");
  o.settings = app.get_option("--settings")->description("settings file, TOML: of it [dds] counts");
  app.footer(
      "Example: weakgrid-replayer run.mcap --rate 0.5 --exclude 'weakgrid/health'\n"
      "Refuses a domain where others write a topic that is replayed, unless --mix. Health and manifest of\n"
      "programs that write nothing else, as a recorder's, do not count.\n"
      "Stops on SIGINT or SIGTERM. Exit: 0 done, 2 bad usage or recording, 3 the world failed.");
}

/// The settings in force: of the recording, but for where and as whom.
Settings settings_of(const Settings& given, const Options& options, const ReplaySource& source) {
  Settings settings = given;
  const auto& recorded = source.settings();
  if (recorded && options.unit->count() == 0 && options.settings->count() == 0)
    settings.unit.number = recorded->unit.number;
  if (options.domain->count() != 0) return settings;
  if (!recorded)
    throw SettingsError(options.files.front() +
                        ": does not say in which domain it was recorded; give --domain, 0 … 230");
  settings.unit.domain = replay_domain(recorded->unit.domain);
  spdlog::info("recorded in domain {}, replays into domain {}", recorded->unit.domain, settings.unit.domain);
  return settings;
}

class ReplayerService {
 public:
  ReplayerService(const Settings& settings, const Options& options, ReplaySource& source)
      : options_(options),
        source_(source),
        domain_(settings.unit.domain),
        target_(domain_, settings.dds),
        settings_(settings) {}

  void serve(StopSignal& stop) {
    if (!options_.mix) {
      if (stop.wait(to_look_around)) return;
      target_.refuse_company(source_.writers());
    }
    target_.make_writers(source_.writers());
    bus_.emplace(domain_, settings_.dds, Role::replayer);
    announcer_.emplace(*bus_, settings_, "replayer", std::vector<Constant>{});
    const double rate = parse_rate(options_.rate).value();
    Replayer replayer(source_, rate, options_.step, [&](const RawSample& sample, bool in_time) {
      const bool sent = target_.write(sample);
      if (!in_time)
        target_.keep_window([&] {
          replayer.waits();
          return !replayer.is_stopping();
        });
      return sent;
    });
    if (wait_for_readers(stop)) return;
    replayer.start();
    play(replayer, stop);
    finish(replayer);
  }

 private:
  /// True: stop.
  bool wait_for_readers(StopSignal& stop) {
    const auto begun = Clock::now();
    auto changed = begun;
    int matched = 0;
    Health starting;
    starting.text = "waits for readers";
    const std::chrono::duration<double> patience(options_.wait_s);
    while (Clock::now() - begun < patience && (matched == 0 || Clock::now() - changed < readers_stand_for)) {
      announcer_->say(starting);
      if (stop.wait(tick)) return true;
      if (const int now = target_.matched(); now != matched) {
        matched = now;
        changed = Clock::now();
      }
    }
    spdlog::info("{} writers, {} matches with readers", source_.writers().size(), target_.matched());
    return false;
  }

  void play(Replayer& replayer, StopSignal& stop) {
    CommandLines lines;
    bool stood = false;
    ServiceManager manager(
        {.status = [this] { return one_line({&announcer_->said()}); },
         .stuck = {[&] { return std::string(replayer.stands_still() ? "the handing out" : ""); }}});
    while (!replayer.has_ended()) {
      if (stop.wait(tick)) replayer.stop();
      if (options_.step || options_.interactive)
        lines.read([&](const std::string& line) {
          const auto command = parse_command(line);
          if (command)
            replayer.command(*command);
          else
            spdlog::warn("'{}' is no command; allowed: {}", line, replay_commands);
        });
      const bool stands = replayer.stands();
      if (stands && lines.has_ended()) {
        spdlog::warn("stdin has ended while paused: nobody can resume");
        replayer.stop();
      }
      if (stands && !stood) spdlog::info("{}", standing(replayer));
      stood = stands;
      announcer_->say(health(replayer));
      manager.tell();
    }
  }

  static std::string standing(const Replayer& replayer) {
    return fmt::format("paused at {:.6f} s after {} messages", replayer.position_s(),
                       replayer.counters().messages);
  }

  static Health health(const Replayer& replayer) {
    Health health;
    const bool stands = replayer.stands();
    health.state = stands ? ServiceState::waiting : ServiceState::running;
    if (stands) health.text = standing(replayer);
    const Replayer::Counters c = replayer.counters();
    health.counters = {{"messages", c.messages}, {"bytes", c.bytes}, {"late", c.late}, {"unsent", c.unsent}};
    return health;
  }

  void finish(Replayer& replayer) {
    const auto deadline = Clock::now() + to_be_taken;
    if (!target_.wait_until_taken([deadline] { return Clock::now() < deadline; }))
      spdlog::warn("some reader has not taken everything within {} s", to_be_taken.count() / 1000);
    // A reader that hears of a writer's end before its last samples drops them.
    std::this_thread::sleep_for(milliseconds(100));
    Health ended = health(replayer);
    ended.text = "ended";
    announcer_->say(ended);
    replayer.end();
    if (const std::uint64_t skipped = source_.chunks_skipped(); skipped != 0)
      spdlog::warn("{} damaged chunks were not replayed", skipped);
    print(replayer);
    if (!replayer.fault().empty()) throw SettingsError(replayer.fault());
  }

  void print(const Replayer& replayer) const {
    const Replayer::Counters c = replayer.counters();
    const DurationHistogram& late = replayer.lateness();
    const double median = 1e-3 * static_cast<double>(late.quantile_ns(0.5)),
                 p99 = 1e-3 * static_cast<double>(late.quantile_ns(0.99));
    if (options_.json) {
      nlohmann::json timing;
      if (late.count() != 0)
        timing = {{"median", median}, {"p99", p99}, {"max", 1e-3 * static_cast<double>(late.max_ns())}};
      const nlohmann::json report{{"domain", domain_},        {"messages", c.messages},
                                  {"bytes", c.bytes},         {"duration_s", replayer.duration_s()},
                                  {"late", c.late},           {"unsent", c.unsent},
                                  {"timing_error_us", timing}};
      fmt::print("{}\n", report.dump(2));
      return;
    }
    fmt::print("{} messages, {} bytes of payload in {:.3f} s into domain {}; {} late, {} unsent\n",
               c.messages, c.bytes, replayer.duration_s(), domain_, c.late, c.unsent);
    if (late.count() != 0)
      fmt::print("timing error: median {:.1f} us, p99 {:.1f} us, max {:.1f} us\n", median, p99,
                 1e-3 * static_cast<double>(late.max_ns()));
  }

  const Options& options_;
  ReplaySource& source_;
  const std::uint32_t domain_;
  ReplayTarget target_;
  const Settings settings_;
  std::optional<Bus> bus_;
  std::optional<Announcer> announcer_;
};

}  // namespace
}  // namespace weakgrid

int main(int argc, char** argv) {
  using namespace weakgrid;
  Options options;
  return run_service(
      argc, argv, "weakgrid-replayer", "Plays recordings back into a DDS domain, with their spacing.", {},
      [&](const Settings& given, StopSignal& stop) {
        options.selection.passes = passes_of(*options.loop);
        ReplaySource source(options.files, options.selection);
        for (const std::string& warning : source.warnings()) spdlog::warn("{}", warning);
        ReplayerService(settings_of(given, options, source), options, source).serve(stop);
      },
      [&](CLI::App& app) { add(app, options); });
}
