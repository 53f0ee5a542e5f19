// Settings files: every key is read, written back and has an effect; whatever is wrong with a file is named
// with file, line, key and what is allowed. No network.
#include "services/runtime/settings.hpp"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <random>
#include <set>
#include <sstream>

#include "services/runtime/settings_schema.hpp"
#include "tests/support/processes_under_test.hpp"

namespace weakgrid {
namespace {

// A visitor of the schema, as a reader of files is one: calls change(key, value, …) on every key there is.
template <class Change>
class Walk {
 public:
  Walk(Change& change, std::string path) : change_(change), path_(std::move(path)) {}

  template <class Fill>
  void section(const char* key, Fill fill) {
    Walk inner(change_, full(key));
    fill(inner);
  }
  template <class Value, class Fill>
  void optional_section(const char* key, std::optional<Value>& value, Fill fill) {
    if (!value) value.emplace();
    Walk inner(change_, full(key));
    fill(inner, *value);
  }
  template <class Value, class Fill>
  void list(const char* key, std::vector<Value>& values, Fill fill) {
    if (values.empty()) values.resize(3);
    for (Value& value : values) {
      Walk inner(change_, full(key));
      fill(inner, value);
    }
    std::sort(values.begin(), values.end(), [](const Value& a, const Value& b) { return a.at_s < b.at_s; });
  }
  void number(const char* key, double& value, double low, double high) {
    change_.number(full(key), value, low, high);
  }
  void required(const char* key, double& value, double low, double high) { number(key, value, low, high); }
  void optional(const char* key, std::optional<double>& value, double low, double high) {
    change_.optional(full(key), value, low, high);
  }
  void interval(const char* key, std::optional<Interval>& value, double low, double high) {
    change_.interval(full(key), value, low, high);
  }
  template <class Integer>
  void count(const char* key, Integer& value, std::int64_t low, std::int64_t high) {
    change_.count(full(key), value, low, high);
  }
  void flag(const char* key, bool& value) { change_.flag(full(key), value); }
  template <class Value, std::size_t n>
  void word(const char* key, Value& value, const Choice<Value> (&choices)[n]) {
    change_.word(full(key), value, choices);
  }
  void text(const char* key, std::string& value) { change_.text(full(key), value); }
  void texts(const char* key, std::vector<std::string>& values, std::size_t least, std::size_t most) {
    change_.texts(full(key), values, least, most);
  }
  void numbers(const char* key, std::vector<double>& values, std::size_t n, double low, double high) {
    for (std::size_t k = 0; k < n; ++k)
      change_.number(fmt::format("{}[{}]", full(key), k), values[k], low, high);
  }

 private:
  std::string full(const char* key) const { return path_.empty() ? key : path_ + "." + key; }

  Change& change_;
  std::string path_;
};

template <class Change>
void walk(Settings& settings, Change& change) {
  Walk<Change> file(change, "");
  visit(file, settings);
}

// Every key a random value of its range.
class Randomly {
 public:
  explicit Randomly(std::uint64_t seed) : generator_(seed) {}

  void number(const std::string&, double& value, double low, double high) {
    value = std::uniform_real_distribution(low, high)(generator_);
    if (generator_() % 8 == 0) value = generator_() % 2 == 0 ? low : high;
  }
  void optional(const std::string& key, std::optional<double>& value, double low, double high) {
    value.reset();
    if (generator_() % 2 == 0) number(key, value.emplace(), low, high);
  }
  void interval(const std::string& key, std::optional<Interval>& value, double low, double high) {
    value.reset();
    if (generator_() % 2 == 0) return;
    value.emplace();
    number(key, value->low, low, high);
    number(key, value->high, low, high);
    if (value->high < value->low || generator_() % 2 == 0) value->high = value->low;
  }
  template <class Integer>
  void count(const std::string&, Integer& value, std::int64_t low, std::int64_t high) {
    value = static_cast<Integer>(std::uniform_int_distribution(low, high)(generator_));
  }
  void flag(const std::string&, bool& value) { value = generator_() % 2 == 0; }
  template <class Value, std::size_t n>
  void word(const std::string&, Value& value, const Choice<Value> (&choices)[n]) {
    value = choices[generator_() % n].value;
  }
  void text(const std::string&, std::string& value) {
    value.clear();
    for (std::uint64_t n = generator_() % 30; n > 0; --n)
      value +=
          std::array{"a", "\"", "\\", "\n", "\t", "\x01", "µ", "…", "#", "'", "]", "\x7f"}[generator_() % 12];
  }
  void texts(const std::string& key, std::vector<std::string>& values, std::size_t least, std::size_t most) {
    values.resize(least + generator_() % (most - least + 1));
    for (std::string& value : values) text(key, value);
  }

