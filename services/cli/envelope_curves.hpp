// The operating envelope as it is drawn in the p-q plane: each limit a curve, the admissible setpoints an
// area. Section III; per unit.
#pragma once

#include <vector>

#include "gateway/envelope.hpp"

namespace weakgrid {

/// What is drawn, and for which v_c.
struct EnvelopeSlice {
  GridBox box;  ///< of the admissible area
  Grid grid;    ///< of the limit curves, one of the box
  Converter converter;
  Limits limits;
  double v_c;
};

/// Where a limit's margin is 0, in unbroken pieces of (p, q); within |s| ≤ reach, a little more may be there.
/// In the current plane each limit is a line or a circle, so the curves are exact; none for the DC voltage.
using PowerCurve = std::vector<std::vector<Setpoint>>;
PowerCurve limit_curve(const EnvelopeSlice& envelope, Limit limit, double reach);

/// At one p the admissible q, from … to.
struct AdmissibleSpan {
  double p, q_min, q_max;
};
/// Areas that together are the admissible setpoints within |p|, |q| ≤ reach, as spans over rising p.
std::vector<std::vector<AdmissibleSpan>> admissible_areas(const EnvelopeSlice& envelope, double reach);

}  // namespace weakgrid
