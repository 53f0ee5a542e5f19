// A program as a child: it ends with this process, and when its stdin does.
#pragma once

#include <sys/types.h>

#include <chrono>
#include <optional>
#include <string>
#include <vector>

namespace weakgrid::bench {

class Child {
 public:
  /// arguments: the program's path first. Start it before anything of DDS lives in this process. Throws
  /// LinkError.
  explicit Child(std::vector<std::string> arguments);
  /// Closes its stdin, asks it to end, and waits for that.
  ~Child();
  Child(const Child&) = delete;
  Child& operator=(const Child&) = delete;

  /// Its exit status once it has ended, 128 + n by signal n; none: it still runs after `patience`.
  std::optional<int> wait(std::chrono::milliseconds patience);
  /// What it has written to stdout and stderr so far.
  std::string out() const { return contents(out_); }
  std::string err() const { return contents(err_); }

 private:
  static std::string contents(int file);

  pid_t pid_ = -1;
  int in_ = -1, out_ = -1, err_ = -1;
  std::optional<int> status_;
};

}  // namespace weakgrid::bench
