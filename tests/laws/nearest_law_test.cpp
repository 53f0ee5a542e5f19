// What a refusal offers: admissible to the last bit, under the policy asked for, and no dense raster of
// setpoints finds one that is nearer by more than 1e-6.
#include <gtest/gtest.h>

#include <cmath>

#include "gateway/nearest.hpp"
#include "tests/support/law_input.hpp"

namespace weakgrid {
namespace {

double distance(const Setpoint& a, const Setpoint& b) { return std::hypot(a.p - b.p, a.q - b.q); }

struct Case {
  GridBox box;
  Limits limits;
  Setpoint wanted;
};

Case draw(std::uint64_t n) {
  LawInput input(n);
  Case x{input.box(), input.limits(), input.setpoint()};
  return x;
}

std::ostream& operator<<(std::ostream& out, const Case& x) {
  return out.precision(17), out << x.box << "; i_max " << x.limits.i_max << ", v_p " << x.limits.v_p_min
                                << " … " << x.limits.v_p_max << "; " << x.wanted;
}

// The nearest admissible point of a raster that zooms in on what it finds.
std::optional<double> nearest_of_raster(const Case& x, double v_c, Policy policy) {
  double size = 2.0;
  SpaceVector centre{x.wanted.p, x.wanted.q};
  std::optional<double> best;
  const SpaceVector s{x.wanted.p, x.wanted.q};
  for (int level = 0; level < 4; ++level, size /= 12.0) {
    constexpr int half = 30;
    SpaceVector best_at = centre;
    for (int a = -half; a <= half; ++a)
      for (int b = -half; b <= half; ++b) {
        const double u = size * a / half, v = size * b / half;
        SpaceVector here = centre + SpaceVector{u, v};
        if (policy == Policy::keep_p) here = {s.re, centre.im + (u * half + v) / half};
        if (policy == Policy::keep_q) here = {centre.re + (u * half + v) / half, s.im};
        if (policy == Policy::keep_power_factor) here = centre + ((u * half + v) / half) * (s / abs(s));
        const Setpoint setpoint{here.re, here.im, v_c};
        const double d = distance(setpoint, x.wanted);
        if (best && d >= *best) continue;
        if (slack(x.box, {}, x.limits, setpoint) < 0.0) continue;
        best = d;
        best_at = here;
      }
    if (!best) return std::nullopt;
    centre = best_at;
  }
  return best;
}

class NearestLaw : public testing::TestWithParam<Policy> {};

TEST_P(NearestLaw, IsAdmissibleKeepsWhatItPromisesAndNoRasterFindsANearerOne) {
  const Policy policy = GetParam();
  std::uint64_t offered = 0, none = 0, missed = 0;
  AdmissibleArea area;
  for (std::uint64_t n = 0; n < law_count(1'000); ++n) {
    const Case x = draw(n);
    const auto found = nearest_admissible(area, x.box, {}, x.limits, x.wanted, policy);
    if (found) {
      ++offered;
      ASSERT_TRUE(assess(x.box, {}, x.limits, *found).admissible) << n << ": " << x;
      ASSERT_TRUE(policy != Policy::keep_p || found->p == x.wanted.p) << n;
      ASSERT_TRUE(policy != Policy::keep_q || found->q == x.wanted.q) << n;
      ASSERT_TRUE(policy != Policy::keep_power_factor ||
                  std::abs(found->p * x.wanted.q - found->q * x.wanted.p) < 1e-12)
          << n;
    }
    const double v_c =
        found ? found->v_c : std::fmin(std::fmax(x.wanted.v_c, x.limits.v_c_min), x.limits.v_c_max);
    const auto raster = nearest_of_raster(x, v_c, policy);
    if (!found) ++none;
    if (!raster) continue;
    if (!found || distance(*found, x.wanted) > *raster + 1e-6) {
      ++missed;
      ADD_FAILURE() << n << ": offered " << (found ? distance(*found, x.wanted) : -1.0) << ", raster "
                    << *raster << "; " << x;
      if (missed > 5) return;
    }
  }
  EXPECT_GT(offered, law_count(1'000) / 3);
}

INSTANTIATE_TEST_SUITE_P(Policies, NearestLaw,
                         testing::Values(Policy::minimum_distance, Policy::keep_p, Policy::keep_q,
                                         Policy::keep_power_factor));

TEST(NearestLaw, AnAdmissibleSetpointIsItsOwnNearest) {
  AdmissibleArea area;
  for (std::uint64_t n = 0; n < law_count(5'000); ++n) {
    const Case x = draw(n);
    if (!assess(x.box, {}, x.limits, x.wanted).admissible) continue;
    const auto found = nearest_admissible(area, x.box, {}, x.limits, x.wanted, Policy::minimum_distance);
    ASSERT_TRUE(found && found->p == x.wanted.p && found->q == x.wanted.q && found->v_c == x.wanted.v_c)
        << n << x;
  }
}

}  // namespace
}  // namespace weakgrid
