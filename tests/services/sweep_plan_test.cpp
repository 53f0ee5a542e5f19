// What a sweep runs, and what it refuses to. No network.
#include "services/sweep_plan.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <set>

namespace weakgrid {
namespace {

using Words = std::vector<std::string>;

const std::string scenario =
    "[grid]\nreactance = 0.3\n[scenario]\nend_s = 0.06\n"
    "[[scenario.setpoint]]\nat_s = 0.01\nactive_power = 0.5\ndc_voltage = 1.8\n"
    "[[scenario.setpoint]]\nat_s = 0.02\nreactive_power = 0.2\n";

SweepPlan plan_of(const Words& axes, std::optional<Draws> draws = {}, const std::string& text = scenario) {
  std::vector<Axis> parsed;
  for (const std::string& axis : axes) parsed.push_back(parse_axis(axis));
  return {parse_settings(text, "base"), parsed, draws};
}

TEST(SweepPlan, ARangeIncludesItsEndAndHasTheDigitsThatPeopleWrite) {
  EXPECT_EQ(parse_axis("grid.reactance=0:0.4:0.05").values,
            (Words{"0", "0.05", "0.1", "0.15", "0.2", "0.25", "0.3", "0.35", "0.4"}));
  EXPECT_EQ(parse_axis("setpoint.active_power=-0.1:0.1:0.1").values, (Words{"-0.1", "0", "0.1"}));
  EXPECT_EQ(parse_axis("setpoint.active_power=-0.3:0.3:0.1").values,
            (Words{"-0.3", "-0.2", "-0.1", "0", "0.1", "0.2", "0.3"}));
  EXPECT_EQ(parse_axis("setpoint.active_power=-1:1:1e-5").values[99'999], "-1e-05");
  EXPECT_EQ(parse_axis("grid.reactance=0:0:1").values, (Words{"0"}));
  EXPECT_EQ(parse_axis("timing.period_us=50:170:50").values, (Words{"50", "100", "150"}));
  EXPECT_EQ(parse_axis("gateway.grid_reactance=[0.2,0.3],0.25").values, (Words{"[0.2,0.3]", "0.25"}));
}

TEST(SweepPlan, AProductHasEveryCombinationOnceAndTheLastKeyMovesFastest) {
  const SweepPlan plan = plan_of({"grid.reactance=0.1,0.2,0.3", "timing.hold=turning,still"});
  ASSERT_EQ(plan.runs(), 6u);
  EXPECT_EQ(plan.values(0), (Words{"0.1", "turning"}));
  EXPECT_EQ(plan.values(1), (Words{"0.1", "still"}));
  EXPECT_EQ(plan.values(5), (Words{"0.3", "still"}));
  EXPECT_EQ(plan.settings(5).grid.reactance, 0.3);
  EXPECT_EQ(plan.settings(5).timing.hold, Hold::still);
}

TEST(SweepPlan, WhatIsNotVariedStaysToTheBit) {
  const std::string base = to_toml(parse_settings(scenario, "base"));
  const SweepPlan plan = plan_of({"grid.reactance=0.3"});
  EXPECT_EQ(to_toml(plan.settings(0)), base);
}

TEST(SweepPlan, AnyKeyOfTheFileCanBeVaried) {
  const SweepPlan plan =
      plan_of({"controller.settling_times_s[2]=0.02", "scenario.setpoint[1].ramp_s=0.03",
               "gateway.grid_reactance=[0.2, 0.4]", "converter.dc_voltage=1.9", "plant.start=off"});
  const Settings settings = plan.settings(0);
  EXPECT_EQ(settings.controller.settling_times_s, (std::vector<double>{0.001, 0.0011, 0.02}));
  EXPECT_EQ(settings.scenario->setpoints[1].ramp_s, 0.03);
  ASSERT_TRUE(settings.gateway.grid_reactance);
  EXPECT_EQ(settings.gateway.grid_reactance->low, 0.2);
  EXPECT_EQ(settings.converter.dc_voltage, 1.9);
  EXPECT_FALSE(settings.plant.starts_running);
}

TEST(SweepPlan, ASetpointIsThatOfTheLastThatHasIt) {
  const auto setpoints =
      plan_of({"setpoint.active_power=0.7", "setpoint.reactive_power=-0.1", "setpoint.dc_voltage=1.9"})
          .settings(0)
          .scenario->setpoints;
  EXPECT_EQ(setpoints[0].active_power, 0.7);
  EXPECT_EQ(setpoints[0].dc_voltage, 1.9);
  EXPECT_EQ(setpoints[1].reactive_power, -0.1);
  EXPECT_FALSE(setpoints[1].active_power);
  const std::string bare = "[scenario]\nend_s = 0.1\n[[scenario.setpoint]]\nat_s = 0.0\nactive_power = 0.1\n";
  EXPECT_EQ(plan_of({"setpoint.dc_voltage=1.9"}, {}, bare).settings(0).scenario->setpoints[0].dc_voltage,
            1.9);
}

TEST(SweepPlan, DrawsDependOnTheSeedAloneAndFillTheirRanges) {
  const Words axes{"grid.reactance=0.1:0.3", "timing.hold=turning,still", "timing.period_us=50:150:50"};
  const SweepPlan plan = plan_of(axes, Draws{400, 7}), longer = plan_of(axes, Draws{401, 7}),
                  other = plan_of(axes, Draws{400, 8});
  ASSERT_EQ(plan.runs(), 400u);
  std::set<std::string> holds, periods;
  double low = 1.0, high = 0.0, sum = 0.0;
  std::uint64_t same = 0;
  for (std::uint64_t n = 0; n < 400; ++n) {
    const Words values = plan.values(n);
    EXPECT_EQ(values, longer.values(n));
    same += values == other.values(n);
    const double reactance = std::stod(values[0]);
    EXPECT_EQ(plan.settings(n).grid.reactance, reactance) << "what stands in the table is what was run";
    low = std::min(low, reactance);
    high = std::max(high, reactance);
    sum += reactance;
    holds.insert(values[1]);
    periods.insert(values[2]);
  }
  EXPECT_GE(low, 0.1);
  EXPECT_LT(low, 0.11);
  EXPECT_GT(high, 0.29);
  EXPECT_LE(high, 0.3);
  EXPECT_NEAR(sum / 400, 0.2, 0.02);
  EXPECT_EQ(holds.size(), 2u);
  EXPECT_EQ(periods.size(), 3u);
  EXPECT_EQ(same, 0u);
}

struct Wrong {
  Words axes;
  Words named;
};

TEST(SweepPlan, WhatIsWrongIsNamedWithWhatIsAllowed) {
  const std::vector<Wrong> cases{
      {{"grid.reactance"}, {"--vary grid.reactance", "KEY=from:to:step"}},
      {{"grid.reactance="}, {"'' is neither a number"}},
      {{"grid.reactance=1;2"}, {"'1;2' is neither a number"}},
      {{"grid.reactance=0:1:0"}, {"a step above 0"}},
      {{"grid.reactance=1:0:0.1"}, {"the lower first"}},
      {{"grid.reactance=0:x:1"}, {"'x' is no number"}},
      {{"grid.reactance=0:nan:1"}, {"'nan' is no number"}},
      {{"grid.reactance=0:1:1:1"}, {"too many colons"}},
      {{"grid.reactance=0:1"}, {"from:to:step, or --random"}},
      {{"grid.reactance=0:1:1e-9"}, {"at most 1000000 values"}},
      {{"grid.reactance=0:1:0.001", "grid.resistance=0:1:0.0009"}, {"at most 1000000 runs"}},
      {{"grid.reactance=0.1,0.10"}, {"0.1 twice"}},
      {{"grid.reactance=0.1", "grid.reactance=0.2"}, {"grid.reactance is varied twice"}},
      {{"setpoint.active_power=0.1", "scenario.setpoint[0].active_power=0.2"}, {"varied twice"}},
      {{"setpoint.ramp_s=0.1"}, {"setpoint.active_power, setpoint.reactive_power"}},
      {{"grid.reactence=0.1"}, {"run 0 with grid.reactence=0.1", "unknown key", "resistance, reactance"}},
      {{"gird.reactance=0.1"}, {"gird: unknown key", "unit, converter"}},
      {{"reactance=0.1"}, {"reactance: unknown key"}},
      {{"a.b.c=0.1"}, {"there is no table a.b"}},
      {{"grid.reactance=0.1,11"}, {"run 1 with grid.reactance=11", "11 is out of range", "0 to 10"}},
      {{"grid.reactance=inf"}, {"inf is out of range"}},
      {{"timing.hold=stil"}, {"timing.hold", "\"turning\", \"still\""}},
      {{"timing.period_us=50.5"}, {"a whole number from 10 to 1000"}},
      {{"controller.settling_times_s[3]=1"}, {"ends at [2]"}},
      {{"controller.settling_times_s[x]=1"}, {"unknown key"}},
      {{"gateway.grid_reactance[0]=1"}, {"there is no list gateway.grid_reactance"}},
      {{"gateway.grid_reactance=[0.1"}, {"'[0.1' is no value"}},
      {{"scenario.setpoint.active_power=1"}, {"scenario.setpoint[0] and so on"}},
      {{"scenario.setpoint[2].active_power=1"}, {"ends at [1]"}},
      {{"scenario.end_s=0.02"}, {"run 0", "not before the end"}},
      {{"protection.dc_voltage_min=1,3"}, {"run 1", "2.6 is not above the minimum 3"}}};
  for (const Wrong& wrong : cases) try {
      plan_of(wrong.axes);
      ADD_FAILURE() << "nothing is wrong with " << wrong.axes[0];
    } catch (const SettingsError& error) {
      const std::string said = error.what();
      EXPECT_EQ(said.find('\n'), std::string::npos) << said;
      for (const std::string& part : wrong.named)
        EXPECT_NE(said.find(part), std::string::npos) << "no \"" << part << "\" in\n" << said;
    }
}

}  // namespace
}  // namespace weakgrid
