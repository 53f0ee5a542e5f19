// RawWriter over Fast DDS 2.9. Newer majors differ here, in bus.cpp and in tap.cpp.
#include "services/runtime/raw_writer.hpp"

#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>

#include <cstring>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>

#include "services/runtime/bus.hpp"

namespace weakgrid {

namespace dds = eprosima::fastdds::dds;
namespace rtps = eprosima::fastrtps::rtps;

namespace {

using View = std::span<const std::byte>;

class RawType : public dds::TopicDataType {
 public:
  explicit RawType(const std::string& name) {
    setName(name.c_str());
    m_typeSize = 256;  // first guess; the pool grows with what is written
    m_isGetKeyDefined = false;
  }
  bool serialize(void* data, rtps::SerializedPayload_t* payload) override {
    const View& bytes = *static_cast<const View*>(data);
    if (bytes.size() > payload->max_size) return false;
    std::memcpy(payload->data, bytes.data(), bytes.size());
    payload->length = static_cast<std::uint32_t>(bytes.size());
    // The second byte of the header tells the byte order.
    payload->encapsulation = bytes.size() > 1 && (bytes[1] & std::byte{1}) == std::byte{0} ? CDR_BE : CDR_LE;
    return true;
  }
  bool deserialize(rtps::SerializedPayload_t*, void*) override { return false; }
  std::function<std::uint32_t()> getSerializedSizeProvider(void* data) override {
    const auto size = static_cast<std::uint32_t>(static_cast<const View*>(data)->size());
    return [size] { return size; };
  }
  void* createData() override { return new View; }
  void deleteData(void* data) override { delete static_cast<View*>(data); }
  bool getKey(void*, rtps::InstanceHandle_t*, bool) override { return false; }
};

template <class Pointer>
Pointer* made(Pointer* entity, const char* what) {
  if (entity == nullptr) throw BusError(std::string("DDS: ") + what + " cannot be made");
  return entity;
}

}  // namespace

struct RawWriter::Impl {
  dds::DomainParticipant* participant = nullptr;
  dds::DataWriter* writer = nullptr;

  ~Impl() {
    if (participant == nullptr) return;
    participant->delete_contained_entities();
    dds::DomainParticipantFactory::get_instance()->delete_participant(participant);
  }
};

RawWriter::RawWriter(const Options& options) : impl_(std::make_unique<Impl>()) {
  dds::DomainParticipantQos qos;
  auto transport = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
  transport->interfaceWhiteList = options.interfaces;
  qos.transport().use_builtin_transports = false;
  qos.transport().user_transports.push_back(transport);
  auto* factory = dds::DomainParticipantFactory::get_instance();
  impl_->participant = made(factory->create_participant(options.domain, qos), "participant");
  dds::TypeSupport type(new RawType(options.type));
  type.register_type(impl_->participant);
  auto* topic =
      made(impl_->participant->create_topic(options.topic, options.type, dds::TOPIC_QOS_DEFAULT), "topic");
  dds::PublisherQos publisher_qos;
  if (!options.partition.empty()) publisher_qos.partition().push_back(options.partition.c_str());
  auto* publisher = made(impl_->participant->create_publisher(publisher_qos), "publisher");
  dds::DataWriterQos writer_qos;
  writer_qos.data_sharing().off();
  writer_qos.reliability().kind =
      options.reliable ? dds::RELIABLE_RELIABILITY_QOS : dds::BEST_EFFORT_RELIABILITY_QOS;
  writer_qos.durability().kind = dds::VOLATILE_DURABILITY_QOS;
  writer_qos.history().kind = dds::KEEP_LAST_HISTORY_QOS;
  writer_qos.history().depth = options.depth;
  writer_qos.endpoint().history_memory_policy = rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
  impl_->writer = made(publisher->create_datawriter(topic, writer_qos), "writer");
}

RawWriter::~RawWriter() = default;

int RawWriter::matched() const {
  dds::PublicationMatchedStatus status;
  impl_->writer->get_publication_matched_status(status);
  return status.current_count;
}

bool RawWriter::write(std::span<const std::byte> payload) {
  View view = payload;
  return impl_->writer->write(&view);
}

}  // namespace weakgrid
