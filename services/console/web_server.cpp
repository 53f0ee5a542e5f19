// The one file that includes Boost.Beast, which takes long to compile: see the header.
#include "services/console/web_server.hpp"

#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/ssl.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/http.hpp>
#include <boost/beast/ssl.hpp>
#include <boost/beast/websocket.hpp>
#include <boost/beast/websocket/ssl.hpp>
#include <deque>
#include <stdexcept>

#include "services/runtime/settings.hpp"

namespace weakgrid {

namespace {

namespace asio = boost::asio;
namespace beast = boost::beast;
namespace http = beast::http;
namespace websocket = beast::websocket;
using Tcp = asio::ip::tcp;
using beast::error_code;
using PlainStream = beast::tcp_stream;
using TlsStream = beast::ssl_stream<beast::tcp_stream>;

constexpr std::size_t connections_max = 64;
constexpr std::size_t header_bytes_max = 8 << 10;
constexpr std::size_t body_bytes_max = 16 << 10;
constexpr std::size_t message_bytes_max = 64 << 10;
constexpr std::size_t queue_bytes_max = 4 << 20;
constexpr std::chrono::seconds request_patience{15};
// Messages from one peer: a person clicks and moves a mouse, a program subscribes to topics.
constexpr double messages_per_s = 100.0, messages_at_once = 400.0;

// Nothing from elsewhere, no script in the page, in nobody's frame.
constexpr const char* content_policy =
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
    "manifest-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'";

// What all connections have in common.
struct Shared {
  WebServer::Answer answer;
  std::vector<WebServer::Protocol> protocols;
  WebAccess access;
  std::optional<WebNames> names;  // once the port is known
  WebCounters counters;
  bool tls = false;
};

PlainStream& lowest(PlainStream& stream) { return stream; }
PlainStream& lowest(TlsStream& stream) { return beast::get_lowest_layer(stream); }

std::string_view view(beast::string_view text) { return {text.data(), text.size()}; }

// Counts as long as it lives.
class Counted {
 public:
  explicit Counted(std::uint64_t& count) : count_(count) { ++count_; }
  ~Counted() { --count_; }
  Counted(const Counted&) = delete;
  Counted& operator=(const Counted&) = delete;

 private:
  std::uint64_t& count_;
};

template <class Stream>
class Socket final : public WebPeer, public std::enable_shared_from_this<Socket<Stream>> {
 public:
  Socket(Stream stream, std::shared_ptr<Shared> shared, std::unique_ptr<Counted> connection)
      : shared_(std::move(shared)),
        connection_(std::move(connection)),
        conversation_count_(shared_->counters.conversations),
        stream_(std::move(stream)) {}

  void open(http::request<http::string_body> request, const WebServer::Protocol& protocol, Access access) {
    beast::get_lowest_layer(stream_).expires_never();  // the WebSocket has a timeout of its own
    stream_.set_option(websocket::stream_base::timeout{std::chrono::seconds(3), std::chrono::seconds(20), true});
    stream_.read_message_max(message_bytes_max);
    stream_.auto_fragment(false);
    stream_.set_option(websocket::stream_base::decorator(
        [name = protocol.name](websocket::response_type& response) {
          response.set(http::field::sec_websocket_protocol, name);
        }));
    request_ = std::move(request);
    conversation_ = protocol.converse(*this, access);
    stream_.async_accept(request_, beast::bind_front_handler(&Socket::opened, this->shared_from_this()));
  }

  bool send_text(std::shared_ptr<const std::string> frame) override { return send(std::move(frame), true); }
  bool send_binary(std::shared_ptr<const std::string> frame) override { return send(std::move(frame), false); }
  void close(const std::string& why) override { close(websocket::close_code::normal, why); }

 private:
  struct Frame {
    std::shared_ptr<const std::string> bytes;
    bool is_text;
  };

  bool send(std::shared_ptr<const std::string> frame, bool is_text) {
    if (closing_) return false;
    if (queued_bytes_ + frame->size() > queue_bytes_max) {
      ++shared_->counters.frames_dropped;
      return false;
    }
    queued_bytes_ += frame->size();
    queue_.push_back({std::move(frame), is_text});
    write_next();
    return true;
  }

