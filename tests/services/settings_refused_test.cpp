// Settings files with something wrong: named with file, line, key and what is allowed; the programs say so in
// one line and exit with 2. No network.
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <set>

#include "services/runtime/settings.hpp"
#include "tests/support/processes_under_test.hpp"

namespace weakgrid {
namespace {

struct WrongFile {
  const char* name;
  std::string text;
  std::vector<std::string> named;  // what the message must hold, besides the file
};

void PrintTo(const WrongFile& wrong, std::ostream* out) { *out << wrong.name; }

std::string many(const std::string& item, int n) {
  std::string text;
  for (int k = 0; k < n; ++k) text += item;
  return text;
}

const std::string scenario_head = "[scenario]\nend_s = 1.0\n";

const std::vector<WrongFile>& wrong_files() {
  static const std::vector<WrongFile> files{
      // Keys
      {"UnknownKey",
       "[grid]\nreactance = 0.3\nreactence = 0.3\n",
       {":3:", "grid.reactence", "unknown key", "resistance, reactance, voltage"}},
      {"UnknownTable",
       "\n[gird]\nreactance = 0.3\n",
       {":2:", "gird", "unknown key", "unit, converter, timing, grid"}},
      {"KeyInTheWrongTable",
       "[converter]\nreactance = 0.3\n",
       {":2:", "converter.reactance", "filter_reactance_pu"}},
      {"KeyOutsideATable", "reactance = 0.3\n", {":1:", "reactance", "unknown key", "scenario"}},
      {"UnknownKeyOfASetpoint",
       scenario_head + "[[scenario.setpoint]]\nat_s = 0.1\nactiv_power = 0.1\n",
       {":5:", "scenario.setpoint.activ_power", "active_power, reactive_power, dc_voltage, ramp_s"}},
      {"UnknownKeyOfAnEvent",
       scenario_head + "[[scenario.event]]\nat_s = 0.1\nvalue = 0.1\nramp = 0.1\n",
       {":6:", "scenario.event.ramp", "at_s, quantity, value, ramp_s"}},
      {"KeyInCapitals", "[grid]\nReactance = 0.3\n", {":2:", "grid.Reactance", "unknown key"}},
      // Types
      {"TextForANumber", "[grid]\nreactance = \"0.3\"\n", {":2:", "grid.reactance", "a number from 0 to 10"}},
      {"TruthForANumber", "[grid]\nreactance = true\n", {":2:", "grid.reactance", "a number from 0 to 10"}},
      {"DateForANumber",
       "[grid]\nreactance = 2024-02-29\n",
       {":2:", "grid.reactance", "a number from 0 to 10"}},
      {"RealForACount",
       "[timing]\nperiod_us = 100.0\n",
       {":2:", "timing.period_us", "a whole number from 10 to 1000"}},
      {"TextForACount",
       "[unit]\nnumber = \"1\"\n",
       {":2:", "unit.number", "a whole number from 1 to 4294967232"}},
      {"NumberForAFlag", "[realtime]\nlock_memory = 1\n", {":2:", "realtime.lock_memory", "true, false"}},
      {"NumberForAWord", "[timing]\nhold = 1\n", {":2:", "timing.hold", "\"turning\", \"still\""}},
      {"NumberForAText",
       scenario_head + "title = 7\n",
       {":3:", "scenario.title", "a text of at most 200 bytes"}},
      {"ValueForATable", "\ngrid = 0.3\n", {":2:", "grid", "a table [grid]"}},
      {"ListForATable", "[[grid]]\nreactance = 0.3\n", {":1:", "grid", "a table [grid]"}},
      {"TableForAList",
       scenario_head + "[scenario.setpoint]\nat_s = 0.1\n",
       {":3:", "scenario.setpoint", "[[scenario.setpoint]]"}},
      {"ValuesForAListOfTables",
       scenario_head + "setpoint = [1, 2]\n",
       {":3:", "scenario.setpoint", "[[scenario.setpoint]]"}},
      {"NumberForAList",
       "[controller]\nsettling_times_s = 0.001\n",
       {":2:", "controller.settling_times_s", "a list of 3 numbers from 0.0001 to 10"}},
      {"TextForAList",
       "[dds]\ninterfaces = \"127.0.0.1\"\n",
       {":2:", "dds.interfaces", "a list of 1 to 16 texts"}},
      {"NumbersInAListOfTexts",
       "[dds]\ninterfaces = [127, 1]\n",
       {":2:", "dds.interfaces", "a list of 1 to 16 texts"}},
      {"MixedList",
       "[dds]\ninterfaces = [\"127.0.0.1\", 1]\n",
       {":2:", "dds.interfaces", "a list of 1 to 16 texts"}},
      {"TextInAListOfNumbers",
       "[controller]\nsettling_times_s = [0.001, \"0.002\", 0.02]\n",
       {":2:", "controller.settling_times_s", "a number from 0.0001 to 10"}},
      // Ranges
      {"BelowTheRange",
       "[grid]\n\nreactance = -0.1\n",
       {":3:", "grid.reactance", "-0.1 is out of range", "0 to 10"}},
      {"AboveTheRange",
       "[grid]\nreactance = 10.5\n",
       {":2:", "grid.reactance", "10.5 is out of range", "0 to 10"}},
      {"NotANumber",
       "[grid]\nreactance = nan\n",
       {":2:", "grid.reactance", "nan is out of range", "0 to 10"}},
      {"Infinite", "[grid]\nreactance = inf\n", {":2:", "grid.reactance", "inf is out of range", "0 to 10"}},
      {"NoGridVoltage", "[grid]\nvoltage = 0\n", {":2:", "grid.voltage", "0 is out of range", "0.1 to 2"}},
      {"CountBelow",
       "[timing]\nperiod_us = 9\n",
       {":2:", "timing.period_us", "9 is out of range", "10 to 1000"}},
      {"CountAbove",
       "[timing]\nperiod_us = 1001\n",
       {":2:", "timing.period_us", "1001 is out of range", "10 to 1000"}},
      {"CountNegative",
       "[protection]\nholds_max = -1\n",
       {":2:", "protection.holds_max", "-1 is out of range"}},
      {"CountBeyond32Bits",
       "[unit]\nnumber = 4294967297\n",
       {":2:", "unit.number", "4294967297 is out of range"}},
      {"UnitZero", "[unit]\nnumber = 0\n", {":2:", "unit.number", "0 is out of range", "1 to 4294967232"}},
      {"DomainAbove", "[unit]\ndomain = 231\n", {":2:", "unit.domain", "231 is out of range", "0 to 230"}},
      {"DelayOfTwo",
       "[timing]\ndelay_steps = 2\n",
       {":2:", "timing.delay_steps", "2 is out of range", "0 to 1"}},
      {"WordUnknown",
       "[controller]\nlaw = \"fast\"\n",
       {":2:", "controller.law", "\"filtered\", \"unfiltered\""}},
      {"RedundancyUnknown",
       "[controller]\nredundancy = \"third\"\n",
       {":2:", "controller.redundancy", "\"none\", \"first\", \"second\""}},
      {"TakeoverAfterTheUnitBlocks",
       "[plant]\npace = \"realtime\"\n[controller]\nredundancy = \"second\"\ntakeover_s = 0.002\n",
       {":5:", "controller.takeover_s", "blocks after 0.002 s", "holds_max"}},
      {"PaceUnknown", "[plant]\npace = \"fast\"\n", {":2:", "plant.pace", "\"lockstep\", \"realtime\""}},
      {"OverrunUnknown", "[plant]\noverrun = \"skip\"\n", {":2:", "plant.overrun", "\"hold\", \"block\""}},
      {"PriorityAbove",
       "[realtime]\npriority = 100\n",
       {":2:", "realtime.priority", "100 is out of range", "0 to 99"}},
      {"ProcessorBelow",
       "[realtime]\ncpu = -2\n",
       {":2:", "realtime.cpu", "-2 is out of range", "-1 to 1023"}},
      {"WordInCapitals",
       "[timing]\nsampling = \"Instantaneous\"\n",
       {":2:", "timing.sampling", "\"instantaneous\", \"period_mean\""}},
      {"QuantityUnknown",
       scenario_head + "[[scenario.event]]\nat_s = 0.1\nquantity = \"load\"\nvalue = 1\n",
       {":5:", "scenario.event.quantity",
        "\"source_power\", \"grid_resistance\", \"grid_reactance\", \"grid_voltage\""}},
      {"TooFewNumbers",
       "[controller]\nsettling_times_s = [0.001, 0.02]\n",
       {":2:", "controller.settling_times_s", "a list of 3 numbers"}},
      {"TooManyNumbers",
       "[controller]\nsettling_times_s = [0.001, 0.02, 0.1, 0.1]\n",
       {":2:", "controller.settling_times_s", "a list of 3 numbers"}},
      {"NumberOfAListOutOfRange",
       "[controller]\nsettling_times_s = [0.001,\n 0.0,\n 0.1]\n",
       {":3:", "controller.settling_times_s", "0 is out of range", "0.0001 to 10"}},
      {"InterfaceByName",
       "[dds]\ninterfaces = [\"127.0.0.1\", \"eth0\"]\n",
       {":2:", "dds.interfaces", "\"eth0\"", "IPv4"}},
      {"PeerByName", "[dds]\npeers = [\"plant.local\"]\n", {":2:", "dds.peers", "\"plant.local\"", "IPv4"}},
      {"ServerWithoutPort",
       "[dds]\ndiscovery_server = \"10.0.0.1\"\n",
       {":2:", "dds.discovery_server", "\"10.0.0.1\"", "address and port"}},
      {"ServerPortBeyond",
       "[dds]\ndiscovery_server = \"10.0.0.1:65536\"\n",
       {":2:", "dds.discovery_server", "65536", "address and port"}},
      {"ServerAndPeers",
       "[dds]\npeers = [\"10.0.0.2\"]\ndiscovery_server = \"10.0.0.1:11811\"\n",
       {":3:", "dds.discovery_server", "not both"}},
      {"ServerAndSecurity",
       "[dds]\nsecurity = \"keys\"\ndiscovery_server = \"10.0.0.1:11811\"\n",
       {":3:", "dds.discovery_server", "no secured Discovery Server"}},
      {"SecurityAndSharedMemory",
       "[dds]\nsecurity = \"keys\"\nloop = \"data_sharing\"\n",
       {":3:", "dds.loop", "\"udp\"", "not encrypted"}},
      {"NoInterface", "[dds]\ninterfaces = []\n", {":2:", "dds.interfaces", "a list of 1 to 16 texts"}},
      {"TooManyInterfaces",
       "[dds]\ninterfaces = [" + many("\"127.0.0.1\",", 17) + "]\n",
       {":2:", "dds.interfaces", "a list of 1 to 16 texts"}},
      {"TitleTooLong",
       scenario_head + "title = \"" + many("x", 201) + "\"\n",
       {":3:", "scenario.title", "at most 200 bytes"}},
      {"TooManyEvents",
       scenario_head + many("[[scenario.event]]\nat_s = 0.1\nvalue = 0.1\n", 257),
       {":3:", "scenario.event", "at most 256"}},
      // Missing and out of order
      {"NoEnd",
       "[grid]\nreactance = 0.3\n[scenario]\ntitle = \"x\"\n",
       {":3:", "scenario.end_s", "missing", "a number from 0.001 to"}},
      {"SetpointWithoutTime",
       scenario_head + "[[scenario.setpoint]]\nactive_power = 0.1\n",
       {":3:", "scenario.setpoint.at_s", "missing", "a number from 0 to"}},
      {"EventWithoutTime",
       scenario_head + "[[scenario.event]]\nvalue = 0.1\n",
       {":3:", "scenario.event.at_s", "missing", "a number from 0 to"}},
      {"EventWithoutValue",
       scenario_head + "[[scenario.event]]\nat_s = 0.1\n",
       {":3:", "scenario.event.value", "missing", "a number from"}},
      {"SetpointsOutOfOrder",
       scenario_head + "[[scenario.setpoint]]\nat_s = 0.2\n[[scenario.setpoint]]\nat_s = 0.1\n",
       {":5:", "scenario.setpoint", "rising at_s"}},
      {"EventsOutOfOrder",
       scenario_head +
           "[[scenario.event]]\nat_s = 0.2\nvalue = 0.1\n[[scenario.event]]\nat_s = 0.1\nvalue = 0.1\n",
       {":6:", "scenario.event", "rising at_s"}},
      // What does not fit together
      {"TripMaximumBelowMinimum",
       "[grid]\nreactance = 0.3\n[protection]\ndc_voltage_max = 1.0\n",
       {":4:", "protection.dc_voltage_max", "maximum 1 is not above the minimum 1.2"}},
      {"TripMinimumAboveMaximum",
       "[protection]\ndc_voltage_min = 3.0\n",
       {":2:", "protection.dc_voltage_min", "maximum 2.6 is not above the minimum 3"}},
      {"DcMaximumAtMinimum",
       "[gateway]\ndc_voltage_min = 2.0\ndc_voltage_max = 2.0\n",
       {":3:", "gateway.dc_voltage_max", "maximum 2 is not above the minimum 2"}},
      {"PccMaximumBelowMinimum",
       "[gateway]\npcc_voltage_max = 0.5\n",
       {":2:", "gateway.pcc_voltage_max", "maximum 0.5 is not above the minimum 0.8"}},
      {"SetpointAtTheEnd",
       scenario_head + "[[scenario.setpoint]]\nat_s = 1.0\n",
       {":4:", "scenario.setpoint.at_s", "not before the end", "below end_s = 1"}},
      {"EventAfterTheEnd",
       scenario_head + "[[scenario.event]]\nat_s = 1.5\nvalue = 0.1\n",
       {":4:", "scenario.event.at_s", "not before the end", "below end_s = 1"}},
      // Not TOML
      {"NotToml", "[grid]\nreactance 0.3\n", {":2:", "not TOML"}},
      {"OpenTable", "[grid\n", {":1:", "not TOML"}},
      {"OpenText", "[timing]\nhold = \"turning\n", {":2:", "not TOML"}},
      {"KeyTwice", "[grid]\nreactance = 0.1\nreactance = 0.2\n", {":3:", "not TOML", "reactance"}},
      {"TableTwice", "[grid]\nreactance = 0.1\n[grid]\n", {":3:", "not TOML", "grid"}},
      {"NotUtf8", "[grid]\n# \xff\xfe\n", {":2:", "not TOML", "utf-8"}},
      {"Binary",
       std::string("\x7f"
                   "ELF\0\0\1",
                   7),
       {":1:", "not TOML"}},
      {"DeeplyNested", "a = " + many("[", 5000), {":1:", "not TOML"}},
  };
  return files;
}

class SettingsAreRefused : public testing::TestWithParam<WrongFile> {};

TEST_P(SettingsAreRefused, WithFileLineKeyAndWhatIsAllowed) {
  try {
    parse_settings(GetParam().text, "some/file.toml");
    FAIL() << "nothing is wrong with\n" << GetParam().text.substr(0, 500);
  } catch (const SettingsError& error) {
    const std::string said = error.what();
    EXPECT_EQ(said.find("some/file.toml:"), 0u) << said;
    EXPECT_EQ(said.find('\n'), std::string::npos) << "more than one line: " << said;
    for (const std::string& part : GetParam().named)
      EXPECT_NE(said.find(part), std::string::npos) << "no \"" << part << "\" in\n" << said;
  }
}

INSTANTIATE_TEST_SUITE_P(Settings, SettingsAreRefused, testing::ValuesIn(wrong_files()),
                         [](const auto& instance) { return instance.param.name; });

// Programs: exit status 2 and that one line, nothing else, before any network.
class ProgramsRefuse : public testing::TestWithParam<std::vector<std::string>> {
 protected:
  // The file stands last.
  void expect_refused(const std::string& file, const std::string& reason) {
    std::vector<std::string> arguments(GetParam().begin() + 1, GetParam().end());
    arguments.push_back(file);
    const test::Ended ended = test::run(GetParam()[0], arguments);
    EXPECT_EQ(ended.status, 2);
    EXPECT_EQ(ended.out, "");
    EXPECT_EQ(ended.err, GetParam()[0] + ": " + reason + "\n");
  }
};

TEST_P(ProgramsRefuse, AWrongFileWithThatOneLine) {
  for (const WrongFile& wrong : wrong_files()) {
    if (std::set<std::string>{"UnknownKey", "RealForACount", "AboveTheRange", "NotToml", "NoEnd"}.count(
            wrong.name) == 0)
      continue;
    const test::TextFile file(wrong.text);
    try {
      load_settings(file.path());
      ADD_FAILURE() << wrong.name;
    } catch (const SettingsError& error) {
      expect_refused(file.path(), error.what());
    }
  }
}

TEST_P(ProgramsRefuse, AFileThatIsNotThere) {
  expect_refused("not/there.toml", "not/there.toml: cannot be read: No such file or directory");
}

TEST_P(ProgramsRefuse, AFolder) {
  const std::string folder = std::filesystem::temp_directory_path();
  expect_refused(folder, folder + ": cannot be read: Is a directory");
}

INSTANTIATE_TEST_SUITE_P(
    Settings, ProgramsRefuse,
    testing::Values(std::vector<std::string>{"weakgrid-plant", "--settings"},
                    std::vector<std::string>{"weakgrid-controller", "--settings"},
                    std::vector<std::string>{"weakgrid-gateway", "--settings"},
                    std::vector<std::string>{"weakgrid", "run"},
                    std::vector<std::string>{"weakgrid", "simulate"},
                    std::vector<std::string>{"weakgrid", "set", "--p", "0.1", "--settings"},
                    std::vector<std::string>{"weakgrid", "status", "--settings"},
                    std::vector<std::string>{"weakgrid", "operate", "reset", "--settings"}),
    [](const auto& instance) {
      std::string name = instance.param[0] +
                         (instance.param.size() > 2 || instance.param[1][0] != '-' ? instance.param[1] : "");
      name.erase(std::remove(name.begin(), name.end(), '-'), name.end());
      return name;
    });

TEST(SettingsRefused, AFileWithoutAScenarioWhereOneIsPlayed) {
  const test::TextFile file("[grid]\nreactance = 0.3\n");
  for (const char* command : {"run", "simulate"}) {
    const test::Ended ended = test::run("weakgrid", {command, file.path()});
    EXPECT_EQ(ended.status, 2);
    EXPECT_NE(ended.err.find(file.path() + ": scenario: missing"), std::string::npos) << ended.err;
  }
}

}  // namespace
}  // namespace weakgrid
