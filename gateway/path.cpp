// λ, current, lowest |v_p| and v_c are convex: inside at both ends is inside all the way. Upper limits on
// |v_p| and the bridge voltage are not: halves are looked at until their slack outweighs how far it can fall.
#include "gateway/path.hpp"

#include <algorithm>
#include <array>
#include <cmath>

namespace weakgrid {

namespace {

Setpoint between(const Setpoint& a, const Setpoint& b, double share) noexcept {
  return {a.p + share * (b.p - a.p), a.q + share * (b.q - a.q), a.v_c + share * (b.v_c - a.v_c)};
}

// How much slack can change from one end of a piece to the other: the gradients of |v_p| and of the bridge
// voltage, bounded over box and way, on which λ is at least `lambda`. With a + jb = s Z̃_g: ∂W/∂a = 1 + V/√λ,
// ∂W/∂b = −2b/(V√λ).
double slack_range(const GridBox& box, const Converter& c, const Setpoint& from, const Setpoint& to,
                   double lambda) noexcept {
  const SpaceVector s_0{from.p, from.q}, s_1{to.p, to.q};
  const double Z_g = abs(SpaceVector{box.R_g.high, c.omega * box.L_g.high});
  const double s = std::max(abs(s_0), abs(s_1)), V = box.V.low, root = std::sqrt(lambda);
  const double by_a = 1.0 + box.V.high / root, by_b = 2.0 * s * Z_g / (V * root);
  const double W_slope = Z_g * std::sqrt(by_a * by_a + by_b * by_b);
  // |v_p| ≥ V/2, so d|v_p| ≤ dW/V. The bridge voltage adds X_L |i| and its turn: d ≤ (dW + 2X_L ds + …)/V.
  const double X_L = c.omega * c.L;
  const double drop = X_L * (1.0 + 2.0 * s * X_L * (1.0 + W_slope * s / V) / (V * V));
  const double slope = (W_slope + 4.0 * drop) / V;
  return slope * abs(s_1 - s_0) + c.mu_max * std::abs(to.v_c - from.v_c);
}

}  // namespace

std::optional<Setpoint> first_outside(const GridBox& box, const Converter& converter, const Limits& limits,
                                      const Setpoint& from, const Setpoint& to, double tolerance) noexcept {
  if (!(slack(box, converter, limits, from) >= -tolerance)) return from;
  if (!(slack(box, converter, limits, to) >= -tolerance)) return to;
  // Depth first, from the beginning on: pieces still to be looked at, each with its depth.
  constexpr int deepest = 20;
  struct Piece {
    double at, length;
    double lambda, lambda_after;  // at its ends
  };
  const auto state_at = [&](const Setpoint& s) { return box_state(box, converter.omega, {s.p, s.q}); };
  std::array<Piece, deepest + 2> stack;
  int count = 0;
  stack[count++] = {0.0, 1.0, state_at(from).lambda, state_at(to).lambda};
  for (int looked = 0; count > 0; ++looked) {
    const Piece piece = stack[--count];
    const double half = 0.5 * piece.length, at_half = piece.at + half;
    const Setpoint middle = between(from, to, at_half);
    const BoxState state = state_at(middle);
    const double here = upper_slack(state, converter, limits, middle);
    if (!(here >= -tolerance)) return middle;
    // λ is concave: no less in between than at the ends.
    const double range =
        slack_range(box, converter, between(from, to, piece.at), between(from, to, piece.at + piece.length),
                    std::min(piece.lambda, piece.lambda_after));
    if (here + tolerance >= 0.5 * range) continue;
    if (count + 2 > static_cast<int>(stack.size()) || looked > 4096) return middle;
    stack[count++] = {at_half, half, state.lambda, piece.lambda_after};
    stack[count++] = {piece.at, half, piece.lambda, state.lambda};
  }
  return std::nullopt;
}

std::optional<Setpoint> detour(const GridBox& box, const Converter& converter, const Limits& limits,
                               const Setpoint& from, const Setpoint& to) noexcept {
  const auto passes = [&](const Setpoint& a, const Setpoint& b) {
    return !first_outside(box, converter, limits, a, b);
  };
  // One quantity first, or aside of the middle, the shortest first.
  const Setpoint middle = between(from, to, 0.5);
  const double dp = to.p - from.p, dq = to.q - from.q;
  const std::array<Setpoint, 9> candidates{{
      {middle.p + 0.15 * dq, middle.q - 0.15 * dp, to.v_c},
      {middle.p - 0.15 * dq, middle.q + 0.15 * dp, to.v_c},
      {middle.p + 0.3 * dq, middle.q - 0.3 * dp, to.v_c},
      {middle.p - 0.3 * dq, middle.q + 0.3 * dp, to.v_c},
      {from.p, to.q, to.v_c},
      {to.p, from.q, to.v_c},
      {from.p, from.q, to.v_c},
      {to.p, to.q, from.v_c},
      {0.5 * middle.p, 0.5 * middle.q, to.v_c},
  }};
  for (const Setpoint& via : candidates)
    if (passes(from, via) && passes(via, to)) return via;
  return std::nullopt;
}

}  // namespace weakgrid
