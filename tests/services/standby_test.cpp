// Two controllers of one unit, as real processes in real time: the second follows, takes over when the first
// goes silent, and whoever comes back commands nothing. How long it takes and how bumpless it is, is printed.
// WEAKGRID_TAKEOVERS (6): how many; WEAKGRID_STANDBY_S (2): how long nothing may happen; WEAKGRID_TAKEOVER_S
// (0.02; 0.5 where nothing may happen); WEAKGRID_LAW_SEED: of the phases.
#include <gtest/gtest.h>
#include <signal.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <random>
#include <thread>

#include "services/runtime/time_grid.hpp"
#include "tests/services/bystander.hpp"
#include "tests/support/law_input.hpp"

namespace weakgrid {
namespace {

using std::chrono::milliseconds;
constexpr std::uint32_t period_us = 500;

std::string settings(const char* which, double takeover_s) {
  return "[timing]\nperiod_us = " + std::to_string(period_us) +
         "\n[grid]\nreactance = 0.1\n[plant]\npace = \"realtime\"\n"
         "[protection]\nholds_max = 2000\n"
         "[controller]\nsettling_times_s = [0.005, 0.0055, 0.2]\nnotch_settling_time_s = 0.25\n"
         "redundancy = \"" +
         which + "\"\ntakeover_s = " + std::to_string(takeover_s) +
         "\n[gateway]\ndecay_min_per_s = 1.0\nramp_s = 0.1\n";
}

// Who answers, and what becomes of v_c, as a peer hears it.
class Watcher {
 public:
  explicit Watcher(Bus& bus)
      : answers_(bus, 1, [this](const Modulation& m, Arrival a) { see(m, a.writer); }),
        samples_(bus, 1, [this](const Measurement& m, Arrival) { see(m); }) {}

  struct Takeover {
    double silent_ms = 0.0;  // from the last answer of one to the first of the other
    double mu_jump = 0.0;    // |μ − μ of the last answer, turned on|
    std::uint64_t held = 0;  // steps
    bool started = false;    // anew, not in step
  };
  std::vector<Takeover> takeovers() const {
    const std::lock_guard lock(mutex_);
    return takeovers_;
  }
  /// Answers of a lower epoch than one before: the plant must not follow them.
  std::uint64_t late() const {
    const std::lock_guard lock(mutex_);
    return late_;
  }
  std::uint64_t epoch() const {
    const std::lock_guard lock(mutex_);
    return last_ ? last_->epoch : 0;
  }
  /// What has been taken over so far is not judged.
  void forget() {
    const std::lock_guard lock(mutex_);
    takeovers_.clear();
  }
  /// Between the lowest and the highest v_c since it was asked last.
  double take_v_c_swing() {
    const std::lock_guard lock(mutex_);
    const double swing = v_c_max_ - v_c_min_;
    v_c_min_ = 1e9;
    v_c_max_ = 0.0;
    return swing;
  }

 private:
  void see(const Modulation& m, WriterId) {
    const std::int64_t now = monotonic_ns();
    const std::lock_guard lock(mutex_);
    if (last_ && m.epoch < last_->epoch) {
      ++late_;
      return;
    }
    if (last_ && m.epoch > last_->epoch && m.step >= last_->step) {
      const double angle = Converter{}.omega * 1e-6 * period_us * static_cast<double>(m.step - last_->step);
      takeovers_.push_back({1e-6 * static_cast<double>(now - heard_ns_),
                            abs(m.mu - unit_phasor(angle) * last_->mu), m.step - last_->step - 1,
                            (m.status & started) != 0});
    }
    last_ = m;
    heard_ns_ = now;
  }
  void see(const Measurement& m) {
    const std::lock_guard lock(mutex_);
    v_c_min_ = std::min(v_c_min_, m.v_c);
    v_c_max_ = std::max(v_c_max_, m.v_c);
  }

  mutable std::mutex mutex_;
  std::optional<Modulation> last_;
  std::int64_t heard_ns_ = 0;
  std::vector<Takeover> takeovers_;
  std::uint64_t late_ = 0;
  double v_c_min_ = 1e9, v_c_max_ = 0.0;
  Reader<Modulation> answers_;
  Reader<Measurement> samples_;
};

class Standby : public testing::Test {
 protected:
  void start(double takeover_s) {
    for (const char* which : {"first", "second"})
      files_.emplace_back(new test::TextFile(settings(which, takeover_s)));
    bystander_.emplace(domain_);
    watcher_.emplace(bystander_->client().bus());
    services_.emplace(domain_, files_[0]->path());
    services_->start("plant");
    controllers_[0] = start_controller(0);
    ASSERT_TRUE(test::wait_until([&] { return bystander_->is("controller", ServiceState::running); }));
    controllers_[1] = start_controller(1);
    services_->start("gateway");
    ASSERT_TRUE(bystander_->runs()) << bystander_->words();
    ASSERT_TRUE(stands_by()) << bystander_->words();
    ASSERT_TRUE(bystander_->order(0.5, 0.1));
    ASSERT_TRUE(bystander_->goes_on(test::long_enough, 1000));
  }
  std::unique_ptr<test::Program> start_controller(int which) const {
    return std::make_unique<test::Program>(
        "weakgrid-controller",
        std::vector<std::string>{"--settings", files_[which]->path(), "--domain", domain_.text()});
  }
  testing::AssertionResult stands_by() {
    if (test::wait_until([&] {
          const auto health = bystander_->health("standby");
          return health && health->state == ServiceState::running && health->text == "stands by, in step";
        }))
      return testing::AssertionSuccess();
    return testing::AssertionFailure() << "nobody stands by in step:" << bystander_->words();
  }

