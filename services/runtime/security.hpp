// DDS Security of a participant: its identity, what it may do, and what the domain asks of everybody. The
// files are deploy/security/make's.
#pragma once

#include <fastdds/dds/domain/qos/DomainParticipantQos.hpp>
#include <string>

#include "services/runtime/role.hpp"

namespace weakgrid {

/// Puts the files of `folder` for this role into force. Looks at them first, because Fast DDS says little of
/// what it does not like: throws SettingsError for one that is missing, unreadable, expired or not what its
/// CA signed.
void secure(const std::string& folder, Role role, std::uint32_t domain,
            eprosima::fastdds::dds::DomainParticipantQos& qos);

}  // namespace weakgrid
