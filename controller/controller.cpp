// Controller: see the header. Names are the paper's; x is where the law is evaluated.
#include "controller/controller.hpp"

#include <algorithm>

namespace weakgrid {

namespace {

bool in_range(const Measurement& m) noexcept {
  // Comparisons with NaN are false, so NaN is out of range.
  return abs2(m.v_p) <= 100.0 && abs2(m.i) <= 1e4 && m.v_c >= 0.01 && m.v_c <= 10.0 && m.p_i >= -10.0 &&
         m.p_i <= 10.0;
}

double power_squared(double p, double q) noexcept { return p * p + q * q; }

}  // namespace

ControllerConstants derive_constants(const ControllerConfiguration& configuration) {
  const double T = period_s(configuration.timing);
  const double omega = configuration.converter.omega;
  const SpaceVector half_turn = unit_phasor(0.5 * omega * T);
  const double sinc = half_turn.im / (0.5 * omega * T);
  ControllerConstants constants;
  constants.T = T;
  constants.K = sampled_gains(configuration.settling_times_s, T);
  constants.notch = make_notch(configuration.kappa, omega, T);
  constants.tracking = T * settling_factor / *std::ranges::max_element(configuration.settling_times_s);
  constants.turn = unit_phasor(omega * T);
  constants.held = configuration.timing.hold == Hold::still ? sinc * conj(half_turn) : SpaceVector{1.0, 0.0};
  constants.mean_to_end = half_turn / sinc;
  return constants;
}

Controller::Controller(const ControllerConfiguration& configuration)
    : configuration_(configuration),
      constants_(derive_constants(configuration)),
      shaper_(configuration.v_c, constants_.T) {}

void Controller::reset() noexcept {
  started_ = false;
  last_ = {};
  shaper_.forget();
}

ControllerState Controller::state() const noexcept {
  return {state_, shaper_.state(), last_, started_, older_};
}

void Controller::restore(const ControllerState& state) noexcept {
  state_ = state.law;
  shaper_.restore(state.references);
  last_ = state.last;
  started_ = state.started;
  older_ = state.older;
}

// Bumpless: v̂_p on v_p, no error, and the μ in force taken to be what the present current needs.
void Controller::start(SpaceVector v_p, SpaceVector i, double v_c) noexcept {
  state_ = {};
  state_.v_p = conj(constants_.turn) * v_p;
  state_.v_p_hat = state_.v_p;
  state_.p_r = power(v_p, i).re;
  state_.mu = (v_p + (configuration_.converter.omega * configuration_.converter.L) * times_j(i)) / v_c;
  state_.mu_before = state_.mu;
  state_.command = state_.mu / constants_.held;
}

// One period without a usable sample: the plant holds μ, turning; phasors turn with it, errors stand.
void Controller::turn_on() noexcept {
  const SpaceVector turn = constants_.turn;
  state_.v_p_hat = turn * state_.v_p_hat;
  state_.v_p = turn * state_.v_p;
  state_.mu_before = turn * (configuration_.timing.delay == 1 ? state_.mu : state_.mu_before);
  state_.mu = turn * state_.mu;
  state_.command = turn * state_.command;
}

// What a held μ amounts to, turning, and the way back. 1 where μ turns: neither multiplied nor divided by.
[[gnu::always_inline]] inline SpaceVector Controller::as_turning(SpaceVector mu) const noexcept {
  return configuration_.timing.hold == Hold::turning ? mu : constants_.held * mu;
}
[[gnu::always_inline]] inline SpaceVector Controller::as_held(SpaceVector mu) const noexcept {
  return configuration_.timing.hold == Hold::turning ? mu : mu / constants_.held;
}

[[gnu::always_inline]] inline double Controller::floored(double v_p_hat2) const noexcept {
  const double floor = configuration_.v_p_hat_min * configuration_.v_p_hat_min;
  return v_p_hat2 > floor ? v_p_hat2 : floor;
}

// The integrals one step on to x, by the trapezoid.
[[gnu::always_inline]] inline Controller::Errors Controller::integrate(const Errors& before,
                                                                       const Point& x) const noexcept {
  const Converter& c = configuration_.converter;
  const double half_T = 0.5 * constants_.T;
  const double q_r = x.reference.q_r, v_cr = x.reference.v_cr;
  Errors errors;
  errors.q_error = power(x.v_p_hat, x.i).im - q_r;
  errors.eta_error = before.eta_error + half_T * (before.q_error + errors.q_error);
  const double i_r2 = power_squared(x.p_r, q_r) / floored(abs2(x.v_p_hat));
  const double energy = 0.5 * (c.L * abs2(x.i) + c.C * (x.v_c * x.v_c));  // eq:xi1_est
  const double energy_r = 0.5 * (c.L * i_r2 + c.C * (v_cr * v_cr));
  errors.e1 = {energy - energy_r, errors.eta_error};
  errors.y = before.y + half_T * (before.e1 + errors.e1);  // eq:dy_est
  return errors;
}

// Backward Euler, in closed form: the equation is stiff near p_r = 0.
[[gnu::always_inline]] inline double Controller::next_p_r(const Point& x, double p_i,
                                                          const ShapedReference& r) const noexcept {
  const Converter& c = configuration_.converter;
  const double T = constants_.T, delta_p = configuration_.delta_p;
  const double b = abs2(x.v_p_hat) * T / c.L;
  const double g = b * (p_i - c.C * (r.dv_cr * r.v_cr)) - T * (r.dq_r * r.q_r);
  // (p⁺ − p_r)(|p⁺| + δ_p) + b p⁺ = g, a quadratic on either side of p⁺ = 0; taken for p_r ≥ 0.  eq:dpr
  const double sign = x.p_r < 0.0 ? -1.0 : 1.0;
  const double p_r = sign * x.p_r;
  const double d = p_r * delta_p + sign * g;
  const double B = delta_p - p_r + b;
  const double discriminant = B * B + 4.0 * d;
  // The root that p_r leads to without crossing 0, if there is one.
  if (d >= 0.0 || (B < 0.0 && discriminant >= 0.0)) {
    const double root = std::sqrt(discriminant);
    if (B <= 0.0) return sign * 0.5 * (root - B);
    return sign * (2.0 * d / (B + root));
  }
  const double D = delta_p + p_r + b;
  return sign * (2.0 * d / (D + std::sqrt(D * D - 4.0 * d)));
}

// What i, v_c and v̂_p will be at the next sample, under the μ that is in force until then: the physical
// state, not the error triple, since a weak grid answers through L + L_g.
[[gnu::always_inline]] inline Controller::Point Controller::predict(
    const Point& x, SpaceVector v_p, double p_i, const ShapedReference& next) const noexcept {
  const Converter& c = configuration_.converter;
  const double T = constants_.T;
  const SpaceVector turn = constants_.turn, mu = state_.mu;
  const SpaceVector v_p_after = v_p + (configuration_.rho * x.v_c) * (mu - state_.mu_before);
  const SpaceVector slope =
      (x.v_c * mu - v_p_after) / c.L - c.omega * times_j(x.i);  // eq:L di, turning frame
  const SpaceVector i_mean = x.i + (0.5 * T) * slope;
  Point ahead;
  ahead.i = turn * (x.i + T * slope);
  ahead.v_c = x.v_c + T * (p_i / x.v_c - (mu.re * i_mean.re + mu.im * i_mean.im)) / c.C;  // eq:C vC
  ahead.v_c = ahead.v_c > 0.01 ? ahead.v_c : 0.01;
  ahead.v_p_hat = configuration_.law == Law::filtered ? constants_.notch.next(x.v_p_hat, v_p) : turn * v_p;
  ahead.p_r = next_p_r(x, p_i, next);
  ahead.reference = next;
  return ahead;
}

// μ that gives û, before the hold and the limit. ṗ_i cancels in it.
[[gnu::always_inline]] inline SpaceVector Controller::law(const Point& x, const Errors& errors, double dp_r,
                                                          double dq_r) const noexcept {
  const Converter& c = configuration_.converter;
  const Gains& K = constants_.K;
  const double p_hat = power(x.v_p_hat, x.i).re;
  const SpaceVector e2{x.p_r - p_hat, errors.q_error};  // eq:xi2_est
  const SpaceVector dp_i_minus_u =
      SpaceVector{dp_r, -dq_r} + K.k1 * errors.e1 + K.k2 * e2 + K.k3 * errors.y;  // eq:u_est
  const SpaceVector across_L = (dp_i_minus_u * x.v_p_hat) / floored(abs2(x.v_p_hat)) + c.omega * times_j(x.i);
  return (x.v_p_hat + c.L * across_L) / x.v_c;  // eq:mu_est
}

[[gnu::always_inline]] inline SpaceVector Controller::evaluate(const Measurement& m, SpaceVector v_p,
                                                               SpaceVector i, bool held) noexcept {
  const bool filtered = configuration_.law == Law::filtered;
  const std::uint64_t k = m.step;
  Point now;
  now.v_p_hat = filtered ? constants_.notch.next(state_.v_p_hat, state_.v_p) : v_p;
  now.i = i;
  now.v_c = m.v_c;
  now.p_r = state_.p_r;
  now.reference = shaper_.at(k);
  Errors errors = integrate({state_.e1, state_.y, state_.q_error, state_.eta_error}, now);
  if (held) {
    errors.y = state_.y;
    errors.eta_error = state_.eta_error;
    errors.e1.im = state_.eta_error;
  }
  const ShapedReference next = shaper_.at(k + 1);

  SpaceVector mu;
  double p_r_next = 0.0;
  if (configuration_.timing.delay == 0) {
    p_r_next = next_p_r(now, m.p_i, next);
    mu = law(now, errors, (p_r_next - now.p_r) / constants_.T, (next.q_r - now.reference.q_r) / constants_.T);
  } else {
    const Point ahead = predict(now, v_p, m.p_i, next);
    const ShapedReference after = shaper_.at(k + 2);
    p_r_next = ahead.p_r;
    mu = law(ahead, integrate(errors, ahead), (next_p_r(ahead, m.p_i, after) - ahead.p_r) / constants_.T,
             (after.q_r - next.q_r) / constants_.T);
  }
  state_.v_p_hat = now.v_p_hat;
  state_.v_p = v_p;
  state_.e1 = errors.e1;
  state_.y = errors.y;
  state_.q_error = errors.q_error;
  state_.eta_error = errors.eta_error;
  state_.p_r = p_r_next;
  return mu;
}

// What nothing waits for, last: the processor does it while the law still divides.
[[gnu::always_inline]] inline void Controller::finish(const Measurement& m, Modulation& out) noexcept {
  const ReferenceTrack& track = shaper_.state().track;
  out.measurement_fingerprint = fingerprint(m);
  out.newest_reference_id = track.newest_id;
  out.reference_id = track.id();
  if (track.fallen_back) out.status |= fallback;
  last_ = out;
}

Modulation Controller::step(const Measurement& m) noexcept {
  if (started_ && m.step <= last_.step) {
    // One sample from far ahead must not silence the controller: a row of older ones is the true stream.
    older_ = m.step < last_.step ? older_ + 1 : 0;
    if (older_ <= max_gap) return last_;
    started_ = false;
  }
  older_ = 0;
  Modulation out;
  out.step = m.step;
  out.period_ns = static_cast<std::uint32_t>(configuration_.timing.period_ns);
  if (!(m.timing == configuration_.timing)) out.status |= wrong_timing;
  if (!in_range(m)) out.status |= bad_measurement;
  const bool usable = out.status == 0;

  if (started_ && m.step - last_.step > 1) {
    out.status |= gap;
    if (m.step - last_.step > max_gap)
      started_ = false;
    else
      for (std::uint64_t missed = m.step - last_.step - 1; missed > 0; --missed) turn_on();
  }
  if (!usable) {
    // Nothing to go by yet: command nothing until the first usable sample.
    if (!started_) state_ = {};
    out.mu = state_.command;
    turn_on();
    finish(m, out);
    return out;
  }

  const bool mean = m.timing.sampling == Sampling::period_mean;
  const SpaceVector v_p = mean ? constants_.mean_to_end * m.v_p : m.v_p;
  SpaceVector i = mean ? constants_.mean_to_end * m.i : m.i;
  const bool starting = !started_ || m.blocked;
  if (m.blocked) shaper_.idle();
  if (starting) {
    out.status |= started;
    start(v_p, i, m.v_c);
  } else if (mean) {
    // The mean lies half a period back: eq:L di over it holds on any grid, v_p being measured.
    i = i + (0.5 * constants_.T) * ((m.v_c * state_.mu_before - v_p) / configuration_.converter.L -
                                    configuration_.converter.omega * times_j(i));
  }
  // Who has seen the unit blocked until now starts with the source, and is no joiner.
  const bool was_blocked = !started_ && (last_.status & started) != 0 && m.step - last_.step <= max_gap;
  if (!m.blocked) shaper_.advance_to(m.step, starting && !was_blocked);

  // The last answer was not used: what is in force is the one before, and what nobody acts on winds up
  // nothing.
  const bool held = m.state == UnitState::holding && !starting;
  if (held && configuration_.timing.delay == 1) state_.mu = state_.mu_before;

  const SpaceVector command = as_held(evaluate(m, v_p, i, held));
  const double magnitude2 = abs2(command);
  const double mu_max = configuration_.converter.mu_max;
  out.mu = command;
  if (!(magnitude2 <= mu_max * mu_max)) {
    out.status |= saturated;
    out.mu = (mu_max / std::sqrt(magnitude2)) * command;
    // Anti-windup by tracking: what the limit cut off û drains from both integrals, at the rate of the
    // slowest pole. To let them stand instead leaves a saturated equilibrium (C = 4.8e-5 s, X_g = 0.3).
    const SpaceVector cut_u = (m.v_c / configuration_.converter.L) *
                              (conj(state_.v_p_hat) * as_turning(command - out.mu));  // eq:mu_est
    state_.y = state_.y - (constants_.tracking / constants_.K.k3) * cut_u;
    state_.eta_error = state_.eta_error - constants_.tracking / constants_.K.k1 * cut_u.im;
  }
  if (abs2(state_.v_p_hat) < configuration_.v_p_hat_min * configuration_.v_p_hat_min)
    out.status |= low_voltage;

  const SpaceVector mu = as_turning(out.mu);
  const bool delayed = configuration_.timing.delay == 1;
  state_.mu_before = constants_.turn * (delayed ? state_.mu : mu);
  state_.mu = mu;
  state_.command = constants_.turn * out.mu;
  finish(m, out);
  started_ = !m.blocked;
  return out;
}

}  // namespace weakgrid
