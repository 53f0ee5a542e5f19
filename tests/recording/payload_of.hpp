// A message as the bytes that a writer would send and a recorder record.
#pragma once

#include "services/recording/mcap_format.hpp"
#include "services/runtime/wire.hpp"

namespace weakgrid {

template <class Message>
mcap::Bytes payload_of(std::uint32_t unit, const Message& message) {
  typename Topic<Message>::Wire wire;
  wire.unit(unit);
  encode(message, wire);
  typename Topic<Message>::Type type;
  eprosima::fastrtps::rtps::SerializedPayload_t payload(type.getSerializedSizeProvider(&wire)());
  if (!type.serialize(&wire, &payload)) return {};
  const auto* begin = reinterpret_cast<const std::byte*>(payload.data);
  return {begin, begin + payload.length};
}

}  // namespace weakgrid
