// The hot path takes nothing from the heap: controller, unit and arbiter, counted by a guard that proves
// itself. This test does not prove that nothing else blocks: no lock, log or clock is looked for here.
#include <gtest/gtest.h>

#include <array>
#include <atomic>
#include <cstdint>
#include <cstdlib>
#include <limits>
#include <memory>
#include <new>
#include <optional>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include "controller/controller.hpp"
#include "gateway/arbiter.hpp"
#include "plant/emulator.hpp"
#include "tests/support/heap_guard.hpp"

namespace weakgrid {
namespace {

using test::HeapGuard;

// Keeps the optimiser from leaving out an allocation that nobody looks at.
void keep(void* memory) { asm volatile("" : : "g"(memory) : "memory"); }

template <typename Action>
std::uint64_t allocations_of(Action action) {
  const HeapGuard guard;
  action();
  return guard.allocations();
}

TEST(HeapGuard, SeesMallocCallocAndRealloc) {
  void* memory = nullptr;
  EXPECT_EQ(allocations_of([&] { keep(memory = std::malloc(100)); }), 1u);
  EXPECT_GE(allocations_of([&] { keep(memory = std::realloc(memory, 100'000)); }), 1u);
  std::free(memory);
  EXPECT_EQ(allocations_of([&] { keep(memory = std::calloc(10, 10)); }), 1u);
  std::free(memory);
}

TEST(HeapGuard, SeesAlignedAllocation) {
  void* memory = nullptr;
  EXPECT_EQ(allocations_of([&] { keep(memory = std::aligned_alloc(64, 128)); }), 1u);
  std::free(memory);
  EXPECT_EQ(allocations_of([&] {
              if (posix_memalign(&memory, 64, 128) != 0) memory = nullptr;
              keep(memory);
            }),
            1u);
  std::free(memory);
}

TEST(HeapGuard, SeesOperatorNewInEveryForm) {
  struct alignas(64) Aligned {
    double x[8];
  };
  int* one = nullptr;
  int* many = nullptr;
  int* quiet = nullptr;
  Aligned* aligned = nullptr;
  EXPECT_EQ(allocations_of([&] { keep(one = new int); }), 1u);
  EXPECT_EQ(allocations_of([&] { keep(many = new int[10]); }), 1u);
  EXPECT_EQ(allocations_of([&] { keep(quiet = new (std::nothrow) int); }), 1u);
  EXPECT_EQ(allocations_of([&] { keep(aligned = new Aligned); }), 1u);
  delete one;
  delete[] many;
  delete quiet;
  delete aligned;
}

TEST(HeapGuard, SeesWhatTheStandardLibraryTakes) {
  EXPECT_GE(allocations_of([] { keep(std::vector<int>(100).data()); }), 1u);
  EXPECT_GE(allocations_of([] { keep(std::string(100, 'x').data()); }), 1u);
  EXPECT_GE(allocations_of([] { keep(std::make_shared<int>(1).get()); }), 1u);
}

TEST(HeapGuard, SeesNothingWhereNothingIsTaken) {
  int* const before = new int{1};
  EXPECT_EQ(allocations_of([&] { delete before; }), 0u);
  EXPECT_EQ(allocations_of([] { keep(std::array<int, 100>{}.data()); }), 0u);
}

TEST(HeapGuard, LeavesOtherThreadsAndWhatComesLaterAlone) {
  std::atomic<int> stage = 0;
  std::thread other([&stage] {
    while (stage != 1) std::this_thread::yield();
    keep(std::vector<int>(100).data());
    stage = 2;
  });
  const std::uint64_t seen = allocations_of([&stage] {
    stage = 1;
    while (stage != 2) std::this_thread::yield();
  });
  other.join();
  EXPECT_EQ(seen, 0u);
  EXPECT_EQ(allocations_of([] {}), 0u);
}

constexpr std::uint64_t million = 1'000'000;

// Whatever may happen on the way: orders, events, lost and spoiled samples, trips, restarts.
TEST(NoHeap, MillionStepsOfControllerAndUnit) {
  std::vector<Event> events;
  for (std::uint64_t k = 0; k < max_events; ++k)
    events.push_back({k * 3000, k % 2 == 0 ? Quantity::grid_voltage : Quantity::grid_inductance,
                      k % 2 == 0 ? 0.9 + 0.001 * static_cast<double>(k % 100) : 2e-4, 100});
  EmulatorConfiguration unit_configuration;
  unit_configuration.substeps = 2;
  Emulator unit(unit_configuration, events);
  Controller controller{ControllerConfiguration{}};
  std::uint64_t accepted = 0, trips = 0, spoiled = 0;
  const std::uint64_t allocations = allocations_of([&] {
    for (std::uint64_t k = 0; k < million; ++k) {
      if (k % 1000 == 10) {
        const Reference reference{.id = static_cast<std::uint32_t>(k),
                                  .p = k % 2000 < 1000 ? 0.5 : 0.2,
                                  .q = k % 3000 < 1000 ? 0.2 : -0.1,
                                  .v_c = 1.8384776310850235,
                                  .effective_step = k + 20,
                                  .ramp_steps = 200};
        if (unit.accept(reference) && controller.accept(reference)) ++accepted;
      }
      Measurement m = unit.sample();
      if (k % 997 == 0) m.v_p.re = std::numeric_limits<double>::quiet_NaN();
      if (k % 1499 == 0) m.timing.delay = 7;
      const Modulation answer = controller.step(m);
      if ((answer.status & (bad_measurement | wrong_timing)) != 0) ++spoiled;
      // From time to time nothing arrives for long enough to trip the unit.
      const bool lost = k % 50'000 < 30 || k % 101 == 0;
      unit.advance(lost ? std::nullopt : std::optional(answer.mu));
      if (unit.trip() != Trip::none && k % 500 == 0) {
        unit.reset_trip();
        ++trips;
      }
      if (k % 100'000 == 99'999) controller.reset();
    }
  });
  EXPECT_EQ(allocations, 0u);
  EXPECT_EQ(unit.step(), million);
  EXPECT_EQ(accepted, 1000u);
  EXPECT_GE(trips, 10u);
  EXPECT_GE(spoiled, 1000u);
}

TEST(NoHeap, ThousandsOfDecisions) {
  Arbiter::Configuration configuration;
  const double L_g = 0.3 / configuration.converter.omega;
  configuration.box = {{0.0, 0.05}, {0.8 * L_g, 1.2 * L_g}, {0.97, 1.03}};
  configuration.loop = LoopModel{configuration.converter, 1.33e7, 6553.0, 1.44e9, 92.0};
  Arbiter arbiter(configuration);
  std::mt19937_64 bits(20'261'122);
  const auto uniform = [&bits] { return -1.5 + 3.0 * static_cast<double>(bits() >> 11) * 0x1p-53; };
  std::array<std::uint64_t, 10> verdicts{};
  const std::uint64_t allocations = allocations_of([&] {
    for (std::uint32_t k = 1; k <= 20'000; ++k) {
      Request request;
      request.who.name.text = {'a', 'n', 'n'};
      request.kind = k % 5 == 0 ? static_cast<RequestKind>(k / 5 % 6) : RequestKind::set;
      request.X_g = {0.2, 0.4};
      request.V = {0.97, 1.03};
      request.token = k % 64;
      request.client = k % 200;  // more than are remembered
      request.id = k % 7 == 0 ? k / 2 : k;
      request.given = static_cast<std::uint32_t>(bits() % 16);
      request.p = uniform();
      request.q = uniform();
      request.v_c = 1.5 + 0.5 * uniform();
      request.effective_step = k % 11 == 0 ? 1 : 0;
      ++verdicts[static_cast<std::size_t>(arbiter.decide(request, k).verdict)];
      if (k % 1000 == 0) arbiter.block();
      if (k % 1000 == 100) arbiter.unblock();
    }
  });
  EXPECT_EQ(allocations, 0u);
  std::uint64_t met = 0;
  for (const std::uint64_t count : verdicts) met += count > 0;
  EXPECT_GE(met, 8u);
}

}  // namespace
}  // namespace weakgrid
