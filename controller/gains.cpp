// Gains: Ackermann's formula on the triple, K = [0 0 1] S⁻¹ φ(A).
#include "controller/gains.hpp"

// One instruction stream for every build: vectorised kernels may add in another order.
#define EIGEN_DONT_VECTORIZE
#include <Eigen/Dense>

namespace weakgrid {

namespace {

using Matrix = Eigen::Matrix3d;
using Vector = Eigen::Vector3d;

// The error dynamics ė = A e + B δu.
Matrix error_dynamics() {
  Matrix A;
  A << 0, 1, 0,  //
      0, 0, 0,   //
      1, 0, 0;
  return A;
}

Gains ackermann(const Matrix& A, const Vector& B, const std::array<double, 3>& poles) {
  Matrix S;
  S << B, A * B, A * (A * B);
  Matrix phi = Matrix::Identity();
  for (const double pole : poles) phi = phi * (A - pole * Matrix::Identity());
  const Eigen::RowVector3d K = S.transpose().partialPivLu().solve(Vector::Unit(2)).transpose() * phi;
  return {K(0), K(1), K(2)};
}

}  // namespace

Gains continuous_gains(const SettlingTimes& settling_times_s) {
  std::array<double, 3> poles{};
  for (std::size_t n = 0; n < 3; ++n) poles[n] = -settling_factor / settling_times_s[n];
  return ackermann(error_dynamics(), Vector(0, 1, 0), poles);
}

Gains sampled_gains(const SettlingTimes& settling_times_s, double T) {
  const Matrix A = error_dynamics();
  // A is nilpotent (A³ = 0): the series of the zero-order hold ends.
  const Matrix A_T = Matrix::Identity() + A * T + A * A * (T * T / 2.0);
  const Vector B_T =
      (Matrix::Identity() * T + A * (T * T / 2.0) + A * A * (T * T * T / 6.0)) * Vector(0, 1, 0);
  std::array<double, 3> poles{};
  for (std::size_t n = 0; n < 3; ++n) poles[n] = exp_minus(settling_factor * T / settling_times_s[n]);
  return ackermann(A_T, B_T, poles);
}

double exp_minus(double x) {
  int halvings = 0;
  for (; x > 0.5 && halvings < 64; ++halvings) x *= 0.5;
  double sum = 1.0;
  for (int n = 16; n >= 1; --n) sum = 1.0 - x * sum / n;
  for (; halvings > 0; --halvings) sum *= sum;
  return sum;
}

Notch make_notch(SpaceVector kappa, double omega, double T) {
  const SpaceVector decay = exp_minus(kappa.re * T) * unit_phasor(-kappa.im * T);
  return {unit_phasor(omega * T), SpaceVector{1.0, 0.0} - decay};
}

}  // namespace weakgrid
