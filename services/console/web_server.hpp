// HTTP and WebSocket for a handful of people and programs: one thread, every size, rate and queue bounded.
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "services/console/web_access.hpp"

namespace weakgrid {

struct WebOptions {
  std::string address = "127.0.0.1";  ///< IPv4 or IPv6, of this host
  std::uint16_t port = 8080;          ///< 0: one that is free
  std::string certificate, key;       ///< files, PEM: then TLS 1.2 or newer, and nothing else
  std::vector<std::pair<Access, std::string>> tokens;
  std::vector<std::string> hosts, origins;  ///< of WebNames
};

/// Views hold until the answer is given.
struct WebRequest {
  std::string_view method, path, body;  ///< GET or POST; the path without what follows '?'
  Access access = Access::none;
};

struct WebResponse {
  unsigned status = 200;
  std::string type = "text/plain; charset=utf-8";
  std::string body;
};

/// The other end of a WebSocket. All calls on the thread of the server.
class WebPeer {
 public:
  virtual ~WebPeer() = default;
  /// False: too slow, and this frame is lost. Frames are shared among those who get the same.
  virtual bool send_text(std::shared_ptr<const std::string> frame) = 0;
  virtual bool send_binary(std::shared_ptr<const std::string> frame) = 0;
  /// After what was sent before. The conversation is over once this thread serves again.
  virtual void close(const std::string& why) = 0;
};

/// One WebSocket, from its opening to its end. Destroyed when the peer is gone.
class Conversation {
 public:
  virtual ~Conversation() = default;
  virtual void hear_text(std::string_view message) = 0;
  virtual void hear_binary(std::string_view message) = 0;
};

struct WebCounters {
  std::uint64_t requests = 0;        ///< answered, whatever with
  std::uint64_t refused = 0;         ///< of these 400 and above, and what was no HTTP
  std::uint64_t connections = 0;     ///< open now
  std::uint64_t conversations = 0;   ///< of these WebSockets
  std::uint64_t frames_dropped = 0;  ///< to peers too slow
};

class WebServer {
 public:
  using Answer = std::function<WebResponse(const WebRequest&)>;
  /// Nothing: not with that access, answered 403.
  using Converse = std::function<std::unique_ptr<Conversation>(WebPeer&, Access)>;
  struct Protocol {
    std::string path, name;  ///< of the upgrade, and its Sec-WebSocket-Protocol
    Converse converse;
  };

  /// Listens from now on, serves in serve_for(). Throws std::runtime_error where that cannot be, SettingsError
  /// for a certificate or key.
  WebServer(const WebOptions& options, Answer answer, std::vector<Protocol> protocols);
  /// Ends every conversation.
  ~WebServer();
  WebServer(const WebServer&) = delete;
  WebServer& operator=(const WebServer&) = delete;

  /// Everything happens in here. 0: what there is to do now.
  void serve_for(std::chrono::milliseconds span);
  std::uint16_t port() const;
  const WebCounters& counters() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace weakgrid
