// Trips: what opens the bridge and the source whatever the controller says.
#pragma once

#include "plant/model.hpp"

namespace weakgrid {

enum class Trip : std::uint8_t {
  none,
  overcurrent,
  dc_overvoltage,
  dc_undervoltage,
  modulation_lost,  ///< held for longer than max_holds
  not_finite,
};

struct Protection {
  double i_max = 2.0;            ///< |i|, per unit
  double v_c_max = 2.6;          ///< per unit
  double v_c_min = 1.2;          ///< per unit, above 0
  std::uint32_t max_holds = 20;  ///< consecutive periods without a modulation before the bridge is blocked
};

/// The first limit that i or v_c violates.
inline Trip check(const Protection& limits, SpaceVector i, double v_c) noexcept {
  if (!finite(i) || !std::isfinite(v_c)) return Trip::not_finite;
  if (abs2(i) > limits.i_max * limits.i_max) return Trip::overcurrent;
  if (v_c > limits.v_c_max) return Trip::dc_overvoltage;
  if (v_c < limits.v_c_min) return Trip::dc_undervoltage;
  return Trip::none;
}

constexpr const char* name(Trip trip) noexcept {
  switch (trip) {
    case Trip::none:
      return "none";
    case Trip::overcurrent:
      return "overcurrent";
    case Trip::dc_overvoltage:
      return "DC overvoltage";
    case Trip::dc_undervoltage:
      return "DC undervoltage";
    case Trip::modulation_lost:
      return "modulation lost";
    case Trip::not_finite:
      return "state not finite";
  }
  return "unknown";
}

}  // namespace weakgrid
