// Who may what at the console's door: tokens, sessions, names and origins. Knows no sockets.
#pragma once

#include <array>
#include <cstdint>
#include <deque>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace weakgrid {

enum class Access : std::uint8_t {
  none,
  view,  ///< everything that is shown
  set,   ///< and setpoints
};

/// A file with one line for each token, "view TOKEN" or "set TOKEN", 32 … 256 printable characters; empty
/// lines and what follows # do not count. Throws SettingsError with the line, never with the token.
std::vector<std::pair<Access, std::string>> read_tokens(const std::string& file);

/// Somebody is let in by a header "Authorization: Bearer TOKEN", or by the cookie of a session that log_in()
/// gave for a token: browsers send no such header, and a token has no place in a URL.
class WebAccess {
 public:
  /// Without tokens everybody may set.
  explicit WebAccess(std::vector<std::pair<Access, std::string>> tokens);

  Access of(std::string_view authorization, std::string_view cookies) const;
  /// A session's secret; nothing for a token that is none. At most 64 sessions: the oldest goes.
  std::optional<std::string> log_in(std::string_view token);
  void log_out(std::string_view cookies);

  static constexpr const char* cookie = "weakgrid_session";

 private:
  struct Known {
    Access access = Access::none;
    std::string digest;  // SHA-256, so that comparing takes no time that tells of the secret
  };
  Access of_token(std::string_view token) const;

  const bool everybody_;
  std::vector<Known> tokens_;
  std::deque<Known> sessions_;
};

/// Where requests may come to and from. A page of somebody else, or one that a name of somebody else brought
/// here (DNS rebinding), has another Host or Origin.
class WebNames {
 public:
  /// hosts: further names of this server, "name" or "name:port"; origins: further pages,
  /// "scheme://host[:port]".
  WebNames(const std::string& address, std::uint16_t port, bool tls, std::vector<std::string> hosts,
           std::vector<std::string> origins);

  bool is_ours(std::string_view host) const;
  /// What is no browser has none.
  bool may_come_from(std::string_view origin) const;

 private:
  std::vector<std::string> hosts_, origins_;
};

}  // namespace weakgrid
