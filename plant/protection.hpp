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
  pcc_overvoltage,
  pcc_undervoltage,
  overrun,  ///< whoever emulates the unit in real time has missed its time
};

struct Protection {
  double i_max = 2.0;             ///< |i|, per unit
  double v_c_max = 2.6;           ///< per unit
  double v_c_min = 1.2;           ///< per unit, above 0
  std::uint32_t max_holds = 20;   ///< consecutive periods without a modulation before the bridge is blocked
  double v_p_max = 1.6;           ///< |v_p|, per unit
  double v_p_min = 0.3;           ///< |v_p|, per unit
  std::uint32_t v_p_steps = 200;  ///< trips at so many samples in a row outside of these two, at least 1
};

/// The first limit that i or v_c violates.
inline Trip check(const Protection& limits, SpaceVector i, double v_c) noexcept {
  if (!finite(i) || !std::isfinite(v_c)) return Trip::not_finite;
  if (abs2(i) > limits.i_max * limits.i_max) return Trip::overcurrent;
  if (v_c > limits.v_c_max) return Trip::dc_overvoltage;
  if (v_c < limits.v_c_min) return Trip::dc_undervoltage;
  return Trip::none;
}

/// The limit of the PCC voltage that v_p violates, whatever for how long.
inline Trip check_pcc_voltage(const Protection& limits, SpaceVector v_p) noexcept {
  const double v_p2 = abs2(v_p);
  if (v_p2 > limits.v_p_max * limits.v_p_max) return Trip::pcc_overvoltage;
  if (v_p2 < limits.v_p_min * limits.v_p_min) return Trip::pcc_undervoltage;
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
    case Trip::pcc_overvoltage:
      return "PCC overvoltage";
    case Trip::pcc_undervoltage:
      return "PCC undervoltage";
    case Trip::overrun:
      return "steps missed";
  }
  return "unknown";
}

}  // namespace weakgrid
