// RawWriter over Fast DDS 2.9. Newer majors differ here, in bus.cpp and in tap.cpp.
#include "services/runtime/raw_writer.hpp"

#include <fastdds/rtps/writer/WriterDiscoveryInfo.h>

#include <algorithm>
#include <cstring>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/domain/DomainParticipantListener.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>
#include <map>
#include <mutex>
#include <sstream>

#include "services/runtime/bus.hpp"
#include "services/runtime/participant.hpp"
#include "services/runtime/payload.hpp"

namespace weakgrid {

namespace dds = eprosima::fastdds::dds;
namespace rtps = eprosima::fastrtps::rtps;
using eprosima::fastrtps::Duration_t;
using eprosima::fastrtps::types::ReturnCode_t;

namespace {

// Of one writer; a payload of one more is not sent.
constexpr int instances_max = 4096;

/// What is written: the type beside it knows neither payload nor key.
struct Sample {
  std::span<const std::byte> bytes;
  KeyHash key{};
};

class RawType : public dds::TopicDataType {
 public:
  RawType(const std::string& name, bool keyed) {
    setName(name.c_str());
    m_typeSize = 256;  // first guess; the pool grows with what is written
    m_isGetKeyDefined = keyed;
  }
  bool serialize(void* data, rtps::SerializedPayload_t* payload) override {
    const std::span bytes = static_cast<const Sample*>(data)->bytes;
    if (bytes.size() > payload->max_size) return false;
    std::memcpy(payload->data, bytes.data(), bytes.size());
    payload->length = static_cast<std::uint32_t>(bytes.size());
    // The second byte of the header tells the byte order.
    payload->encapsulation = bytes.size() > 1 && (bytes[1] & std::byte{1}) == std::byte{0} ? CDR_BE : CDR_LE;
    return true;
  }
  bool deserialize(rtps::SerializedPayload_t*, void*) override { return false; }
  std::function<std::uint32_t()> getSerializedSizeProvider(void* data) override {
    const auto size = static_cast<std::uint32_t>(static_cast<const Sample*>(data)->bytes.size());
    return [size] { return size; };
  }
  void* createData() override { return new Sample; }
  void deleteData(void* data) override { delete static_cast<Sample*>(data); }
  bool getKey(void* data, rtps::InstanceHandle_t* handle, bool) override {
    const KeyHash& key = static_cast<const Sample*>(data)->key;
    for (std::size_t n = 0; n < key.size(); ++n) handle->value[n] = key[n];
    return m_isGetKeyDefined;
  }
};

template <class Pointer>
Pointer* made(Pointer* entity, const std::string& what) {
  if (entity == nullptr) throw BusError("DDS: " + what + " cannot be made");
  return entity;
}

dds::DataWriterQos qos_of(const RawWriter::Options& options) {
  dds::DataWriterQos qos;
  qos.data_sharing().off();
  qos.publish_mode().kind = dds::SYNCHRONOUS_PUBLISH_MODE;
  qos.reliability().kind =
      options.reliable ? dds::RELIABLE_RELIABILITY_QOS : dds::BEST_EFFORT_RELIABILITY_QOS;
  qos.durability().kind =
      options.transient_local ? dds::TRANSIENT_LOCAL_DURABILITY_QOS : dds::VOLATILE_DURABILITY_QOS;
  qos.ownership().kind = options.exclusive ? dds::EXCLUSIVE_OWNERSHIP_QOS : dds::SHARED_OWNERSHIP_QOS;
  qos.ownership_strength().value = options.strength;
  qos.history().kind = dds::KEEP_LAST_HISTORY_QOS;
  qos.history().depth = options.transient_local ? 1 : options.depth;
  qos.resource_limits().max_instances = instances_max;
  qos.resource_limits().max_samples_per_instance = qos.history().depth;
  qos.resource_limits().max_samples = instances_max * qos.history().depth;
  qos.resource_limits().allocated_samples = std::min(64, qos.history().depth);
  qos.endpoint().history_memory_policy = rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
  // How soon readers are asked what they have: wait_until_taken() takes that long.
  qos.reliable_writer_qos().times.heartbeatPeriod = Duration_t(0, 10'000'000);
  return qos;
}

}  // namespace

struct RawBus::Impl : dds::DomainParticipantListener {
  dds::DomainParticipant* participant = nullptr;
  std::map<std::vector<std::string>, dds::Publisher*> publishers;  // by partitions
  mutable std::mutex mutex;
  std::map<rtps::GUID_t, LiveWriter> others;

