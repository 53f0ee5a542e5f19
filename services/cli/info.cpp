// weakgrid info: what is in a recording, and what is not.
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <nlohmann/json.hpp>

#include "services/cli/commands.hpp"
#include "services/cli/stage_text.hpp"
#include "services/recording/mcap_recover.hpp"
#include "services/recording/recorder.hpp"
#include "services/recording/step_timings.hpp"
#include "services/runtime/program.hpp"

namespace weakgrid {

namespace {

using nlohmann::json;

// One channel: a writer, in our recordings.
struct ChannelInfo {
  std::string topic, type, writer;
  std::uint64_t messages = 0, bytes = 0, dropped = 0;
  std::uint64_t first_ns = ~std::uint64_t{0}, last_ns = 0;
  SequenceMap sequences;
};

struct RecordingInfo {
  mcap::ScanReport report;
  std::map<mcap::ChannelId, ChannelInfo> channels;
  std::vector<mcap::StringMap> manifests;
  mcap::StringMap recording, recovery;
  json writers = json::object();               // the recorder's own words, of the last time it wrote them
  std::map<std::uint32_t, StepTimings> loops;  // by unit
  std::map<std::pair<std::uint32_t, std::string>, Health> last_words;  // by unit and service
  std::uint64_t uncompressed = 0, compressed = 0;

  bool is_recovered() const { return !recovery.empty(); }
  std::string state() const {
    if (!report.intact()) return report.ending == mcap::Ending::complete ? "damaged" : "cut";
    return is_recovered() ? "recovered" : "complete";
  }
};

void see_loop(RecordingInfo& info, const std::string& type, const mcap::Message& message) {
  if (type == "weakgrid::wire::Measurement") {
    if (const auto m = from_payload<Measurement>(message.data))
      info.loops[m->unit].see_sample(m->message.step, message.publish_time_ns, message.log_time_ns);
  } else if (type == "weakgrid::wire::Modulation") {
    if (const auto m = from_payload<Modulation>(message.data))
      info.loops[m->unit].see_answer(m->message.step, message.publish_time_ns, message.log_time_ns);
  } else if (type == "weakgrid::wire::Health") {
    if (const auto m = from_payload<Health>(message.data))
      info.last_words[{m->unit, m->message.service}] = m->message;
  }
}

void see(RecordingInfo& info, const mcap::Reader& reader, const mcap::Message& message) {
  auto [entry, is_new] = info.channels.try_emplace(message.channel_id);
  ChannelInfo& channel = entry->second;
  if (is_new) {
    const mcap::Channel& head = reader.channels().at(message.channel_id);
    channel.topic = head.topic;
    const auto writer = head.metadata.find("writer");
    if (writer != head.metadata.end()) channel.writer = writer->second;
    const auto schema = reader.schemas().find(head.schema_id);
    if (schema != reader.schemas().end()) channel.type = schema->second.name;
  }
  ++channel.messages;
  channel.bytes += message.data.size();
  channel.first_ns = std::min(channel.first_ns, message.log_time_ns);
  channel.last_ns = std::max(channel.last_ns, message.log_time_ns);
  // Far from 0, so that a late one before the first stays positive.
  see_loop(info, channel.type, message);
  const std::uint64_t last =
      channel.sequences.count() == 0 ? std::uint64_t{1} << 32 : channel.sequences.last();
  channel.sequences.see(unwrap(message.sequence, last));
}

void see(RecordingInfo& info, const mcap::Metadata& metadata) {
  if (metadata.name == recording_metadata) info.recording = metadata.entries;
  if (metadata.name == mcap::recovery_metadata) info.recovery = metadata.entries;
  if (metadata.name == manifest_metadata) info.manifests.push_back(metadata.entries);
  if (metadata.name != writers_metadata) return;
  info.writers = json::object();
  for (const auto& [writer, text] : metadata.entries) {
    json words = json::parse(text, nullptr, false);
    if (words.is_object()) info.writers[writer] = std::move(words);
  }
}

// What the recorder knows beyond the messages: numbers spent on other things than data, and its own drops.
void settle(RecordingInfo& info) {
  for (auto& [id, channel] : info.channels) {
    const auto words = info.writers.find(channel.writer);
    if (words == info.writers.end()) continue;
    if (const auto dropped = words->find("dropped"); dropped != words->end() && dropped->is_number_unsigned())
      channel.dropped = dropped->get<std::uint64_t>();
    const auto without = words->find("without_data");
    if (without == words->end() || !without->is_array()) continue;
    for (const json& number : *without) {
      if (!number.is_number_unsigned()) continue;
      const std::uint64_t sequence =
          unwrap(static_cast<std::uint32_t>(number.get<std::uint64_t>()), channel.sequences.last());
      if (sequence > channel.sequences.first() && sequence < channel.sequences.last())
        channel.sequences.see(sequence);
    }
  }
}

RecordingInfo read(const std::string& file) {
  mcap::Reader reader;
  const mcap::Status status = reader.open(file);
  if (!status.ok()) throw SettingsError(file + ": " + status.text());
  RecordingInfo info;
  std::uint64_t chunk = 0;
  while (const auto record = reader.next()) {
    if (const auto* message = std::get_if<mcap::Message>(&*record)) {
      see(info, reader, *message);
      if (!reader.in_chunk() || reader.chunk().offset == chunk) continue;
      chunk = reader.chunk().offset;
      info.uncompressed += reader.chunk().uncompressed_bytes;
      info.compressed += reader.chunk().compressed_bytes;
    } else if (const auto* metadata = std::get_if<mcap::Metadata>(&*record)) {
      see(info, *metadata);
    }
  }
  info.report = reader.report();
  settle(info);
  return info;
}

struct TopicInfo {
  std::string type;
  std::uint64_t writers = 0, messages = 0, bytes = 0, missing = 0, repeated = 0, dropped = 0;
  std::uint64_t first_ns = ~std::uint64_t{0}, last_ns = 0;
  bool has_sequences = true;  // false: another program's recording, whose numbers may mean anything

