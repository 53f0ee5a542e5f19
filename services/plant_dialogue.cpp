// PlantDialogue: see the header.
#include "services/plant_dialogue.hpp"

namespace weakgrid {

std::optional<Modulation> PlantDialogue::answer_to(const Measurement& measurement) noexcept {
  while (const auto modulation = modulations_.take()) {
    if (modulation->step > measurement.step || modulation->step < unanswered_) continue;
    if (modulation->period_ns != static_cast<std::uint32_t>(measurement.timing.period_ns)) {
      count(foreign_);
      continue;
    }
    if (modulation->step < measurement.step) {
      unanswered_ = modulation->step + 1;
      count(late_modulations_);
      continue;
    }
    // Of another plant's sample of that step: a unit that was started anew, or twice.
    if (modulation->measurement_fingerprint != 0 &&
        modulation->measurement_fingerprint != fingerprint(measurement)) {
      count(foreign_);
      continue;
    }
    unanswered_ = modulation->step + 1;
    if ((modulation->status & saturated) != 0) count(saturated_);
    return modulation;
  }
  return std::nullopt;
}

bool PlantDialogue::obey(const Operation& operation) noexcept {
  switch (operation.kind) {
    case OperationKind::advance:
      // Nobody who knows this unit asks it to wait in the past.
      if (operation.until_step < emulator_.step()) return false;
      until_ = operation.until_step;
      return true;
    case OperationKind::reset_trip:
      return emulator_.reset_trip();
    case OperationKind::start:
      return emulator_.start();
    case OperationKind::stop:
      return emulator_.stop();
  }
  return false;
}

}  // namespace weakgrid
