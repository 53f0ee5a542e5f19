// A controller whose answers come too late for many steps in a row, as on a busy machine in real time: it
// sees every sample, nothing of what it answers is used. When it is heard again the unit goes on where it
// was.
#include <gtest/gtest.h>

#include <cmath>

#include "controller/controller.hpp"
#include "plant/emulator.hpp"
#include "tests/support/law_input.hpp"

namespace weakgrid {
namespace {

struct Outcome {
  Trip trip = Trip::none;
  double i_error_max = 0.0;  // after the last burst, over the last period of the grid
};

Outcome after_bursts(const Grid& grid, double p, unsigned burst_max, LawInput& input) {
  const Timing timing{.period_ns = 100'000, .delay = 1};
  EmulatorConfiguration unit;
  unit.timing = timing;
  unit.grid = grid;
  unit.protection.max_holds = 1000;
  ControllerConfiguration law;
  law.timing = timing;
  Emulator emulator(unit, {});
  Controller controller(law);
  const Reference order{.id = 1, .p = p, .q = 0.0, .v_c = law.v_c, .effective_step = 100, .ramp_steps = 400};
  (void)emulator.accept(order);
  (void)controller.accept(order);
  constexpr std::uint64_t begin = 5000, end = 30'000, last = 40'000;
  std::uint64_t held_until = 0;
  Outcome outcome;
  SpaceVector i_before;
  while (emulator.step() < last && emulator.trip() == Trip::none) {
    const std::uint64_t k = emulator.step();
    const Measurement m = emulator.sample();
    if (k == begin) i_before = m.i;
    if (k >= begin && k < end && k >= held_until && input.one_in(300))
      held_until = k + 1 + static_cast<std::uint64_t>(input.uniform(0.0, burst_max));
    const Modulation answer = controller.step(m);
    emulator.advance(k < held_until ? std::nullopt : std::optional(answer.mu));
    // Whole periods of the grid after `begin`: the current would be where it was.
    if (k >= last - 200 && (k - begin) % 200 == 0)
      outcome.i_error_max = std::max(outcome.i_error_max, abs(m.i - i_before));
  }
  outcome.trip = emulator.trip();
  return outcome;
}

TEST(HeldLaw, AUnitThatWasNotAnsweredForAWhileGoesOnWhereItWas) {
  for (const double X_g : {0.0, 0.1, 0.2})
    for (const double p : {0.0, 0.3})
      for (std::uint64_t n = 0; n < law_count(4); ++n) {
        LawInput input(n);
        const Outcome outcome = after_bursts({0.0, X_g / Converter{}.omega, 1.0}, p, 400, input);
        EXPECT_EQ(outcome.trip, Trip::none) << "X_g " << X_g << ", p " << p << ", case " << n;
        EXPECT_LT(outcome.i_error_max, 1e-3) << "X_g " << X_g << ", p " << p << ", case " << n;
      }
}

}  // namespace
}  // namespace weakgrid
