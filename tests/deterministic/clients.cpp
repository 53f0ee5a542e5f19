// Clients: see the header.
#include "tests/deterministic/clients.hpp"

#include <limits>

#include "tests/deterministic/world.hpp"

namespace weakgrid::deterministic {

namespace {
constexpr double nan = std::numeric_limits<double>::quiet_NaN();
constexpr double inf = std::numeric_limits<double>::infinity();
}  // namespace

Clients::Clients(World& world, WriterId number) : Process(number, "client"), world_(world) {
  for (std::uint64_t n = 1; n <= 4; ++n) clients_.push_back({.id = n, .unanswered = {}});
  for (std::uint64_t n = 11; n <= 14; ++n) strangers_.push_back({.id = n, .unanswered = {}});
}

void Clients::act() {
  Dice& dice = world_.dice();
  if (dice.one_in(6) && !sent_.empty()) {  // somebody replays what he has overheard
    const Sent& sent = sent_[dice.below(sent_.size())];
    return world_.publish(*this, sent.request, sent.asked, sent.is_hostile);
  }
  if (dice.one_in(6)) return send(hostile(strangers_[dice.below(strangers_.size())]), true);
  Client& client = clients_[dice.below(clients_.size())];
  if (client.unanswered && !dice.one_in(10)) return send(*client.unanswered, false);
  client.unanswered = good(client);
  send(*client.unanswered, false);
}

void Clients::take(const Decision& decision) {
  for (Client& client : clients_) {
    if (client.id != decision.client || client.asked != decision.id) continue;
    client.unanswered.reset();
    if (decision.offer) client.token = decision.offer->token;
  }
}

void Clients::send(const Request& request, bool is_hostile) {
  const Asked asked{request.client, request.id};
  sent_.push_back({request, asked, is_hostile});
  world_.publish(*this, request, asked, is_hostile);
}

double Clients::lease_s() {
  return world_.dice().uniform(300.0, 4000.0) * period_s(timing(world_.settings()));
}

Request Clients::begin(Client& client) {
  Request request;
  request.client = client.id;
  request.id = ++client.asked;
  request.who.name.text = {'c', static_cast<char>('0' + client.id % 10)};
  constexpr Source sources[] = {Source::operation, Source::operation, Source::schedule, Source::test};
  request.who.source = sources[client.id % 4];
  return request;
}

void Clients::fill_setpoint(Request& r) {
  Dice& dice = world_.dice();
  r.kind = RequestKind::set;
  r.given = dice.chance(0.7) ? given_p | given_q | given_v_c : 1u + static_cast<std::uint32_t>(dice.below(7));
  const double size = dice.chance(0.8) ? 1.0 : 3.0;  // beyond: infeasible
  r.p = size * dice.uniform(-0.1, 0.75);
  r.q = size * dice.uniform(-0.35, 0.6);
  r.v_c = dice.chance(0.9) ? dice.uniform(1.75, 2.1) : dice.uniform(1.0, 3.0);
  if (dice.one_in(3)) r.ramp_s = world_.settings().gateway.ramp_s * dice.uniform(1.0, 4.0);
  if (dice.one_in(5))
    r.effective_step = world_.step_seen() + 1 + static_cast<std::uint64_t>(dice.uniform(0.0, 2500.0));
  r.policy = static_cast<Policy>(dice.below(4));
}

// What a blocked unit needs; false: it is not blocked.
bool Clients::operate(Request& r) {
  const UnitState state = world_.unit_state();
  if (state == UnitState::tripped && !world_.dice().one_in(5))
    r.kind = RequestKind::reset;
  else if (state == UnitState::off || state == UnitState::tripped)
    r.kind = state == UnitState::off ? RequestKind::start : RequestKind::stop;
  else
    return false;
  return true;
}

Request Clients::good(Client& client) {
  Dice& dice = world_.dice();
  Request r = begin(client);
  r.lease_s = lease_s();
  if (operate(r)) return r;
  const std::size_t what = dice.below(20);
  if (what < 11) {
    fill_setpoint(r);
  } else if (what < 13) {
    r.kind = RequestKind::accept;
    r.token = client.token;
  } else if (what < 16) {
    r.kind = RequestKind::renew;
  } else if (what < 17) {
    r.kind = dice.one_in(2) ? RequestKind::take : RequestKind::release;
  } else if (what < 19) {
    const double X = world_.settings().grid.reactance;
    r.kind = RequestKind::set_grid;
    r.X_g = {X * dice.uniform(0.6, 1.0), X * dice.uniform(1.0, 1.5)};
    r.V = {dice.uniform(0.93, 1.0), dice.uniform(1.0, 1.03)};
  } else {
    constexpr RequestKind kinds[] = {RequestKind::start, RequestKind::stop, RequestKind::reset};
    r.kind = dice.of(kinds);
  }
  return r;
}

// Every one of these must be refused, whenever it comes.
Request Clients::hostile(Client& client) {
  Dice& dice = world_.dice();
  Request r = begin(client);
  fill_setpoint(r);
  r.given = given_p | given_q | given_v_c;
  const double wrong[] = {nan, inf, -inf, 1e300, -11.0, 11.0};
  switch (dice.below(12)) {
    case 0:
      r.p = dice.of(wrong);
      break;
    case 1:
      r.q = dice.of(wrong);
      break;
    case 2:
      r.v_c = dice.of(wrong);
      break;
    case 3:
      r.ramp_s = dice.one_in(2) ? nan : -1.0;
      break;
    case 4:
      r.lease_s = dice.one_in(2) ? nan : -1.0;
      break;
    case 5:
      r.given = dice.one_in(2) ? 0 : 8u | given_p;
      break;
    case 6:
      if (dice.one_in(3))
        r.client = 0;
      else if (dice.one_in(2))
        r.id = 0;
      else
        r.effective_step = step_max + 1;
      break;
    case 7:
      r.who.source = Source::protection;
      break;
    case 8:
      r.who.name = {};
      break;
    case 9:
      r.kind = RequestKind::revalidate;
      r.V = {0.1, 2.0};
      break;
    case 10:
      r.kind = RequestKind::set_grid;
      r.X_g = {0.4, 0.1};
      r.V = {nan, 1.0};
      break;
    default:
      r.kind = RequestKind::accept;
      r.token = 0xdeadbeef;
      break;
  }
  return r;
}

}  // namespace weakgrid::deterministic
