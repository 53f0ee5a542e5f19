// What a machine does to its processes: a clock that is set, descriptors that run out, shared memory that the
// dead have left.
#include <fcntl.h>
#include <sched.h>
#include <sys/mman.h>
#include <sys/mount.h>
#include <sys/resource.h>
#include <unistd.h>

#include <atomic>
#include <cstring>
#include <fstream>
#include <thread>

#include "tests/faults/campaign.hpp"

namespace weakgrid::faults {
namespace {

const std::vector<std::string> services{"plant", "controller", "gateway", "recorder"};

/// How far each service's CLOCK_REALTIME is from the machine's: stepped_clock.cpp is preloaded where a clock
/// was made.
class Clocks {
 public:
  Clocks() {
    for (const std::string& service : services) {
      const int file = open(path(service).c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600);
      if (file < 0 || ftruncate(file, sizeof(std::int64_t)) != 0) throw std::runtime_error(path(service));
      offsets_[service] = static_cast<std::atomic<std::int64_t>*>(
          mmap(nullptr, sizeof(std::int64_t), PROT_READ | PROT_WRITE, MAP_SHARED, file, 0));
      close(file);
    }
  }
  void start(const std::string& service, const std::function<void()>& start) const {
    if (!offsets_.contains(service)) return start();
    setenv("WEAKGRID_CLOCK_OFFSET_FILE", path(service).c_str(), 1);
    setenv("LD_PRELOAD", WEAKGRID_STEPPED_CLOCK, 1);
    start();
    unsetenv("LD_PRELOAD");
  }
  std::int64_t now_ns(const std::string& service) const { return wall_time_ns() + *offsets_.at(service); }
  void step(const std::string& service, std::int64_t seconds) {
    *offsets_.at(service) += seconds * 1'000'000'000;
  }

