// Grid evidence: see the header.
#include "gateway/grid_evidence.hpp"

#include <algorithm>
#include <cmath>

namespace weakgrid {

namespace {

// x² i2 − 2 x s over an interval of x.
Interval drop(Interval x, double i2, double s) noexcept {
  const auto at = [&](double z) { return z * (z * i2 - 2.0 * s); };
  const double a = at(x.low), b = at(x.high);
  Interval drop{std::min(a, b), std::max(a, b)};
  if (const double bottom = s / i2; bottom > x.low && bottom < x.high) drop.low = at(bottom);
  return drop;
}

}  // namespace

Interval implied_voltage(const GridBox& box, double omega, const OperatingPoint& point) noexcept {
  const Interval resistive = drop(box.R_g, point.i2, point.s.re);
  const Interval reactive = drop({omega * box.L_g.low, omega * box.L_g.high}, point.i2, point.s.im);
  return {std::sqrt(std::max(0.0, point.v_p2 + resistive.low + reactive.low)),
          std::sqrt(std::max(0.0, point.v_p2 + resistive.high + reactive.high))};
}

std::optional<Interval> GridEvidence::add(const GridBox& box, double omega,
                                          const Measurement& sample) noexcept {
  if (sample.blocked || configuration_.cycles == 0) {
    *this = GridEvidence(configuration_);
    return std::nullopt;
  }
  sum_.v_p2 += abs2(sample.v_p);
  sum_.i2 += abs2(sample.i);
  sum_.s = sum_.s + power(sample.v_p, sample.i);
  if (++samples_ < configuration_.cycle_steps) return std::nullopt;
  const double mean = 1.0 / static_cast<double>(samples_);
  const OperatingPoint point{mean * sum_.v_p2, mean * sum_.i2, mean * sum_.s};
  sum_ = {};
  samples_ = 0;
  if (!std::isfinite(point.v_p2 + point.i2 + point.s.re + point.s.im)) {  // a peer's nonsense is no evidence
    contradictions_ = 0;
    return std::nullopt;
  }
  const Interval cycle = implied_voltage(box, omega, point);
  const double t = configuration_.tolerance;
  if (cycle.high + t >= box.V.low && cycle.low - t <= box.V.high) {
    contradictions_ = 0;
    return std::nullopt;
  }
  implied_ = contradictions_ == 0
                 ? cycle
                 : Interval{std::min(implied_.low, cycle.low), std::max(implied_.high, cycle.high)};
  if (++contradictions_ < configuration_.cycles) return std::nullopt;
  contradictions_ = 0;
  return implied_;
}

}  // namespace weakgrid
