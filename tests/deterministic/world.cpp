// World: see the header.
#include "tests/deterministic/world.hpp"

#include <spdlog/spdlog.h>

#include "tests/deterministic/draw.hpp"

namespace weakgrid::deterministic {

namespace {
constexpr std::uint64_t steps_max = 7'000;
constexpr nanoseconds life_max = 40s;
// After the gateway's knowledge of the grid has changed, until whoever it can reach must have followed.
constexpr nanoseconds to_follow = 1s;
constexpr std::uint64_t steps_to_follow = 100;
}  // namespace

bool Matched::is_alive(WriterId writer) const { return !world->is_gone(writer, at); }

World::World(std::uint64_t seed, Bug bug)
    : seed_(seed),
      bug_(bug),
      dice_(seed),
      true_settings_(draw_settings(dice_)),
      settings_(broken_by(bug, true_settings_)),
      events_(draw_events(dice_, true_settings_, steps_max)),
      network_(scheduler_, dice_, draw_weather(dice_, true_settings_)),
      judge_(true_settings_),
      journal_(seed) {
  if (bug == Bug::journal_after_words) journal_.be_late();
}

World::~World() = default;

Outcome World::run() {
  try {
    processes_.push_back(std::make_unique<Clients>(*this, 1));
    clients_ = static_cast<Clients*>(processes_.back().get());
    start_plant();
    start_controller(true_settings_.controller.redundancy);
    if (true_settings_.controller.redundancy != Redundancy::none) start_controller(Redundancy::second);
    start_gateway();
    plan_clients();
    plan_faults();
    const Time end = now() + life_max;
    while (outcome_.steps < steps_max && now() < end && scheduler_.run_next()) judge_what_is_known();
    judge_again();
  } catch (const Violation& violation) {
    outcome_.violation = violation;
    if (violation.step == 0) outcome_.violation->step = step_seen_;
  }
  for (const ControllerProcess* controller : controllers_) outcome_.takeovers += controller->takeovers();
  outcome_.digest = digest_.value();
  return outcome_;
}

template <class Kind, class... Arguments>
Kind& World::start(std::vector<Kind*>& all, Arguments&&... arguments) {
  auto started = std::make_unique<Kind>(*this, processes_.size() + 1, arguments...);
  Kind& process = *started;
  process.joined = now() + dice_.time(5ms, 200ms);
  processes_.push_back(std::move(started));
  spdlog::info("{}: {} {} starts", when(), process.service, process.id);
  all.push_back(&process);
  meet(process);
  return process;
}

void World::start_plant() {
  PlantProcess& plant = start(plants_);
  say_health(plant);
  plant.step();
}

void World::start_controller(Redundancy redundancy) { say_health(start(controllers_, redundancy)); }

void World::start_gateway() {
  GatewayMemory memory = journal_.open();
  if (bug_ == Bug::journal_forgotten) memory = {};
  GatewayProcess& gateway = start(gateways_, memory);
  note_box(gateway.arbiter().rules().box);
  look_after(gateway);
}

void World::start_again(const Process& dead) {
  if (dynamic_cast<const PlantProcess*>(&dead) != nullptr) start_plant();
  if (const auto* controller = dynamic_cast<const ControllerProcess*>(&dead))
    start_controller(controller->redundancy());
  if (dynamic_cast<const GatewayProcess*>(&dead) != nullptr) start_gateway();
}

// What stands is told to who comes later.
void World::meet(Process& newcomer) {
  for (GatewayProcess* gateway : gateways_) {
    if (!gateway->runs || gateway == &newcomer || !gateway->last_reference()) continue;
    const Reference standing = *gateway->last_reference();
    if (auto* plant = dynamic_cast<PlantProcess*>(&newcomer))
      network_.reliable(*gateway, newcomer, [=] { plant->take(standing); });
    if (auto* controller = dynamic_cast<ControllerProcess*>(&newcomer))
      network_.reliable(*gateway, newcomer, [=] { controller->take(standing); });
  }
  auto* gateway = dynamic_cast<GatewayProcess*>(&newcomer);
  if (gateway == nullptr) return;
  const auto tell = [&](const auto& all) {
    for (const auto* process : all)
      if (process->runs && said_.count(process->id) != 0)
        network_.reliable(*process, newcomer,
                          [gateway, health = process->health()] { gateway->take(health); });
  };
  tell(plants_);
  tell(controllers_);
}

// As an announcer does: at a change, and every second.
template <class Kind>
void World::say_health(Kind& of) {
  const Health health = of.health();
  Said& said = said_[of.id];
  if (said.when == Time{} || health.reference_id != said.reference_id || health.state != said.state ||
      now() - said.when > 1s) {
    said = {health.reference_id, health.state, now()};
    for (GatewayProcess* gateway : gateways_)
      if (gateway->runs) network_.reliable(of, *gateway, [=] { gateway->take(health); });
  }
  network_.at(of, now() + 10ms, [this, &of] { say_health(of); });
}

void World::look_after(GatewayProcess& gateway) {
  gateway.look_after();
  network_.at(gateway, now() + 10ms, [this, &gateway] { look_after(gateway); });
  if (bug_ == Bug::journal_after_words) network_.at(gateway, now() + 9ms, [this] { journal_.flush(); });
}

void World::plan_clients() {
  const nanoseconds pause = timing(settings_).period_ns == 100'000 ? 60ms : 120ms;
  scheduler_.after(dice_.time(1ms, pause), [this] {
    clients_->act();
    plan_clients();
  });
}

void World::publish(const PlantProcess& from, const Measurement& m) {
  for (ControllerProcess* to : controllers_)
    network_.best_effort(from, *to, [=, writer = from.id] { to->take(m, writer); });
  for (GatewayProcess* to : gateways_)
    network_.best_effort(from, *to, [=, writer = from.id] { to->take(m, writer); });
}

void World::publish(const ControllerProcess& from, const Modulation& m) {
  digest_.add(std::uint64_t{bits_of(m)});
  for (PlantProcess* to : plants_)
    network_.best_effort(from, *to, [=, writer = from.id] { to->take(m, writer); });
  for (ControllerProcess* to : controllers_)
    if (to != &from) network_.best_effort(from, *to, [=] { to->take(m); });
}

void World::publish(const ControllerProcess& from, const ControllerState& state) {
  for (ControllerProcess* to : controllers_)
    if (to != &from && to->runs) network_.reliable(from, *to, [=] { to->take(state); });
}

void World::publish(const GatewayProcess& from, const Reference& reference) {
  for (PlantProcess* to : plants_)
    if (to->runs) network_.reliable(from, *to, [=] { to->take(reference); });
  for (ControllerProcess* to : controllers_)
    if (to->runs) network_.reliable(from, *to, [=] { to->take(reference); });
}

void World::publish(const GatewayProcess& from, const Operation& operation) {
  for (PlantProcess* to : plants_)
    if (network_.are_matched(from, *to)) network_.reliable(from, *to, [=] { to->take(operation); });
}

void World::publish(const Clients& from, const Request& request, Asked asked, bool is_hostile) {
  Request sent = request;
  if (bug_ == Bug::repeats_decided) sent.id = static_cast<std::uint32_t>(++hidden_ + 1000);
  for (GatewayProcess* to : gateways_)
    if (network_.are_matched(from, *to))
      network_.reliable(from, *to, [=] { to->take(sent, asked, is_hostile); });
}

void World::see(const PlantProcess& plant, const Measurement& sample) {
  ++outcome_.steps;
  if (!sample.blocked) ++outcome_.steps_running;
  if (sample.state == UnitState::tripped && unit_state_ != UnitState::tripped) ++outcome_.trips;
  if (is_blocked(sample.state) != is_blocked(unit_state_))
    spdlog::info("{}: plant {} is {}", when(), plant.id, name(sample.state));
  if (sample.fallback && !is_fallen_back_) ++outcome_.fallbacks;
  is_fallen_back_ = sample.fallback;
  step_seen_ = sample.step;
  unit_state_ = sample.state;
  digest_.add(std::uint64_t{bits_of(sample)});
  judge_.see_sample(plant.id, sample);
}

void World::see_issued(const GatewayProcess& from, const Reference& reference, const GridBox& box) {
  digest_.add(std::uint64_t{bits_of(reference)});
  spdlog::info("{}: gateway {} issues {}, renews {}: p {} q {} at {}, lease ends {}", when(), from.id,
               reference.id, reference.renews, reference.p, reference.q, reference.effective_step,
               reference.lease_end_step);
  judge_.see_issued(from.id, reference, box);
  journal_.see_issued(reference);
  last_issued_ = std::max(last_issued_, reference.id);
}

void World::see_decided(const GatewayProcess& from, Asked asked, bool is_hostile, const Decision& decision) {
  digest_.add(std::uint64_t{decision.id} << 32 | static_cast<std::uint64_t>(decision.verdict));
  if (!decision.repeated) ++(decision.verdict == Verdict::accepted ? outcome_.accepted : outcome_.refused);
  judge_.see_decided(from.id, asked, is_hostile, decision);
  journal_.see_told(decision);
  network_.reliable(from, *clients_, [this, decision] { clients_->take(decision); });
}

std::string World::when() const {
  const std::chrono::duration<double> since = now() - Scheduler{}.now();
  return fmt::format("{:.6f} s, step {}", since.count(), step_seen_);
}

void World::note_box(const GridBox& box) {
  if (box_ == box) return;
  box_ = box;
  box_since_ = now();
  box_since_step_ = step_seen_;
}

void World::judge_what_is_known() {
  const GatewayProcess* gateway = gateways_.empty() ? nullptr : gateways_.back();
  const bool was_followed = gateway != nullptr && gateway->runs && now() - box_since_ > to_follow &&
                            now() - gateway->goes_on > to_follow && now() - gateway->joined > to_follow &&
                            step_seen_ > box_since_step_ + steps_to_follow;
  judge_.know(gateway == nullptr ? 0 : gateway->id, was_followed ? box_ : std::nullopt);
}

void World::judge_again() const {
  const auto check = [](const auto& all) {
    for (const auto* process : all)
      if (const auto n = process->differs_at())
        throw Violation{0, std::string("made again from its inputs, the ") + process->service +
                               " differs at call " + std::to_string(*n)};
  };
  check(plants_);
  check(controllers_);
  check(gateways_);
}

Outcome run(std::uint64_t seed, Bug bug) { return World(seed, bug).run(); }

}  // namespace weakgrid::deterministic
