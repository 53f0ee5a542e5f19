// weakgrid sweep, the real program: its file is the same however often it is killed and by however many
// threads it is made. No network.
#include <gtest/gtest.h>
#include <signal.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <random>
#include <set>
#include <sstream>

#include "services/runtime/settings.hpp"
#include "tests/support/processes_under_test.hpp"

namespace weakgrid {
namespace {

using Words = std::vector<std::string>;

std::uint64_t count_of(const char* variable, std::uint64_t otherwise) {
  const char* text = std::getenv(variable);
  return text != nullptr ? std::strtoull(text, nullptr, 10) : otherwise;
}

// Short: what a run is worth is tested elsewhere.
const std::string scenario =
    "[grid]\nreactance = 0.3\n[scenario]\nend_s = 0.06\n"
    "[[scenario.setpoint]]\nat_s = 0.01\nactive_power = 0.5\ndc_voltage = 1.8\n"
    "[[scenario.setpoint]]\nat_s = 0.02\nreactive_power = 0.2\n";

std::string text_of(const std::string& path) {
  std::ostringstream text;
  text << std::ifstream(path, std::ios::binary).rdbuf();
  return text.str();
}

void write_text(const std::string& path, const std::string& text) {
  std::ofstream(path, std::ios::binary) << text;
}

// Whole lines without the head, as they stand.
Words lines_of(const std::string& text) {
  Words rows;
  for (std::size_t from = 0, end; (end = text.find('\n', from)) != text.npos; from = end + 1)
    if (std::isdigit(static_cast<unsigned char>(text[from]))) rows.push_back(text.substr(from, end - from));
  return rows;
}
std::set<std::string> rows_of(const std::string& text) {
  const Words rows = lines_of(text);
  return {rows.begin(), rows.end()};
}

// Of a life that began with `there` rows: no run was begun before all but `jobs` of those begun before it
// were in the file. Runs are begun in their order, so it shows in that of the rows.
void expect_at_most_under_way(const Words& rows, std::size_t there, std::uint64_t runs, std::size_t jobs) {
  std::set<std::uint64_t> missing;
  for (std::uint64_t n = 0; n < runs; ++n) missing.insert(n);
  for (std::size_t k = 0; k < rows.size(); ++k) {
    const auto row = missing.find(std::stoull(rows[k]));
    ASSERT_NE(row, missing.end()) << "twice: " << rows[k];
    const auto older = static_cast<std::size_t>(std::distance(missing.begin(), row));
    EXPECT_TRUE(k < there || older < jobs) << rows[k];
    missing.erase(row);
  }
}

class Sweep : public testing::Test {
 protected:
  ~Sweep() override {
    for (const char* name : {"one", "other", "one.sorted", "other.sorted"})
      std::filesystem::remove(path(name));
  }
  std::string path(const std::string& name) const { return base_.path() + "." + name; }
  // A sweep of `runs` draws.
  Words arguments(std::uint64_t runs, const std::string& name, unsigned jobs) const {
    return {"sweep",    base_.path(),
            "--vary",   "grid.reactance=0.05:0.35",
            "--vary",   "setpoint.active_power=-0.9:0.9",
            "--vary",   "controller.law=filtered,unfiltered",
            "--random", std::to_string(runs),
            "-o",       path(name),
            "--jobs",   std::to_string(jobs)};
  }
  test::Ended sweep(std::uint64_t runs, const std::string& name, unsigned jobs) {
    return test::run("weakgrid", arguments(runs, name, jobs), milliseconds(1'800'000));
  }
  // Does not end while a test looks at it.
  Words long_sweep() const {
    Words all = arguments(400, "one", 2);
    all.insert(all.end(), {"--vary", "scenario.end_s=10"});
    return all;
  }
  using milliseconds = std::chrono::milliseconds;

