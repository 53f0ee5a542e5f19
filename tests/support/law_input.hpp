// Seeded random inputs of the supervisor's laws. WEAKGRID_LAW_COUNT sets how many cases, WEAKGRID_LAW_SEED
// which.
#pragma once

#include <cstdint>
#include <cstdlib>
#include <ostream>
#include <random>

#include "gateway/envelope.hpp"

namespace weakgrid {

inline std::uint64_t from_environment(const char* name, std::uint64_t otherwise) {
  const char* text = std::getenv(name);
  return text != nullptr ? std::strtoull(text, nullptr, 10) : otherwise;
}
inline std::uint64_t law_count(std::uint64_t otherwise) {
  return from_environment("WEAKGRID_LAW_COUNT", otherwise);
}
inline std::uint64_t law_seed() { return from_environment("WEAKGRID_LAW_SEED", 20'261'122); }

class LawInput {
 public:
  explicit LawInput(std::uint64_t number) : bits_(law_seed() + number * 0x9e3779b97f4a7c15u) {}

  double uniform(double low, double high) {
    return low + (high - low) * static_cast<double>(bits_() >> 11) * 0x1p-53;
  }
  bool one_in(std::uint64_t n) { return bits_() % n == 0; }

  /// Strong to very weak, points and flat boxes among them.
  GridBox box(double R_max = 0.3, double X_max = 0.6) {
    const double omega = Converter{}.omega;
    const auto interval = [&](double most) {
      const double low = one_in(4) ? 0.0 : uniform(0.0, most);
      return Interval{low, one_in(4) ? low : low + uniform(0.0, 0.4) * most};
    };
    GridBox box{interval(R_max), interval(X_max), {}};
    box.L_g = {box.L_g.low / omega, box.L_g.high / omega};
    box.V.low = uniform(0.85, 1.1);
    box.V.high = one_in(4) ? box.V.low : box.V.low + uniform(0.0, 0.1);
    return box;
  }
  Grid within(const GridBox& b) {
    return {uniform(b.R_g.low, b.R_g.high), uniform(b.L_g.low, b.L_g.high), uniform(b.V.low, b.V.high)};
  }
  Setpoint setpoint(double size = 1.5) {
    return {uniform(-size, size), uniform(-size, size), uniform(1.4, 2.5)};
  }
  Limits limits() {
    Limits limits;
    if (one_in(3)) limits.i_max = uniform(0.5, 1.5);
    if (one_in(3)) limits.v_p_min = uniform(0.6, 0.95);
    if (one_in(3)) limits.v_p_max = uniform(1.05, 1.4);
    if (one_in(3)) limits.reserve = {uniform(0.0, 0.3), 0.02, 0.01, 0.01, 0.02};
    return limits;
  }

 private:
  std::mt19937_64 bits_;
};

inline std::ostream& operator<<(std::ostream& out, const GridBox& b) {
  const double omega = Converter{}.omega;
  return out << "R_g " << b.R_g.low << " … " << b.R_g.high << ", X_g " << b.L_g.low * omega << " … "
             << b.L_g.high * omega << ", V " << b.V.low << " … " << b.V.high;
}
inline std::ostream& operator<<(std::ostream& out, const Setpoint& s) {
  return out << "p " << s.p << ", q " << s.q << ", v_c " << s.v_c;
}

}  // namespace weakgrid
