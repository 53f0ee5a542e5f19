// The arbiter: turns a client's request into a decision and, if accepted, into the unit's next reference.
// It asks whether the request is fresh, well formed and inside the envelope (Section III). Time in steps.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>

#include "gateway/acceptance.hpp"
#include "gateway/authority.hpp"
#include "plant/model.hpp"

namespace weakgrid {

/// Bits of Request::given.
inline constexpr std::uint32_t given_p = 1;
inline constexpr std::uint32_t given_q = 2;
inline constexpr std::uint32_t given_v_c = 4;

enum class RequestKind : std::uint8_t {
  set,         ///< a setpoint
  accept,      ///< what was offered under `token`, exactly
  renew,       ///< the lease of what stands
  take,        ///< authority, without a setpoint
  release,     ///< authority; what stands stays until its lease ends
  set_grid,    ///< what is known of the grid has changed
  start,       ///< the unit, from off
  stop,        ///< the unit, from any state; anybody may, and authority ends with it
  reset,       ///< the unit, after a trip
  revalidate,  ///< nobody's request: what is measured has changed what is known of the grid
};

/// (client, id) names a request: a repeat is answered with the same decision, whatever else it says. Of what
/// its kind does not need nothing is read.
struct Request {
  std::uint64_t client = 0;  ///< the asker, a random number, not 0
  std::uint32_t id = 0;      ///< 1, 2, … rising for each client
  RequestKind kind = RequestKind::set;
  Holder who{};             ///< in whose name; not protection
  std::uint32_t given = 0;  ///< what of p, q, v_c is asked for, at least one; the rest stays and is not read
  double p = 0.0;           ///< −10 … 10
  double q = 0.0;           ///< −10 … 10
  double v_c = 0.0;         ///< above 0, at most 10
  double ramp_s = 0.0;      ///< at least; 0 = the default
  double lease_s = 0.0;     ///< 0 = the default
  Policy policy = Policy::minimum_distance;  ///< of the offer, should the setpoint be refused
  std::uint32_t token = 0;                   ///< accept
  std::uint64_t effective_step = 0;          ///< 0 = as soon as possible; at most step_max
  Interval R_g{}, X_g{}, V{};                ///< set_grid: 0 … 10, 0 … 10, 0.1 … 2
};

/// Of every field.
constexpr std::uint32_t fingerprint(const Request& r) {
  Fingerprint f;
  for (const std::uint64_t word :
       {r.client, std::uint64_t{r.id}, std::uint64_t(r.kind), std::uint64_t(r.who.source),
        std::uint64_t{r.given}, std::uint64_t(r.policy), std::uint64_t{r.token}, r.effective_step})
    f.add(word);
  for (const char c : r.who.name.text) f.add(std::uint64_t{static_cast<unsigned char>(c)});
  for (const double number : {r.p, r.q, r.v_c, r.ramp_s, r.lease_s, r.R_g.low, r.R_g.high, r.X_g.low,
                              r.X_g.high, r.V.low, r.V.high})
    f.add(number);
  return f.value();
}

/// No step beyond this is meant: the end of a ramp never wraps around.
inline constexpr std::uint64_t step_max = std::uint64_t{1} << 63;

enum class Verdict : std::uint8_t {
  accepted,
  outside_envelope,
  bad_request,
  stale_request,
  unit_blocked,
  not_authorised,  ///< somebody else holds authority: Decision::holder
  path_outside,    ///< the setpoint would do, the straight way to it leaves the envelope at `leaves_at`
  not_stable,      ///< margins decay or transient
  no_such_offer,   ///< unknown, or its time is over
  nothing_stands,  ///< there is no lease to renew, or it is about to end
  interlocked,     ///< not in Decision::unit_state; or idle itself may not stand: margins
};

/// The field that made a request bad or stale.
enum class Field : std::uint8_t {
  none,
  client,
  id,
  given,
  p,
  q,
  v_c,
  ramp_s,
  effective_step,
  source,
  lease_s,
  grid,
  kind,
};

/// A setpoint that would be accepted now. Instead of what was asked for, or first, on the way to it.
struct Offer {
  std::uint32_t token = 0;
  Setpoint setpoint;
  bool is_detour = false;
  std::uint64_t valid_until_step = 0;
};

/// Mirrors SetpointDecision of the wire contract; its text is the service's.
struct Decision {
  std::uint64_t client = 0;
  std::uint32_t id = 0;
  RequestKind kind = RequestKind::set;
  Verdict verdict = Verdict::bad_request;
  Field field = Field::none;  ///< bad_request, stale_request
  bool repeated = false;      ///< given before; nothing new was issued
  Setpoint setpoint;   ///< judged: as asked, what was not given filled in; maybe not finite if bad_request
  Margins margins;     ///< once the envelope has been looked at
  Setpoint leaves_at;  ///< path_outside
  std::optional<Offer> offer;  ///< outside_envelope, path_outside, not_stable
  Holder holder;               ///< of authority after the decision, if held_until_step is not 0
  std::uint64_t held_until_step = 0;
  /// accepted. On set_grid and revalidate: what stood may not stand any more, this is the nearest that may.
  std::optional<Reference> reference;
  std::uint32_t steps_to_reach = 0;  ///< accepted: ramp and settling
  /// What it was decided on, so that it can be decided again.
  std::uint64_t decided_step = 0;
  std::uint32_t standing_reference_id = 0;
  std::uint32_t request_fingerprint = 0;
  UnitState unit_state = UnitState::running;
  Interval measured_V{};  ///< revalidate: |v_g| that the measurements imply; the box now reaches so far
};

class Arbiter {
 public:
  struct Configuration : Rules {
    Timing timing;
    double settling_s = 0.050;  ///< of the slowest of law and notch: time to reach
    Setpoint initial;           ///< stands until the first reference
    double fallback_ramp_s = 0.1;
    double min_ramp_s = 0.001;
    double default_lease_s = 60.0;
    double max_lease_s = 86'400.0;
    double offer_s = 60.0;          ///< an offer's token is good for so long
    std::uint32_t lead_steps = 50;  ///< "as soon as possible": so long after the last step seen, at least 1
  };

