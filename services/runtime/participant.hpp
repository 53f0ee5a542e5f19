// How every participant of Weakgrid reaches the others: the one place that sets transport and discovery.
#pragma once

#include <cstdint>
#include <fastdds/dds/domain/qos/DomainParticipantQos.hpp>
#include <fastdds/dds/log/Log.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
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
  // Long enough that a stuttering machine loses nobody; a killed peer is gone after it.
  qos.wire_protocol().builtin.discovery_config.leaseDuration = Duration_t(5, 0);
  qos.wire_protocol().builtin.discovery_config.leaseDuration_announcementperiod = Duration_t(1, 0);
  return qos;
}

}  // namespace weakgrid