 private:
  std::mt19937_64 generator_;
};

Settings random_settings(std::uint64_t seed) {
  Settings settings;
  Randomly randomly(seed);
  walk(settings, randomly);
  const auto rising = [](double& low, double& high) {
    if (low > high) std::swap(low, high);
    if (low == high) high += 0.125;
  };
  settings.protection.dc_voltage_min = std::clamp(settings.protection.dc_voltage_min, 0.1, 9.0);
  settings.gateway.dc_voltage_min = std::clamp(settings.gateway.dc_voltage_min, 0.1, 9.0);
  settings.gateway.pcc_voltage_max = std::clamp(settings.gateway.pcc_voltage_max, 0.1, 1.9);
  rising(settings.protection.dc_voltage_min, settings.protection.dc_voltage_max);
  rising(settings.gateway.dc_voltage_min, settings.gateway.dc_voltage_max);
  rising(settings.gateway.pcc_voltage_min, settings.gateway.pcc_voltage_max);
  const double before_end = settings.scenario->end_s / 1.1e6;  // of what the schema allows for at_s
  for (TimedSetpoint& setpoint : settings.scenario->setpoints) setpoint.at_s *= before_end;
  for (TimedEvent& event : settings.scenario->events) event.at_s *= before_end;
  if (seed % 4 == 0) settings.scenario.reset();
  for (auto* addresses : {&settings.dds.interfaces, &settings.dds.peers})
    for (std::size_t n = 0; n < addresses->size(); ++n)
      (*addresses)[n] = fmt::format("10.0.{}.{}", seed % 256, n);
  if (settings.controller.takeover_s >= 1e-6 * settings.timing.period_us * settings.protection.holds_max)
    settings.controller.redundancy = Redundancy::none;
  settings.dds.discovery_server.clear();
  if (seed % 3 == 0) {
    settings.dds.discovery_server = fmt::format("10.0.0.1:{}", 1 + seed % 65535);
    settings.dds.peers.clear();
    settings.dds.security.clear();
  }
  if (!settings.dds.security.empty()) settings.dds.loop = LoopTransport::udp;
  return settings;
}

// All that a key can say, exactly: hexadecimal numbers.
class Printed {
 public:
  void number(const std::string& key, double& value, double, double) {
    line(key, fmt::format("{:a}", value));
  }
  void optional(const std::string& key, std::optional<double>& value, double, double) {
    line(key, value ? fmt::format("{:a}", *value) : "none");
  }
  void interval(const std::string& key, std::optional<Interval>& value, double, double) {
    line(key, value ? fmt::format("{:a} {:a}", value->low, value->high) : "none");
  }
  void count(const std::string& key, std::int64_t value, std::int64_t, std::int64_t) {
    line(key, fmt::format("{}", value));
  }
  void flag(const std::string& key, bool value) { line(key, value ? "true" : "false"); }
  template <class Value, std::size_t n>
  void word(const std::string& key, Value& value, const Choice<Value> (&)[n]) {
    line(key, fmt::format("{}", static_cast<int>(value)));
  }
  void text(const std::string& key, std::string& value) { line(key, value); }
  void texts(const std::string& key, std::vector<std::string>& values, std::size_t, std::size_t) {
    for (std::string& value : values) line(key, value);
  }
  std::string all;