  double rate_hz() const {
    const double span_s = static_cast<double>(last_ns - first_ns) * 1e-9;
    return messages > 1 && span_s > 0.0 ? static_cast<double>(messages - 1) / span_s : 0.0;
  }
};

std::map<std::string, TopicInfo> topics_of(const RecordingInfo& info) {
  std::map<std::string, TopicInfo> topics;
  for (const auto& [id, channel] : info.channels) {
    TopicInfo& topic = topics[channel.topic];
    topic.type = channel.type;
    ++topic.writers;
    topic.messages += channel.messages;
    topic.bytes += channel.bytes;
    topic.dropped += channel.dropped;
    topic.first_ns = std::min(topic.first_ns, channel.first_ns);
    topic.last_ns = std::max(topic.last_ns, channel.last_ns);
    topic.has_sequences = topic.has_sequences && !channel.writer.empty();
    topic.missing += channel.sequences.missing();
    topic.repeated += channel.sequences.repeated();
  }
  return topics;
}

json gaps_of(const SequenceMap& sequences) {
  json gaps = json::array();
  for (const auto& [from, to] : sequences.gaps())
    gaps.push_back({static_cast<std::uint32_t>(from), static_cast<std::uint32_t>(to)});
  return gaps;
}

struct Total {
  std::uint64_t messages = 0, bytes = 0, missing = 0, dropped = 0;
  double duration_s = 0.0;
};

Total total_of(const std::map<std::string, TopicInfo>& topics) {
  Total total;
  std::uint64_t first_ns = ~std::uint64_t{0}, last_ns = 0;
  for (const auto& [name, topic] : topics) {
    total.messages += topic.messages;
    total.bytes += topic.bytes;
    total.missing += topic.has_sequences ? topic.missing : 0;
    total.dropped += topic.dropped;
    first_ns = std::min(first_ns, topic.first_ns);
    last_ns = std::max(last_ns, topic.last_ns);
  }
  if (last_ns >= first_ns) total.duration_s = static_cast<double>(last_ns - first_ns) * 1e-9;
  return total;
}

double ratio_of(const RecordingInfo& info) {
  return info.compressed == 0 ? 1.0
                              : static_cast<double>(info.uncompressed) / static_cast<double>(info.compressed);
}

using NamedDurations = std::pair<const char*, const DurationHistogram*>;
std::array<NamedDurations, 3> durations_of(const StepTimings& loop) {
  return {{{"sample to next sample", &loop.interval},
           {"sample to answer", &loop.turnaround},
           {"publication to recorder", &loop.arrival}}};
}

json to_json(const DurationHistogram& h) {
  return {{"count", h.count()},
          {"p50_us", us(h.quantile_ns(0.5))},
          {"p99_us", us(h.quantile_ns(0.99))},
          {"p999_us", us(h.quantile_ns(0.999))},
          {"max_us", us(h.max_ns())},
          {"negative", h.negative()}};
}

std::map<std::string, std::uint64_t> lateness_of(const Health& health) {
  std::map<std::string, std::uint64_t> found;
  for (const char* name : lateness_counters)
    for (const Counter& counter : health.counters)
      if (counter.name == name) found[name] = counter.value;
  return found;
}

json to_json(const RecordingInfo& info) {
  const auto topics = topics_of(info);
  const Total total = total_of(topics);
  json out{{"state", info.state()},
           {"text", info.report.text()},
           {"duration_s", total.duration_s},
           {"file_bytes", info.report.file_bytes},
           {"messages", total.messages},
           {"payload_bytes", total.bytes},
           {"missing", total.missing},
           {"dropped", total.dropped},
           {"compression_ratio", ratio_of(info)},
           {"recording", info.recording},
           {"recovery", info.recovery},
           {"manifests", info.manifests},
           {"topics", json::array()},
           {"writers", json::array()}};
  for (const auto& [name, t] : topics)
    out["topics"].push_back({{"topic", name},
                             {"type", t.type},
                             {"writers", t.writers},
                             {"messages", t.messages},
                             {"bytes", t.bytes},
                             {"rate_hz", t.rate_hz()},
                             {"missing", t.has_sequences ? json(t.missing) : json()},
                             {"repeated", t.has_sequences ? json(t.repeated) : json()},
                             {"dropped", t.dropped}});
  for (const auto& [id, c] : info.channels)
    out["writers"].push_back({{"writer", c.writer},
                              {"topic", c.topic},
                              {"first", static_cast<std::uint32_t>(c.sequences.first())},
                              {"last", static_cast<std::uint32_t>(c.sequences.last())},
                              {"messages", c.messages},
                              {"missing", c.sequences.missing()},
                              {"repeated", c.sequences.repeated()},
                              {"dropped", c.dropped},
                              {"gaps", gaps_of(c.sequences)}});
  for (const auto& [of, health] : info.last_words) {
    if (health.timings.empty()) continue;
    json& item = out["services"].emplace_back(
        json{{"unit", of.first}, {"service", of.second}, {"timings", to_json(health.timings)}});
    for (const auto& [name, value] : lateness_of(health)) item[name] = value;
  }
  for (const auto& [unit, loop] : info.loops) {
    json& item = out["loops"].emplace_back(json{{"unit", unit}});
    for (const auto& [name, histogram] : durations_of(loop)) item[name] = to_json(*histogram);
  }
  return out;
}

void print(const RecordingInfo& info) {
  const auto topics = topics_of(info);
  const Total total = total_of(topics);
  fmt::print("{}: {}\n", info.state(), info.report.text());
  if (info.is_recovered())
    for (const auto& [key, value] : info.recovery) fmt::print("  {} = {}\n", key, value);
  fmt::print("{:.3f} s, {} messages, {} bytes of payload in a file of {} bytes, compression {:.2f}\n",
             total.duration_s, total.messages, total.bytes, info.report.file_bytes, ratio_of(info));
  if (const auto build = info.recording.find("build"); build != info.recording.end())
    fmt::print("recorded by {}\n", build->second);
  fmt::print("\n{:<28}{:<34}{:>8}{:>10}{:>12}{:>11}{:>9}{:>9}\n", "topic", "type", "writers", "messages",
             "bytes", "rate Hz", "missing", "dropped");
  for (const auto& [name, t] : topics)
    fmt::print("{:<28}{:<34}{:>8}{:>10}{:>12}{:>11.1f}{:>9}{:>9}\n", name, t.type, t.writers, t.messages,
               t.bytes, t.rate_hz(), t.has_sequences ? std::to_string(t.missing) : "?", t.dropped);
  for (const auto& [unit, loop] : info.loops) {
    fmt::print("\nunit {}, µs{:>32}{:>12}{:>12}{:>12}\n", unit, "p50", "p99", "p99.9", "max");
    for (const auto& [name, h] : durations_of(loop))
      if (h->count() > 0)
        fmt::print("  {:<28}{:>12.1f}{:>12.1f}{:>12.1f}{:>12.1f}\n", name, us(h->quantile_ns(0.5)),
                   us(h->quantile_ns(0.99)), us(h->quantile_ns(0.999)), us(h->max_ns()));
  }
  for (const auto& [of, health] : info.last_words) {
    if (health.timings.empty()) continue;
    fmt::print("\nunit {}, {}", of.first, of.second);
    for (const auto& [name, value] : lateness_of(health)) fmt::print(", {} {}", name, value);
    fmt::print("\n  {}", stage_head());
    for (const StageTiming& timing : health.timings) fmt::print("  {}", stage_line(timing.stage, timing));
  }
  for (const auto& [id, c] : info.channels) {
    if (c.writer.empty() || c.sequences.missing() == 0) continue;
    fmt::print("\n{} of {}: {} missing:", c.writer, c.topic, c.sequences.missing());
    for (const auto& [from, to] : c.sequences.gaps())
      fmt::print(" {}-{}", static_cast<std::uint32_t>(from), static_cast<std::uint32_t>(to));
    fmt::print("\n");
  }
}

}  // namespace

Command add_info(CLI::App& app) {
  struct Options {
    std::string file;
    bool json = false;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand("info", "Shows what is in a recording, and what is missing.");
  command->add_option("RECORDING", options->file, "MCAP file")->required();
  command->add_flag("--json", options->json, "print JSON");
  command->footer(
      "Example: weakgrid info run.mcap\n"
      "Exit: 0 complete and without gaps, 1 something is missing, dropped or cut, 2 not a recording.");
  return [options] {
    const RecordingInfo info = read(options->file);
    if (options->json)
      fmt::print("{}\n", to_json(info).dump(2));
    else
      print(info);
    const Total total = total_of(topics_of(info));
    return info.state() == "complete" && total.missing == 0 && total.dropped == 0 ? exit_done : exit_no;
  };
}

}  // namespace weakgrid
