// Child: see the header.
#include "tests/bench/roundtrip/child.hpp"

#include <fcntl.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <thread>

#include "tests/bench/roundtrip/link.hpp"

namespace weakgrid::bench {

Child::Child(std::vector<std::string> arguments)
    : out_(memfd_create("stdout", MFD_CLOEXEC)), err_(memfd_create("stderr", MFD_CLOEXEC)) {
  int ends[2];
  if (access(arguments[0].c_str(), X_OK) != 0) throw LinkError(arguments[0] + ": cannot be started");
  if (out_ < 0 || err_ < 0 || pipe2(ends, O_CLOEXEC) != 0) throw LinkError("no pipe for a child");
  std::vector<char*> argv;
  for (std::string& argument : arguments) argv.push_back(argument.data());
  argv.push_back(nullptr);
  const pid_t parent = getpid();
  pid_ = fork();
  if (pid_ < 0) throw LinkError("fork failed");
  if (pid_ == 0) {
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    if (getppid() != parent) _exit(127);
    dup2(ends[0], STDIN_FILENO);
    dup2(out_, STDOUT_FILENO);
    dup2(err_, STDERR_FILENO);
    close_range(3, ~0u, 0);
    execv(argv[0], argv.data());
    _exit(127);
  }
  close(ends[0]);
  in_ = ends[1];
}

Child::~Child() {
  close(in_);
  if (!wait(std::chrono::milliseconds(500))) kill(pid_, SIGTERM);
  if (!wait(std::chrono::seconds(10))) kill(pid_, SIGKILL);
  while (!wait(std::chrono::seconds(1))) {
  }
  close(out_);
  close(err_);
}

std::optional<int> Child::wait(std::chrono::milliseconds patience) {
  const auto deadline = std::chrono::steady_clock::now() + patience;
  for (;;) {
    int status = 0;
    if (!status_ && waitpid(pid_, &status, WNOHANG) == pid_)
      status_ = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
    if (status_ || std::chrono::steady_clock::now() >= deadline) return status_;
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
}

// pread leaves alone the offset, which is the program's too.
std::string Child::contents(int file) {
  struct stat about {};
  fstat(file, &about);
  std::string text(static_cast<std::size_t>(about.st_size), '\0');
  const ssize_t read = pread(file, text.data(), text.size(), 0);
  text.resize(read > 0 ? static_cast<std::size_t>(read) : 0);
  return text;
}

}  // namespace weakgrid::bench
