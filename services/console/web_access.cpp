// Access: see the header.
#include "services/console/web_access.hpp"

#include <algorithm>
#include <fstream>
#include <random>
#include <span>
#include <sstream>

#include "services/runtime/settings.hpp"
#include "services/runtime/sha256.hpp"

namespace weakgrid {

namespace {

constexpr std::size_t sessions_max = 64;
constexpr std::size_t token_min = 32, token_max = 256;

std::string digest(std::string_view secret) {
  Sha256 sum;
  sum.add(std::as_bytes(std::span{secret}));
  return sum.hex();
}

std::string random_secret() {
  std::random_device device;
  std::string secret;
  for (int n = 0; n < 32; ++n) secret += "0123456789abcdef"[device() % 16];
  return secret;
}

/// The value of our cookie in a header "a=b; c=d".
std::string_view session_of(std::string_view cookies) {
  while (!cookies.empty()) {
    const std::size_t end = std::min(cookies.find(';'), cookies.size());
    std::string_view one = cookies.substr(0, end);
    one.remove_prefix(std::min(one.find_first_not_of(' '), one.size()));
    cookies.remove_prefix(std::min(end + 1, cookies.size()));
    const std::size_t equals = one.find('=');
    if (equals != std::string_view::npos && one.substr(0, equals) == WebAccess::cookie)
      return one.substr(equals + 1);
  }
  return {};
}

}  // namespace

std::vector<std::pair<Access, std::string>> read_tokens(const std::string& file) {
  std::ifstream in(file);
  if (!in) throw SettingsError(file + ": cannot be read");
  std::vector<std::pair<Access, std::string>> tokens;
  std::string line;
  for (int number = 1; std::getline(in, line); ++number) {
    const auto refuse = [&](const std::string& what) {
      throw SettingsError(file + ":" + std::to_string(number) + ": " + what);
    };
    std::istringstream words(line.substr(0, line.find('#')));
    std::string access, token, more;
    if (!(words >> access)) continue;
    if (access != "view" && access != "set") refuse("a line begins with view or set");
    if (!(words >> token) || (words >> more)) refuse("one token is asked for behind " + access);
    if (token.size() < token_min || token.size() > token_max ||
        !std::all_of(token.begin(), token.end(), [](char c) { return c > ' ' && c < '\x7f'; }))
      refuse("a token has 32 to 256 printable characters: openssl rand -hex 32");
    tokens.emplace_back(access == "set" ? Access::set : Access::view, token);
  }
  if (tokens.empty()) throw SettingsError(file + ": no token");
  return tokens;
}

WebAccess::WebAccess(std::vector<std::pair<Access, std::string>> tokens) : everybody_(tokens.empty()) {
  for (const auto& [access, token] : tokens) tokens_.push_back({access, digest(token)});
}

Access WebAccess::of_token(std::string_view token) const {
  Access access = Access::none;
  const std::string asked = digest(token);
  for (const Known& known : tokens_)
    if (known.digest == asked) access = std::max(access, known.access);
  return access;
}

Access WebAccess::of(std::string_view authorization, std::string_view cookies) const {
  if (everybody_) return Access::set;
  constexpr std::string_view bearer = "Bearer ";
  if (authorization.starts_with(bearer)) return of_token(authorization.substr(bearer.size()));
  const std::string_view session = session_of(cookies);
  if (session.empty()) return Access::none;
  const std::string asked = digest(session);
  const auto known =
      std::find_if(sessions_.begin(), sessions_.end(), [&](const Known& k) { return k.digest == asked; });
  return known == sessions_.end() ? Access::none : known->access;
}

std::optional<std::string> WebAccess::log_in(std::string_view token) {
  const Access access = of_token(token);
  if (access == Access::none) return std::nullopt;
  std::string secret = random_secret();
  sessions_.push_back({access, digest(secret)});
  if (sessions_.size() > sessions_max) sessions_.pop_front();
  return secret;
}

void WebAccess::log_out(std::string_view cookies) {
  const std::string_view session = session_of(cookies);
  if (session.empty()) return;
  const std::string asked = digest(session);
  std::erase_if(sessions_, [&](const Known& k) { return k.digest == asked; });
}

WebNames::WebNames(const std::string& address, std::uint16_t port, bool tls, std::vector<std::string> hosts,
                   std::vector<std::string> origins)
    : origins_(std::move(origins)) {
  hosts.push_back(address.find(':') == std::string::npos ? address : "[" + address + "]");
  hosts.push_back("localhost");
  const std::string with_port = ":" + std::to_string(port);
  const std::string scheme = tls ? "https://" : "http://";
  const bool standard = port == (tls ? 443 : 80);
  for (const std::string& host : hosts) {
    const std::size_t colon = host.rfind(':');
    const bool names_port = colon != std::string::npos && host.back() != ']';
    hosts_.push_back(names_port ? host : host + with_port);
    if (!names_port && standard) hosts_.push_back(host);
  }
  for (const std::string& host : hosts_) origins_.push_back(scheme + host);
}

bool WebNames::is_ours(std::string_view host) const {
  return std::find(hosts_.begin(), hosts_.end(), host) != hosts_.end();
}

bool WebNames::may_come_from(std::string_view origin) const {
  return origin.empty() || std::find(origins_.begin(), origins_.end(), origin) != origins_.end();
}

}  // namespace weakgrid
