// A server on a thread of its own, and the other end of a connection, byte by byte: what no well-behaved client sends.
#pragma once

#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <mutex>
#include <stdexcept>
#include <string>
#include <thread>

#include "services/console/web_server.hpp"

namespace weakgrid::test {

class ServedInBackground {
 public:
  ServedInBackground(WebOptions options, WebServer::Answer answer,
                     std::vector<WebServer::Protocol> protocols = {})
      : server_((options.port = 0, options), std::move(answer), std::move(protocols)),
        thread_([this] {
          while (!stops_) {
            while (waiting_ > 0) std::this_thread::yield();
            const std::lock_guard lock(mutex_);
            server_.serve_for(std::chrono::milliseconds(2));
          }
        }) {}
  ~ServedInBackground() {
    stops_ = true;
    thread_.join();
  }

  std::uint16_t port() const { return server_.port(); }
  /// Between two moments of serving.
  template <class Work>
  auto with(Work work) {
    ++waiting_;
    const std::lock_guard lock(mutex_);
    --waiting_;
    return work(server_);
  }
  WebCounters counters() {
    return with([](WebServer& server) { return server.counters(); });
  }

 private:
  WebServer server_;
  std::mutex mutex_;
  std::atomic<bool> stops_ = false;
  std::atomic<int> waiting_ = 0;
  std::thread thread_;
};

class RawConnection {
 public:
  explicit RawConnection(std::uint16_t port) : port_(port), socket_(socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(port);
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    if (connect(socket_, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0)
      throw std::runtime_error("cannot connect");
  }
  ~RawConnection() { ::close(socket_); }
  RawConnection(const RawConnection&) = delete;
  RawConnection& operator=(const RawConnection&) = delete;

  int descriptor() const { return socket_; }
  /// False: the other end has gone.
  bool send(std::string_view bytes) {
    while (!bytes.empty()) {
      const ssize_t count = ::send(socket_, bytes.data(), bytes.size(), MSG_NOSIGNAL);
      if (count <= 0) return false;
      bytes.remove_prefix(static_cast<std::size_t>(count));
    }
    return true;
  }
  void end() { shutdown(socket_, SHUT_WR); }
  std::string host() const { return "127.0.0.1:" + std::to_string(port_); }

  /// Reads until what came has `text`, the end, or patience is over.
  std::string read_until(std::string_view text, int patience_ms = 5000) {
    while (received_.find(text) == std::string::npos && read_some(patience_ms)) {
    }
    return received_;
  }
  /// All until the other end closes; `is_over` tells whether it did.
  std::string read_to_end(int patience_ms = 5000) {
    while (read_some(patience_ms)) {
    }
    return received_;
  }
  bool is_over() const { return is_over_; }
  void forget() { received_.clear(); }

 private:
  bool read_some(int patience_ms) {
    pollfd poller{socket_, POLLIN, 0};
    if (poll(&poller, 1, patience_ms) <= 0) return false;
    char bytes[4096];
    const ssize_t count = recv(socket_, bytes, sizeof bytes, 0);
    is_over_ = count <= 0;
    if (count > 0) received_.append(bytes, static_cast<std::size_t>(count));
    return count > 0;
  }

  const std::uint16_t port_;
  const int socket_;
  std::string received_;
  bool is_over_ = false;
};

/// One request with these further header lines ("A: b\r\n"); the answer with its head.
inline std::string ask(std::uint16_t port, const std::string& line, const std::string& head = "",
                       const std::string& body = "") {
  RawConnection connection(port);
  connection.send(line + " HTTP/1.1\r\nHost: " + connection.host() + "\r\nConnection: close\r\n" + head +
                  (body.empty() ? "" : "Content-Length: " + std::to_string(body.size()) + "\r\n") + "\r\n" + body);
  return connection.read_to_end();
}

/// 200 of "HTTP/1.1 200 OK…"; 0: no answer.
inline int status_of(const std::string& answer) {
  return answer.starts_with("HTTP/1.1 ") ? std::stoi(answer.substr(9, 3)) : 0;
}

/// What of RFC 6455 a client sends to open one.
inline std::string upgrade(const std::string& host, const std::string& protocol, const std::string& head = "") {
  return "GET / HTTP/1.1\r\nHost: " + host +
         "\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
         "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Protocol: " +
         protocol + "\r\n" + head + "\r\n";
}

/// A frame as clients send it, masked with zeros.
inline std::string frame(std::string_view payload, int opcode = 1) {
  std::string bytes{static_cast<char>(0x80 | opcode)};
  if (payload.size() < 126) {
    bytes += static_cast<char>(0x80 | payload.size());
  } else if (payload.size() < 65536) {
    bytes += static_cast<char>(0x80 | 126);
    bytes += static_cast<char>(payload.size() >> 8);
    bytes += static_cast<char>(payload.size());
  } else {
    bytes += static_cast<char>(0x80 | 127);
    for (int shift = 56; shift >= 0; shift -= 8) bytes += static_cast<char>(std::uint64_t{payload.size()} >> shift);
  }
  bytes.append(4, '\0');
  return bytes.append(payload);
}

}  // namespace weakgrid::test
