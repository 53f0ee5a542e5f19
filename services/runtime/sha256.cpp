// Sha256 over OpenSSL.
#include "services/runtime/sha256.hpp"

#include <openssl/evp.h>

#include <array>
#include <cstring>
#include <new>

namespace weakgrid {

Sha256::Sha256() : context_(EVP_MD_CTX_new()) {
  if (context_ == nullptr || EVP_DigestInit_ex(context_, EVP_sha256(), nullptr) != 1) throw std::bad_alloc();
}

Sha256::~Sha256() { EVP_MD_CTX_free(context_); }

void Sha256::add(std::span<const std::byte> bytes) noexcept {
  if (bytes.size() > gathered_.size() - size_) {
    EVP_DigestUpdate(context_, gathered_.data(), size_);
    size_ = 0;
  }
  if (bytes.size() > gathered_.size()) {
    EVP_DigestUpdate(context_, bytes.data(), bytes.size());
    return;
  }
  if (bytes.empty()) return;
  std::memcpy(gathered_.data() + size_, bytes.data(), bytes.size());
  size_ += bytes.size();
}

std::string Sha256::hex() const {
  EVP_MD_CTX* copy = EVP_MD_CTX_new();
  std::array<unsigned char, 32> digest{};
  const bool done = copy != nullptr && EVP_MD_CTX_copy_ex(copy, context_) == 1 &&
                    EVP_DigestUpdate(copy, gathered_.data(), size_) == 1 &&
                    EVP_DigestFinal_ex(copy, digest.data(), nullptr) == 1;
  EVP_MD_CTX_free(copy);
  if (!done) throw std::bad_alloc();
  std::string text;
  for (const unsigned char byte : digest) {
    constexpr char digits[] = "0123456789abcdef";
    text += {digits[byte >> 4], digits[byte & 15]};
  }
  return text;
}

}  // namespace weakgrid
