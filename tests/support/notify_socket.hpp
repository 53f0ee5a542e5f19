// The service manager's end of sd_notify: a real datagram socket, and who has sent.
#pragma once

#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <cstring>
#include <stdexcept>
#include <string>
#include <vector>

#include "tests/support/test_domain.hpp"

namespace weakgrid::test {

/// Programs started while the environment names it send here.
class NotifySocket {
 public:
  NotifySocket() : socket_(::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0)) {
    static int made = 0;
    // No file: an address in the abstract namespace, whose first byte is 0, in the environment '@'.
    name_ = "@weakgrid-test-" + std::to_string(getpid()) + "-" + std::to_string(made++);
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    std::memcpy(address.sun_path + 1, name_.data() + 1, name_.size() - 1);
    const int on = 1;
    if (socket_ < 0 || setsockopt(socket_, SOL_SOCKET, SO_PASSCRED, &on, sizeof on) != 0 ||
        bind(socket_, reinterpret_cast<const sockaddr*>(&address),
             static_cast<socklen_t>(offsetof(sockaddr_un, sun_path) + name_.size())) != 0)
      throw std::runtime_error(name_ + ": no socket");
  }
  ~NotifySocket() { close(socket_); }
  NotifySocket(const NotifySocket&) = delete;
  NotifySocket& operator=(const NotifySocket&) = delete;

  /// What a service manager puts into the environment of a program, as long as this lives; watchdog 0: none.
  class Environment {
   public:
    Environment(const NotifySocket& socket, std::chrono::microseconds watchdog) {
      setenv("NOTIFY_SOCKET", socket.name_.c_str(), 1);
      if (watchdog.count() > 0) setenv("WATCHDOG_USEC", std::to_string(watchdog.count()).c_str(), 1);
    }
    ~Environment() {
      unsetenv("NOTIFY_SOCKET");
      unsetenv("WATCHDOG_USEC");
    }
  };

  struct Word {
    std::string text;  ///< one line of a datagram
    pid_t sender = 0;
    std::chrono::steady_clock::time_point at;  ///< read
  };

  /// All that has come, oldest first.
  const std::vector<Word>& heard() {
    char text[4096], control[CMSG_SPACE(sizeof(ucred))];
    iovec bytes{text, sizeof text};
    for (;;) {
      msghdr message{};
      message.msg_iov = &bytes;
      message.msg_iovlen = 1;
      message.msg_control = control;
      message.msg_controllen = sizeof control;
      const ssize_t size = recvmsg(socket_, &message, 0);
      if (size < 0) return heard_;
      ucred sender{};
      if (const cmsghdr* header = CMSG_FIRSTHDR(&message); header != nullptr)
        std::memcpy(&sender, CMSG_DATA(header), sizeof sender);
      std::string rest(text, static_cast<std::size_t>(size));
      while (!rest.empty()) {
        const std::size_t end = rest.find('\n');
        heard_.push_back({rest.substr(0, end), sender.pid, std::chrono::steady_clock::now()});
        rest = end == std::string::npos ? "" : rest.substr(end + 1);
      }
    }
  }

  std::size_t count(const std::string& line) {
    std::size_t n = 0;
    for (const Word& word : heard()) n += word.text == line ? 1 : 0;
    return n;
  }
  bool hears(const std::string& line, milliseconds patience = long_enough) {
    return wait_until([&] { return count(line) > 0; }, patience);
  }
  /// All of it, for a failure.
  std::string words() {
    std::string all;
    for (const Word& word : heard()) all += "\n  " + word.text;
    return all;
  }

 private:
  int socket_;
  std::string name_;
  std::vector<Word> heard_;
};

}  // namespace weakgrid::test
