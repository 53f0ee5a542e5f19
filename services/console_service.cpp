// weakgrid-console: what happens in a domain, for people and their tools, over HTTP.
#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>

#include "services/console/foxglove.hpp"
#include "services/console/metrics.hpp"
#include "services/console/web_server.hpp"
#include "services/recording/idl_text.hpp"
#include "services/recording/ring.hpp"
#include "services/runtime/announcer.hpp"
#include "services/runtime/payload.hpp"
#include "services/runtime/program.hpp"
#include "services/runtime/service_manager.hpp"
#include "services/runtime/tap.hpp"

namespace weakgrid {
namespace {

constexpr std::size_t writers_max = 4096;
// A second of two loops at 20 kHz.
constexpr std::size_t ring_bytes = 16 << 20;

bool is_loopback(const std::string& address) { return address == "::1" || address.starts_with("127."); }

WebOptions web_options(const Settings& settings) {
  const auto& c = settings.console;
  if (c.certificate.empty() != c.key.empty())
    throw SettingsError("console: a certificate and its key belong together, or neither is given");
  if (!is_loopback(c.address) && (c.certificate.empty() || c.tokens.empty()))
    throw SettingsError("console.address: " + c.address +
                        " is reached by others: that takes a certificate, its key and tokens");
  return {.address = c.address,
          .port = static_cast<std::uint16_t>(c.port),
          .certificate = c.certificate,
          .key = c.key,
          .tokens = c.tokens.empty() ? std::vector<std::pair<Access, std::string>>{} : read_tokens(c.tokens),
          .hosts = c.hosts,
          .origins = c.origins};
}

std::int64_t steady_ns() { return std::chrono::steady_clock::now().time_since_epoch().count(); }

class ConsoleService {
 public:
  explicit ConsoleService(const Settings& settings)
      : ring_(ring_bytes, writers_max),
        foxglove_("weakgrid", std::string(idl_text()),
                  [](const std::string& type) { return is_state_type(type).has_value(); }),
        server_(web_options(settings), [this](const WebRequest& r) { return answer(r); }, protocols()),
        bus_(settings.unit.domain, settings.dds, Role::console),
        announcer_(bus_, settings, "console", {}),
        tap_(std::make_unique<Tap>(Tap::Options{.domain = settings.unit.domain,
                                                .dds = settings.dds,
                                                .role = Role::console,
                                                .filter = {},
                                                .writers_max = writers_max},
                                   [this](const SourceWriter& w) { add(w); },
                                   [this](const RawSample& s) { ring_.put(s); })) {
    spdlog::info("serves at {}://{}:{}/", settings.console.certificate.empty() ? "http" : "https",
                 settings.console.address, server_.port());
  }
  ~ConsoleService() { tap_.reset(); }

  void serve(StopSignal& stop) {
    ServiceManager manager({.status = [this] { return one_line({&announcer_.said()}); }, .stuck = {}});
    while (!stop.wait(std::chrono::milliseconds(0))) {
      server_.serve_for(std::chrono::milliseconds(10));
      take_all();
      announcer_.say(health());
      manager.tell();
    }
  }

 private:
  std::vector<WebServer::Protocol> protocols() {
    std::vector<WebServer::Protocol> all;
    for (const char* name : Foxglove::names)
      all.push_back({"/", name, [this](WebPeer& peer, Access) { return foxglove_.converse(peer); }});
    return all;
  }

  WebResponse answer(const WebRequest& request) {
    if (request.access == Access::none) return {.status = 401, .body = "log in first\n"};
    if (request.method != "GET") return {.status = 405, .body = "GET\n"};
    if (request.path == "/metrics")
      return {.type = "text/plain; version=0.0.4; charset=utf-8",
              .body = metrics_.text(steady_ns())};
    return {.status = 404, .body = "there is no such page\n"};
  }

  // On a thread of the bus.
  void add(const SourceWriter& writer) {
    const std::lock_guard lock(mutex_);
    new_writers_.push_back(writer);
  }

  void take_all() {
    take_new_writers();
    // Bounded: whoever floods the domain keeps nobody from being served.
    for (std::size_t left = 20'000; left > 0; --left) {
      const auto sample = ring_.front();
      if (!sample) return;
      if (sample->writer >= types_.size()) take_new_writers();  // told of before its first sample
      if (sample->writer < types_.size()) take(*sample);
      ring_.drop_front();
    }
  }

  void take_new_writers() {
    const std::lock_guard lock(mutex_);
    for (const SourceWriter& writer : new_writers_) {
      types_.push_back(writer.type);
      foxglove_.see(writer);
    }
    new_writers_.clear();
  }

  void take(const RawSample& sample) {
    ++heard_;
    foxglove_.take(sample);
    if (!sample.has_data) return;
    const std::string& type = types_[sample.writer];
    const std::int64_t now = steady_ns();
    if (type == "weakgrid::wire::Measurement")
      with<Measurement>(sample, [&](std::uint32_t u, const Measurement& m) { metrics_.hear(u, m, now); });
    else if (type == "weakgrid::wire::Health")
      with<Health>(sample, [&](std::uint32_t u, const Health& m) { metrics_.hear(u, m, now, wall_time_ns()); });
    else if (type == "weakgrid::wire::Manifest")
      with<Manifest>(sample, [&](std::uint32_t u, const Manifest& m) { metrics_.hear(u, m); });
    else if (type == "weakgrid::wire::SetpointDecision")
      with<DecisionMessage>(sample, [&](std::uint32_t u, const DecisionMessage& m) { metrics_.hear(u, m.decision); });
  }

  template <class Message, class Take>
  void with(const RawSample& sample, Take take) {
    if (const auto of = from_payload<Message>(sample.payload)) take(of->unit, of->message);
  }

  std::uint64_t dropped() const {
    std::uint64_t sum = 0;
    for (std::uint32_t n = 0; n < types_.size(); ++n) sum += ring_.drops(n);
    return sum;
  }

  Health health() {
    Health health;
    health.state = ServiceState::running;
    const WebCounters& web = server_.counters();
    health.counters = {{"heard", heard_},
                       {"dropped", dropped()},
                       {"left_out", tap_->left_out()},
                       {"connections", web.connections},
                       {"conversations", web.conversations},
                       {"requests", web.requests},
                       {"refused", web.refused},
                       {"frames_dropped", web.frames_dropped}};
    return health;
  }

  SampleRing ring_;
  std::mutex mutex_;
  std::vector<SourceWriter> new_writers_;
  std::vector<std::string> types_;  // by a writer's index
  std::uint64_t heard_ = 0;
  Metrics metrics_;
  Foxglove foxglove_;
  WebServer server_;
  Bus bus_;
  Announcer announcer_;
  std::unique_ptr<Tap> tap_;
};

}  // namespace
}  // namespace weakgrid

int main(int argc, char** argv) {
  using namespace weakgrid;
  return run_service(argc, argv, "weakgrid-console",
                     "Shows a DDS domain over HTTP: a page, Foxglove's WebSocket, metrics for Prometheus.", {},
                     [](const Settings& settings, StopSignal& stop) { ConsoleService(settings).serve(stop); });
}
