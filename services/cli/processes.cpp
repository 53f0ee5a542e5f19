// Processes: see the header.
#include "services/cli/processes.hpp"

#include <fcntl.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <filesystem>
#include <stdexcept>
#include <thread>

namespace weakgrid {

Processes::~Processes() { stop(); }

void Processes::start(const std::string& program, const std::vector<std::string>& arguments) {
  const std::string path = std::filesystem::read_symlink("/proc/self/exe").parent_path() / program;
  if (access(path.c_str(), X_OK) != 0) throw std::runtime_error(path + ": not there or not executable");
  std::vector<char*> argv{const_cast<char*>(path.c_str())};
  for (const std::string& argument : arguments) argv.push_back(const_cast<char*>(argument.c_str()));
  argv.push_back(nullptr);
  const pid_t parent = getpid();
  const pid_t pid = fork();
  if (pid < 0) throw std::runtime_error("fork failed");
  if (pid == 0) {
    prctl(PR_SET_PDEATHSIG, SIGTERM);
    if (getppid() != parent) _exit(3);
    // Ctrl-C is for the parent, which stops its children in order.
    setpgid(0, 0);
    execv(path.c_str(), argv.data());
    _exit(3);
  }
  children_.push_back({program, pid});
}

bool Processes::reap(Child& child) {
  int status = 0;
  if (child.is_running && waitpid(child.pid, &status, WNOHANG) == child.pid) {
    child.is_running = false;
    child.ended_well = WIFEXITED(status) && WEXITSTATUS(status) == 0;
  }
  return !child.is_running;
}

std::string Processes::ended() {
  for (Child& child : children_)
    if (reap(child)) return child.name;
  return {};
}

bool Processes::stop() {
  for (Child& child : children_)
    if (!reap(child)) kill(child.pid, SIGTERM);
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(10);
  bool all_well = true;
  for (Child& child : children_) {
    while (!reap(child) && std::chrono::steady_clock::now() < deadline)
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
    if (child.is_running) {
      kill(child.pid, SIGKILL);
      waitpid(child.pid, nullptr, 0);
      child.is_running = false;
    }
    all_well = all_well && child.ended_well;
  }
  return all_well;
}

}  // namespace weakgrid
