// Typed topics over one DDS participant: the only door to Fast DDS.
#pragma once

#include <array>
#include <atomic>
#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "services/runtime/one_writer.hpp"
#include "services/runtime/role.hpp"
#include "services/runtime/settings.hpp"

namespace weakgrid {

/// The world failed at start-up: a participant, topic, reader or writer cannot be made.
struct BusError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// Where a message comes from.
struct Arrival {
  std::uint32_t unit = 0;
  WriterId writer = 0;
  std::int64_t sent_ns = 0;  ///< CLOCK_REALTIME of the writer when it wrote
};

/// Units first, first + 1, … whose messages one reader takes.
struct Units {
  std::uint32_t first = 1, count = 1;
  Units(std::uint32_t number) : first(number) {}
  Units(std::uint32_t first_number, std::uint32_t how_many) : first(first_number), count(how_many) {}
};

/// One DDS participant: UDPv4 alone, on the interfaces given; with security under the identity of its role.
/// Its threads have the signal mask and scheduling of the thread that makes it. Throws BusError;
/// SettingsError for an interface that is not there or a file of the security's folder.
class Bus {
 public:
  Bus(std::uint32_t domain, const DdsSettings& dds, Role role);
  ~Bus();
  Bus(const Bus&) = delete;
  Bus& operator=(const Bus&) = delete;

  /// In words, a reader whose taker has been at one message since this was asked last; empty: none.
  /// From the thread that makes the readers.
  std::string stuck();

  struct Impl;
  Impl& impl() { return *impl_; }

 private:
  std::unique_ptr<Impl> impl_;
};

/// Writes one unit's messages of one topic. From one thread at a time.
template <class Message>
class Writer {
 public:
  Writer(Bus& bus, std::uint32_t unit);
  ~Writer();
  /// False: not sent. For a sample topic the next one replaces it; a command or state has no room left.
  [[nodiscard]] bool write(const Message& message) noexcept;
  /// Waits until every matched reader has what was written; false after `patience`. Reliable topics only.
  bool wait_until_taken(std::chrono::milliseconds patience) noexcept;
  /// Readers matched now.
  int matched() const noexcept;
  /// As readers know it.
  WriterId id() const noexcept;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// Takes messages of one topic of one or several units as they come, on a thread of the bus, or of a writer
/// in the same process.
template <class Message>
class Reader {
 public:
  using Take = std::function<void(const Message&, Arrival)>;
  Reader(Bus& bus, Units units, Take take);
  /// No call of take is under way or comes after this.
  ~Reader();
  /// Writers matched now.
  int matched() const noexcept;
  /// This writer is matched now.
  bool is_alive(WriterId writer) const noexcept;
  /// Samples that no correct peer sends, of one of its units.
  std::uint64_t malformed(std::uint32_t unit) const noexcept;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace weakgrid
