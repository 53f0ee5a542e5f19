// RelayedHosts: see the header.
#include "tests/faults/relayed_hosts.hpp"

#include <arpa/inet.h>
#include <fcntl.h>
#include <linux/if_tun.h>
#include <net/if.h>
#include <netinet/ip.h>
#include <poll.h>
#include <sched.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <cstring>
#include <stdexcept>

namespace weakgrid::faults {

namespace {

constexpr const char* interface = "wire";

[[noreturn]] void fail(const std::string& what) {
  throw std::runtime_error(what + ": " + std::strerror(errno));
}

int this_space() { return open("/proc/thread-self/ns/net", O_RDONLY | O_CLOEXEC); }

void set_address(int socket, unsigned long request, const std::string& text) {
  ifreq about{};
  std::strcpy(about.ifr_name, interface);
  auto& address = reinterpret_cast<sockaddr_in&>(about.ifr_addr);
  address.sin_family = AF_INET;
  inet_pton(AF_INET, text.c_str(), &address.sin_addr);
  if (ioctl(socket, request, &about) != 0) fail("an address of a host");
}

void set_up(int socket, const char* name, bool up) {
  ifreq about{};
  std::strcpy(about.ifr_name, name);
  if (ioctl(socket, SIOCGIFFLAGS, &about) != 0) fail(name);
  about.ifr_flags = static_cast<short>(up ? about.ifr_flags | IFF_UP : about.ifr_flags & ~IFF_UP);
  if (ioctl(socket, SIOCSIFFLAGS, &about) != 0) fail(name);
}

}  // namespace

std::string RelayedHosts::refused() {
  std::string why;
  // On a thread of its own: whoever asks stays where it is.
  std::thread([&why] {
    if (unshare(CLONE_NEWNET) != 0) why = std::string("network namespaces: ") + std::strerror(errno);
    const int tun = open("/dev/net/tun", O_RDWR | O_CLOEXEC);
    ifreq about{};
    about.ifr_flags = IFF_TUN | IFF_NO_PI;
    if (why.empty() && (tun < 0 || ioctl(tun, TUNSETIFF, &about) != 0))
      why = std::string("/dev/net/tun: ") + std::strerror(errno);
    if (tun >= 0) close(tun);
  }).join();
  return why;
}

RelayedHosts::RelayedHosts(unsigned count, std::uint64_t seed)
    : own_space_(this_space()), hosts_(count), random_(seed) {
  for (unsigned n = 0; n < count; ++n) make(hosts_[n], n);
  thread_ = std::thread([this] { relay(); });
}

RelayedHosts::~RelayedHosts() {
  stopping_ = true;
  thread_.join();
  for (const Host& host : hosts_)
    for (const int file : {host.space, host.tun, host.socket}) close(file);
  close(own_space_);
}

void RelayedHosts::make(Host& host, unsigned number) const {
  if (unshare(CLONE_NEWNET) != 0) fail("a network namespace");
  host.space = this_space();
  host.socket = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  host.tun = open("/dev/net/tun", O_RDWR | O_CLOEXEC | O_NONBLOCK);
  ifreq about{};
  std::strcpy(about.ifr_name, interface);
  about.ifr_flags = IFF_TUN | IFF_NO_PI;
  if (host.tun < 0 || ioctl(host.tun, TUNSETIFF, &about) != 0) fail("/dev/net/tun");
  set_address(host.socket, SIOCSIFADDR, address(number));
  set_address(host.socket, SIOCSIFNETMASK, "255.255.255.0");
  set_up(host.socket, interface, true);
  set_up(host.socket, "lo", true);
  if (setns(own_space_, CLONE_NEWNET) != 0) fail("the way back from a network namespace");
}

void RelayedHosts::on(unsigned host, const std::function<void()>& start) const {
  if (setns(hosts_.at(host).space, CLONE_NEWNET) != 0) fail("a host");
  start();
  if (setns(own_space_, CLONE_NEWNET) != 0) fail("the way back from a host");
}

void RelayedHosts::set(const Weather& weather) {
  const std::lock_guard lock(mutex_);
  weather_ = weather;
}

void RelayedHosts::link(unsigned host, bool up) { set_up(hosts_.at(host).socket, interface, up); }

RelayedHosts::Counts RelayedHosts::counts() const {
  const std::lock_guard lock(mutex_);
  return counts_;
}

void RelayedHosts::relay() {
  std::vector<pollfd> wires;
  for (const Host& host : hosts_) wires.push_back({host.tun, POLLIN, 0});
  std::vector<char> bytes(65536);
  while (!stopping_) {
    // Where packets wait for their time, it is looked at every 0.2 ms or so.
    bool are_waiting = false;
    {
      const std::lock_guard lock(mutex_);
      are_waiting = !waiting_.empty();
    }
    const timespec patience{0, are_waiting ? 200'000 : 20'000'000};
    ppoll(wires.data(), wires.size(), &patience, nullptr);
    const std::lock_guard lock(mutex_);
    for (std::size_t n = 0; n < wires.size(); ++n) {
      ssize_t size = 0;
      for (int burst = 0; burst < 64 && (size = read(hosts_[n].tun, bytes.data(), bytes.size())) > 0; ++burst)
        take(n, bytes.data(), static_cast<std::size_t>(size));
    }
    deliver_due();
  }
}

// IPv4 alone: the hosts' own neighbour discovery and the like goes nowhere.
void RelayedHosts::take(std::size_t from, const char* bytes, std::size_t size) {
  if (size < sizeof(iphdr) || (bytes[0] & 0xf0) != 0x40) return;
  iphdr header;
  std::memcpy(&header, bytes, sizeof header);
  const std::uint32_t address = ntohl(header.daddr);
  for (std::size_t to = 0; to < hosts_.size(); ++to)
    if (to != from && (IN_MULTICAST(address) || (address & 0xff) == to + 1)) send(to, bytes, size);
}

void RelayedHosts::send(std::size_t to, const char* bytes, std::size_t size) {
  const auto happens = [this](double share) {
    return share > 0.0 && std::uniform_real_distribution()(random_) < share;
  };
  ++counts_.relayed;
  if (happens(weather_.lost)) {
    ++counts_.lost;
    return;
  }
  const bool is_doubled = happens(weather_.doubled);
  counts_.doubled += is_doubled ? 1 : 0;
  for (int copy = 0; copy < (is_doubled ? 2 : 1); ++copy) {
    auto delay = weather_.delay;
    if (happens(weather_.late)) {
      delay +=
          std::chrono::microseconds(random_() % static_cast<std::uint64_t>(weather_.late_max.count() + 1));
      ++counts_.late;
    }
    if (delay.count() == 0 && waiting_.empty())
      (void)!write(hosts_[to].tun, bytes, size);  // a link that is down takes nothing
    else
      waiting_.push({std::chrono::steady_clock::now() + delay, numbered_++, to, {bytes, bytes + size}});
  }
}

void RelayedHosts::deliver_due() {
  const Time now = std::chrono::steady_clock::now();
  for (; !waiting_.empty() && waiting_.top().due <= now; waiting_.pop())
    (void)!write(hosts_[waiting_.top().to].tun, waiting_.top().bytes.data(), waiting_.top().bytes.size());
}

}  // namespace weakgrid::faults
