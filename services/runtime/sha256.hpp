// SHA-256 of what is added piece by piece.
#pragma once

#include <cstddef>
#include <span>
#include <string>

struct evp_md_ctx_st;

namespace weakgrid {

class Sha256 {
 public:
  Sha256();
  ~Sha256();
  Sha256(const Sha256&) = delete;
  Sha256& operator=(const Sha256&) = delete;
  /// Does not allocate.
  void add(std::span<const std::byte> bytes) noexcept;
  /// Of all that was added so far, hexadecimal.
  std::string hex() const;

 private:
  evp_md_ctx_st* context_;
};

}  // namespace weakgrid
