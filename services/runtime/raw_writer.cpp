// RawWriter over Fast DDS: see the header.
#include "services/runtime/raw_writer.hpp"

#include <algorithm>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>
#include <map>
#include <mutex>
#include <sstream>

#include "services/runtime/bus.hpp"
#include "services/runtime/participant.hpp"
#include "services/runtime/payload.hpp"

namespace weakgrid {

namespace {

// Of one writer; a payload of one more is not sent.
constexpr int instances_max = 4096;

/// What is written: the type beside it knows neither payload nor key.
struct Sample {
  std::span<const std::byte> bytes;
  KeyHash key{};
};

class RawType : public OpaqueType {
 public:
  using OpaqueType::OpaqueType;

 private:
  std::span<const std::byte> bytes_of(const void* sample) override {
    return static_cast<const Sample*>(sample)->bytes;
  }
  bool key_of(const void* sample, rtps::InstanceHandle_t& key) override {
    if (sample == nullptr || !is_keyed(*this)) return false;
    const KeyHash& its = static_cast<const Sample*>(sample)->key;
    for (std::size_t n = 0; n < its.size(); ++n) key.value[n] = its[n];
    return true;
  }
  void* make() override { return new Sample; }
  void destroy(void* sample) override { delete static_cast<Sample*>(sample); }
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
  set_heartbeat_period(qos, Duration_t(0, 10'000'000));
  return qos;
}

}  // namespace

struct RawBus::Impl : WriterListener {
  dds::DomainParticipant* participant = nullptr;
  std::map<std::vector<std::string>, dds::Publisher*> publishers;  // by partitions
  mutable std::mutex mutex;
  std::map<rtps::GUID_t, LiveWriter> others;

  void on_writer(const rtps::GUID_t& guid, const FoundWriter& writer) override {
    std::ostringstream text;
    text << guid;
    const std::lock_guard lock(mutex);
    others[guid] = {.guid = text.str(), .topic = writer.topic};
  }
  void on_writer_gone(const rtps::GUID_t& guid) override {
    const std::lock_guard lock(mutex);
    others.erase(guid);
  }

  dds::Topic* topic(const std::string& name, const std::string& type_name, bool keyed) {
    dds::TypeSupport type = participant->find_type(type_name);
    if (type.empty()) {
      type.reset(new RawType(type_name, keyed));
      if (!is_ok(type.register_type(participant)))
        throw BusError("DDS: type " + type_name + " cannot be registered");
    }
    auto* known = static_cast<dds::Topic*>(participant->lookup_topicdescription(name));
    if (is_keyed(*type) != keyed || (known != nullptr && known->get_type_name() != type_name))
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
  return is_ok(impl_->writer->write(&sample));
}

bool RawWriter::wait_until_taken(std::chrono::milliseconds patience) {
  const Duration_t span(static_cast<std::int32_t>(patience.count() / 1000),
                        static_cast<std::uint32_t>(patience.count() % 1000 * 1'000'000));
  return is_ok(impl_->writer->wait_for_acknowledgments(span));
}

}  // namespace weakgrid
