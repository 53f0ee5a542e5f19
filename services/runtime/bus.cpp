// Bus over Fast DDS: see the header.
#include "services/runtime/bus.hpp"

#include <algorithm>
#include <cstring>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/DataWriterListener.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>

#include "services/runtime/participant.hpp"
#include "services/runtime/pulse.hpp"
#include "services/runtime/qos.hpp"
#include "services/runtime/wire.hpp"

namespace weakgrid {

namespace {

// Writers of one topic of its units that a reader tells apart.
constexpr std::size_t max_writers = 128;

WriterId writer_id(const dds::InstanceHandle_t& handle) {
  // FNV-1a over the GUID.
  WriterId hash = 14695981039346656037ull;
  for (int n = 0; n < 16; ++n) hash = (hash ^ handle.value[n]) * 1099511628211ull;
  return hash == 0 ? 1 : hash;
}

template <class Pointer>
Pointer* made(Pointer* entity, const std::string& what) {
  if (entity == nullptr) throw BusError("DDS: " + what + " cannot be made" + reason());
  return entity;
}

}  // namespace

struct Bus::Impl {
  dds::DomainParticipant* participant = nullptr;
  dds::Publisher* publisher = nullptr;
  dds::Subscriber* subscriber = nullptr;
  LoopTransport loop = LoopTransport::udp;
  std::vector<std::pair<const char*, Pulse*>> readers;

  template <class Message>
  dds::Topic* topic() {
    using T = Topic<Message>;
    if (dds::TopicDescription* known = participant->lookup_topicdescription(T::name))
      return static_cast<dds::Topic*>(known);
    dds::TypeSupport type(new typename T::Type());
    if (!is_ok(type.register_type(participant)))
      throw BusError(std::string("DDS: type of ") + T::name + " cannot be registered");
    return made(participant->create_topic(T::name, type.get_type_name(), dds::TOPIC_QOS_DEFAULT), T::name);
  }
};

Bus::Bus(std::uint32_t domain, const DdsSettings& dds, Role role) : impl_(std::make_unique<Impl>()) {
  if (is_of_loop(role)) impl_->loop = dds.loop;
  impl_->participant = make_participant(domain, dds, role);
  impl_->publisher = made(impl_->participant->create_publisher(dds::PUBLISHER_QOS_DEFAULT), "publisher");
  impl_->subscriber = made(impl_->participant->create_subscriber(dds::SUBSCRIBER_QOS_DEFAULT), "subscriber");
}

Bus::~Bus() {
  impl_->participant->delete_contained_entities();
  dds::DomainParticipantFactory::get_instance()->delete_participant(impl_->participant);
}

std::string Bus::stuck() {
  std::string topic;
  for (const auto& [name, pulse] : impl_->readers)
    if (pulse->stands()) topic = std::string("the taker of ") + name;  // every one is asked
  return topic;
}

template <class Message>
struct Writer<Message>::Impl : dds::DataWriterListener {
  dds::Publisher* publisher;
  dds::DataWriter* writer = nullptr;
  typename Topic<Message>::Wire wire;
  std::atomic<int> matched{0};

