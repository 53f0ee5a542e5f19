// SHA-256 of what is added piece by piece.
#pragma once

#include <array>
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
  // Small pieces are gathered: a call of OpenSSL's costs more than the hash of 44 bytes.
  std::array<std::byte, 1024> gathered_;
  std::size_t size_ = 0;
};

}  // namespace weakgrid
