// Every field of a message by its name in weakgrid.idl and in that order: for tables, comparisons and
// reports.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "services/runtime/messages.hpp"

namespace weakgrid {

struct WireField {
  /// Whole numbers of either sign, doubles, and texts; an enumerator is the text of its name, a sequence one
  /// text with ; between elements, : within and / within that, a field of a nested struct is named outer.inner.
  using Value = std::variant<bool, std::uint64_t, std::int64_t, double, std::string>;
  const char* name;
  Value value;
};
using WireFields = std::vector<WireField>;

/// As from_payload: for every message that travels.
template <class Message>
WireFields fields_of(std::uint32_t unit, const Message& message);

/// Nothing if the type ("weakgrid::wire::Measurement") is none of ours or the bytes are not of that type.
std::optional<WireFields> fields_of_payload(std::string_view type, std::span<const std::byte> payload);

/// Their names, whatever the message holds; none if the type is none of ours.
std::vector<std::string> field_names(std::string_view type);

/// In decimal; a double with as many digits as tell it from every other.
std::string to_text(const WireField::Value& value);
/// The bits in hexadecimal; of a text its bytes.
std::string to_hex(const WireField::Value& value);
/// Same bits: unlike ==, a NaN is itself and 0 is not -0.
bool is_same(const WireField::Value& a, const WireField::Value& b);

}  // namespace weakgrid
