// Our end of the interop test: `write FOLDER` makes recordings for the official readers, `read FILE` says
// what our readers find in a recording of the official writer, as lines that interop.mjs compares.
#include <unistd.h>

#include <cstdio>
#include <filesystem>

#include "services/recording/mcap_index.hpp"
#include "services/recording/mcap_recover.hpp"

namespace {

using namespace weakgrid::mcap;

constexpr std::string_view idl = R"(// Interop test.
module weakgrid_test {
  enum State { IDLE, RUNNING };
  @final
  struct Sample {
    @key unsigned long unit;
    State state;
    unsigned long long step;
    double alpha;  // αβ
    string text;
    sequence<double> tail;
  };
};
)";

/// Plain little-endian CDR with its encapsulation header, as Fast DDS hands it to a recorder. interop.mjs
/// knows the same values by the same formulas.
Bytes sample(std::uint32_t k) {
  Bytes out{std::byte{0}, std::byte{1}, std::byte{0}, std::byte{0}};
  const auto align = [&out](std::size_t to) {
    while ((out.size() - 4) % to != 0) out.push_back(std::byte{0xcd});  // as a stack byte would stand there
  };
  const auto put_double = [&](double value) {
    align(8);
    std::uint64_t bits = 0;
    std::memcpy(&bits, &value, sizeof bits);
    put(out, bits);
  };
  put(out, k % 3);
  put(out, k % 2);
  put(out, std::uint64_t{k} << 33);
  put_double(0.1 * k);
  const std::string text = "Schritt " + std::to_string(k) + " ä";
  put(out, static_cast<std::uint32_t>(text.size() + 1));
  put_bytes(out, std::as_bytes(std::span{text}));
  out.push_back(std::byte{0});
  align(4);
  put(out, k % 4);
  for (std::uint32_t n = 0; n < k % 4; ++n) put_double(1.0 / (n + 1));
  return out;
}

bool write_recording(const std::string& path, Compression compression, std::uint32_t messages) {
  Writer writer;
  WriterOptions options;
  options.version = "interop";
  options.compression = compression;
  options.chunk_bytes = 16 << 10;
  bool good = writer.open(path, options).ok();
  good &= writer.write_metadata("run", {{"settings", "schwaches Netz ä"}, {"empty", ""}}).ok();
  good &= writer.write_attachment({1, 0, "settings.toml", "text/plain", Bytes(1000, std::byte{'x'})}).ok();
  const SchemaId schema = writer.add_schema("weakgrid_test::Sample", "omgidl", idl);
  const ChannelId channels[] = {writer.add_channel(schema, "weakgrid/a", "cdr", {{"qos", "keyed: true"}}),
                                writer.add_channel(schema, "weakgrid/b", "cdr", {}),
                                writer.add_channel(schema, "never", "cdr", {})};
  for (std::uint32_t k = 0; k < messages; ++k) {
    // Pairs with equal stamps; every tenth goes back in time.
    const std::uint64_t grid = k / 2 - (k % 10 == 0 && k > 9 ? 3 : 0);
    const std::uint64_t time_ns = 1'700'000'000'000'000'000 + grid * 50'000;
    good &= writer.write_message(channels[k % 5 == 0], k, time_ns, time_ns - 1000, sample(k)).ok();
  }
  good &= writer.write_metadata("end", {{"messages", std::to_string(messages)}}).ok();
  return good && writer.close().ok();
}

bool write_recordings(const std::string& folder) {
  bool good = write_recording(folder + "/ours_none.mcap", Compression::none, 2000) &&
              write_recording(folder + "/ours_zstd.mcap", Compression::zstd, 2000) &&
              write_recording(folder + "/ours_lz4.mcap", Compression::lz4, 2000) &&
              write_recording(folder + "/ours_empty.mcap", Compression::zstd, 0) &&
              write_recording(folder + "/broken.mcap", Compression::zstd, 2000);
  const auto half = static_cast<off_t>(std::filesystem::file_size(folder + "/broken.mcap") / 2);
  good &= ::truncate((folder + "/broken.mcap").c_str(), half) == 0;
  Recovery recovery;
  RecoverOptions options;
  options.writer.version = "interop";
  good &= recover(folder + "/broken.mcap", folder + "/ours_recovered.mcap", options, recovery).ok();
  std::printf("%s\n", recovery.text().c_str());
  return good;
}

void print_message(const char* how, const std::string& topic, const Message& message) {
  std::printf("%s %s %u %llu %llu ", how, topic.c_str(), message.sequence,
              static_cast<unsigned long long>(message.log_time_ns),
              static_cast<unsigned long long>(message.publish_time_ns));
  for (const std::byte byte : message.data) std::printf("%02x", std::to_integer<unsigned>(byte));
  std::printf("\n");
}

bool print_recording(const std::string& path) {
  Reader reader;
  if (const Status status = reader.open(path); !status.ok()) {
    std::fprintf(stderr, "%s: %s\n", path.c_str(), status.text().c_str());
    return false;
  }
  while (const auto record = reader.next()) {
    if (const auto* message = std::get_if<Message>(&*record)) {
      print_message("file", reader.channels().at(message->channel_id).topic, *message);
    } else if (const auto* schema = std::get_if<Schema>(&*record)) {
      std::printf("schema %s %s %zu\n", schema->name.c_str(), schema->encoding.c_str(), schema->data.size());
    } else if (const auto* channel = std::get_if<Channel>(&*record)) {
      std::printf("channel %s %s %zu\n", channel->topic.c_str(), channel->message_encoding.c_str(),
                  channel->metadata.size());
    } else if (const auto* metadata = std::get_if<Metadata>(&*record)) {
      std::printf("metadata %s", metadata->name.c_str());
      for (const auto& [key, value] : metadata->entries) std::printf(" %s=%s", key.c_str(), value.c_str());
      std::printf("\n");
    } else if (const auto* attachment = std::get_if<Attachment>(&*record)) {
      std::printf("attachment %s %s %zu\n", attachment->name.c_str(), attachment->media_type.c_str(),
                  attachment->data.size());
    }
  }
  std::printf("%s\n", reader.report().intact() ? "intact" : reader.report().text().c_str());
  IndexedReader indexed;
  if (!indexed.open(path).ok()) return false;
  std::printf("%s\n", indexed.summary().rebuilt ? "rebuilt" : "indexed");
  while (const auto message = indexed.next())
    print_message("time", indexed.summary().channels.at(message->channel_id).topic, *message);
  return true;
}

}  // namespace

int main(int argc, char** argv) {
  const std::string verb = argc == 3 ? argv[1] : "";
  if (verb == "write") return write_recordings(argv[2]) ? 0 : 1;
  if (verb == "read") return print_recording(argv[2]) ? 0 : 1;
  std::fprintf(stderr, "usage: mcap_peer write FOLDER | read FILE\n");
  return 2;
}
