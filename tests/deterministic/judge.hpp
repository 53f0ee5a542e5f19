// What must hold at every step of every run, whatever is lost, late, doubled, stopped or killed. Judged by
// what is seen from outside: samples, answers, references, decisions, never by asking the code under test.
#pragma once

#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "controller/controller.hpp"
#include "gateway/acceptance.hpp"
#include "plant/protection.hpp"
#include "services/runtime/messages.hpp"
#include "services/runtime/settings.hpp"
#include "tests/deterministic/network.hpp"

namespace weakgrid::deterministic {

struct Violation {
  std::uint64_t step = 0;
  std::string what;
};

/// A request by which the judge knows it, whatever id it was given on its way.
using Asked = std::pair<std::uint64_t, std::uint32_t>;

class Judge {
 public:
  /// settings: as they ought to be, whatever a run was given.
  explicit Judge(const Settings& settings);

  /// A gateway has said this; box: what it knows of the grid then.
  void see_issued(WriterId gateway, const Reference& reference, const GridBox& box);
  /// What a gateway knows by now, and every plant and controller has had the time to follow it; none: not so.
  void know(WriterId gateway, const std::optional<GridBox>& box);
  void see_decided(WriterId gateway, Asked asked, bool must_be_refused, const Decision& decision);

  /// A plant goes to its next step.
  void see_sample(WriterId plant, const Measurement& sample);
  /// A plant listens to a controller's answer. is_gone(writer): its peers know that it is dead.
  template <class IsGone>
  void see_admitted(WriterId plant, WriterId controller, Time now, const Modulation& answer, IsGone is_gone);
  /// A plant's bridge follows an answer, or holds.
  void see_applied(WriterId plant, const Measurement& sample, const std::optional<Modulation>& answer,
                   std::uint32_t newest_at_plant);
  void see_answered(WriterId controller, const Measurement& sample, const Modulation& answer,
                    const ControllerState& state);

 private:
  struct Issued {
    Reference reference;
    WriterId gateway = 0;
    std::uint64_t lease_end_step = 0;  // of the order and all its renewals up to this one
  };
  struct Plant {
    std::optional<Measurement> last;
    std::uint64_t fallback_since = 0;
    std::uint32_t outside_v_p = 0;  // samples in a row
    WriterId driver = 0;            // of the last answer admitted
    std::uint64_t driver_epoch = 0;
    Time driver_heard{};
  };
  struct Law {
    std::optional<std::uint64_t> last_step;
    ShapedReference last;
  };

  [[noreturn]] void fail(std::uint64_t step, const std::string& what) const;
  void check_protection(Plant& plant, const Measurement& sample) const;
  void check_in_force(const Measurement& sample);
  void check_lease(const char* who, std::uint64_t step, std::uint32_t id, bool is_fallback) const;
  void check_fallback_reached(Plant& plant, const Measurement& sample) const;
  void check_ramp(const char* what, std::uint64_t step, double before, double after) const;
  bool is_rest(const Setpoint& s) const;
  Setpoint of(const Reference& r) const { return {r.p, r.q, r.v_c}; }

  const Rules rules_;
  const Protection protection_;
  const double step_change_max_;  // of a reference
  const double T_;
  std::map<std::uint32_t, Issued> issued_;
  std::map<WriterId, Plant> plants_;
  std::map<WriterId, Law> laws_;
  std::set<std::pair<WriterId, Asked>> accepted_;
  WriterId knower_ = 0;
  std::optional<GridBox> known_;
  std::set<std::uint32_t> good_on_known_;  // ids judged on that box
  std::uint64_t step_ = 0;                 // the last seen of any plant
};

template <class IsGone>
void Judge::see_admitted(WriterId plant, WriterId controller, Time now, const Modulation& answer,
                         IsGone is_gone) {
  Plant& p = plants_[plant];
  if (p.driver != 0 && p.driver != controller && answer.epoch <= p.driver_epoch && !is_gone(p.driver) &&
      now - p.driver_heard < OneWriter::silence_max)
    fail(answer.step, "two controllers drive one unit: one takes over from another that still speaks");
  p.driver = controller;
  p.driver_epoch = answer.epoch;
  p.driver_heard = now;
}

}  // namespace weakgrid::deterministic
