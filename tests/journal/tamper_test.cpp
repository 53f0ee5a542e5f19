// Whatever is changed in a journal is found, at the line where it was changed. What cannot be found by itself
// is said here too.
#include <algorithm>
#include <random>

#include "tests/journal/journal_support.hpp"

namespace weakgrid::test {
namespace {

std::uint64_t line_at(const std::string& text, std::size_t byte) {
  const auto end = text.begin() + static_cast<std::ptrdiff_t>(byte);
  return 1 + static_cast<std::uint64_t>(std::count(text.begin(), end, '\n'));
}

std::size_t offset_of_line(const std::string& text, std::uint64_t line) {
  std::size_t offset = 0;
  while (--line > 0) offset = text.find('\n', offset) + 1;
  return offset;
}

// Every fault is where the change was, what is before it is intact, what is behind it is shown unverified.
void expect_found_at(const std::string& changed, std::uint64_t line) {
  const auto see = [&](const JournalEntry&, const JournalPlace& place) {
    EXPECT_EQ(place.is_verified, place.line < line);
  };
  const JournalVerdict verdict = verdict_of(changed, see);
  ASSERT_TRUE(verdict.fault);
  EXPECT_TRUE(verdict.is_journal);
  EXPECT_EQ(verdict.fault->line, line) << verdict.text();
  EXPECT_EQ(verdict.fault->offset, offset_of_line(changed, line)) << verdict.text();
  EXPECT_EQ(verdict.entries, line - 1);
  EXPECT_EQ(verdict.bytes, verdict.fault->offset);
}

#ifdef WEAKGRID_SANITIZED
constexpr std::size_t stride = 37;  // half a million changes take minutes there
#else
constexpr std::size_t stride = 1;
#endif

TEST(JournalTamper, EveryByteChangedToEveryOtherIsFoundAtItsLine) {
  const std::string good = journal_of(some_bodies());
  ASSERT_TRUE(verdict_of(good).intact());
  std::size_t changes = 0;
  for (std::size_t byte = 0; byte < good.size(); ++byte) {
    SCOPED_TRACE("byte " + std::to_string(byte));
    for (std::size_t to = byte % stride; to < 256; to += stride) {
      if (static_cast<char>(to) == good[byte]) continue;
      std::string changed = good;
      changed[byte] = static_cast<char>(to);
      expect_found_at(changed, line_at(good, byte));
      ++changes;
    }
    if (testing::Test::HasFailure()) return;
  }
  std::printf("%zu changes of %zu bytes found\n", changes, good.size());
}

TEST(JournalTamper, AChangedLastNewlineLooksLikeATornLineAndIsFoundAsOne) {
  std::string changed = journal_of(some_bodies());
  changed.back() = ' ';
  const JournalVerdict verdict = verdict_of(changed);
  ASSERT_TRUE(verdict.fault);
  EXPECT_EQ(verdict.fault->kind, JournalFaultKind::torn);
  EXPECT_EQ(verdict.fault->line, 4u);
}

TEST(JournalTamper, EveryByteRemovedOrInsertedIsFoundAtItsLine) {
  const std::string good = journal_of(some_bodies());
  for (std::size_t byte = 0; byte < good.size(); ++byte) {
    SCOPED_TRACE("byte " + std::to_string(byte));
    expect_found_at(std::string(good).erase(byte, 1), line_at(good, byte));
    for (const char c : {'0', '\n', '\0', '"', '}'}) {
      const bool is_empty_line = c == '\n' && good[byte] == '\n';
      expect_found_at(std::string(good).insert(byte, 1, c), line_at(good, byte) + is_empty_line);
    }
    if (testing::Test::HasFailure()) return;
  }
}

std::string joined(const std::vector<std::string>& lines) {
  std::string text;
  for (const std::string& line : lines) text += line;
  return text;
}

TEST(JournalTamper, LinesRemovedRepeatedOrMovedAreFoundWhereTheyWere) {
  const auto good = lines_of(journal_of(some_bodies()));
  for (std::size_t k = 0; k < good.size(); ++k) {
    SCOPED_TRACE("line " + std::to_string(k + 1));
    const auto at = static_cast<std::ptrdiff_t>(k);
    auto lines = good;
    lines.insert(lines.begin() + at, good[k]);
    expect_found_at(joined(lines), k + 2);
    if (k + 1 == good.size()) continue;
    lines = good;
    lines.erase(lines.begin() + at);
    expect_found_at(joined(lines), k + 1);
    lines = good;
    std::swap(lines[k], lines[k + 1]);
    expect_found_at(joined(lines), k + 1);
  }
}

TEST(JournalTamper, ALineOfAnotherJournalIsFoundThoughItsHashAndNumberAreGood) {
  const auto good = lines_of(journal_of(some_bodies()));
  const auto other = lines_of(journal_of(some_bodies(), 1'000'000));
  const JournalVerdict verdict = verdict_of(good[0] + good[1] + other[2] + other[3]);
  ASSERT_TRUE(verdict.fault);
  EXPECT_EQ(verdict.fault->kind, JournalFaultKind::previous);
  EXPECT_EQ(verdict.fault->line, 3u);
}

TEST(JournalTamper, WholeLinesMissingAtTheEndCannotBeSeenFromTheFileAlone) {
  const auto good = lines_of(journal_of(some_bodies()));
  const JournalVerdict all = verdict_of(joined(good));
  const JournalVerdict fewer = verdict_of(good[0] + good[1]);
  EXPECT_TRUE(fewer.intact());
  EXPECT_NE(fewer.head, all.head) << "but whoever kept the head elsewhere sees it";
}

TEST(JournalTamper, WhatIsBehindAFaultIsStillShown) {
  const auto good = lines_of(journal_of(some_bodies()));
  std::size_t shown = 0;
  const JournalVerdict verdict = verdict_of(
      good[0] + "damaged\n" + good[2] + good[3],
      [&](const JournalEntry&, const JournalPlace& place) { shown += place.is_verified ? 100 : 1; });
  EXPECT_EQ(shown, 102u);
  EXPECT_EQ(verdict.fault->line, 2u);
}

TEST(JournalTamper, PiecesOfAnySizeGiveTheSame) {
  const std::string good = journal_of(some_bodies());
  const std::string broken = good.substr(0, 700) + "x" + good.substr(700) + "torn";
  for (const std::string& text : {good, broken})
    for (const std::size_t piece : {1u, 2u, 7u, 100u, 1000u}) {
      JournalScan scan;
      for (std::size_t from = 0; from < text.size(); from += piece)
        scan.feed(std::string_view(text).substr(from, piece));
      EXPECT_EQ(scan.finish().text(), verdict_of(text).text());
    }
}

TEST(JournalTamper, ALineLongerThanAllowedIsAFaultAndTakesNoMoreMemory) {
  const auto good = lines_of(journal_of(some_bodies()));
  const std::string mebibyte(1 << 20, 'x');
  std::size_t shown = 0;
  JournalScan scan([&](const JournalEntry&, const JournalPlace&) { ++shown; });
  scan.feed(good[0]);
  for (int k = 0; k < 200; ++k) scan.feed(mebibyte);
  scan.feed("\n" + good[1]);
  const JournalVerdict verdict = scan.finish();
  ASSERT_TRUE(verdict.fault);
  EXPECT_EQ(verdict.fault->kind, JournalFaultKind::too_long);
  EXPECT_EQ(verdict.fault->line, 2u);
  EXPECT_NE(verdict.text().find("209715201 bytes"), std::string::npos) << verdict.text();
  EXPECT_EQ(shown, 2u) << "lines behind it are found again";
}

// Bytes with a good hash that are no entry: only a writer's fault or a forger makes them.
TEST(JournalTamper, AGoodHashDoesNotMakeALineAnEntry) {
  const std::string line = lines_of(journal_of(some_bodies()))[0];
  const auto with = [&](const std::string& from, const std::string& to) {
    std::string head = line.substr(0, line.find(",\"hash\":"));
    head.replace(head.find(from), from.size(), to);
    const std::string hash = [&] {
      Sha256 sum;
      sum.add(std::as_bytes(std::span{head}));
      return sum.hex();
    }();
    return verdict_of(head + ",\"hash\":\"" + hash + "\"}\n");
  };
  EXPECT_TRUE(with("accepted", "refused").intact()) << "what a forger can do, as the README says";
  const std::string deep = std::string(400'000, '[') + std::string(400'000, ']');
  for (const auto& [from, to] :
       std::vector<std::pair<std::string, std::string>>{{"\"n\":1", "\"n\":-1"},
                                                        {"\"n\":1", "\"n\":1.0"},
                                                        {"1970-01", "1970-13"},
                                                        {"\"body\":{", "\"body\":[{"},
                                                        {"\"kind\"", "\"kinds\""},
                                                        {"0.707", "1e999"},
                                                        {"0.707", deep},
                                                        {"decision", "Decision"}}) {
    const JournalVerdict verdict = with(from, to);
    ASSERT_TRUE(verdict.fault) << to.substr(0, 100);
    EXPECT_EQ(verdict.fault->kind, JournalFaultKind::malformed) << to.substr(0, 100);
  }
}

TEST(JournalTamper, OtherFilesAreNoJournals) {
  for (const std::string text : {"[unit]\nnumber = 1\n", "[unit]", "{}\n", "{\"a\":1}\n",
                                 "\x7f"
                                 "ELF\n",
                                 "n\n"})
    EXPECT_FALSE(verdict_of(text).is_journal) << text;
  EXPECT_TRUE(verdict_of("").is_journal);
  EXPECT_TRUE(verdict_of("").intact()) << "one that was just created";
}

}  // namespace
}  // namespace weakgrid::test
