// How every participant of Weakgrid reaches the others: the one place that sets transport, discovery and,
// with security.hpp, who is let in.
#pragma once

#include <cstdint>
#include <string>

#include "services/runtime/fastdds_version.hpp"
#include "services/runtime/role.hpp"
#include "services/runtime/settings.hpp"

namespace weakgrid {

/// UDPv4 alone, on the interfaces given. receive_buffer_bytes: 0 = the system's default; the system may grant
/// less. The listener hears of discovery only. Throws SettingsError or BusError.
dds::DomainParticipant* make_participant(std::uint32_t domain, const DdsSettings& settings, Role role,
                                         dds::DomainParticipantListener* listener = nullptr,
                                         std::uint32_t receive_buffer_bytes = 0);

/// What Fast DDS has complained of lately in this process, and why something cannot be made, as ": …"; empty
/// if nothing. It is said once.
std::string reason();

}  // namespace weakgrid
