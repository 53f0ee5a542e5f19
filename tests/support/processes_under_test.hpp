// The real programs as child processes, each test in a DDS domain of its own, settings files that go with the
// test. Nothing outlives a test: what still runs is killed, and dies with the test should that be killed
// itself.
#pragma once

#include <gtest/gtest.h>
#include <sys/types.h>

#include <chrono>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "tests/support/test_domain.hpp"

namespace weakgrid::test {

/// A file with this text as long as it lives.
class TextFile {
 public:
  explicit TextFile(const std::string& text);
  ~TextFile();
  TextFile(const TextFile&) = delete;
  TextFile& operator=(const TextFile&) = delete;
  const std::string& path() const { return path_; }

 private:
  std::string path_;
};

/// The path of a file of deploy/settings.
std::string shipped_settings(const std::string& name);

/// One program of the build, started at once; start it from a thread that lives as long as it shall. A
/// sanitizer's report on its stderr fails the test.
class Program {
 public:
  Program(const std::string& name, const std::vector<std::string>& arguments);
  ~Program();
  Program(const Program&) = delete;
  Program& operator=(const Program&) = delete;

  void send(int signal);
  /// Its exit status, 128 + n if signal n has ended it; none: it still runs after `patience`.
  std::optional<int> wait(milliseconds patience = long_enough);
  bool runs() { return !wait(milliseconds(0)); }
  /// kill -9, and gone.
  void kill();

  pid_t pid() const { return pid_; }
  /// It holds this signal back to take it in its own time.
  bool blocks(int signal) const;
  /// The processes that it has started and not yet reaped.
  std::vector<pid_t> children() const;

  /// What it has written so far.
  std::string out() const;
  std::string err() const;

 private:
  std::string name_;
  pid_t pid_ = -1;
  int out_ = -1, err_ = -1;
  std::optional<int> status_;
};

/// This process runs; one that has ended and waits to be reaped does not.
bool is_there(pid_t pid);

/// A program run to its end; a status of -1 if it had to be killed.
struct Ended {
  int status = -1;
  std::string out, err;
};
Ended run(const std::string& name, const std::vector<std::string>& arguments,
          milliseconds patience = long_enough);

/// plant, controller, gateway of one unit.
class Services {
 public:
  /// settings: path of a file.
  Services(const Domain& domain, const std::string& settings);

  /// Starts what a test has not, or has killed or stopped.
  Program& start(const std::string& service, const std::vector<std::string>& further = {});
  void start_all();
  Program& operator[](const std::string& service) { return *programs_.at(service); }

 private:
  std::vector<std::string> arguments_;
  std::map<std::string, std::unique_ptr<Program>> programs_;
};

}  // namespace weakgrid::test
