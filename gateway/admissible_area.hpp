// The admissible area of the (p, q) plane at one v_c, as its boundary: traced once, then asked for what of it
// is nearest to a setpoint, in microseconds.
#pragma once

#include <array>
#include <optional>

#include "gateway/envelope.hpp"

namespace weakgrid {

class AdmissibleArea {
 public:
  AdmissibleArea() noexcept = default;
  /// A pure function of its arguments: some 10^4 assessments, 10^5 where no line of the raster meets the
  /// area. Areas, or bites out of one, that are smaller than 1/25 of the largest |s| can be missed.
  AdmissibleArea(const GridBox& box, const Converter& converter, const Limits& limits, double v_c) noexcept;

  bool is_of(const GridBox& box, const Converter& converter, const Limits& limits,
             double v_c) const noexcept {
    return box == box_ && converter == converter_ && limits == limits_ && v_c == v_c_;
  }

  /// Admissible, and of all such points nearest to `s`, which is not. Whatever is returned is to be assessed.
  std::optional<SpaceVector> nearest(SpaceVector s) const noexcept;
  /// The same of those on the line through s along a unit vector; none: the line passes by.
  std::optional<SpaceVector> nearest_on_line(SpaceVector s, SpaceVector along) const noexcept;

 private:
  /// From an admissible point to the next, the area on the left. The boundary in between, over the chord: its
  /// slopes at both ends, how far it is from the chord at most, and how slack falls across it.
  struct Piece {
    SpaceVector from, to;
    double slope_from = 0.0, slope_to = 0.0;
    double bulge = 0.0;
    double fall = 1.0;
  };
  static constexpr int piece_max = 1024;
  struct Beside {
    SpaceVector at;
    double slope = 0.0, fall = 1.0;
  };

  double slack_at(SpaceVector s) const noexcept {
    return slack_in_plane(box_, converter_, limits_, {s.re, s.im, v_c_});
  }
  SpaceVector boundary(SpaceVector inside, double slack_inside, SpaceVector outside,
                       double slack_outside) const noexcept;
  std::optional<SpaceVector> boundary_along(SpaceVector base, SpaceVector outwards, double step,
                                            double farthest) const noexcept;
  Beside sloped(SpaceVector at, double slack_there, SpaceVector along) const noexcept;
  std::optional<Beside> quickly_beside(const Piece& piece, SpaceVector along, double length,
                                       double share) const noexcept;
  bool is_traced() const noexcept { return count_ > 0 && count_ <= piece_max; }
  std::optional<SpaceVector> uphill(SpaceVector here, double step) const noexcept;
  SpaceVector trace_around(SpaceVector centre, double half) noexcept;
  void trace(SpaceVector from, SpaceVector to) noexcept;
  template <class Ahead, class Done>
  std::optional<SpaceVector> turning_point(const Piece& piece, const Ahead& ahead,
                                           const Done& done) const noexcept;

  GridBox box_{{0.0, -1.0}, {0.0, -1.0}, {0.0, -1.0}};  // none
  Converter converter_;
  Limits limits_;
  double v_c_ = 0.0;
  int count_ = 0;
  std::array<Piece, piece_max> pieces_;
};

}  // namespace weakgrid
