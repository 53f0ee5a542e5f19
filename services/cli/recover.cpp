// weakgrid recover: a clean recording of a broken one.
#include <fmt/format.h>

#include "services/cli/commands.hpp"
#include "services/recording/mcap_recover.hpp"
#include "services/runtime/program.hpp"

namespace weakgrid {

Command add_recover(CLI::App& app) {
  struct Options {
    std::string broken, clean, compression = "zstd";
    bool keep_bad_crc = false;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command =
      app.add_subcommand("recover", "Makes a clean recording of one that a crash or a full disk has cut.");
  command->add_option("BROKEN", options->broken, "recording, is not changed")->required();
  command->add_option("-o,--output", options->clean, "file to create")->required();
  command->add_option("--compression", options->compression, "of the clean file")
      ->check(CLI::IsMember({"zstd", "lz4", "none"}))
      ->capture_default_str();
  command->add_flag("--keep-bad-crc", options->keep_bad_crc, "keep also what does not match its checksum");
  command->footer(
      "Example: weakgrid recover broken.mcap -o clean.mcap\n"
      "Exit: 0 everything up to the end is there, 1 something before it was lost, 2 not a recording, 3 the "
      "world "
      "failed.");
  return [options] {
    mcap::RecoverOptions how;
    how.writer.version = WEAKGRID_VERSION;
    how.writer.compression =
        mcap::compression_named(options->compression == "none" ? "" : options->compression).value();
    how.reader.keep_bad_crc = options->keep_bad_crc;
    {
      mcap::Reader reader;
      const mcap::Status status = reader.open(options->broken, how.reader);
      if (!status.ok()) throw SettingsError(options->broken + ": " + status.text());
    }
    mcap::Recovery recovery;
    const mcap::Status status = mcap::recover(options->broken, options->clean, how, recovery);
    if (!status.ok()) throw std::runtime_error(options->clean + ": " + status.text());
    fmt::print("{}\n", recovery.text());
    return recovery.scan.messages_dropped == 0 && recovery.refused == 0 ? exit_done : exit_no;
  };
}

}  // namespace weakgrid
