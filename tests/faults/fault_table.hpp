// What the campaign has found, a row for each kind of fault; printed when the program ends.
#pragma once

#include <map>
#include <string>
#include <vector>

namespace weakgrid::faults {

class FaultTable {
 public:
  static FaultTable& the();
  void add(const std::string& kind, double recovery_s, std::size_t violations);
  std::string text() const;

 private:
  struct Row {
    std::vector<double> recoveries_s;
    std::size_t violations = 0;
  };
  std::map<std::string, Row> rows_;
};

}  // namespace weakgrid::faults
