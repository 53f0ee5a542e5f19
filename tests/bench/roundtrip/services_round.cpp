// A round of the real services: they run to a step and wait there, so that whoever asks for the figures does
// not listen while they are made.
#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <thread>

#include "tests/bench/roundtrip/child.hpp"
#include "tests/bench/roundtrip/round.hpp"

namespace weakgrid::bench {

namespace {

// A file as long as it lives.
class SettingsFile {
 public:
  SettingsFile(const std::string& loop, const Place& place, const Conditions& conditions, int cpu)
      : path_((std::filesystem::temp_directory_path() / "weakgrid-bench-XXXXXX").string()) {
    std::string text = fmt::format(
        "[unit]\ndomain = {}\n[timing]\nperiod_us = 50\n[plant]\nsubsteps = 4\n"
        "[realtime]\npriority = {}\ncpu = {}\ndma_latency = {}\n",
        place.domain, conditions.priority, cpu, conditions.dma_latency);
    if (!loop.empty()) text += fmt::format("[dds]\nloop = \"{}\"\n", loop);
    const int file = mkstemp(path_.data());
    const bool is_written = file >= 0 && write(file, text.data(), text.size()) == std::ssize(text);
    if (file >= 0) close(file);
    if (!is_written) throw LinkError(path_ + ": cannot be written");
  }
  ~SettingsFile() { unlink(path_.c_str()); }
  SettingsFile(const SettingsFile&) = delete;
  SettingsFile& operator=(const SettingsFile&) = delete;
  const std::string& path() const { return path_; }

 private:
  std::string path_;
};

// The plant's entry of `weakgrid status --json`, null if it has none.
nlohmann::json plant_status(const Place& place) {
  Child status(
      {program_folder() + "/weakgrid", "status", "--json", "--domain", std::to_string(place.domain)});
  if (!status.wait(std::chrono::seconds(20))) throw LinkError("weakgrid status does not end");
  const auto all = nlohmann::json::parse(status.out(), nullptr, false);
  if (all.is_discarded()) throw LinkError("weakgrid status says: " + status.out() + status.err());
  for (const auto& service : all.at("services"))
    if (service.at("service") == "plant") return service;
  return nullptr;
}

Figures round_trip_of(const nlohmann::json& plant) {
  const auto timings = plant.value("timings", nlohmann::json::array());
  const auto stage =
      std::ranges::find_if(timings, [](const auto& t) { return t.value("stage", "") == "round_trip"; });
  if (stage == timings.end())
    throw LinkError("weakgrid status shows no timings of the plant's stage round_trip");
  Figures figures;
  figures.count = stage->at("count");
  figures.p50 = stage->at("p50_us");
  figures.p99 = stage->at("p99_us");
  figures.p999 = stage->at("p999_us");
  figures.max = stage->at("max_us");
  figures.resends = plant.at("counters").value("resends", std::uint64_t{0});
  return figures;
}

}  // namespace

Figures services_round(const std::string& loop, const Place& place, const Conditions& conditions) {
  const SettingsFile plant_settings(loop, place, conditions, conditions.cpus[0]);
  const SettingsFile controller_settings(loop, place, conditions, conditions.cpus[1]);
  Child controller({program_folder() + "/weakgrid-controller", "--settings", controller_settings.path()});
  Child plant({program_folder() + "/weakgrid-plant", "--settings", plant_settings.path(), "--until",
               std::to_string(conditions.count)});
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(30) +
                        std::chrono::milliseconds(conditions.count);
  // Longer than it takes on any machine that is good for this.
  std::this_thread::sleep_for(std::chrono::seconds(1) + std::chrono::microseconds(100 * conditions.count));
  for (;;) {
    for (Child* child : {&plant, &controller})
      if (const auto status = child->wait(std::chrono::milliseconds(0)))
        throw LinkError(fmt::format("a service has ended with {}: {}", *status, child->err()));
    const nlohmann::json entry = plant_status(place);
    if (!entry.is_null() && entry.at("step") >= conditions.count) return round_trip_of(entry);
    if (std::chrono::steady_clock::now() >= deadline)
      throw LinkError(entry.is_null() ? "no plant is heard"
                                      : "the plant is still at step " + entry["step"].dump());
  }
}

}  // namespace weakgrid::bench