  const test::Domain domain_;
  std::vector<std::unique_ptr<test::TextFile>> files_;
  std::optional<test::Bystander> bystander_;
  std::optional<Watcher> watcher_;
  std::optional<test::Services> services_;
  std::array<std::unique_ptr<test::Program>, 2> controllers_;
};

TEST_F(Standby, TakesOverFromTheKilledAndTheStoppedWhoCommandsNothingWhenItComesBack) {
  const std::uint64_t seed = from_environment("WEAKGRID_LAW_SEED", std::random_device{}());
  SCOPED_TRACE("WEAKGRID_LAW_SEED=" + std::to_string(seed));
  std::mt19937_64 random(seed);
  const std::uint64_t count = from_environment("WEAKGRID_TAKEOVERS", 6);
  start(0.02);
  // On a busy machine the second may take over before it has caught up, which is no business of this test.
  watcher_->forget();
  (void)watcher_->take_v_c_swing();
  ASSERT_TRUE(bystander_->goes_on(test::long_enough, 1000));
  const double undisturbed = watcher_->take_v_c_swing();
  // Each takeover is one epoch more; a busy machine may cause one that nobody has asked for.
  const auto leader = [&] { return static_cast<int>((watcher_->epoch() - 1) % 2); };
  double swing_max = 0.0;
  for (std::uint64_t n = 0; n < count; ++n) {
    std::this_thread::sleep_for(std::chrono::microseconds(random() % 300'000));
    (void)watcher_->take_v_c_swing();
    const std::uint64_t epoch = watcher_->epoch();
    const int gone = leader();
    const bool is_stopped = n % 2 == 1;
    if (is_stopped)
      controllers_[gone]->send(SIGSTOP);
    else
      controllers_[gone]->kill();
    ASSERT_TRUE(test::wait_until([&] { return watcher_->epoch() > epoch; })) << n << bystander_->words();
    ASSERT_TRUE(bystander_->goes_on(test::long_enough, 400));
    swing_max = std::max(swing_max, watcher_->take_v_c_swing());
    EXPECT_EQ(bystander_->count("plant", "tripped"), 0u) << bystander_->words();
    if (is_stopped)
      controllers_[gone]->send(SIGCONT);
    else
      controllers_[gone] = start_controller(gone);
    ASSERT_TRUE(stands_by()) << n;
  }
  const auto all = watcher_->takeovers();
  ASSERT_GE(all.size(), count);
  EXPECT_TRUE(test::wait_until([&] { return bystander_->count("plant", "controller_changes") >= count; }))
      << bystander_->words();
  std::vector<double> silent_ms;
  double jump_max = 0.0;
  std::uint64_t held_max = 0, anew = 0;
  for (const Watcher::Takeover& t : all) {
    silent_ms.push_back(t.silent_ms);
    jump_max = std::max(jump_max, t.mu_jump);
    held_max = std::max(held_max, t.held);
    anew += t.started;
  }
  std::ranges::sort(silent_ms);
  std::printf(
      "%zu takeovers: silent for %.1f ms (median), %.1f (worst); held %llu steps at most; |mu| jumps by %.4f "
      "at "
      "most; v_c swings by %.1e at most, undisturbed %.1e; %llu started anew; %llu answers of who was "
      "replaced\n",
      all.size(), silent_ms[silent_ms.size() / 2], silent_ms.back(),
      static_cast<unsigned long long>(held_max), jump_max, swing_max, undisturbed,
      static_cast<unsigned long long>(anew), static_cast<unsigned long long>(watcher_->late()));
  EXPECT_LE(anew, all.size() / 3) << "a busy machine may have lost it a sample within 50 ms before";
  EXPECT_LT(jump_max, 0.05);
}

TEST_F(Standby, NobodyTakesOverWhereNothingHappens) {
  const char* const text = std::getenv("WEAKGRID_TAKEOVER_S");
  const double takeover_s = text == nullptr ? 0.5 : std::strtod(text, nullptr);
  start(takeover_s);
  const std::uint64_t epoch = watcher_->epoch();
  std::this_thread::sleep_for(std::chrono::seconds(from_environment("WEAKGRID_STANDBY_S", 2)));
  EXPECT_EQ(watcher_->epoch(), epoch);
  EXPECT_EQ(watcher_->late(), 0u);
  EXPECT_TRUE(stands_by());
}

}  // namespace
}  // namespace weakgrid
