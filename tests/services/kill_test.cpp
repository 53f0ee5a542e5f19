// kill -9 of client, gateway, controller and plant at random phases, in lockstep and in real time: no
// setpoint outlives its lease, the unit stays within its limits or blocks, everyone rejoins without a restart
// of the others, and the journal names the cause. WEAKGRID_KILLS sets how often each is killed (default 1).
#include <gtest/gtest.h>
#include <signal.h>

#include <cmath>
#include <filesystem>
#include <mutex>
#include <random>
#include <thread>

#include "tests/services/bystander.hpp"
#include "tests/support/law_input.hpp"

namespace weakgrid {
namespace {

constexpr std::int64_t period_ns = 500'000;
constexpr double p = 0.2, q = 0.05;
constexpr double fallback_ramp_s = 0.1, settling_s = 0.4;

class Kill : public testing::TestWithParam<const char*> {
 protected:
  void SetUp() override {
    services_.start_all();
    bystander_.emplace(domain_);
    samples_.emplace(bystander_->client().bus(), 1, [this](const Measurement& m, Arrival) { see(m); });
    ASSERT_TRUE(bystander_->runs(test::long_enough, 50));
  }
  void TearDown() override { std::filesystem::remove(journal_); }

  void see(const Measurement& m) {
    const bool within = std::abs(m.v_p.re) < 10.0 && abs(m.i) <= i_max && m.v_c >= 1.2 && m.v_c <= 2.6;
    const std::lock_guard lock(mutex_);
    if (!m.blocked && !within && worst_.empty())
      worst_ = "step " + std::to_string(m.step) + ": |i| " + std::to_string(abs(m.i)) + ", v_c " +
               std::to_string(m.v_c);
    if (m.fallback && !fell_back_at_) fell_back_at_ = m.step;
  }
  std::optional<std::uint64_t> fell_back_at() {
    const std::lock_guard lock(mutex_);
    return fell_back_at_;
  }
  void forget_fallback() {
    const std::lock_guard lock(mutex_);
    fell_back_at_.reset();
  }
  static std::uint64_t steps(double seconds) {
    return static_cast<std::uint64_t>(std::lround(seconds * 1e9 / static_cast<double>(period_ns)));
  }

