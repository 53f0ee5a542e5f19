// What no middleware goes below: UDP sockets on loopback, and semaphores (futexes) in shared memory. No
// thread stands between: who waits is woken by the kernel itself.
#include <arpa/inet.h>
#include <fcntl.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <new>
#include <thread>

#include "tests/bench/roundtrip/link.hpp"

namespace weakgrid::bench {
namespace {

// The bytes of Sample and Answer with their encapsulation.
struct Packet {
  std::uint64_t step = 0;
  std::byte rest[80 + 4 - 8]{};
};
constexpr std::size_t sample_bytes = 80 + 4, answer_bytes = 48 + 4;
constexpr std::chrono::milliseconds look_up_after{20};

std::string last_error(const char* what) { return std::string(what) + ": " + std::strerror(errno); }

int open_socket() {
  const int file = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  const timeval patience{.tv_sec = 0, .tv_usec = 20'000};
  if (file < 0 || setsockopt(file, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience) != 0)
    throw LinkError(last_error("socket"));
  return file;
}

sockaddr_in address_of(const Place& place) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  address.sin_port = htons(place.port());
  return address;
}

class SocketCaller : public Caller {
 public:
  explicit SocketCaller(const Place& place) : socket_(open_socket()) {
    const sockaddr_in address = address_of(place);
    if (connect(socket_, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0)
      throw LinkError(last_error("connect"));
  }
  ~SocketCaller() override { ::close(socket_); }
  bool is_matched() override { return exchange(0, {}); }
  // Waits as long as the socket's own patience, the deadline's by construction.
  bool exchange(std::uint64_t step, const timespec&) override {
    packet_.step = step;
    if (send(socket_, &packet_, sample_bytes, 0) < 0) return false;
    while (recv(socket_, &packet_, sizeof packet_, 0) > 0)
      if (packet_.step == step) return true;
    return false;
  }

 private:
  int socket_;
  Packet packet_;
};

class SocketEcho : public Echo {
 public:
  explicit SocketEcho(const Place& place) : socket_(open_socket()) {
    const sockaddr_in address = address_of(place);
    if (bind(socket_, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0)
      throw LinkError(last_error("bind"));
    thread_ = std::thread([this] { answer(); });
  }
  ~SocketEcho() override {
    stopping_ = true;
    thread_.join();
    ::close(socket_);
  }

 private:
  void answer() {
    Packet packet;
    sockaddr_in from{};
    while (!stopping_) {
      socklen_t size = sizeof from;
      if (recvfrom(socket_, &packet, sizeof packet, 0, reinterpret_cast<sockaddr*>(&from), &size) > 0)
        (void)sendto(socket_, &packet, answer_bytes, 0, reinterpret_cast<sockaddr*>(&from), size);
    }
  }
  int socket_;
  std::atomic<bool> stopping_{false};
  std::thread thread_;
};

struct Page {
  std::atomic<bool> is_served{false};
  sem_t sample_is_there, answer_is_there;
  alignas(64) Packet sample;
  alignas(64) Packet answer;
};

Page* map(int file) {
  void* memory = mmap(nullptr, sizeof(Page), PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
  ::close(file);
  if (memory == MAP_FAILED) throw LinkError(last_error("mmap"));
  return static_cast<Page*>(memory);
}

class MemoryCaller : public Caller {
 public:
  explicit MemoryCaller(const Place& place) : name_(place.name) {
    // Complete before it has its name.
    const std::string making = name_ + ".making";
    const int file = shm_open(making.c_str(), O_CREAT | O_EXCL | O_RDWR, 0600);
    if (file < 0 || ftruncate(file, sizeof(Page)) != 0) throw LinkError(last_error("shm_open"));
    page_ = new (map(file)) Page;
    sem_init(&page_->sample_is_there, 1, 0);
    sem_init(&page_->answer_is_there, 1, 0);
    if (rename(("/dev/shm" + making).c_str(), ("/dev/shm" + name_).c_str()) != 0)
      throw LinkError(last_error("rename"));
  }
  ~MemoryCaller() override {
    shm_unlink(name_.c_str());
    munmap(page_, sizeof *page_);
  }
  bool is_matched() override { return page_->is_served; }
  bool exchange(std::uint64_t step, const timespec& deadline) override {
    page_->sample.step = step;
    sem_post(&page_->sample_is_there);
    while (sem_clockwait(&page_->answer_is_there, CLOCK_MONOTONIC, &deadline) == 0)
      if (page_->answer.step == step) return true;
    return false;
  }

 private:
  std::string name_;
  Page* page_;
};

class MemoryEcho : public Echo {
 public:
  explicit MemoryEcho(const Place& place) {
    int file = -1;
    for (int n = 0; n < 250 && file < 0; ++n) {
      file = shm_open(place.name.c_str(), O_RDWR, 0600);
      if (file < 0) std::this_thread::sleep_for(look_up_after);
    }
    if (file < 0) throw LinkError(last_error("shm_open"));
    page_ = map(file);
    thread_ = std::thread([this] { answer(); });
  }
  ~MemoryEcho() override {
    stopping_ = true;
    thread_.join();
    munmap(page_, sizeof *page_);
  }

 private:
  void answer() {
    page_->is_served = true;
    while (!stopping_) {
      const timespec deadline = monotonic_after(look_up_after);
      if (sem_clockwait(&page_->sample_is_there, CLOCK_MONOTONIC, &deadline) != 0) continue;
      page_->answer.step = page_->sample.step;
      sem_post(&page_->answer_is_there);
    }
  }
  Page* page_ = nullptr;
  std::atomic<bool> stopping_{false};
  std::thread thread_;
};

template <class End>
std::unique_ptr<Caller> make_caller(const Place& place) {
  return std::make_unique<End>(place);
}
template <class End>
std::unique_ptr<Echo> make_echo(const Place& place) {
  return std::make_unique<End>(place);
}

}  // namespace

const Kind udp_sockets{"udp_sockets", make_caller<SocketCaller>, make_echo<SocketEcho>};
const Kind shared_memory{"shared_memory", make_caller<MemoryCaller>, make_echo<MemoryEcho>};

}  // namespace weakgrid::bench
