// SettingsBase: see the header. Keys are put into the table, so that the one parser judges them.
#include "services/runtime/settings_override.hpp"

#include <fmt/format.h>

#include <charconv>
#include <string_view>

#include "services/runtime/settings_table.hpp"

namespace weakgrid {

namespace {

[[noreturn]] void fail(const std::string& name, std::string_view key, const std::string& what) {
  throw SettingsError(fmt::format("{}: {}: {}", name, key, what));
}

// Of key = value, which must be all that the text says.
toml::table parsed(const Override& override, const std::string& name) {
  toml::table table;
  try {
    table = toml::parse("value = " + override.value);
  } catch (const toml::parse_error& error) {
    fail(name, override.key, fmt::format("'{}' is no value: {}", override.value, error.description()));
  }
  if (table.size() != 1) fail(name, override.key, fmt::format("'{}' is more than one value", override.value));
  return table;
}

// "list[2]" → list, 2; false: no item of a list.
bool split_item(std::string_view path, std::string_view& list, std::size_t& index) {
  const std::size_t open = path.rfind('[');
  if (!path.ends_with(']') || open == path.npos) return false;
  list = path.substr(0, open);
  const char* const last = path.data() + path.size() - 1;
  const auto [end, error] = std::from_chars(path.data() + open + 1, last, index);
  return error == std::errc{} && end == last;
}

toml::array& list_at(toml::table& table, std::string_view path, std::size_t index, const Override& override,
                     const std::string& name) {
  toml::array* list = table.at_path(path).as_array();
  if (list == nullptr) fail(name, override.key, fmt::format("there is no list {}", path));
  if (index >= list->size())
    fail(name, override.key, fmt::format("{} ends at [{}]; items count from 0", path, list->size() - 1));
  return *list;
}

void put(toml::table& table, const Override& override, const std::string& name) {
  const toml::table holder = parsed(override, name);
  const toml::node& value = *holder.get("value");
  const std::string_view key = override.key;
  std::string_view list;
  std::size_t index = 0;
  if (split_item(key, list, index)) {
    toml::array& items = list_at(table, list, index, override, name);
    items.replace(items.begin() + static_cast<std::ptrdiff_t>(index), value);
    return;
  }
  const std::size_t dot = key.rfind('.');
  if (dot == key.npos) {
    table.insert_or_assign(key, value);
    return;
  }
  const std::string_view parent = key.substr(0, dot);
  if (split_item(parent, list, index)) list_at(table, list, index, override, name);
  // A table that is not there yet: whether it may be there the parser says.
  if (!table.at_path(parent) && parent.find_first_of(".[") == parent.npos)
    table.insert(parent, toml::table{});
  if (table.at_path(parent).is_array())
    fail(name, key, fmt::format("{0} is a list; allowed: {0}[0] and so on", parent));
  toml::table* inner = table.at_path(parent).as_table();
  if (inner == nullptr) fail(name, key, fmt::format("there is no table {}", parent));
  inner->insert_or_assign(key.substr(dot + 1), value);
}

}  // namespace

struct SettingsBase::Table {
  toml::table in_force;
};

SettingsBase::SettingsBase(const Settings& settings)
    : table_(std::make_shared<Table>(Table{toml::parse(to_toml(settings))})) {}

Settings SettingsBase::with(const std::vector<Override>& overrides, const std::string& name) const {
  // A copy forgets its lines: those of a text that nobody has seen explain nothing.
  toml::table table = table_->in_force;
  for (const Override& override : overrides) put(table, override, name);
  return settings_of(table, name);
}

}  // namespace weakgrid
