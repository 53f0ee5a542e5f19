// The gateway's journal in a run: the real file, and what ought to be in it after a kill or a power cut.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "services/gateway_memory.hpp"
#include "tests/deterministic/judge.hpp"

namespace weakgrid::deterministic {

class KeptJournal {
 public:
  /// Of one run; the file is removed with it.
  explicit KeptJournal(std::uint64_t seed);
  ~KeptJournal();
  KeptJournal(const KeptJournal&) = delete;
  KeptJournal& operator=(const KeptJournal&) = delete;

  /// As the program opens it at its start, and reads what it tells. Checks that it holds what it must.
  GatewayMemory open();
  void keep(std::string_view kind, const nlohmann::json& body, Time now);
  /// late: entries are appended by flush() only, as a gateway would that answers first.
  void be_late() { is_late_ = true; }
  void flush();
  /// A decision has been heard of.
  void see_told(const Decision& decision);
  void see_issued(const Reference& reference);
  /// Kill -9: what was appended is there.
  void close();
  /// What was not synced may be gone, the last line torn; entries older than sync_max are on disk.
  void cut_power(Dice& dice, Time now);

  const std::optional<Reference>& last_order() const { return last_order_; }

 private:
  static constexpr nanoseconds sync_max = 50ms;
  struct Entry {
    std::string kind, body;
    std::uint64_t end = 0;  // in the file
    Time kept;
  };
  struct Told {
    std::string decision;
    std::size_t entries;  // kept by then
  };
  void append(const Entry& entry, const nlohmann::json& body);
  void check() const;

  const std::string path_;
  std::unique_ptr<Journal> journal_;
  std::vector<Entry> entries_;
  std::vector<std::pair<Entry, nlohmann::json>> late_;
  bool is_late_ = false;
  std::vector<Told> told_;
  std::map<std::uint32_t, Reference> issued_;
  std::optional<Reference> last_order_;
};

}  // namespace weakgrid::deterministic