  void close(websocket::close_code code, const std::string& why) {
    if (closing_) return;
    closing_.emplace(code, why.substr(0, 120));
    write_next();
  }

  void opened(error_code error) {
    if (error) return;
    is_open_ = true;
    read_next();
    write_next();
  }

  void read_next() {
    stream_.async_read(buffer_, beast::bind_front_handler(&Socket::heard, this->shared_from_this()));
  }

  void heard(error_code error, std::size_t) {
    if (error) {
      if (error == websocket::error::message_too_big) ++shared_->counters.refused;
      return;
    }
    const auto now = std::chrono::steady_clock::now();
    allowance_ = std::min(messages_at_once,
                          allowance_ + messages_per_s * std::chrono::duration<double>(now - heard_).count());
    heard_ = now;
    if (closing_) return;
    if ((allowance_ -= 1.0) < 0.0) {
      ++shared_->counters.refused;
      return close(websocket::close_code::policy_error, "too many messages");
    }
    const std::string_view message{static_cast<const char*>(buffer_.data().data()), buffer_.size()};
    if (stream_.got_text())
      conversation_->hear_text(message);
    else
      conversation_->hear_binary(message);
    buffer_.consume(buffer_.size());
    read_next();
  }

  void write_next() {
    if (!is_open_ || is_writing_) return;
    if (queue_.empty()) {
      if (!closing_ || std::exchange(is_writing_, true)) return;
      stream_.async_close(*closing_, [self = this->shared_from_this()](error_code) {});
      return;
    }
    is_writing_ = true;
    stream_.text(queue_.front().is_text);
    stream_.async_write(asio::buffer(*queue_.front().bytes),
                        beast::bind_front_handler(&Socket::written, this->shared_from_this()));
  }

  void written(error_code error, std::size_t) {
    is_writing_ = false;
    if (error) return;
    queued_bytes_ -= queue_.front().bytes->size();
    queue_.pop_front();
    write_next();
  }

  std::shared_ptr<Shared> shared_;
  std::unique_ptr<Counted> connection_;
  Counted conversation_count_;
  websocket::stream<Stream> stream_;
  http::request<http::string_body> request_;
  beast::flat_buffer buffer_{message_bytes_max + 1};
  std::deque<Frame> queue_;
  std::size_t queued_bytes_ = 0;
  bool is_open_ = false, is_writing_ = false;
  std::optional<websocket::close_reason> closing_;
  double allowance_ = messages_at_once;
  std::chrono::steady_clock::time_point heard_ = std::chrono::steady_clock::now();
  std::unique_ptr<Conversation> conversation_;  // goes first: it knows this peer
};

template <class Stream>
class Connection final : public std::enable_shared_from_this<Connection<Stream>> {
 public:
  Connection(Stream stream, std::shared_ptr<Shared> shared)
      : shared_(std::move(shared)),
        count_(std::make_unique<Counted>(shared_->counters.connections)),
        stream_(std::move(stream)) {}

  void begin() {
    if constexpr (std::is_same_v<Stream, TlsStream>) {
      lowest(stream_).expires_after(request_patience);
      stream_.async_handshake(asio::ssl::stream_base::server,
                              [self = this->shared_from_this()](error_code error) {
                                if (error) {
                                  ++self->shared_->counters.refused;
                                  return;
                                }
                                self->read_next();
                              });
    } else {
      read_next();
    }
  }

 private:
  using Request = http::request<http::string_body>;
  using Response = http::response<http::string_body>;

  void read_next() {
    parser_.emplace();
    parser_->header_limit(header_bytes_max);
    parser_->body_limit(body_bytes_max);
    lowest(stream_).expires_after(request_patience);
    http::async_read(stream_, buffer_, *parser_,
                     beast::bind_front_handler(&Connection::heard, this->shared_from_this()));
  }

