// The decay of a linear system without its eigenvalues: Hessenberg form, characteristic polynomial, and
// Routh's array of it, shifted. Only + − × ÷.
#include "gateway/loop_decay.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace weakgrid {

namespace {

constexpr int n = 8;
using Row = std::array<double, n>;
using Matrix = std::array<Row, n>;
using Polynomial = std::array<double, n + 1>;

// Of the states (ŷ.im, ê1.im, i, v̂_p, ê1.re, ŷ.re), in this order: A[of][to] is what the state `of` adds to
// the derivative of `to`, transposed, so that little is left to eliminate. In the frame that turns at ω; D is
// d/dt times unit_s. e1 is in units of the order of e2/k2, y of that of e1/100, so that 1/s does not stand
// beside per unit.
Matrix linearised(const LoopModel& m, const Grid& grid, SpaceVector v, SpaceVector i,
                  double unit_s) noexcept {
  constexpr double e1_by_y = 100.0;
  const double L = m.converter.L, L_g = grid.L_g, of_sum = unit_s / (L + L_g), e1_unit = m.k2 / m.k1;
  const double L_g_by_unit = L_g / unit_s, D_kappa = unit_s * m.kappa, of_e1_unit = m.k1 / m.k2;
  const SpaceVector Z_g{grid.R_g, m.converter.omega * L_g}, of_v = SpaceVector{1.0, 0.0} / v;
  const SpaceVector by_u = (of_sum * L) * conj(of_v);  // of −u in Di: eq:mu_est, eq:L+Lg di
  const SpaceVector weight_of_v = (L * abs2(i)) * of_v;
  // What a state with these values adds; e2 of eq:xi2_est.
  const auto row = [&](SpaceVector Di, SpaceVector i_, SpaceVector w, double e2_im) -> Row {
    const SpaceVector v_p = L_g_by_unit * Di + Z_g * i_;  // eq:vp
    const SpaceVector Dw = D_kappa * (v_p - w);           // eq:dvp_est
    // eq:xi1_est less its reference, of which |i_r|² moves with |v̂_p|.
    const double De1 = (weight_of_v * Dw).re - unit_s * (v_p * conj(i) + v * conj(i_)).re;
    return {0.0, unit_s * of_e1_unit * e2_im, Di.re, Di.im, Dw.re, Dw.im, of_e1_unit * De1, 0.0};
  };
  constexpr SpaceVector one{1.0, 0.0}, j{0.0, 1.0}, none{0.0, 0.0};
  const auto of_current = [&](SpaceVector u) {
    const SpaceVector e2 = -1.0 * (conj(v) * u);
    return row(m.k2 * (by_u * e2) - of_sum * (Z_g * u), u, none, e2.im);
  };
  const auto of_voltage = [&](SpaceVector u) {
    const SpaceVector e2 = -1.0 * (conj(u) * i);
    return row(of_sum * u + m.k2 * (by_u * e2), none, u, e2.im);
  };
  const Row of_u_re = row(by_u, none, none, 0.0), of_u_im = row(times_j(by_u), none, none, 0.0);
  Matrix A{of_u_im,         of_u_im,       of_current(one), of_current(j),
           of_voltage(one), of_voltage(j), of_u_re,         of_u_re};
  const double by_e1 = m.k1 * e1_unit, by_y = m.k3 * e1_unit / e1_by_y;  // eq:u_est
  for (const int state : {1, 6})
    for (double& x : A[state]) x *= by_e1;
  for (const int state : {0, 7})
    for (double& x : A[state]) x *= by_y;
  A[1][0] = A[6][7] = e1_by_y * unit_s;  // ŷ integrates ê1
  return A;
}

// By elimination with pivots: similar to A, zero below the subdiagonal.
void to_hessenberg(Matrix& A) noexcept {
  for (int m = 1; m < n - 1; ++m) {
    int pivot = m;
    for (int row = m + 1; row < n; ++row)
      if (std::abs(A[row][m - 1]) > std::abs(A[pivot][m - 1])) pivot = row;
    if (A[pivot][m - 1] == 0.0) continue;
    if (pivot != m) {
      std::swap(A[pivot], A[m]);
      for (auto& row : A) std::swap(row[pivot], row[m]);
    }
    const double of_pivot = 1.0 / A[m][m - 1];
    for (int row = m + 1; row < n; ++row) {
      const double factor = A[row][m - 1] * of_pivot;
      if (factor == 0.0) continue;
      for (int column = m; column < n; ++column) A[row][column] -= factor * A[m][column];
      for (auto& other : A) other[m] += factor * other[row];
      A[row][m - 1] = 0.0;
    }
  }
}

// det(s − H) of the leading blocks, each from those before it.
Polynomial characteristic(const Matrix& H) noexcept {
  std::array<Polynomial, n + 1> p{};
  p[0][0] = 1.0;
  for (int k = 1; k <= n; ++k) {
    for (int power = 0; power < k; ++power) {
      p[k][power + 1] += p[k - 1][power];
      p[k][power] -= H[k - 1][k - 1] * p[k - 1][power];
    }
    double below = 1.0;
    for (int j = k - 1; j > 0; --j) {
      below *= H[j][j - 1];
      const double factor = H[j - 1][k - 1] * below;
      for (int power = 0; power < j; ++power) p[k][power] -= factor * p[j - 1][power];
    }
  }
  return p[n];
}

}  // namespace

LoopPolynomial loop_polynomial(const LoopModel& model, const Grid& grid, SpaceVector v_p,
                               SpaceVector i) noexcept {
  LoopPolynomial loop{{}, 1.0 / model.k2};
  Matrix A = linearised(model, grid, v_p, i, loop.unit_s);
  to_hessenberg(A);
  loop.coefficients = characteristic(A);
  return loop;
}

bool decays(const LoopPolynomial& loop, double rate) noexcept {
  // The polynomial in s − rate: synthetic division, again and again.
  Polynomial p = loop.coefficients;
  const double shift = -rate * loop.unit_s;
  for (int from = 0; from < n; ++from)
    for (int power = n - 1; power >= from; --power) p[power] += shift * p[power + 1];
  // Routh: every first entry of a row positive. A row is written over the one two above it.
  std::array<double, n / 2 + 1> above, below;
  for (int k = 0; k <= n / 2; ++k) above[k] = p[n - 2 * k];
  for (int k = 0; k < n / 2; ++k) below[k] = p[n - 2 * k - 1];
  below[n / 2] = 0.0;
  for (int row = 1; row <= n; ++row) {
    if (!(below[0] > 0.0) || !(below[0] < std::numeric_limits<double>::infinity())) return false;
    const double ratio = above[0] / below[0];
    for (int k = 0; k < n / 2; ++k) above[k] = above[k + 1] - ratio * below[k + 1];
    above[n / 2] = 0.0;
    std::swap(above, below);
  }
  return true;
}

double loop_decay(const LoopPolynomial& loop) noexcept {
  // No mode is larger than the sum of the coefficients; the sum of all decays is the second of them.
  double size = 1.0;
  for (int k = 0; k < n; ++k) size += std::abs(loop.coefficients[k]);
  double low = -size / loop.unit_s, high = loop.coefficients[n - 1] / (n * loop.unit_s);
  if (!decays(loop, low)) return -std::numeric_limits<double>::infinity();
  while (high - low > 1e-3) {
    const double middle = 0.5 * (low + high);
    if (middle == low || middle == high) break;
    (decays(loop, middle) ? low : high) = middle;
  }
  return low;
}

}  // namespace weakgrid
