// SweepPlan: see the header.
#include "services/sweep_plan.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <set>
#include <span>
#include <string_view>
#include <utility>

#include "services/runtime/sha256.hpp"

namespace weakgrid {

namespace {

[[noreturn]] void fail(const std::string& axis, const std::string& what) {
  throw SettingsError(fmt::format("--vary {}: {}", axis, what));
}

std::optional<double> number_of(std::string_view text) {
  double value = 0.0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc{} || end != text.data() + text.size()) return std::nullopt;
  return value;
}

// At commas and colons outside of brackets.
std::vector<std::string_view> split(std::string_view text, char separator) {
  std::vector<std::string_view> parts;
  std::size_t from = 0;
  int depth = 0;
  for (std::size_t k = 0; k <= text.size(); ++k) {
    if (k < text.size()) depth += text[k] == '[' ? 1 : text[k] == ']' ? -1 : 0;
    if (k < text.size() && (text[k] != separator || depth != 0)) continue;
    parts.push_back(text.substr(from, k - from));
    from = k + 1;
  }
  return parts;
}

constexpr std::string_view forms = "allowed: KEY=a,b,c or KEY=from:to:step, with --random also KEY=from:to";

// As it stands in the table too. A number without a point stays one: counts want it so.
std::string cell_of(std::string_view value, const std::string& axis) {
  if (const auto number = number_of(value)) return fmt::format("{}", *number);
  constexpr std::string_view word = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-+.";
  constexpr std::string_view list = "0123456789.,+-eE[] ";
  if (value.empty() || value.find_first_not_of(value.starts_with('[') ? list : word) != value.npos)
    fail(axis, fmt::format("'{}' is neither a number nor a word nor a list of numbers; {}", value, forms));
  return std::string(value);
}

// What the file would say; to TOML nan and inf are numbers too.
std::string toml_of(const std::string& cell) {
  const bool is_word = !number_of(cell) && !cell.starts_with('[') && cell != "true" && cell != "false";
  return is_word ? fmt::format("\"{}\"", cell) : cell;
}

// 0.15 and not 0.15000000000000002, 0 and not 5.6e-17: as people write a number of a range up to `scale`.
std::string decimal(double value, double scale) {
  const int digits = std::clamp(14 - static_cast<int>(std::ceil(std::log10(scale))), 0, 100);
  // − 0 + 0 = 0
  return fmt::format("{}", number_of(fmt::format("{:.{}f}", value, digits)).value_or(value) + 0.0);
}

void fill_range(Axis& axis, std::span<const std::string_view> parts) {
  std::vector<double> numbers;
  for (const std::string_view part : parts) {
    const auto number = number_of(part);
    if (!number || !std::isfinite(*number))
      fail(axis.text, fmt::format("'{}' is no number; {}", part, forms));
    numbers.push_back(*number);
  }
  if (numbers.size() > 3) fail(axis.text, fmt::format("too many colons; {}", forms));
  axis.from = numbers[0];
  axis.to = numbers[1];
  if (axis.to < axis.from) fail(axis.text, "allowed: from:to with the lower first");
  if (numbers.size() == 2) return;
  const double step = numbers[2], steps = (axis.to - axis.from) / step;
  if (!(step > 0.0)) fail(axis.text, "allowed: a step above 0");
  if (!(steps < static_cast<double>(SweepPlan::runs_max)))
    fail(axis.text, fmt::format("allowed: at most {} values", SweepPlan::runs_max));
  // A millionth of a step forgives the rounding of the division.
  const auto last = static_cast<std::uint64_t>(std::floor(steps + 1e-6));
  const double scale = std::max({std::abs(axis.from), std::abs(axis.to), step});
  for (std::uint64_t k = 0; k <= last; ++k)
    axis.values.push_back(decimal(axis.from + static_cast<double>(k) * step, scale));
}

// The key of the file that an axis means.
std::string key_of(const Axis& axis, const Settings& base) {
  constexpr std::string_view prefix = "setpoint.";
  if (!axis.key.starts_with(prefix)) return axis.key;
  const std::string name = axis.key.substr(prefix.size());
  using Field = std::optional<double> TimedSetpoint::*;
  constexpr std::pair<std::string_view, Field> fields[] = {{"active_power", &TimedSetpoint::active_power},
                                                           {"reactive_power", &TimedSetpoint::reactive_power},
                                                           {"dc_voltage", &TimedSetpoint::dc_voltage}};
  const auto* field = std::find_if(std::begin(fields), std::end(fields),
                                   [&](const auto& candidate) { return candidate.first == name; });
  if (field == std::end(fields))
    fail(axis.text,
         "allowed: setpoint.active_power, setpoint.reactive_power, setpoint.dc_voltage; what else "
         "a setpoint has is scenario.setpoint[0].ramp_s and so on");
  const auto& setpoints = base.scenario->setpoints;
  if (setpoints.empty()) fail(axis.text, "the scenario has no setpoint");
  std::size_t n = setpoints.size();
  while (n > 0 && !(setpoints[n - 1].*field->second)) --n;
  return fmt::format("scenario.setpoint[{}].{}", (n > 0 ? n : setpoints.size()) - 1, name);
}

// Steele, Lea and Flood's SplitMix64, by place instead of in a row: a draw depends on nothing before it.
constexpr std::uint64_t golden = 0x9e3779b97f4a7c15;
constexpr std::uint64_t mixed(std::uint64_t x) {
  x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9;
  x = (x ^ (x >> 27)) * 0x94d049bb133111eb;
  return x ^ (x >> 31);
}
constexpr double unit_draw(std::uint64_t seed, std::uint64_t place) {
  return static_cast<double>(mixed(mixed(seed + golden) + (place + 1) * golden) >> 11) * 0x1p-53;
}

}  // namespace

