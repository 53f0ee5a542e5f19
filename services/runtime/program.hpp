// What every program does around its own work: options, settings, signals, log, exit status.
#pragma once

#include <chrono>
#include <functional>
#include <optional>
#include <string>

#include "services/runtime/settings.hpp"

namespace CLI {
class App;
}

namespace weakgrid {

/// Exit status of every program.
inline constexpr int exit_done = 0;
inline constexpr int exit_no = 1;     ///< the answer is no: rejected, differs, unstable
inline constexpr int exit_usage = 2;  ///< bad usage or input
inline constexpr int exit_world = 3;  ///< the world failed

/// SIGINT and SIGTERM as something to ask for. Make it before any other thread: they inherit the blocked
/// signals.
class StopSignal {
 public:
  StopSignal();
  /// Waits at most `patience`; true once the program shall stop.
  bool wait(std::chrono::milliseconds patience);

 private:
  bool stopped_ = false;
};

/// The main function of a service: reads options and settings, sets up log and signals, runs `serve`, and
/// turns whatever it throws into one line on stderr and an exit status.
using Serve = std::function<void(const Settings&, StopSignal&)>;
struct ServiceOption {
  std::string name, description;
  std::optional<std::uint64_t>* value;
};
/// `add` puts options of any other kind on the command line; a footer that it sets stands.
using AddOptions = std::function<void(CLI::App&)>;
int run_service(int argc, char** argv, const std::string& name, const std::string& description,
                const std::vector<ServiceOption>& options, const Serve& serve, const AddOptions& add = {});

/// The name in the log and what is worth a line: "debug", "info", "warning", "error".
void set_up_log(const std::string& name, const std::string& level);

/// One line on stderr for the exception under way, and the exit status that fits.
int report_exception(const std::string& program);

}  // namespace weakgrid
