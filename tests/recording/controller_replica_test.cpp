// One controller re-executed, fed by hand: what a blocked unit's samples, all the same but for their steps,
// prove and what they do not.
#include "services/recording/controller_replica.hpp"

#include <gtest/gtest.h>

#include <functional>

#include "plant/emulator.hpp"

namespace weakgrid {
namespace {

// A replica and what it is fed.
struct Recorded {
  UnitInputs inputs;
  DifferenceLog differences;
  ControllerReplica replica{1, "controller", inputs, differences, {}};
  Recorded() { replica.configure({}, "test"); }
};

// The same of one plant and one controller.
struct Loop : Recorded {
  Emulator emulator{EmulatorConfiguration{}, {}};
  Controller controller{ControllerConfiguration{}};
};

// Answers every sample of a blocked unit; the recording holds what `edit` leaves: false = nothing.
std::uint64_t differences(const std::function<bool(Measurement&)>& edit) {
  constexpr std::uint64_t steps = 2000;
  Loop l;
  EXPECT_TRUE(l.emulator.trip(Trip::overrun));
  for (std::uint64_t k = 0; k < steps; ++k) {
    const Measurement sample = l.emulator.sample();
    const Modulation answer = l.controller.step(sample);
    Measurement recorded = sample;
    if (edit(recorded)) l.inputs.see("plant", recorded);
    l.replica.note_sample();
    l.replica.see(k + 1, answer);
    l.replica.process(false);
    l.emulator.advance(std::nullopt);
  }
  l.replica.process(true);
  EXPECT_GT(l.replica.findings().compared, 0u);
  EXPECT_EQ(l.replica.findings().identical, l.replica.findings().compared);
  return l.differences.count();
}

TEST(ControllerReplica, ASampleOfABlockedUnitThatIsNotRecordedIsNoDifference) {
  EXPECT_EQ(differences([](const Measurement&) { return true; }), 0u);
  for (const std::uint64_t lost : {1u, 700u, 1500u, 1999u})
    EXPECT_EQ(differences([&](const Measurement& m) { return m.step != lost; }), 0u) << lost;
}

TEST(ControllerReplica, ASampleThatNamesAnotherStepIsADifference) {
  for (const std::uint64_t named : {1ull << 40, 5000ull})
    EXPECT_EQ(differences([&](Measurement& m) {
                if (m.step == 700) m.step = named;
                return true;
              }),
              1u)
        << named;
}

// One that is started anew hears no order of before.
TEST(ControllerReplica, WhoJoinsLateHasNotHeardTheOrdersOfBefore) {
  Loop l;
  Reference before{.id = 1, .q = 0.1, .v_c = 1.9, .ramp_steps = 100};
  Reference heard{.id = 2, .q = -0.1, .v_c = 1.8, .effective_step = 300, .ramp_steps = 100};
  l.inputs.references = {{1, before}, {2, heard}};
  for (std::uint64_t k = 0; k < 1000; ++k) {
    if (k == 100) {
      EXPECT_TRUE(l.controller.accept(heard));
    }
    const Measurement sample = l.emulator.sample();
    const Modulation answer = l.controller.step(sample);
    l.inputs.see("plant", sample);
    l.replica.see(k + 1, answer);
    l.emulator.advance(command(answer));
  }
  l.replica.process(true);
  EXPECT_EQ(l.replica.findings().identical, 1000u);
  EXPECT_EQ(l.differences.count(), 0u);
}

// Of a blocked unit every sample is the other's twin: one that nobody has answered may be just that.
TEST(ControllerReplica, OfABlockedUnitASampleThatTheControllerHasMissedIsNotTheOneThatTheRecordingHas) {
  Loop l;
  EXPECT_TRUE(l.emulator.trip(Trip::overrun));
  std::uint64_t answers = 0;
  for (std::uint64_t k = 0; k < 1000; ++k) {
    const Measurement sample = l.emulator.sample();
    if (k != 500) l.inputs.see("plant", sample);
    if (k != 510) l.replica.see(++answers, l.controller.step(sample));
    l.emulator.advance(std::nullopt);
  }
  l.replica.process(true);
  EXPECT_EQ(l.differences.count(), 0u);
}

// A plant that was killed and one that was started then begin with the same samples to the bit.
TEST(ControllerReplica, OfPlantsThatBeginAlikeTheOneAnsweredAllAlongIsTheOneThatGoesOn) {
  struct Case {
    bool goes_on;               // the killed one sends a last sample when the other is answered already
    std::uint64_t heard_from;   // step of the started one from which the recorder has heard it
    std::uint64_t identical;
  };
  for (const Case& c : {Case{false, 0, 200}, Case{true, 0, 200}, Case{false, 20, 0}}) {
    Recorded r;
    Emulator killed(EmulatorConfiguration{}, {});
    const auto run = [&](const std::string& plant, Emulator& emulator, bool is_answered) {
      Controller controller(ControllerConfiguration{});
      for (std::uint64_t k = 0; k < 200; ++k) {
        const Measurement sample = emulator.sample();
        const Modulation answer = controller.step(sample);
        if (!is_answered || k >= c.heard_from) r.inputs.see(plant, sample);
        if (is_answered) r.replica.see(k + 1, answer);
        if (is_answered && k == 5 && c.goes_on) r.inputs.see("killed", killed.sample());
        emulator.advance(is_answered || k < 9 ? std::optional(command(answer)) : std::nullopt);
      }
    };
    run("killed", killed, false);
    Emulator started(EmulatorConfiguration{}, {});
    run("started", started, true);
    r.replica.process(true);
    EXPECT_EQ(r.differences.count(), 0u);
    EXPECT_EQ(r.replica.findings().identical, c.identical);
  }
}

// Cut off for a while it hears of the last order only.
TEST(ControllerReplica, AnOrderThatAnotherHasReplacedBeforeItCameThroughIsNoDifference) {
  Loop l;
  const Reference first{.id = 1, .q = 0.1, .v_c = 1.9, .ramp_steps = 100};
  const Reference missed{.id = 2, .q = -0.1, .v_c = 1.8, .ramp_steps = 100};
  const Reference last{.id = 3, .q = 0.0, .v_c = 1.84, .effective_step = 500, .ramp_steps = 100};
  l.inputs.references = {{1, first}, {2, missed}, {3, last}};
  for (std::uint64_t k = 0; k < 2000; ++k) {
    if (k == 0 || k == 400) {
      EXPECT_TRUE(l.controller.accept(k == 0 ? first : last));
    }
    const Measurement sample = l.emulator.sample();
    const Modulation answer = l.controller.step(sample);
    l.inputs.see("plant", sample);
    l.replica.see(k + 1, answer);
    if (k % 100 == 0) l.replica.see(l.controller.state());
    l.emulator.advance(command(answer));
  }
  l.replica.process(true);
  EXPECT_EQ(l.differences.count(), 0u);
  EXPECT_EQ(l.replica.findings().identical, 2000u);
}

}  // namespace
}  // namespace weakgrid
