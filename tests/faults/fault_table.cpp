// FaultTable: see the header.
#include "tests/faults/fault_table.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdio>

namespace weakgrid::faults {

namespace {

class Printer : public testing::Environment {
  void TearDown() override { std::fputs(FaultTable::the().text().c_str(), stdout); }
};
const testing::Environment* const printer = testing::AddGlobalTestEnvironment(new Printer);

std::string line(const std::string& kind, const std::string& count, const std::string& violations,
                 const std::string& median, const std::string& worst) {
  return "| " + kind + " | " + count + " | " + violations + " | " + median + " | " + worst + " |\n";
}

std::string seconds(double s) {
  char text[32];
  std::snprintf(text, sizeof text, "%.2f", s);
  return text;
}

}  // namespace

FaultTable& FaultTable::the() {
  static FaultTable table;
  return table;
}

void FaultTable::add(const std::string& kind, double recovery_s, std::size_t violations) {
  Row& row = rows_[kind];
  row.recoveries_s.push_back(recovery_s);
  row.violations += violations;
}

std::string FaultTable::text() const {
  if (rows_.empty()) return "";
  std::string text =
      line("fault", "count", "violations", "recovery, median, s", "worst, s") + "|---|---|---|---|---|\n";
  std::size_t count = 0, violations = 0;
  double worst = 0.0;
  for (const auto& [kind, row] : rows_) {
    std::vector<double> sorted = row.recoveries_s;
    std::sort(sorted.begin(), sorted.end());
    text += line(kind, std::to_string(sorted.size()), std::to_string(row.violations),
                 seconds(sorted[sorted.size() / 2]), seconds(sorted.back()));
    count += sorted.size();
    violations += row.violations;
    worst = std::max(worst, sorted.back());
  }
  return text + line("all", std::to_string(count), std::to_string(violations), "", seconds(worst));
}

}  // namespace weakgrid::faults
