// The CSV file of a sweep: a head that says which sweep it is, and a row for each run. Rows are appended as
// runs end, in any order, so a kill -9 loses only what was under way; once all are there the file is put in
// order, whole or not at all. So it is the same, byte by byte, however often and by how many threads it was
// made.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "services/sweep_plan.hpp"

namespace weakgrid {

/// Not thread-safe.
class SweepFile {
 public:
  /// Opens or makes the file and reads which runs are there; a torn last line is dropped. `version` is that
  /// of the program, `columns` are those beside run and axes. Throws SettingsError if the file is none or of
  /// another sweep, std::runtime_error if it cannot be opened or another process writes it.
  SweepFile(const std::string& path, const SweepPlan& plan, const std::string& version,
            const std::vector<std::string>& columns);
  ~SweepFile();
  SweepFile(const SweepFile&) = delete;
  SweepFile& operator=(const SweepFile&) = delete;

  bool has(std::uint64_t n) const { return rows_[n].bytes != 0; }
  std::uint64_t done() const { return done_; }
  /// `cells` are those of `columns`, joined. Once it returns a kill loses them no more. Throws
  /// std::runtime_error, and the file is as if it had not been tried.
  void append(std::uint64_t n, const std::string& cells);
  /// Puts the rows in the order of runs, if all are there and it is not so already.
  void finish();
  /// What append() was given for a run that is there.
  std::string cells(std::uint64_t n) const;

 private:
  struct Row {
    std::uint64_t offset = 0;
    std::uint32_t bytes = 0;  // with the line's end; 0: not there
  };
  void open();
  void read();
  void read_rows();
  std::string row_head(std::uint64_t n) const;
  void write(int file, std::string_view bytes) const;
  std::string bytes_at(std::uint64_t offset, std::uint64_t count) const;
  void take(std::string_view line, std::uint64_t offset, std::uint64_t number);
  [[noreturn]] void of_another_sweep(std::string_view there) const;
  [[noreturn]] void fail(const std::string& what) const;

  const std::string path_;
  const SweepPlan& plan_;
  std::string head_;
  int file_ = -1;
  std::uint64_t size_ = 0, done_ = 0;
  bool is_torn_ = false;
  bool in_order_ = true;
  std::uint64_t newest_ = 0;  // run of the last row
  std::vector<Row> rows_;
};

}  // namespace weakgrid
