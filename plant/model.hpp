// The vocabulary that every pure room shares: space vectors, the converter, the grid, and what passes between
// plant, controller and gateway in one step. Section II of the paper; per unit, time in seconds.
#pragma once

#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>

#include "plant/reference.hpp"

namespace weakgrid {

/// Complex space vector in the stationary αβ frame: re = α, im = β.
/// Not std::complex: its product may call a library routine, and every operation here must round the same way
/// with every compiler, so that a recorded run re-executes bit for bit.
struct SpaceVector {
  double re = 0.0;
  double im = 0.0;
  friend constexpr bool operator==(SpaceVector, SpaceVector) = default;
};

constexpr SpaceVector operator+(SpaceVector a, SpaceVector b) { return {a.re + b.re, a.im + b.im}; }
constexpr SpaceVector operator-(SpaceVector a, SpaceVector b) { return {a.re - b.re, a.im - b.im}; }
constexpr SpaceVector operator*(SpaceVector a, SpaceVector b) {
  return {a.re * b.re - a.im * b.im, a.re * b.im + a.im * b.re};
}
constexpr SpaceVector operator*(double a, SpaceVector b) { return {a * b.re, a * b.im}; }
constexpr SpaceVector operator/(SpaceVector a, double b) { return {a.re / b, a.im / b}; }
constexpr SpaceVector conj(SpaceVector a) { return {a.re, -a.im}; }
constexpr double abs2(SpaceVector a) { return a.re * a.re + a.im * a.im; }
constexpr SpaceVector operator/(SpaceVector a, SpaceVector b) { return (a * conj(b)) / abs2(b); }
inline double abs(SpaceVector a) { return std::sqrt(abs2(a)); }
inline bool finite(SpaceVector a) { return std::isfinite(a.re) && std::isfinite(a.im); }

/// j·a, the quarter turn.
constexpr SpaceVector times_j(SpaceVector a) { return {-a.im, a.re}; }

/// s = v ĩ = p + jq: re is the active, im the reactive power. eq:s
constexpr SpaceVector power(SpaceVector v, SpaceVector i) { return v * conj(i); }

inline constexpr double pi = 3.14159265358979323846;

/// 1/0!, 1/1!, … 1/23!
inline constexpr auto reciprocal_factorial = [] {
  struct {
    double of[24];
  } table{};
  double factorial = 1.0;
  for (int n = 0; n < 24; ++n) {
    if (n > 0) factorial *= n;
    table.of[n] = 1.0 / factorial;
  }
  return table;
}();

/// e^{j·angle} for |angle| ≤ π/2 rad, to the last bits, from + and × alone: libm's sin and cos differ between
/// machines, and a ramp is evaluated inside the step. Taylor: the first term left out is below 2⁻⁵³.
constexpr SpaceVector unit_phasor(double angle) {
  const double x2 = angle * angle;
  double c = 0.0, s = 0.0;
  for (int n = 22; n >= 0; n -= 2) {
    c = reciprocal_factorial.of[n] - x2 * c;
    s = reciprocal_factorial.of[n + 1] - x2 * s;
  }
  return {c, angle * s};
}

struct Converter {
  double omega = 2.0 * pi * 50.0;       ///< grid angular frequency ω, rad/s
  double L = 0.02 / (2.0 * pi * 50.0);  ///< filter inductance X_L/ω, seconds
  double C = 4.8e-4;                    ///< DC-link capacitance C_phys·Z_b, seconds
  double mu_max = 0.70710678118654752;  ///< |μ| ≤ 1/√2: space vector modulation
  friend constexpr bool operator==(const Converter&, const Converter&) = default;
};

/// Thévenin grid. R_g ≥ 0 and L_g ≥ 0, both may be zero (strong grid).
struct Grid {
  double R_g = 0.0;
  double L_g = 0.0;  ///< X_g/ω, seconds
  double V = 1.0;    ///< |v_g| > 0
};

/// How μ is held between two updates. Part of the contract: a still μ ripples, and sampling aliases the
/// ripple.
enum class Hold : std::uint8_t {
  turning,  ///< the modulator turns the held μ at ω
  still,    ///< μ stands still in αβ
};

/// What a measurement of v_p and i is.
enum class Sampling : std::uint8_t {
  instantaneous,  ///< taken just before μ is updated
  period_mean,    ///< mean over the period that ends there
};

/// The contract between plant and controller; both must hold the same.
struct Timing {
  std::int64_t period_ns = 100'000;
  std::uint8_t delay = 1;  ///< 0 or 1 steps between a sample and the effect of its μ
  Hold hold = Hold::turning;
  Sampling sampling = Sampling::instantaneous;
  friend constexpr bool operator==(Timing, Timing) = default;
};

constexpr double period_s(const Timing& timing) { return static_cast<double>(timing.period_ns) * 1e-9; }

/// What a unit does. Its numbers are the wire's; 0 is the usual.
enum class UnitState : std::uint8_t {
  running,
  holding,    ///< runs, with the last modulation: the answer to the last sample has not come
  tripped,    ///< bridge blocked, source open, until it is reset
  off,        ///< bridge blocked, source open, DC link discharged or on its way there
  precharge,  ///< bridge blocked, source open, the DC voltage rises
  ready,      ///< bridge blocked, source open, waits for the controller
};

constexpr bool is_blocked(UnitState state) {
  return state != UnitState::running && state != UnitState::holding;
}

constexpr const char* name(UnitState state) noexcept {
  constexpr const char* names[] = {"running", "holding", "tripped", "off", "precharge", "ready"};
  return names[static_cast<std::size_t>(state)];
}

/// Sample k: taken at t = k·T, just before μ is updated.
struct Measurement {
  std::uint64_t step = 0;
  Timing timing;
  std::uint32_t reference_id = 0;  ///< the reference that the source follows, 0 = none yet
  bool blocked = false;            ///< the bridge is blocked and the source open: is_blocked(state)
  bool fallback = false;           ///< the source follows the fallback of that reference: its lease is over
  UnitState state = UnitState::running;
  SpaceVector v_p;
  SpaceVector i;
  double v_c = 0.0;
  double p_i = 0.0;
};

/// A hash over whole numbers and the bits of doubles, so that an answer can name exactly what it answers.
/// Each step is a bijection: two values that differ in one field give the same 32 bits once in 2³² only.
class Fingerprint {
 public:
  constexpr void add(std::uint64_t word) {
    hash_ = (hash_ ^ word) * 0x9e3779b97f4a7c15u;
    hash_ ^= hash_ >> 32;
  }
  constexpr void add(double number) { add(std::bit_cast<std::uint64_t>(number)); }
  constexpr std::uint32_t value() const { return static_cast<std::uint32_t>(hash_ ^ (hash_ >> 29)); }

