// weakgrid journal: what it shows, what it finds, and its exit status. No network.
#include <atomic>
#include <limits>

#include "tests/journal/journal_support.hpp"
#include "tests/support/processes_under_test.hpp"

namespace weakgrid::test {
namespace {

using nlohmann::json;

constexpr std::uint64_t evening_ns = 1'795'378'422'123'456'789;  // 2026-11-22T20:13:42.123456789Z
constexpr std::uint64_t hour_ns = 3'600'000'000'000;

/// Four entries, an hour apart.
struct Command : testing::Test {
  Scratch folder;
  std::string path = folder / "a.journal";
  std::vector<std::string> hashes;

  Command() {
    std::string text, previous = journal_beginning();
    const std::vector<std::pair<std::string, json>> entries{
        {"request", {{"client", 7}, {"p", 0.5}}},
        {"decision", {{"client", 7}, {"text", "refused: \"current\"\nlimit \x1b[31m\u009b"}}},
        {"trip", {{"text", "overcurrent"}}},
        {"request", {{"client", "seven"}, {"margin", std::numeric_limits<double>::infinity()}}}};
    for (const auto& [kind, body] : entries) {
      const auto line =
          journal_line(hashes.size() + 1, evening_ns + hashes.size() * hour_ns, kind, body, previous);
      text += line->bytes;
      hashes.push_back(previous = line->hash);
    }
    write_text(path, text);
  }
  Ended journal(std::vector<std::string> arguments) const {
    arguments.insert(arguments.begin(), {"journal", path});
    return run("weakgrid", arguments);
  }
  /// The n of those shown.
  std::vector<int> shown(std::vector<std::string> arguments, int status = 0) const {
    arguments.push_back("--json");
    const Ended ended = journal(arguments);
    EXPECT_EQ(ended.status, status) << ended.err;
    std::vector<int> numbers;
    for (const std::string& line : lines_of(ended.out)) numbers.push_back(json::parse(line)["n"]);
    return numbers;
  }
  /// Flips a bit of the third line.
  std::size_t break_third() const {
    std::string text = text_of(path);
    const auto lines = lines_of(text);
    const std::size_t third = lines[0].size() + lines[1].size();
    text[third + 80] = static_cast<char>(text[third + 80] ^ 1);
    write_text(path, text);
    return third;
  }
};

using Numbers = std::vector<int>;

TEST_F(Command, EntriesAreOnePlainLineEach) {
  const Ended ended = journal({});
  EXPECT_EQ(ended.status, 0);
  EXPECT_EQ(ended.err, "");
  EXPECT_EQ(
      ended.out,
      "2026-11-22T20:13:42.123456789Z      1 request    {\"client\":7,\"p\":0.5}\n"
      "2026-11-22T21:13:42.123456789Z      2 decision   refused: \"current\"\\x0alimit \\x1b[31m\\u009b\n"
      "2026-11-22T22:13:42.123456789Z      3 trip       overcurrent\n"
      "2026-11-22T23:13:42.123456789Z      4 request    {\"client\":\"seven\",\"margin\":\"inf\"}\n");
}

TEST_F(Command, EntriesAreChosenByKindTimeClientAndFromTheEnd) {
  EXPECT_EQ(shown({}), (Numbers{1, 2, 3, 4}));
  EXPECT_EQ(shown({"--kind", "request"}), (Numbers{1, 4}));
  EXPECT_EQ(shown({"--kind", "request", "--kind", "trip"}), (Numbers{1, 3, 4}));
  EXPECT_EQ(shown({"--since", "2026-11-22T21"}), (Numbers{2, 3, 4}));
  EXPECT_EQ(shown({"--since", "2026-11-22T21:13:42.123456789Z"}), (Numbers{2, 3, 4}));
  EXPECT_EQ(shown({"--since", "2026-11-22T21:13:42.2Z"}), (Numbers{3, 4}));
  EXPECT_EQ(shown({"--until", "2026-11-22T21"}), (Numbers{1, 2}));
  EXPECT_EQ(shown({"--since", "2026-11-22", "--until", "2026-11-22"}), (Numbers{1, 2, 3, 4}));
  EXPECT_EQ(shown({"--client", "7"}), (Numbers{1, 2}));
  EXPECT_EQ(shown({"--client", "seven"}), (Numbers{4}));
  EXPECT_EQ(shown({"--last", "2"}), (Numbers{3, 4}));
  EXPECT_EQ(shown({"--last", "1", "--kind", "decision"}), (Numbers{2}));
  EXPECT_EQ(shown({"--last", "100"}), (Numbers{1, 2, 3, 4}));
  EXPECT_EQ(shown({"--kind", "none"}), Numbers{});
}

TEST_F(Command, JsonLinesOfAnIntactJournalAreItsLines) { EXPECT_EQ(journal({"--json"}).out, text_of(path)); }

TEST_F(Command, AnIntactJournalVerifiesAndGivesItsHead) {
  const Ended ended = journal({"--verify"});
  EXPECT_EQ(ended.status, 0);
  EXPECT_EQ(ended.out, "intact: 4 entries, " + std::to_string(text_of(path).size()) + " bytes\nhead " +
                           hashes.back() + "\n");
  const json verdict = json::parse(journal({"--verify", "--json"}).out);
  EXPECT_EQ(verdict["state"], "intact");
  EXPECT_EQ(verdict["entries"], 4);
  EXPECT_EQ(verdict["head"], hashes.back());
  EXPECT_TRUE(verdict["fault"].is_null());
}

TEST_F(Command, OfABrokenJournalTheFaultIsNamedAndWhatFollowsIsMarked) {
  const std::size_t third = break_third();
  const std::string fault = "line 3, byte " + std::to_string(third) + ": its hash differs";
  const Ended shown_all = journal({});
  EXPECT_EQ(shown_all.status, 1);
  EXPECT_NE(shown_all.err.find(path + ": " + fault), std::string::npos) << shown_all.err;
  const auto lines = lines_of(shown_all.out);
  ASSERT_EQ(lines.size(), 4u);
  for (std::size_t k = 0; k < 4; ++k) EXPECT_EQ(lines[k].ends_with("[unverified]\n"), k >= 2) << lines[k];

  const Ended verified = journal({"--verify"});
  EXPECT_EQ(verified.status, 1);
  EXPECT_TRUE(verified.out.starts_with("broken: " + fault)) << verified.out;
  EXPECT_NE(verified.out.find("head " + hashes[1]), std::string::npos) << "of the last intact entry";

  const Ended as_json = journal({"--verify", "--json"});
  EXPECT_EQ(as_json.status, 1);
  const json verdict = json::parse(as_json.out);
  EXPECT_EQ(verdict["state"], "broken");
  EXPECT_EQ(verdict["fault"]["line"], 3);
  EXPECT_EQ(verdict["fault"]["byte"], third);
  EXPECT_EQ(verdict["fault"]["kind"], "hash");
  EXPECT_EQ(verdict["unverified"], 2);

  const auto unverified = lines_of(journal({"--json"}).out);
  ASSERT_EQ(unverified.size(), 4u);
  EXPECT_FALSE(json::parse(unverified[1]).contains("unverified"));
  EXPECT_EQ(json::parse(unverified[3])["unverified"], true);
}

TEST_F(Command, LinesMissingAtTheEndAreFoundByAHeadThatWasKept) {
  EXPECT_EQ(journal({"--expect-hash", hashes[1]}).status, 0) << "the journal has grown since";
  const auto lines = lines_of(text_of(path));
  write_text(path, lines[0] + lines[1]);
  EXPECT_EQ(journal({"--verify"}).status, 0);
  const Ended ended = journal({"--verify", "--expect-hash", hashes[3]});
  EXPECT_EQ(ended.status, 1);
  EXPECT_NE(ended.out.find("the expected hash is of none"), std::string::npos) << ended.out;
  const Ended as_json = journal({"--expect-hash", hashes[3], "--json"});
  EXPECT_EQ(json::parse(as_json.out)["expected"]["found"], false);
}

TEST_F(Command, ATornTailIsAFaultAndNothingIsChanged) {
  const std::string torn = text_of(path) + "{\"n\":5,";
  write_text(path, torn);
  const Ended ended = journal({"--verify"});
  EXPECT_EQ(ended.status, 1);
  EXPECT_NE(ended.out.find("line 5"), std::string::npos);
  EXPECT_NE(ended.out.find("torn"), std::string::npos);
  EXPECT_EQ(text_of(path), torn);
}

TEST_F(Command, AJournalThatIsBeingWrittenIsNotTakenForATornOne) {
  Journal journal_file(path);
  std::atomic<bool> stopping = false;
  // Bounded: whatever goes wrong with the reader, a test does not fill the disk. Paced, so that it lasts.
  std::thread writer([&] {
    for (int k = 0; k < 1000 && !stopping; ++k) {
      EXPECT_TRUE(journal_file.append("note", {{"text", std::string(50'000, 'x')}}));
      std::this_thread::sleep_for(milliseconds(1));
    }
  });
  for (int k = 0; k < 5; ++k) {
    const Ended ended = journal({"--verify"});
    EXPECT_EQ(ended.status, 0) << ended.out;
  }
  stopping = true;
  writer.join();
}

TEST_F(Command, BadUsageIsNamedWithWhatIsAllowed) {
  const std::vector<std::pair<std::vector<std::string>, std::string>> cases{
      {{"--since", "yesterday"}, "--since yesterday: must be a UTC time like"},
      {{"--until", "2026-13"}, "--until 2026-13: must be a UTC time like"},
      {{"--expect-hash", "abc"}, "--expect-hash abc: must be 64 hexadecimal digits"},
      {{"--last", "0"}, "--last"},
      {{"--nonsense"}, "--nonsense"}};
  for (const auto& [arguments, said] : cases) {
    const Ended ended = journal(arguments);
    EXPECT_EQ(ended.status, 2) << said;
    EXPECT_NE(ended.err.find(said), std::string::npos) << ended.err;
  }
  write_text(path, "[unit]\nnumber = 1\n");
  const Ended ended = journal({"--verify"});
  EXPECT_EQ(ended.status, 2);
  EXPECT_NE(ended.err.find(path + ": is not a journal"), std::string::npos) << ended.err;
}

TEST_F(Command, WhatCannotBeReadIsTheWorldsFault) {
  EXPECT_EQ(run("weakgrid", {"journal", folder / "none"}).status, 3);
  const Ended ended = run("weakgrid", {"journal", folder / "."});
  EXPECT_EQ(ended.status, 3);
  EXPECT_NE(ended.err.find("cannot be read: Is a directory"), std::string::npos) << ended.err;
}

TEST_F(Command, AnEmptyJournalIsIntact) {
  write_text(path, "");
  const Ended ended = journal({"--verify"});
  EXPECT_EQ(ended.status, 0);
  EXPECT_EQ(ended.out, "intact: 0 entries, 0 bytes\nhead " + journal_beginning() + "\n");
}

}  // namespace
}  // namespace weakgrid::test
