// A recording re-executed: every controller and gateway in it fed what it was fed, every answer compared.
#pragma once

#include <functional>
#include <limits>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "services/recording/controller_replica.hpp"
#include "services/recording/gateway_replica.hpp"
#include "services/recording/recording_source.hpp"
#include "services/recording/what_if.hpp"
#include "services/runtime/settings.hpp"

namespace weakgrid {

struct ReexecutionOptions {
  std::uint64_t from_step = 0;             ///< 0 = from the start, else from the first state recorded there
  std::optional<Settings> other_settings;  ///< instead of the recorded ones: what if
  /// Called with each sample that a controller answered: unit, sample, recorded answer, controller after it.
  std::function<void(std::uint32_t, const Measurement&, const Modulation&, const Controller&)> watch;
};

struct ReexecutionFindings {
  std::vector<ControllerFindings> controllers;
  std::vector<GatewayFindings> gateways;
  DifferenceLog differences;
  std::uint64_t manifests = 0;
  std::map<std::uint32_t, RecordedLoop> loops;  ///< by unit
  std::string file_faults;

  std::uint64_t compared() const;
  std::uint64_t unchecked() const;
};

class Reexecution {
 public:
  explicit Reexecution(const ReexecutionOptions& options) : options_(options) {}

  /// The whole recording.
  void run(RecordingSource& source);
  const ReexecutionFindings& findings() const { return findings_; }

 private:
  // A process, as far as its manifest goes.
  struct Process {
    std::uint32_t unit;
    std::string service, participant, build;
    Settings settings;
    bool taken = false;
  };
  struct Unit {
    UnitInputs inputs;
    GatewayReplica::Requests requests;
    std::map<std::size_t, std::unique_ptr<ControllerReplica>> controllers;  // by index of the writer
    std::map<std::string, GatewayReplica> gateways;                         // by participant
    std::uint64_t first_step = 0;
    std::string first_type;
    RecordedLoop loop;
    Measurement newest_sample;
    std::uint32_t newest_reference = 0;  // that the controller knew
  };
  void note_loop(Unit& unit, const Modulation& answer);
  void note_holds(Unit& unit, const Measurement& sample);

  void see(const RecordedMessage& message);
  template <class Message>
  void see_as(const RecordedMessage& message);
  void see(const RecordedWriter& writer, std::uint32_t unit, const Manifest& manifest);
  void see(const mcap::Metadata& metadata);
  void check_manifest(std::uint32_t unit, const Manifest& manifest);
  void refuse(const RecordedMessage& message);
  void check_units();
  std::uint64_t step_of(const RecordedMessage& message);
  ControllerReplica& controller_of(Unit& unit, std::uint32_t number, const RecordedWriter& writer);
  GatewayReplica& gateway_of(Unit& unit, std::uint32_t number, const RecordedWriter& writer);
  Process* process_of(std::uint32_t unit, const std::string& service, const std::string& participant);
  void finish();

  const ReexecutionOptions options_;
  std::map<std::uint32_t, Unit> units_;
  std::map<std::pair<std::uint32_t, std::uint64_t>, bool> manifests_seen_;  // (unit, instance)
  std::vector<Process> processes_;
  std::map<std::size_t, std::uint64_t> last_steps_;  // by index of the writer
  ReexecutionFindings findings_;
};

}  // namespace weakgrid
