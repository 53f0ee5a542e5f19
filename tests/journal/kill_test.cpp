// kill -9 at any moment: every append that had returned is in the file, and the journal goes on. Prints what
// it measures.
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <random>

#include "tests/journal/journal_support.hpp"

namespace weakgrid::test {
namespace {

using nlohmann::json;
using std::chrono::duration;
using std::chrono::steady_clock;

std::uint32_t count_of(const char* variable, std::uint32_t otherwise) {
  const char* text = std::getenv(variable);
  return text != nullptr ? static_cast<std::uint32_t>(std::strtoul(text, nullptr, 10)) : otherwise;
}

// A line that crosses pages is what a kill can tear.
json body_of(std::uint64_t n) { return {{"of", n}, {"text", std::string(n * 7919 % 30'000, 'x')}}; }

// Appends until it is killed; says through the pipe which entries have been appended.
[[noreturn]] void append_forever(const std::string& path, int pipe) {
  try {
    Journal journal(path);
    while (true) {
      const std::uint64_t n = journal.entries() + 1;
      if (!journal.append("note", body_of(n))) _exit(2);
      if (write(pipe, &n, sizeof n) != sizeof n) _exit(3);
    }
  } catch (const std::exception& error) {
    std::fprintf(stderr, "the child: %s\n", error.what());
  }
  _exit(1);
}

// The last n that came through the pipe until its end.
std::uint64_t last_of(int pipe) {
  std::uint64_t n = 0, last = 0;
  while (read(pipe, &n, sizeof n) == sizeof n) last = n;
  return last;
}

// The n of the last append that had returned when it was killed after about `life`.
std::uint64_t run_and_kill(const std::string& path, std::chrono::microseconds life) {
  int ends[2];
  EXPECT_EQ(pipe(ends), 0);
  const pid_t child = fork();
  if (child == 0) {
    close(ends[0]);
    append_forever(path, ends[1]);
  }
  close(ends[1]);
  std::uint64_t last = 0;
  // From the first append on, so that start-up does not eat the time.
  EXPECT_EQ(read(ends[0], &last, sizeof last), static_cast<ssize_t>(sizeof last));
  std::thread killer([&] {
    std::this_thread::sleep_for(life);
    kill(child, SIGKILL);
  });
  last = std::max(last, last_of(ends[0]));
  killer.join();
  close(ends[0]);
  int status = 0;
  waitpid(child, &status, 0);
  EXPECT_TRUE(WIFSIGNALED(status) && WTERMSIG(status) == SIGKILL) << status;
  return last;
}

TEST(JournalKill, EveryAppendThatReturnedIsThereAndTheJournalGoesOn) {
  const std::uint32_t kills = count_of("WEAKGRID_LAW_COUNT", 50);
  const std::uint32_t seed = count_of("WEAKGRID_LAW_FIRST", std::random_device{}());
  std::printf("WEAKGRID_LAW_FIRST=%u\n", seed);
  SCOPED_TRACE("WEAKGRID_LAW_FIRST=" + std::to_string(seed));
  std::mt19937 random(seed);
  const Scratch folder;
  std::string path;
  std::uint64_t appended = 0, torn = 0;
  for (std::uint32_t k = 0; k < kills; ++k) {
    SCOPED_TRACE("kill " + std::to_string(k));
    // A new file now and then: else checking it takes ever longer.
    if (k % 5 == 0) path = folder / ("a" + std::to_string(k));
    const std::uint64_t last =
        run_and_kill(path, std::chrono::microseconds(std::uniform_int_distribution<int>(0, 15'000)(random)));
    const JournalVerdict left = read_journal(path);
    ASSERT_TRUE(left.intact() || left.fault->kind == JournalFaultKind::torn) << left.text();
    ASSERT_GE(left.entries, last) << "an append that had returned is not there";
    ASSERT_LE(left.entries, last + 1) << "an entry that nobody appended";
    torn += !left.intact();
    {
      Journal journal(path);
      EXPECT_TRUE(journal.append("start", json::object()));
      EXPECT_EQ(journal.entries(), left.entries + 1 + !left.intact());
    }
    for (const JournalEntry& entry : entries_of(path))
      ASSERT_TRUE(entry.kind != "note" || entry.body == body_of(entry.n)) << entry.n;
    appended += last;
  }
  std::printf("%u kills, %llu torn last lines set aside\n", kills, static_cast<unsigned long long>(torn));
  EXPECT_GT(appended, 0u);
}

double us(steady_clock::duration time) { return duration<double, std::micro>(time).count(); }

// On the disk of the build, not in memory. No claim beyond that all arrive: the figures are the machine's.
TEST(JournalKill, FiguresOfThisMachine) {
  const Scratch folder(std::filesystem::current_path());
  Journal journal(folder / "a.journal");
  const json body{{"client", 7},
                  {"id", 12},
                  {"p", 0.707},
                  {"q", -0.5},
                  {"current", -0.1326},
                  {"step", 1},
                  {"text", "refused: current limit"}};
  constexpr int count = 20'000, waits = 100;
  std::uint64_t behind = 0;
  const auto start = steady_clock::now();
  for (int k = 0; k < count; ++k) {
    ASSERT_TRUE(journal.append("decision", body));
    behind = std::max(behind, journal.unsynced());
  }
  const double appends_us = us(steady_clock::now() - start);
  ASSERT_TRUE(journal.sync());
  std::vector<double> lags;
  for (int k = 0; k < waits; ++k) {
    const auto appended = steady_clock::now();
    ASSERT_TRUE(journal.append("decision", body));
    ASSERT_TRUE(journal.sync());
    lags.push_back(us(steady_clock::now() - appended));
  }
  std::sort(lags.begin(), lags.end());
  const auto read_start = steady_clock::now();
  const JournalVerdict verdict = read_journal(folder / "a.journal");
  const double read_us = us(steady_clock::now() - read_start);
  EXPECT_EQ(verdict.entries, std::uint64_t{count + waits});
  std::printf(
      "append %.1f µs, %.0f/s, at most %llu not synced; append and sync: median %.0f µs, max %.0f µs; "
      "verified at %.1f MB/s\n",
      appends_us / count, count / appends_us * 1e6, static_cast<unsigned long long>(behind),
      lags[lags.size() / 2], lags.back(), static_cast<double>(verdict.bytes) / read_us);
}

}  // namespace
}  // namespace weakgrid::test
