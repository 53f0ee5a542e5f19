// Lines of stdin as they come.
#pragma once

#include <poll.h>
#include <unistd.h>

#include <string>

namespace weakgrid {

/// Never waits for one. A line too long for any command is thrown away.
class CommandLines {
 public:
  bool has_ended() const { return ended_; }
  template <class Take>
  void read(const Take& take) {
    pollfd input{.fd = STDIN_FILENO, .events = POLLIN, .revents = 0};
    while (!ended_ && poll(&input, 1, 0) > 0) {
      char bytes[256];
      const ssize_t count = ::read(STDIN_FILENO, bytes, sizeof bytes);
      ended_ = count <= 0;
      if (!ended_) text_.append(bytes, static_cast<std::size_t>(count));
    }
    for (std::size_t end; (end = text_.find('\n')) != std::string::npos; text_.erase(0, end + 1))
      take(text_.substr(0, end));
    if (text_.size() > 4096) text_.clear();
  }

 private:
  std::string text_;
  bool ended_ = false;
};

}  // namespace weakgrid
