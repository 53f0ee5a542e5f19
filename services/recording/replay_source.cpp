// Replay source: see the header.
#include "services/recording/replay_source.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <set>

#include "services/recording/recorder.hpp"
#include "services/runtime/announcer.hpp"
#include "services/runtime/payload.hpp"

namespace weakgrid {

namespace {

// Times beyond this from the first message are nonsense; so sums over passes fit.
constexpr std::uint64_t span_ns_max = 100'000'000'000'000'000;  // three years
constexpr std::int64_t passes_ns_max = 80 * static_cast<std::int64_t>(span_ns_max);
// Between the last message of a pass and the first of the next: a single message, too, keeps a pace.
constexpr std::int64_t between_passes_ns = 1'000'000;

std::map<std::string, std::string> renamed(const std::vector<std::string>& remaps) {
  std::map<std::string, std::string> to;
  for (const std::string& remap : remaps) {
    const std::size_t sign = remap.find('=');
    if (sign == std::string::npos || sign == 0 || sign + 1 == remap.size())
      throw SettingsError(
          fmt::format("--remap {}: wanted is FROM=TO, a recorded topic and the one to write", remap));
    if (!to.emplace(remap.substr(0, sign), remap.substr(sign + 1)).second)
      throw SettingsError(fmt::format("--remap {}: {} is remapped twice", remap, remap.substr(0, sign)));
  }
  return to;
}

std::string value_of(const mcap::StringMap& map, const std::string& key) {
  const auto entry = map.find(key);
  return entry == map.end() ? "" : entry->second;
}

// A line "key: true" of what the recorder writes as YAML.
bool flag(const std::string& yaml, const std::string& key, bool otherwise) {
  const std::size_t at = ("\n" + yaml).find("\n" + key + ": ");
  return at == std::string::npos ? otherwise : yaml.compare(at + key.size() + 2, 4, "true") == 0;
}

// "guid:part1|part2;guid:…": other recorders name several writers of a channel.
std::vector<std::string> partitions_of(const std::string& text) {
  std::vector<std::string> partitions;
  for (std::size_t at = 0; at < text.size();) {
    const std::size_t end = std::min(text.find(';', at), text.size());
    const std::size_t colon = text.find(':', at);
    for (std::size_t part = colon < end ? colon + 1 : end; part < end;) {
      const std::size_t part_end = std::min(text.find('|', part), end);
      partitions.push_back(text.substr(part, part_end - part));
      part = part_end + 1;
    }
    at = end + 1;
  }
  return partitions;
}

}  // namespace

struct ReplaySource::Input {
  std::string file;
  mcap::IndexedReader reader;
  std::map<mcap::ChannelId, std::uint32_t> writers;  // what is selected
  std::vector<mcap::ChannelId> channels;
  std::optional<mcap::Message> front;
  std::uint64_t skipped = 0;  // chunks, in passes before
};

const LiveWriter* writer_in_the_way(const std::vector<LiveWriter>& live,
                                    const std::vector<SourceWriter>& replayed) {
  const auto announces = [](const LiveWriter& writer) { return is_announced(writer.topic); };
  const auto participant = [](const LiveWriter& writer) {
    return writer.guid.substr(0, writer.guid.find('|'));
  };
  std::set<std::string> topics, active;
  for (const SourceWriter& writer : replayed) topics.insert(writer.topic);
  for (const LiveWriter& writer : live)
    if (!announces(writer)) active.insert(participant(writer));
  const auto found = std::find_if(live.begin(), live.end(), [&](const LiveWriter& writer) {
    return topics.count(writer.topic) != 0 && (!announces(writer) || active.count(participant(writer)) != 0);
  });
  return found == live.end() ? nullptr : &*found;
}

ReplaySource::ReplaySource(const std::vector<std::string>& files, const ReplaySelection& selection)
    : passes_left_(selection.passes), for_ever_(selection.passes == 0) {
  for (const std::string& file : files) {
    auto& input = inputs_.emplace_back(std::make_unique<Input>());
    input->file = file;
    const mcap::Status status = input->reader.open(file);
    if (!status.ok()) throw SettingsError(file + ": " + status.text());
    if (input->reader.summary().rebuilt) warnings_.push_back(file + ": has no index, read as far as it goes");
    take_settings(*input);
  }
  first_ns_ = ~std::uint64_t{0};
  for (const auto& input : inputs_)
    for (const mcap::ChunkIndex& chunk : input->reader.summary().chunks)
      if (chunk.end_ns != 0) first_ns_ = std::min(first_ns_, chunk.start_ns);
  for (const auto& input : inputs_) add_channels(*input, selection);
  const std::string named = fmt::format("{}", fmt::join(files, ", "));
  if (writers_.empty())
    throw SettingsError(named + ": no topic is selected; weakgrid info names those it has");
  const auto after = [this](double s) { return first_ns_ + static_cast<std::uint64_t>(s * 1e9); };
  range_.from_ns = after(selection.start_s);
  if (selection.until_s) {
    if (*selection.until_s <= selection.start_s)
      throw SettingsError(
          fmt::format("--until {}: must be above --start {}", *selection.until_s, selection.start_s));
    range_.until_ns = after(*selection.until_s) - 1;
  }
  begin_pass();
  if (std::none_of(inputs_.begin(), inputs_.end(), [](const auto& input) { return input->front; }))
    throw SettingsError(named +
                        ": no message is selected; weakgrid info tells how many there are, and weakgrid "
                        "recover makes chunks of messages that stand outside of any");
}

ReplaySource::~ReplaySource() = default;

void ReplaySource::take_settings(Input& input) {
  for (const mcap::AttachmentIndex& index : input.reader.summary().attachments) {
    if (settings_ || index.name != settings_attachment) continue;
    const auto attachment = input.reader.attachment(index);
    if (!attachment) continue;
    try {
      settings_ =
          parse_settings({reinterpret_cast<const char*>(attachment->data.data()), attachment->data.size()},
                         input.file + ": " + settings_attachment);
    } catch (const SettingsError& error) {
      warnings_.emplace_back(error.what());
    }
  }
}

void ReplaySource::add_channels(Input& input, const ReplaySelection& selection) {
  const auto to = renamed(selection.remaps);
  for (const auto& [from, name] : to) {
    const bool known = std::any_of(inputs_.begin(), inputs_.end(), [&from = from](const auto& any) {
      const auto& channels = any->reader.summary().channels;
      return std::any_of(channels.begin(), channels.end(),
                         [&](const auto& entry) { return entry.second.topic == from; });
    });
    if (!known)
      throw SettingsError(fmt::format("--remap {}={}: no recording has a topic {}", from, name, from));
  }
  for (const auto& [id, channel] : input.reader.summary().channels) {
    if (!selection.filter.wants(channel.topic)) continue;
    const auto name = to.find(channel.topic);
    add_channel(input, channel, name == to.end() ? channel.topic : name->second);
  }
}

void ReplaySource::add_channel(Input& input, const mcap::Channel& channel, const std::string& topic) {
  const auto& schemas = input.reader.summary().schemas;
  const auto schema = schemas.find(channel.schema_id);
  if (channel.message_encoding != "cdr" || schema == schemas.end()) {
    warnings_.push_back(fmt::format("{}: {} is left out: {}", input.file, channel.topic,
                                    schema == schemas.end()
                                        ? "its type is not named"
                                        : "encoding '" + channel.message_encoding + "', wanted is 'cdr'"));
    return;
  }
  const std::string qos = value_of(channel.metadata, "qos");
  SourceWriter writer{.guid = value_of(channel.metadata, "writer"),
                      .topic = topic,
                      .type = schema->second.name,
                      // Of our own types the contract says it: it may have changed since.
                      .keyed = is_keyed_type(schema->second.name).value_or(flag(qos, "keyed", false)),
                      .reliable = flag(qos, "reliability", true),
                      .transient_local = flag(qos, "durability", false),
                      .exclusive = flag(qos, "ownership", false),
                      .partitions = partitions_of(value_of(channel.metadata, "partitions")),
                      .qos_full = value_of(channel.metadata, "qos_full")};
  for (const SourceWriter& other : writers_)
    if ((other.topic == writer.topic && other.type != writer.type) ||
        (other.type == writer.type && other.keyed != writer.keyed))
      throw SettingsError(
          fmt::format("{}: {} of type {} ({}) and {} of type {} ({}) cannot be written together", input.file,
                      writer.topic, writer.type, writer.keyed ? "keyed" : "no key", other.topic, other.type,
                      other.keyed ? "keyed" : "no key"));
  // Without a writer's name, as others record, each channel stands for itself.
  const std::string who = writer.guid.empty() ? fmt::format("{} {}", input.file, channel.id) : writer.guid;
  writer.index = static_cast<std::uint32_t>(writers_.size());
  const auto [known, is_new] = known_writers_.emplace(who + " " + channel.topic, writer.index);
  if (is_new) writers_.push_back(std::move(writer));
  input.writers[channel.id] = known->second;
  input.channels.push_back(channel.id);
}

void ReplaySource::begin_pass() {
  for (const auto& input : inputs_) {
    input->skipped += input->reader.chunks_skipped();
    input->front.reset();
    if (input->channels.empty()) continue;  // none would mean all
    input->reader.select(range_, input->channels);
    advance(*input);
  }
  handed_out_ = nullptr;
  pass_begins_ = true;
}

void ReplaySource::advance(Input& input) {
  input.front = input.reader.next();
  if (!input.front && !input.reader.status().ok())
    throw SettingsError(input.file + ": " + input.reader.status().text());
}

std::optional<RawSample> ReplaySource::next() {
  if (handed_out_ != nullptr) advance(*handed_out_);
  const auto earlier = [](const auto& a, const auto& b) {
    return a->front && (!b->front || a->front->log_time_ns < b->front->log_time_ns);
  };
  auto first = std::min_element(inputs_.begin(), inputs_.end(), earlier);
  if (!(*first)->front) {
    if ((!for_ever_ && --passes_left_ == 0) || last_ns_ > passes_ns_max) return std::nullopt;
    offset_ns_ = last_ns_ + between_passes_ns;
    begin_pass();
    first = std::min_element(inputs_.begin(), inputs_.end(), earlier);
    if (!(*first)->front) return std::nullopt;
  }
  handed_out_ = first->get();
  const mcap::Message& message = *handed_out_->front;
  const auto at_ns = static_cast<std::int64_t>(std::min(message.log_time_ns - first_ns_, span_ns_max));
  if (pass_begins_ && offset_ns_ != 0) offset_ns_ -= at_ns;
  pass_begins_ = false;
  last_ns_ = offset_ns_ + at_ns;
  return RawSample{.writer = handed_out_->writers.at(message.channel_id),
                   .sequence = message.sequence,
                   .source_ns = static_cast<std::int64_t>(message.publish_time_ns),
                   .reception_ns = last_ns_,
                   .payload = message.data};
}

std::uint64_t ReplaySource::chunks_skipped() const {
  std::uint64_t skipped = 0;
  for (const auto& input : inputs_) skipped += input->skipped + input->reader.chunks_skipped();
  return skipped;
}

}  // namespace weakgrid
