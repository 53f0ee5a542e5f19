// Settings: reading and writing TOML along the schema, and what the pure rooms get of it.
#include "services/runtime/settings.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <iterator>
#include <sstream>
#include <toml++/toml.h>

#include "services/runtime/settings_schema.hpp"

namespace weakgrid {

namespace {

[[noreturn]] void fail(const std::string& file, const toml::source_region& where, const std::string& key,
                       const std::string& what) {
  throw SettingsError(
      fmt::format("{}:{}:{}: {}: {}", file, where.begin.line, where.begin.column, key, what));
}

// One table being read. Keys asked for are known; what is left over at the end is an error.
class TableReader {
 public:
  TableReader(const std::string& file, const toml::table& table, std::string path)
      : file_(file), table_(table), path_(std::move(path)) {}

  template <class Fill>
  void section(const char* key, Fill fill) {
    if (const toml::node* node = find(key)) read_table(*node, key, fill);
  }
  template <class Value, class Fill>
  void optional_section(const char* key, std::optional<Value>& value, Fill fill) {
    if (const toml::node* node = find(key))
      read_table(*node, key, [&](TableReader& inner) { fill(inner, value.emplace()); });
  }
  template <class Value, class Fill>
  void list(const char* key, std::vector<Value>& values, Fill fill) {
    const toml::node* node = find(key);
    if (!node) return;
    const toml::array* array = node->as_array();
    if (!array || !array->is_array_of_tables()) wrong(*node, key, fmt::format("allowed: tables [[{}]]", full(key)));
    for (const toml::node& item : *array)
      read_table(item, key, [&](TableReader& inner) { fill(inner, values.emplace_back()); });
    const auto earlier = [](const Value& a, const Value& b) { return a.at_s < b.at_s; };
    if (const auto late = std::is_sorted_until(values.begin(), values.end(), earlier); late != values.end())
      wrong(*array->get(static_cast<std::size_t>(late - values.begin())), key, "allowed: rising at_s");
    if (values.size() > max_events) wrong(*node, key, fmt::format("allowed: at most {} of them", max_events));
  }

  void number(const char* key, double& value, double low, double high) {
    if (const toml::node* node = find(key)) value = in_range(*node, key, low, high);
  }
  void required(const char* key, double& value, double low, double high) {
    if (!table_.contains(key))
      fail(file_, table_.source(), full(key), fmt::format("missing; allowed: a number from {} to {}", low, high));
    number(key, value, low, high);
  }
  void optional(const char* key, std::optional<double>& value, double low, double high) {
    if (const toml::node* node = find(key)) value = in_range(*node, key, low, high);
  }
  void count(const char* key, std::uint32_t& value, std::int64_t low, std::int64_t high) {
    const toml::node* node = find(key);
    if (!node) return;
    const auto allowed = fmt::format("allowed: a whole number from {} to {}", low, high);
    if (!node->is_integer()) wrong(*node, key, allowed);
    const std::int64_t read = node->as_integer()->get();
    if (read < low || read > high) wrong(*node, key, fmt::format("{} is out of range; {}", read, allowed));
    value = static_cast<std::uint32_t>(read);
  }
  template <class Value, std::size_t n>
  void word(const char* key, Value& value, const Choice<Value> (&choices)[n]) {
    const toml::node* node = find(key);
    if (!node) return;
    std::string words;
    for (const auto& choice : choices) {
      if (node->is_string() && node->as_string()->get() == choice.word) {
        value = choice.value;
        return;
      }
      words += fmt::format("{}\"{}\"", words.empty() ? "" : ", ", choice.word);
    }
    wrong(*node, key, "allowed: one of " + words);
  }
  void text(const char* key, std::string& value) {
    const toml::node* node = find(key);
    if (!node) return;
    if (!node->is_string() || node->as_string()->get().size() > 200)
      wrong(*node, key, "allowed: a text of at most 200 bytes");
    value = node->as_string()->get();
  }
  void texts(const char* key, std::vector<std::string>& values, std::size_t least, std::size_t most) {
    const toml::node* node = find(key);
    if (!node) return;
    const toml::array* array = node->as_array();
    if (!array || array->size() < least || array->size() > most || !array->is_homogeneous<std::string>())
      wrong(*node, key, fmt::format("allowed: a list of {} to {} texts", least, most));
    values.clear();
    for (const toml::node& item : *array) values.push_back(item.as_string()->get());
  }
  void numbers(const char* key, std::vector<double>& values, std::size_t n, double low, double high) {
    const toml::node* node = find(key);
    if (!node) return;
    const toml::array* array = node->as_array();
    if (!array || array->size() != n)
      wrong(*node, key, fmt::format("allowed: a list of {} numbers from {} to {}", n, low, high));
    values.clear();
    for (const toml::node& item : *array) values.push_back(in_range(item, key, low, high));
  }

