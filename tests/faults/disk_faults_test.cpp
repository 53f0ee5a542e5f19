// A disk that fills up or may only be read, under the journal and under a recording: a small one of the
// test's own (tmpfs, in a mount namespace of its own). The unit does not notice.
#include <sched.h>
#include <signal.h>
#include <sys/mount.h>

#include <cstring>
#include <fstream>
#include <thread>

#include "tests/faults/campaign.hpp"

namespace weakgrid::faults {
namespace {

class SmallDisk {
 public:
  explicit SmallDisk(std::uint64_t megabytes) {
    if (unshare(CLONE_NEWNS) != 0)
      why_ = std::string("mount namespaces: ") + std::strerror(errno);
    else if (mount("none", "/", nullptr, MS_REC | MS_PRIVATE, nullptr) != 0 ||
             mount("none", path(), "tmpfs", 0, ("size=" + std::to_string(megabytes) + "m").c_str()) != 0)
      why_ = std::string("tmpfs: ") + std::strerror(errno);
  }
  ~SmallDisk() {
    if (why_.empty()) umount2(path(), MNT_DETACH);
  }
  SmallDisk(const SmallDisk&) = delete;
  SmallDisk& operator=(const SmallDisk&) = delete;
  /// Empty: it is there.
  const std::string& why() const { return why_; }
  std::string operator/(const std::string& name) const { return folder_ / name; }

  void fill() {
    std::ofstream filler(*this / "filler", std::ios::binary);
    const std::string block(4096, 'x');
    while (filler.write(block.data(), static_cast<std::streamsize>(block.size())).flush()) {
    }
  }
  void free() { std::filesystem::remove(*this / "filler"); }
  /// False: somebody has a file of it open for writing.
  bool set_read_only(bool on) {
    return mount("none", path(), nullptr, MS_REMOUNT | (on ? static_cast<unsigned long>(MS_RDONLY) : 0),
                 nullptr) == 0;
  }

 private:
  const char* path() const { return folder_.path().c_str(); }
  const Folder folder_;
  std::string why_;
};

void wait_some(Campaign& campaign) {
  std::this_thread::sleep_for(test::milliseconds(100 + campaign.random()() % 400));
}

TEST(DiskFaults, AFullDiskUnderTheJournalIsCountedAndTheGatewayGoesOn) {
  SmallDisk disk(8);
  if (!disk.why().empty()) GTEST_SKIP() << "skipped: " << disk.why();
  Campaign campaign({.journal = disk / "journal"});
  ASSERT_TRUE(campaign.is_sound());
  UnitWatch& watch = campaign.watch();
  for (std::uint64_t n = 0; n < injections(); ++n) {
    campaign.wait_for_any_phase();
    const std::uint64_t before = watch.count("gateway", "unwritten");
    disk.fill();
    // What fits into the last page of the file is still written.
    const bool is_counted =
        test::wait_until([&] { return campaign.is_sound() && watch.count("gateway", "unwritten") > before; });
    EXPECT_TRUE(is_counted) << watch.words();
    disk.free();
    campaign.expect_recovery("disk full under the journal");
  }
  campaign.expect_proof();
}

TEST(DiskFaults, AGatewayWhoseJournalMayNotBeWrittenSaysSoAndTheUnitKeepsItsLease) {
  SmallDisk disk(8);
  if (!disk.why().empty()) GTEST_SKIP() << "skipped: " << disk.why();
  Campaign campaign({.journal = disk / "journal"});
  ASSERT_TRUE(campaign.is_sound());
  for (std::uint64_t n = 0; n < injections(); ++n) {
    campaign.wait_for_any_phase();
    campaign["gateway"].kill();
    ASSERT_TRUE(disk.set_read_only(true)) << std::strerror(errno);
    test::Program& refused = campaign.start("gateway");
    EXPECT_EQ(refused.wait(), 3) << refused.err();
    EXPECT_NE(refused.err().find("journal"), std::string::npos) << refused.err();
    ASSERT_TRUE(disk.set_read_only(false));
    campaign.start("gateway");
    campaign.expect_recovery("disk read-only under the journal");
  }
  campaign.expect_proof();
}

TEST(DiskFaults, AFullDiskUnderARecordingEndsThatRecordingOnly) {
  SmallDisk disk(4);
  if (!disk.why().empty()) GTEST_SKIP() << "skipped: " << disk.why();
  Campaign campaign;
  ASSERT_TRUE(campaign.is_sound());
  for (std::uint64_t n = 0; n < injections(); ++n) {
    const bool is_full = campaign.random()() % 2 == 0;
    if (!is_full) {
      ASSERT_TRUE(disk.set_read_only(true));
    }
    const std::string file = disk / ("b" + std::to_string(n) + ".mcap");
    test::Program& second = campaign.start_as("second", "recorder", file);
    if (is_full) {
      EXPECT_TRUE(test::wait_until(
          [&] { return second.err().find("hears weakgrid/controller_state") != std::string::npos; }));
      wait_some(campaign);
      disk.fill();
      EXPECT_TRUE(test::wait_until([&] {
        return second.err().find("recording stopped") != std::string::npos;
      })) << second.err();
      EXPECT_TRUE(second.runs());
      second.send(SIGTERM);
    }
    EXPECT_EQ(second.wait(), 3) << second.err();
    if (is_full) {
      disk.free();
      // It holds messages up to then, and can be read.
      const test::Ended info = test::run("weakgrid", {"info", file});
      EXPECT_NE(info.out.find("weakgrid/measurement"), std::string::npos)
          << info.status << info.out << info.err;
      std::filesystem::remove(file);
    } else {
      ASSERT_TRUE(disk.set_read_only(false));
    }
    campaign.end("second");
    campaign.expect_recovery(is_full ? "disk full under a recording" : "disk read-only under a recording");
  }
  campaign.expect_proof();
}

}  // namespace
}  // namespace weakgrid::faults