  void heard(error_code error, std::size_t) {
    if (error == http::error::end_of_stream) return shut();
    if (error == http::error::body_limit || error == http::error::header_limit) {
      keeps_ = false;
      return respond(plain(http::status::payload_too_large, "larger than is taken"));
    }
    if (error) {
      // What is slow or gone is no request; what cannot be parsed is told so.
      if (error.category() != http::make_error_code(http::error::bad_method).category()) return;
      keeps_ = false;
      return respond(plain(http::status::bad_request, error.message()));
    }
    const Request request = parser_->release();
    keeps_ = request.keep_alive();
    is_head_ = request.method() == http::verb::head;
    if (!shared_->names->is_ours(view(request[http::field::host])))
      return respond(plain(http::status::misdirected_request, "this server does not go by that name"));
    if (!shared_->names->may_come_from(view(request[http::field::origin])))
      return respond(plain(http::status::forbidden, "not from that page"));
    const Access access = shared_->access.of(view(request[http::field::authorization]),
                                             view(request[http::field::cookie]));
    std::string_view path = view(request.target());
    path = path.substr(0, path.find('?'));
    if (websocket::is_upgrade(request)) return upgrade(request, path, access);
    if (path == "/login" || path == "/logout") return log_in_or_out(request, path);
    if (request.method() != http::verb::get && !is_head_ && request.method() != http::verb::post)
      return respond(plain(http::status::method_not_allowed, "GET, HEAD or POST"));
    WebResponse answer = shared_->answer(
        {is_head_ ? "GET" : view(request.method_string()), path, request.body(), access});
    Response response = plain(static_cast<http::status>(answer.status), "");
    response.set(http::field::content_type, answer.type);
    response.body() = std::move(answer.body);
    if (response.result() == http::status::unauthorized)
      response.set(http::field::www_authenticate, "Bearer");
    respond(std::move(response));
  }

  void upgrade(const Request& request, std::string_view path, Access access) {
    for (const WebServer::Protocol& protocol : shared_->protocols) {
      if (protocol.path != path) continue;
      for (const auto& offered : http::token_list{request[http::field::sec_websocket_protocol]}) {
        if (view(offered) != protocol.name) continue;
        if (access == Access::none)
          return respond(plain(http::status::unauthorized, "log in first"));
        ++shared_->counters.requests;
        std::make_shared<Socket<Stream>>(std::move(stream_), shared_, std::move(count_))
            ->open(request, protocol, access);
        return;
      }
    }
    respond(plain(http::status::bad_request, "no such WebSocket protocol at that path"));
  }

  void log_in_or_out(const Request& request, std::string_view path) {
    if (request.method() != http::verb::post)
      return respond(plain(http::status::method_not_allowed, "POST the token"));
    const std::string attributes =
        std::string("; Path=/; HttpOnly; SameSite=Strict") + (shared_->tls ? "; Secure" : "");
    if (path == "/logout") {
      shared_->access.log_out(view(request[http::field::cookie]));
      Response response = plain(http::status::no_content, "");
      response.set(http::field::set_cookie, std::string(WebAccess::cookie) + "=; Max-Age=0" + attributes);
      return respond(std::move(response));
    }
    const auto session = shared_->access.log_in(request.body());
    if (!session) return respond(plain(http::status::forbidden, "that is no token of this console"));
    Response response = plain(http::status::no_content, "");
    response.set(http::field::set_cookie, WebAccess::cookie + ("=" + *session) + attributes);
    respond(std::move(response));
  }

  static Response plain(http::status status, const std::string& text) {
    Response response{status, 11};
    response.set(http::field::content_type, "text/plain; charset=utf-8");
    if (!text.empty()) response.body() = text + "\n";
    return response;
  }

  void respond(Response response) {
    ++shared_->counters.requests;
    if (response.result_int() >= 400) ++shared_->counters.refused;
    response.set("Content-Security-Policy", content_policy);
    response.set("X-Content-Type-Options", "nosniff");
    response.set("Referrer-Policy", "no-referrer");
    response.set(http::field::cache_control, "no-store");
    response.keep_alive(keeps_);
    response.prepare_payload();
    response_ = std::move(response);
    if (is_head_) response_.body().clear();  // the length stays
    lowest(stream_).expires_after(request_patience);
    http::async_write(stream_, response_,
                      beast::bind_front_handler(&Connection::responded, this->shared_from_this()));
  }

  void responded(error_code error, std::size_t) {
    if (error) return;
    if (!keeps_) return shut();
    read_next();
  }

