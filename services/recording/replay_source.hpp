// What is replayed: selected messages of one or more recordings in the order of time, and who wrote them.
#pragma once

#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "services/recording/mcap_index.hpp"
#include "services/recording/sample.hpp"
#include "services/runtime/settings.hpp"
#include "services/runtime/topic_filter.hpp"

namespace weakgrid {

struct ReplaySelection {
  TopicFilter filter;
  std::vector<std::string> remaps;     ///< "FROM=TO", recorded topic and the one to write; patterns see FROM
  double start_s = 0.0;                ///< from the first message of the recordings
  std::optional<double> until_s = {};  ///< likewise; what is at this time is left out
  std::uint64_t passes = 1;            ///< 0 = for ever
};

/// The domain for a replay where none is given: never the one that was recorded.
constexpr std::uint32_t replay_domain(std::uint32_t recorded) {
  return recorded + 100 <= 229 ? recorded + 100 : recorded - 100;
}

/// A writer of a topic that the replay writes as well; nullptr: nobody. Health and manifest of programs that
/// write nothing else do not count: whoever looks on announces himself there under his own name.
const LiveWriter* writer_in_the_way(const std::vector<LiveWriter>& live,
                                    const std::vector<SourceWriter>& replayed);

class ReplaySource {
 public:
  /// Throws SettingsError for what cannot be read or selects nothing.
  ReplaySource(const std::vector<std::string>& files, const ReplaySelection& selection);
  ~ReplaySource();

  /// One for each recorded writer with a selected topic, under the name to write; parts of one recording
  /// share theirs.
  const std::vector<SourceWriter>& writers() const { return writers_; }
  /// Those that the first recording that has any was made with.
  const std::optional<Settings>& settings() const { return settings_; }
  /// What a person should know: channels left out and why.
  const std::vector<std::string>& warnings() const { return warnings_; }

  /// The next by log time; of equal times, in the order of the files and in them. `reception_ns` counts from
  /// the first message and goes on over passes. Holds until the next call. Throws SettingsError for a file
  /// that cannot be read on.
  std::optional<RawSample> next();
  /// Chunks that were damaged and are not replayed.
  std::uint64_t chunks_skipped() const;

 private:
  struct Input;

  void add_channels(Input& input, const ReplaySelection& selection);
  void add_channel(Input& input, const mcap::Channel& channel, const std::string& topic);
  void take_settings(Input& input);
  void begin_pass();
  void advance(Input& input);

  std::vector<std::unique_ptr<Input>> inputs_;
  std::vector<SourceWriter> writers_;
  std::map<std::string, std::uint32_t> known_writers_;
  std::optional<Settings> settings_;
  std::vector<std::string> warnings_;
  mcap::TimeRange range_;
  std::uint64_t first_ns_ = 0;
  std::uint64_t passes_left_;
  bool for_ever_;
  bool pass_begins_ = true;
  std::int64_t offset_ns_ = 0, last_ns_ = 0;
  Input* handed_out_ = nullptr;
};

}  // namespace weakgrid
