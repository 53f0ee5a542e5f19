// Program: see the header.
#include "services/runtime/program.hpp"

#include <fmt/format.h>
#include <pthread.h>
#include <signal.h>
#include <spdlog/sinks/stdout_sinks.h>
#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <limits>

#include "services/runtime/announcer.hpp"
#include "services/runtime/service_manager.hpp"

namespace weakgrid {

namespace {

sigset_t stop_signals() {
  sigset_t set;
  sigemptyset(&set);
  sigaddset(&set, SIGINT);
  sigaddset(&set, SIGTERM);
  return set;
}

}  // namespace

StopSignal::StopSignal() {
  const sigset_t set = stop_signals();
  pthread_sigmask(SIG_BLOCK, &set, nullptr);
}

bool StopSignal::wait(std::chrono::milliseconds patience) {
  if (stopped_) return true;
  const sigset_t set = stop_signals();
  const timespec timeout{.tv_sec = patience.count() / 1000, .tv_nsec = patience.count() % 1000 * 1'000'000};
  stopped_ = sigtimedwait(&set, nullptr, &timeout) > 0;
  if (stopped_) tell_of_stopping();
  return stopped_;
}

void set_up_log(const std::string& name, const std::string& level) {
  auto log = std::make_shared<spdlog::logger>(name, std::make_shared<spdlog::sinks::stderr_sink_mt>());
  log->set_pattern("%Y-%m-%dT%H:%M:%S.%e %l %n: %v");
  log->set_level(spdlog::level::from_str(level));
  log->flush_on(spdlog::level::trace);
  spdlog::set_default_logger(log);
}

int report_exception(const std::string& program) {
  try {
    throw;
  } catch (const SettingsError& error) {
    fmt::print(stderr, "{}: {}\n", program, error.what());
    return exit_usage;
  } catch (const std::exception& error) {
    fmt::print(stderr, "{}: {}\n", program, error.what());
    return exit_world;
  }
}

int run_service(int argc, char** argv, const std::string& name, const std::string& description,
                const std::vector<ServiceOption>& options, const Serve& serve, const AddOptions& add) {
  CLI::App app(description, name);
  std::string file;
  std::string level = "info";
  std::optional<std::uint32_t> domain, unit;
  std::uint64_t instance = 0;
  app.set_version_flag("--version", build_text());
  app.add_option("--settings", file, "settings or scenario file, TOML; without it, all defaults");
  app.add_option("--domain", domain, "DDS domain, instead of the file's")->check(CLI::Range(0, 230));
  app.add_option("--unit", unit, "unit number, instead of the file's")->check(CLI::Range(1u, 4294967232u));
  app.add_option("--instance", instance, "identity in health and manifest, instead of a random one")
      ->check(CLI::Range(std::uint64_t{1}, std::numeric_limits<std::uint64_t>::max()));
  app.add_option("--log", level, "what is worth a line on stderr")
      ->check(CLI::IsMember({"debug", "info", "warning", "error"}))
      ->capture_default_str();
  for (const ServiceOption& option : options) app.add_option(option.name, *option.value, option.description);
  if (add) add(app);
  if (app.get_footer().empty())
    app.footer(
        fmt::format("Example: {} --settings deploy/settings/paper-weak.toml\n"
                    "Stops on SIGINT or SIGTERM. Exit: 0 done, 2 bad usage or settings, 3 the world failed.",
                    name));
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? exit_done : exit_usage;
  }
  try {
    set_up_log(name, level);
    Settings settings = file.empty() ? Settings{} : load_settings(file);
    settings.unit.domain = domain.value_or(settings.unit.domain);
    settings.unit.number = unit.value_or(settings.unit.number);
    settings.unit.instance = instance;
    StopSignal stop;
    serve(settings, stop);
    return exit_done;
  } catch (...) {
    return report_exception(name);
  }
}

}  // namespace weakgrid