  // Every key that nobody asked for is a mistake.
  void finish() const {
    for (const auto& [key, node] : table_) {
      const std::string name(key.str());
      if (std::find(known_.begin(), known_.end(), name) != known_.end()) continue;
      fail(file_, key.source(), full(name), fmt::format("unknown key; allowed: {}", fmt::join(known_, ", ")));
    }
  }

 private:
  std::string full(const std::string& key) const { return path_.empty() ? key : path_ + "." + key; }

  const toml::node* find(const char* key) {
    known_.emplace_back(key);
    return table_.get(key);
  }
  [[noreturn]] void wrong(const toml::node& node, const char* key, const std::string& what) const {
    fail(file_, node.source(), full(key), what);
  }
  double in_range(const toml::node& node, const char* key, double low, double high) const {
    const auto allowed = fmt::format("allowed: a number from {} to {}", low, high);
    const std::optional<double> read = node.is_number() ? node.value<double>() : std::nullopt;
    if (!read) wrong(node, key, allowed);
    if (!(*read >= low && *read <= high)) wrong(node, key, fmt::format("{} is out of range; {}", *read, allowed));
    return *read;
  }
  template <class Fill>
  void read_table(const toml::node& node, const char* key, Fill fill) const {
    if (!node.is_table()) wrong(node, key, fmt::format("allowed: a table [{}]", full(key)));
    TableReader inner(file_, *node.as_table(), full(key));
    fill(inner);
    inner.finish();
  }

  const std::string& file_;
  const toml::table& table_;
  std::string path_;
  std::vector<std::string> known_;
};

// Settings as TOML; numbers with the digits that give them back exactly.
class TableWriter {
 public:
  TableWriter(std::string& text, std::string path) : text_(text), path_(std::move(path)) {}

  template <class Fill>
  void section(const char* key, Fill fill) {
    write_table(key, "[{}]\n", fill);
  }
  template <class Value, class Fill>
  void optional_section(const char* key, const std::optional<Value>& value, Fill fill) {
    if (value) write_table(key, "[{}]\n", [&](TableWriter& inner) { fill(inner, *value); });
  }
  template <class Value, class Fill>
  void list(const char* key, const std::vector<Value>& values, Fill fill) {
    for (const Value& value : values)
      write_table(key, "[[{}]]\n", [&](TableWriter& inner) { fill(inner, value); });
  }
  void number(const char* key, double value, double, double) { line(key, real(value)); }
  void required(const char* key, double value, double low, double high) { number(key, value, low, high); }
  void optional(const char* key, const std::optional<double>& value, double low, double high) {
    if (value) number(key, *value, low, high);
  }
  void count(const char* key, std::uint32_t value, std::int64_t, std::int64_t) { line(key, fmt::format("{}", value)); }
  template <class Value, std::size_t n>
  void word(const char* key, Value value, const Choice<Value> (&choices)[n]) {
    for (const auto& choice : choices)
      if (choice.value == value) line(key, fmt::format("\"{}\"", choice.word));
  }
  void text(const char* key, const std::string& value) { line(key, quoted(value)); }
  void texts(const char* key, const std::vector<std::string>& values, std::size_t, std::size_t) {
    std::vector<std::string> items(values.size());
    std::transform(values.begin(), values.end(), items.begin(), quoted);
    line(key, fmt::format("[{}]", fmt::join(items, ", ")));
  }
  void numbers(const char* key, const std::vector<double>& values, std::size_t, double, double) {
    std::vector<std::string> items(values.size());
    std::transform(values.begin(), values.end(), items.begin(), real);
    line(key, fmt::format("[{}]", fmt::join(items, ", ")));
  }

 private:
  static std::string real(double value) { return fmt::format("{:#}", value); }
  static std::string quoted(const std::string& value) {
    std::ostringstream out;
    out << toml::value<std::string>(value);
    return out.str();
  }
  void line(const char* key, const std::string& value) { text_ += fmt::format("{} = {}\n", key, value); }
  template <class Fill>
  void write_table(const char* key, fmt::format_string<std::string> head, Fill fill) {
    const std::string path = path_.empty() ? key : path_ + "." + key;
    text_ += fmt::format(head, std::string(path));
    TableWriter inner(text_, path);
    fill(inner);
  }