 private:
  std::string path(const std::string& service) const { return folder_ / ("clock_" + service); }
  const Folder folder_;
  std::map<std::string, std::atomic<std::int64_t>*> offsets_;
};

TEST(MachineFaults, AClockThatIsSetByAnHourDisturbsNobody) {
  Clocks clocks;
  Campaign campaign({.at = [&](const std::string& s, const auto& start) { clocks.start(s, start); }});
  ASSERT_TRUE(campaign.is_sound());
  for (std::uint64_t n = 0; n < injections(); ++n)
    for (const bool all : {true, false}) {
      const std::int64_t by_s = campaign.random()() % 2 == 0 ? 3600 : -3600;
      const std::string one = services[campaign.random()() % services.size()];
      campaign.wait_for_any_phase();
      for (const std::string& service : services)
        if (all || service == one) clocks.step(service, by_s);
      campaign.expect_recovery(all ? "clock set by an hour, everywhere"
                                   : "clock set by an hour, of one service");
      // They do go by it: the health that they say has its time.
      for (const std::string& service : services)
        EXPECT_TRUE(test::wait_until([&] {
          return std::abs(campaign.watch().wall_time_ns(service) - clocks.now_ns(service)) < 60'000'000'000;
        })) << service;
    }
  campaign.expect_proof();
}

std::uint64_t descriptors_of(pid_t pid) {
  const auto files = std::filesystem::directory_iterator("/proc/" + std::to_string(pid) + "/fd");
  return static_cast<std::uint64_t>(std::distance(begin(files), end(files)));
}

TEST(MachineFaults, OneThatMayOpenNothingMoreGoesOn) {
  Campaign campaign;
  ASSERT_TRUE(campaign.is_sound());
  for (std::uint64_t n = 0; n < injections(); ++n)
    // A recorder that may open nothing ends its recording and says so, with exit status 3 in the end.
    for (const std::string service : {"plant", "controller", "gateway"}) {
      const pid_t pid = campaign[service].pid();
      rlimit before{};
      ASSERT_EQ(prlimit(pid, RLIMIT_NOFILE, nullptr, &before), 0);
      const rlimit none{campaign.random()() % (descriptors_of(pid) + 1), before.rlim_max};
      campaign.wait_for_any_phase();
      ASSERT_EQ(prlimit(pid, RLIMIT_NOFILE, &none, nullptr), 0);
      // A client that joins meanwhile is one more to talk to.
      (void)test::run("weakgrid", {"status", "--domain", campaign.domain().text(), "--wait", "0.3"});
      EXPECT_TRUE(campaign[service].runs()) << service << ": " << campaign[service].err();
      ASSERT_EQ(prlimit(pid, RLIMIT_NOFILE, &before, nullptr), 0);
      campaign.expect_recovery("no descriptor left");
    }
  campaign.expect_proof();
}

TEST(MachineFaults, OneThatIsStartedWithTooFewDescriptorsSaysSoOrServes) {
  Campaign campaign;
  ASSERT_TRUE(campaign.is_sound());
  rlimit before{};
  ASSERT_EQ(getrlimit(RLIMIT_NOFILE, &before), 0);
  for (std::uint64_t n = 0; n < injections(); ++n)
    for (const char* service : {"controller", "gateway", "plant"}) {
      campaign[service].kill();
      const rlim_t few = 3 + campaign.random()() % 20;
      const Time started = std::chrono::steady_clock::now();
      // Before it has come to its main: it takes some ms to load its libraries, and if it cannot it says so.
      const rlimit limit{few, before.rlim_max};
      ASSERT_EQ(prlimit(campaign.start(service).pid(), RLIMIT_NOFILE, &limit, nullptr), 0);
      const bool decided = test::wait_until(
          [&] { return !campaign[service].runs() || campaign.watch().is_well(service, started); },
          test::milliseconds(8000));
      EXPECT_TRUE(decided) << service << " with " << few
                           << " descriptors is there and does not serve: " << campaign[service].err();
      if (const auto status = campaign[service].wait(test::milliseconds(0))) {
        // 127: not even its libraries; 2: nor its settings.
        EXPECT_TRUE(*status == 3 || *status == 127 || *status == 2) << service << " with " << few << ": status " << *status;
        EXPECT_FALSE(campaign[service].err().empty())
            << service << " with " << few << " descriptors says nothing";
      } else {
        campaign[service].kill();
      }
      campaign.start(service);
      campaign.expect_recovery("started with 3 … 22 descriptors, then anew");
    }
  campaign.expect_proof();
}

/// A /dev/shm of this test's own, for as long as it lives and for what it starts.
std::string own_shared_memory() {
  if (unshare(CLONE_NEWNS) != 0) return std::string("mount namespaces: ") + std::strerror(errno);
  if (mount("none", "/", nullptr, MS_REC | MS_PRIVATE, nullptr) != 0 ||
      mount("none", "/dev/shm", "tmpfs", 0, "size=256m") != 0)
    return std::string("/dev/shm: ") + std::strerror(errno);
  return "";
}

void leave_garbage(const std::filesystem::path& file, std::mt19937_64& random) {
  std::ofstream out(file, std::ios::binary);
  for (std::uint64_t n = random() % 20'000; n > 0; --n) out.put(static_cast<char>(random()));
  out.close();
  // Another user's, whom root's own rights do not stand above everywhere.
  if (random() % 2 == 0) (void)!chown(file.c_str(), 65534, 65534);
  if (random() % 2 == 0) (void)!chmod(file.c_str(), 0);
}

TEST(MachineFaults, SharedMemoryThatTheDeadHaveLeftIsInNobodysWay) {
  if (const std::string why = own_shared_memory(); !why.empty()) GTEST_SKIP() << "skipped: " << why;
  const std::filesystem::path shared("/dev/shm");
  Campaign campaign({.dds = [](const std::string& service) {
    return service == "plant" || service == "controller" ? std::string("loop = \"data_sharing\"\n")
                                                         : std::string();
  }});
  ASSERT_TRUE(campaign.is_sound());
  for (std::uint64_t n = 0; n < injections(); ++n) {
    campaign.wait_for_any_phase();
    // Both: what it does to one when the other dies within their memory is another matter
    // (services/README.md).
    for (const char* service : {"plant", "controller"}) campaign[service].kill();
    std::vector<std::filesystem::path> left;
    for (const auto& file : std::filesystem::directory_iterator(shared)) left.push_back(file.path());
    EXPECT_FALSE(left.empty()) << "the dead have left nothing";
    for (const auto& file : left)
      if (campaign.random()() % 2 == 0) leave_garbage(file, campaign.random());
    for (const char* name : {"fast_datasharing_", "fastrtps_", "fastrtps_port", "sem.fastrtps_port", "fastdds_"})
      for (int k = 0; k < 5; ++k)
        leave_garbage(shared / (name + std::to_string(campaign.random()() % 40'000)), campaign.random());
    for (const char* service : {"plant", "controller"}) campaign.start(service);
    campaign.expect_recovery("shared memory of the dead");
  }
  campaign.expect_proof();
}

}  // namespace
}  // namespace weakgrid::faults
