// Payload: see the header.
#include "services/runtime/payload.hpp"

#include <fastcdr/Cdr.h>
#include <fastcdr/FastBuffer.h>

#include <exception>
#include <memory>

#include "services/runtime/wire.hpp"

namespace weakgrid {

namespace {

template <class Wire>
bool read(std::span<const std::byte> payload, Wire& wire) {
  using eprosima::fastcdr::Cdr;
  // Fast CDR takes what it only reads as changeable.
  auto* bytes = const_cast<char*>(reinterpret_cast<const char*>(payload.data()));
  eprosima::fastcdr::FastBuffer buffer(bytes, payload.size());
  Cdr cdr(buffer, Cdr::DEFAULT_ENDIAN, Cdr::DDS_CDR);
  try {
    cdr.read_encapsulation();
    wire.deserialize(cdr);
  } catch (const std::exception&) {  // Fast CDR's, and no memory for an absurd length
    return false;
  }
  return true;
}

template <class Message>
KeyOf key_of() {
  // The generated type keeps a buffer for the key between calls.
  return [type = std::make_shared<typename Topic<Message>::Type>(),
          wire = std::make_shared<typename Topic<Message>::Wire>()](
             std::span<const std::byte> payload) -> std::optional<KeyHash> {
    eprosima::fastrtps::rtps::InstanceHandle_t handle;
    if (!read(payload, *wire) || !type->getKey(wire.get(), &handle, false)) return std::nullopt;
    KeyHash key;
    for (std::size_t n = 0; n < key.size(); ++n) key[n] = handle.value[n];
    return key;
  };
}

}  // namespace

template <class Message>
std::optional<OfUnit<Message>> from_payload(std::span<const std::byte> payload) {
  typename Topic<Message>::Wire wire;
  if (!read(payload, wire)) return std::nullopt;
  OfUnit<Message> out;
  out.unit = wire.unit();
  if (!decode(wire, out.message)) return std::nullopt;
  return out;
}

KeyOf key_of_type(const std::string& type) {
#define WEAKGRID_KEY(Message) \
  if (type == typename Topic<Message>::Type().getName()) return key_of<Message>();
  WEAKGRID_KEY(Measurement)
  WEAKGRID_KEY(Modulation)
  WEAKGRID_KEY(Request)
  WEAKGRID_KEY(DecisionMessage)
  WEAKGRID_KEY(Reference)
  WEAKGRID_KEY(Operation)
  WEAKGRID_KEY(Health)
  WEAKGRID_KEY(Manifest)
#undef WEAKGRID_KEY
  return {};
}

#define WEAKGRID_INSTANTIATE(Message) \
  template std::optional<OfUnit<Message>> from_payload<Message>(std::span<const std::byte>);
WEAKGRID_INSTANTIATE(Measurement)
WEAKGRID_INSTANTIATE(Modulation)
WEAKGRID_INSTANTIATE(Request)
WEAKGRID_INSTANTIATE(DecisionMessage)
WEAKGRID_INSTANTIATE(Reference)
WEAKGRID_INSTANTIATE(Operation)
WEAKGRID_INSTANTIATE(Health)
WEAKGRID_INSTANTIATE(Manifest)
#undef WEAKGRID_INSTANTIATE

}  // namespace weakgrid
