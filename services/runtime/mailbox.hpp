// A bounded queue from one thread to one other that neither locks nor allocates.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
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

}  // namespace weakgrid
