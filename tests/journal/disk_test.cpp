// A disk that is full, slow or broken: append and sync say so, what was written stays whole, and it goes on
// as soon as it can.
#include <errno.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <atomic>
#include <chrono>

#include "tests/journal/journal_support.hpp"

namespace {

std::atomic<int> sync_error{0}, sync_ms{0}, syncs{0};

}  // namespace

/// In place of the C library's: a disk as the test wants it.
extern "C" int fdatasync(int file) {
  ++syncs;
  if (sync_ms > 0) std::this_thread::sleep_for(std::chrono::milliseconds(sync_ms));
  if (sync_error != 0) {
    errno = sync_error;
    return -1;
  }
  return static_cast<int>(syscall(SYS_fdatasync, file));
}

namespace weakgrid::test {
namespace {

using nlohmann::json;

/// Lets files grow to `bytes` only: write() then comes back short, and after that fails with EFBIG.
class FileSizeLimit {
 public:
  FileSizeLimit() {
    ::signal(SIGXFSZ, SIG_IGN);
    ::getrlimit(RLIMIT_FSIZE, &before_);
  }
  ~FileSizeLimit() { lift(); }
  FileSizeLimit(const FileSizeLimit&) = delete;
  FileSizeLimit& operator=(const FileSizeLimit&) = delete;
  void set(rlim_t bytes) {
    const rlimit limit{bytes, before_.rlim_max};
    ASSERT_EQ(::setrlimit(RLIMIT_FSIZE, &limit), 0);
  }
  void lift() { ::setrlimit(RLIMIT_FSIZE, &before_); }

 private:
  rlimit before_{};
};

struct Disk {
  ~Disk() { sync_error = sync_ms = 0; }
};

TEST(JournalDisk, WhereTheDiskEndsAppendSaysNoTheFileStaysWholeAndGoesOnWhenThereIsRoom) {
  const std::size_t line = journal_line(1, 0, "note", {{"k", 1}}, journal_beginning())->bytes.size();
  for (std::size_t room = 0; room < line; ++room) {
    SCOPED_TRACE(std::to_string(room) + " bytes of room");
    const Scratch folder;
    const std::string path = folder / "a.journal";
    Journal journal(path);
    ASSERT_TRUE(journal.append("note", {{"k", 1}}));
    const std::string before = text_of(path);
    FileSizeLimit limit;
    limit.set(before.size() + room);
    EXPECT_FALSE(journal.append("note", {{"k", 2}}));
    EXPECT_NE(journal.fault(), "");
    EXPECT_FALSE(journal.append("note", {{"k", 3}}));
    EXPECT_EQ(journal.refused(), 2u);
    EXPECT_EQ(text_of(path), before) << "no part of a line stays";
    EXPECT_TRUE(verdict_of(text_of(path)).intact());
    EXPECT_TRUE(journal.sync()) << "what is there can be synced";
    limit.lift();
    EXPECT_TRUE(journal.append("note", {{"k", 4}})) << journal.fault();
    EXPECT_EQ(journal.fault(), "");
    const auto entries = entries_of(path);
    ASSERT_EQ(entries.size(), 3u);
    EXPECT_EQ(entries[1].kind, "lost");
    EXPECT_EQ(entries[1].body["entries"], 2);
    EXPECT_EQ(entries[2].body["k"], 4);
  }
}

TEST(JournalDisk, AShortEntryThatFitsIsStillNotWrittenBeforeTheGapIsSaid) {
  const Scratch folder;
  const std::string path = folder / "a.journal";
  Journal journal(path);
  FileSizeLimit limit;
  limit.set(400);
  EXPECT_FALSE(journal.append("note", {{"text", std::string(1000, 'x')}}));
  EXPECT_FALSE(journal.append("note", json::object()) && entries_of(path)[0].kind != "lost");
  limit.lift();
  EXPECT_TRUE(journal.append("note", json::object()));
  EXPECT_EQ(entries_of(path)[0].kind, "lost");
}

TEST(JournalDisk, ATornTailOnAFullDiskIsNotThrownAway) {
  const Scratch folder;
  const std::string path = folder / "a.journal";
  const std::string torn = journal_of(some_bodies()) + std::string(2000, '\0');
  write_text(path, torn);
  FileSizeLimit limit;
  limit.set(1000);
  EXPECT_NE(refusal_of(path).find(".torn-1: a torn last line cannot be kept: "), std::string::npos)
      << refusal_of(path);
  EXPECT_EQ(text_of(path), torn);
  limit.lift();
  EXPECT_EQ(refusal_of(path), "");
  EXPECT_EQ(entries_of(path).size(), some_bodies().size() + 1);
}

TEST(JournalDisk, WhoeverChangesOrRemovesTheFileMeanwhileIsNotFollowed) {
  for (const bool removes : {false, true}) {
    const Scratch folder;
    const std::string path = folder / "a.journal";
    Journal journal(path);
    ASSERT_TRUE(journal.append("note", json::object()));
    if (removes)
      std::filesystem::remove(path);
    else
      write_text(path, text_of(path) + "by hand\n");
    EXPECT_FALSE(journal.append("note", json::object()));
    EXPECT_NE(journal.fault().find(removes ? "removed" : "somebody else changed"), std::string::npos)
        << journal.fault();
  }
}

TEST(JournalDisk, ASlowDiskHoldsUpNobodyAndOneSyncCoversMany) {
  const Disk disk;
  const Scratch folder;
  Journal journal(folder / "a.journal");
  sync_ms = 300;
  syncs = 0;
  const auto start = std::chrono::steady_clock::now();
  for (int k = 0; k < 1000; ++k) ASSERT_TRUE(journal.append("note", {{"k", k}}));
  const auto appended = std::chrono::steady_clock::now() - start;
  EXPECT_GT(journal.unsynced(), 0u);
  EXPECT_TRUE(journal.sync());
  EXPECT_EQ(journal.unsynced(), 0u);
  EXPECT_LE(syncs, 2 + appended / std::chrono::milliseconds(300));
}

TEST(JournalDisk, SyncReturnsOnlyWhenEverythingBeforeItIsOnDisk) {
  const Disk disk;
  const Scratch folder;
  Journal journal(folder / "a.journal");
  sync_ms = 20;
  for (int k = 0; k < 20; ++k) {
    ASSERT_TRUE(journal.append("note", {{"k", k}}));
    EXPECT_EQ(journal.unsynced(), 1u);
    EXPECT_TRUE(journal.sync());
    EXPECT_EQ(journal.unsynced(), 0u);
  }
}

TEST(JournalDisk, ADiskThatOnceFailedToSyncIsNotBelievedAgainUntilTheJournalIsOpenedAnew) {
  const Disk disk;
  const Scratch folder;
  const std::string path = folder / "a.journal";
  {
    Journal journal(path);
    ASSERT_TRUE(journal.append("note", {{"k", 1}}));
    ASSERT_TRUE(journal.sync());
    sync_error = EIO;
    EXPECT_TRUE(journal.append("note", {{"k", 2}})) << "goes on";
    EXPECT_FALSE(journal.sync());
    sync_error = 0;
    EXPECT_TRUE(journal.append("note", {{"k", 3}}));
    EXPECT_FALSE(journal.sync());
    EXPECT_EQ(journal.unsynced(), 2u);
    EXPECT_EQ(journal.fault(), "cannot be synced: Input/output error");
  }
  Journal again(path);
  EXPECT_EQ(again.entries(), 3u);
  EXPECT_TRUE(again.sync());
}

}  // namespace
}  // namespace weakgrid::test
