// weakgrid-recorder: everything that is written in a domain, into MCAP.
#include <fmt/chrono.h>
#include <fmt/format.h>
#include <signal.h>
#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <filesystem>
#include <thread>

#include "services/recording/recorder.hpp"
#include "services/runtime/announcer.hpp"
#include "services/runtime/program.hpp"
#include "services/runtime/service_manager.hpp"
#include "services/runtime/tap.hpp"

namespace weakgrid {
namespace {

struct Options {
  std::string output = ".";
  TopicFilter filter;
  std::vector<std::string> awaited;
  std::string compression = "zstd";
  std::string trigger;
  RecorderOptions recorder;
};

void add(CLI::App& app, Options& o) {
  app.add_option("-o,--output", o.output, "file to create, or folder for a file named by the time")
      ->capture_default_str();
  app.add_option("--topic", o.filter.topics,
                 "record these topics only; pattern with * and ?, may be repeated");
  app.add_option("--exclude", o.filter.excluded, "do not record these; wins over --topic");
  app.add_option("--await", o.awaited, "say \"running\" only when writers of these topics are heard");
  app.add_option("--compression", o.compression, "of the file")
      ->check(CLI::IsMember({"zstd", "lz4", "none"}))
      ->capture_default_str();
  app.add_option("--max-bytes", o.recorder.max_bytes, "begin another file at this size (default: never)");
  app.add_option("--max-seconds", o.recorder.max_seconds, "begin another file after this long")
      ->check(CLI::Range(1.0, 1e9));
  app.add_option("--min-free-bytes", o.recorder.min_free_bytes, "stop when less is free on the disk")
      ->capture_default_str();
  app.add_option("--ring-bytes", o.recorder.ring_bytes, "memory between receiving and writing")
      ->check(CLI::Range(std::size_t{1} << 16, std::size_t{1} << 32))
      ->capture_default_str();
  auto* before = app.add_option("--before", o.recorder.before_s,
                                "with --on: keep the last so many seconds in memory until then (\"10s\")");
  before->transform(
      CLI::AsNumberWithUnit(std::map<std::string, double>{{"s", 1.0}, {"ms", 1e-3}, {"min", 60.0}},
                            CLI::AsNumberWithUnit::Options::DEFAULT, "TIME"));
  auto* on =
      app.add_option("--on", o.trigger, "begin to write when a unit trips")->check(CLI::IsMember({"trip"}));
  before->needs(on);
  on->needs(before);
  app.add_option("--before-bytes", o.recorder.before_bytes, "memory that --before may take")
      ->check(CLI::Range(std::size_t{1} << 16, std::size_t{1} << 36))
      ->capture_default_str();
}

std::string path_of(const std::string& output) {
  if (!std::filesystem::is_directory(output)) return output;
  const std::time_t now = std::time(nullptr);
  return std::filesystem::path(output) / fmt::format("weakgrid_{:%Y%m%dT%H%M%SZ}.mcap", fmt::gmtime(now));
}

RecorderOptions recorder_options(const Options& o, const Settings& settings) {
  RecorderOptions out = o.recorder;
  out.path = path_of(o.output);
  out.compression = mcap::compression_named(o.compression == "none" ? "" : o.compression).value();
  out.version = WEAKGRID_VERSION;
  out.build = build_text();
  out.settings = to_toml(settings);
  return out;
}

class RecorderService {
 public:
  RecorderService(const Settings& settings, const Options& options)
      : awaited_(options.awaited),
        before_s_(options.recorder.before_s),
        recorder_(recorder_options(options, settings)),
        bus_(settings.unit.domain, settings.dds, Role::recorder),
        announcer_(bus_, settings, "recorder", {}),
        tap_(std::make_unique<Tap>(
            Tap::Options{.domain = settings.unit.domain,
                         .dds = settings.dds,
                         .filter = options.filter,
                         .writers_max = options.recorder.writers_max},
            [this](const SourceWriter& w) {
              recorder_.add(w);
              spdlog::info("hears {} of type {} from {}", w.topic, w.type, w.guid);
            },
            [this](const RawSample& s) { recorder_.put(s); })) {}

  /// Throws if recording has ended before it should.
  void serve(StopSignal& stop) {
    ServiceManager manager(
        {.status = [this] { return one_line({&announcer_.said()}); },
         .stuck = {[this] { return std::string(recorder_.stands() ? "the writing to the file" : ""); }}});
    while (!stop.wait(std::chrono::milliseconds(20))) {
      announcer_.say(health());
      report();
      manager.tell();
    }
    // What was sent before the signal is still on its way.
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
    tap_.reset();
    recorder_.close();
    const Recorder::Counters c = recorder_.counters();
    spdlog::info("stopped: {} messages of {} writers, {} missing, {} dropped", c.messages, c.writers,
                 c.missing, c.dropped);
    if (const std::string why = recorder_.stopped(); !why.empty())
      throw std::runtime_error(
          fmt::format("recording stopped: {}; {} messages after that are not recorded", why, c.after_stop));
  }

 private:
  Health health() {
    Health health;
    const std::string why = recorder_.stopped();
    const std::string waits_for = awaited();
    if (!why.empty()) {
      health.state = ServiceState::waiting;
      health.text = "recording stopped: " + why;
    } else if (!waits_for.empty()) {
      health.state = ServiceState::starting;
      health.text = "waits for a writer of " + waits_for;
    } else {
      health.state = ServiceState::running;
      if (recorder_.waits_for_trip()) health.text = fmt::format("waits for a trip, keeps {} s", before_s_);
    }
    const Recorder::Counters c = recorder_.counters();
    health.counters = {{"messages", c.messages},       {"bytes", c.bytes},
                       {"dropped", c.dropped},         {"missing", c.missing},
                       {"after_stop", c.after_stop},   {"writers", c.writers},
                       {"left_out", tap_->left_out()}, {"files", c.parts}};
    return health;
  }

  /// The first topic that must be heard and is not; once all are, that stands.
  std::string awaited() {
    while (!awaited_.empty() && tap_->hears(awaited_.back())) awaited_.pop_back();
    return awaited_.empty() ? "" : awaited_.back();
  }

  void report() {
    const std::string why = recorder_.stopped();
    if (!why.empty() && !told_) spdlog::error("recording stopped: {}", why);
    told_ = !why.empty();
    const auto now = std::chrono::steady_clock::now();
    if (now - reported_ < std::chrono::seconds(10)) return;
    reported_ = now;
    const Recorder::Counters c = recorder_.counters();
    spdlog::info("{} messages, file {} has {} bytes, {} missing, {} dropped", c.messages, c.parts,
                 c.file_bytes, c.missing, c.dropped);
  }

  std::vector<std::string> awaited_;
  const double before_s_;
  bool told_ = false;
  std::chrono::steady_clock::time_point reported_ = std::chrono::steady_clock::now();
  Recorder recorder_;
  Bus bus_;
  Announcer announcer_;
  std::unique_ptr<Tap> tap_;
};

}  // namespace
}  // namespace weakgrid

int main(int argc, char** argv) {
  using namespace weakgrid;
  // A file that may not grow further is a full disk to us, said by write().
  signal(SIGXFSZ, SIG_IGN);
  Options options;
  return run_service(
      argc, argv, "weakgrid-recorder",
      "Records every topic of a DDS domain to MCAP, also those of other programs.", {},
      [&](const Settings& settings, StopSignal& stop) { RecorderService(settings, options).serve(stop); },
      [&](CLI::App& app) { add(app, options); });
}
