// Packets of the services themselves, caught on the loopback, damaged and sent to them again while they run:
// nobody may be lost for long, and the unit obeys again afterwards. (What it does meanwhile its protection
// judges: forged samples look like true ones from outside.) WEAKGRID_PACKETS (2000): how many;
// WEAKGRID_LAW_SEED: of the damage, which is not repeatable to the bit, since the packets caught are not.
#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <linux/if_packet.h>
#include <net/ethernet.h>
#include <net/if.h>
#include <netinet/in.h>
#include <signal.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <cstring>
#include <functional>
#include <map>
#include <random>
#include <thread>

#include "services/recording/mcap_reader.hpp"
#include "tests/recording/recording_support.hpp"
#include "tests/services/bystander.hpp"
#include "tests/support/law_input.hpp"

namespace weakgrid {
namespace {

using std::chrono::milliseconds;
using Clock = std::chrono::steady_clock;
using Random = std::mt19937_64;
using Bytes = std::vector<unsigned char>;

struct Packet {
  sockaddr_in to{};
  Bytes bytes;
};

constexpr std::size_t header_size = 20;  // "RTPS", version, vendor, GUID prefix

// What anybody in the domain sends on the loopback, while this lives.
class Capture {
 public:
  explicit Capture(std::uint32_t domain)
      : first_port_(static_cast<std::uint16_t>(7400 + 250 * domain)),
        socket_(socket(AF_PACKET, SOCK_DGRAM | SOCK_NONBLOCK, htons(ETH_P_IP))) {
    sockaddr_ll at{};
    at.sll_family = AF_PACKET;
    at.sll_protocol = htons(ETH_P_IP);
    at.sll_ifindex = static_cast<int>(if_nametoindex("lo"));
    if (socket_ >= 0 && bind(socket_, reinterpret_cast<const sockaddr*>(&at), sizeof at) != 0) close(socket_);
  }
  ~Capture() {
    if (socket_ >= 0) close(socket_);
  }
  Capture(const Capture&) = delete;
  Capture& operator=(const Capture&) = delete;
  bool is_allowed() const { return socket_ >= 0; }

  // Not all of one kind: samples are many, and discovery's packets few.
  void take_for(milliseconds time, std::vector<Packet>& packets) const {
    for (const auto end = Clock::now() + time; Clock::now() < end;) {
      Bytes frame(65536);
      sockaddr_ll from{};
      socklen_t length = sizeof from;
      const ssize_t size =
          recvfrom(socket_, frame.data(), frame.size(), 0, reinterpret_cast<sockaddr*>(&from), &length);
      if (size < 0) {
        std::this_thread::sleep_for(milliseconds(1));
        continue;
      }
      frame.resize(static_cast<std::size_t>(size));
      if (from.sll_pkttype != PACKET_OUTGOING) keep(frame, packets);
    }
  }

 private:
  void keep(const Bytes& frame, std::vector<Packet>& packets) const {
    constexpr std::size_t udp_header = 8, each_max = 60;
    if (frame.size() < 20 || frame[9] != IPPROTO_UDP) return;
    const std::size_t ip_header = std::size_t{frame[0] & 15u} * 4, begin = ip_header + udp_header;
    if (frame.size() < begin + header_size || std::memcmp(&frame[begin], "RTPS", 4) != 0) return;
    Packet packet;
    packet.to.sin_family = AF_INET;
    std::memcpy(&packet.to.sin_addr, &frame[16], 4);
    std::memcpy(&packet.to.sin_port, &frame[ip_header + 2], 2);
    const int port = ntohs(packet.to.sin_port);
    if (port < first_port_ || port >= first_port_ + 250) return;
    packet.bytes.assign(frame.begin() + static_cast<std::ptrdiff_t>(begin), frame.end());
    const auto alike = std::ranges::count_if(packets, [&](const Packet& p) {
      return p.to.sin_port == packet.to.sin_port && p.bytes.size() == packet.bytes.size();
    });
    if (alike < static_cast<std::ptrdiff_t>(each_max)) packets.push_back(std::move(packet));
  }

