// How every participant of Weakgrid reaches the others: the one place that sets transport and discovery.
#pragma once

#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <cstdint>
#include <fastdds/dds/domain/qos/DomainParticipantQos.hpp>
#include <fastdds/dds/log/Log.hpp>
#include <memory>
#include <string>
#include <vector>

namespace weakgrid {

/// UDPv4 alone, on the interfaces given. receive_buffer_bytes: 0 = the system's default; the system may grant
/// less.
inline eprosima::fastdds::dds::DomainParticipantQos participant_qos(
    const std::string& name, const std::vector<std::string>& interfaces,
    std::uint32_t receive_buffer_bytes = 0) {
  using eprosima::fastrtps::Duration_t;
  // Fast DDS prints to stdout by default; a refused socket buffer size is all it would have to say.
  eprosima::fastdds::dds::Log::SetVerbosity(eprosima::fastdds::dds::Log::Kind::Error);
  eprosima::fastdds::dds::DomainParticipantQos qos;
  qos.name(name);
  auto transport = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
  transport->interfaceWhiteList = interfaces;
  transport->receiveBufferSize = receive_buffer_bytes;
  qos.transport().use_builtin_transports = false;
  qos.transport().user_transports.push_back(transport);
  // Long: where only one of two has taken the other for lost (one of them was held up for about so long),
  // Fast DDS 2.9 does not always make them meet again. Who is silent gives way much sooner: OneWriter.
  qos.wire_protocol().builtin.discovery_config.leaseDuration = Duration_t(20, 0);
  qos.wire_protocol().builtin.discovery_config.leaseDuration_announcementperiod = Duration_t(1, 0);
  return qos;
}

}  // namespace weakgrid
