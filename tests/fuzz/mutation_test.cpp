// Recordings, payloads, settings and journals damaged at random: each is refused, or read as far as it goes;
// none crashes, hangs or breaks a claim. The count is WEAKGRID_LAW_COUNT; WEAKGRID_LAW_FIRST is the seed to
// begin with.
#include <cstdio>
#include <ctime>

#include "services/journal/journal_reader.hpp"
#include "services/runtime/payload.hpp"
#include "services/runtime/wire_fields.hpp"
#include "tests/fuzz/exercise.hpp"
#include "tests/fuzz/exercise_web.hpp"
#include "tests/fuzz/seeds.hpp"
#include "tests/recording/payload_of.hpp"
#include "tests/recording/recording_support.hpp"

#ifdef WEAKGRID_SANITIZED
#include <sanitizer/common_interface_defs.h>
#endif

namespace weakgrid::fuzz {
namespace {

using mcap::below;
using mcap::Bytes;
using mcap::Random;

constexpr double case_s_max = 5.0;  // of the processor: a thousand times what one takes, and still no hang

std::uint32_t current_seed = 0;

[[maybe_unused]] void say_seed() { std::fprintf(stderr, "at seed %u\n", current_seed); }

// Lengths of all ones and high bits are what overflows are made of.
std::byte some_byte(Random& random) {
  const auto kind = below(random, 4);
  return kind == 0 ? std::byte{0xff} : kind == 1 ? std::byte{0} : static_cast<std::byte>(random());
}

template <class Buffer>
void mutate_once(Buffer& bytes, Random& random) {
  const auto at = [&](std::size_t offset) { return bytes.begin() + static_cast<std::ptrdiff_t>(offset); };
  using Element = typename Buffer::value_type;
  const std::size_t from = below(random, bytes.size());
  const std::size_t count = std::min<std::size_t>(1 + below(random, 9), bytes.size() - from);
  switch (below(random, 6)) {
    case 0:
      bytes[from] = static_cast<Element>(static_cast<unsigned>(bytes[from]) ^ 1U << below(random, 8));
      break;
    case 1:
    case 2:
      std::generate_n(at(from), count, [&] { return static_cast<Element>(some_byte(random)); });
      break;
    case 3:
      bytes.erase(at(from), at(from + count));
      break;
    case 4: {  // something of its own, at another place
      const std::size_t long_count = std::min<std::size_t>(below(random, 300), bytes.size() - from);
      const Buffer part(at(from), at(from + long_count));
      bytes.insert(at(below(random, bytes.size())), part.begin(), part.end());
      break;
    }
    default:
      bytes.insert(at(from), count, static_cast<Element>(some_byte(random)));
  }
}

template <class Buffer>
Buffer mutated(Buffer bytes, Random& random) {
  for (std::uint64_t k = below(random, 8); k < 8 && !bytes.empty(); ++k) mutate_once(bytes, random);
  if (below(random, 4) == 0 && !bytes.empty()) bytes.resize(below(random, bytes.size()));
  return bytes;
}

/// Tries exercise(damaged) on `count` damaged copies of the inputs, in turn.
template <class Buffer, class Exercise>
void try_all(const std::vector<Buffer>& inputs, std::uint32_t count, Exercise exercise) {
#ifdef WEAKGRID_SANITIZED
  __sanitizer_set_death_callback(say_seed);
#endif
  const char* first = std::getenv("WEAKGRID_LAW_FIRST");
  const auto begin = first == nullptr ? 0U : static_cast<std::uint32_t>(std::strtoul(first, nullptr, 10));
  double worst_s = 0.0;
  std::uint32_t worst_seed = begin;
  for (std::uint32_t seed = begin; seed < begin + count; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    current_seed = seed;
    Random random{seed};
    const Buffer damaged = mutated(inputs[seed % inputs.size()], random);
    const std::clock_t start = std::clock();
    ASSERT_NO_THROW(exercise(damaged));
    const double case_s = static_cast<double>(std::clock() - start) / CLOCKS_PER_SEC;
    ASSERT_LT(case_s, case_s_max);
    if (case_s > worst_s) worst_seed = seed;
    worst_s = std::max(worst_s, case_s);
  }
  std::printf("%u cases, worst %.3f s of the processor, seed %u\n", count, worst_s, worst_seed);
}

TEST(Mutations, ADamagedRecordingIsReadRecoveredAndExportedAsFarAsItGoes) {
  const mcap::Folder folder;
  try_all(recording_seeds(folder / "."), mcap::law_count(1500), [&](const Bytes& bytes) {
    exercise_reader(bytes);
    exercise_summary(bytes);
    exercise_recover(bytes, folder / ".");
  });
}

TEST(Mutations, ADamagedPayloadIsRefusedOrDecoded) {
  try_all(payload_seeds(), mcap::law_count(20'000), [](const Bytes& bytes) { exercise_payload(bytes); });
}

TEST(Mutations, DamagedSettingsAreRefusedOrReadBackTheSame) {
  try_all(settings_seeds(), mcap::law_count(2000), [](const std::string& text) { exercise_settings(text); });
}

TEST(Mutations, ADamagedScheduleIsRefusedOrInOrder) {
  try_all(schedule_seeds(), mcap::law_count(20'000),
          [](const std::string& text) { exercise_schedule(text); });
}

TEST(Mutations, ADamagedJournalIsReadUpToItsFault) {
  try_all(journal_seeds(), mcap::law_count(20'000), [](const std::string& text) { exercise_journal(text); });
}

TEST(Mutations, ADamagedConnectionIsAnsweredOrEndsAndOthersAreServed) {
  try_all(http_seeds(), mcap::law_count(2000), [](const std::string& bytes) { exercise_http(bytes); });
}

TEST(Mutations, ADamagedFoxgloveClientIsToldSo) {
  try_all(foxglove_seeds(), mcap::law_count(5000), [](const std::string& text) { exercise_foxglove(text); });
}

TEST(Mutations, APayloadLongerThanItsTypeCanBeIsRefused) {
  const char* const type = "weakgrid::wire::Measurement";
  Bytes payload = payload_of(1, Measurement{});
  payload.resize(payload.size() + 3);
  EXPECT_TRUE(fields_of_payload(type, payload)) << "RTPS pads to 4 bytes";
  payload.resize(payload.size() + 1);
  EXPECT_FALSE(fields_of_payload(type, payload));
  EXPECT_FALSE(from_payload<Measurement>(payload));

  // A million counters without a name, as a sequence that is bounded to 32 announces them.
  payload = payload_of(1, Health{});
  constexpr std::size_t count_offset = 4 + 56;
  constexpr std::uint32_t count = 1'000'000;
  ASSERT_EQ(mcap::load<std::uint32_t>(&payload[count_offset]), 0U);
  payload.resize(count_offset);
  mcap::put(payload, count);
  payload.resize(payload.size() + std::size_t{count} * 24);
  EXPECT_FALSE(fields_of_payload("weakgrid::wire::Health", payload));
}

TEST(Mutations, TheInputsThemselvesAreGood) {
  const mcap::Folder folder;
  for (const Bytes& seed : recording_seeds(folder / ".")) {
    mcap::ScanReport report;
    EXPECT_EQ(mcap::content_of(mcap::ByteView{seed}, report).messages.size(), 20U);
    EXPECT_TRUE(report.intact()) << report.text();
    EXPECT_GT(report.chunks, 3U);
  }
  for (const std::string& seed : journal_seeds()) {
    JournalScan scan;
    scan.feed(seed);
    EXPECT_TRUE(scan.finish().intact());
  }
  EXPECT_EQ(payload_seeds().size(), 10U);
  for (const Bytes& seed : payload_seeds()) EXPECT_GT(seed.size(), 4U);
}

}  // namespace
}  // namespace weakgrid::fuzz
