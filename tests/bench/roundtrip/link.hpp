// One way to go from a process to another and back, laid out as plant and controller are: who answers does so
// where the sample arrives; who asks waits in a thread of its own and is woken.
#pragma once

#include <atomic>
#include <cstdint>
#include <ctime>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "services/runtime/semaphore.hpp"

namespace weakgrid::bench {

/// Where two processes meet.
struct Place {
  std::uint32_t domain = 0;
  std::string name;  ///< of shared memory, begins with '/'

  /// In the domain's range, beyond what its participants take.
  std::uint16_t port() const { return static_cast<std::uint16_t>(7400 + 250 * domain + 249); }
};

struct LinkError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// The plant's side. From one thread.
class Caller {
 public:
  virtual ~Caller() = default;
  virtual bool is_matched() = 0;
  /// Sends sample `step` and waits for its answer. False: none until the deadline.
  virtual bool exchange(std::uint64_t step, const timespec& deadline) = 0;
};

/// The controller's side: answers as long as it lives.
class Echo {
 public:
  virtual ~Echo() = default;
};

/// Hands the answer from a thread of the middleware to the one that waits.
class Handover {
 public:
  void give(std::uint64_t step) noexcept {
    step_.store(step, std::memory_order_release);
    wake_.post();
  }
  bool wait_for(std::uint64_t step, const timespec& deadline) noexcept {
    while (wake_.wait_until(deadline))
      if (step_.load(std::memory_order_acquire) == step) return true;
    return false;
  }

 private:
  std::atomic<std::uint64_t> step_{0};
  Semaphore wake_;
};

/// A kind of link: its name and how to make either end. May throw LinkError.
struct Kind {
  const char* name;
  std::unique_ptr<Caller> (*make_caller)(const Place&);
  std::unique_ptr<Echo> (*make_echo)(const Place&);
};

extern const Kind fastdds_udp, fastdds_data_sharing, cyclone_udp, udp_sockets, shared_memory;

}  // namespace weakgrid::bench
