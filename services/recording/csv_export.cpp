// CsvExport: see the header.
#include "services/recording/csv_export.hpp"

#include <errno.h>
#include <fmt/format.h>

#include <filesystem>
#include <stdexcept>
#include <system_error>

#include "services/csv_text.hpp"
#include "services/recording/idl_text.hpp"
#include "services/runtime/wire_fields.hpp"

namespace weakgrid {

namespace {

constexpr std::size_t pending_bytes_max = 64 << 10;  // of each table, beside one row
constexpr std::size_t name_bytes_max = 200;          // a file name may have 255

// Topics are names that strangers give.
std::string file_name(const std::string& topic) {
  std::string name;
  for (const char c : topic.substr(0, name_bytes_max)) {
    const auto byte = static_cast<unsigned char>(c);
    name += c == '/' || byte < 0x20 || byte == 0x7f ? '_' : c;
  }
  return name.empty() ? "_" : name;
}

// A text of IDL without what means nothing.
std::string bare(std::string_view text) {
  std::string out;
  bool in_comment = false;
  for (std::size_t k = 0; k < text.size(); ++k) {
    if (text[k] == '/' && k + 1 < text.size() && text[k + 1] == '/') in_comment = true;
    if (text[k] == '\n') in_comment = false;
    if (!in_comment && !std::isspace(static_cast<unsigned char>(text[k]))) out += text[k];
  }
  return out;
}

bool is_other_idl(const mcap::Schema& schema) {
  const std::string_view text{reinterpret_cast<const char*>(schema.data.data()), schema.data.size()};
  static const std::string ours = bare(idl_text());
  return !text.empty() && text != idl_text() && bare(text) != ours;
}

}  // namespace

CsvExport::CsvExport(std::string folder, TopicFilter filter)
    : folder_(std::move(folder)), filter_(std::move(filter)) {
  std::error_code error;
  made_folder_ = std::filesystem::create_directories(folder_, error);
  if (error || !std::filesystem::is_directory(folder_, error))
    throw std::runtime_error(folder_ + ": cannot be made a folder" + (error ? ": " + error.message() : ""));
}

CsvExport::~CsvExport() {
  if (finished_) return;
  std::error_code ignored;
  for (const Sink& sink : sinks_)
    if (sink.file.is_open()) std::filesystem::remove(sink.path, ignored);
  if (made_folder_) std::filesystem::remove(folder_, ignored);
}

mcap::ScanReport CsvExport::add(mcap::Reader& reader, const Progress& progress) {
  std::map<mcap::ChannelId, Source> sources;
  while (const auto record = reader.next()) {
    const auto* message = std::get_if<mcap::Message>(&*record);
    if (message == nullptr) continue;
    auto source = sources.find(message->channel_id);
    if (source == sources.end())
      source = sources.emplace(message->channel_id, source_of(reader, message->channel_id)).first;
    if (source->second.sink != nullptr) write(*source->second.sink, source->second.writer, *message);
    if (progress) progress(reader.report().offset, reader.report().file_bytes);
  }
  return reader.report();
}

CsvExport::Source CsvExport::source_of(const mcap::Reader& reader, mcap::ChannelId id) {
  const mcap::Channel& channel = reader.channels().at(id);
  if (!filter_.wants(channel.topic)) return {};
  std::string type;
  bool is_ours = false;
  if (const auto schema = reader.schemas().find(channel.schema_id); schema != reader.schemas().end()) {
    type = schema->second.name;
    is_ours = channel.message_encoding == "cdr" && !field_names(type).empty();
    if (is_ours && is_other_idl(schema->second)) met_other_idl_ = true;
  }
  const auto writer = channel.metadata.find("writer");
  return {&sink_of(channel.topic, type, is_ours), writer == channel.metadata.end() ? "" : writer->second};
}

CsvExport::Sink& CsvExport::sink_of(const std::string& topic, const std::string& type, bool is_ours) {
  Sink*& known = by_topic_and_type_[{topic, type + (is_ours ? "" : " in hexadecimal")}];
  if (known != nullptr) return *known;
  std::string name = file_name(topic);
  for (int n = 2; !names_.insert(name).second; ++n) name = fmt::format("{}_{}", file_name(topic), n);
  Sink& sink = sinks_.emplace_back();
  sink.path = (std::filesystem::path(folder_) / (name + ".csv")).string();
  sink.topic = topic;
  sink.type = type;
  sink.is_ours = is_ours;
  if (const mcap::Status status = sink.file.create(sink.path); !status.ok())
    throw std::runtime_error(status.error == EEXIST
                                 ? sink.path + ": is there already, and nothing is overwritten"
                                 : sink.path + ": " + std::generic_category().message(status.error));
  sink.pending = "log_time_ns,publish_time_ns,writer,sequence";
  for (const std::string& field : is_ours ? field_names(type) : std::vector<std::string>{"payload"})
    sink.pending += "," + field;
  sink.pending += '\n';
  return *(known = &sink);
}

void CsvExport::write(Sink& sink, const std::string& writer, const mcap::Message& message) {
  std::optional<WireFields> fields;
  if (sink.is_ours && !(fields = fields_of_payload(sink.type, message.data))) {
    ++sink.undecodable;
    return;
  }
  ++sink.rows;
  std::string& line = sink.pending;
  fmt::format_to(std::back_inserter(line), "{},{},", message.log_time_ns, message.publish_time_ns);
  put_csv_text(line, writer);
  fmt::format_to(std::back_inserter(line), ",{}", message.sequence);
  if (fields) {
    for (const WireField& field : *fields) {
      line += ',';
      put_csv_text(line, to_text(field.value));
    }
  } else {
    line += ',';
    for (const std::byte byte : message.data) {
      line += "0123456789abcdef"[std::to_integer<unsigned>(byte >> 4)];
      line += "0123456789abcdef"[std::to_integer<unsigned>(byte & std::byte{15})];
    }
  }
  line += '\n';
  if (line.size() >= pending_bytes_max) flush(sink);
}

void CsvExport::flush(Sink& sink) {
  const mcap::Status status = sink.file.append(std::as_bytes(std::span{sink.pending}));
  if (!status.ok())
    throw std::runtime_error(sink.path + ": " + std::generic_category().message(status.error));
  sink.pending.clear();
}

void CsvExport::finish() {
  for (Sink& sink : sinks_) flush(sink);
  finished_ = true;
  for (Sink& sink : sinks_)
    if (const mcap::Status status = sink.file.close(); !status.ok())
      throw std::runtime_error(sink.path + ": " + std::generic_category().message(status.error));
}

std::vector<CsvExport::Table> CsvExport::tables() const { return {sinks_.begin(), sinks_.end()}; }

}  // namespace weakgrid
