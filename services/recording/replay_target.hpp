// Where a replay goes: a DDS writer for each recorded one, all of one participant.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "services/recording/sample.hpp"
#include "services/runtime/raw_writer.hpp"

namespace weakgrid {

class ReplayTarget {
 public:
  /// Asked between waits: shall it go on waiting?
  using GoesOn = std::function<bool()>;

  /// Throws BusError, as make_writers().
  ReplayTarget(std::uint32_t domain, const DdsSettings& dds);

  /// Throws if somebody writes what these do, as far as discovery has come.
  void refuse_company(const std::vector<SourceWriter>& replayed) const;
  /// In the order of their indices; one with nothing known of its type's key is warned of.
  void make_writers(const std::vector<SourceWriter>& replayed);
  /// Pairs of writer and reader.
  int matched() const;

  /// From one thread. Waits for nobody; false: not sent.
  [[nodiscard]] bool write(const RawSample& sample);
  /// Where nobody keeps a pace: waits for the readers of reliable topics, should they be far behind.
  void keep_window(const GoesOn& goes_on);
  /// False: some reader has not taken everything, and `goes_on` said no.
  bool wait_until_taken(const GoesOn& goes_on);

 private:
  const std::uint32_t domain_;
  RawBus bus_;
  std::vector<RawWriter> writers_;
  std::vector<bool> reliable_;
  std::size_t ahead_messages_ = 0, ahead_bytes_ = 0;  // on reliable topics, since readers were waited for
};

}  // namespace weakgrid
