// One line of the journal: how an entry becomes bytes, and bytes an entry. The format: README.md.
#pragma once

#include <cstddef>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <string_view>

namespace weakgrid {

struct JournalEntry {
  std::uint64_t n = 0;
  std::string time, kind;
  nlohmann::json body;
  std::string previous, hash;  ///< 64 hexadecimal digits, lower case
};

/// With its newline. A reader needs no more memory than this, whatever it is given.
inline constexpr std::size_t journal_line_bytes_max = 1 << 20;
/// Objects and arrays within each other, the body itself is the first: printing recurses.
inline constexpr int journal_depth_max = 32;

/// What stands for the hash before the first line: 64 zeros.
const std::string& journal_beginning();

struct JournalLine {
  std::string bytes;  ///< with its newline
  std::string hash;
};
/// What a number cannot say in JSON becomes a text: "nan", "inf", "-inf"; what is not UTF-8, U+FFFD. None:
/// not a kind of 1 … 64 of a-z 0-9 _ -, not an object, too deep or too long.
std::optional<JournalLine> journal_line(std::uint64_t n, std::uint64_t time_ns, std::string_view kind,
                                        nlohmann::json body, std::string_view previous);

/// 2026-11-22T20:13:42.123456789Z, of ns since 1970.
std::string journal_time(std::uint64_t time_ns);
/// That, or a beginning of it that ends with a whole field: 2026-11-22T20:13.
bool is_journal_time(std::string_view text);
bool is_journal_hash(std::string_view text);

/// A line begins and ends like ours. `line`: without its newline, like below.
bool begins_like_journal(std::string_view line);
bool ends_like_journal(std::string_view line);
/// The hash that stands in a line that ends like ours is that of its bytes.
bool journal_hash_holds(std::string_view line);
/// Whatever the hash: none if it is not JSON or not of these fields.
std::optional<JournalEntry> parse_journal_line(std::string_view line);

}  // namespace weakgrid
