// gnuplot as a process: no shell, a folder of its own, the picture moved into place when it is whole.
#include <fcntl.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <stdexcept>
#include <thread>

#include "services/cli/figure.hpp"

namespace weakgrid {

namespace {

namespace fs = std::filesystem;

constexpr std::chrono::seconds patience{120};

class TemporaryFolder {
 public:
  TemporaryFolder() {
    std::string name = (fs::temp_directory_path() / "weakgrid_plot_XXXXXX").string();
    if (mkdtemp(name.data()) == nullptr)
      throw std::runtime_error(name + ": cannot be created: " + std::strerror(errno));
    path_ = name;
  }
  ~TemporaryFolder() {
    std::error_code ignored;
    fs::remove_all(path_, ignored);
  }
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;
  fs::path operator/(const char* name) const { return path_ / name; }
  const char* path() const { return path_.c_str(); }

 private:
  fs::path path_;
};

class SpawnActions {
 public:
  SpawnActions() { posix_spawn_file_actions_init(&actions_); }
  ~SpawnActions() { posix_spawn_file_actions_destroy(&actions_); }
  SpawnActions(const SpawnActions&) = delete;
  SpawnActions& operator=(const SpawnActions&) = delete;
  posix_spawn_file_actions_t* get() { return &actions_; }

 private:
  posix_spawn_file_actions_t actions_;
};

std::string text_of(const fs::path& path) {
  std::ostringstream text;
  text << std::ifstream(path).rdbuf();
  return text.str();
}

// Its exit status, 128 + n if signal n has ended it.
int wait_for(pid_t pid) {
  const auto deadline = std::chrono::steady_clock::now() + patience;
  int status = 0;
  while (waitpid(pid, &status, WNOHANG) == 0) {
    if (std::chrono::steady_clock::now() > deadline) {
      kill(pid, SIGKILL);
      waitpid(pid, &status, 0);
      throw std::runtime_error("gnuplot does not come to an end");
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
}

// -d: nobody's own initialization.
void run_gnuplot(const TemporaryFolder& folder) {
  SpawnActions actions;
  posix_spawn_file_actions_addchdir_np(actions.get(), folder.path());
  posix_spawn_file_actions_addopen(actions.get(), STDIN_FILENO, "/dev/null", O_RDONLY, 0);
  posix_spawn_file_actions_addopen(actions.get(), STDOUT_FILENO, "words", O_WRONLY | O_CREAT | O_APPEND,
                                   0600);
  posix_spawn_file_actions_adddup2(actions.get(), STDOUT_FILENO, STDERR_FILENO);
  std::string words[] = {"gnuplot", "-d", "script.gp"};
  char* const argv[] = {words[0].data(), words[1].data(), words[2].data(), nullptr};
  pid_t pid = -1;
  const int error = posix_spawnp(&pid, "gnuplot", actions.get(), nullptr, argv, environ);
  if (error == ENOENT) throw std::runtime_error("gnuplot is missing: apt-get install gnuplot-nox");
  if (error != 0) throw std::runtime_error(std::string("gnuplot cannot be started: ") + std::strerror(error));
  const int status = wait_for(pid);
  std::error_code ignored;
  if (status == 0 && fs::file_size(folder / "figure", ignored) > 0 && !ignored) return;
  std::string words_said = text_of(folder / "words").substr(0, 500);
  throw std::runtime_error("gnuplot failed: exit status " + std::to_string(status) + "\n" + words_said);
}

}  // namespace

void draw_figure(const std::string& script, const std::string& file) {
  const TemporaryFolder folder;
  if (std::ofstream out(folder / "script.gp"); !(out << script).flush())
    throw std::runtime_error((folder / "script.gp").string() + ": cannot be written");
  run_gnuplot(folder);
  // Beside the place it goes to: only there a rename is whole or not at all.
  const fs::path beside = file + ".part" + std::to_string(getpid());
  std::error_code error;
  fs::copy_file(folder / "figure", beside, fs::copy_options::overwrite_existing, error);
  if (!error) fs::rename(beside, file, error);
  if (!error) return;
  std::error_code ignored;
  fs::remove(beside, ignored);
  throw std::runtime_error(file + ": cannot be written: " + error.message());
}

}  // namespace weakgrid
