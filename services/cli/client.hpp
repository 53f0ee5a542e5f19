// A supervisory client on the bus: who is there, ask for a setpoint, operate the plant.
#pragma once

#include <chrono>
#include <condition_variable>
#include <functional>
#include <map>
#include <mutex>
#include <optional>

#include "services/runtime/announcer.hpp"
#include "services/runtime/bus.hpp"
#include "services/runtime/messages.hpp"

namespace weakgrid {

using Patience = std::chrono::milliseconds;

class Client {
 public:
  Client(std::uint32_t domain, std::uint32_t unit, const DdsSettings& dds);
  /// Waits a moment until whoever listens, a recorder too, has what was asked.
  ~Client();

  /// The last word of each living instance of each service: (service, instance) → health.
  using Peers = std::map<std::pair<std::string, std::uint64_t>, Health>;
  Peers peers() const;
  std::vector<Manifest> manifests() const;

  /// Waits until `condition` holds of the peers; false after `patience`.
  bool wait_for(Patience patience, const std::function<bool(const Peers&)>& condition) const;
  /// The same for one service of which one instance is expected.
  bool wait_for(const std::string& service, Patience patience,
                const std::function<bool(const Health&)>& condition) const;

  /// The gateway's last word of what stands and who may change it.
  std::optional<Envelope> envelope() const;

  /// Sends the request until a decision answers it. Fills in client and id, and a name if there is none.
  std::optional<DecisionMessage> ask(Request request, Patience patience);
  /// Sends an operation to the plant; false: no plant has come within `patience`.
  bool operate(OperationKind kind, std::uint64_t until_step, Patience patience);

 private:
  void wait_for_recorders() const;
  void forget_former_names(std::uint64_t instance);  // under the lock

  const std::uint64_t identity_;
  const std::chrono::steady_clock::time_point born_ = std::chrono::steady_clock::now();
  std::uint32_t last_id_ = 0;

  mutable std::mutex mutex_;
  mutable std::condition_variable news_;
  Peers peers_;
  std::map<std::pair<std::string, std::uint64_t>, Manifest> manifests_;
  std::optional<DecisionMessage> decision_;
  std::optional<Envelope> envelope_;

  Bus bus_;
  Reader<Health> health_reader_;
  Reader<Manifest> manifest_reader_;
  Reader<DecisionMessage> decision_reader_;
  Reader<Envelope> envelope_reader_;
  Writer<Request> requests_;
  Writer<Operation> operations_;

 public:
  Bus& bus() { return bus_; }
};

/// The value of a health's counter, 0 if it has none of that name.
std::uint64_t counter(const Health& health, const std::string& name);

}  // namespace weakgrid
