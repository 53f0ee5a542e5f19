// One unit's services as processes, a recorder beside them and an observer; a fault after the other is
// injected at random phases, each followed by the measure of how long the unit takes to be its own again.
#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <random>
#include <vector>

#include "tests/faults/fault_table.hpp"
#include "tests/faults/unit_watch.hpp"
#include "tests/support/processes_under_test.hpp"

namespace weakgrid::faults {

/// Of the plant: real time, and if somebody asks for a number of faults lockstep too.
std::vector<const char*> paces();
/// How often each kind of fault is injected.
std::uint64_t injections();
/// Of all that is drawn: WEAKGRID_FAULT_SEED, else one of this program's own. Printed.
std::uint64_t fault_seed();

/// A folder of its own for journal and recording; it is left there if the test has failed.
class Folder {
 public:
  Folder();
  ~Folder();
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;
  std::string operator/(const std::string& name) const { return (path_ / name).string(); }
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

struct Surroundings {
  std::string pace = "realtime";
  /// The lines of [dds] for a service, or for the observer ("").
  std::function<std::string(const std::string&)> dds = [](const std::string&) { return std::string(); };
  /// Calls the second at the place that belongs to the first.
  std::function<void(const std::string&, const std::function<void()>&)> at =
      [](const std::string&, const std::function<void()>& start) { start(); };
  /// Where the journal is; none: in a folder of the campaign's own.
  std::string journal = {};
};

class Campaign {
 public:
  explicit Campaign(Surroundings surroundings = {});
  ~Campaign();

  test::Program& operator[](const std::string& service) { return *programs_.at(service); }
  /// One that was killed, or another one under a name of its own; file: its journal or recording, if not the
  /// usual.
  test::Program& start(const std::string& service) { return start_as(service, service); }
  test::Program& start_as(const std::string& name, const std::string& service,
                          const std::optional<std::string>& file = std::nullopt);
  void end(const std::string& name) { programs_.erase(name); }
  /// `second` goes on as `first`, which has ended.
  void takes_the_place(const std::string& second, const std::string& first);

  UnitWatch& watch() { return *watch_; }
  std::mt19937_64& random() { return random_; }
  double uniform(double low, double high) { return std::uniform_real_distribution(low, high)(random_); }
  /// Many short ones, some long: 1 ms … 3 s.
  std::chrono::microseconds some_pause();
  /// Some tenths of a second of the unit's life.
  void wait_for_any_phase();
  static constexpr const char* who = "ann";
  double lease_s() const;
  const std::string& pace() const { return surroundings_.pace; }
  const test::Domain& domain() const { return domain_; }
  const Folder& folder() const { return folder_; }
  const std::string& journal() const { return journal_; }

  /// The unit steps, all say that they are well and a new order is followed.
  bool is_sound();
  /// From now on: how long until it is; into the table, with what was violated since the last one.
  void expect_recovery(const std::string& kind) { expect_recovery(kind, std::chrono::steady_clock::now()); }
  void expect_recovery(const std::string& kind, Time end_of_fault);
  /// Stops all; journal and recording verify, and know every order that the unit has followed.
  void expect_proof();

 private:
  std::string settings(const std::string& service, const std::string& journal) const;
  std::optional<std::uint32_t> ordered();
  /// Seconds until it is sound again; none: it is not.
  std::optional<double> recovery(Time end_of_fault);

  const std::uint64_t seed_;
  std::mt19937_64 random_;
  const Surroundings surroundings_;
  const test::Domain domain_;
  const Folder folder_;
  const std::string journal_;
  std::map<std::string, std::unique_ptr<test::TextFile>> files_;
  std::map<std::string, std::unique_ptr<test::Program>> programs_;
  std::unique_ptr<UnitWatch> watch_;
};

}  // namespace weakgrid::faults
