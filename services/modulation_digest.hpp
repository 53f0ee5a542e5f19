// SHA-256 over every field of every modulation that drove a unit: two runs with the same digest took the same
// path.
#pragma once

#include <string>

#include "plant/model.hpp"

struct evp_md_ctx_st;

namespace weakgrid {

class ModulationDigest {
 public:
  ModulationDigest();
  ~ModulationDigest();
  /// The fields in the order of the IDL, little-endian. Does not allocate.
  void add(std::uint32_t unit, const Modulation& modulation) noexcept;
  /// Of all that was added so far, hexadecimal.
  std::string hex() const;

 private:
  evp_md_ctx_st* context_;
};

}  // namespace weakgrid
