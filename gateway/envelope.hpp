// The operating envelope: the limits of Section III around one setpoint, each with its margin. Per unit.
#pragma once

#include <array>
#include <cassert>
#include <cstddef>
#include <cstdint>

#include "gateway/grid_box.hpp"
#include "plant/model.hpp"

namespace weakgrid {

/// How far inside a limit a setpoint must stay; 0 = up to the limit itself. For what the model leaves out.
struct Reserve {
  double steady_state = 0.0;  ///< of λ
  double current = 0.0;
  double control = 0.0;
  double pcc_voltage = 0.0;
  double dc_voltage = 0.0;
  friend constexpr bool operator==(const Reserve&, const Reserve&) = default;
};

/// What a setpoint must respect. The defaults keep the paper's points at X_g = 0.3: p = q = 0.707 is inside
/// (|v_p| = 1.165), and at p = 0.707 it is the current that ends the range of q downwards, at −0.407.
struct Limits {
  double i_max = 1.0;    ///< nominal current
  double v_p_min = 0.8;  ///< PCC voltage band, ±20 %
  double v_p_max = 1.2;
  double v_c_min = 1.5;  ///< below √2 the bridge cannot even make the nominal voltage
  double v_c_max = 2.4;  ///< 1.7 √2: room above the paper's 1.3 √2, to be kept below the DC-link trip
  Reserve reserve;
  friend constexpr bool operator==(const Limits&, const Limits&) = default;
};

struct Setpoint {
  double p = 0.0;
  double q = 0.0;
  double v_c = 1.3 * 1.41421356237309505;
};

/// Mirrors LimitName of the wire contract, same order.
enum class Limit : std::uint8_t {
  steady_state,   ///< λ ≥ 0; the margin is λ itself
  current,        ///< |i| ≤ i_max
  control,        ///< |v_p + jX_L i| ≤ v_c μ_max, exact: with the drop in the filter
  control_rough,  ///< |v_p| ≤ v_c μ_max, the paper's estimate; never enforced
  pcc_voltage_min,
  pcc_voltage_max,
  dc_voltage_min,
  dc_voltage_max,
  decay,      ///< of small disturbances of the closed loop, 1/s: gateway/loop_decay.hpp
  transient,  ///< the paper's eq:condicion conservativa: gateway/transient.hpp
};
inline constexpr std::size_t limit_count = 8;    ///< of the envelope: all but the last two
inline constexpr std::size_t margin_count = 10;  ///< all

struct LimitMargin {
  Limit limit = Limit::steady_state;
  bool enforced = true;
  double margin = 0.0;    ///< distance to the limit, at least 0 = inside; NaN = cannot be told
  double required = 0.0;  ///< what it must be at least
  Grid grid{};            ///< where in the box it is the smallest; of v_c limits any
};

/// This margin refuses the setpoint. A NaN does.
constexpr bool violated(const LimitMargin& m) noexcept { return m.enforced && !(m.margin >= m.required); }

/// At most one margin per limit, in the order of Limit. Fixed capacity: a decision allocates nothing.
class Margins {
 public:
  constexpr void add(LimitMargin margin) noexcept {
    assert(count_ < margin_count);
    margins_[count_++] = margin;
  }
  constexpr std::size_t size() const noexcept { return count_; }
  constexpr const LimitMargin* begin() const noexcept { return margins_.data(); }
  constexpr const LimitMargin* end() const noexcept { return margins_.data() + count_; }
  /// nullptr if the limit could not be assessed.
  constexpr const LimitMargin* find(Limit limit) const noexcept {
    for (const LimitMargin& m : *this)
      if (m.limit == limit) return &m;
    return nullptr;
  }

 private:
  std::array<LimitMargin, margin_count> margins_{};
  std::size_t count_ = 0;
};

struct Assessment {
  bool admissible = false;  ///< no margin is violated
  Margins margins;  ///< without a steady state (λ < 0): only λ and the v_c range, the rest does not exist
};

/// The smallest margin of each limit over all grids of the box, exact: in closed form, no search (README).
/// Total: NaN in anything read here (all but Converter::C) is never admissible; an infinite limit is none.
Assessment assess(const GridBox& box, const Converter& converter, const Limits& limits,
                  const Setpoint& setpoint) noexcept;
/// The same where the grid is known.
Assessment assess(const Grid& grid, const Converter& converter, const Limits& limits,
                  const Setpoint& setpoint) noexcept;

/// The smallest of margin − required over the limits of the envelope: at least 0 where assess() admits.
/// Rises towards the inside; λ alone where no steady state exists on some grid.
double slack(const GridBox& box, const Converter& converter, const Limits& limits,
             const Setpoint& setpoint) noexcept;

/// The same without the limits of v_c itself.
double slack_in_plane(const GridBox& box, const Converter& converter, const Limits& limits,
                      const Setpoint& setpoint) noexcept;
/// The extremes of the steady state over a box.
struct BoxState {
  bool exists = false;  ///< on every grid; else only λ means anything
  double lambda = 0.0;  ///< the lowest
  Grid lambda_grid;
  double v_p_min = 0.0, v_p_max = 0.0;  ///< |v_p|
  Grid v_p_min_grid, v_p_max_grid;      ///< |i| = |s|/|v_p| is largest where |v_p| is smallest
};
BoxState box_state(const GridBox& box, double omega, SpaceVector s) noexcept;

/// slack() of the upper limits on |v_p| and on the bridge voltage alone, those that are not convex in (p, q);
/// `state` is that of the setpoint.
double upper_slack(const BoxState& state, const Converter& converter, const Limits& limits,
                   const Setpoint& setpoint) noexcept;

}  // namespace weakgrid
