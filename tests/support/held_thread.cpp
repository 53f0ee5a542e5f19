// HeldThread: see the header.
#include "tests/support/held_thread.hpp"

#include <sys/ptrace.h>
#include <sys/syscall.h>
#include <sys/wait.h>

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <sstream>
#include <stdexcept>
#include <thread>
#include <vector>

#include "tests/support/test_domain.hpp"

namespace weakgrid::test {

namespace {

[[noreturn]] void fail(pid_t thread, const char* what) {
  throw std::runtime_error("thread " + std::to_string(thread) + ": " + what);
}

// Not for ever: a thread that waits for what never comes makes no call either.
void wait_for_stop(pid_t thread) {
  int status = 0;
  if (!wait_until([&] { return waitpid(thread, &status, __WALL | WNOHANG) != 0; }) || !WIFSTOPPED(status))
    fail(thread, "does not stop");
}

bool is_about_to_send(pid_t thread) {
  __ptrace_syscall_info call{};
  const auto size = reinterpret_cast<void*>(sizeof call);
  if (ptrace(PTRACE_GET_SYSCALL_INFO, thread, size, &call) <= 0) fail(thread, "cannot be asked");
  return call.op == PTRACE_SYSCALL_INFO_ENTRY &&
         (call.entry.nr == SYS_sendto || call.entry.nr == SYS_sendmsg);
}

std::vector<pid_t> threads(pid_t process) {
  std::vector<pid_t> all;
  for (const auto& entry : std::filesystem::directory_iterator("/proc/" + std::to_string(process) + "/task"))
    all.push_back(std::stoi(entry.path().filename()));
  return all;
}

std::string text_of(pid_t process, pid_t thread, const std::string& file) {
  std::ifstream in("/proc/" + std::to_string(process) + "/task/" + std::to_string(thread) + "/" + file);
  return {std::istreambuf_iterator<char>(in), {}};
}

}  // namespace

HeldThread::HeldThread(pid_t thread, Where where) : thread_(thread) {
  const auto options = reinterpret_cast<void*>(static_cast<std::intptr_t>(PTRACE_O_TRACESYSGOOD));
  if (ptrace(PTRACE_SEIZE, thread, nullptr, options) != 0)
    fail(thread, "cannot be seized: ptrace is not allowed");
  try {
    if (ptrace(PTRACE_INTERRUPT, thread, nullptr, nullptr) != 0) fail(thread, "cannot be interrupted");
    wait_for_stop(thread);
    for (int calls = 0; where == Where::sending && !is_about_to_send(thread); ++calls) {
      if (calls == 10'000) fail(thread, "never sends");
      if (ptrace(PTRACE_SYSCALL, thread, nullptr, nullptr) != 0) fail(thread, "does not go on");
      wait_for_stop(thread);
    }
  } catch (...) {
    ptrace(PTRACE_INTERRUPT, thread, nullptr, nullptr);  // only one that stands can be let go
    int status = 0;
    (void)wait_until([&] { return waitpid(thread, &status, __WALL | WNOHANG) != 0; }, milliseconds(1000));
    ptrace(PTRACE_DETACH, thread, nullptr, nullptr);
    throw;
  }
}

HeldThread::~HeldThread() { ptrace(PTRACE_DETACH, thread_, nullptr, nullptr); }

pid_t thread_named(pid_t process, const std::string& name) {
  for (const pid_t thread : threads(process))
    if (text_of(process, thread, "comm") == name + "\n") return thread;
  throw std::runtime_error("no thread '" + name + "'");
}

pid_t busiest_thread(pid_t process) {
  const auto spent = [&] {
    std::map<pid_t, std::uint64_t> ns;  // on a processor
    for (const pid_t thread : threads(process))
      std::istringstream(text_of(process, thread, "schedstat")) >> ns[thread];
    ns.erase(process);
    return ns;
  };
  const auto before = spent();
  std::this_thread::sleep_for(milliseconds(300));
  pid_t busiest = -1;
  std::uint64_t most = 0;
  for (const auto& [thread, ns] : spent()) {
    const auto known = before.find(thread);
    const std::uint64_t here = ns - (known == before.end() ? 0 : known->second);
    if (here <= most) continue;
    most = here;
    busiest = thread;
  }
  return busiest;
}

}  // namespace weakgrid::test
