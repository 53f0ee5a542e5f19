// Serialized payload → generated type, by Fast CDR alone. For the runtime's own sources.
#pragma once

#include <fastcdr/Cdr.h>
#include <fastcdr/FastBuffer.h>

#include <cstddef>
#include <exception>
#include <span>

namespace weakgrid {

/// False: the bytes are not of that type.
template <class Wire>
[[nodiscard]] bool deserialize(std::span<const std::byte> payload, Wire& wire) {
  using eprosima::fastcdr::Cdr;
  // What no writer of that type sends: Fast CDR would make room for as many elements as there are bytes.
  constexpr std::size_t encapsulation_bytes = 4, padding_bytes_max = 3;
  static const std::size_t bytes_max =
      encapsulation_bytes + Wire::getMaxCdrSerializedSize() + padding_bytes_max;
  if (payload.size() > bytes_max) return false;
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

}  // namespace weakgrid
