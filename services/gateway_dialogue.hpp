// What the supervisor of one unit makes of what it hears: decides requests, issues references, withdraws them
// when the unit trips or begins anew, journals, and goes on where its journal ends. Knows no bus, clock or
// file: it is told the time, and says things through its outlet. From one thread at a time.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>
#include <string_view>

#include "gateway/arbiter.hpp"
#include "gateway/grid_evidence.hpp"
#include "services/gateway_memory.hpp"
#include "services/precedence.hpp"
#include "services/runtime/messages.hpp"
#include "services/runtime/one_writer.hpp"

namespace weakgrid {

/// Where a gateway's words go, in the order in which they are said.
class GatewayOutlet {
 public:
  virtual ~GatewayOutlet() = default;
  /// False: not sent.
  virtual bool write(const Reference& reference) = 0;
  virtual bool write(const Operation& operation) = 0;
  virtual bool write(const DecisionMessage& decision) = 0;
  virtual bool write(const Envelope& envelope) = 0;
  /// There is a journal.
  virtual bool keeps() const = 0;
  /// An entry of it; false: not written. What it tells of is said after this has returned: a kill in between
  /// loses no decision.
  virtual bool keep(std::string_view kind, nlohmann::json body) = 0;
};

class GatewayDialogue {
 public:
  using Time = std::chrono::steady_clock::time_point;

  /// instance: as its health says. who: its lines in the log begin so. memory: what the journal of an earlier
  /// start tells; settings hold the grid of it already.
  GatewayDialogue(const Settings& settings, std::uint64_t instance, const std::string& who,
                  const GatewayMemory& memory, GatewayOutlet& outlet, Time now);
  /// It stops, in order.
  void stop();

  void decide(const Request& request, Time now);
  /// Follows the unit: its step, its trips, and whether it is still the same one.
  void watch(const Measurement& measurement, bool is_another, Time now);
  void hear(const Health& health, Time now);
  /// Every few ms: people are told of the end of a lease, and of what has changed.
  void look_after(Time now);
  /// Without what only the outlet can count.
  Health health(Time now) const;

  std::uint64_t unsent() const { return unsent_; }
  std::uint64_t unwritten() const { return unwritten_; }
  const Arbiter& arbiter() const { return arbiter_; }

 private:
  bool may_act(Time now);
  void operate(const Decision& decision);
  void revalidate(Interval V);
  KnownGrid known_grid() const;
  void issue(const Reference& reference);
  void note(const Request* request, const Decision& decision);
  void note_event(std::string_view kind, const std::string& text,
                  const std::optional<Reference>& reference = {});
  void check_fallback();
  void watch_lease();
  void say_envelope();
  void leave_room();
  void go_on(const Measurement& measurement);
  bool has_heard_all(Time now) const;
  bool has_looked_around(Time now) const;
  template <class Message>
  void write(const Message& message) {
    if (!outlet_.write(message)) ++unsent_;
  }

  const std::uint32_t unit_;
  const std::string who_;  // in the log
  const Timing timing_;
  const AfterRestart after_restart_;
  const Time started_;
  GatewayOutlet& outlet_;
  std::optional<GatewayMemory> memory_;  // until the unit has been seen
  Precedence precedence_;
  Arbiter arbiter_;
  GridEvidence evidence_;
  std::optional<Envelope> said_;
  std::uint32_t fallen_back_id_ = 0;
  bool fallback_holds_ = true;
  bool was_blocked_ = false;
  bool has_left_room_ = false, has_heard_of_orders_ = false;
  bool has_yielded_ = false;  // another serves, or has served, beside this one
  bool is_unseen_ = false;   // a sample has come too early to act on it
  bool is_another_ = false;  // since the last sample that was acted on
  bool heard_plant_ = false, heard_controller_ = false;
  std::uint64_t step_ = 0, accepted_ = 0, rejected_ = 0, unsent_ = 0, unwritten_ = 0;
  std::uint32_t reference_id_ = 0;
};

}  // namespace weakgrid
