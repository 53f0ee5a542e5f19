// weakgrid-gateway of services/gateway_service.cpp: its outlet is the simulated network and a real journal.
#include "tests/deterministic/world.hpp"

namespace weakgrid::deterministic {

GatewayProcess::GatewayProcess(World& world, WriterId number, const GatewayMemory& memory)
    : Process(number, "gateway"),
      world_(world),
      memory_(memory),
      started_(world.now()),
      settings_(world.settings()) {
  if (memory.grid) {
    settings_.gateway.grid_resistance = memory.grid->R_g;
    settings_.gateway.grid_reactance = memory.grid->X_g;
    settings_.gateway.grid_voltage = memory.grid->V;
  }
  dialogue_ = std::make_unique<GatewayDialogue>(settings_, id, "", memory_, *this, started_);
}

// One call: judged, and kept so that it can be made again. It may be its death.
template <class Call>
void GatewayProcess::make(Call call) {
  try {
    call(*dialogue_);
    tape_.emplace_back(call, said());
  } catch (const Killed&) {
    world_.kill(*this);
    return;
  }
  world_.note_box(arbiter().rules().box);
}

void GatewayProcess::take(const Request& request, Asked asked, bool is_hostile) {
  asked_ = asked;
  is_hostile_ = is_hostile;
  const Time now = world_.now();
  make([=](GatewayDialogue& d) { d.decide(request, now); });
}

void GatewayProcess::take(const Measurement& measurement, WriterId from) {
  const auto verdict = one_plant_.admit(from, Matched{&world_, world_.now()}, world_.now());
  if (verdict == OneWriter::Verdict::refused) return;
  const bool is_another = verdict == OneWriter::Verdict::changed;
  const Time now = world_.now();
  make([=](GatewayDialogue& d) { d.watch(measurement, is_another, now); });
  if (!runs || has_seen_unit_ || dialogue_->health(now).state != ServiceState::running) return;
  has_seen_unit_ = true;
  check_resumed(measurement);
}

// The unit follows the last that the journal knows: then that is what stands.
void GatewayProcess::check_resumed(const Measurement& m) {
  const auto& last = memory_.reference ? memory_.reference : world_.journal().last_order();
  const bool follows = last && m.reference_id == last->id && m.step >= last->effective_step && !m.blocked &&
                       world_.last_issued() == last->id && m.step >= memory_.step;
  if (follows && (!arbiter().standing() || arbiter().standing()->id < last->id))
    throw Violation{m.step,
                    "a restarted gateway does not know what stands: reference " + std::to_string(last->id)};
}

void GatewayProcess::take(const Health& health) {
  const Time now = world_.now();
  make([=](GatewayDialogue& d) { d.hear(health, now); });
}

void GatewayProcess::look_after() {
  const Time now = world_.now();
  make([=](GatewayDialogue& d) { d.look_after(now); });
}

void GatewayProcess::stop() {
  make([](GatewayDialogue& d) { d.stop(); });
}

std::optional<std::size_t> GatewayProcess::differs_at() const {
  Echo echo;
  GatewayDialogue again(settings_, id, "", memory_, echo, started_);
  for (std::size_t n = 0; n < tape_.size(); ++n) {
    tape_[n].first(again);
    if (echo.said() != tape_[n].second) return n;
  }
  return std::nullopt;
}

void GatewayProcess::speak() {
  if (words_left_ != ~0u && words_left_-- == 0) throw Killed{};
}

bool GatewayProcess::write(const Reference& reference) {
  speak();
  world_.see_issued(*this, reference, dialogue_->arbiter().rules().box);
  last_reference_ = reference;
  world_.publish(*this, reference);
  return Echo::write(reference);
}

bool GatewayProcess::write(const Operation& operation) {
  speak();
  world_.publish(*this, operation);
  return Echo::write(operation);
}

bool GatewayProcess::write(const DecisionMessage& decision) {
  speak();
  world_.see_decided(*this, asked_, is_hostile_, decision.decision);
  return Echo::write(decision);
}

bool GatewayProcess::write(const Envelope& envelope) {
  speak();
  return Echo::write(envelope);
}

bool GatewayProcess::keep(std::string_view kind, nlohmann::json body) {
  speak();
  world_.journal().keep(kind, body, world_.now());
  return Echo::keep(kind, std::move(body));
}

}  // namespace weakgrid::deterministic
