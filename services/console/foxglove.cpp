// Foxglove: see the header.
#include "services/console/foxglove.hpp"

#include <algorithm>
#include <cstring>
#include <nlohmann/json.hpp>
#include <optional>

#include "services/runtime/announcer.hpp"

namespace weakgrid {

namespace {

using nlohmann::json;

constexpr std::size_t subscriptions_max = 256;
constexpr std::int64_t recently_ns = 2'000'000'000;
constexpr int level_warning = 1, level_error = 2;

std::shared_ptr<const std::string> text_of(const json& message) {
  return std::make_shared<const std::string>(message.dump(-1, ' ', false, json::error_handler_t::replace));
}

std::shared_ptr<const std::string> data_frame(std::uint32_t subscription, std::int64_t time_ns,
                                              std::string_view payload) {
  auto frame = std::make_shared<std::string>();
  frame->reserve(13 + payload.size());
  const auto put = [&](auto value) {  // little endian
    for (std::size_t n = 0; n < sizeof value; ++n) frame->push_back(static_cast<char>(value >> (8 * n)));
  };
  put(std::uint8_t{1});
  put(subscription);
  put(static_cast<std::uint64_t>(time_ns));
  frame->append(payload);
  return frame;
}

std::optional<std::uint32_t> number_at(const json& object, const char* key) {
  const auto found = object.is_object() ? object.find(key) : object.end();
  if (!object.is_object() || found == object.end() || !found->is_number_unsigned()) return std::nullopt;
  const auto number = found->get<std::uint64_t>();
  return number <= 0xffffffffu ? std::optional(static_cast<std::uint32_t>(number)) : std::nullopt;
}

}  // namespace

class Foxglove::Client final : public Conversation {
 public:
  Client(Foxglove& server, WebPeer& peer) : server_(server), peer_(peer) {
    server_.clients_.insert(this);
    peer_.send_text(text_of({{"op", "serverInfo"},
                             {"name", server_.server_name_},
                             {"capabilities", json::array()},
                             {"metadata", json::object()},
                             {"sessionId", server_.session_}}));
    if (!server_.channels_.empty()) tell(server_.advertise(server_.channels_));
  }
  ~Client() override { server_.clients_.erase(this); }

  void tell(std::string text) { peer_.send_text(std::make_shared<const std::string>(std::move(text))); }

  void take(std::uint32_t channel, std::int64_t time_ns, std::string_view payload) {
    const auto [first, last] = by_channel_.equal_range(channel);
    for (auto it = first; it != last; ++it) send(it->second, time_ns, payload);
  }

  void hear_binary(std::string_view) override {
    complain(level_error, "this server publishes nothing for its clients");
  }

  void hear_text(std::string_view text) override {
    const json message = json::parse(text, nullptr, false);
    const auto op = message.is_object() ? message.find("op") : message.end();
    if (!message.is_object() || op == message.end() || !op->is_string())
      return complain(level_error, "not a JSON object with an op");
    if (*op == "subscribe")
      for_each(message, "subscriptions", [&](const json& item) { subscribe(item); });
    else if (*op == "unsubscribe")
      for_each(message, "subscriptionIds", [&](const json& item) { unsubscribe(item); });
    else
      complain(level_error, "this server has no such capability: " + op->get<std::string>().substr(0, 64));
  }

 private:
  void for_each(const json& message, const char* key, const std::function<void(const json&)>& each) {
    const auto items = message.find(key);
    if (items == message.end() || !items->is_array())
      return complain(level_error, std::string("no list ") + key);
    for (const json& item : *items) each(item);
  }

