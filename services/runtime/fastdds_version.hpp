// The one place that knows which Fast DDS this is: 2.9 (Debian 12) or 3.1 (Debian 13). Where they differ,
// both are known here under one name; all else says what the two have in common. On the wire they are the
// same.
#pragma once

#if __has_include(<fastrtps/config.h>)
#include <fastcdr/Cdr.h>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastdds/rtps/writer/WriterDiscoveryInfo.h>
#include <fastrtps/utils/IPLocator.h>
#include <fastrtps/xmlparser/XMLProfileManager.h>
#define WEAKGRID_FASTDDS_2
#else
#include <fastdds/LibrarySettings.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.hpp>
#include <fastdds/rtps/writer/WriterDiscoveryStatus.hpp>
#include <fastdds/utils/IPLocator.hpp>
#endif

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/domain/DomainParticipantListener.hpp>
#include <fastdds/dds/publisher/qos/DataWriterQos.hpp>
#include <fastdds/dds/subscriber/qos/DataReaderQos.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <functional>
#include <span>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace weakgrid {

namespace dds = eprosima::fastdds::dds;

/// A writer of another participant, as discovery tells of it.
struct FoundWriter {
  std::string topic, type;
  bool keyed = false;
  dds::ReliabilityQosPolicy reliability;
  dds::DurabilityQosPolicy durability;
  dds::OwnershipQosPolicy ownership;
  dds::OwnershipStrengthQosPolicy ownership_strength;
  dds::LivelinessQosPolicy liveliness;
  dds::DeadlineQosPolicy deadline;
  dds::LifespanQosPolicy lifespan;
  dds::DataRepresentationQosPolicy representation;
  std::vector<std::string> partitions;
};

#ifdef WEAKGRID_FASTDDS_2

namespace rtps = eprosima::fastrtps::rtps;
using eprosima::fastrtps::c_TimeInfinite;
using eprosima::fastrtps::Duration_t;
using eprosima::fastrtps::types::ReturnCode_t;

inline bool is_ok(const ReturnCode_t& code) { return code == ReturnCode_t::RETCODE_OK; }
/// What DataWriter::write() answers.
inline bool is_ok(bool written) { return written; }

inline std::string name_of(const dds::TopicDataType& type) { return type.getName(); }
inline bool is_keyed(const dds::TopicDataType& type) { return type.m_isGetKeyDefined; }
inline bool compute_key(dds::TopicDataType& type, void* data, rtps::InstanceHandle_t& key) {
  return type.getKey(data, &key, false);
}

/// Bytes that the longest value of a generated type takes, without header.
template <class Type>
std::size_t cdr_bytes_max() {
  return Type::type::getMaxCdrSerializedSize();
}
/// From the header on; throws what Fast CDR throws, and std::bad_alloc.
template <class Type>
void read_cdr(std::span<char> payload, typename Type::type& data) {
  using eprosima::fastcdr::Cdr;
  eprosima::fastcdr::FastBuffer buffer(payload.data(), payload.size());
  Cdr cdr(buffer, Cdr::DEFAULT_ENDIAN, Cdr::DDS_CDR);
  cdr.read_encapsulation();
  data.deserialize(cdr);
}
/// As it goes over the wire, from the header on; empty: not possible.
template <class Type>
std::vector<std::byte> write_cdr(typename Type::type& data) {
  Type type;
  rtps::SerializedPayload_t payload(type.getSerializedSizeProvider(&data)());
  if (!type.serialize(&data, &payload)) return {};
  const auto* begin = reinterpret_cast<const std::byte*>(payload.data);
  return {begin, begin + payload.length};
}

inline void set_heartbeat_period(dds::DataWriterQos& qos, const Duration_t& period) {
  qos.reliable_writer_qos().times.heartbeatPeriod = period;
}

inline void accept_representations(dds::DataReaderQos& qos,
                                   std::vector<dds::DataRepresentationId_t> representations) {
  qos.type_consistency().representation.m_value = std::move(representations);
}

inline void use_discovery_server(const rtps::Locator_t& at, rtps::BuiltinAttributes& builtin) {
  rtps::RemoteServerAttributes server;
  server.ReadguidPrefix("44.53.00.5f.45.50.52.4f.53.49.4d.41");  // of `fastdds discovery -i 0`
  server.metatrafficUnicastLocatorList.push_back(at);
  builtin.discovery_config.m_DiscoveryServers.push_back(server);
}

