// What services make of single messages, without a bus: cases that the simulation of the whole has found.
#include <gtest/gtest.h>

#include <limits>

#include "services/controller_dialogue.hpp"
#include "services/plant_dialogue.hpp"

namespace weakgrid {
namespace {

struct Anybody {
  bool is_alive(WriterId) const { return true; }
};
constexpr std::uint64_t for_ever = std::numeric_limits<std::uint64_t>::max();

Reference order(std::uint32_t id, double p, double q, std::uint64_t effective_step) {
  return {.id = id, .p = p, .q = q, .v_c = 1.84, .effective_step = effective_step, .ramp_steps = 20};
}

// Plant and controller that hear each other, step by step.
struct Pair {
  PlantDialogue plant{{}, {}, for_ever};
  ControllerDialogue controller{{}};

  Measurement sample() {
    plant.hear([](const Operation&) {});
    return plant.emulator().sample();
  }
  Modulation step() {
    const Measurement m = sample();
    const Modulation answer = *controller.answer(m);
    plant.keep(answer);
    plant.advance(plant.answer_to(m));
    return answer;
  }
  void tell_both(const Reference& reference) {
    plant.keep(reference);
    controller.keep(reference);
  }
};

TEST(Dialogue, AnAnswerToAnotherPlantsSampleOfThatStepIsNotUsed) {
  Pair pair;
  for (int k = 0; k < 10; ++k) (void)pair.step();
  const Measurement own = pair.sample();
  Measurement other = own;
  other.i = {0.1, 0.0};
  const Modulation answer_to_other = *ControllerDialogue({}).answer(other);
  ASSERT_EQ(answer_to_other.step, own.step);
  pair.plant.keep(answer_to_other);
  EXPECT_FALSE(pair.plant.answer_to(own));
  EXPECT_EQ(pair.plant.foreign(), 1u);
  pair.plant.keep(*pair.controller.answer(own));
  EXPECT_TRUE(pair.plant.answer_to(own)) << "and its own answer still comes in time";
}

TEST(Dialogue, AnAnswerThatNamesNoSampleIsTakenAtItsStep) {
  Pair pair;
  const Measurement own = pair.sample();
  Modulation answer = *pair.controller.answer(own);
  answer.measurement_fingerprint = 0;
  pair.plant.keep(answer);
  EXPECT_TRUE(pair.plant.answer_to(own));
}

TEST(Dialogue, HoweverManyOrdersWaitTheNewestIsNotLost) {
  Pair pair;
  for (std::uint32_t id = 1; id <= 100; ++id) pair.tell_both(order(id, 0.001 * id, 0.0, 0));
  const Modulation answer = pair.step();
  EXPECT_EQ(pair.sample().reference_id, 100u);
  EXPECT_EQ(answer.reference_id, 100u);
  EXPECT_GT(pair.plant.overflow(), 0u);
  EXPECT_EQ(pair.controller.overflow(), pair.plant.overflow());
}

TEST(Dialogue, WhatIsDueBeginsInTheLawAsInTheSourceEvenIfTheNextOrderIsKnownByThen) {
  Pair pair;
  pair.tell_both(order(1, 0.0, 0.3, 5));
  for (int k = 0; k < 100; ++k) (void)pair.step();
  // Both come between two samples; the second waits for its step.
  pair.tell_both(order(2, 0.0, 0.0, 0));
  pair.tell_both(order(3, 0.1, 0.1, 1000));
  const Modulation answer = pair.step();
  EXPECT_EQ(answer.reference_id, 2u);
  EXPECT_EQ(pair.sample().reference_id, 2u);
  EXPECT_EQ(answer.newest_reference_id, 3u);
}

}  // namespace
}  // namespace weakgrid
