// Exercise of the console's door: see the header.
#include "tests/fuzz/exercise_web.hpp"

#include <nlohmann/json.hpp>
#include <stdexcept>

#include "services/console/foxglove.hpp"
#include "tests/console/web_client.hpp"

namespace weakgrid::fuzz {

namespace {

void claim(bool holds, const char* what) {
  if (!holds) throw std::logic_error(std::string("does not hold: ") + what);
}

class Echo : public Conversation {
 public:
  explicit Echo(WebPeer& peer) : peer_(peer) {}
  void hear_text(std::string_view message) override {
    peer_.send_text(std::make_shared<const std::string>(message));
  }
  void hear_binary(std::string_view message) override {
    peer_.send_binary(std::make_shared<const std::string>(message));
  }

 private:
  WebPeer& peer_;
};

const std::string token(32, 't');

WebServer& server() {
  static WebServer one(
      {.port = 0, .certificate = {}, .key = {}, .tokens = {{Access::set, token}}, .hosts = {"h:1"}, .origins = {}},
      [](const WebRequest& request) {
        claim(request.path.find('?') == std::string_view::npos, "a path has no query");
        claim(request.method == "GET" || request.method == "POST", "GET or POST");
        WebResponse response;
        if (request.access == Access::none)
          response.status = 401;
        else
          response.body = "in";
        return response;
      },
      {{"/", "echo", [](WebPeer& peer, Access access) {
          claim(access == Access::set, "nobody converses who may not");
          return std::make_unique<Echo>(peer);
        }}});
  return one;
}

/// What the server answers until it has closed.
std::string exchange(std::string_view bytes) {
  test::RawConnection connection(server().port());
  // What the server has not yet taken waits in the kernel.
  (void)::send(connection.descriptor(), bytes.data(), bytes.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
  connection.end();
  for (int rounds = 0; !connection.is_over(); ++rounds) {
    claim(rounds < 10'000, "a connection that has ended is over");
    server().serve_for(std::chrono::milliseconds(0));
    connection.read_to_end(0);
  }
  return connection.read_to_end(0);
}

// Keeps what it is sent, as long as a slow one would.
class Peer : public WebPeer {
 public:
  bool send_text(std::shared_ptr<const std::string> frame) override {
    const auto message = nlohmann::json::parse(*frame, nullptr, false);
    claim(message.is_object() && message.contains("op"), "what is said is a message");
    return true;
  }
  bool send_binary(std::shared_ptr<const std::string> frame) override {
    claim(frame->size() >= 13 && frame->front() == 1, "a data frame has its head");
    ++frames;
    return true;
  }
  void close(const std::string&) override {}
  int frames = 0;
};

}  // namespace

void exercise_http(std::string_view bytes) {
  exchange(bytes);
  for (int rounds = 0; server().counters().connections > 0; ++rounds) {
    claim(rounds < 10'000, "nothing is left of a connection");
    server().serve_for(std::chrono::milliseconds(0));
  }
  claim(server().counters().conversations == 0, "nor of a conversation");
  static int count = 0;
  if (++count % 64 != 0) return;
  const std::string answer =
      exchange("GET / HTTP/1.1\r\nHost: h:1\r\nConnection: close\r\nAuthorization: Bearer " + token + "\r\n\r\n");
  claim(answer.starts_with("HTTP/1.1 200 ") && answer.ends_with("\r\n\r\nin"), "others are served");
}

void exercise_foxglove(std::string_view text) {
  Foxglove foxglove("fuzz", "module m {};", [](const std::string& type) { return type != "theirs"; });
  SourceWriter writer;
  for (const char* type : {"a", "b", "theirs", "a"}) {
    writer.topic = std::string("topic/") + type;
    writer.type = type;
    writer.reliable = writer.transient_local = writer.index % 2 == 0;
    foxglove.see(writer);
    ++writer.index;
  }
  const std::string payload("\0\1\0\0hello", 9);
  const auto write = [&] {
    for (std::uint32_t n = 0; n < writer.index + 1; ++n)
      foxglove.take({.writer = n, .payload = std::as_bytes(std::span{payload})});
  };
  write();
  Peer peer, other;
  const auto bystander = foxglove.converse(other);
  const auto client = foxglove.converse(peer);
  while (!text.empty()) {
    const std::size_t end = text.find('\n');
    const std::string_view line = text.substr(0, end);
    text.remove_prefix(end == std::string_view::npos ? text.size() : end + 1);
    if (!line.empty() && line.front() == 'b')
      client->hear_binary(line);
    else
      client->hear_text(line);
    peer.frames = 0;
    write();
    // Two channels of which one has two writers; at most 256 subscriptions.
    claim(peer.frames <= 3 * 256, "subscriptions are bounded");
  }
  claim(other.frames == 0, "who has not subscribed hears nothing");
}

std::vector<std::string> http_seeds() {
  const std::string in = "Host: h:1\r\nAuthorization: Bearer " + token + "\r\n";
  return {"GET /a?b HTTP/1.1\r\n" + in + "\r\nHEAD / HTTP/1.1\r\n" + in + "\r\n",
          "POST /x HTTP/1.1\r\nHost: h:1\r\nOrigin: http://h:1\r\nContent-Length: 3\r\n\r\nabc",
          "POST /login HTTP/1.1\r\nHost: h:1\r\nContent-Length: 32\r\n\r\n" + token +
              "POST /logout HTTP/1.1\r\nHost: h:1\r\nCookie: weakgrid_session=a; b=c\r\n\r\n",
          "POST /x HTTP/1.1\r\n" + in + "Transfer-Encoding: chunked\r\n\r\n3;a=b\r\nabc\r\n0\r\n\r\n",
          test::upgrade("h:1", "other, echo", "Authorization: Bearer " + token + "\r\n") + test::frame("hello") +
              test::frame(std::string(200, 'x'), 2) + test::frame("", 9) + test::frame("\x03\xe8", 8)};
}

std::vector<std::string> foxglove_seeds() {
  return {R"({"op":"subscribe","subscriptions":[{"id":0,"channelId":1},{"id":4294967295,"channelId":2}]})"
          "\n"
          R"({"op":"unsubscribe","subscriptionIds":[0,7]})",
          "{\"op\":\"advertise\",\"channels\":[]}\nb\x01\x02\n[]\n{\"op\":7}"};
}

}  // namespace weakgrid::fuzz
