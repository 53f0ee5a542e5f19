// The arbiter: turns a client's request into a decision and, if accepted, into the unit's next reference.
// It asks whether the request is fresh, well formed and inside the envelope (Section III). Time in steps.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>

#include "gateway/envelope.hpp"
#include "plant/model.hpp"

namespace weakgrid {

/// Bits of Request::given.
inline constexpr std::uint32_t given_p = 1;
inline constexpr std::uint32_t given_q = 2;
inline constexpr std::uint32_t given_v_c = 4;

/// (client, id) names a request: a repeat is answered with the same decision, whatever else it says.
struct Request {
  std::uint64_t client = 0;  ///< the asker, a random number, not 0
  std::uint32_t id = 0;      ///< 1, 2, … rising for each client
  std::uint32_t given = 0;   ///< what of p, q, v_c is asked for, at least one; the rest stays and is not read
  double p = 0.0;            ///< −10 … 10
  double q = 0.0;            ///< −10 … 10
  double v_c = 0.0;          ///< above 0, at most 10
  double ramp_s = 0.0;       ///< 0 = the default
  std::uint64_t effective_step = 0;  ///< 0 = as soon as possible; at most step_max
};

/// Of every field.
constexpr std::uint32_t fingerprint(const Request& r) {
  Fingerprint f;
  for (const std::uint64_t word : {r.client, std::uint64_t{r.id}, std::uint64_t{r.given}, r.effective_step})
    f.add(word);
  for (const double number : {r.p, r.q, r.v_c, r.ramp_s}) f.add(number);
  return f.value();
}

/// No step beyond this is meant: the end of a ramp never wraps around.
inline constexpr std::uint64_t step_max = std::uint64_t{1} << 63;

enum class Verdict : std::uint8_t { accepted, outside_envelope, bad_request, stale_request, unit_blocked };

/// The field that made a request bad or stale.
enum class Field : std::uint8_t { none, client, id, given, p, q, v_c, ramp_s, effective_step };

/// Mirrors SetpointDecision of the wire contract; its text is the service's.
struct Decision {
  std::uint64_t client = 0;
  std::uint32_t id = 0;
  Verdict verdict = Verdict::bad_request;
  Field field = Field::none;  ///< bad_request, stale_request
  bool repeated = false;      ///< given before; nothing new was issued
  Setpoint setpoint;          ///< as asked, what was not given filled in; maybe not finite if bad_request
  Margins margins;            ///< accepted, outside_envelope
  std::optional<Reference> reference;  ///< accepted
  /// What it was decided on, so that it can be decided again.
  std::uint64_t decided_step = 0;
  std::uint32_t standing_reference_id = 0;
  std::uint32_t request_fingerprint = 0;
};

class Arbiter {
 public:
  struct Configuration {
    Grid grid;  ///< what the gateway knows of the grid
    Converter converter;
    Limits limits;
    Timing timing;
    Setpoint initial;               ///< stands until the first reference
    double default_ramp_s = 0.020;  ///< reference steps would saturate μ on a weak grid
    double min_ramp_s = 0.001;
    double max_ramp_s = 60.0;
    std::uint32_t lead_steps = 50;  ///< "as soon as possible": so long after the last step seen, at least 1
  };

  /// Clients remembered. One more, and the least recently heard is forgotten: its late repeat is judged anew.
  static constexpr std::size_t client_max = 64;

  explicit Arbiter(const Configuration& configuration) noexcept;

  /// step_now: the last step a measurement was seen of. A unit waiting at k has published k − 1, so an
  /// effective_step of step_now + 1 is in time, one of step_now is stale. Total, no allocation; the same
  /// calls in the same order give the same decisions, bit for bit.
  Decision decide(const Request& request, std::uint64_t step_now) noexcept;

  /// The unit has tripped: the initial setpoint stands, at once, and until unblocked() nothing is accepted.
  Reference block() noexcept;
  void unblock() noexcept { blocked_ = false; }

  /// A reference that this arbiter did not issue is in force (it has restarted): ids go on above it, and
  /// until a request gives p, q and v_c nothing is known to stand.
  void note_foreign_reference(std::uint32_t id) noexcept;

  /// That reference is known to stand, whoever issued it.
  void adopt(const Reference& reference) noexcept;

  /// The newest reference issued, perhaps not yet in effect.
  const std::optional<Reference>& standing() const noexcept { return standing_; }

 private:
  struct Client {
    std::uint64_t heard = 0;  ///< hearings_ when last heard, 0 = free
    Decision last;
  };

  Client& recall(std::uint64_t client) noexcept;
  Setpoint complete(const Request& request) const noexcept;
  Field offending_field(const Request& request) const noexcept;
  void judge(const Request& request, std::uint64_t step_now, Decision& decision) const noexcept;
  Reference issue(const Setpoint& setpoint, double ramp_s, std::uint64_t effective_step) noexcept;
  std::uint64_t start_of(const Request& request, std::uint64_t step_now) const noexcept;

  Configuration configuration_;
  Setpoint setpoint_;  ///< the standing one
  std::optional<Reference> standing_;
  std::uint32_t reference_id_ = 0;
  bool standing_is_known_ = true;
  bool blocked_ = false;
  std::uint64_t hearings_ = 0;
  std::array<Client, client_max> clients_{};
};

}  // namespace weakgrid
