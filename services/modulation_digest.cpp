// ModulationDigest over OpenSSL's SHA-256.
#include "services/modulation_digest.hpp"

#include <openssl/evp.h>

#include <array>
#include <bit>
#include <cstring>
#include <new>

namespace weakgrid {

namespace {

template <class Value>
unsigned char* put(unsigned char* at, Value value) {
  static_assert(std::endian::native == std::endian::little, "bytes are taken as they lie");
  std::memcpy(at, &value, sizeof value);
  return at + sizeof value;
}

}  // namespace

ModulationDigest::ModulationDigest() : context_(EVP_MD_CTX_new()) {
  if (context_ == nullptr || EVP_DigestInit_ex(context_, EVP_sha256(), nullptr) != 1) throw std::bad_alloc();
}

ModulationDigest::~ModulationDigest() { EVP_MD_CTX_free(context_); }

void ModulationDigest::add(std::uint32_t unit, const Modulation& m) noexcept {
  std::array<unsigned char, 40> bytes;
  unsigned char* at = put(bytes.data(), unit);
  at = put(at, m.period_ns);
  at = put(at, m.reference_id);
  at = put(at, m.status);
  at = put(at, m.step);
  at = put(at, m.mu.re);
  put(at, m.mu.im);
  EVP_DigestUpdate(context_, bytes.data(), bytes.size());
}

std::string ModulationDigest::hex() const {
  EVP_MD_CTX* copy = EVP_MD_CTX_new();
  std::array<unsigned char, 32> digest{};
  const bool done = copy != nullptr && EVP_MD_CTX_copy_ex(copy, context_) == 1 &&
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
