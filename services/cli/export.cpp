// weakgrid export: recordings as CSV, for every other tool.
#include <fmt/format.h>
#include <signal.h>
#include <unistd.h>

#include <chrono>

#include "services/cli/commands.hpp"
#include "services/recording/csv_export.hpp"
#include "services/runtime/program.hpp"

namespace weakgrid {

namespace {

struct Options {
  std::vector<std::string> recordings;
  std::string folder;
  TopicFilter filter;
};

void open(mcap::Reader& reader, const std::string& recording) {
  const mcap::Status status = reader.open(recording);
  if (!status.ok()) throw SettingsError(recording + ": " + status.text());
}

// One line that is written over and over, where a person may be looking.
class ProgressLine {
 public:
  explicit ProgressLine(const std::string& what) : what_(what) {}
  ~ProgressLine() {
    if (shown_) fmt::print(stderr, "\r{:{}}\r", "", what_.size() + 8);
  }
  void show(std::uint64_t done, std::uint64_t all) {
    if (!is_terminal_ || ++calls_ % 1024 != 0) return;
    const auto now = std::chrono::steady_clock::now();
    if (now - shown_at_ < std::chrono::milliseconds(200)) return;
    shown_at_ = now;
    shown_ = true;
    fmt::print(stderr, "\r{}: {:3} %", what_, all == 0 ? 100 : done * 100 / all);
  }

 private:
  const std::string what_;
  const bool is_terminal_ = isatty(STDERR_FILENO) != 0;
  bool shown_ = false;
  std::uint64_t calls_ = 0;
  std::chrono::steady_clock::time_point shown_at_ = std::chrono::steady_clock::now();
};

// False if something is missing in the tables that the recordings meant to hold.
bool say_tables(const CsvExport& out, bool is_filtered) {
  bool is_whole = true;
  for (const CsvExport::Table& table : out.tables()) {
    fmt::print("{}: {} of {}\n", table.path, table.rows, table.type.empty() ? "no type" : table.type);
    if (table.undecodable == 0) continue;
    is_whole = false;
    fmt::print(stderr, "weakgrid: {}: {} messages are not of the type {} that they name: left out\n",
               table.topic, table.undecodable, table.type);
  }
  if (out.met_other_idl())
    fmt::print(stderr,
               "weakgrid: recorded with another weakgrid.idl than this program's: fields may differ\n");
  if (out.tables().empty() && is_filtered) {
    is_whole = false;
    fmt::print(stderr, "weakgrid: no message is of the topics asked for\n");
  }
  return is_whole;
}

int export_recordings(const Options& options) {
  // A disk that is full is an error of write(), not the end.
  signal(SIGXFSZ, SIG_IGN);
  for (const std::string& recording : options.recordings) {
    mcap::Reader reader;
    open(reader, recording);
  }
  CsvExport out(options.folder, options.filter);
  bool is_whole = true;
  for (const std::string& recording : options.recordings) {
    mcap::Reader reader;
    open(reader, recording);
    mcap::ScanReport report;
    {
      ProgressLine line(recording);
      report = out.add(reader, [&](std::uint64_t done, std::uint64_t all) { line.show(done, all); });
    }
    if (report.intact()) continue;
    is_whole = false;
    fmt::print(stderr, "weakgrid: {}: {}\n", recording, report.text());
  }
  out.finish();
  is_whole &= say_tables(out, !options.filter.topics.empty());
  return is_whole ? exit_done : exit_no;
}

}  // namespace

Command add_export(CLI::App& app) {
  auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand("export", "Writes recordings as CSV, one file for each topic.");
  command->add_option("RECORDING", options->recordings, "MCAP files; the parts of one in their order")
      ->required();
  command->add_option("-o,--output", options->folder, "folder for the tables, made where it is missing")
      ->required();
  command
      ->add_option("--topic", options->filter.topics,
                   "these topics only; pattern with * and ?, may be repeated")
      ->allow_extra_args(false);
  command->add_option("--exclude", options->filter.excluded, "not these; wins over --topic")
      ->allow_extra_args(false);
  command->footer(
      "Example: weakgrid export run.mcap -o run --topic 'weakgrid/m*'\n"
      "Exit: 0 everything is there, 1 something is missing or damaged, 2 not a recording, 3 a table is there "
      "already, or the world failed.");
  return [options] { return export_recordings(*options); };
}

}  // namespace weakgrid
