// What the controller derives at start-up, by name: for its manifest, and for whoever checks it.
#pragma once

#include <vector>

#include "controller/controller.hpp"
#include "services/runtime/messages.hpp"

namespace weakgrid {

inline std::vector<Constant> constants_of(const ControllerConstants& c) {
  return {{"T", c.T},
          {"K1", c.K.k1},
          {"K2", c.K.k2},
          {"K3", c.K.k3},
          {"notch_turn_re", c.notch.turn.re},
          {"notch_turn_im", c.notch.turn.im},
          {"notch_intake_re", c.notch.intake.re},
          {"notch_intake_im", c.notch.intake.im},
          {"tracking", c.tracking},
          {"held_re", c.held.re},
          {"held_im", c.held.im},
          {"mean_to_end_re", c.mean_to_end.re},
          {"mean_to_end_im", c.mean_to_end.im}};
}

}  // namespace weakgrid
