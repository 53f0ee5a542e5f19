// Settings: reading and writing TOML along the schema.
#include "services/runtime/settings.hpp"

#include <fmt/format.h>

#include <arpa/inet.h>
#include <toml++/toml.h>
#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <sstream>

#include "services/runtime/settings_schema.hpp"
#include "services/runtime/settings_table.hpp"

namespace weakgrid {

namespace {

[[noreturn]] void fail(const std::string& file, const toml::source_region& where, const std::string& key,
                       const std::string& what) {
  // What was put into a table stands on no line.
  if (where.begin.line == 0) throw SettingsError(fmt::format("{}: {}: {}", file, key, what));
  throw SettingsError(fmt::format("{}:{}:{}: {}: {}", file, where.begin.line, where.begin.column, key, what));
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
    if (!array || !array->is_array_of_tables())
      wrong(*node, key, fmt::format("allowed: tables [[{}]]", full(key)));
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
      fail(file_, table_.source(), full(key),
           fmt::format("missing; allowed: a number from {} to {}", low, high));
    number(key, value, low, high);
  }
  void optional(const char* key, std::optional<double>& value, double low, double high) {
    if (const toml::node* node = find(key)) value = in_range(*node, key, low, high);
  }
  // A number, known exactly, or a list of the least and the most that it may be.
  void interval(const char* key, std::optional<Interval>& value, double low, double high) {
    const toml::node* node = find(key);
    if (!node) return;
    const auto allowed = fmt::format("allowed: a number from {} to {}, or two, the lower first", low, high);
    const toml::array* array = node->as_array();
    if (array && array->size() != 2) wrong(*node, key, allowed);
    const double first = in_range(array ? *array->get(0) : *node, key, low, high);
    const double second = array ? in_range(*array->get(1), key, low, high) : first;
    if (second < first) wrong(*node, key, fmt::format("{} is above {}; {}", first, second, allowed));
    value = Interval{first, second};
  }
  template <class Integer>
  void count(const char* key, Integer& value, std::int64_t low, std::int64_t high) {
    const toml::node* node = find(key);
    if (!node) return;
    const auto allowed = fmt::format("allowed: a whole number from {} to {}", low, high);
    if (!node->is_integer()) wrong(*node, key, allowed);
    const std::int64_t read = node->as_integer()->get();
    if (read < low || read > high) wrong(*node, key, fmt::format("{} is out of range; {}", read, allowed));
    value = static_cast<Integer>(read);
  }
  void flag(const char* key, bool& value) {
    const toml::node* node = find(key);
    if (!node) return;
    if (!node->is_boolean()) wrong(*node, key, "allowed: true, false");
    value = node->as_boolean()->get();
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
    if (!array || array->size() < least || array->size() > most ||
        !(array->empty() || array->is_homogeneous<std::string>()))
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
    if (!(*read >= low && *read <= high))
      wrong(node, key, fmt::format("{} is out of range; {}", *read, allowed));
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
  void interval(const char* key, const std::optional<Interval>& value, double, double) {
    if (!value) return;
    line(key, value->low == value->high ? real(value->low)
                                        : fmt::format("[{}, {}]", real(value->low), real(value->high)));
  }
  void count(const char* key, std::int64_t value, std::int64_t, std::int64_t) {
    line(key, fmt::format("{}", value));
  }
  void flag(const char* key, bool value) { line(key, value ? "true" : "false"); }
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
  // The shortest digits that give the number back; with a point or an exponent, TOML reads a float.
  static std::string real(double value) {
    const std::string text = fmt::format("{}", value);
    return text.find_first_of(".e") == std::string::npos ? text + ".0" : text;
  }
  // Not toml++'s own writer: it drops a newline that a text begins with.
  static std::string quoted(const std::string& value) {
    std::string text = "\"";
    for (const char c : value) {
      if (c == '"' || c == '\\') text += '\\';
      if (static_cast<unsigned char>(c) < 0x20 || c == 0x7f)
        text += fmt::format("\\u{:04X}", static_cast<unsigned>(c));
      else
        text += c;
    }
    return text + '"';
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

bool is_address(const std::string& text) {
  in_addr address{};
  return inet_pton(AF_INET, text.c_str(), &address) == 1;
}

bool is_address_and_port(const std::string& text) {
  const std::size_t colon = text.find(':');
  if (colon == std::string::npos || !is_address(text.substr(0, colon))) return false;
  const std::string port = text.substr(colon + 1);
  return !port.empty() && port.size() <= 5 && port.find_first_not_of("0123456789") == std::string::npos &&
         std::stoul(port) >= 1 && std::stoul(port) <= 65535;
}

// What addresses look like, and what does not go together. Whether they are there is the bus's to see.
template <class Wrong>
void check(const DdsSettings& dds, const Wrong& wrong) {
  constexpr const char* an_address = "allowed: IPv4 addresses such as \"192.168.7.1\"";
  for (const std::string& address : dds.interfaces)
    if (!is_address(address)) wrong("interfaces", fmt::format("\"{}\" is none; {}", address, an_address));
  for (const std::string& address : dds.peers)
    if (!is_address(address)) wrong("peers", fmt::format("\"{}\" is none; {}", address, an_address));
  // What two processes share in memory is open to whoever may read that memory.
  if (!dds.security.empty() && dds.loop == LoopTransport::data_sharing)
    wrong("loop", "allowed with dds.security: \"udp\"; shared memory is not encrypted");
  if (dds.discovery_server.empty()) return;
  if (!is_address_and_port(dds.discovery_server))
    wrong("discovery_server",
          fmt::format("\"{}\" is none; allowed: address and port such as \"192.168.7.1:11811\"",
                      dds.discovery_server));
  if (!dds.peers.empty()) wrong("discovery_server", "allowed: this or dds.peers, not both");
  if (!dds.security.empty())
    wrong("discovery_server",
          "allowed: this or dds.security, not both, since Fast DDS 2.9 has no secured Discovery Server; with "
          "security give dds.peers");
}

}  // namespace

Settings parse_settings(const std::string& text, const std::string& name) {
  toml::table table;
  try {
    table = toml::parse(text, name);
  } catch (const toml::parse_error& error) {
    fail(name, error.source(), "not TOML", std::string(error.description()));
  }
  return settings_of(table, name);
}

Settings settings_of(const toml::table& table, const std::string& name) {
  Settings settings;
  TableReader reader(name, table, "");
  visit(reader, settings);
  reader.finish();
  const auto before_end = [&](const char* list, const auto& items) {
    for (std::size_t n = 0; n < items.size(); ++n)
      if (!(items[n].at_s < settings.scenario->end_s))
        fail(name, table.at_path(fmt::format("scenario.{}[{}].at_s", list, n)).node()->source(),
             fmt::format("scenario.{}.at_s", list),
             fmt::format("{} is not before the end; allowed: below end_s = {}", items[n].at_s,
                         settings.scenario->end_s));
  };
  if (settings.scenario) {
    before_end("setpoint", settings.scenario->setpoints);
    before_end("event", settings.scenario->events);
  }
  // Of a pair, the key that the file has is the one to mend.
  const auto rising = [&](const std::string& section, const std::string& quantity, double low, double high) {
    if (low < high) return;
    const std::string max = section + "." + quantity + "_max", min = section + "." + quantity + "_min";
    const std::string& key = table.at_path(max) ? max : min;
    fail(name, table.at_path(key).node()->source(), key,
         fmt::format("the maximum {} is not above the minimum {}; allowed: a maximum above its minimum", high,
                     low));
  };
  rising("protection", "dc_voltage", settings.protection.dc_voltage_min, settings.protection.dc_voltage_max);
  rising("gateway", "dc_voltage", settings.gateway.dc_voltage_min, settings.gateway.dc_voltage_max);
  rising("gateway", "pcc_voltage", settings.gateway.pcc_voltage_min, settings.gateway.pcc_voltage_max);
  // Of two controllers: a unit that blocks before the second takes over has no use for it.
  const double blocks_s = 1e-6 * settings.timing.period_us * settings.protection.holds_max;
  if (settings.controller.redundancy != Redundancy::none && settings.plant.pace == Pace::realtime &&
      settings.controller.takeover_s >= blocks_s) {
    const char* const key =
        table.at_path("controller.takeover_s") ? "controller.takeover_s" : "controller.redundancy";
    fail(name, table.at_path(key).node()->source(), key,
         fmt::format("takes over after {} s, and the unit blocks after {} s without an answer; allowed: "
                     "controller.takeover_s below protection.holds_max * timing.period_us",
                     settings.controller.takeover_s, blocks_s));
  }
  check(settings.dds, [&](const char* key, const std::string& what) {
    fail(name, table.at_path("dds").at_path(key).node()->source(), std::string("dds.") + key, what);
  });
  return settings;
}

Settings load_settings(const std::string& path) {
  std::error_code why;
  if (std::filesystem::is_directory(path, why))
    throw SettingsError(path + ": cannot be read: " + std::strerror(EISDIR));
  errno = 0;
  std::ifstream file(path, std::ios::binary);
  if (!file.is_open()) throw SettingsError(path + ": cannot be read: " + std::strerror(errno));
  std::ostringstream text;
  // Not by istreambuf_iterator: that throws where a file opens but does not read.
  if (file.peek() != std::ifstream::traits_type::eof()) text << file.rdbuf();
  if (file.bad() || text.bad()) throw SettingsError(path + ": cannot be read");
  return parse_settings(text.str(), path);
}

std::string to_toml(const Settings& settings) {
  std::string text;
  TableWriter writer(text, "");
  visit(writer, settings);
  return text;
}

}  // namespace weakgrid
