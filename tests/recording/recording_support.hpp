// What the recording tests share: a scratch folder, seeded recordings, and what a reader makes of a file.
#pragma once

#include <gtest/gtest.h>
#include <stdlib.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <random>

#include "services/recording/mcap_index.hpp"
#include "services/recording/mcap_recover.hpp"

namespace weakgrid::mcap {

/// How many seeded cases a law is tried on.
inline std::uint32_t law_count(std::uint32_t otherwise) {
  const char* count = std::getenv("WEAKGRID_LAW_COUNT");
  return count != nullptr ? static_cast<std::uint32_t>(std::strtoul(count, nullptr, 10)) : otherwise;
}

class Folder {
 public:
  Folder() {
    // In memory where there is such a place: these tests sync thousands of files.
    const std::filesystem::path memory = "/dev/shm";
    const auto parent = std::filesystem::exists(memory) ? memory : std::filesystem::temp_directory_path();
    std::string name = (parent / "weakgrid_recording_XXXXXX").string();
    if (::mkdtemp(name.data()) == nullptr) std::abort();
    path_ = name;
  }
  ~Folder() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;
  std::string operator/(const char* name) const { return (path_ / name).string(); }

 private:
  std::filesystem::path path_;
};

inline Bytes bytes_of(std::string_view text) {
  const ByteView view = std::as_bytes(std::span{text});
  return {view.begin(), view.end()};
}

inline Bytes file_bytes(const std::string& path) {
  std::ifstream file{path, std::ios::binary};
  const std::string text{std::istreambuf_iterator<char>{file}, {}};
  return bytes_of(text);
}

inline void write_bytes(const std::string& path, ByteView bytes) {
  std::ofstream file{path, std::ios::binary | std::ios::trunc};
  file.write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
}

/// A message that owns its payload and names its topic, so that it can be compared across files.
struct Entry {
  std::string topic;
  std::uint32_t sequence = 0;
  std::uint64_t log_time_ns = 0;
  std::uint64_t publish_time_ns = 0;
  Bytes data;
  friend bool operator==(const Entry&, const Entry&) = default;
};

/// The content of a file, apart from its chunks.
struct Content {
  std::vector<Entry> messages;
  std::vector<std::string> order;  // "m" per message, names of metadata and attachments, as they follow
  std::map<std::string, StringMap> metadata;
  std::map<std::string, Bytes> attachments;
  friend bool operator==(const Content&, const Content&) = default;
};

template <class Source>
Content content_of(const Source& source, ScanReport& report, const ReaderOptions& options = {}) {
  Content content;
  Reader reader;
  if (!reader.open(source, options).ok()) {
    report = reader.report();
    return content;
  }
  while (const auto record = reader.next()) {
    if (const auto* message = std::get_if<Message>(&*record)) {
      const Channel& channel = reader.channels().at(message->channel_id);
      content.messages.push_back({channel.topic, message->sequence, message->log_time_ns,
                                  message->publish_time_ns,
                                  Bytes{message->data.begin(), message->data.end()}});
      content.order.emplace_back("m");
    } else if (const auto* metadata = std::get_if<Metadata>(&*record)) {
      content.metadata[metadata->name] = metadata->entries;
      content.order.push_back(metadata->name);
    } else if (const auto* attachment = std::get_if<Attachment>(&*record)) {
      content.attachments[attachment->name] = attachment->data;
      content.order.push_back(attachment->name);
    }
  }
  report = reader.report();
  return content;
}

template <class Source>
Content content_of(const Source& source) {
  ScanReport report;
  return content_of(source, report);
}

template <class Source>
std::vector<Entry> by_time(const Source& source, TimeRange range = {}, const std::string& only_topic = "") {
  std::vector<Entry> entries;
  IndexedReader reader;
  if (!reader.open(source).ok()) return entries;
  const auto& channels = reader.summary().channels;
  std::vector<ChannelId> wanted;
  for (const auto& [id, channel] : channels)
    if (channel.topic == only_topic) wanted.push_back(id);
  reader.select(range, wanted);
  while (const auto message = reader.next()) {
    const auto channel = channels.find(message->channel_id);
    entries.push_back({channel == channels.end() ? "?" : channel->second.topic, message->sequence,
                       message->log_time_ns, message->publish_time_ns,
                       Bytes{message->data.begin(), message->data.end()}});
  }
  return entries;
}

using Random = std::mt19937_64;

inline std::uint64_t below(Random& random, std::uint64_t limit) { return random() % limit; }

inline Bytes random_payload(Random& random, std::size_t size_max) {
  Bytes data(below(random, size_max + 1));
  const bool noise = below(random, 2) == 0;
  const auto constant = static_cast<std::byte>(random());
  for (std::byte& byte : data) byte = noise ? static_cast<std::byte>(random()) : constant;
  return data;
}

struct RandomRecording {
  int records = 300;
  std::size_t payload_max = 300;
  bool extras = true;  // metadata, attachments, flushes in between
};

/// Writes a recording as a recorder would and returns what is in it. The writer is left open.
inline Content write_random(Writer& writer, Random& random, const RandomRecording& how) {
  Content content;
  std::vector<std::pair<ChannelId, std::string>> channels;
  std::vector<SchemaId> schemas{0};
  std::uint64_t now_ns = 1'700'000'000'000'000'000 + below(random, 1'000'000'000);
  for (int k = 0; k < how.records; ++k) {
    const auto dice = below(random, 1000);
    const auto name = std::to_string(k);
    if (channels.empty() || dice < 20) {
      if (below(random, 2) == 0) {
        const auto text = "module m { struct T" + name + " { double x; }; };";
        schemas.push_back(writer.add_schema("m::T" + name, "omgidl", text));
      }
      const auto topic = "topic " + name;
      const auto schema = schemas[below(random, schemas.size())];
      const auto id = writer.add_channel(schema, topic, "cdr", {{"qos", "reliability: true"}, {"n", name}});
      EXPECT_NE(id, 0);
      channels.emplace_back(id, topic);
    } else if (how.extras && dice < 30) {
      content.metadata["metadata " + name] = {{"k", name}, {"empty", ""}};
      content.order.push_back("metadata " + name);
      EXPECT_TRUE(writer.write_metadata("metadata " + name, {{"k", name}, {"empty", ""}}).ok());
    } else if (how.extras && dice < 40) {
      const Bytes data = random_payload(random, 4 * how.payload_max);
      content.attachments["attachment " + name] = data;
      content.order.push_back("attachment " + name);
      EXPECT_TRUE(writer.write_attachment({now_ns, 0, "attachment " + name, "text/plain", data}).ok());
    } else if (how.extras && dice < 60) {
      EXPECT_TRUE(writer.flush().ok());
    } else {
      const auto& [id, topic] = channels[below(random, channels.size())];
      // Equal stamps, and stamps that go back, as sources on several clocks make them.
      now_ns += below(random, 3) * 50'000;
      const std::uint64_t log_ns = now_ns - below(random, 2) * below(random, 10) * 50'000;
      Entry entry{topic, static_cast<std::uint32_t>(random()), log_ns, log_ns - below(random, 1000),
                  random_payload(random, below(random, 50) == 0 ? 40 * how.payload_max : how.payload_max)};
      EXPECT_TRUE(
          writer.write_message(id, entry.sequence, entry.log_time_ns, entry.publish_time_ns, entry.data)
              .ok());
      content.messages.push_back(std::move(entry));
      content.order.emplace_back("m");
    }
  }
  return content;
}

inline WriterOptions small_chunks(Compression compression = Compression::zstd) {
  WriterOptions options;
  options.version = "test";
  options.compression = compression;
  options.chunk_bytes = 4096;
  return options;
}

inline constexpr Compression compressions[] = {Compression::none, Compression::zstd, Compression::lz4};

/// The content of `path`, written anew.
inline Content write_file(const std::string& path, std::uint64_t seed, const RandomRecording& how = {},
                          const WriterOptions& options = small_chunks()) {
  Random random{seed};
  Writer writer;
  EXPECT_TRUE(writer.open(path, options).ok());
  Content content = write_random(writer, random, how);
  EXPECT_TRUE(writer.close().ok());
  return content;
}

}  // namespace weakgrid::mcap
