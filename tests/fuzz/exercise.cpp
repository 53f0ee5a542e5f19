// Exercise: see the header.
#include "tests/fuzz/exercise.hpp"

#include <cmath>
#include <filesystem>
#include <fstream>
#include <stdexcept>

#include "services/cli/schedule_table.hpp"
#include "services/journal/journal_reader.hpp"
#include "services/recording/csv_export.hpp"
#include "services/recording/mcap_index.hpp"
#include "services/recording/mcap_recover.hpp"
#include "services/runtime/payload.hpp"
#include "services/runtime/settings.hpp"
#include "services/runtime/wire_fields.hpp"

namespace weakgrid::fuzz {

namespace {

using mcap::ByteView;

void claim(bool holds, const char* what) {
  if (!holds) throw std::logic_error(std::string("does not hold: ") + what);
}

// Small, so that a file of a few bytes cannot make every case slow.
mcap::ReaderOptions limits(bool keep_bad_crc) {
  return {.chunk_bytes_max = 1 << 20, .record_bytes_max = 8 << 20, .keep_bad_crc = keep_bad_crc};
}

volatile unsigned sink;
// Looks at every byte: a view beyond its buffer shows under a sanitizer only then.
void touch(ByteView bytes) {
  unsigned sum = 0;
  for (const std::byte byte : bytes) sum += std::to_integer<unsigned>(byte);
  sink = sum;
}

mcap::ScanReport read_all(ByteView bytes, const mcap::ReaderOptions& options) {
  mcap::Reader reader;
  if (!reader.open(bytes, options).ok()) {
    claim(!reader.next(), "what is refused yields nothing");
    return reader.report();
  }
  std::uint64_t messages = 0;
  while (const auto record = reader.next()) {
    const auto* message = std::get_if<mcap::Message>(&*record);
    if (message == nullptr) continue;
    ++messages;
    touch(message->data);
    const auto channel = reader.channels().find(message->channel_id);
    claim(channel != reader.channels().end(), "a message comes after its channel");
    claim(channel->second.schema_id == 0 || reader.schemas().contains(channel->second.schema_id),
          "a channel comes after its schema");
  }
  const mcap::ScanReport& report = reader.report();
  claim(!reader.next(), "the end is the end");
  claim(report.messages == messages, "the report counts what was yielded");
  claim(report.ending != mcap::Ending::running, "a scan ends");
  claim(report.offset <= bytes.size(), "a scan ends within the file");
  claim(!report.text().empty(), "a report has words");
  return report;
}

void read_indexed(ByteView bytes, const mcap::ReaderOptions& options) {
  mcap::IndexedReader reader;
  if (!reader.open(bytes, options).ok()) return;
  for (const mcap::MetadataIndex& index : reader.summary().metadata) (void)reader.metadata(index);
  for (const mcap::AttachmentIndex& index : reader.summary().attachments) (void)reader.attachment(index);
  while (const auto message = reader.next()) touch(message->data);
  reader.select({5, ~std::uint64_t{0} / 2}, {1});
  while (const auto message = reader.next()) {
    claim(message->channel_id == 1, "only what is selected comes");
    claim(message->log_time_ns >= 5 && message->log_time_ns <= ~std::uint64_t{0} / 2, "of that time");
  }
}

void write_file(const std::string& path, ByteView bytes) {
  std::ofstream file{path, std::ios::binary | std::ios::trunc};
  file.write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
  claim(file.good(), "the test can write its own file");
}

void export_tables(const std::string& path, const std::string& folder) {
  mcap::Reader reader;
  if (!reader.open(path, limits(false)).ok()) return;
  CsvExport out(folder, {});
  const mcap::ScanReport report = out.add(reader);
  out.finish();
  std::uint64_t rows = 0;
  for (const CsvExport::Table& table : out.tables()) rows += table.rows + table.undecodable;
  claim(rows == report.messages, "every message is a row or counted");
}

template <class Message>
void take_payload(const char* type, ByteView payload) {
  const auto fields = fields_of_payload(type, payload);
  const auto message = from_payload<Message>(payload);
  claim(fields || !message, "what is a message has fields");
  if (!fields) return;
  claim(fields->size() == field_names(type).size(), "every field has its column");
  for (const WireField& field : *fields) {
    claim(is_same(field.value, field.value), "a value is itself");
    for (const std::string& text : {to_text(field.value), to_hex(field.value)})
      touch(std::as_bytes(std::span{text}));
  }
  if (message) claim(fields_of(message->unit, message->message).size() == fields->size(), "both ways agree");
}

}  // namespace

void exercise_reader(ByteView bytes) {
  for (const bool keep_bad_crc : {false, true}) {
    read_all(bytes, limits(keep_bad_crc));
    read_indexed(bytes, limits(keep_bad_crc));
  }
}

void exercise_summary(ByteView bytes) {
  constexpr std::size_t crc_bytes = 4;
  constexpr std::size_t footer_from_end = mcap::record_head_bytes + mcap::footer_bytes + mcap::magic.size();
  if (bytes.size() < footer_from_end + mcap::magic.size()) return;
  mcap::Bytes mended{bytes.begin(), bytes.end()};
  std::copy(mcap::magic.begin(), mcap::magic.end(), mended.begin());
  std::copy(mcap::magic.begin(), mcap::magic.end(), mended.end() - mcap::magic.size());
  const std::size_t footer = mended.size() - footer_from_end;
  mended[footer] = static_cast<std::byte>(mcap::Op::footer);
  mcap::store(&mended[footer + 1], std::uint64_t{mcap::footer_bytes});
  const auto begin = mcap::load<std::uint64_t>(&mended[footer + mcap::record_head_bytes]);
  const std::size_t crc = mended.size() - mcap::magic.size() - crc_bytes;
  if (begin < crc) mcap::store(&mended[crc], mcap::crc32(ByteView{mended}.subspan(begin, crc - begin)));
  exercise_reader(mended);
}

void exercise_recover(ByteView bytes, const std::string& folder) {
  const std::string broken = folder + "/broken.mcap", clean = folder + "/clean.mcap";
  write_file(broken, bytes);
  mcap::RecoverOptions options;
  options.writer.chunk_bytes = 4096;
  options.writer.compression = mcap::Compression::none;  // else the time goes into libzstd
  options.reader = limits(bytes.size() % 2 == 0);        // one of both a case: a file is cut at either
  mcap::Recovery recovery;
  if (mcap::recover(broken, clean, options, recovery).ok()) {
    mcap::Reader reader;
    claim(reader.open(clean).ok(), "what recover makes can be read");
    std::uint64_t messages = 0;
    while (const auto record = reader.next()) messages += std::holds_alternative<mcap::Message>(*record);
    claim(reader.report().intact(), "and is intact");
    claim(messages == recovery.messages, "and holds what recover says");
    claim(recovery.messages + recovery.refused >= recovery.scan.messages, "nothing is lost in silence");
    claim(!recovery.text().empty(), "a recovery has words");
  }
  std::filesystem::remove(clean);
  export_tables(broken, folder + "/tables");
  std::filesystem::remove_all(folder + "/tables");
  std::filesystem::remove(broken);
}

void exercise_payload(ByteView payload) {
  take_payload<Measurement>("weakgrid::wire::Measurement", payload);
  take_payload<Modulation>("weakgrid::wire::Modulation", payload);
  take_payload<Request>("weakgrid::wire::SetpointRequest", payload);
  take_payload<DecisionMessage>("weakgrid::wire::SetpointDecision", payload);
  take_payload<Envelope>("weakgrid::wire::Envelope", payload);
  take_payload<Reference>("weakgrid::wire::Reference", payload);
  take_payload<Operation>("weakgrid::wire::Operation", payload);
  take_payload<ControllerState>("weakgrid::wire::ControllerState", payload);
  take_payload<Health>("weakgrid::wire::Health", payload);
  take_payload<Manifest>("weakgrid::wire::Manifest", payload);
}

void exercise_settings(std::string_view text) {
  std::string written;
  try {
    written = to_toml(parse_settings(std::string(text), "fuzz"));
  } catch (const SettingsError& error) {
    claim(std::string_view(error.what()).substr(0, 4) == "fuzz", "an error names its file");
    return;
  }
  try {
    claim(to_toml(parse_settings(written, "written")) == written, "settings written are settings read");
  } catch (const SettingsError&) {
    claim(false, "settings written can be read");
  }
}

void exercise_schedule(std::string_view text) {
  std::vector<TimedSetpoint> setpoints;
  try {
    setpoints = parse_table(std::string(text), "fuzz");
  } catch (const SettingsError& error) {
    claim(std::string_view(error.what()).substr(0, 4) == "fuzz", "an error names its file");
    return;
  }
  claim(!setpoints.empty(), "a schedule asks for something");
  double before_s = -1.0;
  for (const TimedSetpoint& s : setpoints) {
    claim(s.at_s > before_s && s.at_s <= 1e6, "times rise");
    before_s = s.at_s;
    claim(s.active_power || s.reactive_power || s.dc_voltage, "each setpoint asks for something");
    for (const auto& power : {s.active_power, s.reactive_power})
      claim(!power || std::abs(*power) <= 10.0, "powers are in range");
    claim(!s.dc_voltage || (*s.dc_voltage > 0.0 && *s.dc_voltage <= 10.0), "voltages are in range");
    claim(s.ramp_s >= 0.0 && s.ramp_s <= 60.0 && s.lease_s >= 0.0 && s.lease_s <= 86400.0,
          "spans are in range");
  }
}

void exercise_journal(std::string_view text) {
  std::uint64_t verified = 0, line = 0;
  const auto see = [&](const JournalEntry& entry, const JournalPlace& place) {
    claim(place.line > line, "lines come in order");
    line = place.line;
    claim(text.substr(place.offset, place.as_read.size()) == place.as_read,
          "a line is where it is said to be");
    if (place.is_verified) claim(entry.n == ++verified, "what is verified counts from 1");
    claim(!entry.body.dump(-1, ' ', true).empty(), "what was read can be printed");
  };
  JournalScan whole(see);
  whole.feed(text);
  const JournalVerdict verdict = whole.finish();
  claim(verdict.entries == verified, "the verdict counts what was shown as verified");
  claim(verdict.intact() ? verdict.bytes == text.size() : verdict.bytes == verdict.fault->offset,
        "everything before the fault is intact");
  claim(!verdict.text().empty(), "a verdict has words");
  JournalScan pieces;
  for (const char& c : text) pieces.feed({&c, 1});
  claim(pieces.finish().text() == verdict.text(), "in pieces it is the same");
  JournalScan before;
  before.feed(text.substr(0, verdict.bytes));
  const JournalVerdict cut = before.finish();
  claim(cut.intact() && cut.head == verdict.head, "cut at the fault it is a journal");
  // A fuzzer finds no hash.
  (void)parse_journal_line(text.substr(0, text.find('\n')));
}

}  // namespace weakgrid::fuzz
