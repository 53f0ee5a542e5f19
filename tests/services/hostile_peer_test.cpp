// Peers that mean ill, or are there by mistake: a running loop does not notice.
#include <gtest/gtest.h>

#include <atomic>
#include <limits>
#include <nlohmann/json.hpp>
#include <thread>

#include "tests/services/bystander.hpp"

namespace weakgrid {
namespace {

using nlohmann::json;

constexpr double nan = std::numeric_limits<double>::quiet_NaN();

std::string scenario(const std::string& end_s) {
  return "[grid]\nreactance = 0.3\n[scenario]\nend_s = " + end_s +
         "\n[[scenario.setpoint]]\nat_s = 0.01\nactive_power = 0.707\n"
         "[[scenario.setpoint]]\nat_s = 0.05\nreactive_power = 0.707\n";
}

json report_of(const std::string& text) {
  json report = json::parse(text, nullptr, false);
  return report.is_discarded() ? json::object() : report;
}

std::string simulated_digest(const std::string& file) {
  return report_of(test::run("weakgrid", {"simulate", file, "--json"}).out)
      .value("modulation_digest", "none");
}

// Until the test is over: one round of `write` each ms.
class Spammer {
 public:
  explicit Spammer(std::function<void()> write)
      : thread_([this, write = std::move(write)] {
          while (!stop_) {
            write();
            std::this_thread::sleep_for(test::milliseconds(1));
          }
        }) {}
  ~Spammer() { stop(); }
  void stop() {
    stop_ = true;
    if (thread_.joinable()) thread_.join();
  }

