// Who a program is on the bus: with security, whose identity it has and so what it may write and read.
// Which that is: deploy/security/access.
#pragma once

#include <cstddef>
#include <cstdint>

namespace weakgrid {

enum class Role : std::uint8_t { plant, controller, gateway, recorder, console, client, unit, replayer };

constexpr const char* name(Role role) noexcept {
  constexpr const char* names[] = {"plant",   "controller", "gateway", "recorder",
                                   "console", "client",     "unit",    "replayer"};
  return names[static_cast<std::size_t>(role)];
}

/// Its samples may go through shared memory.
constexpr bool is_of_loop(Role role) noexcept {
  return role == Role::plant || role == Role::controller || role == Role::unit;
}

}  // namespace weakgrid
