// Foxglove's WebSocket protocol, version 1, as far as a server needs it that shows topics: Foxglove, Lichtblick
// and any client of npm's @foxglove/ws-protocol plot a domain without anything else. Knows no sockets and no
// DDS. Source: github.com/foxglove/ws-protocol, docs/spec.md.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "services/console/web_server.hpp"
#include "services/recording/sample.hpp"

namespace weakgrid {

/// All on one thread, that of the server.
class Foxglove {
 public:
  /// The protocol's names: Lichtblick asks for the first, Foxglove for the second; all that is said here is the
  /// same in both.
  static constexpr const char* names[] = {"foxglove.websocket.v1", "foxglove.sdk.v1"};

  /// schema: the text of an IDL that has every type that has_schema() says yes to.
  Foxglove(std::string server_name, std::string schema, std::function<bool(const std::string&)> has_schema);
  ~Foxglove();
  Foxglove(const Foxglove&) = delete;
  Foxglove& operator=(const Foxglove&) = delete;

  /// Of topics whose type has no schema nothing is shown: nobody could read it.
  void see(const SourceWriter& writer);
  /// To whoever has subscribed. What stands (transient_local) also goes to whoever subscribes later, and other
  /// reliable messages for two seconds: a command's writer lives for a moment, and who subscribes to its topic
  /// when told of it would come too late.
  void take(const RawSample& sample);
  /// Must end before this does.
  std::unique_ptr<Conversation> converse(WebPeer& peer);

 private:
  class Client;
  struct Channel {
    std::uint32_t id = 0;
    std::string topic, type;
  };
  struct Source {
    std::uint32_t channel = 0;  // 0: not shown
    bool stands = false, is_reliable = false;
    std::int64_t time_ns = 0;
    std::string payload;
  };
  std::string advertise(const std::vector<Channel>& channels) const;

  const std::string server_name_, session_, schema_;
  const std::function<bool(const std::string&)> has_schema_;
  std::vector<Channel> channels_;            // id n + 1 at n
  std::map<std::uint32_t, Source> sources_;  // by a writer's index
  std::set<Client*> clients_;
  std::int64_t now_ns_ = 0;  // of the newest sample
};

}  // namespace weakgrid
