// What of the traced boundary is nearest: pieces that may be, then Newton's method onto the boundary over
// them.
#include <algorithm>
#include <cmath>

#include "gateway/admissible_area.hpp"

namespace weakgrid {

namespace {

double distance_to_chord(SpaceVector s, SpaceVector from, SpaceVector to) noexcept {
  const SpaceVector chord = to - from;
  const double length2 = abs2(chord);
  const double share = length2 > 0.0 ? std::clamp(((s - from) * conj(chord)).re / length2, 0.0, 1.0) : 0.0;
  return abs(s - (from + share * chord));
}

}  // namespace

// By Newton's method from where the slopes say that it is. None: that does not lead there.
std::optional<AdmissibleArea::Beside> AdmissibleArea::quickly_beside(const Piece& piece, SpaceVector along,
                                                                     double length,
                                                                     double share) const noexcept {
  const SpaceVector base = piece.from + (share * length) * along, outwards = -1.0 * times_j(along);
  double height =
      length * share * (1.0 - share) * ((1.0 - share) * piece.slope_from - share * piece.slope_to);
  for (int k = 0; k < 5 && std::abs(height) <= 2.0 * piece.bulge; ++k) {
    const SpaceVector at = base + height * outwards;
    const double slack_here = slack_at(at);
    if (std::abs(slack_here) < 1e-10 * piece.fall) return sloped(at, slack_here, along);
    height += slack_here / piece.fall;
  }
  return std::nullopt;
}

// Where on the boundary `ahead(point, tangent)` falls through zero: regula falsi (Illinois), at times a half,
// for bends. `done` says when what is left of it does not matter.
template <class Ahead, class Done>
std::optional<SpaceVector> AdmissibleArea::turning_point(const Piece& piece, const Ahead& ahead,
                                                         const Done& done) const noexcept {
  const double length = abs(piece.from - piece.to);
  if (!(length > 0.0)) return std::nullopt;
  const SpaceVector along = (1.0 / length) * (piece.to - piece.from), outwards = -1.0 * times_j(along);
  double low = 0.0, high = 1.0;
  double at_low = ahead(piece.from, along + piece.slope_from * outwards);
  double at_high = ahead(piece.to, along + piece.slope_to * outwards);
  if (!(at_low > 0.0 && at_high < 0.0)) return std::nullopt;
  std::optional<SpaceVector> best;
  int side = 0;
  for (int k = 0; k < 40 && high - low > 1e-7; ++k) {
    const double share = k % 4 == 3 ? 0.5 * (low + high) : low + (high - low) * at_low / (at_low - at_high);
    auto here = quickly_beside(piece, along, length, share);
    if (!here) {
      const auto there = boundary_along(piece.from + share * (piece.to - piece.from), outwards,
                                        std::max(0.02 * length, 1e-10), 2.0 * length);
      if (!there) break;
      here = sloped(*there, 0.0, along);
    }
    best = here->at;
    const double rest = ahead(here->at, along + here->slope * outwards);
    if (done(here->at, rest)) break;
    if (rest > 0.0) {
      low = share;
      at_low = rest;
      if (side > 0) at_high *= 0.5;
      side = 1;
    } else {
      high = share;
      at_high = rest;
      if (side < 0) at_low *= 0.5;
      side = -1;
    }
  }
  if (!best) return best;
  // Newton's method may have stopped just outside.
  for (double back = 1e-11; back < 1e-7; back *= 4.0) {
    if (slack_at(*best) >= 0.0) return best;
    *best = *best - back * outwards;
  }
  return std::nullopt;
}

std::optional<SpaceVector> AdmissibleArea::nearest(SpaceVector s) const noexcept {
  if (!is_traced()) return std::nullopt;
  SpaceVector best = pieces_[0].from;
  double best2 = abs2(best - s);
  for (int k = 0; k < count_; ++k) {
    if (const double d2 = abs2(pieces_[k].from - s); d2 < best2) {
      best2 = d2;
      best = pieces_[k].from;
    }
    if (const double d2 = abs2(pieces_[k].to - s); d2 < best2) {
      best2 = d2;
      best = pieces_[k].to;
    }
  }
  double best_distance = std::sqrt(best2);
  // What may be nearer than any end of a piece.
  constexpr int few = 64;
  struct Candidate {
    double least;
    int piece;
  };
  std::array<Candidate, few> candidates;
  int count = 0;
  for (int k = 0; k < count_ && count < few; ++k) {
    const double least = distance_to_chord(s, pieces_[k].from, pieces_[k].to) - pieces_[k].bulge;
    if (least < best_distance) candidates[count++] = {least, k};
  }
  std::sort(candidates.begin(), candidates.begin() + count, [](const Candidate& a, const Candidate& b) {
    return a.least < b.least || (a.least == b.least && a.piece < b.piece);
  });
  // Where the way to s stands at a right angle to the boundary. If nowhere, an end is nearer than all
  // between.
  const auto ahead = [s](SpaceVector at, SpaceVector tangent) { return ((s - at) * conj(tangent)).re; };
  const auto done = [s](SpaceVector at, double rest) {
    return rest * rest < 1e-8 * std::max(abs(at - s), 1e-8);  // less than 1e-8 to be gained
  };
  for (int k = 0; k < count && candidates[k].least < best_distance; ++k) {
    const auto found = turning_point(pieces_[candidates[k].piece], ahead, done);
    if (found && abs(*found - s) < best_distance) {
      best = *found;
      best_distance = abs(best - s);
    }
  }
  return best;
}

std::optional<SpaceVector> AdmissibleArea::nearest_on_line(SpaceVector s, SpaceVector along) const noexcept {
  if (!is_traced()) return std::nullopt;
  std::optional<SpaceVector> best;
  double least = 1e300;  // way along the line, of either sign
  const auto aside = [&](SpaceVector at) { return (conj(along) * (at - s)).im; };
  const auto way_to = [&](SpaceVector at) { return (conj(along) * (at - s)).re; };
  // From a place on the line, admissible or not, to the boundary on either side, no farther than `farthest`.
  const auto consider = [&](double way, double farthest) {
    const bool inside = slack_at(s + way * along) >= 0.0;
    for (const double turn : {1.0, -1.0}) {
      double last = way;
      for (double far = 1e-9; far < farthest; far *= 4.0) {
        const double next = way + turn * far;
        const SpaceVector here = s + next * along;
        if (!((slack_at(here) >= 0.0) == inside)) {
          const SpaceVector a = s + last * along;
          const SpaceVector edge = inside ? boundary(a, slack_at(a), here, slack_at(here))
                                          : boundary(here, slack_at(here), a, slack_at(a));
          if (const double found = way_to(edge); std::abs(found) < std::abs(least)) {
            least = found;
            best = edge;
          }
          break;
        }
        last = next;
      }
    }
  };
  for (int k = 0; k < count_; ++k) {
    const Piece& piece = pieces_[k];
    const double a = aside(piece.from), b = aside(piece.to);
    const double way_a = way_to(piece.from), way_b = way_to(piece.to);
    const double length = abs(piece.from - piece.to), sign = a >= 0.0 ? 1.0 : -1.0;
    if (std::min(std::abs(way_a), std::abs(way_b)) - length > std::abs(least)) continue;
    if ((a >= 0.0) != (b >= 0.0)) {
      const auto crossing = turning_point(
          piece, [&](SpaceVector at, SpaceVector) { return sign * aside(at); },
          [](SpaceVector, double rest) { return std::abs(rest) < 1e-10; });
      consider(crossing ? way_to(*crossing) : way_a + (way_b - way_a) * (a / (a - b)), 4.0 * length + 1e-8);
    } else if (std::min(std::abs(a), std::abs(b)) < piece.bulge) {
      // The line may touch the piece between its ends.
      const auto top = turning_point(
          piece, [&](SpaceVector, SpaceVector tangent) { return -sign * (conj(along) * tangent).im; },
          [](SpaceVector, double rest) { return std::abs(rest) < 1e-7; });
      if (top && (aside(*top) >= 0.0) != (a >= 0.0)) consider(way_to(*top), 4.0 * length + 1e-8);
    }
  }
  return best;
}

}  // namespace weakgrid
