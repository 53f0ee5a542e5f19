// Writes the seeds as files, a folder for each target: make_seeds FOLDER.
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <span>

#include "tests/fuzz/exercise_web.hpp"
#include "tests/fuzz/seeds.hpp"

namespace {

void write(const std::filesystem::path& folder, std::size_t n, std::span<const std::byte> bytes) {
  std::filesystem::create_directories(folder);
  std::ofstream file{folder / ("seed_" + std::to_string(n)), std::ios::binary};
  file.write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
}

}  // namespace

int main(int argc, char** argv) {
  using namespace weakgrid::fuzz;
  if (argc != 2) {
    std::fprintf(stderr, "usage: make_seeds FOLDER\n");
    return 2;
  }
  const std::filesystem::path folder = argv[1];
  std::filesystem::create_directories(folder);
  std::size_t n = 0;
  for (const auto& seed : recording_seeds(folder.string())) {
    for (const char* target : {"reader", "summary", "recover"}) write(folder / target, n, seed);
    ++n;
  }
  for (const auto& seed : payload_seeds()) write(folder / "payload", n++, seed);
  for (const auto& seed : settings_seeds()) write(folder / "settings", n++, std::as_bytes(std::span{seed}));
  for (const auto& seed : schedule_seeds()) write(folder / "schedule", n++, std::as_bytes(std::span{seed}));
  for (const auto& seed : journal_seeds()) write(folder / "journal", n++, std::as_bytes(std::span{seed}));
  for (const auto& seed : http_seeds()) write(folder / "http", n++, std::as_bytes(std::span{seed}));
  for (const auto& seed : foxglove_seeds()) write(folder / "foxglove", n++, std::as_bytes(std::span{seed}));
  std::printf("%zu seeds in %s\n", n, argv[1]);
}
