// The filtered flatness law, one sample at a time: Section IV of the paper, its gains placed for the sampled
// loop.
#pragma once

#include "controller/gains.hpp"
#include "controller/notch.hpp"
#include "controller/reference.hpp"
#include "plant/model.hpp"

namespace weakgrid {

enum class Law : std::uint8_t {
  filtered,    ///< v̂_p from the notch: eq:xi1_est … eq:mu_est
  unfiltered,  ///< v̂_p = v_p: loses the operating point on a weak grid, the paper's reason to exist
};

struct ControllerConfiguration {
  Converter converter;
  Timing timing;
  Law law = Law::filtered;
  SettlingTimes settling_times_s{0.001, 0.0011, 0.040};  ///< departs from the paper (20 ms): README
  SpaceVector kappa{92.0, 0.0};                          ///< notch gain κ_r + jκ_i, 1/s: 4.6/50 ms
  double rho = 0.6;                 ///< how the grid answers a change of μ, L_g/(L+L_g); for delay = 1
  double delta_p = 0.01;            ///< δ_p of eq:dpr
  double v_p_hat_min = 0.1;         ///< floor of |v̂_p| where the law divides by it
  double v_c = 1.8384776310850235;  ///< v_cr until the first reference, 1.3·√2
};

/// Computed once at start-up; recorded in the manifest.
struct ControllerConstants {
  double T = 0.0;
  Gains K;  ///< sampled gains
  Notch notch;
  double tracking = 0.0;  ///< anti-windup: share of the cut that drains each step
  SpaceVector turn;       ///< e^{jωT}
  /// What a held μ amounts to, turning: 1, or its mean over the period e^{−jωT/2}·sinc(ωT/2) when it stands
  /// still.
  SpaceVector held;
  /// The same for a mean over the last period: mean·(this) is the value at its end.
  SpaceVector mean_to_end;
};

/// What the law carries from one sample to the next.
struct LawState {
  SpaceVector v_p_hat;
  SpaceVector v_p;  ///< at the last sample, for the notch
  SpaceVector e1;   ///< ê_ξ1 at the last sample, for the trapezoid
  SpaceVector y;
  double q_error = 0.0;    ///< q̂ − q_r at the last sample, for the trapezoid
  double eta_error = 0.0;  ///< η̂ − η_r: each grows without bound, the difference does not
  double p_r = 0.0;
  /// In force in the period that ends at the next sample, its value there, as if turning.
  SpaceVector mu_before;
  SpaceVector mu;       ///< in force from the next sample on (delay 1), as if turning
  SpaceVector command;  ///< the last answer, its value one period on
};

/// All that the next answers depend on besides samples, references and configuration: whoever restores it
/// goes on with the same bits.
struct ControllerState {
  LawState law;
  ReferenceShaper::State references;
  Modulation last;
  bool started = false;
  std::uint64_t older = 0;  ///< samples in a row that were older than the last
};

ControllerConstants derive_constants(const ControllerConfiguration& configuration);

/// Heap-free, noexcept, bounded; + − × ÷ sqrt only. Total: any measurement leaves a finite state.
///
/// Bad measurement (not finite; |i| > 100, |v_p| > 10, |p_i| > 10, v_c outside [0.01, 10]) or wrong timing:
/// the last μ is held, turning; the state stands; status says so. Missed samples: the state turns on over
/// them, over at most max_gap; after more the controller starts anew. While the bridge is blocked it idles,
/// as after a start.
class Controller {
 public:
  static constexpr std::uint64_t max_gap = 16;

  explicit Controller(const ControllerConfiguration& configuration);

  /// The answer to a sample. A sample that is not newer than the last gets the last answer again; after more
  /// than max_gap older ones in a row the controller starts anew with them.
  Modulation step(const Measurement& measurement) noexcept;

  /// False: refused, not finite, out of range or not newer than the newest known. What was due by the next
  /// sample has begun by then, also if this one is known first: as in the source, which begins it at once.
  bool accept(const Reference& reference) noexcept {
    if (started_) shaper_.advance_to(last_.step + 1, false);
    return shaper_.accept(reference);
  }

  /// The next sample starts it anew, whatever its step; a pending reference stays.
  void reset() noexcept;
  /// The same for the unit that it follows: the references stay where they are.
  void start_anew() noexcept { started_ = false; }

  SpaceVector v_p_hat() const noexcept { return state_.v_p_hat; }
  ControllerState state() const noexcept;
  void restore(const ControllerState& state) noexcept;
  const ControllerConstants& constants() const noexcept { return constants_; }

 private:
  // Where the law is evaluated: at a sample, or one step ahead of it.
  struct Point {
    SpaceVector v_p_hat, i;
    double v_c = 0.0;
    double p_r = 0.0;
    ShapedReference reference;
  };
  struct Errors {
    SpaceVector e1, y;
    double q_error = 0.0, eta_error = 0.0;
  };

  void start(SpaceVector v_p, SpaceVector i, double v_c) noexcept;
  void turn_on() noexcept;
  SpaceVector as_turning(SpaceVector mu) const noexcept;
  SpaceVector as_held(SpaceVector mu) const noexcept;
  double floored(double v_p_hat2) const noexcept;
  Errors integrate(const Errors& before, const Point& x) const noexcept;
  double next_p_r(const Point& x, double p_i, const ShapedReference& next) const noexcept;
  Point predict(const Point& x, SpaceVector v_p, double p_i, const ShapedReference& next) const noexcept;
  SpaceVector law(const Point& x, const Errors& errors, double dp_r, double dq_r) const noexcept;
  void finish(const Measurement& m, Modulation& out) noexcept;
  SpaceVector evaluate(const Measurement& m, SpaceVector v_p, SpaceVector i, bool held) noexcept;

  ControllerConfiguration configuration_;
  ControllerConstants constants_;
  ReferenceShaper shaper_;
  LawState state_;
  Modulation last_;
  bool started_ = false;
  std::uint64_t older_ = 0;  // samples in a row that were older than the last
};

}  // namespace weakgrid
