// One run: processes, network and disk under a scheduler that a seed decides everything for. It loses,
// delays, doubles and reorders, stops, kills and starts, and cuts the power; clients ask whatever they like.
#pragma once

#include "tests/deterministic/clients.hpp"
#include "tests/deterministic/kept_journal.hpp"
#include "tests/deterministic/processes.hpp"

namespace weakgrid::deterministic {

struct Outcome {
  std::optional<Violation> violation;
  std::uint64_t steps = 0, steps_running = 0;
  std::uint32_t digest = 0;  ///< of every sample, answer, reference and decision, in their order
  std::uint64_t accepted = 0, refused = 0, trips = 0, kills = 0, fallbacks = 0, takeovers = 0;
};

/// Violations are found, not thrown.
Outcome run(std::uint64_t seed, Bug bug = Bug::none);

class World {
 public:
  World(std::uint64_t seed, Bug bug);
  ~World();
  Outcome run();

  // For the processes.
  Time now() const { return scheduler_.now(); }
  Dice& dice() { return dice_; }
  Network& network() { return network_; }
  Judge& judge() { return judge_; }
  KeptJournal& journal() { return journal_; }
  const Settings& settings() const { return settings_; }
  const std::vector<Event>& events() const { return events_; }
  Bug bug() const { return bug_; }
  std::uint64_t* hidden() { return &hidden_; }
  bool is_gone(WriterId writer, Time at) const { return processes_[writer - 1]->gone <= at; }
  std::uint64_t step_seen() const { return step_seen_; }
  UnitState unit_state() const { return unit_state_; }
  std::uint32_t last_issued() const { return last_issued_; }
  /// How late a loop in real time wakes.
  nanoseconds late_by() { return dice_.one_in(2000) ? dice_.time(1ms, 20ms) : 20us; }

  void publish(const PlantProcess& from, const Measurement& measurement);
  void publish(const ControllerProcess& from, const Modulation& modulation);
  void publish(const ControllerProcess& from, const ControllerState& state);
  void publish(const GatewayProcess& from, const Reference& reference);
  void publish(const GatewayProcess& from, const Operation& operation);
  void publish(const Clients& from, const Request& request, Asked asked, bool is_hostile);
  void see(const PlantProcess& plant, const Measurement& sample);
  void see_issued(const GatewayProcess& from, const Reference& reference, const GridBox& box);
  void see_decided(const GatewayProcess& from, Asked asked, bool is_hostile, const Decision& decision);
  /// What the gateway knows of the grid now.
  void note_box(const GridBox& box);
  /// For the log of a run.
  std::string when() const;
  /// kill -9, now.
  void kill(Process& process);

 private:
  struct Said {
    std::uint32_t reference_id = 0;
    ServiceState state = ServiceState::starting;
    Time when{};
  };
  template <class Kind, class... Arguments>
  Kind& start(std::vector<Kind*>& all, Arguments&&... arguments);
  void start_plant();
  void start_controller(Redundancy redundancy);
  void start_gateway();
  /// What the service manager of its host does.
  void start_again(const Process& dead);
  template <class Kind>
  void say_health(Kind& of);
  void look_after(GatewayProcess& gateway);
  void meet(Process& newcomer);
  void plan_clients();
  void plan_faults();
  void disturb();
  void stop_in_order(Process& process);
  Process* any_running();
  void judge_what_is_known();
  void judge_again() const;

  const std::uint64_t seed_;
  const Bug bug_;
  Dice dice_;
  Scheduler scheduler_;
  const Settings true_settings_;
  const Settings settings_;
  const std::vector<Event> events_;
  Network network_;
  Judge judge_;
  KeptJournal journal_;
  std::vector<std::unique_ptr<Process>> processes_;  // by number − 1, the dead as well
  std::vector<PlantProcess*> plants_;
  std::vector<ControllerProcess*> controllers_;
  std::vector<GatewayProcess*> gateways_;
  Clients* clients_ = nullptr;
  std::map<WriterId, Said> said_;

  std::optional<GridBox> box_;
  Time box_since_{};
  std::uint64_t box_since_step_ = 0;
  std::uint64_t step_seen_ = 0;
  UnitState unit_state_ = UnitState::running;
  bool is_fallen_back_ = false;
  std::uint32_t last_issued_ = 0;
  std::uint64_t hidden_ = 0;
  Fingerprint digest_;
  Outcome outcome_;
};

}  // namespace weakgrid::deterministic
