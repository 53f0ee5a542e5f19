// Bus over Fast DDS 2.9. Newer majors differ here and nowhere else.
#include "services/runtime/bus.hpp"

#include <algorithm>
#include <cstring>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/DataWriterListener.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>

#include "services/runtime/participant.hpp"
#include "services/runtime/wire.hpp"

namespace weakgrid {

namespace dds = eprosima::fastdds::dds;
using eprosima::fastrtps::Duration_t;
using eprosima::fastrtps::types::ReturnCode_t;

namespace {

// Units of one topic that one process may meet; more are refused by the middleware.
constexpr int max_units = 64;

WriterId writer_id(const dds::InstanceHandle_t& handle) {
  // FNV-1a over the GUID.
  WriterId hash = 14695981039346656037ull;
  for (int n = 0; n < 16; ++n) hash = (hash ^ handle.value[n]) * 1099511628211ull;
  return hash == 0 ? 1 : hash;
}

// What a loop, a command and a state topic ask of DDS; the same for both ends.
template <class Qos>
void apply(QosClass qos_class, bool is_reader, Qos& qos) {
  qos.data_sharing().off();
  switch (qos_class) {
    case QosClass::sample:
      // Best effort: a late sample is worthless, and reliability costs allocations at each write.
      qos.reliability().kind = dds::BEST_EFFORT_RELIABILITY_QOS;
      qos.durability().kind = dds::VOLATILE_DURABILITY_QOS;
      qos.history().kind = dds::KEEP_LAST_HISTORY_QOS;
      qos.history().depth = is_reader ? 8 : 1;
      break;
    case QosClass::command:
      qos.reliability().kind = dds::RELIABLE_RELIABILITY_QOS;
      // The writer keeps what it wrote for a recorder that hears of it late; whoever acts on it must not be
      // late.
      qos.durability().kind = is_reader ? dds::VOLATILE_DURABILITY_QOS : dds::TRANSIENT_LOCAL_DURABILITY_QOS;
      qos.history().kind = dds::KEEP_ALL_HISTORY_QOS;
      break;
    case QosClass::state:
      qos.reliability().kind = dds::RELIABLE_RELIABILITY_QOS;
      qos.durability().kind = dds::TRANSIENT_LOCAL_DURABILITY_QOS;
      qos.history().kind = dds::KEEP_LAST_HISTORY_QOS;
      qos.history().depth = 1;
      break;
  }
  const int per_instance = qos_class == QosClass::command ? 1024 : qos.history().depth;
  qos.resource_limits().max_instances = max_units;
  qos.resource_limits().max_samples_per_instance = per_instance;
  qos.resource_limits().max_samples = max_units * per_instance;
  qos.resource_limits().allocated_samples = std::min(per_instance, 64);
  qos.endpoint().history_memory_policy =
      qos_class == QosClass::sample ? eprosima::fastrtps::rtps::PREALLOCATED_MEMORY_MODE
                                    : eprosima::fastrtps::rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
}

template <class Pointer>
Pointer* made(Pointer* entity, const std::string& what) {
  if (entity == nullptr) throw BusError("DDS: " + what + " cannot be made");
  return entity;
}

}  // namespace

struct Bus::Impl {
  dds::DomainParticipant* participant = nullptr;
  dds::Publisher* publisher = nullptr;
  dds::Subscriber* subscriber = nullptr;

  template <class Message>
  dds::Topic* topic() {
    using T = Topic<Message>;
    if (dds::TopicDescription* known = participant->lookup_topicdescription(T::name))
      return static_cast<dds::Topic*>(known);
    dds::TypeSupport type(new typename T::Type());
    if (type.register_type(participant) != ReturnCode_t::RETCODE_OK)
      throw BusError(std::string("DDS: type of ") + T::name + " cannot be registered");
    return made(participant->create_topic(T::name, type.get_type_name(), dds::TOPIC_QOS_DEFAULT), T::name);
  }
};

Bus::Bus(std::uint32_t domain, const std::vector<std::string>& interfaces, const std::string& name)
    : impl_(std::make_unique<Impl>()) {
  const dds::DomainParticipantQos qos = participant_qos(name, interfaces);
  auto* factory = dds::DomainParticipantFactory::get_instance();
  impl_->participant =
      made(factory->create_participant(domain, qos), "participant in domain " + std::to_string(domain));
  impl_->publisher = made(impl_->participant->create_publisher(dds::PUBLISHER_QOS_DEFAULT), "publisher");
  impl_->subscriber = made(impl_->participant->create_subscriber(dds::SUBSCRIBER_QOS_DEFAULT), "subscriber");
}

Bus::~Bus() {
  impl_->participant->delete_contained_entities();
  dds::DomainParticipantFactory::get_instance()->delete_participant(impl_->participant);
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
  apply(Topic<Message>::qos, false, qos);
  qos.publish_mode().kind = dds::SYNCHRONOUS_PUBLISH_MODE;
  // A full history waits for acknowledgements, and these for a heartbeat: 64 samples and 100 ms let some 100
  // commands a second through, 1024 and 10 ms more than 1000.
  qos.reliable_writer_qos().times.heartbeatPeriod = Duration_t(0, 10'000'000);
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
  return impl_->writer->write(&impl_->wire);
}

template <class Message>
bool Writer<Message>::wait_until_taken(std::chrono::milliseconds patience) noexcept {
  const Duration_t span(static_cast<std::int32_t>(patience.count() / 1000),
                        static_cast<std::uint32_t>(patience.count() % 1000 * 1'000'000));
  return impl_->writer->wait_for_acknowledgments(span) == ReturnCode_t::RETCODE_OK;
}

template <class Message>
int Writer<Message>::matched() const noexcept {
  return impl_->matched;
}

template <class Message>
struct Reader<Message>::Impl : dds::DataReaderListener {
  dds::Subscriber* subscriber;
  dds::DataReader* reader = nullptr;
  std::uint32_t unit;
  Take take;
  typename Topic<Message>::Wire wire;
  Message message;
  dds::SampleInfo info;
  std::array<std::atomic<WriterId>, 16> alive{};
  std::atomic<int> matched{0};
  std::atomic<std::uint64_t> malformed{0};

  void on_data_available(dds::DataReader* from) override {
    while (from->take_next_sample(&wire, &info) == ReturnCode_t::RETCODE_OK) {
      if (!info.valid_data || wire.unit() != unit) continue;
      if (decode(wire, message))
        take(message, writer_id(info.publication_handle));
      else
        malformed.fetch_add(1, std::memory_order_relaxed);
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
Reader<Message>::Reader(Bus& bus, std::uint32_t unit, Take take) : impl_(std::make_unique<Impl>()) {
  impl_->subscriber = bus.impl().subscriber;
  impl_->unit = unit;
  impl_->take = std::move(take);
  dds::DataReaderQos qos;
  apply(Topic<Message>::qos, true, qos);
  impl_->reader = made(impl_->subscriber->create_datareader(bus.impl().topic<Message>(), qos, impl_.get(),
                                                            dds::StatusMask::data_available()
                                                                << dds::StatusMask::subscription_matched()),
                       std::string("reader of ") + Topic<Message>::name);
}

template <class Message>
Reader<Message>::~Reader() {
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
std::uint64_t Reader<Message>::malformed() const noexcept {
  return impl_->malformed.load(std::memory_order_relaxed);
}

#define WEAKGRID_INSTANTIATE(Message) \
  template class Writer<Message>;     \
  template class Reader<Message>;
WEAKGRID_MESSAGES(WEAKGRID_INSTANTIATE)
#undef WEAKGRID_INSTANTIATE

}  // namespace weakgrid
