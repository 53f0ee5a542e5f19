// One recorded gateway process, re-executed: its requests into the pure arbiter, every bit of its decisions
// and references compared. All at the end: decisions are few.
#pragma once

#include <limits>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "gateway/arbiter.hpp"
#include "services/recording/differences.hpp"
#include "services/recording/unit_inputs.hpp"

namespace weakgrid {

struct GatewayFindings {
  std::uint32_t unit = 0;
  std::string participant, build;
  std::uint64_t decisions = 0, decisions_identical = 0;
  std::uint64_t references = 0, references_identical = 0;
  std::uint64_t accepted_recorded = 0, accepted_computed = 0;
  std::vector<Unchecked> unchecked;
};

class GatewayReplica {
 public:
  GatewayReplica(std::uint32_t unit, const std::string& participant) : unit_(unit) {
    findings_.unit = unit;
    findings_.participant = participant;
  }

  /// resumes: it had a journal, so that it knew what stood before its start.
  void configure(const Arbiter::Configuration& configuration, bool resumes, const std::string& build);
  bool is_configured() const { return arbiter_.has_value(); }

  /// plants: how many of the unit had been heard by then.
  void see(std::uint64_t sequence, const DecisionMessage& decision, std::size_t plants) {
    decisions_.emplace(sequence, Taken{decision, plants});
  }
  void see(const Reference& reference) { references_.emplace(reference.id, reference); }

  /// Requests: every one heard in that unit, by client and id.
  using Requests = std::multimap<std::pair<std::uint64_t, std::uint32_t>, Request>;
  /// What all units hold, should something of this one have lost its way.
  struct Strays {
    Requests requests;
    std::vector<Reference> references;  // of other units
  };
  void process(const UnitInputs& inputs, const Requests& requests, const Strays& strays,
               DifferenceLog& differences);

  const GatewayFindings& findings() const { return findings_; }

 private:
  struct Taken {
    DecisionMessage message;
    std::size_t plants;
  };
  void catch_up(std::uint32_t reference_id);
  void issue_unasked(std::uint32_t up_to, std::uint64_t step);
  bool may_answer_a_request(const Reference& reference) const;
  void decide(const DecisionMessage& recorded);
  void look_for(const Reference& issued, std::uint64_t step);
  const Request* request_of(const Decision& recorded);
  void take_as_recorded(const Decision& recorded);
  bool is_sure(const Decision& recorded) const;
  bool compare(const DecisionMessage& recorded, const Decision& computed);
  void compare(const Reference& recorded, const Reference& computed, std::uint64_t step);
  UnitState state_at(const Decision& decision) const;

  const std::uint32_t unit_;
  std::optional<Arbiter> arbiter_;
  std::optional<Timing> timing_;
  bool resumes_ = false;
  std::map<std::uint64_t, Taken> decisions_;
  std::size_t plants_then_ = 0;
  std::map<std::uint32_t, Reference> references_;  // as recorded
  std::set<std::pair<std::uint64_t, std::uint32_t>> decided_;
  std::set<std::pair<std::uint64_t, std::uint32_t>> answered_;  // by any recorded decision
  std::set<std::uint64_t> clients_;
  std::uint32_t newest_ = 0;  // reference known to the arbiter
  bool standing_is_lost_ = false;
  std::uint64_t sure_from_step_ = std::numeric_limits<std::uint64_t>::max();
  bool is_late_ = false;  // its first decision is not recorded
  const UnitInputs* inputs_ = nullptr;
  const Requests* requests_ = nullptr;
  const Strays* strays_ = nullptr;
  DifferenceLog* differences_ = nullptr;
  GatewayFindings findings_;
};

}  // namespace weakgrid
