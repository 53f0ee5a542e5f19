// The loop of services/plant_unit.cpp, turned inside out: what waits there is an event here.
#include "tests/deterministic/world.hpp"

namespace weakgrid::deterministic {

namespace {
std::int64_t ns(Time t) { return t.time_since_epoch().count(); }
constexpr nanoseconds between_steps = 5us;
}  // namespace

PlantProcess::PlantProcess(World& world, WriterId number)
    : Process(number, "plant"),
      world_(world),
      dialogue_(emulator_configuration(world.settings()), std::span<const Event>(world.events()),
                ~std::uint64_t{0}) {}

void PlantProcess::take(const Modulation& modulation, WriterId from) {
  const Matched matched{&world_, world_.now()};
  const Time now = world_.now();
  const bool is_admitted =
      dialogue_([=](PlantDialogue& d) { return d.admit(from, modulation.epoch, matched, now); });
  if (!is_admitted && world_.bug() != Bug::no_fence) return;
  world_.judge().see_admitted(id, from, now, modulation,
                              [&](WriterId writer) { return !matched.is_alive(writer); });
  Modulation kept = modulation;
  if (world_.bug() == Bug::stale_answer && last_ && kept.step < last_->step) {
    kept.step = last_->step;
    kept.measurement_fingerprint = 0;
  }
  dialogue_([=](PlantDialogue& d) { d.keep(kept); });
  if (!is_waiting_) return;
  if (const auto found = answer()) {
    is_waiting_ = controller_is_lost_ = false;
    has_been_answered_ = true;
    end_step(found);
  }
}

void PlantProcess::take(const Reference& reference) {
  Reference kept = reference;
  if (world_.bug() == Bug::no_lease) kept.lease_end_step = 0;
  dialogue_([=](PlantDialogue& d) { d.keep(kept); });
}

void PlantProcess::take(const Operation& operation) {
  dialogue_([=](PlantDialogue& d) { d.keep(operation); });
}

Health PlantProcess::health() const {
  Health health;
  health.service = service;
  health.state = has_been_answered_ ? ServiceState::running : ServiceState::starting;
  health.step = emulator().step();
  health.reference_id = dialogue_->newest_heard();
  return health;
}

void PlantProcess::step() {
  dialogue_([](PlantDialogue& d) { d.hear([](const Operation&) {}); });
  last_ = dialogue_([](PlantDialogue& d) { return d.emulator().sample(); });
  world_.see(*this, *last_);
  const bool in_time = world_.settings().plant.pace == Pace::realtime && has_been_answered_;
  if (!in_time) {
    is_waiting_ = true;
    waited_ = 0ns;
    send(*last_);
    return wait_for_answer(++exchange_);
  }
  if (!grid_) grid_ = TimeGrid{last_->step, ns(world_.now()), timing(world_.settings()).period_ns};
  send(*last_);
  world_.network().at(*this, Time(nanoseconds(grid_->time_of(last_->step + 1))) + world_.late_by(),
                      [this] { end_step(answer()); });
}

void PlantProcess::send(const Measurement& sample) { world_.publish(*this, sample); }

// In lockstep: the sample again now and then, until patience is over.
void PlantProcess::wait_for_answer(std::uint64_t exchange) {
  world_.network().at(*this, world_.now() + resend_after, [this, exchange] {
    if (!is_waiting_ || exchange != exchange_) return;
    waited_ += resend_after;
    const nanoseconds patience =
        controller_is_lost_
            ? resend_after
            : nanoseconds(static_cast<std::int64_t>(world_.settings().plant.patience_s * 1e9));
    if (has_been_answered_ && waited_ >= patience) {
      is_waiting_ = false;
      controller_is_lost_ = true;
      return end_step(std::nullopt);
    }
    send(*last_);
    wait_for_answer(exchange);
  });
}

std::optional<Modulation> PlantProcess::answer() {
  const Measurement sample = *last_;
  return dialogue_([=](PlantDialogue& d) { return d.answer_to(sample); });
}

void PlantProcess::end_step(const std::optional<Modulation>& answer) {
  world_.judge().see_applied(id, *last_, answer, emulator().newest_reference_id());
  dialogue_([=](PlantDialogue& d) { d.advance(answer); });
  if (grid_) make_up_for_missed();
  world_.network().at(*this, world_.now() + between_steps, [this] { step(); });
}

void PlantProcess::make_up_for_missed() {
  const std::uint64_t missed = grid_->missed(emulator().step(), ns(world_.now()));
  if (missed == 0) return;
  if (world_.settings().plant.overrun == Overrun::block)
    dialogue_([](PlantDialogue& d) { d.trip(Trip::overrun); });
  const auto see = [this] {
    const Measurement sample = dialogue_([](PlantDialogue& d) { return d.emulator().sample(); });
    world_.see(*this, sample);
    return sample;
  };
  send(see());
  const std::uint64_t n = std::min(missed, catch_up_max);
  for (std::uint64_t k = 0; k < n; ++k) {
    dialogue_([](PlantDialogue& d) { d.advance(std::nullopt); });
    if (k + 1 < n) (void)see();
  }
}

}  // namespace weakgrid::deterministic
