// Announcer: see the header.
#include "services/runtime/announcer.hpp"

#include <map>
#include <random>

#include "services/runtime/sha256.hpp"
#include "services/runtime/wire.hpp"

namespace weakgrid {

std::uint64_t random_identity() {
  std::random_device device;
  std::uint64_t identity = 0;
  while (identity == 0) identity = (std::uint64_t{device()} << 32) | device();
  return identity;
}

std::int64_t wall_time_ns() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::system_clock::now().time_since_epoch())
      .count();
}

std::string build_text() { return "weakgrid " WEAKGRID_VERSION ", " WEAKGRID_COMPILER; }

std::string digest_of(std::uint32_t unit, const Manifest& manifest) {
  Sha256 sum;
  const auto add_number = [&sum](const auto& number) { sum.add(std::as_bytes(std::span{&number, 1})); };
  const auto add_text = [&](const std::string& text) {
    add_number(std::uint64_t{text.size()});
    sum.add(std::as_bytes(std::span{text}));
  };
  add_number(unit);
  add_text(manifest.service);
  add_number(manifest.instance);
  add_text(manifest.build);
  add_text(manifest.settings);
  for (const Constant& constant : manifest.constants) {
    add_text(constant.name);
    add_number(constant.value);
  }
  return sum.hex();
}

std::string name_in_log(const Settings& settings) {
  return settings.unit.count > 1 ? "unit " + std::to_string(settings.unit.number) + ": " : "";
}

std::string one_line(const std::vector<const Health*>& units) {
  std::map<std::string, std::size_t> counts;
  for (const Health* unit : units) ++counts[unit->text.empty() ? name(unit->state) : unit->text];
  if (counts.size() == 1) return counts.begin()->first;
  std::string line;
  for (const auto& [words, count] : counts)
    line += (line.empty() ? "" : ", ") + std::to_string(count) + " " + words;
  return line;
}

bool is_announced(const std::string& topic) {
  return topic == Topic<Health>::name || topic == Topic<Manifest>::name;
}

Announcer::Announcer(Bus& bus, const Settings& settings, const std::string& service,
                     std::vector<Constant> constants)
    : health_(bus, settings.unit.number),
      manifest_(bus, settings.unit.number),
      service_(service),
      instance_(settings.unit.instance != 0 ? settings.unit.instance : random_identity()) {
  Manifest manifest{.service = service_,
                    .instance = instance_,
                    .build = build_text(),
                    .settings = to_toml(settings),
                    .constants = std::move(constants),
                    .digest = {}};
  manifest.digest = digest_of(settings.unit.number, manifest);
  if (!manifest_.write(manifest)) throw BusError("DDS: the manifest cannot be written");
}

Announcer::~Announcer() {
  Health goodbye = last_;
  goodbye.state = ServiceState::stopped;
  goodbye.text = "stopped";
  say(goodbye);
  // The participant goes next, and with it what was not taken.
  health_.wait_until_taken(std::chrono::milliseconds(500));
}

void Announcer::say(Health health, std::span<const Stage> stages) noexcept {
  const auto now = std::chrono::steady_clock::now();
  if (health.service.empty()) health.service = service_;
  const bool changed = health.service != last_.service || health.state != last_.state ||
                       health.reference_id != last_.reference_id || health.text != last_.text ||
                       health.digest != last_.digest;
  // Where a unit has come to a stand, whoever waits for that step hears of it at once.
  const bool stands_still = health.step == seen_step_ && health.step != last_.step;
  seen_step_ = health.step;
  if (!changed && !stands_still && now - said_ < std::chrono::seconds(1)) return;
  // Under another name from now on: nobody may take the old one's last word for the present.
  if (!last_.service.empty() && health.service != last_.service) {
    Health goodbye = last_;
    goodbye.state = ServiceState::stopped;
    goodbye.text = "is the " + health.service + " now";
    goodbye.wall_time_ns = wall_time_ns();
    (void)health_.write(goodbye);
  }
  health.instance = instance_;
  health.wall_time_ns = wall_time_ns();
  if (!stages.empty()) health.timings = timings_of(stages);
  if (!health_.write(health)) return;  // said again at the next call
  last_ = health;
  said_ = now;
}

}  // namespace weakgrid
