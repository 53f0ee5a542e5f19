// The decay of a linear system from the norm of e^{At} at a long t: repeated squaring, no eigenvalue solver.
#include "gateway/loop_decay.hpp"

#include <array>
#include <cmath>
#include <limits>

namespace weakgrid {

namespace {

constexpr int n = 8;
using Matrix = std::array<std::array<double, n>, n>;

Matrix product(const Matrix& a, const Matrix& b) noexcept {
  Matrix c{};
  for (int row = 0; row < n; ++row)
    for (int k = 0; k < n; ++k)
      for (int column = 0; column < n; ++column) c[row][column] += a[row][k] * b[k][column];
  return c;
}

double norm_squared(const Matrix& a) noexcept {
  double sum = 0.0;
  for (const auto& row : a)
    for (const double x : row) sum += x * x;
  return sum;
}

// One column of A: the derivative of the state that is 1 in one place. δ of everything, in the frame that
// turns at ω; e1 and y as the paper's, w = δv̂_p.
std::array<double, n> derivative(const LoopModel& m, const Grid& grid, SpaceVector v, SpaceVector i,
                                 const std::array<double, n>& x) noexcept {
  const double L = m.converter.L, L_g = grid.L_g;
  const SpaceVector Z_g{grid.R_g, m.converter.omega * L_g};
  const SpaceVector di{x[0], x[1]}, w{x[2], x[3]}, e1{x[4], x[5]}, y{x[6], x[7]};
  const SpaceVector e2 = -1.0 * (conj(v) * di + conj(w) * i);                      // eq:xi2_est
  const SpaceVector minus_u = m.k1 * e1 + m.k2 * e2 + m.k3 * y;                    // eq:u_est
  const SpaceVector di_dt = (w + L * (minus_u / conj(v)) - Z_g * di) / (L + L_g);  // eq:mu_est, eq:L+Lg di
  const SpaceVector dv_p = L_g * di_dt + Z_g * di;                                 // eq:vp
  const SpaceVector dw_dt = m.kappa * (dv_p - w);                                  // eq:dvp_est
  const double dp = (dv_p * conj(i) + v * conj(di)).re;
  // eq:xi1_est less its reference, of which |i_r|² moves with |v̂_p|.
  const SpaceVector de1_dt{L * abs2(i) * (dw_dt / v).re - dp, e2.im};
  return {di_dt.re, di_dt.im, dw_dt.re, dw_dt.im, de1_dt.re, de1_dt.im, e1.re, e1.im};
}

// Each state in a unit of its own, so that the norm is not that of 1/s beside per unit: e1 is of the order of
// e2/k2, y of that of e1/100.
std::array<double, n> scales(const LoopModel& m) noexcept {
  const double e1 = m.k2 / m.k1, y = e1 * 1e-2;
  return {1.0, 1.0, 1.0, 1.0, e1, e1, y, y};
}

}  // namespace

double loop_decay(const LoopModel& model, const Grid& grid, SpaceVector v_p, SpaceVector i,
                  double enough) noexcept {
  const std::array<double, n> scale = scales(model);
  // e^{Ah} by Taylor to the fourth power: |λh| stays below about 1, and what it misses of the fast modes does
  // not matter as long as they decay.
  const double h = 1.0 / model.k2;
  Matrix A{};
  for (int k = 0; k < n; ++k) {
    std::array<double, n> unit{};
    unit[k] = scale[k];
    const std::array<double, n> column = derivative(model, grid, v_p, i, unit);
    for (int row = 0; row < n; ++row) A[row][k] = h * column[row] / scale[row];
  }
  Matrix M = A;
  for (auto& row : M)
    for (double& x : row) x *= 0.25;
  for (int term = 3; term > 0; --term) {  // Horner: 1 + A(1 + A/2(1 + A/3(1 + A/4)))
    for (int k = 0; k < n; ++k) M[k][k] += 1.0;
    M = product(A, M);
    for (auto& row : M)
      for (double& x : row) x /= static_cast<double>(term);
  }
  for (int k = 0; k < n; ++k) M[k][k] += 1.0;

  // ‖M^m‖ never falls below ρ(M)^m, so the decay read off it is a lower bound, the better the larger m.
  constexpr int squarings = 14, fewest = 9;
  constexpr double ln_2 = 0.69314718055994531;
  double exponent = 0.0;  // log2 of what was divided out
  double powers = 1.0;
  for (int k = 1;; ++k) {
    M = product(M, M);
    exponent *= 2.0;
    powers *= 2.0;
    const double size = norm_squared(M);
    if (!(size > 0.0) || !(size < std::numeric_limits<double>::infinity()))
      return size == 0.0 ? model.k2 : -std::numeric_limits<double>::infinity();
    int shift = 0;
    const double mantissa = std::frexp(size, &shift);
    if (k >= fewest) {
      // log2 ‖M‖ = (shift + log2 m)/2, and log2 m ≤ 2m − 2 + 0.09 for m in [½, 1].
      const double log2_norm = exponent + 0.5 * (shift + 2.0 * mantissa - 1.91);
      const double bound = -ln_2 * log2_norm / (powers * h);
      if (k == squarings || bound >= enough) return bound;
    }
    // By a power of two, so that nothing is rounded.
    const double factor = std::ldexp(1.0, -shift / 2);
    for (auto& row : M)
      for (double& x : row) x *= factor;
    exponent += shift / 2;
  }
}

}  // namespace weakgrid