 private:
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

TEST(HostilePeer, ASecondWriterOfModulationDoesNotDisturbARun) {
  const test::Domain domain;
  const test::TextFile file(scenario("1.5"));
  test::Program run("weakgrid", {"run", file.path(), "--json", "--domain", domain.text()});
  Client client(domain.number(), 1, {});
  Writer<Modulation> writer(client.bus(), 1);
  std::atomic<std::uint64_t> step{0};
  const Reader<Modulation> reader(client.bus(), 1, [&](const Modulation& m, Arrival) {
    if (m.step < std::uint64_t{1} << 40) step = m.step;
  });
  // From step 1 on the plant has heard its controller.
  ASSERT_TRUE(test::wait_until([&] { return writer.matched() > 0 && step >= 1; })) << run.err();
  Spammer spammer([&] {
    const std::uint64_t now = step;
    for (const std::uint64_t at : {now, now + 1, now + 2, now - 1, std::uint64_t{0}, ~std::uint64_t{0}})
      for (const SpaceVector mu : {SpaceVector{nan, 0.0}, SpaceVector{1e300, -1e300}, SpaceVector{0.1, -0.2}})
        (void)writer.write({.step = at, .period_ns = 100'000, .reference_id = 9, .status = 0, .mu = mu});
  });
  std::uint64_t foreign = 0;
  EXPECT_TRUE(test::wait_until([&] {
    for (const auto& [key, health] : client.peers())
      if (key.first == "plant") foreign = std::max(foreign, counter(health, "foreign_modulations"));
    return foreign > 0 && !run.runs();
  })) << "foreign modulations counted: "
      << foreign;
  spammer.stop();
  EXPECT_EQ(run.wait(), 0) << run.err();
  const json report = report_of(run.out());
  EXPECT_EQ(report.value("good", false), true) << report.value("verdict", "");
  EXPECT_EQ(report.value("held_steps", -1), 0);
  EXPECT_EQ(report.value("modulation_digest", ""), simulated_digest(file.path()));
}

TEST(HostilePeer, ASecondControllerDoesNotDisturbARun) {
  const test::Domain domain;
  const test::TextFile file(scenario("3.0"));
  test::Program run("weakgrid", {"run", file.path(), "--json", "--domain", domain.text()});
  Client client(domain.number(), 1, {});
  std::atomic<std::uint64_t> step{0};
  const Reader<Modulation> reader(client.bus(), 1, [&](const Modulation& m, Arrival) { step = m.step; });
  ASSERT_TRUE(test::wait_until([&] { return step >= 1; })) << run.err();
  test::Program second("weakgrid-controller", {"--settings", file.path(), "--domain", domain.text()});
  std::uint64_t foreign = 0;
  EXPECT_TRUE(test::wait_until([&] {
    for (const auto& [key, health] : client.peers())
      if (key.first == "plant") foreign = std::max(foreign, counter(health, "foreign_modulations"));
    return foreign > 0 && !run.runs();
  })) << "foreign modulations counted: "
      << foreign;
  EXPECT_EQ(run.wait(), 0) << run.err();
  EXPECT_EQ(report_of(run.out()).value("modulation_digest", ""), simulated_digest(file.path()));
}

TEST(HostilePeer, ASecondWriterOfMeasurementsIsNotAnswered) {
  const test::Domain domain;
  const test::TextFile file("[grid]\nreactance = 0.3\n");
  test::Services services(domain, file.path());
  services.start_all();
  test::Bystander bystander(domain);
  ASSERT_TRUE(bystander.runs());
  const auto reference = bystander.order(0.5, 0.1);
  ASSERT_TRUE(reference);
  ASSERT_TRUE(bystander.settles_at(0.5, 0.1));

  constexpr std::uint64_t far_ahead = std::uint64_t{1} << 40;
  std::atomic<std::uint64_t> answered{0};
  const Reader<Modulation> modulations(bystander.client().bus(), 1, [&](const Modulation& m, Arrival) {
    if (m.step >= far_ahead) ++answered;
  });
  Writer<Measurement> writer(bystander.client().bus(), 1);
  // The controller, the gateway, and this test's own bystander.
  ASSERT_TRUE(test::wait_until([&] { return writer.matched() >= 3 && modulations.matched() > 0; }));
  std::uint64_t sent = 0;
  Measurement hostile = *bystander.measurement();
  Spammer spammer([&] {
    ++sent;
    hostile.step = far_ahead + sent;
    hostile.blocked = sent % 2 == 0;  // the gateway would take back what stands
    hostile.state = hostile.blocked ? UnitState::tripped : UnitState::running;
    hostile.reference_id = static_cast<std::uint32_t>(sent);
    hostile.v_c = sent % 3 == 0 ? nan : 1e300;
    (void)writer.write(hostile);
  });
  for (const char* service : {"controller", "gateway"})
    EXPECT_TRUE(test::wait_until([&] { return bystander.count(service, "foreign_measurements") >= 200; }))
        << service << bystander.words();
  spammer.stop();
  ASSERT_TRUE(bystander.goes_on());
  EXPECT_EQ(answered, 0u);
  EXPECT_TRUE(bystander.settles_at(0.5, 0.1));
  EXPECT_EQ(bystander.references().back().id, reference->id) << "the gateway has believed the foreign unit";
  EXPECT_EQ(bystander.count("controller", "gap"), 0u);
  EXPECT_EQ(bystander.count("controller", "bad_measurement"), 0u);
}

TEST(HostilePeer, ASecondRunOfTheSameUnitIsToldSoAndTheFirstIsUndisturbed) {
  const test::Domain domain;
  const test::TextFile file(scenario("8.0"));
  test::Program first("weakgrid", {"run", file.path(), "--json", "--domain", domain.text()});
  Client client(domain.number(), 1, {});
  std::atomic<std::uint64_t> step{0};
  const Reader<Modulation> reader(client.bus(), 1, [&](const Modulation& m, Arrival) { step = m.step; });
  ASSERT_TRUE(test::wait_until([&] { return step >= 600; })) << first.err();  // both setpoints stand
  const test::Ended second = test::run("weakgrid", {"run", file.path(), "--domain", domain.text()});
  EXPECT_TRUE(first.runs()) << "the first has ended before the second could meet it";
  EXPECT_EQ(second.status, 3) << second.err;
  EXPECT_NE(second.err.find("unit 1 is already served in domain " + domain.text()), std::string::npos)
      << second.err;
  EXPECT_EQ(first.wait(2 * test::long_enough), 0) << first.err();
  const json report = report_of(first.out());
  EXPECT_EQ(report.value("good", false), true) << report.value("verdict", "");
  EXPECT_EQ(report.value("modulation_digest", ""), simulated_digest(file.path()));
}

TEST(HostilePeer, TwoUnitsShareADomain) {
  const test::Domain domain;
  const test::TextFile one("[unit]\nnumber = 1\n" + scenario("1.0")),
      two("[unit]\nnumber = 2\n" + scenario("1.0"));
  test::Program first("weakgrid", {"run", one.path(), "--json", "--domain", domain.text()});
  test::Program second("weakgrid", {"run", two.path(), "--json", "--domain", domain.text()});
  EXPECT_EQ(first.wait(2 * test::long_enough), 0) << first.err();
  EXPECT_EQ(second.wait(2 * test::long_enough), 0) << second.err();
  EXPECT_EQ(report_of(first.out()).value("modulation_digest", ""), simulated_digest(one.path()));
  EXPECT_EQ(report_of(second.out()).value("modulation_digest", ""), simulated_digest(two.path()));
}

}  // namespace
}  // namespace weakgrid
