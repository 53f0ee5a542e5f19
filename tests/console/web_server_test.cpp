// The console's door: whoever comes is answered or sent away, and nobody else notices.
#include <gtest/gtest.h>
#include <openssl/ssl.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>
#include <random>

#include "services/runtime/settings.hpp"
#include "tests/console/web_client.hpp"

namespace weakgrid {
namespace {

using test::ask;
using test::frame;
using test::RawConnection;
using test::ServedInBackground;
using test::status_of;
using test::upgrade;

const std::string viewer(40, 'v'), setter(40, 's');

WebResponse tell_access(const WebRequest& request) {
  if (request.access == Access::none) return {.status = 401, .body = "who?"};
  return {.body = std::string(request.method) + " " + std::string(request.path) + " " +
                  (request.access == Access::set ? "set" : "view") + " " + std::string(request.body)};
}

WebOptions with_tokens() {
  WebOptions options;
  options.tokens = {{Access::view, viewer}, {Access::set, setter}};
  return options;
}

// Says again what it hears; and to everybody what it is given.
class Echo : public Conversation {
 public:
  Echo(WebPeer& peer, std::vector<WebPeer*>& all) : peer_(peer), all_(all) { all_.push_back(&peer); }
  ~Echo() override { std::erase(all_, &peer_); }
  void hear_text(std::string_view message) override {
    peer_.send_text(std::make_shared<const std::string>(message));
  }
  void hear_binary(std::string_view message) override {
    peer_.send_binary(std::make_shared<const std::string>(message));
  }