 private:
  std::uint64_t hash_ = 0xcbf29ce484222325u;
};

/// Of every field; how others compute it: services/recording/README.md.
constexpr std::uint32_t fingerprint(const Measurement& m) {
  Fingerprint f;
  f.add(m.step);
  f.add(static_cast<std::uint64_t>(m.timing.period_ns));
  const bool flags[] = {m.timing.hold == Hold::still, m.timing.sampling == Sampling::period_mean,
                        m.timing.delay == 1, m.blocked};
  std::uint64_t word = m.reference_id;
  for (const bool flag : flags) word = word << 1 | (flag ? 1u : 0u);
  // Above the rest: a sample of a unit that runs and follows its order keeps the number it always had.
  word |= std::uint64_t{m.fallback} << 36 | std::uint64_t{static_cast<std::uint8_t>(m.state)} << 37;
  f.add(word);
  for (const double number : {m.v_p.re, m.v_p.im, m.i.re, m.i.im, m.v_c, m.p_i}) f.add(number);
  return f.value();
}

/// Bits of Modulation::status, as in weakgrid.idl.
enum ModulationStatus : std::uint32_t {
  saturated = 1,
  bad_measurement = 2,
  low_voltage = 4,
  gap = 8,
  wrong_timing = 16,
  started = 32,
  fallback = 64,  ///< for information: the answer is as good as any
};

/// The answer to sample k: μ as it stands in αβ at the instant (k + delay)·T at which it takes effect.
struct Modulation {
  std::uint64_t step = 0;
  std::uint32_t period_ns = 0;                ///< echo of the contract
  std::uint32_t reference_id = 0;             ///< the reference in force, 0 = none yet
  std::uint32_t status = 0;                   ///< ModulationStatus bits
  std::uint32_t newest_reference_id = 0;      ///< accepted before this step, perhaps not yet in force
  std::uint32_t measurement_fingerprint = 0;  ///< of the sample answered
  std::uint64_t epoch = 0;                    ///< of its controller: a higher one replaces; no part of the law
  SpaceVector mu;
};

/// What the bridge makes of an answer: none, that is hold, if the controller had no sample to go by.
constexpr std::optional<SpaceVector> command(const Modulation& modulation) {
  if ((modulation.status & (bad_measurement | wrong_timing)) != 0) return std::nullopt;
  return modulation.mu;
}

/// A quantity on its way: raised cosine over `steps` steps from `start`, then `to`. A ramp that begins while
/// the one before still moves carries the slope over, so value and slope never jump.
struct Ramp {
  double from = 0.0;
  double to = 0.0;
  double slope = 0.0;  ///< slope at the start, per step
  std::uint64_t start = 0;
  std::uint32_t steps = 0;
  std::uint32_t slope_steps = 0;  ///< within so many the slope at the start dies out, 0 … steps

  struct Point {
    double value;
    double slope;  ///< per step, exact
  };

  constexpr Point at(std::uint64_t step) const {
    if (step < start) return {from, slope};
    if (step - start >= steps) return {to, 0.0};
    const double elapsed = static_cast<double>(step - start);
    const double n = static_cast<double>(steps);
    const SpaceVector half = unit_phasor(0.5 * pi * (elapsed / n));
    // sin²(πs/2) is the raised cosine.
    Point point{from + (to - from) * (half.im * half.im), (to - from) * (pi * half.im * half.re) / n};
    if (step - start < slope_steps) {
      // x(1-x)² takes the initial slope to zero and moves neither end.
      const double m = static_cast<double>(slope_steps);
      const double x = elapsed / m;
      const double r = 1.0 - x;
      point.value += slope * m * (x * r * r);
      point.slope += slope * (r * r - 2.0 * x * r);
    }
    return point;
  }

  /// The ramp to `target` that leaves from where this one is at `step`.
  constexpr Ramp towards(double target, std::uint64_t step, std::uint32_t over_steps) const {
    const Point now = at(step);
    // No longer than what moves now takes: over a longer ramp the slope would carry the value far away.
    const bool carries = step >= start && step - start < slope_steps;
    const std::uint32_t fade = carries ? slope_steps : steps;
    return {now.value, target, now.slope, step, over_steps, fade < over_steps ? fade : over_steps};
  }
};

}  // namespace weakgrid
