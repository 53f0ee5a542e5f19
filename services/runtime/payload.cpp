// Payload: see the header.
#include "services/runtime/payload.hpp"

#include <fastcdr/Cdr.h>
#include <fastcdr/FastBuffer.h>
#include <fastcdr/exceptions/Exception.h>

#include "services/runtime/wire.hpp"

namespace weakgrid {

template <class Message>
std::optional<OfUnit<Message>> from_payload(std::span<const std::byte> payload) {
  using eprosima::fastcdr::Cdr;
  // Fast CDR takes what it only reads as changeable.
  auto* bytes = const_cast<char*>(reinterpret_cast<const char*>(payload.data()));
  eprosima::fastcdr::FastBuffer buffer(bytes, payload.size());
  Cdr cdr(buffer, Cdr::DEFAULT_ENDIAN, Cdr::DDS_CDR);
  typename Topic<Message>::Wire wire;
  OfUnit<Message> out;
  try {
    cdr.read_encapsulation();
    wire.deserialize(cdr);
  } catch (const eprosima::fastcdr::exception::Exception&) {
    return std::nullopt;
  }
  out.unit = wire.unit();
  if (!decode(wire, out.message)) return std::nullopt;
  return out;
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
