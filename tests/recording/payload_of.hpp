// A message as the bytes that a writer would send and a recorder record.
#pragma once

#include "services/recording/mcap_format.hpp"
#include "services/runtime/payload_cdr.hpp"
#include "services/runtime/wire.hpp"

namespace weakgrid {

template <class Message>
mcap::Bytes payload_of(std::uint32_t unit, const Message& message) {
  typename Topic<Message>::Wire wire;
  wire.unit(unit);
  encode(message, wire);
  return serialize<typename Topic<Message>::Type>(wire);
}

}  // namespace weakgrid
