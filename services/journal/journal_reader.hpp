// Reads a journal from its beginning, entry by entry, and says whether the chain holds. Memory is bounded by
// one line.
#pragma once

#include <chrono>
#include <functional>

#include "services/journal/journal_line.hpp"

namespace weakgrid {

enum class JournalFaultKind {
  malformed,  ///< not a line of a journal
  hash,       ///< was changed
  number,     ///< a line before it is missing, or lines changed places
  previous,   ///< does not follow the line before it
  too_long,
  torn  ///< the last line has no end: a crash in the middle of a write
};
const char* name(JournalFaultKind kind);

struct JournalFault {
  JournalFaultKind kind;
  std::uint64_t line;    ///< from 1
  std::uint64_t offset;  ///< of its first byte, from 0
  std::string text;
};

struct JournalVerdict {
  std::uint64_t entries = 0;  ///< before the first fault
  std::uint64_t bytes = 0;    ///< that they take
  std::string head = journal_beginning();
  std::optional<JournalFault> fault;  ///< the first
  /// False: begins and ends like something else, and there is a fault.
  bool is_journal = true;

  bool intact() const { return !fault; }
  /// "line 3, byte 512: …", or that it is intact.
  std::string text() const;
};

struct JournalPlace {
  std::uint64_t line, offset;
  bool is_verified;          ///< no fault up to here
  std::string_view as_read;  ///< the line without its newline, as long as the visitor has it
};
/// Sees every line that is an entry, also behind a fault.
using JournalVisitor = std::function<void(const JournalEntry&, const JournalPlace&)>;

/// The bytes of a journal, in pieces of any size.
class JournalScan {
 public:
  explicit JournalScan(JournalVisitor visitor = {}) : visitor_(std::move(visitor)) {}
  void feed(std::string_view bytes);
  /// There are no more bytes.
  JournalVerdict finish();
  /// Bytes after the last newline.
  bool is_in_line() const { return line_bytes_ > 0; }

 private:
  void add(std::string_view part);
  void end_line();
  void find_fault(JournalFaultKind kind, std::string text);
  std::optional<JournalEntry> check(std::string_view line);

  JournalVisitor visitor_;
  JournalVerdict verdict_;
  std::string line_;  // what is there of a line that is not whole yet, up to the longest allowed
  std::uint64_t line_number_ = 1, line_offset_ = 0, line_bytes_ = 0;
};

/// What is in the file at the beginning of the call, whole lines. `patience`: how long to wait at its end for
/// the rest of a line that somebody writes just now. Throws std::system_error if the file cannot be read.
JournalVerdict read_journal(const std::string& path, const JournalVisitor& visitor = {},
                            std::chrono::milliseconds patience = {});
/// From an open file's beginning.
JournalVerdict read_journal(int file, const JournalVisitor& visitor = {},
                            std::chrono::milliseconds patience = {});

}  // namespace weakgrid
