// Schedule table: see the header.
#include "services/cli/schedule_table.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <iterator>
#include <sstream>
#include <string_view>

namespace weakgrid {

namespace {

// Names and ranges are those of [[scenario.setpoint]].
struct Column {
  std::string_view name;
  double low, high;
  void (*take)(TimedSetpoint&, double);
};
constexpr Column columns[] = {
    {"at_s", 0.0, 1e6, [](TimedSetpoint& s, double x) { s.at_s = x; }},
    {"active_power", -10.0, 10.0, [](TimedSetpoint& s, double x) { s.active_power = x; }},
    {"reactive_power", -10.0, 10.0, [](TimedSetpoint& s, double x) { s.reactive_power = x; }},
    {"dc_voltage", 0.01, 10.0, [](TimedSetpoint& s, double x) { s.dc_voltage = x; }},
    {"ramp_s", 0.0, 60.0, [](TimedSetpoint& s, double x) { s.ramp_s = x; }},
    {"lease_s", 0.0, 86400.0, [](TimedSetpoint& s, double x) { s.lease_s = x; }},
};

std::string_view trimmed(std::string_view text) {
  const auto first = text.find_first_not_of(" \t\r\"");
  if (first == text.npos) return {};
  return text.substr(first, text.find_last_not_of(" \t\r\"") - first + 1);
}

std::vector<std::string_view> cells_of(std::string_view line) {
  std::vector<std::string_view> cells;
  for (std::size_t from = 0, comma = 0; comma != line.npos; from = comma + 1) {
    comma = line.find(',', from);
    cells.push_back(trimmed(line.substr(from, comma - from)));
  }
  return cells;
}

double number_in(std::string_view cell, const Column& column, const std::string& place) {
  double value = 0.0;
  const auto [end, error] = std::from_chars(cell.data(), cell.data() + cell.size(), value);
  if (error != std::errc{} || end != cell.data() + cell.size() ||
      !(value >= column.low && value <= column.high))
    throw SettingsError(fmt::format("{}: {}: '{}'; allowed: a number from {} to {}", place, column.name, cell,
                                    column.low, column.high));
  return value;
}

}  // namespace

std::vector<TimedSetpoint> parse_table(const std::string& text, const std::string& name) {
  std::istringstream lines(text);
  std::vector<const Column*> header;
  std::vector<TimedSetpoint> setpoints;
  std::size_t number = 0;
  for (std::string line; std::getline(lines, line);) {
    const std::string place = fmt::format("{}:{}", name, ++number);
    if (trimmed(line).empty() || trimmed(line).front() == '#') continue;
    const auto cells = cells_of(line);
    if (header.empty()) {
      for (const std::string_view cell : cells) {
        const auto* column = std::find_if(std::begin(columns), std::end(columns),
                                          [&](const Column& c) { return c.name == cell; });
        if (column == std::end(columns))
          throw SettingsError(
              fmt::format("{}: column '{}'; allowed: at_s, active_power, reactive_power, "
                          "dc_voltage, ramp_s, lease_s",
                          place, cell));
        if (std::find(header.begin(), header.end(), column) != header.end())
          throw SettingsError(fmt::format("{}: column '{}' twice", place, cell));
        header.push_back(column);
      }
      if (std::find(header.begin(), header.end(), columns) == header.end())
        throw SettingsError(place + ": no column at_s");
      continue;
    }
    if (cells.size() != header.size())
      throw SettingsError(
          fmt::format("{}: {} cells, the first line names {}", place, cells.size(), header.size()));
    TimedSetpoint setpoint;
    for (std::size_t k = 0; k < cells.size(); ++k) {
      if (!cells[k].empty())
        header[k]->take(setpoint, number_in(cells[k], *header[k], place));
      else if (header[k] == columns)
        throw SettingsError(place + ": at_s: missing; allowed: a number from 0 to 1e6");
    }
    if (!setpoint.active_power && !setpoint.reactive_power && !setpoint.dc_voltage)
      throw SettingsError(place + ": nothing asked for; give active_power, reactive_power or dc_voltage");
    if (!setpoints.empty() && setpoint.at_s <= setpoints.back().at_s)
      throw SettingsError(fmt::format("{}: at_s: {} is not after {}, the line before", place, setpoint.at_s,
                                      setpoints.back().at_s));
    setpoints.push_back(setpoint);
  }
  if (setpoints.empty()) throw SettingsError(name + ": no setpoint; a schedule needs at least one");
  return setpoints;
}

}  // namespace weakgrid
