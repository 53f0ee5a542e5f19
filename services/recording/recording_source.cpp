// RecordingSource: see the header.
#include "services/recording/recording_source.hpp"

#include <fmt/format.h>

#include "services/recording/sequence_map.hpp"
#include "services/runtime/settings.hpp"

namespace weakgrid {

RecordingSource::RecordingSource(const std::vector<std::string>& files) : files_(files) {
  // Whatever is no recording is said before work begins.
  for (const std::string& file : files_) {
    mcap::Reader reader;
    if (const mcap::Status status = reader.open(file); !status.ok())
      throw SettingsError(file + ": " + status.text());
  }
}

bool RecordingSource::open_next() {
  if (next_file_ == files_.size()) return false;
  reader_ = std::make_unique<mcap::Reader>();
  channels_.clear();
  const std::string& file = files_[next_file_++];
  if (const mcap::Status status = reader_->open(file); !status.ok())
    throw SettingsError(file + ": " + status.text());
  return true;
}

std::optional<RecordedMessage> RecordingSource::next() {
  while (reader_ || open_next()) {
    while (auto record = reader_->next()) {
      if (auto* metadata = std::get_if<mcap::Metadata>(&*record)) metadata_.push_back(std::move(*metadata));
      const auto* message = std::get_if<mcap::Message>(&*record);
      if (message == nullptr) continue;
      RecordedMessage out{.writer = writer_of(*message),
                          .log_time_ns = message->log_time_ns,
                          .publish_time_ns = message->publish_time_ns,
                          .payload = message->data};
      auto& [writer, last] = channels_[message->channel_id];
      last = last == 0 ? message->sequence : unwrap(message->sequence, last);
      out.sequence = last;
      return out;
    }
    if (!reader_->report().intact())
      faults_ += fmt::format("{}: {}\n", files_[next_file_ - 1], reader_->report().text());
    reader_.reset();
  }
  return std::nullopt;
}

const RecordedWriter* RecordingSource::writer_of(const mcap::Message& message) {
  if (message.channel_id >= channels_.size()) channels_.resize(message.channel_id + std::size_t{1});
  auto& [known, last] = channels_[message.channel_id];
  if (known != nullptr) return known;
  const mcap::Channel& channel = reader_->channels().at(message.channel_id);
  const auto guid = channel.metadata.find("writer");
  const std::string name = guid != channel.metadata.end()
                               ? guid->second
                               : fmt::format("channel {} of {}", channel.id, files_[next_file_ - 1]);
  auto [entry, is_new] = writers_.try_emplace(name);
  RecordedWriter& writer = entry->second;
  if (is_new) {
    writer.index = writers_.size() - 1;
    writer.topic = channel.topic;
    writer.guid = name;
    const auto schema = reader_->schemas().find(channel.schema_id);
    if (schema != reader_->schemas().end()) writer.type = schema->second.name;
  }
  known = &writer;
  return known;
}

}  // namespace weakgrid