  void on_publisher_discovery(dds::DomainParticipant*, rtps::WriterDiscoveryInfo&& found) override {
    const rtps::GUID_t guid = found.info.guid();
    const std::lock_guard lock(mutex);
    if (found.status == rtps::WriterDiscoveryInfo::REMOVED_WRITER) {
      others.erase(guid);
      return;
    }
    std::ostringstream text;
    text << guid;
    others[guid] = {.guid = text.str(), .topic = found.info.topicName().to_string()};
  }

  dds::Topic* topic(const std::string& name, const std::string& type_name, bool keyed) {
    dds::TypeSupport type = participant->find_type(type_name);
    if (type.empty()) {
      type.reset(new RawType(type_name, keyed));
      if (type.register_type(participant) != ReturnCode_t::RETCODE_OK)
        throw BusError("DDS: type " + type_name + " cannot be registered");
    }
    auto* known = static_cast<dds::Topic*>(participant->lookup_topicdescription(name));
    if (type->m_isGetKeyDefined != keyed || (known != nullptr && known->get_type_name() != type_name))
      throw BusError("DDS: topic " + name + " cannot be written with two types");
    if (known != nullptr) return known;
    return made(participant->create_topic(name, type_name, dds::TOPIC_QOS_DEFAULT), "topic " + name);
  }

  dds::Publisher* publisher(const std::vector<std::string>& partitions) {
    dds::Publisher*& known = publishers[partitions];
    if (known != nullptr) return known;
    dds::PublisherQos qos;
    for (const std::string& partition : partitions) qos.partition().push_back(partition.c_str());
    return known = made(participant->create_publisher(qos), "publisher");
  }

  ~Impl() override {
    if (participant == nullptr) return;
    participant->set_listener(nullptr);
    participant->delete_contained_entities();
    dds::DomainParticipantFactory::get_instance()->delete_participant(participant);
  }
};

RawBus::RawBus(std::uint32_t domain, const DdsSettings& dds) : impl_(std::make_unique<Impl>()) {
  impl_->participant = make_participant(domain, dds, Role::replayer, impl_.get());
}

RawBus::~RawBus() = default;

std::vector<LiveWriter> RawBus::writers_of_others() const {
  const std::lock_guard lock(impl_->mutex);
  std::vector<LiveWriter> writers;
  for (const auto& [guid, writer] : impl_->others) writers.push_back(writer);
  return writers;
}

struct RawWriter::Impl {
  dds::Publisher* publisher;
  dds::DataWriter* writer;
  KeyOf key_of;
  KeyHash own_key{};  // where that of a payload is not known: one instance for each writer
  bool keyed;

  ~Impl() { publisher->delete_datawriter(writer); }
};

RawWriter::RawWriter(RawBus& bus, const Options& options) {
  RawBus::Impl& of = bus.impl();
  dds::Topic* topic = of.topic(options.topic, options.type, options.keyed);
  dds::Publisher* publisher = of.publisher(options.partitions);
  dds::DataWriter* writer =
      made(publisher->create_datawriter(topic, qos_of(options)), "writer of " + options.topic);
  impl_.reset(new Impl{.publisher = publisher,
                       .writer = writer,
                       .key_of = options.keyed ? key_of_type(options.type) : KeyOf{},
                       .own_key = {},
                       .keyed = options.keyed});
  const dds::InstanceHandle_t handle = writer->get_instance_handle();
  for (std::size_t n = 0; n < impl_->own_key.size(); ++n) impl_->own_key[n] = handle.value[n];
}

RawWriter::~RawWriter() = default;
RawWriter::RawWriter(RawWriter&&) noexcept = default;

int RawWriter::matched() const {
  dds::PublicationMatchedStatus status;
  impl_->writer->get_publication_matched_status(status);
  return status.current_count;
}

bool RawWriter::knows_key() const { return !impl_->keyed || impl_->key_of; }

bool RawWriter::write(std::span<const std::byte> payload) {
  Sample sample{.bytes = payload, .key = impl_->own_key};
  if (impl_->key_of)
    if (const auto key = impl_->key_of(payload)) sample.key = *key;
  return impl_->writer->write(&sample);
}

bool RawWriter::wait_until_taken(std::chrono::milliseconds patience) {
  const Duration_t span(static_cast<std::int32_t>(patience.count() / 1000),
                        static_cast<std::uint32_t>(patience.count() % 1000 * 1'000'000));
  return impl_->writer->wait_for_acknowledgments(span) == ReturnCode_t::RETCODE_OK;
}

}  // namespace weakgrid
