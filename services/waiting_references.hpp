// References that have come and wait for a loop's next step.
#pragma once

#include "plant/reference.hpp"
#include "services/runtime/mailbox.hpp"

namespace weakgrid {

/// One thread puts, one takes. In order; should too many wait, those in between are lost and never the
/// newest: it says all that there is to say.
class WaitingReferences {
 public:
  /// False: one is lost, this one or one before it.
  bool put(const Reference& reference) noexcept {
    if (in_order_.put(reference)) return true;
    newest_.put(reference);
    return false;
  }
  template <class Accept>
  void take(Accept accept) noexcept {
    while (const auto reference = in_order_.take()) accept(*reference);
    if (const auto reference = newest_.take()) accept(*reference);
  }

 private:
  Mailbox<Reference, 16> in_order_;
  Newest<Reference> newest_;
};

}  // namespace weakgrid