  void shut() {
    error_code ignored;
    lowest(stream_).socket().shutdown(Tcp::socket::shutdown_send, ignored);
  }

  std::shared_ptr<Shared> shared_;
  std::unique_ptr<Counted> count_;
  Stream stream_;
  beast::flat_buffer buffer_{header_bytes_max + body_bytes_max};
  std::optional<http::request_parser<http::string_body>> parser_;
  Response response_;
  bool keeps_ = false, is_head_ = false;
};

}  // namespace

struct WebServer::Impl {
  Impl(const WebOptions& options, Answer answer, std::vector<Protocol> protocols)
      : shared(std::make_shared<Shared>(Shared{.answer = std::move(answer),
                                               .protocols = std::move(protocols),
                                               .access = WebAccess(options.tokens),
                                               .names = {},
                                               .counters = {},
                                               .tls = !options.certificate.empty()})),
        acceptor(context) {
    if (shared->tls) use(options.certificate, options.key);
    error_code error;
    const auto address = asio::ip::make_address(options.address, error);
    if (error) throw SettingsError(options.address + ": not an address");
    const Tcp::endpoint endpoint{address, options.port};
    const auto check = [&](const char* what) {
      if (error)
        throw std::runtime_error("cannot " + std::string(what) + " " + options.address + " port " +
                                 std::to_string(options.port) + ": " + error.message());
    };
    acceptor.open(endpoint.protocol(), error);
    check("open");
    acceptor.set_option(asio::socket_base::reuse_address(true), error);
    acceptor.bind(endpoint, error);
    check("bind");
    acceptor.listen(asio::socket_base::max_listen_connections, error);
    check("listen at");
    port = acceptor.local_endpoint().port();
    shared->names.emplace(options.address, port, shared->tls, options.hosts, options.origins);
    accept();
  }

  void use(const std::string& certificate, const std::string& key) {
    error_code error;
    tls.set_options(asio::ssl::context::default_workarounds | asio::ssl::context::no_sslv2 |
                    asio::ssl::context::no_sslv3 | asio::ssl::context::no_tlsv1 |
                    asio::ssl::context::no_tlsv1_1);
    tls.use_certificate_chain_file(certificate, error);
    if (error) throw SettingsError(certificate + ": no certificate: " + error.message());
    tls.use_private_key_file(key, asio::ssl::context::pem, error);
    if (error) throw SettingsError(key + ": no key of that certificate: " + error.message());
  }

  void accept() {
    acceptor.async_accept([this](error_code error, Tcp::socket socket) {
      if (error == asio::error::operation_aborted) return;
      // Without descriptors this fails at once again: a moment lets go some.
      if (error) return retry();
      if (shared->counters.connections < connections_max) {
        error_code ignored;
        socket.set_option(Tcp::no_delay(true), ignored);
        PlainStream stream(std::move(socket));
        if (shared->tls)
          std::make_shared<Connection<TlsStream>>(TlsStream(std::move(stream), tls), shared)->begin();
        else
          std::make_shared<Connection<PlainStream>>(std::move(stream), shared)->begin();
      } else {
        ++shared->counters.refused;
      }
      accept();
    });
  }

  void retry() {
    pause.expires_after(std::chrono::milliseconds(100));
    pause.async_wait([this](error_code error) {
      if (!error) accept();
    });
  }

  asio::io_context context{1};
  asio::ssl::context tls{asio::ssl::context::tls_server};
  std::shared_ptr<Shared> shared;
  Tcp::acceptor acceptor;
  asio::steady_timer pause{context};
  std::uint16_t port = 0;
};

WebServer::WebServer(const WebOptions& options, Answer answer, std::vector<Protocol> protocols)
    : impl_(std::make_unique<Impl>(options, std::move(answer), std::move(protocols))) {}
WebServer::~WebServer() = default;

void WebServer::serve_for(std::chrono::milliseconds span) {
  impl_->context.restart();
  if (span.count() > 0)
    impl_->context.run_for(span);
  else
    impl_->context.poll();
}
std::uint16_t WebServer::port() const { return impl_->port; }
const WebCounters& WebServer::counters() const { return impl_->shared->counters; }

}  // namespace weakgrid
