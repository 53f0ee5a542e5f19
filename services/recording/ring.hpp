// A bounded byte ring from the threads that receive to the one that writes: what does not fit is lost and
// counted, nobody waits, nothing is allocated.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <mutex>
#include <optional>

#include "services/recording/sample.hpp"

namespace weakgrid {

/// Any threads put, one takes. The lock is among those who put, and held for the copy only.
class SampleRing {
 public:
  /// `bytes` for the samples with their heads, `writers` = indices that are counted.
  SampleRing(std::size_t bytes, std::size_t writers)
      : capacity_{bytes / alignment * alignment},
        writers_{writers},
        bytes_{std::make_unique<std::byte[]>(capacity_)},
        drops_{std::make_unique<std::atomic<std::uint64_t>[]>(writers)} {}

  /// False: lost and counted.
  bool put(const RawSample& sample) noexcept {
    const std::size_t need = room(sample.payload.size());
    const std::lock_guard lock(mutex_);
    const std::uint64_t put = put_.load(std::memory_order_relaxed);
    const std::uint64_t taken = taken_.load(std::memory_order_acquire);
    const std::size_t to_end = capacity_ - put % capacity_;
    // A record lies in one piece: if it does not fit before the end, it begins at the start.
    const std::size_t skip = need <= to_end ? 0 : to_end;
    if (sample.writer >= writers_ || sample.payload.size() >= capacity_ ||
        put - taken + skip + need > capacity_) {
      if (sample.writer < writers_) drops_[sample.writer].fetch_add(1, std::memory_order_relaxed);
      return false;
    }
    // A head that does not fit before the end needs no mark: whoever takes sees the same lack of room.
    if (skip >= sizeof(Head)) store({.size = skip_mark}, put);
    store({.source_ns = sample.source_ns,
           .reception_ns = sample.reception_ns,
           .sequence = sample.sequence,
           .size = sample.payload.size(),
           .writer = sample.writer,
           .has_data = sample.has_data},
          put + skip);
    if (!sample.payload.empty())
      std::memcpy(at(put + skip) + sizeof(Head), sample.payload.data(), sample.payload.size());
    put_.store(put + skip + need, std::memory_order_release);
    return true;
  }

  /// The oldest sample; its payload holds until drop_front().
  std::optional<RawSample> front() noexcept {
    std::uint64_t taken = taken_.load(std::memory_order_relaxed);
    if (taken == put_.load(std::memory_order_acquire)) return std::nullopt;
    Head head = load(taken);
    if (head.size == skip_mark) {
      taken += capacity_ - taken % capacity_;
      taken_.store(taken, std::memory_order_release);
      head = load(taken);
    }
    return RawSample{.writer = head.writer,
                     .has_data = head.has_data,
                     .sequence = head.sequence,
                     .source_ns = head.source_ns,
                     .reception_ns = head.reception_ns,
                     .payload = {at(taken) + sizeof(Head), static_cast<std::size_t>(head.size)}};
  }
  /// After front() gave a sample.
  void drop_front() noexcept {
    const std::uint64_t taken = taken_.load(std::memory_order_relaxed);
    taken_.store(taken + room(static_cast<std::size_t>(load(taken).size)), std::memory_order_release);
  }

  /// Samples of this writer that found no room.
  std::uint64_t drops(std::uint32_t writer) const noexcept {
    return writer < writers_ ? drops_[writer].load(std::memory_order_relaxed) : 0;
  }

 private:
  struct Head {
    std::int64_t source_ns = 0;
    std::int64_t reception_ns = 0;
    std::uint64_t sequence = 0;
    std::uint64_t size = 0;
    std::uint32_t writer = 0;
    bool has_data = false;
  };
  static constexpr std::size_t alignment = 8;
  static constexpr std::uint64_t skip_mark = ~std::uint64_t{0};

  static constexpr std::size_t room(std::size_t payload_bytes) noexcept {
    return (sizeof(Head) + payload_bytes + alignment - 1) / alignment * alignment;
  }
  std::byte* at(std::uint64_t position) const noexcept { return bytes_.get() + position % capacity_; }
  void store(const Head& head, std::uint64_t position) noexcept {
    std::memcpy(at(position), &head, sizeof head);
  }
  Head load(std::uint64_t position) const noexcept {
    Head head{.size = skip_mark};
    if (capacity_ - position % capacity_ >= sizeof head) std::memcpy(&head, at(position), sizeof head);
    return head;
  }

  const std::size_t capacity_;
  const std::size_t writers_;
  const std::unique_ptr<std::byte[]> bytes_;
  const std::unique_ptr<std::atomic<std::uint64_t>[]> drops_;
  std::mutex mutex_;
  std::atomic<std::uint64_t> put_{0};
  std::atomic<std::uint64_t> taken_{0};
};

}  // namespace weakgrid
