// The controller's arithmetic written as one straight function, to measure what its structure costs: filtered
// law, delay 1, turning hold, instantaneous samples. The references at the sample and at the two after it are
// given, with their slopes. Nothing else: no status, no gaps, no ramps. The same operations in the same order
// as controller.cpp, so its μ has the same bits.
#pragma once

#include <array>

#include "controller/controller.hpp"

namespace weakgrid::bench {

class StraightLaw {
 public:
  StraightLaw(const ControllerConfiguration& c, const ControllerConstants& k, const LawState& state)
      : c_(c), k_(k), s_(state) {}

  void restore(const LawState& state) noexcept { s_ = state; }

  // Not inlined: the controller is not either, whoever calls it.
  [[gnu::noinline]] SpaceVector step(const Measurement& m,
                                     const std::array<ShapedReference, 3>& references) noexcept {
    const auto& [now, next, after] = references;
    const double L = c_.converter.L, C = c_.converter.C, omega = c_.converter.omega, T = k_.T;
    const double half_T = 0.5 * T, floor = c_.v_p_hat_min * c_.v_p_hat_min;
    const SpaceVector v_p = m.v_p, i = m.i, mu_in_force = s_.mu;

    // Notch, and the integrals up to this sample.
    const SpaceVector v_hat = k_.notch.turn * (s_.v_p_hat + k_.notch.intake * (s_.v_p - s_.v_p_hat));
    const double v_hat2 = abs2(v_hat), v_hat2_floored = v_hat2 > floor ? v_hat2 : floor;
    const double q_error = power(v_hat, i).im - now.q_r;
    const double eta_error = s_.eta_error + half_T * (s_.q_error + q_error);
    const double i_r2 = (s_.p_r * s_.p_r + now.q_r * now.q_r) / v_hat2_floored;
    const double energy = 0.5 * (L * abs2(i) + C * (m.v_c * m.v_c));
    const double energy_r = 0.5 * (L * i_r2 + C * (now.v_cr * now.v_cr));
    const SpaceVector e1{energy - energy_r, eta_error};
    const SpaceVector y = s_.y + half_T * (s_.e1 + e1);

    // One step ahead.
    const SpaceVector v_p_after = v_p + (c_.rho * m.v_c) * (mu_in_force - s_.mu_before);
    const SpaceVector slope = (m.v_c * mu_in_force - v_p_after) / L - omega * times_j(i);
    const SpaceVector i_mean = i + half_T * slope;
    const SpaceVector i_next = k_.turn * (i + T * slope);
    double v_c = m.v_c + T * (m.p_i / m.v_c - (mu_in_force.re * i_mean.re + mu_in_force.im * i_mean.im)) / C;
    v_c = v_c > 0.01 ? v_c : 0.01;
    const SpaceVector v_next = k_.notch.turn * (v_hat + k_.notch.intake * (v_p - v_hat));
    const double v_next2 = abs2(v_next), v_next2_floored = v_next2 > floor ? v_next2 : floor;
    const double p_r = next_p_r(s_.p_r, v_hat2 * T / L, m.p_i, next);

    // The integrals up to there.
    const double q_error_next = power(v_next, i_next).im - next.q_r;
    const double eta_error_next = eta_error + half_T * (q_error + q_error_next);
    const double i_r2_next = (p_r * p_r + next.q_r * next.q_r) / v_next2_floored;
    const double energy_next = 0.5 * (L * abs2(i_next) + C * (v_c * v_c));
    const double energy_r_next = 0.5 * (L * i_r2_next + C * (next.v_cr * next.v_cr));
    const SpaceVector e1_next{energy_next - energy_r_next, eta_error_next};
    const SpaceVector y_next = y + half_T * (e1 + e1_next);

    // The law, and the limit.
    const double dp_r = (next_p_r(p_r, v_next2 * T / L, m.p_i, after) - p_r) / T;
    const double dq_r = (after.q_r - next.q_r) / T;
    const SpaceVector e2{p_r - power(v_next, i_next).re, q_error_next};
    const SpaceVector u = SpaceVector{dp_r, -dq_r} + k_.K.k1 * e1_next + k_.K.k2 * e2 + k_.K.k3 * y_next;
    const SpaceVector across_L = (u * v_next) / v_next2_floored + omega * times_j(i_next);
    SpaceVector mu = (v_next + L * across_L) / v_c;
    s_.y = y;
    s_.eta_error = eta_error;
    const double magnitude2 = abs2(mu), mu_max = c_.converter.mu_max;
    if (!(magnitude2 <= mu_max * mu_max)) {
      const SpaceVector wanted = mu;
      mu = (mu_max / std::sqrt(magnitude2)) * mu;
      const SpaceVector cut_u = (m.v_c / L) * (conj(v_hat) * (wanted - mu));
      s_.y = s_.y - (k_.tracking / k_.K.k3) * cut_u;
      s_.eta_error = s_.eta_error - k_.tracking / k_.K.k1 * cut_u.im;
    }
    s_.v_p_hat = v_hat;
    s_.v_p = v_p;
    s_.e1 = e1;
    s_.q_error = q_error;
    s_.p_r = p_r;
    s_.mu_before = k_.turn * mu_in_force;
    s_.mu = mu;
    return mu;
  }

 private:
  // b = |v̂_p|²·T/L. Controller::next_p_r.
  double next_p_r(double p_r_before, double b, double p_i, const ShapedReference& r) const noexcept {
    const double g = b * (p_i - c_.converter.C * (r.dv_cr * r.v_cr)) - k_.T * (r.dq_r * r.q_r);
    const double delta_p = c_.delta_p;
    const double sign = p_r_before < 0.0 ? -1.0 : 1.0, p_r = sign * p_r_before;
    const double d = p_r * delta_p + sign * g, B = delta_p - p_r + b, discriminant = B * B + 4.0 * d;
    if (d >= 0.0 || (B < 0.0 && discriminant >= 0.0)) {
      const double root = std::sqrt(discriminant);
      if (B <= 0.0) return sign * 0.5 * (root - B);
      return sign * (2.0 * d / (B + root));
    }
    const double D = delta_p + p_r + b;
    return sign * (2.0 * d / (D + std::sqrt(D * D - 4.0 * d)));
  }

  ControllerConfiguration c_;
  ControllerConstants k_;
  LawState s_;
};

}  // namespace weakgrid::bench
