// Processes under test: see the header.
#include "tests/support/processes_under_test.hpp"

#include <fcntl.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <stdexcept>
#include <thread>

namespace weakgrid::test {

namespace {

// fstat and pread leave alone the offset, which is the program's too.
std::string contents(int file) {
  struct stat about {};
  fstat(file, &about);
  std::string text(static_cast<std::size_t>(about.st_size), '\0');
  const ssize_t read = pread(file, text.data(), text.size(), 0);
  text.resize(read > 0 ? static_cast<std::size_t>(read) : 0);
  return text;
}

}  // namespace

TextFile::TextFile(const std::string& text)
    : path_((std::filesystem::temp_directory_path() / "weakgrid-test-XXXXXX").string()) {
  const int file = mkstemp(path_.data());
  const ssize_t size = static_cast<ssize_t>(text.size());
  if (file < 0 || write(file, text.data(), text.size()) != size)
    throw std::runtime_error(path_ + ": cannot be written");
  close(file);
}

TextFile::~TextFile() { unlink(path_.c_str()); }

std::string shipped_settings(const std::string& name) { return WEAKGRID_SETTINGS_FOLDER "/" + name; }

Program::Program(const std::string& name, const std::vector<std::string>& arguments)
    : name_(name), out_(memfd_create("stdout", MFD_CLOEXEC)), err_(memfd_create("stderr", MFD_CLOEXEC)) {
  const std::string path = WEAKGRID_PROGRAM_FOLDER "/" + name;
  if (out_ < 0 || err_ < 0 || access(path.c_str(), X_OK) != 0)
    throw std::runtime_error(path + ": cannot be started");
  std::vector<char*> argv{const_cast<char*>(path.c_str())};
  for (const std::string& argument : arguments) argv.push_back(const_cast<char*>(argument.c_str()));
  argv.push_back(nullptr);
  const pid_t parent = getpid();
  pid_ = fork();
  if (pid_ < 0) throw std::runtime_error("fork failed");
  if (pid_ > 0) return;
  // The test may be a DDS peer with many threads: system calls only until exec, and none of its sockets kept.
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  if (getppid() != parent) _exit(127);
  dup2(out_, STDOUT_FILENO);
  dup2(err_, STDERR_FILENO);
  close_range(3, ~0u, 0);
  execv(path.c_str(), argv.data());
  _exit(127);
}

Program::~Program() {
  if (!wait(milliseconds(0))) kill();
  const std::string said = err();
  if (said.find("Sanitizer") != std::string::npos || said.find("runtime error:") != std::string::npos)
    ADD_FAILURE() << name_ << ":\n" << said;
  else if (testing::Test::HasFailure())
    std::fprintf(stderr, "--- %s, status %d, said:\n%s", name_.c_str(), *status_, said.c_str());
  close(out_);
  close(err_);
}

void Program::send(int signal) {
  if (runs()) ::kill(pid_, signal);
}

std::optional<int> Program::wait(milliseconds patience) {
  wait_until(
      [this] {
        int status = 0;
        if (!status_ && waitpid(pid_, &status, WNOHANG) == pid_)
          status_ = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
        return status_.has_value();
      },
      patience);
  return status_;
}

void Program::kill() {
  send(SIGKILL);
  while (!wait()) {
  }
}

bool Program::blocks(int signal) const {
  // Before it is a program of its own, newer C libraries block everything for a moment within fork().
  std::error_code none;
  const auto program = std::filesystem::read_symlink("/proc/" + std::to_string(pid_) + "/exe", none);
  if (none || program == std::filesystem::read_symlink("/proc/self/exe")) return false;
  std::ifstream file("/proc/" + std::to_string(pid_) + "/status");
  for (std::string line; std::getline(file, line);)
    if (line.starts_with("SigBlk:"))
      return (std::stoull(line.substr(7), nullptr, 16) >> (signal - 1) & 1u) != 0;
  return false;
}

std::vector<pid_t> Program::children() const {
  const std::string pid = std::to_string(pid_);
  std::ifstream file("/proc/" + pid + "/task/" + pid + "/children");
  return {std::istream_iterator<pid_t>(file), {}};
}

bool is_there(pid_t pid) {
  std::ifstream file("/proc/" + std::to_string(pid) + "/stat");
  std::string text{std::istreambuf_iterator<char>(file), {}};
  const std::size_t name_end = text.rfind(") ");
  return name_end != std::string::npos && text[name_end + 2] != 'Z';
}

std::string Program::out() const { return contents(out_); }
std::string Program::err() const { return contents(err_); }

Ended run(const std::string& name, const std::vector<std::string>& arguments, milliseconds patience) {
  Program program(name, arguments);
  const int status = program.wait(patience).value_or(-1);
  if (status < 0) {
    ADD_FAILURE() << name << " has not ended within " << patience.count() << " ms";
    program.kill();
  }
  return {status, program.out(), program.err()};
}

Services::Services(const Domain& domain, const std::string& settings)
    : arguments_{"--settings", settings, "--domain", domain.text()} {}

Program& Services::start(const std::string& service, const std::vector<std::string>& further) {
  auto& program = programs_[service];
  program.reset();
  std::vector<std::string> arguments = arguments_;
  arguments.insert(arguments.end(), further.begin(), further.end());
  program = std::make_unique<Program>("weakgrid-" + service, arguments);
  return *program;
}

void Services::start_all() {
  for (const char* service : {"plant", "controller", "gateway"}) start(service);
}

}  // namespace weakgrid::test
