// Fencing: of several writers of one topic one is listened to.
#pragma once

#include <chrono>
#include <cstdint>

namespace weakgrid {

/// Who wrote a sample: a hash of the writer's GUID, never 0.
using WriterId = std::uint64_t;

/// Listens to one writer until that is gone, has been silent for 1.5 s, or another comes with a higher epoch,
/// so that two are never mixed in, and nobody who was replaced comes back.
class OneWriter {
 public:
  enum class Verdict : std::uint8_t { known, changed, refused };

  static constexpr std::chrono::milliseconds silence_max{1500};

  /// Reader: whatever says is_alive(writer), a Reader<Message> or what stands for it where there is no bus.
  template <class Reader>
  Verdict admit(WriterId writer, const Reader& reader,
                std::chrono::steady_clock::time_point now = std::chrono::steady_clock::now(),
                std::uint64_t epoch = 0) noexcept {
    if (writer != writer_ && writer_ != 0 && epoch <= epoch_ && reader.is_alive(writer_) &&
        now - heard_ < silence_max)
      return Verdict::refused;
    const Verdict verdict = writer == writer_ || writer_ == 0 ? Verdict::known : Verdict::changed;
    writer_ = writer;
    epoch_ = epoch;
    heard_ = now;
    return verdict;
  }

 private:
  WriterId writer_ = 0;
  std::uint64_t epoch_ = 0;
  std::chrono::steady_clock::time_point heard_{};
};

}  // namespace weakgrid