 private:
  WebPeer& peer_;
  std::vector<WebPeer*>& all_;
};

struct EchoServer {
  std::vector<WebPeer*> peers;
  ServedInBackground server;
  explicit EchoServer(const WebOptions& options = {})
      : server(options, tell_access, {{"/", "echo", [this](WebPeer& peer, Access) {
                                         return std::make_unique<Echo>(peer, peers);
                                       }}}) {}
  std::uint16_t port() const { return server.port(); }
  /// A peer that has been let in.
  std::unique_ptr<RawConnection> enter() {
    auto connection = std::make_unique<RawConnection>(port());
    connection->send(upgrade(connection->host(), "echo"));
    EXPECT_EQ(status_of(connection->read_until("\r\n\r\n")), 101);
    connection->forget();
    return connection;
  }
};

TEST(WebServer, AnswersWhoAsksByItsNameWithHeadersThatKeepThePageToItself) {
  ServedInBackground server({}, tell_access);
  const std::string answer = ask(server.port(), "GET /a/b?c=d");
  EXPECT_EQ(status_of(answer), 200) << answer;
  EXPECT_NE(answer.find("\r\n\r\nGET /a/b set "), std::string::npos) << answer;
  EXPECT_NE(answer.find("default-src 'none'"), std::string::npos);
  EXPECT_NE(answer.find("X-Content-Type-Options: nosniff"), std::string::npos);
  EXPECT_NE(ask(server.port(), "POST /x", "", "body").find("POST /x set body"), std::string::npos);
  const std::string head = ask(server.port(), "HEAD /a/b");
  EXPECT_EQ(status_of(head), 200);
  EXPECT_TRUE(head.ends_with("\r\n\r\n")) << head;
  EXPECT_EQ(status_of(ask(server.port(), "DELETE /")), 405);
  EXPECT_EQ(status_of(ask(server.port(), "OPTIONS *")), 405);
}

TEST(WebServer, ByAnotherNameOrFromAnotherPageNobodyIsAnswered) {
  WebOptions options;
  options.hosts = {"plant.example"};
  options.origins = {"https://studio.example"};
  ServedInBackground server(options, tell_access);
  const std::string port = std::to_string(server.port());
  const auto by_name = [&](const std::string& host) {
    RawConnection connection(server.port());
    connection.send("GET / HTTP/1.1\r\nHost: " + host + "\r\nConnection: close\r\n\r\n");
    return status_of(connection.read_to_end());
  };
  EXPECT_EQ(by_name("127.0.0.1:" + port), 200);
  EXPECT_EQ(by_name("localhost:" + port), 200);
  EXPECT_EQ(by_name("plant.example:" + port), 200);
  for (const char* other : {"evil.example", "127.0.0.1", "", "plant.example:1", "127.0.0.1.evil.example"})
    EXPECT_EQ(by_name(other), 421) << other;
  const auto from = [&](const std::string& origin) {
    return status_of(ask(server.port(), "GET /", "Origin: " + origin + "\r\n"));
  };
  EXPECT_EQ(from("http://localhost:" + port), 200);
  EXPECT_EQ(from("https://studio.example"), 200);
  for (const std::string& other : {std::string("null"), std::string("http://evil.example"),
                                  "https://localhost:" + port, std::string("http://localhost:1")})
    EXPECT_EQ(from(other), 403) << other;
}

TEST(WebServer, ATokenLetsInAndHasNoPlaceInAUrl) {
  ServedInBackground server(with_tokens(), tell_access);
  const std::uint16_t port = server.port();
  EXPECT_EQ(status_of(ask(port, "GET /")), 401);
  EXPECT_EQ(status_of(ask(port, "GET /?token=" + setter)), 401);
  EXPECT_NE(ask(port, "GET /", "Authorization: Bearer " + viewer + "\r\n").find("view"), std::string::npos);
  EXPECT_NE(ask(port, "GET /", "Authorization: Bearer " + setter + "\r\n").find("set"), std::string::npos);
  for (const std::string& bad : {viewer.substr(1), viewer + "v", std::string(), "v " + viewer})
    EXPECT_EQ(status_of(ask(port, "GET /", "Authorization: Bearer " + bad + "\r\n")), 401) << bad;
  EXPECT_EQ(status_of(ask(port, "GET /", "Authorization: Basic " + viewer + "\r\n")), 401);
}

TEST(WebServer, ABrowserGetsASessionForATokenUntilItLogsOut) {
  ServedInBackground server(with_tokens(), tell_access);
  const std::uint16_t port = server.port();
  EXPECT_EQ(status_of(ask(port, "POST /login", "", std::string(40, 'x'))), 403);
  EXPECT_EQ(status_of(ask(port, "GET /login")), 405);
  EXPECT_EQ(status_of(ask(port, "POST /login", "Origin: http://evil.example\r\n", viewer)), 403);
  const std::string answer = ask(port, "POST /login", "", viewer);
  EXPECT_EQ(status_of(answer), 204) << answer;
  const std::size_t begin = answer.find("Set-Cookie: ") + 12;
  const std::string attributes = answer.substr(begin, answer.find("\r\n", begin) - begin);
  EXPECT_NE(attributes.find("HttpOnly; SameSite=Strict"), std::string::npos) << attributes;
  EXPECT_EQ(attributes.find(viewer), std::string::npos);
  const std::string cookie = "Cookie: other=1; " + attributes.substr(0, attributes.find(';')) + "; more=2\r\n";
  EXPECT_NE(ask(port, "GET /", cookie).find("view"), std::string::npos);
  EXPECT_EQ(status_of(ask(port, "POST /logout", cookie)), 204);
  EXPECT_EQ(status_of(ask(port, "GET /", cookie)), 401);
  // Only so many at a time: the oldest goes.
  const std::string second = ask(port, "POST /login", "", setter);
  const std::size_t at = second.find("Set-Cookie: ") + 12;
  const std::string oldest = "Cookie: " + second.substr(at, second.find(';', at) - at) + "\r\n";
  EXPECT_EQ(status_of(ask(port, "GET /", oldest)), 200);
  for (int n = 0; n < 64; ++n) ask(port, "POST /login", "", viewer);
  EXPECT_EQ(status_of(ask(port, "GET /", oldest)), 401);
}

TEST(WebServer, AFileOfTokensThatIsWrongIsNamedWithoutThem) {
  const std::string file = testing::TempDir() + "tokens" + std::to_string(getpid());
  const auto read = [&](const std::string& text) {
    std::ofstream(file) << text;
    try {
      return std::to_string(read_tokens(file).size());
    } catch (const SettingsError& error) {
      return std::string(error.what());
    }
  };
  EXPECT_EQ(read("# of the hall\n\nview " + viewer + " # ann\nset " + setter + "\n"), "2");
  for (const auto& [text, line] : std::map<std::string, std::string>{{"view short", ":1: "},
                                                                    {"\nset", ":2: "},
                                                                    {"rule " + viewer, ":1: "},
                                                                    {"view " + viewer + " " + setter, ":1: "},
                                                                    {"view " + viewer + "\xc3\xa4", ":1: "},
                                                                    {"# none", ": no token"}}) {
    const std::string said = read(text);
    EXPECT_EQ(said.find(file + line), 0u) << said;
    EXPECT_EQ(said.find(viewer), std::string::npos) << said;
  }
  std::filesystem::remove(file);
  EXPECT_THROW(read_tokens(file), SettingsError);
}

TEST(WebServer, WhatIsTooLargeOrNoHttpIsRefusedAndOthersAreServed) {
  ServedInBackground server({}, tell_access);
  const std::uint16_t port = server.port();
  EXPECT_EQ(status_of(ask(port, "GET /", "X: " + std::string(9000, 'x') + "\r\n")), 413);
  EXPECT_EQ(status_of(ask(port, "POST /", "", std::string(17'000, 'x'))), 413);
  RawConnection announces(port);
  announces.send("POST / HTTP/1.1\r\nHost: " + announces.host() + "\r\nContent-Length: 99999999999\r\n\r\n");
  EXPECT_EQ(status_of(announces.read_to_end()), 413);
  for (const char* nonsense : {"\r\n\r\n", "GET\r\n\r\n", "GET / HTTP/9.9\r\n\r\n", "\x16\x03\x01\x02\r\n\r\n",
                               "GET / HTTP/1.1\r\nHost\r\n\r\n", "GET / HTTP/1.1\r\n : x\r\n\r\n"}) {
    RawConnection connection(port);
    connection.send(nonsense);
    connection.end();
    EXPECT_NE(status_of(connection.read_to_end()), 200) << nonsense;
    EXPECT_TRUE(connection.is_over());
  }
  EXPECT_EQ(status_of(ask(port, "GET /")), 200);
}

TEST(WebServer, WhoSaysNothingKeepsNobodyFromBeingServed) {
  ServedInBackground server({}, tell_access);
  std::vector<std::unique_ptr<RawConnection>> silent;
  for (int n = 0; n < 32; ++n) {
    silent.push_back(std::make_unique<RawConnection>(server.port()));
    silent.back()->send("GET / HT");
  }
  EXPECT_EQ(status_of(ask(server.port(), "GET /")), 200);
  // As many as it takes, and no more; when some have gone there is room again.
  for (int n = 0; n < 64; ++n) silent.push_back(std::make_unique<RawConnection>(server.port()));
  RawConnection beyond(server.port());
  EXPECT_EQ(beyond.read_to_end(), "");
  EXPECT_TRUE(beyond.is_over());
  silent.clear();
  for (int patience = 100; server.counters().connections > 0 && patience > 0; --patience)
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  EXPECT_EQ(status_of(ask(server.port(), "GET /")), 200);
}

TEST(WebServer, RandomBytesDisturbNobody) {
  EchoServer echo;
  std::mt19937_64 random(20261123);
  const std::string good = "GET / HTTP/1.1\r\nHost: 127.0.0.1:" + std::to_string(echo.port()) + "\r\n\r\n";
  const std::string open = upgrade("127.0.0.1:" + std::to_string(echo.port()), "echo") + frame("hello");
  for (int n = 0; n < 300; ++n) {
    std::string bytes = n % 2 == 0 ? good : open;
    for (std::uint64_t changes = 1 + random() % 8; changes > 0; --changes) {
      const std::size_t at = random() % bytes.size();
      if (random() % 3 == 0)
        bytes.erase(at, random() % 9);
      else
        bytes[at] = static_cast<char>(random());
      if (bytes.empty()) break;
    }
    RawConnection connection(echo.port());
    connection.send(bytes);
    connection.end();
    connection.read_to_end(2000);
    ASSERT_TRUE(connection.is_over()) << n;
  }
  EXPECT_EQ(status_of(ask(echo.port(), "GET /")), 200);
}

TEST(WebSocket, OpensForThoseWhoMayAndKnowTheProtocol) {
  EchoServer echo(with_tokens());
  const auto tried = [&](const std::string& protocol, const std::string& head) {
    RawConnection connection(echo.port());
    connection.send(upgrade(connection.host(), protocol, head));
    return connection.read_until("\r\n\r\n");
  };
  const std::string token = "Authorization: Bearer " + viewer + "\r\n";
  const std::string opened = tried("other, echo", token);
  EXPECT_EQ(status_of(opened), 101) << opened;
  EXPECT_NE(opened.find("Sec-WebSocket-Protocol: echo"), std::string::npos) << opened;
  EXPECT_EQ(status_of(tried("echo", "")), 401);
  EXPECT_EQ(status_of(tried("echo", token + "Origin: http://evil.example\r\n")), 403);
  EXPECT_EQ(status_of(tried("other", token)), 400);
}

TEST(WebSocket, IsHeardAndAnswered) {
  EchoServer echo;
  const auto peer = echo.enter();
  peer->send(frame("hello") + frame(std::string(300, 'b'), 2));
  const std::string heard = peer->read_until(std::string(300, 'b'));
  EXPECT_EQ(heard.substr(0, 7), "\x81\x05hello");
  EXPECT_EQ(heard.substr(7, 4), std::string("\x82\x7e\x01\x2c", 4));
}

TEST(WebSocket, AFrameThatIsTooLargeEndsItBeforeItIsRead) {
  EchoServer echo;
  const auto other = echo.enter();
  const auto peer = echo.enter();
  peer->send(frame(std::string(70'000, 'x')).substr(0, 200));  // its length is enough
  const std::string said = peer->read_to_end();
  EXPECT_TRUE(peer->is_over());
  EXPECT_EQ(said.substr(0, 1), "\x88") << "a close frame";
  EXPECT_EQ(said.substr(2, 2), std::string("\x03\xf1", 2)) << "1009, too big";
  other->send(frame("still there"));
  EXPECT_NE(other->read_until("still there").find("still there"), std::string::npos);
}

TEST(WebSocket, WhoFloodsIsSentAway) {
  EchoServer echo;
  const auto peer = echo.enter();
  std::string flood;
  for (int n = 0; n < 2000; ++n) flood += frame("x");
  peer->send(flood);
  const std::string said = peer->read_to_end();
  EXPECT_TRUE(peer->is_over());
  EXPECT_NE(said.find("too many messages"), std::string::npos);
  EXPECT_LT(said.size(), 3 * 600u);
}

TEST(WebSocket, WhoReadsSlowlyLosesFramesAndOthersDoNot) {
  EchoServer echo;
  const auto slow = echo.enter();
  const auto quick = echo.enter();
  // Four times what may wait for one peer.
  const auto burst = std::make_shared<const std::string>(64 << 10, 'z');
  std::uint64_t lost_by_quick = 0;
  for (int n = 0; n < 512; ++n) {
    echo.server.with([&](WebServer&) {
      ASSERT_EQ(echo.peers.size(), 2u);
      echo.peers[0]->send_binary(burst);
      lost_by_quick += echo.peers[1]->send_binary(burst) ? 0 : 1;
    });
    quick->read_until(*burst);
    quick->forget();
  }
  EXPECT_EQ(lost_by_quick, 0u);
  EXPECT_GT(echo.server.counters().frames_dropped, 100u);
}

TEST(WebServer, WithACertificateItSpeaksTlsAlone) {
  const std::string folder = testing::TempDir() + "tls" + std::to_string(getpid());
  std::filesystem::create_directory(folder);
  ASSERT_EQ(std::system(("openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days 1 -subj "
                         "/CN=localhost -keyout " +
                         folder + "/key -out " + folder + "/certificate 2> /dev/null")
                            .c_str()),
            0);
  WebOptions options;
  options.certificate = folder + "/certificate";
  options.key = folder + "/key";
  {
    ServedInBackground server(options, tell_access);
    RawConnection plain(server.port());
    plain.send("GET / HTTP/1.1\r\nHost: " + plain.host() + "\r\n\r\n");
    EXPECT_EQ(status_of(plain.read_to_end()), 0);
    EXPECT_TRUE(plain.is_over());
    const auto shaken = [&](int version) {
      RawConnection connection(server.port());
      SSL_CTX* context = SSL_CTX_new(TLS_client_method());
      SSL_CTX_set_max_proto_version(context, version);
      SSL* tls = SSL_new(context);
      SSL_set_fd(tls, connection.descriptor());
      std::string answer;
      if (SSL_connect(tls) == 1) {
        const std::string request = "GET / HTTP/1.1\r\nHost: " + connection.host() + "\r\nConnection: close\r\n\r\n";
        SSL_write(tls, request.data(), static_cast<int>(request.size()));
        char bytes[4096];
        for (int count; (count = SSL_read(tls, bytes, sizeof bytes)) > 0;)
          answer.append(bytes, static_cast<std::size_t>(count));
      }
      SSL_free(tls);
      SSL_CTX_free(context);
      return status_of(answer);
    };
    EXPECT_EQ(shaken(TLS1_3_VERSION), 200);
    EXPECT_EQ(shaken(TLS1_2_VERSION), 200);
    EXPECT_EQ(shaken(TLS1_1_VERSION), 0);
  }
  std::swap(options.certificate, options.key);
  EXPECT_THROW(WebServer(options, tell_access, {}), SettingsError);
  options.certificate = folder + "/none";
  EXPECT_THROW(WebServer(options, tell_access, {}), SettingsError);
  std::filesystem::remove_all(folder);
}

TEST(WebServer, APortThatSomebodyHasIsNamed) {
  ServedInBackground first({}, tell_access);
  WebOptions options;
  options.port = first.port();
  try {
    WebServer second(options, tell_access, {});
    ADD_FAILURE() << "two at one port";
  } catch (const std::runtime_error& error) {
    EXPECT_NE(std::string(error.what()).find(std::to_string(first.port())), std::string::npos) << error.what();
  }
}

}  // namespace
}  // namespace weakgrid
