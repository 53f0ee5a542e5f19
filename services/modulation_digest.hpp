// SHA-256 over the modulations that drove a unit: two runs with the same digest took the same path.
#pragma once

#include <string>

#include "plant/model.hpp"
#include "services/runtime/sha256.hpp"

namespace weakgrid {

class ModulationDigest {
 public:
  /// The fields in the order of the IDL, little-endian, but newest_reference_id: when an order arrived is no
  /// part of what was done. Does not allocate.
  void add(std::uint32_t unit, const Modulation& modulation) noexcept;
  /// Of all that was added so far, hexadecimal.
  std::string hex() const { return sum_.hex(); }

 private:
  Sha256 sum_;
};

}  // namespace weakgrid
