// The ring between receiving and writing, and the count of what has not come.
#include "services/recording/ring.hpp"

#include <deque>
#include <thread>

#include "services/recording/sequence_map.hpp"
#include "tests/recording/recording_support.hpp"

namespace weakgrid {
namespace {

using mcap::Bytes;

TEST(SampleRing, GivesBackWhatWasPutInOrderUntilItIsFullAndThenCountsTheLoss) {
  for (std::uint64_t seed = 1; seed <= mcap::law_count(200); ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    mcap::Random random{seed};
    SampleRing ring(512 + mcap::below(random, 1024), 3);
    std::deque<std::pair<RawSample, Bytes>> model;
    std::uint64_t drops[3] = {};
    for (int k = 0; k < 2000; ++k) {
      if (mcap::below(random, 100) < 55) {
        Bytes data = mcap::random_payload(random, mcap::below(random, 20) == 0 ? 2000 : 150);
        RawSample sample{.writer = static_cast<std::uint32_t>(mcap::below(random, 3)),
                         .has_data = mcap::below(random, 10) != 0,
                         .sequence = random(),
                         .source_ns = k,
                         .reception_ns = 2 * k,
                         .payload = data};
        if (ring.put(sample))
          model.emplace_back(sample, std::move(data));
        else
          ++drops[sample.writer];
      } else {
        const auto sample = ring.front();
        ASSERT_EQ(sample.has_value(), !model.empty());
        if (!sample) continue;
        const auto& [expected, data] = model.front();
        ASSERT_EQ(sample->writer, expected.writer);
        ASSERT_EQ(sample->has_data, expected.has_data);
        ASSERT_EQ(sample->sequence, expected.sequence);
        ASSERT_EQ(sample->source_ns, expected.source_ns);
        ASSERT_EQ(sample->reception_ns, expected.reception_ns);
        ASSERT_TRUE(std::equal(sample->payload.begin(), sample->payload.end(), data.begin(), data.end()));
        ring.drop_front();
        model.pop_front();
      }
    }
    EXPECT_GT(drops[0] + drops[1] + drops[2], 0u);
    for (std::uint32_t writer = 0; writer < 3; ++writer) EXPECT_EQ(ring.drops(writer), drops[writer]);
  }
}

TEST(SampleRing, AWriterBeyondTheCountedOnesIsRefused) {
  SampleRing ring(1024, 1);
  EXPECT_FALSE(ring.put({.writer = 1}));
  EXPECT_FALSE(ring.front());
}

TEST(SampleRing, OfSeveralThreadsEverySampleIsTakenOnceOrCountedAsLost) {
  constexpr std::uint32_t threads = 3;
  constexpr std::uint64_t each = 20'000;
  SampleRing ring(1 << 14, threads);
  std::atomic<std::uint32_t> running{threads};
  std::vector<std::jthread> writers;
  for (std::uint32_t writer = 0; writer < threads; ++writer)
    writers.emplace_back([&, writer] {
      const Bytes data(40 + writer, static_cast<std::byte>(writer));
      for (std::uint64_t n = 1; n <= each; ++n) ring.put({.writer = writer, .sequence = n, .payload = data});
      --running;
    });
  SequenceMap seen[threads];
  for (;;) {
    const bool is_last_look = running == 0;
    const auto sample = ring.front();
    if (!sample && is_last_look) break;
    if (!sample) continue;
    ASSERT_EQ(sample->payload.size(), 40 + sample->writer);
    ASSERT_EQ(sample->payload.back(), static_cast<std::byte>(sample->writer));
    ASSERT_TRUE(seen[sample->writer].see(sample->sequence)) << "in order, never twice";
    ring.drop_front();
  }
  for (std::uint32_t writer = 0; writer < threads; ++writer)
    EXPECT_EQ(seen[writer].count() + ring.drops(writer), each);
}

TEST(SequenceMap, AgreesWithASetWhateverTheOrder) {
  for (std::uint64_t seed = 1; seed <= mcap::law_count(300); ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    mcap::Random random{seed};
    SequenceMap map;
    std::set<std::uint64_t> model;
    std::uint64_t next = 1 + mcap::below(random, 100), repeated = 0;
    const std::uint64_t first = next;
    for (int k = 0; k < 200; ++k) {
      // Mostly the next, sometimes one further, one late or one again.
      const auto dice = k == 0 ? 0 : mcap::below(random, 100);
      const std::uint64_t one = dice < 80   ? next
                                : dice < 90 ? next + 1 + mcap::below(random, 3)
                                            : first + mcap::below(random, next - first + 1);
      const bool is_new = model.insert(one).second;
      repeated += is_new ? 0 : 1;
      ASSERT_EQ(map.see(one), is_new) << one;
      next = std::max(next, one + 1);
    }
    EXPECT_EQ(map.first(), first);
    EXPECT_EQ(map.last(), *model.rbegin());
    EXPECT_EQ(map.count(), model.size());
    EXPECT_EQ(map.missing(), map.last() - map.first() + 1 - model.size());
    EXPECT_EQ(map.repeated(), repeated);
    std::uint64_t in_gaps = 0;
    for (const auto& [from, to] : map.gaps()) {
      in_gaps += to - from + 1;
      for (std::uint64_t n = from; n <= to; ++n) EXPECT_EQ(model.count(n), 0u);
    }
    EXPECT_EQ(in_gaps, map.missing());
  }
}

}  // namespace
}  // namespace weakgrid
