// Serialized payload ↔ generated type, without any bus. For the runtime's own sources, and tests.
#pragma once

#include <cstddef>
#include <exception>
#include <span>
#include <vector>

#include "services/runtime/fastdds_version.hpp"

namespace weakgrid {

/// By the generated type support, XPubSubType for X. False: the bytes are not of that type.
template <class Type>
[[nodiscard]] bool deserialize(std::span<const std::byte> payload, typename Type::type& wire) {
  // What no writer of that type sends: Fast CDR would make room for as many elements as there are bytes.
  constexpr std::size_t encapsulation_bytes = 4, padding_bytes_max = 3;
  static const std::size_t bytes_max = encapsulation_bytes + cdr_bytes_max<Type>() + padding_bytes_max;
  if (payload.size() > bytes_max) return false;
  // Fast CDR takes what it only reads as changeable.
  auto* bytes = const_cast<char*>(reinterpret_cast<const char*>(payload.data()));
  try {
    read_cdr<Type>({bytes, payload.size()}, wire);
  } catch (const std::exception&) {  // Fast CDR's, and no memory for an absurd length
    return false;
  }
  return true;
}

/// As a writer sends it; empty: not possible.
template <class Type>
std::vector<std::byte> serialize(typename Type::type& wire) {
  return write_cdr<Type>(wire);
}

}  // namespace weakgrid
