// Client: see the header.
#include "services/cli/client.hpp"

#include <algorithm>
#include <thread>

namespace weakgrid {

Client::Client(std::uint32_t domain, std::uint32_t unit, const DdsSettings& dds)
    : identity_(random_identity()),
      bus_(domain, dds, Role::client),
      health_reader_(bus_, unit,
                     [this](const Health& health, Arrival) {
                       const std::lock_guard lock(mutex_);
                       peers_[{health.service, health.instance}] = health;
                       forget_former_names(health.instance);
                       news_.notify_all();
                     }),
      manifest_reader_(bus_, unit,
                       [this](const Manifest& manifest, Arrival) {
                         const std::lock_guard lock(mutex_);
                         manifests_[{manifest.service, manifest.instance}] = manifest;
                       }),
      decision_reader_(bus_, unit,
                       [this](const DecisionMessage& message, Arrival) {
                         if (message.decision.client != identity_) return;
                         const std::lock_guard lock(mutex_);
                         decision_ = message;
                         news_.notify_all();
                       }),
      envelope_reader_(bus_, unit,
                       [this](const Envelope& envelope, Arrival) {
                         const std::lock_guard lock(mutex_);
                         envelope_ = envelope;
                         news_.notify_all();
                       }),
      requests_(bus_, unit),
      operations_(bus_, unit) {}

// One of two controllers goes by the name of what it does now, and has said goodbye under the other.
void Client::forget_former_names(std::uint64_t instance) {
  const auto is_of = [&](const Peers::value_type& peer) { return peer.first.second == instance; };
  const bool lives = std::ranges::any_of(
      peers_, [&](const auto& peer) { return is_of(peer) && peer.second.state != ServiceState::stopped; });
  if (lives)
    std::erase_if(
        peers_, [&](const auto& peer) { return is_of(peer) && peer.second.state == ServiceState::stopped; });
}

Client::~Client() {
  constexpr Patience moment{300};
  if (last_id_ > 0) wait_for_recorders();
  requests_.wait_until_taken(moment);
  operations_.wait_until_taken(moment);
}

// Discovery takes a tenth of a second or so; a command may be done sooner, and nobody would know what was
// asked.
void Client::wait_for_recorders() const {
  const auto recorders = [](const Peers& peers) {
    return std::count_if(peers.begin(), peers.end(), [](const auto& peer) {
      return peer.first.first == "recorder" && peer.second.state != ServiceState::stopped;
    });
  };
  const auto known =
      std::chrono::duration_cast<Patience>(born_ + Patience(400) - std::chrono::steady_clock::now());
  if (!wait_for(known, [&](const Peers& peers) { return recorders(peers) > 0; })) return;
  const auto deadline = std::chrono::steady_clock::now() + Patience(300);
  // Beside them the gateway listens.
  while (requests_.matched() < 1 + recorders(peers()) && std::chrono::steady_clock::now() < deadline)
    std::this_thread::sleep_for(Patience(5));
}

Client::Peers Client::peers() const {
  const std::lock_guard lock(mutex_);
  return peers_;
}

std::vector<Manifest> Client::manifests() const {
  const std::lock_guard lock(mutex_);
  std::vector<Manifest> all;
  for (const auto& [key, manifest] : manifests_) all.push_back(manifest);
  return all;
}

std::optional<Envelope> Client::envelope() const {
  const std::lock_guard lock(mutex_);
  return envelope_;
}

bool Client::wait_for(Patience patience, const std::function<bool(const Peers&)>& condition) const {
  std::unique_lock lock(mutex_);
  return news_.wait_for(lock, patience, [&] { return condition(peers_); });
}

bool Client::wait_for(const std::string& service, Patience patience,
                      const std::function<bool(const Health&)>& condition) const {
  return wait_for(patience, [&](const Peers& peers) {
    for (const auto& [key, health] : peers)
      if (key.first == service && health.state != ServiceState::stopped && condition(health)) return true;
    return false;
  });
}

std::optional<DecisionMessage> Client::ask(Request request, Patience patience) {
  request.client = identity_;
  request.id = ++last_id_;
  if (request.who.name.empty()) request.who.name.text = {'s', 'o', 'm', 'e', 'b', 'o', 'd', 'y'};
  const auto deadline = std::chrono::steady_clock::now() + patience;
  std::unique_lock lock(mutex_);
  decision_.reset();
  // The gateway may know this client as a writer before it knows it as a reader: a repeat costs nothing.
  while (std::chrono::steady_clock::now() < deadline) {
    if (requests_.matched() > 0 && decision_reader_.matched() > 0) {
      lock.unlock();
      (void)requests_.write(request);
      lock.lock();
    }
    if (news_.wait_for(lock, Patience(100),
                       [&] { return decision_ && decision_->decision.id == request.id; }))
      return decision_;
  }
  return std::nullopt;
}

bool Client::operate(OperationKind kind, std::uint64_t until_step, Patience patience) {
  const auto deadline = std::chrono::steady_clock::now() + patience;
  const Operation operation{.client = identity_, .id = ++last_id_, .kind = kind, .until_step = until_step};
  while (operations_.matched() == 0) {
    if (std::chrono::steady_clock::now() >= deadline) return false;
    std::unique_lock lock(mutex_);
    news_.wait_for(lock, Patience(10));
  }
  return operations_.write(operation);
}

std::uint64_t counter(const Health& health, const std::string& name) {
  for (const Counter& counter : health.counters)
    if (counter.name == name) return counter.value;
  return 0;
}

}  // namespace weakgrid