  const test::TextFile base_{scenario};
};

TEST_F(Sweep, TheFileIsTheSameWhateverTheNumberOfThreads) {
  ASSERT_EQ(sweep(40, "one", 1).status, 0);
  ASSERT_EQ(sweep(40, "other", 4).status, 0);
  const std::string text = text_of(path("one"));
  EXPECT_EQ(text, text_of(path("other")));
  EXPECT_EQ(rows_of(text).size(), 40u);
  EXPECT_NE(text.find("\n39,"), std::string::npos);
  const test::Ended again = sweep(40, "one", 2);
  EXPECT_EQ(again.status, 0);
  EXPECT_NE(again.err.find("40 of 40 runs are there"), std::string::npos) << again.err;
  EXPECT_EQ(text_of(path("one")), text) << "a whole sweep is not changed";
}

TEST_F(Sweep, ARowSaysWhatSimulateSays) {
  Settings settings = parse_settings(scenario, "base");
  settings.grid.reactance = 0.2;
  const test::TextFile same(to_toml(settings));
  const test::Ended simulated = test::run("weakgrid", {"simulate", same.path()});
  ASSERT_EQ(test::run("weakgrid", {"sweep", base_.path(), "--vary", "grid.reactance=0.1,0.2", "-o",
                                   path("one"), "--jobs", "1"})
                .status,
            0);
  const std::string text = text_of(path("one"));
  const std::string digest = text.substr(text.rfind(',') + 1, 64);
  EXPECT_NE(simulated.out.find("modulation digest " + digest), std::string::npos) << simulated.out << text;
}

TEST_F(Sweep, WhatTheGatewayRefusesIsAResultWithItsLimit) {
  const test::Ended ended = test::run(
      "weakgrid", {"sweep", base_.path(), "--vary", "setpoint.active_power=0.1,1.5", "-o", path("one")});
  EXPECT_EQ(ended.status, 0) << ended.err;
  EXPECT_NE(ended.out.find("1 refused"), std::string::npos) << ended.out;
  EXPECT_NE(text_of(path("one")).find("\n1,1.5,refused,1,outside the envelope,current limit,-0."),
            std::string::npos)
      << text_of(path("one"));
}

// WEAKGRID_SWEEP=1000: the size that we promise; WEAKGRID_LAW_FIRST: the seed.
TEST_F(Sweep, KilledAtAnyMomentItGoesOnAndLosesOnlyWhatWasUnderWay) {
  const std::uint64_t runs = count_of("WEAKGRID_SWEEP", 60);
  const std::uint64_t seed = count_of("WEAKGRID_LAW_FIRST", std::random_device{}());
  std::printf("WEAKGRID_LAW_FIRST=%llu\n", static_cast<unsigned long long>(seed));
  SCOPED_TRACE("WEAKGRID_LAW_FIRST=" + std::to_string(seed));
  std::mt19937_64 random(seed);
  constexpr unsigned jobs = 2;
  ASSERT_EQ(sweep(runs, "one", jobs).status, 0);
  const std::string whole = text_of(path("one"));
  const std::set<std::string> rows = rows_of(whole);

  // A test that is held up may find a life ended by itself: then again from the beginning.
  constexpr std::uint64_t kills_min = 5;
  std::uint64_t kills = 0, torn = 0, empty = 0;
  for (std::set<std::string> before; kills < kills_min || before.size() < runs;) {
    SCOPED_TRACE("kill " + std::to_string(kills));
    if (before.size() == runs) {
      std::filesystem::remove(path("other"));
      before.clear();
    }
    test::Program program("weakgrid", arguments(runs, "other", jobs));
    // So many rows further, and then a moment more or less: also before the first, also in the middle of one.
    const std::size_t further = before.size() + random() % (runs / 10 + 1);
    test::wait_until([&] { return !program.runs() || rows_of(text_of(path("other"))).size() >= further; });
    usleep(static_cast<useconds_t>(random() % 3000));
    program.kill();
    if (program.wait() == 128 + SIGKILL) ++kills;
    const std::string left = text_of(path("other"));
    const std::set<std::string> now = rows_of(left);
    EXPECT_TRUE(std::includes(now.begin(), now.end(), before.begin(), before.end())) << "a row was lost";
    EXPECT_TRUE(std::includes(rows.begin(), rows.end(), now.begin(), now.end())) << "a row differs";
    if (now.size() < runs) expect_at_most_under_way(lines_of(left), before.size(), runs, jobs);
    torn += !left.empty() && left.back() != '\n';
    empty += left.empty();
    before = now;
  }
  const test::Ended last = sweep(runs, "other", jobs);
  EXPECT_EQ(last.status, 0) << last.err;
  EXPECT_TRUE(text_of(path("other")) == whole) << "not the file of an uninterrupted sweep";
  EXPECT_FALSE(std::filesystem::exists(path("other.sorted")));
  std::printf("%llu runs, %llu kills, %llu files torn, %llu empty\n", static_cast<unsigned long long>(runs),
              static_cast<unsigned long long>(kills), static_cast<unsigned long long>(torn),
              static_cast<unsigned long long>(empty));
}

TEST_F(Sweep, ItGoesOnFromAnyLengthOfItsFile) {
  ASSERT_EQ(sweep(12, "one", 1).status, 0);
  const std::string whole = text_of(path("one"));
  const std::size_t head = whole.find("\n0,") + 1;
  for (const std::size_t bytes :
       {std::size_t{0}, std::size_t{1}, head - 1, head, head + 1, whole.size() / 2, whole.size() - 1}) {
    write_text(path("one"), whole.substr(0, bytes));
    const test::Ended ended = sweep(12, "one", 1);
    EXPECT_EQ(ended.status, 0) << ended.err;
    EXPECT_TRUE(text_of(path("one")) == whole) << bytes;
  }
}

TEST_F(Sweep, KilledWhilePuttingItsRowsInOrderItDoesSo) {
  ASSERT_EQ(sweep(12, "one", 1).status, 0);
  const std::string whole = text_of(path("one"));
  const Words rows = lines_of(whole);
  std::string text = whole.substr(0, whole.find("\n0,") + 1);
  for (auto row = rows.rbegin(); row != rows.rend(); ++row) text += *row + '\n';
  write_text(path("one"), text);
  write_text(path("one.sorted"), text.substr(0, text.size() / 2));
  EXPECT_EQ(sweep(12, "one", 1).status, 0);
  EXPECT_TRUE(text_of(path("one")) == whole);
  EXPECT_FALSE(std::filesystem::exists(path("one.sorted")));
}

TEST_F(Sweep, AnInterruptStopsItAfterTheRunsUnderWayAndItSaysHowToGoOn) {
  test::Program program("weakgrid", long_sweep());
  ASSERT_TRUE(test::wait_until([&] { return rows_of(text_of(path("one"))).size() > 2; }));
  program.send(SIGINT);
  ASSERT_EQ(program.wait(), 1) << program.err();
  const std::string left = text_of(path("one"));
  EXPECT_EQ(left.back(), '\n');
  EXPECT_NE(program.err().find(": " + std::to_string(rows_of(left).size()) +
                               " of 400 runs are there; the same command goes on"),
            std::string::npos)
      << program.err();
}

TEST_F(Sweep, TwoDoNotWriteOneFile) {
  test::Program program("weakgrid", long_sweep());
  ASSERT_TRUE(test::wait_until([&] { return rows_of(text_of(path("one"))).size() > 0; }));
  const test::Ended second = test::run("weakgrid", long_sweep());
  EXPECT_EQ(second.status, 3);
  EXPECT_NE(second.err.find("another sweep writes this file"), std::string::npos) << second.err;
}

TEST_F(Sweep, AFileOfAnotherSweepIsRefusedWithWhatDiffersAndLeftAlone) {
  ASSERT_EQ(sweep(3, "one", 1).status, 0);
  const std::string whole = text_of(path("one"));
  const test::TextFile other_base(scenario + "ramp_s = 0.03\n");
  const auto refused = [&](Words with, const std::string& base, const std::string& said) {
    Words all = arguments(3, "one", 1);
    all[1] = base;
    all.insert(all.end(), with.begin(), with.end());
    const test::Ended ended = test::run("weakgrid", all);
    EXPECT_EQ(ended.status, 2) << ended.out;
    EXPECT_NE(ended.err.find(said), std::string::npos) << ended.err;
    EXPECT_TRUE(text_of(path("one")) == whole);
  };
  refused({"--seed", "2"}, base_.path(), "'# random 3 seed 1' where this one has '# random 3 seed 2'");
  refused({"--vary", "timing.delay_steps=0"}, base_.path(),
          "where this one has '# vary timing.delay_steps=0'");
  refused({}, other_base.path(), "is of another sweep: it has '# settings SHA-256");
}

TEST_F(Sweep, AFileThatIsNoneOfASweepIsLeftAlone) {
  for (const std::string text : {"a,b\n1,2\n", "x", "# weakgrid swept\n"}) {
    write_text(path("one"), text);
    const test::Ended ended = sweep(3, "one", 1);
    EXPECT_EQ(ended.status, 2);
    EXPECT_NE(ended.err.find("is there and no sweep's"), std::string::npos) << ended.err;
    EXPECT_EQ(text_of(path("one")), text);
  }
}

TEST_F(Sweep, ARowThatWasChangedIsNamedByItsLine) {
  ASSERT_EQ(sweep(3, "one", 1).status, 0);
  const std::string whole = text_of(path("one"));
  const std::size_t second = whole.find("\n1,") + 1, third = whole.find("\n2,") + 1;
  const std::string row = whole.substr(second, third - second);
  for (const std::string& changed :
       {std::string("1,0.5") + row.substr(1), whole.substr(third - row.size(), 2) + "\n",
        std::string("7") + row.substr(1), std::string("0") + row.substr(1), std::string("\n"), row + row}) {
    write_text(path("one"), whole.substr(0, second) + changed + whole.substr(third));
    const test::Ended ended = sweep(3, "one", 1);
    EXPECT_EQ(ended.status, 2) << changed;
    EXPECT_NE(ended.err.find(": no row of this sweep"), std::string::npos) << ended.err;
  }
}

TEST_F(Sweep, BadUsageMakesNoFile) {
  const std::vector<Words> cases{
      {"sweep", base_.path(), "-o", path("one")},
      {"sweep", base_.path(), "--vary", "grid.reactance=0.1"},
      {"sweep", base_.path(), "--vary", "grid.reactance=11", "-o", path("one")},
      {"sweep", base_.path(), "--vary", "grid.reactance=1", "--seed", "2", "-o", path("one")},
      {"sweep", base_.path(), "--vary", "grid.reactance=1", "--jobs", "0", "-o", path("one")},
      {"sweep", "not/there.toml", "--vary", "grid.reactance=1", "-o", path("one")}};
  for (const Words& arguments : cases) {
    const test::Ended ended = test::run("weakgrid", arguments);
    EXPECT_EQ(ended.status, 2) << ended.err;
    EXPECT_FALSE(std::filesystem::exists(path("one")));
  }
  EXPECT_EQ(sweep(3, "no/folder", 1).status, 3);
}

}  // namespace
}  // namespace weakgrid