Axis parse_axis(const std::string& text) {
  Axis axis;
  axis.text = text;
  const std::size_t equals = text.find('=');
  if (equals == text.npos || equals == 0) fail(text, fmt::format("no KEY=; {}", forms));
  axis.key = text.substr(0, equals);
  const std::string_view told = std::string_view(text).substr(equals + 1);
  if (const auto parts = split(told, ':'); parts.size() > 1)
    fill_range(axis, parts);
  else
    for (const std::string_view value : split(told, ',')) axis.values.push_back(cell_of(value, text));
  std::set<std::string_view> known;
  for (const std::string& value : axis.values)
    if (!known.insert(value).second) fail(text, fmt::format("{} twice", value));
  return axis;
}

SweepPlan::SweepPlan(const Settings& base, std::vector<Axis> axes, std::optional<Draws> draws)
    : in_force_(to_toml(base)), base_(base), axes_(std::move(axes)), draws_(draws) {
  const std::string limit = fmt::format("allowed: at most {} runs", runs_max);
  for (const Axis& axis : axes_) {
    keys_.push_back(key_of(axis, base));
    if (std::find(keys_.begin(), keys_.end() - 1, keys_.back()) != keys_.end() - 1)
      fail(axis.text, fmt::format("{} is varied twice", keys_.back()));
    if (draws_) continue;
    if (axis.values.empty()) fail(axis.text, "a range without a step; allowed: from:to:step, or --random");
    runs_ *= axis.values.size();
    if (runs_ > runs_max) fail(axis.text, limit);
  }
  if (draws_) runs_ = draws_->count;
  if (runs_ == 0 || runs_ > runs_max) throw SettingsError(fmt::format("{} runs; {}", runs_, limit));
  // Now, and not after hours. Takes some percent of the runs themselves.
  for (std::uint64_t n = 0; n < runs_; ++n) settings(n);
}

std::vector<std::string> SweepPlan::values(std::uint64_t n) const {
  std::vector<std::string> values(axes_.size());
  for (std::size_t k = axes_.size(); k-- > 0;) {
    const Axis& axis = axes_[k];
    if (!draws_) {
      values[k] = axis.values[n % axis.values.size()];
      n /= axis.values.size();
      continue;
    }
    const double draw = unit_draw(draws_->seed, n * axes_.size() + k);
    values[k] = axis.values.empty()
                    ? fmt::format("{}", axis.from + draw * (axis.to - axis.from))
                    : axis.values[static_cast<std::size_t>(draw * static_cast<double>(axis.values.size()))];
  }
  return values;
}

Settings SweepPlan::settings(std::uint64_t n) const {
  const std::vector<std::string> told = values(n);
  std::vector<Override> overrides;
  std::string name = "run " + std::to_string(n);
  for (std::size_t k = 0; k < told.size(); ++k) {
    overrides.push_back({keys_[k], toml_of(told[k])});
    name += fmt::format("{}{}={}", k == 0 ? " with " : " ", axes_[k].key, told[k]);
  }
  return base_.with(overrides, name);
}

std::vector<std::string> SweepPlan::identity() const {
  Sha256 sum;
  sum.add(std::as_bytes(std::span(in_force_)));
  std::vector<std::string> lines{"settings SHA-256 " + sum.hex()};
  for (const Axis& axis : axes_) lines.push_back("vary " + axis.text);
  lines.push_back(draws_ ? fmt::format("random {} seed {}", runs_, draws_->seed)
                         : fmt::format("product {}", runs_));
  return lines;
}

}  // namespace weakgrid
