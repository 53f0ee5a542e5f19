// Participants over Fast DDS: see the header.
#include "services/runtime/participant.hpp"

#include <arpa/inet.h>
#include <ifaddrs.h>
#include <netinet/in.h>
#include <sys/resource.h>

#include <algorithm>
#include <fastdds/dds/domain/qos/DomainParticipantQos.hpp>
#include <fastdds/dds/log/Log.hpp>
#include <mutex>
#include <set>
#include <sstream>

#include "services/runtime/bus.hpp"
#include "services/runtime/security.hpp"

namespace weakgrid {

namespace {

// Participants that one host may have in a domain when nobody multicasts: each has a port of its own, and all
// are asked for.
constexpr std::uint32_t participants_of_a_host = 32;

// Never destroyed: Fast DDS may have something to say until the very end.
struct Kept {
  std::mutex mutex;
  std::vector<std::string> errors;  // the newest few
};
Kept& kept() {
  static Kept* const it = new Kept;
  return *it;
}

// Fast DDS prints to stdout by default, where a command's answer belongs.
class ErrorKeeper : public dds::LogConsumer {
  void Consume(const dds::Log::Entry& entry) override {
    if (entry.kind != dds::Log::Kind::Error) return;
    constexpr std::size_t most = 4;
    const std::lock_guard lock(kept().mutex);
    auto& errors = kept().errors;
    if (errors.size() == most) errors.erase(errors.begin());
    errors.push_back(entry.message);
  }
};

void keep_errors() {
  static std::once_flag once;
  std::call_once(once, [] {
    dds::Log::SetVerbosity(dds::Log::Kind::Error);
    dds::Log::ClearConsumers();
    dds::Log::RegisterConsumer(std::make_unique<ErrorKeeper>());
  });
}

// What one participant tells another of the same process goes the short way, by a call. Fast DDS 2.9 then
// takes keys for delivered that come before the other is ready for them, and the two never meet; a packet
// would be sent again.
void discover_by_packets() {
  static std::once_flag once;
  std::call_once(once, deliver_user_data_alone_within_process);
}

// Fast DDS would go on without it, and be alone.
void expect_interfaces(const std::vector<std::string>& wanted) {
  std::set<std::string> here;
  ifaddrs* first = nullptr;
  if (getifaddrs(&first) != 0) return;
  for (const ifaddrs* one = first; one != nullptr; one = one->ifa_next) {
    if (one->ifa_addr == nullptr || one->ifa_addr->sa_family != AF_INET) continue;
    char text[INET_ADDRSTRLEN];
    const auto* address = reinterpret_cast<const sockaddr_in*>(one->ifa_addr);
    here.insert(inet_ntop(AF_INET, &address->sin_addr, text, sizeof text));
  }
  freeifaddrs(first);
  std::ostringstream list;
  for (const std::string& address : here) list << ' ' << address;
  for (const std::string& address : wanted)
    if (!here.contains(address))
      throw SettingsError("dds.interfaces: " + address +
                          " is no address of this host; allowed:" + list.str());
}

// With too few Fast DDS finds no interface or opens no socket, says so to nobody, and is alone.
void expect_descriptors() {
  constexpr rlim_t least = 64;
  rlimit limit{};
  if (getrlimit(RLIMIT_NOFILE, &limit) == 0 && limit.rlim_cur < least)
    throw BusError("DDS: " + std::to_string(limit.rlim_cur) +
                   " file descriptors are allowed (RLIMIT_NOFILE), at least " + std::to_string(least) +
                   " are needed: ulimit -n, or LimitNOFILE= of its systemd unit");
}

rtps::Locator_t locator(const std::string& address, std::uint32_t port) {
  rtps::Locator_t locator(LOCATOR_KIND_UDPv4, port);
  rtps::IPLocator::setIPv4(locator, address);
  return locator;
}

void find_others(const DdsSettings& settings, Role role, dds::DomainParticipantQos& qos) {
  auto& builtin = qos.wire_protocol().builtin;
  // Long: where only one of two has taken the other for lost (one of them was held up for about so long),
  // Fast DDS 2.9 does not always make them meet again. Who is silent gives way much sooner: OneWriter.
  builtin.discovery_config.leaseDuration = Duration_t(20, 0);
  builtin.discovery_config.leaseDuration_announcementperiod = Duration_t(1, 0);
  if (!settings.discovery_server.empty()) {
    // A server tells a client of what that client takes part in; who listens to everything must ask for all.
    const bool listens_to_all = role == Role::recorder || role == Role::replayer || role == Role::console;
    builtin.discovery_config.discoveryProtocol =
        listens_to_all ? rtps::DiscoveryProtocol::SUPER_CLIENT : rtps::DiscoveryProtocol::CLIENT;
    const std::size_t colon = settings.discovery_server.find(':');
    use_discovery_server(
        locator(settings.discovery_server.substr(0, colon),
                static_cast<std::uint32_t>(std::stoul(settings.discovery_server.substr(colon + 1)))),
        builtin);
  }
  if (!settings.peers.empty()) {
    // Port 0: those of all participants that the host may have. The others of this host are asked too.
    for (const auto* addresses : {&settings.peers, &settings.interfaces})
      for (const std::string& address : *addresses) builtin.initialPeersList.push_back(locator(address, 0));
    // A list of unicast addresses of its own keeps a participant from listening to multicast.
    for (const std::string& address : settings.interfaces)
      builtin.metatrafficUnicastLocatorList.push_back(locator(address, 0));
  }
}

}  // namespace

std::string reason() {
  dds::Log::Flush();
  const std::lock_guard lock(kept().mutex);
  std::string text;
  for (const std::string& error : kept().errors) text += (text.empty() ? ": " : "; ") + error;
  kept().errors.clear();
  return text;
}

dds::DomainParticipant* make_participant(std::uint32_t domain, const DdsSettings& settings, Role role,
                                         dds::DomainParticipantListener* listener,
                                         std::uint32_t receive_buffer_bytes) {
  keep_errors();
  expect_descriptors();
  expect_interfaces(settings.interfaces);
  dds::DomainParticipantQos qos;
  qos.name(std::string("weakgrid-") + name(role));
  auto transport = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
  transport->interfaceWhiteList = settings.interfaces;
  transport->receiveBufferSize = receive_buffer_bytes;
  transport->maxInitialPeersRange = participants_of_a_host;
  qos.transport().use_builtin_transports = false;
  qos.transport().user_transports.push_back(transport);
  find_others(settings, role, qos);
  if (!settings.security.empty()) {
    secure(settings.security, role, domain, qos);
    discover_by_packets();
  }
  auto* participant = dds::DomainParticipantFactory::get_instance()->create_participant(
      domain, qos, listener, dds::StatusMask::none());
  if (participant == nullptr)
    throw BusError("DDS: participant in domain " + std::to_string(domain) + " cannot be made" +
                   (settings.security.empty() ? "" : " with security of " + settings.security) + reason());
  return participant;
}

}  // namespace weakgrid