inline void deliver_user_data_alone_within_process() {
  eprosima::fastrtps::LibrarySettingsAttributes settings;
  settings.intraprocess_delivery = eprosima::fastrtps::INTRAPROCESS_USER_DATA_ONLY;
  eprosima::fastrtps::xmlparser::XMLProfileManager::library_settings(settings);
}

#else

namespace rtps = eprosima::fastdds::rtps;
using dds::c_TimeInfinite;
using dds::Duration_t;
using dds::ReturnCode_t;

inline bool is_ok(ReturnCode_t code) { return code == dds::RETCODE_OK; }
bool is_ok(bool) = delete;  // would be taken for a number, true for an error

inline const std::string& name_of(const dds::TopicDataType& type) { return type.get_name(); }
inline bool is_keyed(const dds::TopicDataType& type) { return type.is_compute_key_provided; }
inline bool compute_key(dds::TopicDataType& type, void* data, rtps::InstanceHandle_t& key) {
  return type.compute_key(data, key, false);
}

// The generated types' own functions are in a source file; the type hands on to them.
template <class Type>
std::size_t cdr_bytes_max() {
  return Type().max_serialized_type_size - rtps::SerializedPayload_t::representation_header_size;
}
template <class Type>
void read_cdr(std::span<char> payload, typename Type::type& data) {
  static Type type;  // has no state that this touches
  rtps::SerializedPayload_t borrowed;
  borrowed.data = reinterpret_cast<rtps::octet*>(payload.data());
  borrowed.length = borrowed.max_size = static_cast<std::uint32_t>(payload.size());
  struct GiveBack {
    rtps::SerializedPayload_t& payload;
    ~GiveBack() { payload.data = nullptr; }
  } const give_back{borrowed};
  if (!type.deserialize(borrowed, &data)) throw std::runtime_error("not of the type " + type.get_name());
}
template <class Type>
std::vector<std::byte> write_cdr(typename Type::type& data) {
  Type type;
  rtps::SerializedPayload_t payload(type.calculate_serialized_size(&data, dds::XCDR_DATA_REPRESENTATION));
  if (!type.serialize(&data, payload, dds::XCDR_DATA_REPRESENTATION)) return {};
  const auto* begin = reinterpret_cast<const std::byte*>(payload.data);
  return {begin, begin + payload.length};
}

inline void set_heartbeat_period(dds::DataWriterQos& qos, const Duration_t& period) {
  qos.reliable_writer_qos().times.heartbeat_period = period;
}

inline void accept_representations(dds::DataReaderQos& qos,
                                   std::vector<dds::DataRepresentationId_t> representations) {
  qos.representation().m_value = std::move(representations);
}

inline void use_discovery_server(const rtps::Locator_t& at, rtps::BuiltinAttributes& builtin) {
  builtin.discovery_config.m_DiscoveryServers.push_back(at);
}

inline void deliver_user_data_alone_within_process() {
  eprosima::fastdds::LibrarySettings settings;
  settings.intraprocess_delivery = eprosima::fastdds::INTRAPROCESS_USER_DATA_ONLY;
  dds::DomainParticipantFactory::get_instance()->set_library_settings(settings);
}

#endif

/// Hears of the writers of other participants, on a thread of the bus.
class WriterListener : public dds::DomainParticipantListener {
 public:
  virtual void on_writer(const rtps::GUID_t& guid, const FoundWriter& writer) = 0;
  virtual void on_writer_gone(const rtps::GUID_t& guid) = 0;

