// The law that ties the rooms: what the supervisor accepts for a box of grids, the loop holds on every grid
// of the box; what has no steady state it does not. Accepted with the reserves of
// deploy/settings/supervised.toml.
#include <gtest/gtest.h>

#include <cmath>

#include "controller/controller.hpp"
#include "gateway/arbiter.hpp"
#include "gateway/steady_state.hpp"
#include "plant/emulator.hpp"
#include "tests/support/law_input.hpp"

namespace weakgrid {
namespace {

constexpr double v_c = 1.8384776310850235;

struct Outcome {
  bool tripped = false;
  std::uint64_t saturated = 0;
  double i_max = 0.0, v_p_min = 10.0, v_p_max = 0.0;  // from `watch` on
  double p_error = 0.0, q_error = 0.0;                // at the end
};

Outcome play(const Grid& grid, const Reference& reference, std::uint64_t watch, std::uint64_t end) {
  Controller controller{ControllerConfiguration{}};
  EmulatorConfiguration unit;
  unit.grid = grid;
  unit.substeps = 4;
  Emulator emulator(unit, {});
  (void)emulator.accept(reference);
  (void)controller.accept(reference);
  Outcome out;
  for (std::uint64_t k = 0; k < end; ++k) {
    const Measurement m = emulator.sample();
    const Modulation answer = controller.step(m);
    emulator.advance(command(answer));
    if (emulator.trip() != Trip::none) {
      out.tripped = true;
      return out;
    }
    if ((answer.status & saturated) != 0) ++out.saturated;
    if (k < watch) continue;
    out.i_max = std::max(out.i_max, abs(m.i));
    out.v_p_min = std::min(out.v_p_min, abs(m.v_p));
    out.v_p_max = std::max(out.v_p_max, abs(m.v_p));
    const SpaceVector s = power(m.v_p, m.i);
    out.p_error = std::abs(s.re - reference.p);
    out.q_error = std::abs(s.im - reference.q);
  }
  return out;
}

Arbiter::Configuration supervised(const GridBox& box) {
  Arbiter::Configuration c;
  c.box = box;
  c.limits.reserve = {
      .steady_state = 0.1, .current = 0.02, .control = 0.05, .pcc_voltage = 0.01, .dc_voltage = 0.0};
  const Gains K = sampled_gains({0.001, 0.0011, 0.040}, 1e-4);
  c.loop = LoopModel{c.converter, K.k1, K.k2, K.k3, 92.0};
  c.decay_min = 35.0;
  c.default_ramp_s = 0.05;
  return c;
}

TEST(AcceptedLoopLaw, WhatIsAcceptedIsHeldOnEveryGridOfTheBox) {
  const std::uint64_t count = law_count(60);
  std::uint64_t accepted = 0;
  for (std::uint64_t n = 0; accepted < count && n < 100 * count; ++n) {
    LawInput input(n);
    GridBox box = input.box(0.2, 0.35);
    box.V = {0.97, 1.03};
    Arbiter arbiter(supervised(box));
    Request request;
    request.client = 1;
    request.id = 1;
    request.who.name.text = {'t'};
    request.given = given_p | given_q | given_v_c;
    request.p = input.uniform(-0.5, 1.1);
    request.q = input.uniform(-0.9, 0.9);
    request.v_c = v_c;
    const Decision decision = arbiter.decide(request, 100);
    if (decision.verdict != Verdict::accepted) continue;
    ++accepted;
    const Reference& r = *decision.reference;
    const std::uint64_t reached = r.effective_step + decision.steps_to_reach;
    const Limits limits;
    for (int k = 0; k < 20; ++k) {
      const Grid grid = k < 4   ? corners(box, box.V.low)[static_cast<std::size_t>(k)]
                        : k < 8 ? corners(box, box.V.high)[static_cast<std::size_t>(k - 4)]
                                : input.within(box);
      const Outcome out = play(grid, r, reached, reached + 5000);
      const auto where = [&] {
        std::ostringstream text;
        text << n << ": " << box << "; on R_g " << grid.R_g << ", X_g " << grid.L_g * Converter{}.omega
             << ", V " << grid.V << ": p " << r.p << ", q " << r.q;
        return text.str();
      };
      EXPECT_FALSE(out.tripped) << where();
      EXPECT_EQ(out.saturated, 0u) << where();
      EXPECT_LE(out.i_max, limits.i_max) << where();
      EXPECT_GE(out.v_p_min, limits.v_p_min) << where();
      EXPECT_LE(out.v_p_max, limits.v_p_max) << where();
      EXPECT_LT(out.p_error, 1e-3) << where();
      EXPECT_LT(out.q_error, 1e-3) << where();
      if (HasFailure()) return;
    }
  }
  EXPECT_EQ(accepted, count);
}

TEST(AcceptedLoopLaw, WhatHasNoSteadyStateDoesNotSettle) {
  const std::uint64_t count = law_count(60) / 5;
  std::uint64_t tried = 0;
  for (std::uint64_t n = 0; tried < count; ++n) {
    LawInput input(n);
    const Grid grid{0.0, input.uniform(0.2, 0.4) / Converter{}.omega, 1.0};
    const SpaceVector s{input.uniform(0.0, 1.2), input.uniform(-1.4, 0.0)};
    const SteadyState at = steady_state({grid.R_g, Converter{}.omega * grid.L_g}, grid.V, s);
    if (!(at.lambda < -0.02)) continue;
    ++tried;
    Reference r;
    r.id = 1;
    r.p = s.re;
    r.q = s.im;
    r.v_c = v_c;
    r.effective_step = 100;
    r.ramp_steps = 500;
    const Outcome out = play(grid, r, 1000, 6000);
    EXPECT_TRUE(out.tripped || out.p_error > 1e-2 || out.q_error > 1e-2)
        << n << ": p " << s.re << ", q " << s.im;
  }
}

}  // namespace
}  // namespace weakgrid
