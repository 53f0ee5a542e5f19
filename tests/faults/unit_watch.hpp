// An observer that hears every sample, answer, order and health of one unit, and holds them to what no fault
// may change. What it has not heard it does not judge: a lost packet is no violation.
#pragma once

#include <map>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "services/cli/client.hpp"

namespace weakgrid::faults {

using Time = std::chrono::steady_clock::time_point;

class UnitWatch {
 public:
  UnitWatch(std::uint32_t domain, const DdsSettings& dds);

  Client& client() { return client_; }
  std::optional<Measurement> sample() const;
  /// Plant and controller both have this order in force, and the unit runs on the controller's answers: it
  /// closes after a reset also if the plant listens to nobody, for the steps that it may hold.
  bool follows(std::uint32_t id) const;
  /// This service has said its health after `since`.
  bool is_well(const std::string& service, Time since) const;
  /// That health's counter.
  std::uint64_t count(const std::string& service, const std::string& name) const;
  /// When it said its health last, by its own clock; 0: never.
  std::int64_t wall_time_ns(const std::string& service) const;
  /// What is known, for a failure.
  std::string words() const;

  /// What was violated since this was asked last.
  std::vector<std::string> take_violations();
  /// Ids that the unit has followed and nobody was heard to issue: the journal has to know them.
  std::set<std::uint32_t> followed_unheard() const;

 private:
  struct Said {
    Health health;
    Time at{};
  };
  void see(const Measurement& m, WriterId writer);
  void see(const Modulation& m);
  void see(const Reference& r);
  void see(const Health& h);
  void violated(const std::string& what) { violations_.push_back(what); }
  void check_leases();

  mutable std::mutex mutex_;
  std::optional<Measurement> sample_;
  std::optional<Modulation> answer_;
  static constexpr std::uint64_t enough_answered = 20;
  std::uint64_t answered_ = 0;  // samples that say so, under the present order
  Time heard_at_{};
  WriterId plant_ = 0;
  std::map<WriterId, std::uint64_t> last_step_;
  std::map<std::uint32_t, Reference> issued_;
  std::map<std::uint32_t, std::uint64_t> lease_ends_;
  std::map<std::uint32_t, std::uint64_t> followed_until_;  // id → the last step at which its lease stood
  std::map<std::string, Said> said_;
  std::vector<std::string> violations_;

  Client client_;
  Reader<Reference> references_;
  Reader<Modulation> modulations_;
  Reader<Health> healths_;
  Reader<Measurement> measurements_;
};

}  // namespace weakgrid::faults