  const std::uint16_t first_port_;
  const int socket_;
};

std::size_t below(Random& random, std::size_t n) { return n == 0 ? 0 : random() % n; }

std::uint32_t interesting(Random& random) {
  constexpr std::uint32_t values[] = {0, 1, 0xff, 0x7fff, 0x8000, 0xffff, 0x7fffffff, 0x80000000, 0xffffffff};
  const std::size_t which = below(random, std::size(values) + 1);
  return which < std::size(values) ? values[which] : static_cast<std::uint32_t>(random());
}

// Where submessages begin, as far as their lengths lead.
std::vector<std::size_t> submessages(const Bytes& bytes) {
  std::vector<std::size_t> at;
  for (std::size_t here = header_size; here + 4 <= bytes.size();) {
    at.push_back(here);
    const bool is_little = (bytes[here + 1] & 1) != 0;
    const std::size_t length =
        is_little ? bytes[here + 2] | bytes[here + 3] << 8 : bytes[here + 3] | bytes[here + 2] << 8;
    if (length == 0) break;
    here += 4 + length;
  }
  return at;
}

void damage(Random& random, Bytes& bytes, const std::vector<Packet>& others) {
  const std::size_t size = bytes.size();
  const auto put = [&](std::size_t at, std::uint32_t value, std::size_t width) {
    std::memcpy(&bytes[at], &value, std::min(width, bytes.size() - at));
  };
  switch (below(random, 6)) {
    case 0:
      for (std::size_t n = 1 + below(random, 8); n > 0; --n)
        bytes[4 + below(random, size - 4)] ^= static_cast<unsigned char>(1u << below(random, 8));
      break;
    case 1:
      bytes.resize(header_size + below(random, size - header_size + 1));
      break;
    case 2:
      put(header_size + below(random, size - header_size) / 4 * 4, interesting(random), 4);
      break;
    case 3:
      if (const auto at = submessages(bytes); !at.empty())
        put(at[below(random, at.size())] + 2, interesting(random), 2);
      break;
    case 4: {
      const Bytes& other = others[below(random, others.size())].bytes;
      bytes.insert(bytes.end(), other.begin() + header_size, other.end());
      break;
    }
    case 5: {
      const std::size_t from = header_size + below(random, size - header_size);
      const Bytes piece(bytes.begin() + static_cast<std::ptrdiff_t>(from), bytes.end());
      bytes.insert(bytes.begin() + static_cast<std::ptrdiff_t>(from), piece.begin(), piece.end());
      break;
    }
  }
  constexpr std::size_t size_max = 60'000;
  if (bytes.size() > size_max) bytes.resize(size_max);
}

// As a service manager does: who dies is started again.
class Kept {
 public:
  Kept(std::string name, std::function<std::vector<std::string>()> arguments)
      : name_(std::move(name)), arguments_(std::move(arguments)) {
    start();
  }
  void look_after() {
    if (program_->runs()) return;
    ++deaths_;
    const std::string said = program_->err();
    // glibc's assert and terminate say it in one line, the last; who is killed by a signal says nothing.
    const auto end = said.find_last_not_of('\n');
    const auto begin = end == said.npos ? said.npos : said.find_last_of('\n', end);
    ++last_words_[end == said.npos ? "nothing" : said.substr(begin + 1, end - begin)];
    start();
  }
  test::Program& program() { return *program_; }
  const std::string& name() const { return name_; }
  std::uint64_t deaths() const { return deaths_; }
  const std::map<std::string, std::uint64_t>& last_words() const { return last_words_; }

 private:
  void start() { program_ = std::make_unique<test::Program>(name_, arguments_()); }

