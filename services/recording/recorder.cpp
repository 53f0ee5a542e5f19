// Recorder: see the header.
#include "services/recording/recorder.hpp"

#include <fmt/format.h>
#include <pthread.h>
#include <sys/statvfs.h>

#include <cstring>
#include <filesystem>
#include <limits>
#include <nlohmann/json.hpp>
#include <stdexcept>

#include "services/recording/idl_text.hpp"

namespace weakgrid {

namespace {

using namespace std::chrono_literals;

constexpr auto poll_every = 5ms;
constexpr auto sync_every = 1s;
constexpr auto writers_every = 10s;
constexpr int samples_between_ticks = 1024;
constexpr std::size_t manifests_max = 1024;
constexpr std::size_t without_data_max = 64;

std::string path_of(const std::string& path, std::uint64_t part) {
  if (part == 1) return path;
  std::filesystem::path p(path);
  return p.replace_filename(fmt::format("{}_{:04}{}", p.stem().string(), part, p.extension().string()));
}

// Plenty where nobody knows.
std::uint64_t free_bytes(const std::string& path) {
  struct statvfs disk {};
  const std::string folder = std::filesystem::absolute(path).parent_path();
  return statvfs(folder.c_str(), &disk) == 0 ? std::uint64_t{disk.f_bavail} * disk.f_frsize
                                             : std::numeric_limits<std::uint64_t>::max();
}

bool is_ours(const std::string& type) {
  constexpr std::string_view scope = "weakgrid::wire::";
  return type.rfind(scope, 0) == 0 &&
         idl_text().find(fmt::format("struct {} {{", type.substr(scope.size()))) != std::string_view::npos;
}

// The keys that eProsima's replayer insists on.
std::string qos_yaml(const SourceWriter& w) {
  return fmt::format("reliability: {}\ndurability: {}\nownership: {}\nkeyed: {}\n", w.reliable,
                     w.transient_local, w.exclusive, w.keyed);
}

std::string partitions_text(const SourceWriter& w) {
  std::string text;
  for (const std::string& partition : w.partitions) text += (text.empty() ? "" : "|") + partition;
  return text.empty() ? text : w.guid + ":" + text;
}

}  // namespace

Recorder::Recorder(const RecorderOptions& options)
    : options_(options),
      ring_(options.ring_bytes, options.writers_max),
      before_(options.before_s > 0.0 ? std::make_unique<SampleRing>(options.before_bytes, options.writers_max)
                                     : nullptr),
      triggered_(before_ == nullptr) {
  is_recording_ = true;
  open_part();
  if (!is_recording_) throw std::runtime_error(stopped_);
  thread_ = std::thread([this] { run(); });
}

Recorder::~Recorder() { close(); }

void Recorder::add(const SourceWriter& writer) {
  const std::lock_guard lock(mutex_);
  new_writers_.push_back(writer);
  writer_count_.fetch_add(1, std::memory_order_relaxed);
}

void Recorder::close() {
  closing_ = true;
  if (thread_.joinable()) thread_.join();
}

std::string Recorder::stopped() const {
  const std::lock_guard lock(mutex_);
  return stopped_;
}

std::uint64_t Recorder::dropped() const {
  std::uint64_t sum = refused_.load(std::memory_order_relaxed);
  const auto count = static_cast<std::uint32_t>(writer_count_.load(std::memory_order_relaxed));
  for (std::uint32_t writer = 0; writer < count; ++writer) sum += ring_.drops(writer);
  return sum;
}

Recorder::Counters Recorder::counters() const {
  return {.messages = messages_,
          .bytes = bytes_,
          .dropped = dropped(),
          .missing = missing_,
          .after_stop = after_stop_,
          .writers = writer_count_,
          .parts = parts_,
          .file_bytes = file_bytes_};
}

void Recorder::run() {
  pthread_setname_np(pthread_self(), "writer");
  while (!closing_) {
    pulse_.beat();
    const bool more = drain();
    tick(Clock::now());
    if (!more) std::this_thread::sleep_for(poll_every);
  }
  while (drain()) {
  }
  if (is_recording_) close_part();
  is_recording_ = false;
}

// True: there may be more.
bool Recorder::drain() {
  for (int n = 0; n < samples_between_ticks; ++n) {
    if (const auto oldest = before_ && triggered_ ? before_->front() : std::nullopt) {
      write_standing(oldest->reception_ns);
      while (const auto kept = before_->front()) {
        write(*kept);
        before_->drop_front();
      }
    }
    const auto sample = ring_.front();
    if (!sample) return false;
    if (triggered_)
      write(*sample);
    else
      keep(*sample);
    ring_.drop_front();
  }
  return true;
}

void Recorder::keep(const RawSample& sample) {
  hear_manifest(sample);
  const auto oldest_ns = sample.reception_ns - static_cast<std::int64_t>(options_.before_s * 1e9);
  const auto forget_oldest = [this](const RawSample& oldest) {
    keep_standing(oldest);
    before_->drop_front();
  };
  for (auto kept = before_->front(); kept && kept->reception_ns < oldest_ns; kept = before_->front())
    forget_oldest(*kept);
  while (!before_->put(sample) && before_->front()) forget_oldest(*before_->front());
  if (is_trip(sample)) triggered_ = true;
}

bool Recorder::is_trip(const RawSample& sample) {
  if (!sample.has_data || writer_at(sample.writer).source.type != "weakgrid::wire::Measurement") return false;
  const auto measurement = from_payload<Measurement>(sample.payload);
  return measurement && measurement->message.state == UnitState::tripped;
}

Recorder::Writer& Recorder::writer_at(std::uint32_t index) {
  if (index >= writers_.size()) take_new_writers();
  return writers_.at(index);
}

void Recorder::take_new_writers() {
  const std::lock_guard lock(mutex_);
  for (SourceWriter& source : new_writers_) {
    const bool is_state = is_state_type(source.type).value_or(source.transient_local);
    writers_.push_back({.source = std::move(source), .is_state = is_state});
  }
  new_writers_.clear();
}

void Recorder::write(const RawSample& sample) {
  if (!is_recording_) {
    after_stop_.fetch_add(1, std::memory_order_relaxed);
    return;
  }
  if (rotates(Clock::now(), sample.payload.size())) {
    close_part();
    if (is_recording_) open_part();
    if (is_recording_) write_standing(sample.reception_ns);
    if (!is_recording_) {
      after_stop_.fetch_add(1, std::memory_order_relaxed);
      return;
    }
  }
  hear_manifest(sample);
  Writer& writer = writer_at(sample.writer);
  note(writer, sample);
  if (!sample.has_data) return;
  const mcap::Status status = write_message(writer, sample);
  if (status.fault == mcap::Fault::refused) {
    ++writer.refused;
    refused_.fetch_add(1, std::memory_order_relaxed);
    return;
  }
  check(status);
  messages_.fetch_add(1, std::memory_order_relaxed);
  bytes_.fetch_add(sample.payload.size(), std::memory_order_relaxed);
  keep_standing(sample);
}

mcap::Status Recorder::write_message(Writer& writer, const RawSample& sample) {
  const mcap::ChannelId channel = channel_of(writer);
  if (channel == 0) return {mcap::Fault::refused, 0, "no channel is left"};
  return file_.write_message(channel, static_cast<std::uint32_t>(sample.sequence),
                             static_cast<std::uint64_t>(sample.reception_ns),
                             static_cast<std::uint64_t>(sample.source_ns), sample.payload);
}

void Recorder::keep_standing(const RawSample& sample) {
  Writer& writer = writer_at(sample.writer);
  if (!writer.is_state || !sample.has_data) return;
  writer.standing_payload.assign(sample.payload.begin(), sample.payload.end());
  writer.standing = sample;
}

// Each part stands for itself: a late joiner would be told the same, and that is when it hears it.
void Recorder::write_standing(std::int64_t now_ns) {
  for (Writer& writer : writers_) {
    if (!writer.standing) continue;
    RawSample sample = *writer.standing;
    sample.payload = writer.standing_payload;
    sample.reception_ns = now_ns;
    if (writer.sequences.count() == 0 || sample.sequence > writer.sequences.last())
      writer.sequences.see(sample.sequence);
    check(write_message(writer, sample));
  }
}

void Recorder::note(Writer& writer, const RawSample& sample) {
  const std::uint64_t before = writer.sequences.missing();
  writer.sequences.see(sample.sequence);
  missing_.fetch_add(writer.sequences.missing() - before, std::memory_order_relaxed);
  if (!sample.has_data && writer.without_data.size() < without_data_max)
    writer.without_data.push_back(sample.sequence);
}

// A channel for each writer: its sequence numbers then show in the file itself whether anything is missing.
mcap::ChannelId Recorder::channel_of(Writer& writer) {
  if (writer.channel == 0)
    writer.channel = file_.add_channel(schema_of(writer.source.type), writer.source.topic, "cdr",
                                       {{"qos", qos_yaml(writer.source)},
                                        {"partitions", partitions_text(writer.source)},
                                        {"ros2-types", "false"},
                                        {"qos_full", writer.source.qos_full},
                                        {"writer", writer.source.guid}});
  return writer.channel;
}

mcap::SchemaId Recorder::schema_of(const std::string& type) {
  const auto known = schemas_.find(type);
  if (known != schemas_.end()) return known->second;
  // The specification wants an empty encoding where there is no text.
  const mcap::SchemaId id =
      is_ours(type) ? file_.add_schema(type, "omgidl", idl_text()) : file_.add_schema(type, "", "");
  return schemas_[type] = id;
}

void Recorder::hear_manifest(const RawSample& sample) {
  const SourceWriter& source = writer_at(sample.writer).source;
  if (!sample.has_data || source.type != "weakgrid::wire::Manifest") return;
  const auto manifest = from_payload<Manifest>(sample.payload);
  if (!manifest || manifests_.size() >= manifests_max) return;
  const auto [heard, is_new] =
      manifests_.try_emplace(manifest->message.instance, HeardManifest{source.guid, *manifest});
  if (is_new && is_recording_) write_manifest(heard->second);
}

void Recorder::write_manifest(const HeardManifest& heard) {
  const Manifest& m = heard.manifest.message;
  nlohmann::json constants = nlohmann::json::array();
  for (const Constant& constant : m.constants) constants.push_back({constant.name, constant.value});
  check(file_.write_metadata(manifest_metadata, {{"unit", std::to_string(heard.manifest.unit)},
                                                 {"writer", heard.writer},
                                                 {"service", m.service},
                                                 {"instance", fmt::format("{:016x}", m.instance)},
                                                 {"build", m.build},
                                                 {"settings", m.settings},
                                                 {"constants", constants.dump()},
                                                 {"digest", m.digest}}));
}

void Recorder::open_part() {
  const std::uint64_t part = parts_ + 1;
  const std::string path = path_of(options_.path, part);
  mcap::WriterOptions options;
  options.version = options_.version;
  options.compression = options_.compression;
  if (const mcap::Status status = file_.open(path, options); !status.ok()) {
    stop(fmt::format("{}: {}", path, status.text()));
    return;
  }
  parts_ = part;
  part_begun_ = synced_ = writers_written_ = Clock::now();
  const auto now_ns = static_cast<std::uint64_t>(std::chrono::duration_cast<std::chrono::nanoseconds>(
                                                     std::chrono::system_clock::now().time_since_epoch())
                                                     .count());
  check(file_.write_metadata("version", {{"release", options_.version}, {"commit", ""}}));
  check(file_.write_metadata(
      recording_metadata,
      {{"build", options_.build}, {"part", std::to_string(part)}, {"begun_ns", std::to_string(now_ns)}}));
  const auto settings = std::as_bytes(std::span{options_.settings});
  check(file_.write_attachment({.log_time_ns = now_ns,
                                .create_time_ns = now_ns,
                                .name = settings_attachment,
                                .media_type = "application/toml",
                                .data = {settings.begin(), settings.end()}}));
  for (const auto& [instance, manifest] : manifests_) write_manifest(manifest);
}

void Recorder::close_part() {
  write_writers();
  if (!file_.is_open()) return;
  const mcap::Status status = file_.close();
  if (!status.ok()) stop(fmt::format("{}: {}", path_of(options_.path, parts_), status.text()));
}

void Recorder::write_writers() {
  take_new_writers();
  mcap::StringMap entries;
  for (const Writer& writer : writers_) {
    const SequenceMap& s = writer.sequences;
    entries[writer.source.guid] = nlohmann::json{
        {"topic", writer.source.topic},
        {"type", writer.source.type},
        {"first", s.first()},
        {"last", s.last()},
        {"count", s.count()},
        {"missing", s.missing()},
        {"repeated", s.repeated()},
        {"dropped", ring_.drops(writer.source.index) + writer.refused},
        {"gaps", s.gaps()},
        {"without_data",
         writer.without_data}}.dump();
  }
  check(file_.write_metadata(writers_metadata, entries));
}

bool Recorder::rotates(Clock::time_point now, std::size_t more) const {
  return (options_.max_bytes != 0 && file_.file_bytes() + more > options_.max_bytes) ||
         (options_.max_seconds > 0.0 &&
          std::chrono::duration<double>(now - part_begun_).count() >= options_.max_seconds);
}

void Recorder::tick(Clock::time_point now) {
  if (!is_recording_) return;
  check(file_.flush_if_older(now.time_since_epoch().count()));
  if (!is_recording_ || now - synced_ < sync_every) return;
  synced_ = now;
  const std::string path = path_of(options_.path, parts_);
  disk_.request(path);
  if (const int error = disk_.take_error(); error != 0)
    return stop(fmt::format("{}: cannot be written to the disk: {}", path, std::strerror(error)));
  file_bytes_ = file_.file_bytes();
  if (now - writers_written_ >= writers_every) {
    writers_written_ = now;
    write_writers();
  }
  if (const std::uint64_t left = free_bytes(options_.path); left < options_.min_free_bytes && is_recording_) {
    close_part();
    stop(fmt::format("{} bytes are left on the disk, {} are to stay free", left, options_.min_free_bytes));
  }
}

void Recorder::check(const mcap::Status& status) {
  if (status.ok() || !is_recording_) return;
  if (status.fault == mcap::Fault::refused) {
    refused_.fetch_add(1, std::memory_order_relaxed);
    return;
  }
  stop(fmt::format("{}: {}", path_of(options_.path, parts_), status.text()));
}

void Recorder::stop(const std::string& reason) {
  is_recording_ = false;
  // The summary is tried: after a full disk there may be room for less than a chunk.
  if (file_.is_open()) (void)file_.close();
  const std::uint64_t lost = file_.counters().messages_lost;
  messages_.fetch_sub(lost, std::memory_order_relaxed);
  refused_.fetch_add(lost, std::memory_order_relaxed);
  const std::lock_guard lock(mutex_);
  if (stopped_.empty()) stopped_ = reason;
}

}  // namespace weakgrid
