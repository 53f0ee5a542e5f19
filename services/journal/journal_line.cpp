// Journal line: see the header.
#include "services/journal/journal_line.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>

#include "services/runtime/sha256.hpp"

namespace weakgrid {

namespace {

using nlohmann::json;

constexpr std::string_view line_begin = "{\"n\":";
constexpr std::string_view hash_begin = ",\"hash\":\"";
constexpr std::string_view line_end = "\"}";
constexpr std::size_t hash_digits = 64;
constexpr std::size_t tail_bytes = hash_begin.size() + hash_digits + line_end.size();

std::string sha256_of(std::string_view bytes) {
  Sha256 hash;
  hash.add(std::as_bytes(std::span{bytes}));
  return hash.hex();
}

bool is_digit(char c) { return c >= '0' && c <= '9'; }
bool is_lower(char c) { return c >= 'a' && c <= 'z'; }

bool is_kind(std::string_view kind) {
  return !kind.empty() && kind.size() <= 64 && std::all_of(kind.begin(), kind.end(), [](char c) {
    return is_lower(c) || is_digit(c) || c == '_' || c == '-';
  });
}

// False: nested deeper than `depth`.
bool make_finite(json& value, int depth) {
  if (value.is_number_float()) {
    const double number = value.get<double>();
    if (!std::isfinite(number)) value = std::isnan(number) ? "nan" : number > 0.0 ? "inf" : "-inf";
  }
  if (!value.is_structured()) return true;
  return depth > 0 &&
         std::all_of(value.begin(), value.end(), [&](json& item) { return make_finite(item, depth - 1); });
}

// Without a parser: those that build or print a tree of a million brackets recurse.
int depth_of(std::string_view line) {
  int depth = 0, deepest = 0;
  bool in_text = false;
  for (std::size_t k = 0; k < line.size(); ++k) {
    const char c = line[k];
    if (in_text && c == '\\')
      ++k;
    else if (c == '"')
      in_text = !in_text;
    else if (!in_text && (c == '{' || c == '['))
      deepest = std::max(deepest, ++depth);
    else if (!in_text && (c == '}' || c == ']'))
      --depth;
  }
  return deepest;
}

}  // namespace

const std::string& journal_beginning() {
  static const std::string zeros(hash_digits, '0');
  return zeros;
}

std::string journal_time(std::uint64_t time_ns) {
  using namespace std::chrono;
  const sys_seconds second{seconds{time_ns / 1'000'000'000}};
  const sys_days day = floor<days>(second);
  const year_month_day date{day};
  const hh_mm_ss clock{second - day};
  return fmt::format("{:04}-{:02}-{:02}T{:02}:{:02}:{:02}.{:09}Z", static_cast<int>(date.year()),
                     static_cast<unsigned>(date.month()), static_cast<unsigned>(date.day()),
                     clock.hours().count(), clock.minutes().count(), clock.seconds().count(),
                     time_ns % 1'000'000'000);
}

bool is_journal_time(std::string_view text) {
  constexpr std::string_view shape = "dddd-dd-ddTdd:dd:dd.dddddddddZ";
  if (text.ends_with('Z') && text.size() >= 20 && text.size() < shape.size()) text.remove_suffix(1);
  const std::size_t size = text.size();
  if (size > shape.size() || size < 4) return false;
  for (std::size_t k = 0; k < size; ++k)
    if (shape[k] == 'd' ? !is_digit(text[k]) : shape[k] != text[k]) return false;
  const bool is_whole = size >= 21 || size == 4 || (size <= 19 && (size - 4) % 3 == 0);
  const auto field = [&](std::size_t at, int least, int most) {
    if (size < at + 2) return true;
    const int value = (text[at] - '0') * 10 + text[at + 1] - '0';
    return value >= least && value <= most;
  };
  return is_whole && field(5, 1, 12) && field(8, 1, 31) && field(11, 0, 23) && field(14, 0, 59) &&
         field(17, 0, 59);
}

bool is_journal_hash(std::string_view text) {
  return text.size() == hash_digits &&
         std::all_of(text.begin(), text.end(), [](char c) { return is_digit(c) || (c >= 'a' && c <= 'f'); });
}

std::optional<JournalLine> journal_line(std::uint64_t n, std::uint64_t time_ns, std::string_view kind,
                                        json body, std::string_view previous) {
  if (!is_kind(kind) || !body.is_object() || !make_finite(body, journal_depth_max)) return std::nullopt;
  JournalLine line;
  line.bytes = fmt::format("{}{},\"time\":\"{}\",\"kind\":\"{}\",\"body\":{},\"previous\":\"{}\"", line_begin,
                           n, journal_time(time_ns), kind,
                           body.dump(-1, ' ', false, json::error_handler_t::replace), previous);
  line.hash = sha256_of(line.bytes);
  line.bytes.append(hash_begin).append(line.hash).append(line_end) += '\n';
  if (line.bytes.size() > journal_line_bytes_max) return std::nullopt;
  return line;
}

bool begins_like_journal(std::string_view line) {
  return line_begin.starts_with(line.substr(0, line_begin.size()));
}

bool ends_like_journal(std::string_view line) {
  if (line.size() < tail_bytes) return false;
  const std::string_view tail = line.substr(line.size() - tail_bytes);
  return tail.starts_with(hash_begin) && tail.ends_with(line_end) &&
         is_journal_hash(tail.substr(hash_begin.size(), hash_digits));
}

bool journal_hash_holds(std::string_view line) {
  const std::size_t hashed = line.size() - tail_bytes;
  return line.substr(hashed + hash_begin.size(), hash_digits) == sha256_of(line.substr(0, hashed));
}

std::optional<JournalEntry> parse_journal_line(std::string_view line) {
  if (depth_of(line) > journal_depth_max + 1) return std::nullopt;
  json fields = json::parse(line, nullptr, false);
  if (!fields.is_object() || fields.size() != 6) return std::nullopt;
  const auto text = [&](const char* key) {
    const auto field = fields.find(key);
    return field != fields.end() && field->is_string() ? field->get<std::string>() : std::string();
  };
  JournalEntry entry;
  entry.time = text("time");
  entry.kind = text("kind");
  entry.previous = text("previous");
  entry.hash = text("hash");
  const auto n = fields.find("n"), body = fields.find("body");
  const bool is_entry = n != fields.end() && n->is_number_unsigned() && body != fields.end() &&
                        body->is_object() && is_kind(entry.kind) && entry.time.size() == 30 &&
                        is_journal_time(entry.time) && is_journal_hash(entry.previous) &&
                        is_journal_hash(entry.hash);
  if (!is_entry) return std::nullopt;
  entry.n = n->get<std::uint64_t>();
  entry.body = std::move(*body);
  return entry;
}

}  // namespace weakgrid
