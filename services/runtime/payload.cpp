// Payload: see the header.
#include "services/runtime/payload.hpp"

#include <memory>

#include "services/runtime/payload_cdr.hpp"
#include "services/runtime/wire.hpp"

namespace weakgrid {

namespace {

template <class Message>
KeyOf key_of() {
  using Type = typename Topic<Message>::Type;
  if (!is_keyed(Type())) return {};
  // The generated type keeps a buffer for the key between calls.
  return [type = std::make_shared<Type>(), wire = std::make_shared<typename Topic<Message>::Wire>()](
             std::span<const std::byte> payload) -> std::optional<KeyHash> {
    rtps::InstanceHandle_t handle;
    if (!deserialize<Type>(payload, *wire) || !compute_key(*type, wire.get(), handle)) return std::nullopt;
    KeyHash key;
    for (std::size_t n = 0; n < key.size(); ++n) key[n] = handle.value[n];
    return key;
  };
}

}  // namespace

template <class Message>
std::optional<OfUnit<Message>> from_payload(std::span<const std::byte> payload) {
  typename Topic<Message>::Wire wire;
  OfUnit<Message> out;
  if (!deserialize<typename Topic<Message>::Type>(payload, wire) || !decode(wire, out.message))
    return std::nullopt;
  out.unit = wire.unit();
  return out;
}

std::optional<bool> is_state_type(std::string_view type) {
#define WEAKGRID_TRY(Message) \
  if (type == name_of(typename Topic<Message>::Type())) return Topic<Message>::qos == QosClass::state;
  WEAKGRID_MESSAGES(WEAKGRID_TRY)
#undef WEAKGRID_TRY
  return std::nullopt;
}

std::optional<bool> is_keyed_type(std::string_view type) {
#define WEAKGRID_TRY(Message) \
  if (const typename Topic<Message>::Type known; type == name_of(known)) return is_keyed(known);
  WEAKGRID_MESSAGES(WEAKGRID_TRY)
#undef WEAKGRID_TRY
  return std::nullopt;
}

KeyOf key_of_type(const std::string& type) {
#define WEAKGRID_TRY(Message) \
  if (type == name_of(typename Topic<Message>::Type())) return key_of<Message>();
  WEAKGRID_MESSAGES(WEAKGRID_TRY)
#undef WEAKGRID_TRY
  return {};
}

#define WEAKGRID_INSTANTIATE(Message) \
  template std::optional<OfUnit<Message>> from_payload<Message>(std::span<const std::byte>);
WEAKGRID_MESSAGES(WEAKGRID_INSTANTIATE)
#undef WEAKGRID_INSTANTIATE

}  // namespace weakgrid