  const std::string name_;
  const std::function<std::vector<std::string>()> arguments_;
  std::unique_ptr<test::Program> program_;
  std::uint64_t deaths_ = 0;
  std::map<std::string, std::uint64_t> last_words_;
};

TEST(MutatedRtps, NobodyIsLostForLongAndTheUnitObeysAfterwards) {
  const std::uint64_t count = from_environment("WEAKGRID_PACKETS", 2000);
  const std::uint64_t seed = from_environment("WEAKGRID_LAW_SEED", std::random_device{}());
  SCOPED_TRACE("WEAKGRID_LAW_SEED=" + std::to_string(seed));
  Random random(seed);
  const test::Domain domain;
  const mcap::Folder folder;
  const Capture capture(domain.number());
  if (!capture.is_allowed()) GTEST_SKIP() << "packets on the loopback may not be seen: needs root";

  const test::TextFile settings(
      "[grid]\nreactance = 0.2\n[plant]\npatience_s = 60.0\n[gateway]\njournal = \"" + (folder / "journal") +
      "\"\n");
  const std::vector<std::string> common{"--settings", settings.path(), "--domain", domain.text()};
  std::size_t part = 0;
  std::vector<std::unique_ptr<Kept>> services;
  std::vector<Packet> packets;
  services.push_back(std::make_unique<Kept>("weakgrid-recorder", [&] {
    const std::string file = folder / ("part" + std::to_string(part++) + ".mcap").c_str();
    return std::vector<std::string>{"--domain", domain.text(), "--output", file};
  }));
  capture.take_for(milliseconds(300), packets);
  for (const char* name : {"weakgrid-plant", "weakgrid-controller", "weakgrid-gateway"}) {
    services.push_back(std::make_unique<Kept>(name, [&] { return common; }));
    capture.take_for(milliseconds(300), packets);
  }
  std::thread client([&] {
    const auto set =
        test::run("weakgrid", {"set", "--p", "0.4", "--q", "0.1", "--vc", "1.84", "--domain", domain.text()});
    EXPECT_EQ(set.status, 0) << set.out << set.err;
  });
  capture.take_for(milliseconds(1500), packets);
  client.join();
  ASSERT_GT(packets.size(), 100u);

  // Nobody of this process listens meanwhile: a participant here would be damaged too.
  const int out = socket(AF_INET, SOCK_DGRAM, 0);
  const in_addr loopback{htonl(INADDR_LOOPBACK)};
  ASSERT_EQ(setsockopt(out, IPPROTO_IP, IP_MULTICAST_IF, &loopback, sizeof loopback), 0);
  constexpr std::uint64_t at_once = 20;  // every 2 ms: sockets hold that, and 10⁵ take 10 s
  for (std::uint64_t sent = 0; sent < count; ++sent) {
    const Packet& packet = packets[below(random, packets.size())];
    Bytes bytes = packet.bytes;
    for (std::size_t n = below(random, 4); n > 0 && bytes.size() > header_size; --n)
      damage(random, bytes, packets);
    (void)sendto(out, bytes.data(), bytes.size(), 0, reinterpret_cast<const sockaddr*>(&packet.to),
                 sizeof packet.to);
    if (sent % at_once != 0) continue;
    std::this_thread::sleep_for(milliseconds(2));
    for (const auto& service : services) service->look_after();
  }
  close(out);

  const auto over = Clock::now();
  // What waits in their sockets has its effect now.
  for (; Clock::now() - over < milliseconds(500); std::this_thread::sleep_for(milliseconds(2)))
    for (const auto& service : services) service->look_after();
  std::uint64_t deaths = 0;
  for (const auto& service : services) {
    deaths += service->deaths();
    for (const auto& [words, times] : service->last_words())
      std::printf("%s died %llu times saying: %s\n", service->name().c_str(),
                  static_cast<unsigned long long>(times), words.c_str());
  }
  test::Bystander bystander(domain);
  ASSERT_TRUE(bystander.runs(std::chrono::seconds(60))) << bystander.words();
  ASSERT_TRUE(bystander.order(0.2, 0.0)) << bystander.words();
  EXPECT_TRUE(bystander.settles_at(0.2, 0.0)) << bystander.words();
  const std::chrono::duration<double> recovery = Clock::now() - over;
  const std::uint64_t trips = bystander.count("plant", "tripped");
  for (const auto& service : services) {
    service->program().send(SIGTERM);
    EXPECT_EQ(service->program().wait(), 0) << service->name() << service->program().err();
  }
  std::printf("%llu packets made of %zu: %llu deaths, %s; a new setpoint settled %.1f s after\n",
              static_cast<unsigned long long>(count), packets.size(), static_cast<unsigned long long>(deaths),
              trips == 0 ? "no trip" : "tripped", recovery.count());
  // Forged samples may be in them; what they are made of must be sound.
  for (std::size_t n = 0; n < part; ++n) {
    mcap::Reader reader;
    EXPECT_TRUE(reader.open(folder / ("part" + std::to_string(n) + ".mcap").c_str()).ok());
  }
  const test::Ended journal = test::run("weakgrid", {"journal", folder / "journal", "--verify"});
  EXPECT_EQ(journal.status, 0) << journal.out << journal.err;
}

}  // namespace
}  // namespace weakgrid
