// Wire ↔ domain, field by field.
#include "services/runtime/wire.hpp"

#include <algorithm>

namespace weakgrid {

namespace {

// The bits of the IDL and of the controller are the same by construction.
static_assert(saturated == wire::SATURATED && bad_measurement == wire::BAD_MEASUREMENT &&
              low_voltage == wire::LOW_VOLTAGE && gap == wire::GAP && wrong_timing == wire::WRONG_TIMING &&
              started == wire::STARTED && fallback == wire::FALLBACK);
static_assert(given_p == wire::GIVEN_ACTIVE_POWER && given_q == wire::GIVEN_REACTIVE_POWER &&
              given_v_c == wire::GIVEN_DC_VOLTAGE);

constexpr std::uint32_t state_shift = 5;
static_assert(static_cast<std::uint32_t>(UnitState::holding) << state_shift == wire::STATE_HOLDING &&
              static_cast<std::uint32_t>(UnitState::tripped) << state_shift == wire::STATE_TRIPPED &&
              static_cast<std::uint32_t>(UnitState::off) << state_shift == wire::STATE_OFF &&
              static_cast<std::uint32_t>(UnitState::precharge) << state_shift == wire::STATE_PRECHARGE &&
              static_cast<std::uint32_t>(UnitState::ready) << state_shift == wire::STATE_READY);

Name name_of(const char* text) {
  Name name;
  for (std::size_t k = 0; k + 1 < name.text.size() && text[k] != '\0'; ++k) name.text[k] = text[k];
  return name;
}

std::string cut(const std::string& text, std::size_t most) { return text.substr(0, most); }

template <class To, class From>
bool decode_enum(From in, To last, To& out) {
  const auto value = static_cast<std::uint32_t>(in);
  if (value > static_cast<std::uint32_t>(last)) return false;
  out = static_cast<To>(value);
  return true;
}

void encode(const Ramp& m, wire::Ramp& out) {
  out.from(m.from);
  out.to(m.to);
  out.slope(m.slope);
  out.start_step(m.start);
  out.steps(m.steps);
  out.slope_steps(m.slope_steps);
}

void decode(const wire::Ramp& in, Ramp& m) {
  m = {in.from(), in.to(), in.slope(), in.start_step(), in.steps(), in.slope_steps()};
}

template <class Sequence>
void encode(const Margins& margins, Sequence& out) {
  out.clear();
  for (const LimitMargin& margin : margins) {
    wire::LimitMargin& item = out.emplace_back();
    item.limit(static_cast<wire::LimitName>(margin.limit));
    item.enforced(margin.enforced);
    item.margin(margin.margin);
    item.required(margin.required);
    item.grid_resistance(margin.grid.R_g);
    item.grid_inductance_s(margin.grid.L_g);
    item.grid_voltage(margin.grid.V);
  }
}

template <class Sequence>
bool decode(const Sequence& in, Margins& margins) {
  if (in.size() > margin_count) return false;
  for (const wire::LimitMargin& item : in) {
    LimitMargin margin{.enforced = item.enforced(),
                       .margin = item.margin(),
                       .required = item.required(),
                       .grid = {item.grid_resistance(), item.grid_inductance_s(), item.grid_voltage()}};
    if (!decode_enum(item.limit(), Limit::transient, margin.limit)) return false;
    margins.add(margin);
  }
  return true;
}

}  // namespace

void encode(const Measurement& m, wire::Measurement& out) {
  std::uint32_t flags = 0;
  if (m.timing.hold == Hold::still) flags |= wire::HOLD_STILL;
  if (m.timing.sampling == Sampling::period_mean) flags |= wire::PERIOD_MEAN;
  if (m.timing.delay == 1) flags |= wire::DELAY_ONE;
  if (m.blocked) flags |= wire::BLOCKED;
  if (m.fallback) flags |= wire::SOURCE_FALLBACK;
  flags |= static_cast<std::uint32_t>(m.state) << state_shift;
  out.period_ns(static_cast<std::uint32_t>(m.timing.period_ns));
  out.flags(flags);
  out.reference_id(m.reference_id);
  out.step(m.step);
  out.time_ns(static_cast<std::int64_t>(m.step * static_cast<std::uint64_t>(m.timing.period_ns)));
  out.pcc_voltage_alpha(m.v_p.re);
  out.pcc_voltage_beta(m.v_p.im);
  out.current_alpha(m.i.re);
  out.current_beta(m.i.im);
  out.dc_voltage(m.v_c);
  out.source_power(m.p_i);
}

bool decode(const wire::Measurement& in, Measurement& m) {
  constexpr std::uint32_t known = wire::HOLD_STILL | wire::PERIOD_MEAN | wire::DELAY_ONE | wire::BLOCKED |
                                  wire::SOURCE_FALLBACK | wire::STATE_MASK;
  const std::uint32_t flags = in.flags();
  if ((flags & ~known) != 0 || static_cast<std::uint64_t>(in.time_ns()) != in.step() * in.period_ns())
    return false;
  m.step = in.step();
  m.timing.period_ns = in.period_ns();
  m.timing.delay = (flags & wire::DELAY_ONE) != 0 ? 1 : 0;
  m.timing.hold = (flags & wire::HOLD_STILL) != 0 ? Hold::still : Hold::turning;
  m.timing.sampling = (flags & wire::PERIOD_MEAN) != 0 ? Sampling::period_mean : Sampling::instantaneous;
  m.reference_id = in.reference_id();
  m.blocked = (flags & wire::BLOCKED) != 0;
  m.fallback = (flags & wire::SOURCE_FALLBACK) != 0;
  if (!decode_enum((flags & wire::STATE_MASK) >> state_shift, UnitState::ready, m.state)) return false;
  if (m.blocked != is_blocked(m.state)) return false;
  m.v_p = {in.pcc_voltage_alpha(), in.pcc_voltage_beta()};
  m.i = {in.current_alpha(), in.current_beta()};
  m.v_c = in.dc_voltage();
  m.p_i = in.source_power();
  return true;
}

void encode(const Modulation& m, wire::Modulation& out) {
  out.period_ns(m.period_ns);
  out.reference_id(m.reference_id);
  out.status(m.status);
  out.newest_reference_id(m.newest_reference_id);
  out.measurement_fingerprint(m.measurement_fingerprint);
  out.step(m.step);
  out.epoch(m.epoch);
  out.modulation_alpha(m.mu.re);
  out.modulation_beta(m.mu.im);
}

bool decode(const wire::Modulation& in, Modulation& m) {
  m = {.step = in.step(),
       .period_ns = in.period_ns(),
       .reference_id = in.reference_id(),
       .status = in.status(),
       .newest_reference_id = in.newest_reference_id(),
       .measurement_fingerprint = in.measurement_fingerprint(),
       .epoch = in.epoch(),
       .mu = {in.modulation_alpha(), in.modulation_beta()}};
  return true;
}

void encode(const Request& m, wire::SetpointRequest& out) {
  out.given(m.given);
  out.client(m.client);
  out.id(m.id);
  out.kind(static_cast<wire::RequestKind>(m.kind));
  out.source(static_cast<wire::Source>(m.who.source));
  out.name(m.who.name.text.data());
  out.policy(static_cast<wire::OfferPolicy>(m.policy));
  out.token(m.token);
  out.active_power(m.p);
  out.reactive_power(m.q);
  out.dc_voltage(m.v_c);
  out.ramp_s(m.ramp_s);
  out.lease_s(m.lease_s);
  out.effective_step(m.effective_step);
  out.grid_resistance_min(m.R_g.low);
  out.grid_resistance_max(m.R_g.high);
  out.grid_reactance_min(m.X_g.low);
  out.grid_reactance_max(m.X_g.high);
  out.grid_voltage_min(m.V.low);
  out.grid_voltage_max(m.V.high);
}

bool decode(const wire::SetpointRequest& in, Request& m) {
  m = {};
  if (!decode_enum(in.kind(), RequestKind::revalidate, m.kind)) return false;
  if (!decode_enum(in.source(), Source::protection, m.who.source)) return false;
  if (!decode_enum(in.policy(), Policy::keep_power_factor, m.policy)) return false;
  m.who.name = name_of(in.name().c_str());
  m.client = in.client();
  m.id = in.id();
  m.given = in.given();
  m.p = in.active_power();
  m.q = in.reactive_power();
  m.v_c = in.dc_voltage();
  m.ramp_s = in.ramp_s();
  m.lease_s = in.lease_s();
  m.token = in.token();
  m.effective_step = in.effective_step();
  m.R_g = {in.grid_resistance_min(), in.grid_resistance_max()};
  m.X_g = {in.grid_reactance_min(), in.grid_reactance_max()};
  m.V = {in.grid_voltage_min(), in.grid_voltage_max()};
  return true;
}

void encode(const DecisionMessage& m, wire::SetpointDecision& out) {
  const Decision& d = m.decision;
  const Reference reference = d.reference.value_or(Reference{});
  const Offer offer = d.offer.value_or(Offer{});
  out.id(d.id);
  out.client(d.client);
  out.kind(static_cast<wire::RequestKind>(d.kind));
  out.verdict(static_cast<wire::Verdict>(d.verdict));
  out.field(static_cast<wire::RequestField>(d.field));
  out.active_power(d.setpoint.p);
  out.reactive_power(d.setpoint.q);
  out.dc_voltage(d.setpoint.v_c);
  out.reference_id(reference.id);
  out.renews(reference.renews);
  out.ramp_steps(reference.ramp_steps);
  out.steps_to_reach(d.steps_to_reach);
  out.effective_step(reference.effective_step);
  out.lease_end_step(reference.lease_end_step);
  out.reference_active_power(reference.p);
  out.reference_reactive_power(reference.q);
  out.reference_dc_voltage(reference.v_c);
  out.fallback_active_power(reference.fallback_p);
  out.fallback_reactive_power(reference.fallback_q);
  out.fallback_dc_voltage(reference.fallback_v_c);
  out.fallback_ramp_steps(reference.fallback_ramp_steps);
  out.offer_token(offer.token);
  out.offer_is_detour(offer.is_detour);
  out.offer_active_power(offer.setpoint.p);
  out.offer_reactive_power(offer.setpoint.q);
  out.offer_dc_voltage(offer.setpoint.v_c);
  out.offer_valid_until_step(offer.valid_until_step);
  out.leaves_at_active_power(d.leaves_at.p);
  out.leaves_at_reactive_power(d.leaves_at.q);
  out.leaves_at_dc_voltage(d.leaves_at.v_c);
  out.holder_source(static_cast<wire::Source>(d.holder.source));
  out.holder_name(d.holder.name.text.data());
  out.held_until_step(d.held_until_step);
  out.decided_step(d.decided_step);
  out.standing_reference_id(d.standing_reference_id);
  out.request_fingerprint(d.request_fingerprint);
  out.unit_state(static_cast<std::uint32_t>(d.unit_state));
  out.measured_grid_voltage_min(d.measured_V.low);
  out.measured_grid_voltage_max(d.measured_V.high);
  encode(d.margins, out.margins());
  out.text(cut(m.text, 255));
}

bool decode(const wire::SetpointDecision& in, DecisionMessage& m) {
  Decision& d = m.decision;
  d = {};
  d.client = in.client();
  d.id = in.id();
  if (!decode_enum(in.kind(), RequestKind::revalidate, d.kind)) return false;
  if (!decode_enum(in.verdict(), Verdict::interlocked, d.verdict)) return false;
  if (!decode_enum(in.field(), Field::kind, d.field)) return false;
  d.setpoint = {in.active_power(), in.reactive_power(), in.dc_voltage()};
  if (in.reference_id() != 0)
    d.reference = Reference{.id = in.reference_id(),
                            .p = in.reference_active_power(),
                            .q = in.reference_reactive_power(),
                            .v_c = in.reference_dc_voltage(),
                            .effective_step = in.effective_step(),
                            .ramp_steps = in.ramp_steps(),
                            .renews = in.renews(),
                            .lease_end_step = in.lease_end_step(),
                            .fallback_p = in.fallback_active_power(),
                            .fallback_q = in.fallback_reactive_power(),
                            .fallback_v_c = in.fallback_dc_voltage(),
                            .fallback_ramp_steps = in.fallback_ramp_steps()};
  if (in.offer_token() != 0)
    d.offer = Offer{in.offer_token(),
                    {in.offer_active_power(), in.offer_reactive_power(), in.offer_dc_voltage()},
                    in.offer_is_detour(),
                    in.offer_valid_until_step()};
  d.leaves_at = {in.leaves_at_active_power(), in.leaves_at_reactive_power(), in.leaves_at_dc_voltage()};
  if (!decode_enum(in.holder_source(), Source::protection, d.holder.source)) return false;
  d.holder.name = name_of(in.holder_name().c_str());
  d.held_until_step = in.held_until_step();
  d.steps_to_reach = in.steps_to_reach();
  d.decided_step = in.decided_step();
  d.standing_reference_id = in.standing_reference_id();
  d.request_fingerprint = in.request_fingerprint();
  if (!decode_enum(in.unit_state(), UnitState::ready, d.unit_state)) return false;
  d.measured_V = {in.measured_grid_voltage_min(), in.measured_grid_voltage_max()};
  if (!decode(in.margins(), d.margins)) return false;
  m.text = in.text().c_str();
  return true;
}

void encode(const Envelope& m, wire::Envelope& out) {
  out.reference_id(m.reference_id);
  out.step(m.step);
  out.grid_resistance_min(m.grid.R_g.low);
  out.grid_resistance_max(m.grid.R_g.high);
  out.grid_reactance_min(m.grid.X_g.low);
  out.grid_reactance_max(m.grid.X_g.high);
  out.grid_voltage_min(m.grid.V.low);
  out.grid_voltage_max(m.grid.V.high);
  out.active_power(m.setpoint.p);
  out.reactive_power(m.setpoint.q);
  out.dc_voltage(m.setpoint.v_c);
  out.lease_end_step(m.lease_end_step);
  out.fallen_back(m.fallen_back);
  out.fallback_holds(m.fallback_holds);
  out.holder_source(static_cast<wire::Source>(m.holder.source));
  out.holder_name(m.holder.name.text.data());
  out.held_until_step(m.held_until_step);
  encode(m.margins, out.margins());
}

bool decode(const wire::Envelope& in, Envelope& m) {
  m = {};
  m.reference_id = in.reference_id();
  m.step = in.step();
  m.grid.R_g = {in.grid_resistance_min(), in.grid_resistance_max()};
  m.grid.X_g = {in.grid_reactance_min(), in.grid_reactance_max()};
  m.grid.V = {in.grid_voltage_min(), in.grid_voltage_max()};
  m.setpoint = {in.active_power(), in.reactive_power(), in.dc_voltage()};
  m.lease_end_step = in.lease_end_step();
  m.fallen_back = in.fallen_back();
  m.fallback_holds = in.fallback_holds();
  if (!decode_enum(in.holder_source(), Source::protection, m.holder.source)) return false;
  m.holder.name = name_of(in.holder_name().c_str());
  m.held_until_step = in.held_until_step();
  return decode(in.margins(), m.margins);
}

void encode(const Reference& m, wire::Reference& out) {
  out.id(m.id);
  out.renews(m.renews);
  out.ramp_steps(m.ramp_steps);
  out.active_power(m.p);
  out.reactive_power(m.q);
  out.dc_voltage(m.v_c);
  out.effective_step(m.effective_step);
  out.lease_end_step(m.lease_end_step);
  out.fallback_active_power(m.fallback_p);
  out.fallback_reactive_power(m.fallback_q);
  out.fallback_dc_voltage(m.fallback_v_c);
  out.fallback_ramp_steps(m.fallback_ramp_steps);
}

bool decode(const wire::Reference& in, Reference& m) {
  m = {.id = in.id(),
       .p = in.active_power(),
       .q = in.reactive_power(),
       .v_c = in.dc_voltage(),
       .effective_step = in.effective_step(),
       .ramp_steps = in.ramp_steps(),
       .renews = in.renews(),
       .lease_end_step = in.lease_end_step(),
       .fallback_p = in.fallback_active_power(),
       .fallback_q = in.fallback_reactive_power(),
       .fallback_v_c = in.fallback_dc_voltage(),
       .fallback_ramp_steps = in.fallback_ramp_steps()};
  return true;
}

void encode(const ControllerState& m, wire::ControllerState& out) {
  out.older_in_a_row(static_cast<std::uint32_t>(m.older));
  out.step(m.last.step);
  out.started(m.started);
  out.reference_id(m.last.reference_id);
  out.newest_reference_id(m.last.newest_reference_id);
  out.status(m.last.status);
  out.measurement_fingerprint(m.last.measurement_fingerprint);
  out.period_ns(m.last.period_ns);
  out.modulation_alpha(m.last.mu.re);
  out.modulation_beta(m.last.mu.im);
  out.filtered_pcc_voltage_alpha(m.law.v_p_hat.re);
  out.filtered_pcc_voltage_beta(m.law.v_p_hat.im);
  out.pcc_voltage_alpha(m.law.v_p.re);
  out.pcc_voltage_beta(m.law.v_p.im);
  out.energy_error(m.law.e1.re);
  out.reactive_energy_error(m.law.e1.im);
  out.energy_error_integral(m.law.y.re);
  out.reactive_energy_error_integral(m.law.y.im);
  out.reactive_power_error(m.law.q_error);
  out.reactive_energy_error_kept(m.law.eta_error);
  out.active_power_reference(m.law.p_r);
  out.modulation_before_alpha(m.law.mu_before.re);
  out.modulation_before_beta(m.law.mu_before.im);
  out.modulation_in_force_alpha(m.law.mu.re);
  out.modulation_in_force_beta(m.law.mu.im);
  out.command_alpha(m.law.command.re);
  out.command_beta(m.law.command.im);
  encode(m.references.q, out.reactive_power_ramp());
  encode(m.references.v_c, out.dc_voltage_ramp());
  const ReferenceTrack& track = m.references.track;
  encode(track.in_force.value_or(Reference{}), out.in_force());
  encode(track.pending.value_or(Reference{}), out.pending());
  out.fallen_back(track.fallen_back);
  out.accepted_reference_id(track.newest_id);
  out.order_id(track.order_id);
}

bool decode(const wire::ControllerState& in, ControllerState& m) {
  m = {};
  m.older = in.older_in_a_row();
  m.started = in.started();
  m.last = {.step = in.step(),
            .period_ns = in.period_ns(),
            .reference_id = in.reference_id(),
            .status = in.status(),
            .newest_reference_id = in.newest_reference_id(),
            .measurement_fingerprint = in.measurement_fingerprint(),
            .mu = {in.modulation_alpha(), in.modulation_beta()}};
  m.law.v_p_hat = {in.filtered_pcc_voltage_alpha(), in.filtered_pcc_voltage_beta()};
  m.law.v_p = {in.pcc_voltage_alpha(), in.pcc_voltage_beta()};
  m.law.e1 = {in.energy_error(), in.reactive_energy_error()};
  m.law.y = {in.energy_error_integral(), in.reactive_energy_error_integral()};
  m.law.q_error = in.reactive_power_error();
  m.law.eta_error = in.reactive_energy_error_kept();
  m.law.p_r = in.active_power_reference();
  m.law.mu_before = {in.modulation_before_alpha(), in.modulation_before_beta()};
  m.law.mu = {in.modulation_in_force_alpha(), in.modulation_in_force_beta()};
  m.law.command = {in.command_alpha(), in.command_beta()};
  decode(in.reactive_power_ramp(), m.references.q);
  decode(in.dc_voltage_ramp(), m.references.v_c);
  ReferenceTrack& track = m.references.track;
  if (in.in_force().id() != 0 && !decode(in.in_force(), track.in_force.emplace())) return false;
  if (in.pending().id() != 0 && !decode(in.pending(), track.pending.emplace())) return false;
  track.fallen_back = in.fallen_back();
  track.newest_id = in.accepted_reference_id();
  track.order_id = in.order_id();
  return true;
}

void encode(const Operation& m, wire::Operation& out) {
  out.client(m.client);
  out.id(m.id);
  out.kind(static_cast<wire::OperationKind>(m.kind));
  out.until_step(m.until_step);
}

bool decode(const wire::Operation& in, Operation& m) {
  m.client = in.client();
  m.id = in.id();
  m.until_step = in.until_step();
  return decode_enum(in.kind(), OperationKind::stop, m.kind);
}

void encode(const Health& m, wire::Health& out) {
  out.service(cut(m.service, 15));
  out.instance(m.instance);
  out.state(static_cast<wire::ServiceState>(m.state));
  out.step(m.step);
  out.reference_id(m.reference_id);
  out.wall_time_ns(m.wall_time_ns);
  out.counters().clear();
  for (const Counter& counter : m.counters) {
    wire::Counter& item = out.counters().emplace_back();
    item.name(cut(counter.name, 31));
    item.value(counter.value);
  }
  out.digest(cut(m.digest, 64));
  out.text(cut(m.text, 255));
  out.timings().clear();
  for (const StageTiming& timing : m.timings) {
    wire::StageTiming& item = out.timings().emplace_back();
    item.stage(cut(timing.stage, 15));
    item.count(timing.count);
    item.p50_ns(timing.p50_ns);
    item.p99_ns(timing.p99_ns);
    item.p999_ns(timing.p999_ns);
    item.max_ns(timing.max_ns);
    item.sum_ns(timing.sum_ns);
    item.at_most().assign(timing.at_most.begin(), timing.at_most.end());
  }
}

bool decode(const wire::Health& in, Health& m) {
  m = {};
  m.service = in.service().c_str();
  m.instance = in.instance();
  if (!decode_enum(in.state(), ServiceState::stopped, m.state)) return false;
  m.step = in.step();
  m.reference_id = in.reference_id();
  m.wall_time_ns = in.wall_time_ns();
  for (const wire::Counter& item : in.counters()) m.counters.push_back({item.name().c_str(), item.value()});
  m.digest = in.digest().c_str();
  m.text = in.text().c_str();
  for (const wire::StageTiming& item : in.timings()) {
    StageTiming& timing = m.timings.emplace_back(StageTiming{item.stage().c_str(), item.count(), item.p50_ns(),
                                                             item.p99_ns(), item.p999_ns(), item.max_ns(),
                                                             item.sum_ns(), {}});
    std::copy_n(item.at_most().begin(), std::min(item.at_most().size(), timing.at_most.size()),
                timing.at_most.begin());
  }
  return true;
}

void encode(const Manifest& m, wire::Manifest& out) {
  out.service(cut(m.service, 15));
  out.instance(m.instance);
  out.build(cut(m.build, 255));
  out.settings(cut(m.settings, 8191));
  out.constants().clear();
  for (const Constant& constant : m.constants) {
    wire::Constant& item = out.constants().emplace_back();
    item.name(cut(constant.name, 31));
    item.value(constant.value);
  }
  out.digest(cut(m.digest, 64));
}

bool decode(const wire::Manifest& in, Manifest& m) {
  m = {};
  m.service = in.service().c_str();
  m.instance = in.instance();
  m.build = in.build().c_str();
  m.settings = in.settings().c_str();
  for (const wire::Constant& item : in.constants())
    m.constants.push_back({item.name().c_str(), item.value()});
  m.digest = in.digest().c_str();
  return true;
}

}  // namespace weakgrid
