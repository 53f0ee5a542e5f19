// The messages of a recording, or of several that are parts of one, as one stream in the order of the files.
#pragma once

#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "services/recording/mcap_reader.hpp"

namespace weakgrid {

/// Who wrote a recorded message. The same writer in two parts is one.
struct RecordedWriter {
  std::size_t index = 0;    ///< 0, 1, … in the order of first appearance
  std::string topic, type;  ///< type: "weakgrid::wire::Measurement"
  std::string guid;         ///< of another program's recording: made up, one for each channel

  /// The process that it belongs to, as far as the middleware knows.
  std::string participant() const { return guid.substr(0, guid.find('|')); }
};

struct RecordedMessage {
  const RecordedWriter* writer = nullptr;
  std::uint64_t sequence = 0;  ///< the writer's own count, from 1
  std::uint64_t log_time_ns = 0;
  std::uint64_t publish_time_ns = 0;
  mcap::ByteView payload;  ///< holds until the next call
};

class RecordingSource {
 public:
  /// Throws SettingsError for a file that is no recording.
  explicit RecordingSource(const std::vector<std::string>& files);

  /// Nothing at the end of the last file.
  std::optional<RecordedMessage> next();
  /// Metadata met so far, in order; whoever takes them empties the list.
  std::vector<mcap::Metadata>& metadata() { return metadata_; }
  /// What is not whole, a line for each file; empty if every file is.
  const std::string& faults() const { return faults_; }

 private:
  const RecordedWriter* writer_of(const mcap::Message& message);
  bool open_next();

  std::vector<std::string> files_;
  std::size_t next_file_ = 0;
  std::unique_ptr<mcap::Reader> reader_;
  std::map<std::string, RecordedWriter> writers_;                          // by GUID
  std::vector<std::pair<const RecordedWriter*, std::uint64_t>> channels_;  // by id; the last sequence number
  std::vector<mcap::Metadata> metadata_;
  std::string faults_;
};

}  // namespace weakgrid
