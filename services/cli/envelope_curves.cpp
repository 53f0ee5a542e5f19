// Envelope curves: see the header.
#include "services/cli/envelope_curves.hpp"

#include <algorithm>
#include <optional>

namespace weakgrid {

namespace {

constexpr int curve_points = 400;
constexpr int area_columns = 500;

// Currents i with |V + Z i| = radius and |i| ≤ i_reach, in order.
std::vector<SpaceVector> circle(double V, SpaceVector Z, double radius, double i_reach) {
  std::vector<SpaceVector> currents;
  if (!(abs2(Z) > 0.0) || !std::isfinite(radius) || !(radius > 0.0)) return currents;
  const double cosine =
      1.0 - (i_reach * i_reach * abs2(Z) - (radius - V) * (radius - V)) / (2.0 * radius * V);
  if (cosine > 1.0) return currents;
  const double angle_max = std::acos(std::max(cosine, -1.0));
  for (int n = -curve_points; n <= curve_points; ++n) {
    const double angle = angle_max * n / curve_points;
    currents.push_back((SpaceVector{radius * std::cos(angle) - V, radius * std::sin(angle)}) / Z);
  }
  return currents;
}

std::vector<SpaceVector> currents_at(const EnvelopeSlice& e, Limit limit, double reach) {
  const SpaceVector Z_g{e.grid.R_g, e.converter.omega * e.grid.L_g};
  const SpaceVector Z = Z_g + SpaceVector{0.0, e.converter.omega * e.converter.L};
  const double V = e.grid.V;
  const double i_reach = 2.0 * reach / V;  // |v_p| ≥ V/2
  std::vector<SpaceVector> currents;
  switch (limit) {
    case Limit::steady_state: {
      // There v_p = V/2 + jx, so |s| = (V²/4 + x²)/|Z_g|.
      const double x2_max = reach * abs(Z_g) - 0.25 * V * V;
      for (int n = -curve_points; x2_max > 0.0 && n <= curve_points; ++n)
        currents.push_back(SpaceVector{-0.5 * V, std::sqrt(x2_max) * n / curve_points} / Z_g);
      return currents;
    }
    case Limit::current:
      for (int n = -curve_points; std::isfinite(e.limits.i_max) && n <= curve_points; ++n)
        currents.push_back(e.limits.i_max *
                           SpaceVector{std::cos(pi * n / curve_points), std::sin(pi * n / curve_points)});
      return currents;
    case Limit::control:
      return circle(V, Z, e.v_c * e.converter.mu_max, i_reach);
    case Limit::control_rough:
      return circle(V, Z_g, e.v_c * e.converter.mu_max, i_reach);
    case Limit::pcc_voltage_min:
      return circle(V, Z_g, e.limits.v_p_min, i_reach);
    case Limit::pcc_voltage_max:
      return circle(V, Z_g, e.limits.v_p_max, i_reach);
    default:
      return currents;
  }
}

bool is_admissible(const EnvelopeSlice& e, double p, double q) {
  return assess(e.box, e.converter, e.limits, {p, q, e.v_c}).admissible;
}

// Between q, admissible, and q_out, not: the last that is.
double edge(const EnvelopeSlice& e, double p, double q, double q_out) {
  for (int n = 0; n < 40; ++n) (is_admissible(e, p, 0.5 * (q + q_out)) ? q : q_out) = 0.5 * (q + q_out);
  return q;
}

std::vector<AdmissibleSpan> spans_at(const EnvelopeSlice& e, double p, double reach) {
  std::vector<AdmissibleSpan> spans;
  std::optional<double> from;
  const double spacing = 2.0 * reach / area_columns;
  for (int n = 0; n <= area_columns; ++n) {
    const double q = -reach + spacing * n;
    const bool is_in = is_admissible(e, p, q);
    if (is_in && !from) from = n == 0 ? q : edge(e, p, q, q - spacing);
    if (from && (!is_in || n == area_columns)) {
      spans.push_back({p, *from, is_in ? q : edge(e, p, q - spacing, q)});
      from.reset();
    }
  }
  return spans;
}

}  // namespace

PowerCurve limit_curve(const EnvelopeSlice& e, Limit limit, double reach) {
  const SpaceVector Z_g{e.grid.R_g, e.converter.omega * e.grid.L_g};
  PowerCurve curve;
  bool is_broken = true;
  for (const SpaceVector i : currents_at(e, limit, reach)) {
    const SpaceVector v_p = SpaceVector{e.grid.V, 0.0} + Z_g * i;  // eq:i ss
    const SpaceVector s = power(v_p, i);
    // The same power is reached by two currents; beyond λ = 0 it is the other one that a grid would carry.
    const bool operates = e.grid.V + 2.0 * (Z_g * i).re >= -1e-12 && finite(s);
    if (operates && is_broken) curve.emplace_back();
    if (operates) curve.back().push_back({s.re, s.im, e.v_c});
    is_broken = !operates;
  }
  return curve;
}

std::vector<std::vector<AdmissibleSpan>> admissible_areas(const EnvelopeSlice& e, double reach) {
  std::vector<std::vector<AdmissibleSpan>> areas;
  std::size_t open = 0;  // the last so many go on
  for (int n = 0; n <= area_columns; ++n) {
    const auto spans = spans_at(e, -reach + 2.0 * reach * n / area_columns, reach);
    if (spans.size() != open) areas.resize(areas.size() + spans.size());
    open = spans.size();
    for (std::size_t k = 0; k < open; ++k) areas[areas.size() - open + k].push_back(spans[k]);
  }
  return areas;
}

}  // namespace weakgrid
