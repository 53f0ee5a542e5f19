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
using Matrix = std::array<std::array<double, n>, n>;
using Polynomial = std::array<double, n + 1>;

// Columns of A: the derivative of the state that is 1 in one place. δ of everything, in the frame that turns
// at ω; e1 and y as the paper's, w = δv̂_p.
Matrix linearised(const LoopModel& m, const Grid& grid, SpaceVector v, SpaceVector i) noexcept {
  const double L = m.converter.L, L_g = grid.L_g, of_sum = 1.0 / (L + L_g);
  const SpaceVector Z_g{grid.R_g, m.converter.omega * L_g};
  const SpaceVector L_by_v = L * (SpaceVector{1.0, 0.0} / conj(v)), of_v = SpaceVector{1.0, 0.0} / v;
  const double weight = L * abs2(i);
  // Each state in a unit of its own, so that 1/s does not stand beside per unit: e1 is of the order of e2/k2,
  // y of that of e1/100.
  const double e1_unit = m.k2 / m.k1, y_unit = e1_unit * 1e-2;
  const std::array<double, n> unit{1.0, 1.0, 1.0, 1.0, e1_unit, e1_unit, y_unit, y_unit};
  const std::array<double, n> of_unit{1.0,           1.0,           1.0,          1.0,
                                      1.0 / e1_unit, 1.0 / e1_unit, 1.0 / y_unit, 1.0 / y_unit};
  Matrix A;
  for (int column = 0; column < n; ++column) {
    std::array<double, n> x{};
    x[column] = unit[column];
    const SpaceVector di{x[0], x[1]}, w{x[2], x[3]}, e1{x[4], x[5]}, y{x[6], x[7]};
    const SpaceVector e2 = -1.0 * (conj(v) * di + conj(w) * i);            // eq:xi2_est
    const SpaceVector minus_u = m.k1 * e1 + m.k2 * e2 + m.k3 * y;          // eq:u_est
    const SpaceVector di_dt = of_sum * (w + L_by_v * minus_u - Z_g * di);  // eq:mu_est, eq:L+Lg di
    const SpaceVector dv_p = L_g * di_dt + Z_g * di;                       // eq:vp
    const SpaceVector dw_dt = m.kappa * (dv_p - w);                        // eq:dvp_est
    // eq:xi1_est less its reference, of which |i_r|² moves with |v̂_p|.
    const double de1_dt = weight * (dw_dt * of_v).re - (dv_p * conj(i) + v * conj(di)).re;
    const std::array<double, n> derivative{di_dt.re, di_dt.im, dw_dt.re, dw_dt.im,
                                           de1_dt,   e2.im,    e1.re,    e1.im};
    for (int row = 0; row < n; ++row) A[row][column] = derivative[row] * of_unit[row];
  }
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
  Matrix A = linearised(model, grid, v_p, i);
  for (auto& row : A)
    for (double& x : row) x *= loop.unit_s;
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