 private:
#ifdef WEAKGRID_FASTDDS_2
  void on_publisher_discovery(dds::DomainParticipant*, rtps::WriterDiscoveryInfo&& found) final {
    const rtps::WriterProxyData& writer = found.info;
    if (found.status == rtps::WriterDiscoveryInfo::REMOVED_WRITER) return on_writer_gone(writer.guid());
    const dds::WriterQos& qos = writer.m_qos;
    on_writer(writer.guid(), {.topic = writer.topicName().to_string(),
                              .type = writer.typeName().to_string(),
                              .keyed = writer.topicKind() == rtps::WITH_KEY,
                              .reliability = qos.m_reliability,
                              .durability = qos.m_durability,
                              .ownership = qos.m_ownership,
                              .ownership_strength = qos.m_ownershipStrength,
                              .liveliness = qos.m_liveliness,
                              .deadline = qos.m_deadline,
                              .lifespan = qos.m_lifespan,
                              .representation = qos.representation,
                              .partitions = qos.m_partition.names()});
  }
#else
  void on_data_writer_discovery(dds::DomainParticipant*, rtps::WriterDiscoveryStatus status,
                                const dds::PublicationBuiltinTopicData& writer, bool&) final {
    if (status == rtps::WriterDiscoveryStatus::REMOVED_WRITER) return on_writer_gone(writer.guid);
    on_writer(writer.guid, {.topic = writer.topic_name.to_string(),
                            .type = writer.type_name.to_string(),
                            .keyed = writer.topic_kind == rtps::WITH_KEY,
                            .reliability = writer.reliability,
                            .durability = writer.durability,
                            .ownership = writer.ownership,
                            .ownership_strength = writer.ownership_strength,
                            .liveliness = writer.liveliness,
                            .deadline = writer.deadline,
                            .lifespan = writer.lifespan,
                            .representation = writer.representation,
                            .partitions = writer.partition.names()});
  }
#endif
};

/// A type of which nobody here knows more than the bytes, header included. Who only reads overrides take(),
/// who only writes bytes_of().
class OpaqueType : public dds::TopicDataType {
 public:
  OpaqueType(const std::string& name, bool keyed) {
    constexpr std::uint32_t first_guess = 256;  // the pools grow with what comes and goes
#ifdef WEAKGRID_FASTDDS_2
    setName(name.c_str());
    m_typeSize = first_guess;
    m_isGetKeyDefined = keyed;
#else
    set_name(name);
    max_serialized_type_size = first_guess;
    is_compute_key_provided = keyed;
#endif
  }

 protected:
  virtual bool take(std::span<const std::byte>, void*) { return false; }
  virtual std::span<const std::byte> bytes_of(const void*) { return {}; }
  /// False, or a nil key, of what comes would abort the process: Debian builds with asserts. Null where only
  /// the bytes are known.
  virtual bool key_of(const void* sample, rtps::InstanceHandle_t& key) = 0;
  virtual void* make() = 0;
  virtual void destroy(void* sample) = 0;

 private:
  bool put(const void* sample, rtps::SerializedPayload_t& payload) {
    const std::span bytes = bytes_of(sample);
    if (bytes.size() > payload.max_size) return false;
    std::memcpy(payload.data, bytes.data(), bytes.size());
    payload.length = static_cast<std::uint32_t>(bytes.size());
    // The second byte of the header tells the byte order.
    payload.encapsulation = bytes.size() > 1 && (bytes[1] & std::byte{1}) == std::byte{0} ? CDR_BE : CDR_LE;
    return true;
  }
  bool get(const rtps::SerializedPayload_t& payload, void* sample) {
    return take({reinterpret_cast<const std::byte*>(payload.data), payload.length}, sample);
  }

#ifdef WEAKGRID_FASTDDS_2
  bool serialize(void* data, rtps::SerializedPayload_t* payload) final { return put(data, *payload); }
  bool deserialize(rtps::SerializedPayload_t* payload, void* data) final { return get(*payload, data); }
  std::function<std::uint32_t()> getSerializedSizeProvider(void* data) final {
    return [size = static_cast<std::uint32_t>(bytes_of(data).size())] { return size; };
  }
  void* createData() final { return make(); }
  void deleteData(void* data) final { destroy(data); }
  bool getKey(void* data, rtps::InstanceHandle_t* key, bool) final { return key_of(data, *key); }
#else
  bool serialize(const void* data, rtps::SerializedPayload_t& payload, dds::DataRepresentationId_t) final {
    return put(data, payload);
  }
  bool deserialize(rtps::SerializedPayload_t& payload, void* data) final { return get(payload, data); }
  std::uint32_t calculate_serialized_size(const void* data, dds::DataRepresentationId_t) final {
    return static_cast<std::uint32_t>(bytes_of(data).size());
  }
  void* create_data() final { return make(); }
  void delete_data(void* data) final { destroy(data); }
  bool compute_key(const void* data, rtps::InstanceHandle_t& key, bool) final { return key_of(data, key); }
  bool compute_key(rtps::SerializedPayload_t&, rtps::InstanceHandle_t& key, bool) final {
    return key_of(nullptr, key);
  }
#endif
};

}  // namespace weakgrid
