// weakgrid journal: what stands in the supervisor's journal, and whether it still is what was written.
#include "services/journal/journal_reader.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <deque>
#include <system_error>

#include "services/cli/commands.hpp"
#include "services/runtime/program.hpp"

namespace weakgrid {

namespace {

using nlohmann::json;

struct Options {
  std::string file, since, until, client, expected;
  std::vector<std::string> kinds;
  std::uint64_t last = 0;  // 0: all
  bool json = false, verify = false;
};

bool is_wanted(const Options& options, const JournalEntry& entry) {
  // A shorter time stands for the whole hour, day, …
  const auto time = [&](const std::string& limit) { return entry.time.substr(0, limit.size()); };
  if (!options.since.empty() && time(options.since) < options.since) return false;
  if (!options.until.empty() && time(options.until) > options.until) return false;
  if (!options.kinds.empty() &&
      std::find(options.kinds.begin(), options.kinds.end(), entry.kind) == options.kinds.end())
    return false;
  if (options.client.empty()) return true;
  const auto client = entry.body.find("client");
  return client != entry.body.end() &&
         (client->is_string() ? client->get_ref<const std::string&>() : client->dump()) == options.client;
}

// Texts come from clients: none may begin a line of its own or speak to a terminal.
std::string plain(const std::string& text) {
  std::string out;
  for (std::size_t k = 0; k < text.size(); ++k) {
    const auto byte = static_cast<unsigned char>(text[k]);
    const auto next = k + 1 < text.size() ? static_cast<unsigned char>(text[k + 1]) : 0u;
    if (byte < 0x20 || byte == 0x7f) {
      out += fmt::format("\\x{:02x}", byte);
    } else if (byte == 0xc2 && next >= 0x80 && next < 0xa0) {
      out += fmt::format("\\u{:04x}", next);
      ++k;
    } else {
      out += text[k];
    }
  }
  return out;
}

std::string line_of(const Options& options, const JournalEntry& entry, const JournalPlace& place) {
  if (options.json) {
    if (place.is_verified) return std::string(place.as_read);
    return json{{"n", entry.n},       {"time", entry.time},         {"kind", entry.kind},
                {"body", entry.body}, {"previous", entry.previous}, {"hash", entry.hash},
                {"unverified", true}, {"line", place.line}}
        .dump();
  }
  const auto text = entry.body.find("text");
  const bool has_text = text != entry.body.end() && text->is_string();
  return fmt::format("{} {:>6} {:<10} {}{}", entry.time, entry.n, entry.kind,
                     plain(has_text ? text->get<std::string>() : entry.body.dump()),
                     place.is_verified ? "" : "  [unverified]");
}

struct Read {
  JournalVerdict verdict;
  std::uint64_t expected_n = 0;  // of the intact entry whose hash was expected; 0: none
  std::uint64_t behind = 0;      // entries that follow the fault
};

// Prints meanwhile, unless it must know the end first.
Read read(const Options& options) {
  std::deque<std::string> last;
  Read result;
  const auto see = [&](const JournalEntry& entry, const JournalPlace& place) {
    if (!place.is_verified) ++result.behind;
    if (place.is_verified && entry.hash == options.expected) result.expected_n = entry.n;
    if (options.verify || !is_wanted(options, entry)) return;
    if (options.last == 0) {
      fmt::print("{}\n", line_of(options, entry, place));
      return;
    }
    if (last.size() == options.last) last.pop_front();
    last.push_back(line_of(options, entry, place));
  };
  // The gateway may be in the middle of a line.
  constexpr std::chrono::milliseconds patience{100};
  result.verdict = read_journal(options.file, see, patience);
  if (!result.verdict.is_journal)
    throw SettingsError(fmt::format("{}: is not a journal: {}", options.file, result.verdict.text()));
  for (const std::string& line : last) fmt::print("{}\n", line);
  return result;
}

json to_json(const Options& options, const Read& result) {
  const JournalVerdict& verdict = result.verdict;
  json out{{"state", verdict.intact() ? "intact" : "broken"},
           {"text", verdict.text()},
           {"entries", verdict.entries},
           {"bytes", verdict.bytes},
           {"head", verdict.head},
           {"unverified", result.behind},
           {"fault", nullptr}};
  if (const auto& fault = verdict.fault)
    out["fault"] = {
        {"line", fault->line}, {"byte", fault->offset}, {"kind", name(fault->kind)}, {"text", fault->text}};
  if (!options.expected.empty())
    out["expected"] = {{"hash", options.expected},
                       {"found", result.expected_n > 0},
                       {"n", result.expected_n > 0 ? json(result.expected_n) : json()}};
  return out;
}

void print(const Options& options, const Read& result) {
  const JournalVerdict& verdict = result.verdict;
  fmt::print("{}{}\n", verdict.intact() ? "" : "broken: ", verdict.text());
  if (!verdict.intact())
    fmt::print("intact before it: {} entries, {} bytes; unverified: {} entries\n", verdict.entries,
               verdict.bytes, result.behind);
  fmt::print("head {}\n", verdict.head);
  if (options.expected.empty()) return;
  if (result.expected_n > 0)
    fmt::print("the expected hash is that of entry {}\n", result.expected_n);
  else
    fmt::print(
        "the expected hash is of none of these entries: those at the end were removed, or it is another "
        "journal\n");
}

void check(Options& options) {
  for (auto [option, time] : {std::pair{"--since", &options.since}, {"--until", &options.until}}) {
    if (!time->empty() && !is_journal_time(*time))
      throw SettingsError(fmt::format(
          "{} {}: must be a UTC time like 2026-11-22T20:13:42.123Z or a beginning of it like 2026-11-22",
          option, *time));
    if (time->size() < 30 && time->ends_with('Z')) time->pop_back();
  }
  if (!options.expected.empty() && !is_journal_hash(options.expected))
    throw SettingsError(
        fmt::format("--expect-hash {}: must be 64 hexadecimal digits, lower case", options.expected));
  options.verify = options.verify || !options.expected.empty();
}

}  // namespace

Command add_journal(CLI::App& app) {
  auto options = std::make_shared<Options>();
  CLI::App* command =
      app.add_subcommand("journal", "Shows what stands in a supervisor's journal, and checks it.");
  command->add_option("FILE", options->file, "journal")->required();
  command->add_option("--kind", options->kinds, "only entries of this kind; may be repeated")
      ->expected(1)
      ->multi_option_policy(CLI::MultiOptionPolicy::TakeAll);
  command->add_option("--since", options->since, "only from this time on: UTC, or a beginning of it");
  command->add_option("--until", options->until, "only up to this time; 2026-11-22 is all of that day");
  command->add_option("--client", options->client, "only entries whose body says this client");
  command->add_option("--last", options->last, "only the last of those")
      ->check(CLI::Range(std::uint64_t{1}, std::uint64_t{1'000'000}));
  command->add_flag("--verify", options->verify,
                    "show no entries but whether every line is as it was written");
  command->add_option("--expect-hash", options->expected,
                      "a head that --verify gave before: verify also that this entry is still there");
  command->add_flag("--json", options->json, "print JSON lines, with --verify one JSON verdict");
  command->footer(
      "Example: weakgrid journal gateway.journal --kind decision --since 2026-11-22T20:13 --last 20\n"
      "         weakgrid journal gateway.journal --verify\n"
      "Exit: 0 intact, 1 broken or the expected hash is not there, 2 bad usage or not a journal, 3 cannot be "
      "read.");
  return [options] {
    check(*options);
    const Read result = read(*options);
    const JournalVerdict& verdict = result.verdict;
    if (options->verify && options->json)
      fmt::print("{}\n", to_json(*options, result).dump(2));
    else if (options->verify)
      print(*options, result);
    else if (!verdict.intact())
      fmt::print(stderr, "weakgrid: {}: {}; from there on entries are unverified\n", options->file,
                 verdict.text());
    const bool is_as_expected = options->expected.empty() || result.expected_n > 0;
    return verdict.intact() && is_as_expected ? exit_done : exit_no;
  };
}

}  // namespace weakgrid
