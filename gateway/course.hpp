// p, q and v_c as the unit follows them, step by step, and the order that comes next.
#pragma once

#include <cstdint>

#include "gateway/envelope.hpp"
#include "plant/model.hpp"

namespace weakgrid {

struct Course {
  ReferenceTrack track;
  Ramp p, q, v_c;

  void stand_at(const Setpoint& s) noexcept {
    p = {s.p, s.p, 0.0, 0, 0};
    q = {s.q, s.q, 0.0, 0, 0};
    v_c = {s.v_c, s.v_c, 0.0, 0, 0};
  }
  void advance_to(std::uint64_t step) noexcept {
    while (const auto move = track.advance_to(step, true)) {
      p = p.towards(move->p, move->start, move->ramp_steps);
      q = q.towards(move->q, move->start, move->ramp_steps);
      v_c = v_c.towards(move->v_c, move->start, move->ramp_steps);
    }
  }
  Setpoint at(std::uint64_t step) const noexcept {
    return {p.at(step).value, q.at(step).value, v_c.at(step).value};
  }
  bool moves(std::uint64_t step) const noexcept {
    return p.at(step).slope != 0.0 || q.at(step).slope != 0.0 || v_c.at(step).slope != 0.0;
  }
};

}  // namespace weakgrid