  std::string& text_;
  std::string path_;
};

}  // namespace

Settings parse_settings(const std::string& text, const std::string& name) {
  toml::table table;
  try {
    table = toml::parse(text, name);
  } catch (const toml::parse_error& error) {
    fail(name, error.source(), "not TOML", std::string(error.description()));
  }
  Settings settings;
  TableReader reader(name, table, "");
  visit(reader, settings);
  reader.finish();
  const auto rising = [&](const char* key, double low, double high) {
    if (!(low < high))
      fail(name, table.source(), key, fmt::format("{} is not above its minimum, {}", high, low));
  };
  rising("protection.dc_voltage_max", settings.protection.dc_voltage_min, settings.protection.dc_voltage_max);
  rising("gateway.dc_voltage_max", settings.gateway.dc_voltage_min, settings.gateway.dc_voltage_max);
  rising("gateway.pcc_voltage_max", settings.gateway.pcc_voltage_min, settings.gateway.pcc_voltage_max);
  return settings;
}

Settings load_settings(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::string text{std::istreambuf_iterator<char>(file), {}};
  if (!file.is_open() || file.bad()) throw SettingsError(path + ": cannot be read");
  return parse_settings(text, path);
}

std::string to_toml(const Settings& settings) {
  std::string text;
  TableWriter writer(text, "");
  visit(writer, settings);
  return text;
}

Timing timing(const Settings& s) {
  return {.period_ns = std::int64_t{s.timing.period_us} * 1000,
          .delay = static_cast<std::uint8_t>(s.timing.delay_steps),
          .hold = s.timing.hold,
          .sampling = s.timing.sampling};
}

Converter converter(const Settings& s) {
  Converter c;
  c.omega = 2.0 * pi * s.converter.frequency_hz;
  c.L = s.converter.filter_reactance_pu / c.omega;
  c.C = s.converter.dc_capacitance_s;
  return c;
}

Grid grid(const Settings& s) {
  return {s.grid.resistance, s.grid.reactance / converter(s).omega, s.grid.voltage};
}

EmulatorConfiguration emulator_configuration(const Settings& s) {
  return {.converter = converter(s),
          .timing = timing(s),
          .grid = grid(s),
          .protection = {.i_max = s.protection.current_max,
                         .v_c_max = s.protection.dc_voltage_max,
                         .v_c_min = s.protection.dc_voltage_min,
                         .max_holds = s.protection.holds_max},
          .substeps = s.plant.substeps,
          .v_c = s.converter.dc_voltage};
}

ControllerConfiguration controller_configuration(const Settings& s) {
  ControllerConfiguration c;
  c.converter = converter(s);
  c.timing = timing(s);
  c.law = s.controller.law;
  std::copy_n(s.controller.settling_times_s.begin(), 3, c.settling_times_s.begin());
  c.kappa = {settling_factor / s.controller.notch_settling_time_s, 0.0};
  c.rho = s.controller.predictor_rho;
  c.v_c = s.converter.dc_voltage;
  return c;
}

Arbiter::Configuration arbiter_configuration(const Settings& s) {
  Arbiter::Configuration c;
  c.converter = converter(s);
  c.grid = {s.gateway.grid_resistance.value_or(s.grid.resistance),
            s.gateway.grid_reactance.value_or(s.grid.reactance) / c.converter.omega,
            s.gateway.grid_voltage.value_or(s.grid.voltage)};
  c.limits = {.i_max = s.gateway.current_max,
              .v_p_min = s.gateway.pcc_voltage_min,
              .v_p_max = s.gateway.pcc_voltage_max,
              .v_c_min = s.gateway.dc_voltage_min,
              .v_c_max = s.gateway.dc_voltage_max};
  c.timing = timing(s);
  c.initial = {0.0, 0.0, s.converter.dc_voltage};
  c.default_ramp_s = s.gateway.ramp_s;
  c.lead_steps = s.gateway.lead_steps;
  return c;
}

std::uint64_t step_at(const Settings& s, double t_s) {
  // A millionth of a step forgives the rounding of t/T.
  return static_cast<std::uint64_t>(std::ceil(t_s / period_s(timing(s)) - 1e-6));
}

std::vector<Event> events(const Settings& s) {
  std::vector<Event> out;
  if (!s.scenario) return out;
  const double omega = converter(s).omega;
  for (const auto& event : s.scenario->events)
    out.push_back({.step = step_at(s, event.at_s),
                   .quantity = event.quantity,
                   .target = event.quantity == Quantity::grid_inductance ? event.value / omega : event.value,
                   .ramp_steps = static_cast<std::uint32_t>(step_at(s, event.ramp_s))});
  return out;
}

Request request(const Settings& s, const Settings::TimedSetpoint& setpoint, std::uint64_t client,
                std::uint32_t id) {
  return {.client = client,
          .id = id,
          .given = (setpoint.active_power ? given_p : 0u) | (setpoint.reactive_power ? given_q : 0u) |
                   (setpoint.dc_voltage ? given_v_c : 0u),
          .p = setpoint.active_power.value_or(0.0),
          .q = setpoint.reactive_power.value_or(0.0),
          .v_c = setpoint.dc_voltage.value_or(0.0),
          .ramp_s = setpoint.ramp_s,
          .effective_step = step_at(s, setpoint.at_s)};
}

}  // namespace weakgrid
