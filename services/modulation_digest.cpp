// ModulationDigest: see the header.
#include "services/modulation_digest.hpp"

#include <array>
#include <bit>
#include <cstring>

namespace weakgrid {

namespace {

template <class Value>
std::byte* put(std::byte* at, Value value) {
  static_assert(std::endian::native == std::endian::little, "bytes are taken as they lie");
  std::memcpy(at, &value, sizeof value);
  return at + sizeof value;
}

}  // namespace

void ModulationDigest::add(std::uint32_t unit, const Modulation& m) noexcept {
  std::array<std::byte, 44> bytes;
  std::byte* at = put(bytes.data(), unit);
  at = put(at, m.period_ns);
  at = put(at, m.reference_id);
  at = put(at, m.status);
  at = put(at, m.measurement_fingerprint);
  at = put(at, m.step);
  at = put(at, m.mu.re);
  put(at, m.mu.im);
  sum_.add(bytes);
}

}  // namespace weakgrid