 private:
  void line(const std::string& key, const std::string& value) { all += key + " = " + value + "\n"; }
};

std::string printed(const Settings& settings) {
  Settings copy = settings;
  Printed text;
  const bool has_scenario = copy.scenario.has_value();
  if (has_scenario)
    text.all = fmt::format("{} {}\n", copy.scenario->setpoints.size(), copy.scenario->events.size());
  walk(copy, text);
  return has_scenario ? text.all : "no scenario\n" + text.all;
}

std::string first_difference(const std::string& a, const std::string& b) {
  std::istringstream lines_of_a(a), lines_of_b(b);
  std::string line_of_a, line_of_b;
  do {
    line_of_a = line_of_b = "";
    std::getline(lines_of_a, line_of_a);
    std::getline(lines_of_b, line_of_b);
    if (line_of_a != line_of_b) return line_of_a + "\n  and not\n" + line_of_b;
  } while (lines_of_a || lines_of_b);
  return "";
}

TEST(Settings, WrittenAndReadAgainAreTheSameInEveryKey) {
  for (std::uint64_t seed = 0; seed < 300; ++seed) {
    const Settings settings = random_settings(seed);
    const std::string text = to_toml(settings);
    Settings again;
    ASSERT_NO_THROW(again = parse_settings(text, "written")) << "seed " << seed << "\n" << text;
    ASSERT_EQ(first_difference(printed(again), printed(settings)), "") << "seed " << seed;
    ASSERT_EQ(to_toml(again), text) << "seed " << seed;
  }
}

TEST(Settings, AnEmptyFileIsAllDefaults) {
  EXPECT_EQ(printed(parse_settings("", "empty")), printed(Settings{}));
  EXPECT_EQ(printed(parse_settings("# a comment\n[grid]\n", "empty")), printed(Settings{}));
}

TEST(Settings, EveryShippedFileLoads) {
  std::size_t files = 0;
  for (const auto& entry : std::filesystem::directory_iterator(test::shipped_settings(""))) {
    if (entry.path().extension() != ".toml") continue;
    ++files;
    EXPECT_NO_THROW(load_settings(entry.path())) << entry.path();
  }
  EXPECT_GE(files, 5u);
}

// Gives one key after the other another value of its range.
class OneByOne {
 public:
  explicit OneByOne(std::size_t which) : left_(which) {}

  void number(const std::string& key, double& value, double low, double high) {
    if (!is_it(key)) return;
    value = value + 0.001 <= high ? value + 0.001 : std::max(low, value - 0.001);
  }
  void optional(const std::string& key, std::optional<double>& value, double low, double) {
    if (is_it(key)) value = value ? *value + 0.001 : low + 0.456;
  }
  void interval(const std::string& key, std::optional<Interval>& value, double low, double) {
    if (is_it(key)) value = Interval{low + 0.456, low + 0.5};
  }
  template <class Integer>
  void count(const std::string& key, Integer& value, std::int64_t, std::int64_t high) {
    if (is_it(key)) value = value < high ? value + 1 : value - 1;
  }
  void flag(const std::string& key, bool& value) {
    if (is_it(key)) value = !value;
  }
  template <class Value, std::size_t n>
  void word(const std::string& key, Value& value, const Choice<Value> (&choices)[n]) {
    if (is_it(key)) value = value == choices[0].value ? choices[1].value : choices[0].value;
  }
  void text(const std::string& key, std::string& value) {
    if (is_it(key)) value += "!";
  }
  void texts(const std::string& key, std::vector<std::string>& values, std::size_t, std::size_t) {
    if (is_it(key)) values.push_back("!");
  }
  std::string changed;  // of what was changed; empty: there are not so many keys

