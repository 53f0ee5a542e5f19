// What the journal tests share: a scratch folder, files as texts, entries as a reader gives them.
#pragma once

#include <gtest/gtest.h>
#include <stdlib.h>

#include <filesystem>
#include <fstream>
#include <sstream>
#include <vector>

#include "services/journal/journal.hpp"
#include "services/runtime/settings.hpp"
#include "services/runtime/sha256.hpp"

namespace weakgrid::test {

/// A folder of its own that goes with the test; `parent`: in memory where there is such a place.
class Scratch {
 public:
  explicit Scratch(const std::filesystem::path& parent = std::filesystem::exists("/dev/shm")
                                                             ? std::filesystem::path("/dev/shm")
                                                             : std::filesystem::temp_directory_path()) {
    std::string name = (parent / "weakgrid_journal_XXXXXX").string();
    if (mkdtemp(name.data()) == nullptr) throw std::runtime_error(name + ": cannot be made");
    path_ = name;
  }
  ~Scratch() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  Scratch(const Scratch&) = delete;
  Scratch& operator=(const Scratch&) = delete;
  std::string operator/(const std::string& name) const { return (path_ / name).string(); }

 private:
  std::filesystem::path path_;
};

inline std::string text_of(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::ostringstream text;
  text << file.rdbuf();
  return text.str();
}

inline void write_text(const std::string& path, std::string_view text) {
  std::ofstream file(path, std::ios::binary | std::ios::trunc);
  file << text;
  if (!file.good()) throw std::runtime_error(path + ": cannot be written");
}

/// A whole journal with one entry for each body.
inline std::string journal_of(const std::vector<nlohmann::json>& bodies, std::uint64_t time_ns = 0) {
  std::string text, previous = journal_beginning();
  std::uint64_t n = 0;
  for (const nlohmann::json& body : bodies) {
    ++n;
    const auto line = journal_line(n, time_ns + n, "decision", body, previous);
    if (!line) throw std::logic_error("not an entry: " + body.dump());
    text += line->bytes;
    previous = line->hash;
  }
  return text;
}

inline const std::vector<nlohmann::json>& some_bodies() {
  static const std::vector<nlohmann::json> bodies{
      {{"client", 7}, {"p", 0.707}, {"text", "accepted"}},
      {{"client", 8}, {"margins", {{"current", -0.1326}}}, {"text", "refused: \"limit\"\n"}},
      nlohmann::json::object(),
      {{"client", 7}, {"p", 1e-300}}};
  return bodies;
}

inline std::vector<std::string> lines_of(const std::string& text) {
  std::vector<std::string> lines;
  std::istringstream stream(text);
  for (std::string line; std::getline(stream, line);) lines.push_back(line + '\n');
  return lines;
}

inline JournalVerdict verdict_of(std::string_view text, const JournalVisitor& visitor = {}) {
  JournalScan scan(visitor);
  scan.feed(text);
  return scan.finish();
}

inline std::vector<JournalEntry> entries_of(const std::string& path) {
  std::vector<JournalEntry> entries;
  const JournalVerdict verdict =
      read_journal(path, [&](const JournalEntry& entry, const JournalPlace& place) {
        EXPECT_TRUE(place.is_verified);
        entries.push_back(entry);
      });
  EXPECT_TRUE(verdict.intact()) << verdict.text();
  return entries;
}

/// What opening the journal says instead; empty: it opens.
inline std::string refusal_of(const std::string& path) {
  try {
    const Journal journal(path);
  } catch (const std::exception& error) {
    return error.what();
  }
  return {};
}

}  // namespace weakgrid::test
