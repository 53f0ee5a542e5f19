// What is appended is what is read, and what a stranger verifies with standard tools.
#include <bit>
#include <cmath>
#include <cstdlib>
#include <limits>
#include <random>
#include <set>

#include "tests/journal/journal_support.hpp"

namespace weakgrid::test {
namespace {

using nlohmann::json;

// The only entry after appending this body.
json after_round_trip(const json& body) {
  const Scratch folder;
  {
    Journal journal(folder / "a.journal");
    EXPECT_TRUE(journal.append("note", body)) << journal.fault();
  }
  const auto entries = entries_of(folder / "a.journal");
  EXPECT_EQ(entries.size(), 1u);
  return entries.empty() ? json() : entries[0].body;
}

TEST(JournalAppend, AnEntryIsOneLineOfTheDocumentedShape) {
  const Scratch folder;
  {
    Journal journal(folder / "a.journal");
    ASSERT_TRUE(journal.append("decision", {{"p", 0.5}}));
    ASSERT_TRUE(journal.append("trip", json::object()));
    EXPECT_EQ(journal.entries(), 2u);
  }
  const auto lines = lines_of(text_of(folder / "a.journal"));
  ASSERT_EQ(lines.size(), 2u);
  const json first = json::parse(lines[0]);
  const std::string time = first["time"], hash = first["hash"];
  EXPECT_TRUE(is_journal_time(time)) << time;
  EXPECT_EQ(lines[0], R"({"n":1,"time":")" + time + R"(","kind":"decision","body":{"p":0.5},"previous":")" +
                          std::string(64, '0') + R"(","hash":")" + hash + "\"}\n");
  EXPECT_EQ(json::parse(lines[1])["previous"], hash);
}

TEST(JournalAppend, StrangeTextsComeBackAsTheyWere) {
  std::string every;
  for (int c = 0; c < 128; ++c) every += static_cast<char>(c);
  for (const std::string& text : {std::string(), every, std::string("\n{\"n\":1}\n"), std::string("µ λ 電 🜚"),
                                  std::string(",\"hash\":\""), std::string(100'000, '"')}) {
    const json body{{"text", text}, {text, 1}};
    EXPECT_TRUE(after_round_trip(body) == body) << text.substr(0, 100);
  }
}

TEST(JournalAppend, WhatIsNotUtf8IsReplacedAndDoesNotBreakTheLine) {
  EXPECT_EQ(after_round_trip({{"text", "a\xff\xc2z"}}), (json{{"text", "a\xef\xbf\xbd\xef\xbf\xbdz"}}));
}

TEST(JournalAppend, NumbersComeBackToTheLastBit) {
  json numbers =
      json::array({0.1, -0.0, 5e-324, std::numeric_limits<double>::max(), 0.1 + 0.2, 1e23,
                   std::numeric_limits<std::uint64_t>::max(), std::numeric_limits<std::int64_t>::min()});
  std::mt19937_64 random(1);
  while (numbers.size() < 5000) {
    const auto number = std::bit_cast<double>(random());
    if (std::isfinite(number)) numbers.push_back(number);
  }
  const json back = after_round_trip({{"numbers", numbers}})["numbers"];
  ASSERT_EQ(back.size(), numbers.size());
  for (std::size_t k = 0; k < numbers.size(); ++k) {
    EXPECT_EQ(back[k].type(), numbers[k].type());
    if (numbers[k].is_number_float()) {
      EXPECT_EQ(std::bit_cast<std::uint64_t>(back[k].get<double>()),
                std::bit_cast<std::uint64_t>(numbers[k].get<double>()))
          << numbers[k];
    } else {
      EXPECT_EQ(back[k], numbers[k]);
    }
  }
}

TEST(JournalAppend, WhatIsNoNumberIsSaidInWords) {
  const double inf = std::numeric_limits<double>::infinity();
  EXPECT_EQ(after_round_trip({{"margins", {{"a", std::nan("")}, {"b", {inf, -inf, 1.5}}}}}),
            (json{{"margins", {{"a", "nan"}, {"b", {"inf", "-inf", 1.5}}}}}));
}

TEST(JournalAppend, WhatIsNoEntryIsRefusedAndTheCountOfThoseIsWritten) {
  const Scratch folder;
  Journal journal(folder / "a.journal");
  json deep = 1;
  for (int k = 0; k < journal_depth_max; ++k) deep = json{{"a", deep}};
  EXPECT_TRUE(journal.append("note", deep));
  EXPECT_FALSE(journal.append("note", {{"a", deep}}));
  EXPECT_FALSE(journal.append("note", {{"text", std::string(journal_line_bytes_max, 'x')}}));
  EXPECT_FALSE(journal.append("note", json::array()));
  EXPECT_FALSE(journal.append("no\"te", json::object()));
  EXPECT_FALSE(journal.append("", json::object()));
  EXPECT_EQ(journal.refused(), 5u);
  EXPECT_NE(journal.fault().find("kind"), std::string::npos);
  EXPECT_TRUE(journal.append("note", json::object()));
  EXPECT_EQ(journal.fault(), "");
  const auto entries = entries_of(folder / "a.journal");
  ASSERT_EQ(entries.size(), 3u);
  EXPECT_EQ(entries[1].kind, "lost");
  EXPECT_EQ(entries[1].body["entries"], 5);
}

TEST(JournalAppend, TheLongestLineAllowedCanBeReadAndOneMoreByteCannotBeWritten) {
  const Scratch folder;
  Journal journal(folder / "a.journal");
  const std::size_t frame = journal_line(1, 0, "note", {{"text", ""}}, journal_beginning())->bytes.size();
  const std::string text(journal_line_bytes_max - frame, 'x');
  EXPECT_FALSE(journal.append("note", {{"text", text + 'x'}}));
  const Scratch other;
  Journal long_journal(other / "a.journal");
  EXPECT_TRUE(long_journal.append("note", {{"text", text}}));
  EXPECT_EQ(entries_of(other / "a.journal").size(), 1u);
}

TEST(JournalAppend, AJournalGoesOnWhereItEnded) {
  const Scratch folder;
  std::string head;
  for (std::uint64_t round = 1; round <= 5; ++round) {
    Journal journal(folder / "a.journal");
    EXPECT_EQ(journal.entries(), round - 1);
    EXPECT_EQ(journal.head(), round == 1 ? journal_beginning() : head);
    EXPECT_TRUE(journal.append("start", {{"round", round}}));
    head = journal.head();
  }
  const auto entries = entries_of(folder / "a.journal");
  ASSERT_EQ(entries.size(), 5u);
  EXPECT_EQ(entries[4].body["round"], 5);
  EXPECT_EQ(entries[4].hash, head);
}

TEST(JournalAppend, ThreadsAppendOneAfterTheOther) {
  const Scratch folder;
  {
    Journal journal(folder / "a.journal");
    std::vector<std::thread> threads;
    for (int t = 0; t < 4; ++t)
      threads.emplace_back([&journal, t] {
        for (int k = 0; k < 250; ++k) EXPECT_TRUE(journal.append("note", {{"thread", t}, {"k", k}}));
      });
    for (std::thread& thread : threads) thread.join();
    EXPECT_TRUE(journal.sync());
    EXPECT_EQ(journal.unsynced(), 0u);
  }
  std::set<std::pair<int, int>> seen;
  for (const JournalEntry& entry : entries_of(folder / "a.journal"))
    seen.emplace(entry.body["thread"], entry.body["k"]);
  EXPECT_EQ(seen.size(), 1000u);
}

TEST(JournalAppend, TimesAreUtcWithNineDigits) {
  EXPECT_EQ(journal_time(1'795'378'422'123'456'789), "2026-11-22T20:13:42.123456789Z");
  EXPECT_EQ(journal_time(0), "1970-01-01T00:00:00.000000000Z");
  for (const char* good : {"2026", "2026-11", "2026-11-22", "2026-11-22T20", "2026-11-22T20:13:42",
                           "2026-11-22T20:13:42Z", "2026-11-22T20:13:42.1", "2026-11-22T20:13:42.12Z"})
    EXPECT_TRUE(is_journal_time(good)) << good;
  for (const char* bad :
       {"", "202", "2026-", "2026-13", "2026-11-22 20:13", "2026-11-22T24", "2026-11-22T20Z",
        "2026-11-22T20:13:42.", "2026-11-22T20:13:42.1234567890Z", "yesterday"})
    EXPECT_FALSE(is_journal_time(bad)) << bad;
}

// The recipes of services/journal/README.md, as they stand there.
std::string recipe(const std::string& begin) {
  const std::string text = text_of(WEAKGRID_JOURNAL_README);
  const std::size_t from = text.find(begin);
  EXPECT_NE(from, std::string::npos) << begin;
  std::istringstream lines(text.substr(from));
  std::string code;
  for (std::string line; std::getline(lines, line) && (code.empty() || line.starts_with("    "));)
    code += line.substr(code.empty() ? 0 : 4) + '\n';
  return code;
}

TEST(JournalAppend, StandardToolsVerifyTheChainAsTheReadmeSays) {
  const Scratch folder;
  const std::string text = journal_of(some_bodies());
  const auto says_well = [&](const std::string& script, const std::string& journal) {
    write_text(folder / "gateway.journal", journal);
    write_text(folder / "check", script);
    return std::system(("cd " + folder / "." + " && bash ./check > out 2>&1").c_str()) == 0;
  };
  std::string changed = text;
  changed[changed.find("0.707") + 2] = '8';
  for (const char* begin : {"python3 - gateway.journal", "previous=$(printf"}) {
    const std::string script = recipe(begin);
    EXPECT_TRUE(says_well(script, text)) << text_of(folder / "out");
    EXPECT_FALSE(says_well(script, changed)) << begin;
    const auto lines = lines_of(text);
    EXPECT_FALSE(says_well(script, lines[0] + lines[2] + lines[3])) << begin;
  }
}

}  // namespace
}  // namespace weakgrid::test
