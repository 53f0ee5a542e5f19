// Listens to a whole DDS domain: every topic of every writer, also of types that this program does not know.
// Beside Bus the only other door to Fast DDS.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "services/recording/sample.hpp"
#include "services/runtime/bus.hpp"
#include "services/runtime/topic_filter.hpp"

namespace weakgrid {

/// One DDS participant with a reader for each topic and quality of service that it discovers.
class Tap {
 public:
  struct Options {
    std::uint32_t domain = 0;
    DdsSettings dds;
    Role role = Role::recorder;
    TopicFilter filter;
    std::size_t writers_max = 4096;  ///< more are left out
  };
  /// On a thread of the bus, one call at a time, before any sample of that writer.
  using SeeWriter = std::function<void(const SourceWriter&)>;
  /// On threads of the bus, several at a time. `writer` of the sample is a SourceWriter's index.
  using TakeSample = std::function<void(const RawSample&)>;

  /// Throws BusError.
  Tap(const Options& options, SeeWriter see, TakeSample take);
  /// No call is under way or comes after this.
  ~Tap();
  Tap(const Tap&) = delete;
  Tap& operator=(const Tap&) = delete;

  /// A writer of this topic is there and has been told of our reader: what it writes from now on comes here.
  /// For a participant that has a manifest this is proved by an echo; for others taken for true once matched.
  bool hears(const std::string& topic) const;
  /// Writers that cannot be recorded: beyond the limit, or a second type of a topic's name.
  std::uint64_t left_out() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace weakgrid
