// The listener of services/controller_unit.cpp.
#include "tests/deterministic/world.hpp"

namespace weakgrid::deterministic {

ControllerProcess::ControllerProcess(World& world, WriterId number, Redundancy redundancy)
    : Process(number, redundancy == Redundancy::second ? "second controller" : "controller"),
      world_(world),
      redundancy_(redundancy),
      dialogue_(controller_configuration(world.settings()), redundancy, nanoseconds(20ms)) {}

void ControllerProcess::take(const Reference& reference) {
  Reference kept = reference;
  if (world_.bug() == Bug::no_ramp) kept.ramp_steps = 0;
  dialogue_([=](ControllerDialogue& d) { d.keep(kept); });
}

void ControllerProcess::take(const Modulation& others) {
  if (redundancy_ != Redundancy::none) dialogue_([=](ControllerDialogue& d) { d.hear(others); });
}

void ControllerProcess::take(const ControllerState& others) {
  if (redundancy_ != Redundancy::none) dialogue_([=](ControllerDialogue& d) { d.hear(others); });
}

void ControllerProcess::take(const Measurement& measurement, WriterId from) {
  const Matched matched{&world_, world_.now()};
  const Time now = world_.now();
  if (!dialogue_([=](ControllerDialogue& d) { return d.admit(from, matched, now); })) return;
  std::uint64_t* const hidden = world_.bug() == Bug::hidden_state ? world_.hidden() : nullptr;
  std::optional<Modulation> answer = dialogue_([=](ControllerDialogue& d) {
    auto given = d.answer(measurement, now);
    if (hidden != nullptr && given) given->mu.re *= 1.0 - 1e-12 * static_cast<double>(++*hidden);
    return given;
  });
  if (!answer) return;
  answers_ = true;
  if (world_.bug() == Bug::no_modulation_limit) answer->mu = 1.2 * answer->mu;
  world_.judge().see_answered(id, measurement, *answer, dialogue_->controller().state());
  world_.publish(*this, *answer);
  constexpr std::uint64_t state_every = 100;
  if (redundancy_ != Redundancy::none && measurement.step % state_every == 0)
    world_.publish(*this, dialogue_->controller().state());
}

Health ControllerProcess::health() const {
  Health health;
  health.service = dialogue_->leads() ? "controller" : "standby";
  health.state = answers_ ? ServiceState::running : ServiceState::starting;
  health.reference_id = dialogue_->newest_heard();
  return health;
}

}  // namespace weakgrid::deterministic
