// Hosts of a campaign's own, without leave of anybody's network: each a network namespace whose one interface
// ends in this process (TUN). A thread relays the packets between them and makes the weather: the kernels
// that we meet have no netem, and what happens here is drawn from a seed.
#pragma once

#include <netinet/in.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <functional>
#include <mutex>
#include <queue>
#include <random>
#include <string>
#include <thread>
#include <vector>

namespace weakgrid::faults {

/// What becomes of a packet, each by its share of 1.
struct Weather {
  double lost = 0.0;
  double doubled = 0.0;
  std::chrono::microseconds delay{0};  ///< of all
  double late = 0.0;                   ///< of these each by another time, so that others overtake
  std::chrono::microseconds late_max{0};
};

class RelayedHosts {
 public:
  /// Why this user or kernel cannot have them; empty: can.
  static std::string refused();

  RelayedHosts(unsigned count, std::uint64_t seed);
  ~RelayedHosts();
  RelayedHosts(const RelayedHosts&) = delete;
  RelayedHosts& operator=(const RelayedHosts&) = delete;

  static std::string address(unsigned host) { return "10.77.0." + std::to_string(host + 1); }
  /// Calls it on that host: threads and processes that it starts live there.
  void on(unsigned host, const std::function<void()>& start) const;
  void set(const Weather& weather);
  /// The host's interface goes down or comes up.
  void link(unsigned host, bool up);

  struct Counts {
    std::uint64_t relayed = 0, lost = 0, doubled = 0, late = 0;
  };
  Counts counts() const;

 private:
  using Time = std::chrono::steady_clock::time_point;
  struct Host {
    int space = -1;   // its network namespace
    int tun = -1;     // the wire
    int socket = -1;  // in the namespace, to speak of its interface
  };
  struct Packet {
    Time due;
    std::uint64_t number;  // of two due at once the first goes first
    std::size_t to;
    std::vector<char> bytes;
    bool operator>(const Packet& other) const {
      return due != other.due ? due > other.due : number > other.number;
    }
  };
  void make(Host& host, unsigned number) const;
  void relay();
  void take(std::size_t from, const char* bytes, std::size_t size);
  void send(std::size_t to, const char* bytes, std::size_t size);
  void deliver_due();

  int own_space_ = -1;
  std::vector<Host> hosts_;
  mutable std::mutex mutex_;  // of the next four
  std::mt19937_64 random_;
  Weather weather_;
  Counts counts_;
  std::priority_queue<Packet, std::vector<Packet>, std::greater<>> waiting_;
  std::uint64_t numbered_ = 0;
  std::atomic<bool> stopping_{false};
  std::thread thread_;
};

}  // namespace weakgrid::faults
