// What one thread hands to one other without a lock or an allocation: a bounded queue, and a place for the
// newest.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <optional>

namespace weakgrid {

/// One thread puts, one takes. Full: put gives false and the message is lost to the caller's count.
template <class Message, std::size_t capacity>
class Mailbox {
 public:
  [[nodiscard]] bool put(const Message& message) noexcept {
    const std::size_t put = put_.load(std::memory_order_relaxed);
    if (put - taken_.load(std::memory_order_acquire) == capacity) return false;
    slots_[put % capacity] = message;
    put_.store(put + 1, std::memory_order_release);
    return true;
  }

  std::optional<Message> take() noexcept {
    const std::size_t taken = taken_.load(std::memory_order_relaxed);
    if (taken == put_.load(std::memory_order_acquire)) return std::nullopt;
    std::optional<Message> message{slots_[taken % capacity]};
    taken_.store(taken + 1, std::memory_order_release);
    return message;
  }

 private:
  std::array<Message, capacity> slots_{};
  std::atomic<std::size_t> put_{0};
  std::atomic<std::size_t> taken_{0};
};

/// One thread puts, one takes: the newest of what has been put since the last take.
template <class Message>
class Newest {
 public:
  void put(const Message& message) noexcept {
    slots_[mine_] = message;
    mine_ = between_.exchange(mine_ | fresh, std::memory_order_acq_rel) & ~fresh;
  }

  std::optional<Message> take() noexcept {
    if ((between_.load(std::memory_order_relaxed) & fresh) == 0) return std::nullopt;
    theirs_ = between_.exchange(theirs_, std::memory_order_acq_rel) & ~fresh;
    return slots_[theirs_];
  }

 private:
  static constexpr std::uint8_t fresh = 4;
  std::array<Message, 3> slots_{};
  std::uint8_t mine_ = 0, theirs_ = 1;  // slots that only the one or the other touches
  std::atomic<std::uint8_t> between_{2};
};

}  // namespace weakgrid
