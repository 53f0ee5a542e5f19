// DDS Security: see the header.
#include "services/runtime/security.hpp"

#include <fmt/format.h>
#include <openssl/pem.h>
#include <openssl/pkcs7.h>
#include <openssl/x509.h>

#include <cerrno>
#include <cstring>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <memory>
#include <sstream>

#include "services/runtime/settings.hpp"

namespace weakgrid {

namespace {

constexpr const char* make_anew = "; make it anew: deploy/security/make FOLDER --renew";

struct Free {
  void operator()(BIO* it) const { BIO_free_all(it); }
  void operator()(X509* it) const { X509_free(it); }
  void operator()(EVP_PKEY* it) const { EVP_PKEY_free(it); }
  void operator()(PKCS7* it) const { PKCS7_free(it); }
  void operator()(STACK_OF(X509) * it) const { sk_X509_free(it); }  // not what is in it
};
template <class Object>
using Owned = std::unique_ptr<Object, Free>;

[[noreturn]] void fail(const std::string& path, const std::string& what) {
  throw SettingsError(fmt::format("dds.security: {}: {}", path, what));
}

// The content in memory, to be read as OpenSSL likes.
Owned<BIO> open(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::ostringstream text;
  if (!file.is_open())
    fail(path, std::strerror(errno) +
                   std::string("; deploy/security/make FOLDER --role ROLE makes what a role needs"));
  text << file.rdbuf();
  if (!file || text.str().empty()) fail(path, "empty, or cannot be read");
  Owned<BIO> memory(BIO_new(BIO_s_mem()));
  BIO_write(memory.get(), text.str().data(), static_cast<int>(text.str().size()));
  return memory;
}

std::string text_of(BIO* memory) {
  char* data = nullptr;
  const long size = BIO_get_mem_data(memory, &data);
  return {data, static_cast<std::size_t>(size)};
}

std::string text_of(const ASN1_TIME* time) {
  const Owned<BIO> out(BIO_new(BIO_s_mem()));
  ASN1_TIME_print(out.get(), time);
  return text_of(out.get());
}

// In force now.
Owned<X509> certificate(const std::string& path) {
  Owned<X509> it(PEM_read_bio_X509(open(path).get(), nullptr, nullptr, nullptr));
  if (!it) fail(path, "is no certificate in PEM");
  if (X509_cmp_current_time(X509_get0_notAfter(it.get())) < 0)
    fail(path, "expired on " + text_of(X509_get0_notAfter(it.get())) + make_anew);
  if (X509_cmp_current_time(X509_get0_notBefore(it.get())) > 0)
    fail(path, "is valid only from " + text_of(X509_get0_notBefore(it.get())));
  return it;
}

// What the certificate's owner, and nobody else, has signed.
std::string signed_text(const std::string& path, X509* signer, const std::string& signer_path) {
  BIO* detached = nullptr;
  const Owned<PKCS7> document(SMIME_read_PKCS7(open(path).get(), &detached));
  const Owned<BIO> content(detached);
  if (!document) fail(path, "is no document signed with S/MIME");
  const Owned<STACK_OF(X509)> signers(sk_X509_new_null());
  sk_X509_push(signers.get(), signer);
  const Owned<BIO> out(BIO_new(BIO_s_mem()));
  if (PKCS7_verify(document.get(), signers.get(), nullptr, content.get(), out.get(),
                   PKCS7_NOVERIFY | PKCS7_NOINTERN | PKCS7_TEXT) != 1)
    fail(path, "was changed, or is not signed by " + signer_path);
  return text_of(out.get());
}

// As Fast DDS 2.9 reads it: a local time.
std::time_t time_in(const std::string& text, const std::string& element, const std::string& path) {
  const std::size_t at = text.find("<" + element + ">");
  std::tm time{};
  if (at == std::string::npos ||
      strptime(text.c_str() + at + element.size() + 2, "%Y-%m-%dT%H:%M:%S", &time) == nullptr)
    fail(path, "has no date in <" + element + ">");
  time.tm_isdst = -1;
  return std::mktime(&time);
}

// Some rule of it is for this domain: <id>, or <min> and <max>.
bool is_for(const std::string& text, std::uint32_t domain) {
  const auto number_after = [&](const std::string& element,
                                std::size_t from) -> std::pair<std::size_t, unsigned long> {
    const std::size_t at = text.find("<" + element + ">", from);
    if (at == std::string::npos) return {at, 0};
    return {at + 1, std::strtoul(text.c_str() + at + element.size() + 2, nullptr, 10)};
  };
  for (auto id = number_after("id", 0); id.first != std::string::npos; id = number_after("id", id.first))
    if (id.second == domain) return true;
  for (auto min = number_after("min", 0); min.first != std::string::npos;
       min = number_after("min", min.first)) {
    const auto max = number_after("max", min.first);
    if (min.second <= domain && (max.first == std::string::npos || domain <= max.second)) return true;
  }
  return false;
}

}  // namespace

void secure(const std::string& folder, Role role, std::uint32_t domain,
            eprosima::fastdds::dds::DomainParticipantQos& qos) {
  if (!std::filesystem::is_directory(folder))
    fail(folder, "is no folder; allowed: one made by deploy/security/make");
  const std::string base = std::filesystem::absolute(folder).string() + "/", own = base + name(role);
  const std::string identity_ca = base + "identity_ca.pem", permissions_ca = base + "permissions_ca.pem",
                    governance = base + "governance.p7s", identity = own + ".pem", key = own + ".key",
                    permissions = own + ".p7s";

  const Owned<X509> issuer = certificate(identity_ca), signer = certificate(permissions_ca),
                    mine = certificate(identity);
  if (X509_verify(mine.get(), X509_get0_pubkey(issuer.get())) != 1)
    fail(identity, "was not issued by " + identity_ca);
  const Owned<EVP_PKEY> secret(PEM_read_bio_PrivateKey(open(key).get(), nullptr, nullptr, nullptr));
  if (!secret) fail(key, "is no private key in PEM without a password");
  if (X509_check_private_key(mine.get(), secret.get()) != 1) fail(key, "is not the key of " + identity);
  const std::string rules = signed_text(governance, signer.get(), permissions_ca);
  const std::string grants = signed_text(permissions, signer.get(), permissions_ca);
  const std::time_t now = std::time(nullptr);
  if (time_in(grants, "not_after", permissions) < now)
    fail(permissions, std::string("has expired") + make_anew);
  if (time_in(grants, "not_before", permissions) > now) fail(permissions, "is not valid yet");

  for (const auto& [path, text] : {std::pair{governance, rules}, std::pair{permissions, grants}})
    if (!is_for(text, domain))
      fail(path,
           fmt::format("is not for domain {}; --domain of deploy/security/make says for which", domain));

  const auto set = [&qos](const std::string& property, const std::string& value) {
    qos.properties().properties().emplace_back("dds.sec." + property, value);
  };
  set("auth.plugin", "builtin.PKI-DH");
  set("auth.builtin.PKI-DH.identity_ca", "file://" + identity_ca);
  set("auth.builtin.PKI-DH.identity_certificate", "file://" + identity);
  set("auth.builtin.PKI-DH.private_key", "file://" + key);
  set("access.plugin", "builtin.Access-Permissions");
  set("access.builtin.Access-Permissions.permissions_ca", "file://" + permissions_ca);
  set("access.builtin.Access-Permissions.governance", "file://" + governance);
  set("access.builtin.Access-Permissions.permissions", "file://" + permissions);
  set("crypto.plugin", "builtin.AES-GCM-GMAC");
}

}  // namespace weakgrid