 private:
  bool is_it(const std::string& name) {
    const bool is = left_-- == 0;
    if (is) changed = name;
    return is;
  }
  std::size_t left_;
};

// All that the pure rooms get of the settings.
std::string derived(const Settings& s) {
  const EmulatorConfiguration e = emulator_configuration(s);
  const ControllerConfiguration c = controller_configuration(s);
  const Arbiter::Configuration a = arbiter_configuration(s);
  std::string text = fmt::format(
      "{:a} {:a} {:a} {} {} {} {} {:a} {:a} {:a} {:a} {:a} {:a} {} {} {:a}\n", e.converter.omega,
      e.converter.L, e.converter.C, e.timing.period_ns, e.timing.delay, static_cast<int>(e.timing.hold),
      static_cast<int>(e.timing.sampling), e.grid.R_g, e.grid.L_g, e.grid.V, e.protection.i_max,
      e.protection.v_c_max, e.protection.v_c_min, e.protection.max_holds, e.substeps, e.v_c);
  text += fmt::format("{} {:a} {:a} {:a} {:a} {:a} {:a}\n", static_cast<int>(c.law), c.settling_times_s[0],
                      c.settling_times_s[1], c.settling_times_s[2], c.kappa.re, c.rho, c.v_c);
  text += fmt::format("{:a} {:a} {:a} {:a} {:a} {:a} {:a} {:a} {:a} {}\n", a.box.R_g.low, a.box.L_g.low,
                      a.box.V.low, a.limits.i_max, a.limits.v_p_min, a.limits.v_p_max, a.limits.v_c_min,
                      a.limits.v_c_max, a.default_ramp_s, a.lead_steps);
  text += fmt::format("{:a} {:a} {:a} {:a} {:a} {:a}", a.limits.reserve.steady_state,
                      a.limits.reserve.current, a.limits.reserve.control, a.limits.reserve.pcc_voltage,
                      a.limits.reserve.dc_voltage, a.decay_min);
  text += fmt::format("{:a} {:a} {:a} {:a} {:a} {:a}\n", a.default_lease_s, a.offer_s, a.fallback.p,
                      a.fallback.q, a.fallback.v_c, a.fallback_ramp_s);
  text += fmt::format("{} {} {:a} {:a} {}\n", e.starts_running, e.precharge_steps, e.protection.v_p_min,
                      e.protection.v_p_max, e.protection.v_p_steps);
  const GridEvidence::Configuration g = evidence_configuration(s);
  text += fmt::format("{} {} {:a}\n", g.cycle_steps, g.cycles, g.tolerance);
  text += fmt::format("{}\n", step_at(s, s.scenario->end_s));
  for (const auto& setpoint : s.scenario->setpoints) {
    const Request r = request(s, setpoint, 1, 1);
    text += fmt::format("{} {:a} {:a} {:a} {:a} {:a} {}\n", r.given, r.p, r.q, r.v_c, r.ramp_s, r.lease_s,
                        r.effective_step);
  }
  for (const Event& event : events(s))
    text += fmt::format("{} {} {:a} {}\n", event.step, static_cast<int>(event.quantity), event.target,
                        event.ramp_steps);
  return text;
}

TEST(Settings, EveryKeyHasAnEffect) {
  // Read by the services themselves: who they are, where they meet, how the plant keeps time, what they ask
  // of the machine, what a run is called.
  const std::set<std::string> read_elsewhere{"unit.number",
                                             "unit.count",
                                             "dds.loop",
                                             "unit.domain",
                                             "plant.patience_s",
                                             "plant.pace",
                                             "plant.overrun",
                                             "controller.redundancy",
                                             "controller.takeover_s",
                                             "realtime.priority",
                                             "realtime.cpu",
                                             "realtime.lock_memory",
                                             "realtime.dma_latency",
                                             "console.address",
                                             "console.port",
                                             "console.certificate",
                                             "console.key",
                                             "console.tokens",
                                             "console.hosts",
                                             "console.origins",
                                             "dds.interfaces",
                                             "scenario.title",
                                             "gateway.journal",
                                             "gateway.after_restart",
                                             "dds.peers",
                                             "dds.discovery_server",
                                             "dds.security"};
  Settings settings;
  settings.scenario.emplace();
  settings.scenario->end_s = 1.0;
  settings.scenario->setpoints.emplace_back().at_s = 0.1;
  settings.scenario->events.emplace_back().at_s = 0.1;
  const std::string before = derived(settings);
  std::size_t keys = 0;
  for (;; ++keys) {
    Settings changed = settings;
    OneByOne change(keys);
    walk(changed, change);
    if (change.changed.empty()) break;
    EXPECT_NE(printed(changed), printed(settings)) << change.changed << " was not changed by the test";
    EXPECT_EQ(derived(changed) == before, read_elsewhere.contains(change.changed)) << change.changed;
  }
  EXPECT_GE(keys, 40u);
}

TEST(Settings, TheGatewayMayKnowAnotherGridThanThePlants) {
  const Settings settings =
      parse_settings("[grid]\nreactance = 0.1\n[gateway]\ngrid_reactance = 0.3\n", "two grids");
  EXPECT_DOUBLE_EQ(emulator_configuration(settings).grid.L_g * 100.0 * pi, 0.1);
  EXPECT_DOUBLE_EQ(arbiter_configuration(settings).box.L_g.high * 100.0 * pi, 0.3);
}

}  // namespace
}  // namespace weakgrid
