// Payload: see the header.
#include "services/runtime/payload.hpp"

#include "services/runtime/payload_cdr.hpp"
#include "services/runtime/wire.hpp"

namespace weakgrid {

template <class Message>
std::optional<OfUnit<Message>> from_payload(std::span<const std::byte> payload) {
  typename Topic<Message>::Wire wire;
  OfUnit<Message> out;
  if (!deserialize(payload, wire) || !decode(wire, out.message)) return std::nullopt;
  out.unit = wire.unit();
  return out;
}

std::optional<bool> is_state_type(std::string_view type) {
  std::optional<bool> is_state;
  const auto look_at = [&]<class Message>(const Message*) {
    static const std::string name = typename Topic<Message>::Type().getName();
    if (type == name) is_state = Topic<Message>::qos == QosClass::state;
  };
  look_at(static_cast<const Measurement*>(nullptr));
  look_at(static_cast<const Modulation*>(nullptr));
  look_at(static_cast<const Request*>(nullptr));
  look_at(static_cast<const DecisionMessage*>(nullptr));
  look_at(static_cast<const Reference*>(nullptr));
  look_at(static_cast<const Operation*>(nullptr));
  look_at(static_cast<const ControllerState*>(nullptr));
  look_at(static_cast<const Health*>(nullptr));
  look_at(static_cast<const Manifest*>(nullptr));
  return is_state;
}

#define WEAKGRID_INSTANTIATE(Message) \
  template std::optional<OfUnit<Message>> from_payload<Message>(std::span<const std::byte>);
WEAKGRID_INSTANTIATE(Measurement)
WEAKGRID_INSTANTIATE(Modulation)
WEAKGRID_INSTANTIATE(Request)
WEAKGRID_INSTANTIATE(DecisionMessage)
WEAKGRID_INSTANTIATE(Reference)
WEAKGRID_INSTANTIATE(Operation)
WEAKGRID_INSTANTIATE(ControllerState)
WEAKGRID_INSTANTIATE(Health)
WEAKGRID_INSTANTIATE(Manifest)
#undef WEAKGRID_INSTANTIATE

}  // namespace weakgrid