  // Some tenths of a second of the unit's life, at most.
  void wait_for_any_phase() { std::this_thread::sleep_for(std::chrono::microseconds(random_() % 300'000)); }

  std::vector<std::string> set(const char* further = nullptr) const {
    std::vector<std::string> arguments{"set",
                                       "--p",
                                       std::to_string(p),
                                       "--q",
                                       std::to_string(q),
                                       "--vc",
                                       "1.8385",
                                       "--name",
                                       "ann",
                                       "--timeout",
                                       "60",
                                       "--lease",
                                       std::to_string(lease_s_),
                                       "--domain",
                                       domain_.text()};
    if (further != nullptr) arguments.emplace_back(further);
    return arguments;
  }
  // Ordered and in force; a unit that has tripped is reset first.
  ::testing::AssertionResult is_ordered() {
    for (int n = 0; n < 20; ++n) {
      if (bystander_->measurement()->blocked)
        (void)test::run("weakgrid",
                        {"operate", "reset", "--name", "ann", "--timeout", "60", "--domain", domain_.text()});
      const test::Ended ended = test::run("weakgrid", set());
      // In force, what fell back before does so no more, and this observer has the order too: who wrote it
      // may be killed next.
      if (ended.status == 0 && test::wait_until([&] {
            const Measurement m = *bystander_->measurement();
            const auto orders = bystander_->references();
            return !m.fallback && !orders.empty() && orders.back().lease_end_step > m.step;
          }))
        return ::testing::AssertionSuccess();
    }
    return ::testing::AssertionFailure() << "nothing is accepted any more" << bystander_->words();
  }
  void expect_fallback_by(std::uint64_t step) {
    ASSERT_TRUE(test::wait_until([&] { return fell_back_at().has_value(); })) << bystander_->words();
    EXPECT_LE(*fell_back_at(), step);
    const std::uint64_t lease_end = bystander_->references().back().lease_end_step;
    EXPECT_GE(*fell_back_at(), lease_end);
    EXPECT_LE(*fell_back_at(), lease_end + 100) << "but for samples that this observer has lost";
    const std::uint64_t reached = *fell_back_at() + steps(fallback_ramp_s + settling_s);
    ASSERT_TRUE(test::wait_until([&] { return bystander_->measurement()->step > reached; }));
    const Measurement m = *bystander_->measurement();
    EXPECT_TRUE(m.blocked || std::abs(power(m.v_p, m.i).re) < 0.02) << "step " << m.step;
  }
  void expect_named(const std::string& kind, const std::string& cause) {
    EXPECT_TRUE(test::wait_until([&] {
      return test::run("weakgrid", {"journal", journal_, "--kind", kind}).out.find(cause) !=
             std::string::npos;
    })) << kind
        << ": " << cause;
  }
  void expect_all_well() {
    const test::Ended verified = test::run("weakgrid", {"journal", journal_, "--verify"});
    EXPECT_EQ(verified.status, 0) << verified.out << verified.err;
    const std::lock_guard lock(mutex_);
    EXPECT_EQ(worst_, "") << "outside its limits and not blocked";
  }
  // A peer that was killed gives way after 1.5 s of silence.
  ::testing::AssertionResult rejoins(const char* service) {
    services_.start(service);
    return bystander_->goes_on(test::long_enough, 50);
  }

  static constexpr double i_max = 2.0;
  // In lockstep a unit lives faster than the clock, and than clients.
  const double lease_s_ = GetParam() == std::string("lockstep") ? 30.0 : 1.5;
  static constexpr std::uint64_t on_its_way = 2000;  // what was sent just before a kill is decided after it
  const std::uint64_t kills_ = from_environment("WEAKGRID_KILLS", 1);
  const std::uint64_t seed_ = from_environment("WEAKGRID_LAW_SEED", std::random_device{}());
  const testing::ScopedTrace trace_{__FILE__, __LINE__, "WEAKGRID_LAW_SEED=" + std::to_string(seed_)};
  std::mt19937_64 random_{seed_};
  const test::Domain domain_;
  const std::string journal_ =
      std::filesystem::temp_directory_path() / ("weakgrid_kill_" + std::to_string(::getpid()) + ".journal");
  // A law that is slow enough for a busy machine's holds in real time.
  const test::TextFile file_{
      "[timing]\nperiod_us = 500\n[grid]\nreactance = 0.1\n"
      "[plant]\npatience_s = 0.2\npace = \"" +
      std::string(GetParam()) +
      "\"\n[protection]\nholds_max = 100\n"
      "[controller]\nsettling_times_s = [0.005, 0.0055, 0.2]\nnotch_settling_time_s = 0.25\n"
      "[gateway]\ndecay_min_per_s = 1.0\nramp_s = 0.1\nfallback_ramp_s = 0.1\njournal = \"" +
      journal_ + "\"\n"};
  test::Services services_{domain_, file_.path()};
  std::optional<test::Bystander> bystander_;
  std::mutex mutex_;
  std::string worst_;
  std::optional<std::uint64_t> fell_back_at_;
  std::optional<Reader<Measurement>> samples_;
};

TEST_P(Kill, OfAClientTheFallbackComesWithItsLease) {
  for (std::uint64_t n = 0; n < kills_; ++n) {
    ASSERT_TRUE(is_ordered());
    forget_fallback();
    test::Program holding("weakgrid", set("--hold"));
    wait_for_any_phase();
    holding.kill();
    const std::uint64_t killed_at = bystander_->measurement()->step;
    // The last order or renewal may have been on its way, for some steps.
    expect_fallback_by(killed_at + steps(lease_s_) + on_its_way);
  }
  expect_named("lease_end", "ended at step");
  expect_all_well();
}

TEST_P(Kill, OfTheGatewayPlantAndControllerFallBackByThemselves) {
  for (std::uint64_t n = 0; n < kills_; ++n) {
    ASSERT_TRUE(is_ordered());
    forget_fallback();
    const std::uint64_t ordered_at = bystander_->measurement()->step;
    wait_for_any_phase();
    services_["gateway"].kill();
    expect_fallback_by(ordered_at + steps(lease_s_) + on_its_way);
    ASSERT_TRUE(rejoins("gateway"));
  }
  ASSERT_TRUE(is_ordered());
  expect_named("started", "the gateway has started");
  expect_all_well();
}

TEST_P(Kill, OfTheControllerTheUnitHoldsThenBlocksUntilItIsReset) {
  for (std::uint64_t n = 0; n < kills_; ++n) {
    ASSERT_TRUE(is_ordered());
    wait_for_any_phase();
    services_["controller"].kill();
    ASSERT_TRUE(test::wait_until([&] { return bystander_->measurement()->blocked; })) << bystander_->words();
    ASSERT_TRUE(rejoins("controller"));
  }
  ASSERT_TRUE(is_ordered());
  expect_named("blocked", "the unit is tripped");
  expect_all_well();
}

TEST_P(Kill, OfThePlantTheOthersGoOnWithTheNextFromIdle) {
  for (std::uint64_t n = 0; n < kills_; ++n) {
    ASSERT_TRUE(is_ordered());
    wait_for_any_phase();
    const WriterId killed = bystander_->plant();
    services_["plant"].kill();
    services_.start("plant");
    ASSERT_TRUE(test::wait_until([&] { return bystander_->plant() != killed; })) << bystander_->words();
    ASSERT_TRUE(bystander_->goes_on(test::long_enough, 50));
  }
  ASSERT_TRUE(is_ordered());
  expect_named("restarted", "the unit is another one");
  expect_all_well();
}

INSTANTIATE_TEST_SUITE_P(Paces, Kill, testing::Values("lockstep", "realtime"),
                         [](const auto& pace) { return std::string(pace.param); });

}  // namespace
}  // namespace weakgrid