  void on_publication_matched(dds::DataWriter*, const dds::PublicationMatchedStatus& status) override {
    matched = status.current_count;
  }
};

template <class Message>
Writer<Message>::Writer(Bus& bus, std::uint32_t unit) : impl_(std::make_unique<Impl>()) {
  impl_->publisher = bus.impl().publisher;
  impl_->wire.unit(unit);
  dds::DataWriterQos qos;
  apply<Message>(false, bus.impl().loop, qos);
  qos.publish_mode().kind = dds::SYNCHRONOUS_PUBLISH_MODE;
  // A full history waits for acknowledgements, and these for a heartbeat: 64 samples and 100 ms let some 100
  // commands a second through, 1024 and 10 ms more than 1000.
  set_heartbeat_period(qos, Duration_t(0, 10'000'000));
  impl_->writer = made(impl_->publisher->create_datawriter(bus.impl().topic<Message>(), qos, impl_.get(),
                                                           dds::StatusMask::publication_matched()),
                       std::string("writer of ") + Topic<Message>::name);
}

template <class Message>
Writer<Message>::~Writer() {
  impl_->publisher->delete_datawriter(impl_->writer);
}

template <class Message>
bool Writer<Message>::write(const Message& message) noexcept {
  encode(message, impl_->wire);
  return is_ok(impl_->writer->write(&impl_->wire));
}

template <class Message>
bool Writer<Message>::wait_until_taken(std::chrono::milliseconds patience) noexcept {
  const Duration_t span(static_cast<std::int32_t>(patience.count() / 1000),
                        static_cast<std::uint32_t>(patience.count() % 1000 * 1'000'000));
  return is_ok(impl_->writer->wait_for_acknowledgments(span));
}

template <class Message>
int Writer<Message>::matched() const noexcept {
  return impl_->matched;
}

template <class Message>
WriterId Writer<Message>::id() const noexcept {
  return writer_id(impl_->writer->get_instance_handle());
}

template <class Message>
struct Reader<Message>::Impl : dds::DataReaderListener {
  dds::Subscriber* subscriber;
  dds::DataReader* reader = nullptr;
  Units units{0};
  Take take;
  typename Topic<Message>::Wire wire;
  Message message;
  dds::SampleInfo info;
  std::array<std::atomic<WriterId>, max_writers> alive{};
  std::atomic<int> matched{0};
  std::vector<std::atomic<std::uint64_t>> malformed;  // of each unit
  Bus::Impl* bus = nullptr;
  Pulse pulse;

  void on_data_available(dds::DataReader* from) override {
    const Working working(pulse);
    while (is_ok(from->take_next_sample(&wire, &info))) {
      pulse.beat();
      const std::uint32_t index = wire.unit() - units.first;
      if (!info.valid_data || index >= units.count) continue;
      if (decode(wire, message))
        take(message, {wire.unit(), writer_id(info.publication_handle), info.source_timestamp.to_ns()});
      else
        malformed[index].fetch_add(1, std::memory_order_relaxed);
    }
  }

  void on_subscription_matched(dds::DataReader*, const dds::SubscriptionMatchedStatus& status) override {
    const WriterId writer = writer_id(status.last_publication_handle);
    const WriterId from = status.current_count_change > 0 ? 0 : writer;
    const WriterId to = status.current_count_change > 0 ? writer : 0;
    for (auto& slot : alive) {
      WriterId expected = from;
      if (slot.compare_exchange_strong(expected, to)) break;
    }
    matched = status.current_count;
  }
};

template <class Message>
Reader<Message>::Reader(Bus& bus, Units units, Take take) : impl_(std::make_unique<Impl>()) {
  impl_->subscriber = bus.impl().subscriber;
  impl_->units = units;
  impl_->malformed = std::vector<std::atomic<std::uint64_t>>(units.count);
  impl_->take = std::move(take);
  dds::DataReaderQos qos;
  apply<Message>(true, bus.impl().loop, qos);
  impl_->reader = made(impl_->subscriber->create_datareader(bus.impl().topic<Message>(), qos, impl_.get(),
                                                            dds::StatusMask::data_available()
                                                                << dds::StatusMask::subscription_matched()),
                       std::string("reader of ") + Topic<Message>::name);
  impl_->bus = &bus.impl();
  impl_->bus->readers.emplace_back(Topic<Message>::name, &impl_->pulse);
}

template <class Message>
Reader<Message>::~Reader() {
  std::erase_if(impl_->bus->readers, [this](const auto& reader) { return reader.second == &impl_->pulse; });
  impl_->reader->set_listener(nullptr);
  impl_->subscriber->delete_datareader(impl_->reader);
}

template <class Message>
int Reader<Message>::matched() const noexcept {
  return impl_->matched;
}

template <class Message>
bool Reader<Message>::is_alive(WriterId writer) const noexcept {
  return std::any_of(impl_->alive.begin(), impl_->alive.end(),
                     [writer](const auto& slot) { return slot.load(std::memory_order_relaxed) == writer; });
}

template <class Message>
std::uint64_t Reader<Message>::malformed(std::uint32_t unit) const noexcept {
  return impl_->malformed[unit - impl_->units.first].load(std::memory_order_relaxed);
}

#define WEAKGRID_INSTANTIATE(Message) \
  template class Writer<Message>;     \
  template class Reader<Message>;
WEAKGRID_MESSAGES(WEAKGRID_INSTANTIATE)
#undef WEAKGRID_INSTANTIATE

}  // namespace weakgrid