  /// Clients remembered. One more, and the least recently heard is forgotten: its late repeat is judged anew.
  static constexpr std::size_t client_max = 64;
  /// Offers remembered; the oldest goes first.
  static constexpr std::size_t offer_max = 64;

  explicit Arbiter(const Configuration& configuration) noexcept;

  /// step_now: the last step a measurement was seen of. A unit waiting at k has published k − 1, so an
  /// effective_step of step_now + 1 is in time, one of step_now is stale. Total, no allocation; the same
  /// calls in the same order give the same decisions, bit for bit.
  Decision decide(const Request& request, std::uint64_t step_now) noexcept;

  /// The measured state contradicts every grid of the box; |v_g| = V would explain it. The box is widened,
  /// and what stands is judged anew: it may have to move.
  Decision revalidate(Interval V, std::uint64_t step_now) noexcept;

  /// Nobody was heard of whom it could be learnt: until a request gives p, q and v_c nothing is known to
  /// stand.
  void forget() noexcept { standing_is_known_ = false; }

  /// What stands is given up for the fallback, ramped; nobody holds authority.
  Reference fall_back(std::uint64_t step_now) noexcept;

  /// As last measured; what start, stop and reset depend on.
  void note_unit(UnitState state) noexcept { unit_state_ = state; }

  /// The unit has tripped or begun anew: the initial setpoint stands, at once, nobody holds authority, no
  /// offer is good, and until unblocked() nothing is accepted.
  Reference block() noexcept;
  void unblock() noexcept { blocked_ = false; }

  /// A reference that this arbiter did not issue is in force (it has restarted): ids go on above it, and
  /// until a request gives p, q and v_c nothing is known to stand.
  void note_foreign_reference(std::uint32_t id) noexcept;

  /// The next ids are left to references of before a restart that nobody here knows of; of one of those
  /// note_foreign_reference() tells.
  static constexpr std::uint32_t room = 64;
  void leave_room() noexcept;

  /// That reference is known to stand, whoever issued it; one older than the newest known is ignored.
  void adopt(const Reference& reference) noexcept;

  /// The newest reference issued, perhaps not yet in effect, perhaps fallen back.
  const std::optional<Reference>& standing() const noexcept { return standing_; }
  /// Stands before the first order and after block().
  const Setpoint& idle() const noexcept { return configuration_.initial; }
  const Authority& authority() const noexcept { return authority_; }
  /// What a lost client leads to would itself be accepted, but for the way there.
  bool fallback_holds() const noexcept { return may_stand(configuration_, configuration_.fallback); }
  const Rules& rules() const noexcept { return configuration_; }
  /// A restarted gateway goes on where its journal ends.
  void adopt(const Authority& authority) noexcept { authority_ = authority; }

 private:
  struct Client {
    std::uint64_t heard = 0;  ///< hearings_ when last heard, 0 = free
    Decision last;
  };
  Decision begun(RequestKind kind, std::uint64_t step_now) noexcept;
  void tell_holder(std::uint64_t step_now, Decision& decision) const noexcept;
  Client& recall(std::uint64_t client) noexcept;
  Setpoint complete(const Request& request) const noexcept;
  Field offending_field(const Request& request) const noexcept;
  void judge(const Request& request, std::uint64_t step_now, Decision& decision) noexcept;
  void judge_setpoint(const Request& request, std::uint64_t step_now, Decision& decision) noexcept;
  void judge_renewal(const Request& request, std::uint64_t step_now, Decision& decision) noexcept;
  void judge_operation(const Request& request, Decision& decision) noexcept;
  void judge_standing(std::uint64_t step_now, Decision& decision) noexcept;
  void offer(const Setpoint& setpoint, bool is_detour, std::uint64_t step_now, Decision& decision) noexcept;
  Reference issue(const Setpoint& setpoint, double ramp_s, std::uint64_t effective_step,
                  std::uint64_t lease_end_step) noexcept;
  void follow(const Reference& reference) noexcept;
  std::uint64_t start_of(const Request& request, std::uint64_t step_now) const noexcept;
  std::uint64_t steps(double seconds) const noexcept;

  Configuration configuration_;
  Setpoint setpoint_;  ///< the standing one
  std::optional<Reference> standing_;
  Course course_;
  std::uint32_t reference_id_ = 0;
  AdmissibleArea area_;         ///< saves time, decides nothing
  std::uint32_t room_end_ = 0;  // the last of the ids that were left, 0: none
  bool standing_is_known_ = true;
  bool blocked_ = false;
  UnitState unit_state_ = UnitState::running;
  Authority authority_;
  std::array<Offer, offer_max> offers_{};
  std::uint32_t offers_made_ = 0;
  std::uint64_t hearings_ = 0;
  std::array<Client, client_max> clients_{};
};

}  // namespace weakgrid
