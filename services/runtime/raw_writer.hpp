// Writes payloads nobody has parsed on any topic: the counterpart of Tap.
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "services/recording/sample.hpp"
#include "services/runtime/settings.hpp"

namespace weakgrid {

/// One DDS participant for raw writers, in the role of a replayer. It also sees who else writes.
class RawBus {
 public:
  /// Throws BusError.
  RawBus(std::uint32_t domain, const DdsSettings& dds);
  ~RawBus();
  RawBus(const RawBus&) = delete;
  RawBus& operator=(const RawBus&) = delete;

  /// Of other participants, as far as discovery has come; complete after a second or so.
  std::vector<LiveWriter> writers_of_others() const;

  struct Impl;
  Impl& impl() { return *impl_; }

 private:
  std::unique_ptr<Impl> impl_;
};

/// Writes synchronously: several writers of one bus, used by one thread, are heard in the order of the calls.
/// Of a keyed type of weakgrid.idl each payload goes to the instance that its key names; of another keyed
/// type, whose key nobody knows here, a writer's payloads are one instance. Must not outlive its bus.
class RawWriter {
 public:
  struct Options {
    std::string topic, type;
    bool keyed = false;
    bool reliable = true;
    bool transient_local = false;  ///< the last of each instance stands
    bool exclusive = false;        ///< ownership
    std::uint32_t strength = 0;    ///< of an exclusive one
    std::vector<std::string> partitions{};
    int depth = 100;  ///< volatile: samples kept for readers that are behind, for each instance
  };
  /// Throws BusError, also where the bus knows the topic with another type.
  RawWriter(RawBus& bus, const Options& options);
  ~RawWriter();
  RawWriter(RawWriter&&) noexcept;

  /// Readers matched now.
  int matched() const;
  /// False: the type is keyed and its key not known.
  bool knows_key() const;
  /// `payload` with its 4-byte encapsulation header. False: not sent.
  [[nodiscard]] bool write(std::span<const std::byte> payload);
  /// Waits until every matched reliable reader has what was written; false after `patience`.
  bool wait_until_taken(std::chrono::milliseconds patience);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace weakgrid
