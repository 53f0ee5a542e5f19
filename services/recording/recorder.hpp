// Records samples to MCAP: many threads hand in, one writes. Knows no DDS.
#pragma once

#include <atomic>
#include <chrono>
#include <deque>
#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "services/recording/disk_sync.hpp"
#include "services/recording/mcap_writer.hpp"
#include "services/recording/ring.hpp"
#include "services/recording/sequence_map.hpp"
#include "services/runtime/payload.hpp"
#include "services/runtime/pulse.hpp"

namespace weakgrid {

/// Names of the metadata records that a recording carries besides eProsima's "version".
inline constexpr const char* recording_metadata = "weakgrid_recording";  ///< at the start: build, part
inline constexpr const char* manifest_metadata = "weakgrid_manifest";    ///< one for each service heard
/// Writer → JSON: topic, first, last, count, missing, repeated, dropped, gaps, without_data. Cumulative over
/// all parts; about every 10 s, the last one counts.
inline constexpr const char* writers_metadata = "weakgrid_writers";
inline constexpr const char* settings_attachment = "settings.toml";

struct RecorderOptions {
  std::string path;  ///< of the first part; rotation makes NAME_0002.mcap and so on of NAME.mcap
  mcap::Compression compression = mcap::Compression::zstd;
  std::size_t ring_bytes = 64 << 20;  ///< between the threads that receive and the one that writes
  std::size_t writers_max = 4096;
  std::uint64_t max_bytes = 0;              ///< of a part, 0 = no limit; exceeded by the end of the file
  double max_seconds = 0.0;                 ///< likewise
  std::uint64_t min_free_bytes = 64 << 20;  ///< on the disk, below it recording stops
  double before_s = 0.0;  ///< above 0: wait for a trip, then write on, from that long before it
  std::size_t before_bytes = std::size_t{256} << 20;  ///< what that may take in memory
  std::string version, build, settings;
};

class Recorder {
 public:
  struct Counters {
    std::uint64_t messages = 0;    ///< written
    std::uint64_t bytes = 0;       ///< of their payloads
    std::uint64_t dropped = 0;     ///< no room in the ring, or refused by the file
    std::uint64_t missing = 0;     ///< never came, by the writers' sequence numbers
    std::uint64_t after_stop = 0;  ///< came when recording had stopped
    std::uint64_t writers = 0;
    std::uint64_t parts = 0;
    std::uint64_t file_bytes = 0;  ///< of the part under way
  };

  /// Creates the file; throws std::runtime_error where that cannot be.
  explicit Recorder(const RecorderOptions& options);
  /// Writes what has been put, closes.
  ~Recorder();
  Recorder(const Recorder&) = delete;
  Recorder& operator=(const Recorder&) = delete;

  /// Before the first sample of that writer; indices count from 0.
  void add(const SourceWriter& writer);
  /// From any thread; waits for nobody.
  void put(const RawSample& sample) noexcept { ring_.put(sample); }

  /// Ends recording: all that was put is written before. Then stopped() tells how it went.
  void close();
  Counters counters() const;
  bool waits_for_trip() const { return !triggered_.load(); }
  /// Why nothing is recorded any more, though close() has not been called; empty while all is well.
  std::string stopped() const;
  /// The thread that writes has not moved since this was asked last: a disk that does not answer.
  bool stands() { return pulse_.stands(); }

 private:
  using Clock = std::chrono::steady_clock;
  struct Writer {
    SourceWriter source;
    bool is_state = false;  // its last word stands: repeated where a part begins
    mcap::ChannelId channel = 0;
    SequenceMap sequences{};
    std::vector<std::uint64_t> without_data{};
    std::uint64_t refused = 0;
    std::optional<RawSample> standing{};
    std::vector<std::byte> standing_payload{};
  };

  void run();
  bool drain();
  void keep(const RawSample& sample);
  bool is_trip(const RawSample& sample);
  void write(const RawSample& sample);
  void note(Writer& writer, const RawSample& sample);
  void keep_standing(const RawSample& sample);
  void write_standing(std::int64_t now_ns);
  mcap::Status write_message(Writer& writer, const RawSample& sample);
  mcap::ChannelId channel_of(Writer& writer);
  mcap::SchemaId schema_of(const std::string& type);
  void hear_manifest(const RawSample& sample);
  struct HeardManifest {
    std::string writer;
    OfUnit<Manifest> manifest;
  };
  void write_manifest(const HeardManifest& heard);
  void take_new_writers();
  Writer& writer_at(std::uint32_t index);
  void tick(Clock::time_point now);
  void open_part();
  void close_part();
  void write_writers();
  bool rotates(Clock::time_point now, std::size_t more) const;
  void check(const mcap::Status& status);
  void stop(const std::string& reason);
  std::uint64_t dropped() const;

  const RecorderOptions options_;
  SampleRing ring_;
  std::unique_ptr<SampleRing> before_;

  mutable std::mutex mutex_;
  std::deque<SourceWriter> new_writers_;
  std::string stopped_;
  std::atomic<bool> closing_{false}, triggered_;
  Pulse pulse_{Pulse::at_work};
  std::atomic<std::uint64_t> messages_{0}, bytes_{0}, missing_{0}, refused_{0}, after_stop_{0}, parts_{0};
  std::atomic<std::uint64_t> writer_count_{0}, file_bytes_{0};

  // Of the writing thread alone.
  DiskSync disk_;
  mcap::Writer file_;
  bool is_recording_ = false;
  std::deque<Writer> writers_;
  std::map<std::string, mcap::SchemaId> schemas_;
  std::map<std::uint64_t, HeardManifest> manifests_;  // by instance
  Clock::time_point part_begun_, synced_, writers_written_;
  std::thread thread_;
};

}  // namespace weakgrid