  void subscribe(const json& item) {
    const auto id = number_at(item, "id"), channel = number_at(item, "channelId");
    if (!id || !channel) return complain(level_error, "a subscription has an id and a channelId");
    if (*channel == 0 || *channel > server_.channels_.size())
      return complain(level_error, "there is no channel " + std::to_string(*channel));
    if (channel_of_.contains(*id))
      return complain(level_error, "subscription " + std::to_string(*id) + " is there already");
    if (channel_of_.size() >= subscriptions_max) return complain(level_error, "too many subscriptions");
    channel_of_.emplace(*id, *channel);
    by_channel_.emplace(*channel, *id);
    for (const auto& [index, source] : server_.sources_)
      if (source.channel == *channel && !source.payload.empty() &&
          (source.stands || server_.now_ns_ - source.time_ns < recently_ns))
        send(*id, source.time_ns, source.payload);
  }

  void unsubscribe(const json& item) {
    const auto id = item.is_number_unsigned() && item.get<std::uint64_t>() <= 0xffffffffu
                        ? channel_of_.find(item.get<std::uint32_t>())
                        : channel_of_.end();
    if (id == channel_of_.end()) return complain(level_warning, "there is no such subscription");
    const auto [first, last] = by_channel_.equal_range(id->second);
    by_channel_.erase(std::find_if(first, last, [&](const auto& entry) { return entry.second == id->first; }));
    channel_of_.erase(id);
  }

  void send(std::uint32_t subscription, std::int64_t time_ns, std::string_view payload) {
    peer_.send_binary(data_frame(subscription, time_ns, payload));
  }

  void complain(int level, const std::string& what) {
    peer_.send_text(text_of({{"op", "status"}, {"level", level}, {"message", what}}));
  }

  Foxglove& server_;
  WebPeer& peer_;
  std::map<std::uint32_t, std::uint32_t> channel_of_;  // subscription → channel
  std::multimap<std::uint32_t, std::uint32_t> by_channel_;
};

Foxglove::Foxglove(std::string server_name, std::string schema,
                   std::function<bool(const std::string&)> has_schema)
    : server_name_(std::move(server_name)),
      session_(std::to_string(random_identity())),
      schema_(std::move(schema)),
      has_schema_(std::move(has_schema)) {}
Foxglove::~Foxglove() = default;

std::string Foxglove::advertise(const std::vector<Channel>& channels) const {
  json list = json::array();
  for (const Channel& channel : channels)
    list.push_back({{"id", channel.id},
                    {"topic", channel.topic},
                    {"encoding", "cdr"},
                    {"schemaName", channel.type},
                    {"schemaEncoding", "omgidl"},
                    {"schema", schema_}});
  return *text_of({{"op", "advertise"}, {"channels", list}});
}

void Foxglove::see(const SourceWriter& writer) {
  Source& source = sources_[writer.index];
  source.stands = writer.transient_local;
  source.is_reliable = writer.reliable;
  if (!has_schema_(writer.type)) return;
  const auto same = [&](const Channel& c) { return c.topic == writer.topic && c.type == writer.type; };
  const auto known = std::find_if(channels_.begin(), channels_.end(), same);
  if (known != channels_.end()) {
    source.channel = known->id;
    return;
  }
  source.channel = static_cast<std::uint32_t>(channels_.size() + 1);
  channels_.push_back({source.channel, writer.topic, writer.type});
  const std::string text = advertise({channels_.back()});
  for (Client* client : clients_) client->tell(text);
}

void Foxglove::take(const RawSample& sample) {
  const auto found = sources_.find(sample.writer);
  if (found == sources_.end() || found->second.channel == 0 || !sample.has_data) return;
  Source& source = found->second;
  const std::string_view payload{reinterpret_cast<const char*>(sample.payload.data()), sample.payload.size()};
  now_ns_ = sample.reception_ns;
  if (source.is_reliable) {
    source.time_ns = sample.reception_ns;
    source.payload = payload;
  }
  for (Client* client : clients_) client->take(source.channel, sample.reception_ns, payload);
}

std::unique_ptr<Conversation> Foxglove::converse(WebPeer& peer) {
  return std::make_unique<Client>(*this, peer);
}

}  // namespace weakgrid
