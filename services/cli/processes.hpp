// Services as child processes: started together, stopped together, never left behind.
#pragma once

#include <sys/types.h>

#include <string>
#include <vector>

namespace weakgrid {

class Processes {
 public:
  Processes() = default;
  Processes(const Processes&) = delete;
  Processes& operator=(const Processes&) = delete;
  /// Stops what still runs.
  ~Processes();

  /// Starts `program` from the folder of this executable; it gets SIGTERM should this process die. Call
  /// before the first bus is made: a forked participant is broken. Throws std::runtime_error.
  void start(const std::string& program, const std::vector<std::string>& arguments);

  /// The name of a program that has ended by itself, empty while all run.
  std::string ended();

  /// SIGTERM to all, SIGKILL to what is left after 10 s. True: all ended with exit status 0.
  bool stop();

 private:
  struct Child {
    std::string name;
    pid_t pid;
    bool is_running = true;
    bool ended_well = false;
  };
  bool reap(Child& child);

  std::vector<Child> children_;
};

}  // namespace weakgrid
