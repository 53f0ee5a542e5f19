// Recordings as CSV tables, one for each topic and type: streamed, so of any size.
#pragma once

#include <deque>
#include <functional>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "services/recording/mcap_file.hpp"
#include "services/recording/mcap_reader.hpp"
#include "services/runtime/topic_filter.hpp"

namespace weakgrid {

/// Columns: log_time_ns, publish_time_ns, writer, sequence, then the fields of weakgrid.idl as WireFields
/// name and write them; of a type that is not ours `payload`, in hexadecimal. Quoted where RFC 4180 asks for
/// it; lines end with LF. Rows stand in the order of the recordings.
class CsvExport {
 public:
  struct Table {
    std::string path, topic, type;
    bool is_ours = false;
    std::uint64_t rows = 0;
    std::uint64_t undecodable = 0;  ///< of a type of ours by name, not by their bytes: left out
  };
  /// How far a recording has been read.
  using Progress = std::function<void(std::uint64_t offset, std::uint64_t file_bytes)>;

  /// Makes the folder where it is missing; throws std::runtime_error, as everything here.
  CsvExport(std::string folder, TopicFilter filter);
  /// Unless finish() went well, removes what was made: half a table looks like a whole one.
  ~CsvExport();
  CsvExport(const CsvExport&) = delete;
  CsvExport& operator=(const CsvExport&) = delete;

  /// Appends all that a reader, just opened, yields. Throws if a table to be made is there already. The
  /// report says what was not yielded.
  mcap::ScanReport add(mcap::Reader& reader, const Progress& progress = {});
  void finish();

  std::vector<Table> tables() const;
  /// A recording carries another weakgrid.idl than this program's: then fields may be shifted.
  bool met_other_idl() const { return met_other_idl_; }

 private:
  struct Sink : Table {
    mcap::OutputFile file;
    std::string pending;
  };
  struct Source {
    Sink* sink = nullptr;  // none: not asked for
    std::string writer;
  };

  Source source_of(const mcap::Reader& reader, mcap::ChannelId id);
  Sink& sink_of(const std::string& topic, const std::string& type, bool is_ours);
  void write(Sink& sink, const std::string& writer, const mcap::Message& message);
  void flush(Sink& sink);

  const std::string folder_;
  const TopicFilter filter_;
  bool made_folder_ = false, finished_ = false, met_other_idl_ = false;
  std::deque<Sink> sinks_;
  std::map<std::pair<std::string, std::string>, Sink*> by_topic_and_type_;
  std::set<std::string> names_;
};

}  // namespace weakgrid
