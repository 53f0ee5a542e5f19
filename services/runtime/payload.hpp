// The bytes of a recorded or replayed sample ↔ the messages of weakgrid.idl, without any bus.
#pragma once

#include <array>
#include <cstddef>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "services/runtime/messages.hpp"

namespace weakgrid {

/// A message and the unit it belongs to.
template <class Message>
struct OfUnit {
  std::uint32_t unit = 0;
  Message message;
};

/// The topic of this type is one on which the last word stands; nothing for types that are not ours.
std::optional<bool> is_state_type(std::string_view type);

/// From a serialized payload with its encapsulation header; nothing for what no correct peer sends.
/// For every message that travels: Measurement, Modulation, Request, DecisionMessage, Reference, Operation,
/// ControllerState, Health, Manifest.
template <class Message>
std::optional<OfUnit<Message>> from_payload(std::span<const std::byte> payload);

/// What DDS tells the instances of a keyed topic apart by.
using KeyHash = std::array<std::uint8_t, 16>;
/// The key of a payload of one type; nothing for one that does not decode. For one thread.
using KeyOf = std::function<std::optional<KeyHash>(std::span<const std::byte>)>;
/// Whether our type is keyed; nothing for types that are not ours.
std::optional<bool> is_keyed_type(std::string_view type);
/// For a DDS type name; empty for a type that weakgrid.idl does not have, or has without a key.
KeyOf key_of_type(const std::string& type);

}  // namespace weakgrid
