// A libFuzzer target: built once for each name of exercise_NAME.
#include <stdlib.h>

#include <cstdint>
#include <filesystem>

#include "tests/fuzz/exercise.hpp"
#include "tests/fuzz/exercise_web.hpp"

namespace {

using weakgrid::mcap::ByteView;

// In memory where there is such a place.
[[maybe_unused]] std::string scratch() {
  const char* parent = std::filesystem::exists("/dev/shm") ? "/dev/shm" : "/tmp";
  std::string name = std::string(parent) + "/weakgrid_fuzz_XXXXXX";
  return mkdtemp(name.data()) == nullptr ? "." : name;
}

[[maybe_unused]] void reader(ByteView bytes) { weakgrid::fuzz::exercise_reader(bytes); }
[[maybe_unused]] void summary(ByteView bytes) { weakgrid::fuzz::exercise_summary(bytes); }
[[maybe_unused]] void payload(ByteView bytes) { weakgrid::fuzz::exercise_payload(bytes); }
[[maybe_unused]] std::string_view text_of(ByteView bytes) { return {reinterpret_cast<const char*>(bytes.data()), bytes.size()}; }

[[maybe_unused]] void settings(ByteView bytes) { weakgrid::fuzz::exercise_settings(text_of(bytes)); }
[[maybe_unused]] void schedule(ByteView bytes) { weakgrid::fuzz::exercise_schedule(text_of(bytes)); }
[[maybe_unused]] void journal(ByteView bytes) { weakgrid::fuzz::exercise_journal(text_of(bytes)); }
[[maybe_unused]] void http(ByteView bytes) { weakgrid::fuzz::exercise_http(text_of(bytes)); }
[[maybe_unused]] void foxglove(ByteView bytes) { weakgrid::fuzz::exercise_foxglove(text_of(bytes)); }
[[maybe_unused]] void recover(ByteView bytes) {
  static const struct Scratch {
    std::string path = scratch();
    ~Scratch() { std::filesystem::remove_all(path); }
  } folder;
  weakgrid::fuzz::exercise_recover(bytes, folder.path);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  WEAKGRID_FUZZ_TARGET({reinterpret_cast<const std::byte*>(data), size});
  return 0;
}
