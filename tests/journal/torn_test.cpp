// A crash in the middle of a write leaves a torn last line: it is set aside, said, and the journal goes on. A
// break before that is another matter.
#include <sys/stat.h>
#include <unistd.h>

#include "tests/journal/journal_support.hpp"

namespace weakgrid::test {
namespace {

TEST(JournalTorn, ATailTornAtAnyByteIsSetAsideAndTheJournalGoesOn) {
  const std::string good = journal_of(some_bodies());
  for (std::size_t size = 0; size <= good.size(); ++size) {
    SCOPED_TRACE("cut to " + std::to_string(size) + " bytes");
    const Scratch folder;
    const std::string path = folder / "a.journal";
    write_text(path, good.substr(0, size));
    const std::size_t whole = size == 0 ? 0 : good.rfind('\n', size - 1) + 1;
    const bool is_torn = whole < size;
    const auto lines = lines_of(good.substr(0, whole)).size();
    {
      Journal journal(path);
      EXPECT_TRUE(journal.append("start", {{"a", 1}}));
    }
    const auto entries = entries_of(path);
    ASSERT_EQ(entries.size(), lines + is_torn + 1);
    EXPECT_TRUE(text_of(path).starts_with(good.substr(0, whole)));
    EXPECT_EQ(std::filesystem::exists(path + ".torn-1"), is_torn);
    if (!is_torn) continue;
    EXPECT_EQ(text_of(path + ".torn-1"), good.substr(whole, size - whole));
    EXPECT_EQ(entries[lines].kind, "recovered");
    EXPECT_EQ(entries[lines].body["bytes"], size - whole);
    EXPECT_EQ(entries[lines].body["set_aside"], "a.journal.torn-1");
  }
}

TEST(JournalTorn, OneTornLineAfterTheOtherIsKept) {
  const Scratch folder;
  const std::string path = folder / "a.journal";
  for (const char* torn : {"{\"n\":1,", "{\"n\"", "garbage"}) {
    write_text(path, text_of(path) + torn);
    EXPECT_EQ(refusal_of(path), "");
  }
  EXPECT_EQ(text_of(path + ".torn-1"), "{\"n\":1,");
  EXPECT_EQ(text_of(path + ".torn-3"), "garbage");
  EXPECT_EQ(entries_of(path).size(), 3u);
}

TEST(JournalTorn, ZerosOfAPowerCutAreATornTailHoweverMany) {
  const Scratch folder;
  const std::string good = journal_of(some_bodies());
  for (const std::string& whole : {good, std::string()}) {
    const std::string path = folder / (whole.empty() ? "empty" : "a.journal");
    write_text(path, whole + std::string(5'000'000, '\0'));
    EXPECT_EQ(refusal_of(path), "");
    EXPECT_EQ(std::filesystem::file_size(path + ".torn-1"), 5'000'000u);
    EXPECT_EQ(entries_of(path).size(), lines_of(whole).size() + 1);
  }
}

TEST(JournalTorn, ABreakInTheMiddleIsRefusedWithItsPlaceAndNothingIsTouched) {
  const Scratch folder;
  const std::string path = folder / "a.journal";
  std::string broken = journal_of(some_bodies()) + "torn too";
  const std::size_t second = broken.find('\n') + 1;
  broken[second + 100] = static_cast<char>(broken[second + 100] ^ 1);
  write_text(path, broken);
  EXPECT_THROW(Journal{path}, SettingsError);
  const std::string said = refusal_of(path);
  EXPECT_NE(said.find(path + ": line 2, byte " + std::to_string(second) + ": its hash differs"),
            std::string::npos)
      << said;
  EXPECT_EQ(text_of(path), broken);
  EXPECT_FALSE(std::filesystem::exists(path + ".torn-1"));
}

TEST(JournalTorn, WhatIsNoJournalIsRefusedAndNotTouched) {
  const Scratch folder;
  for (const std::string text : {"[unit]\nnumber = 1\n", "one line without an end"}) {
    write_text(folder / "a", text);
    EXPECT_THROW(Journal{folder / "a"}, SettingsError);
    EXPECT_NE(refusal_of(folder / "a").find("is not a journal"), std::string::npos);
    EXPECT_EQ(text_of(folder / "a"), text);
  }
  ASSERT_EQ(mkfifo((folder / "pipe").c_str(), 0600), 0);
  EXPECT_NE(refusal_of(folder / "pipe").find("is not a file"), std::string::npos);
  EXPECT_NE(refusal_of(folder / ".").find("Is a directory"), std::string::npos) << refusal_of(folder / ".");
}

TEST(JournalTorn, ASecondWriterIsRefusedUntilTheFirstIsGone) {
  const Scratch folder;
  const std::string path = folder / "a.journal";
  {
    Journal first(path);
    ASSERT_TRUE(first.append("start", nlohmann::json::object()));
    EXPECT_EQ(refusal_of(path), path + ": another process writes this journal; only one can");
    EXPECT_TRUE(first.append("note", nlohmann::json::object()));
    EXPECT_EQ(entries_of(path).size(), 2u) << "readers are in nobody's way";
  }
  EXPECT_EQ(refusal_of(path), "");
}

TEST(JournalTorn, AFolderThatIsNotThereOrMayNotBeWrittenIsSaid) {
  const Scratch folder;
  EXPECT_EQ(
      refusal_of(folder / "none/a.journal"),
      folder / "none/a.journal" + ": the journal cannot be opened for writing: No such file or directory");
  // Root may write everywhere but here.
  const std::string read_only = getuid() == 0 ? "/proc/self/a.journal" : folder / "closed/a.journal";
  std::filesystem::create_directory(folder / "closed");
  std::filesystem::permissions(folder / "closed", std::filesystem::perms::owner_read);
  EXPECT_TRUE(refusal_of(read_only).starts_with(read_only + ": the journal cannot be opened for writing: "))
      << refusal_of(read_only);
}

}  // namespace
}  // namespace weakgrid::test
