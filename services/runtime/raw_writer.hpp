// Writes payloads nobody has parsed on any topic without key: the counterpart of Tap.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

namespace weakgrid {

/// One writer with a participant of its own.
class RawWriter {
 public:
  struct Options {
    std::uint32_t domain = 0;
    std::vector<std::string> interfaces;
    std::string topic, type;
    std::string partition;  ///< empty = none
    bool reliable = true;
    int depth = 100;  ///< samples kept for readers that are behind
  };
  /// Throws BusError.
  explicit RawWriter(const Options& options);
  ~RawWriter();
  RawWriter(const RawWriter&) = delete;
  RawWriter& operator=(const RawWriter&) = delete;

  /// Readers matched now.
  int matched() const;
  /// `payload` with its 4-byte encapsulation header. False: not sent.
  [[nodiscard]] bool write(std::span<const std::byte> payload);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace weakgrid
