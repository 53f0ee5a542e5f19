// The writer allocates at start-up and then no more. Needs an executable of its own: it replaces operator
// new.
#include <atomic>
#include <new>

#include "tests/recording/recording_support.hpp"

namespace {
std::atomic<std::uint64_t> allocations = 0;
}  // namespace

// Not inlined: else g++ sees malloc meet delete, or new meet free, and warns.
[[gnu::noinline]] void* operator new(std::size_t size) {
  ++allocations;
  if (void* memory = std::malloc(size)) return memory;
  throw std::bad_alloc{};
}
[[gnu::noinline]] void operator delete(void* memory) noexcept { std::free(memory); }
[[gnu::noinline]] void operator delete(void* memory, std::size_t) noexcept { std::free(memory); }

namespace weakgrid::mcap {
namespace {

TEST(McapAllocation, WritingMessagesAllocatesNothingAfterTheFirstChunk) {
  for (const Compression compression : compressions) {
    const Folder folder;
    Writer writer;
    WriterOptions options = small_chunks(compression);
    options.chunk_bytes = 256 << 10;
    ASSERT_TRUE(writer.open(folder / "a.mcap", options).ok());
    const SchemaId schema = writer.add_schema("a::T", "omgidl", "module a { struct T { double x; }; };");
    const ChannelId often = writer.add_channel(schema, "often", "cdr", {});
    const ChannelId seldom = writer.add_channel(schema, "seldom", "cdr", {});
    Random random{5};
    const Bytes payload = random_payload(random, 250);
    const auto write = [&](std::uint32_t messages) {
      bool good = true;
      for (std::uint32_t k = 0; k < messages; ++k) {
        // From 0 to 250 bytes, so that chunks differ in how many messages they hold.
        const ByteView data = ByteView{payload}.first(std::size_t{k} * 7919 % (payload.size() + 1));
        good &= writer.write_message(k % 100 == 0 ? seldom : often, k, k, k, data).ok();
        if (k % 3001 == 0) good &= writer.flush().ok();
        good &= writer.flush_if_older(k).ok();
      }
      return good;
    };
    EXPECT_TRUE(write(10'000));
    const std::uint64_t before = allocations;
    EXPECT_TRUE(write(100'000));
    EXPECT_EQ(allocations - before, 0U) << "compression " << name_of(compression);
    EXPECT_GT(writer.counters().chunks, 30U);
  }
}

}  // namespace
}  // namespace weakgrid::mcap
