// Journal reader: see the header.
#include "services/journal/journal_reader.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <system_error>
#include <thread>
#include <vector>

namespace weakgrid {

const char* name(JournalFaultKind kind) {
  switch (kind) {
    case JournalFaultKind::malformed:
      return "malformed";
    case JournalFaultKind::hash:
      return "hash";
    case JournalFaultKind::number:
      return "number";
    case JournalFaultKind::previous:
      return "previous";
    case JournalFaultKind::too_long:
      return "too_long";
    case JournalFaultKind::torn:
      return "torn";
  }
  return "";
}

std::string JournalVerdict::text() const {
  if (intact()) return fmt::format("intact: {} entries, {} bytes", entries, bytes);
  return fmt::format("line {}, byte {}: {}", fault->line, fault->offset, fault->text);
}

void JournalScan::feed(std::string_view bytes) {
  while (!bytes.empty()) {
    const std::size_t end = bytes.find('\n');
    add(bytes.substr(0, end));
    if (end == std::string_view::npos) return;
    end_line();
    bytes.remove_prefix(end + 1);
  }
}

void JournalScan::add(std::string_view part) {
  line_bytes_ += part.size();
  line_.append(part.substr(0, journal_line_bytes_max - std::min(journal_line_bytes_max, line_.size())));
}

void JournalScan::find_fault(JournalFaultKind kind, std::string text) {
  if (verdict_.fault) return;
  verdict_.fault = {kind, line_number_, line_offset_, std::move(text)};
  // Of a line damaged at one place, one of the two ends is still ours; of nothing but zeros, after a power
  // cut, nobody can tell.
  const bool is_zeros = line_.find_first_not_of('\0') == std::string::npos;
  verdict_.is_journal = verdict_.entries > 0 || begins_like_journal(line_) || ends_like_journal(line_) ||
                        (kind == JournalFaultKind::torn && is_zeros);
}

std::optional<JournalEntry> JournalScan::check(std::string_view line) {
  if (line_bytes_ >= journal_line_bytes_max) {
    find_fault(JournalFaultKind::too_long,
               fmt::format("{} bytes long, at most {} are allowed", line_bytes_ + 1, journal_line_bytes_max));
    return std::nullopt;
  }
  if (!ends_like_journal(line)) {
    find_fault(JournalFaultKind::malformed, "not a line of a journal: it does not end with a hash");
  } else if (!journal_hash_holds(line)) {
    find_fault(JournalFaultKind::hash, "its hash differs: the line was changed");
  }
  auto entry = parse_journal_line(line);
  if (!entry) {
    find_fault(JournalFaultKind::malformed,
               "not a line of a journal: JSON with n, time, kind, body, previous");
  } else if (entry->n != verdict_.entries + 1) {
    find_fault(JournalFaultKind::number,
               fmt::format("its n is {}, {} would follow: lines are missing, repeated or moved", entry->n,
                           verdict_.entries + 1));
  } else if (entry->previous != verdict_.head) {
    find_fault(JournalFaultKind::previous, "it does not follow the line before it: the hashes differ");
  }
  return entry;
}

void JournalScan::end_line() {
  const auto entry = check(line_);
  if (!verdict_.fault) {
    ++verdict_.entries;
    verdict_.bytes = line_offset_ + line_bytes_ + 1;
    verdict_.head = entry->hash;
  }
  if (entry && visitor_) visitor_(*entry, {line_number_, line_offset_, !verdict_.fault, line_});
  line_offset_ += line_bytes_ + 1;
  ++line_number_;
  line_bytes_ = 0;
  line_.clear();
}

JournalVerdict JournalScan::finish() {
  if (is_in_line())
    find_fault(JournalFaultKind::torn,
               fmt::format("a torn last line: {} bytes without a newline", line_bytes_));
  return verdict_;
}

JournalVerdict read_journal(int file, const JournalVisitor& visitor, std::chrono::milliseconds patience) {
  constexpr std::chrono::milliseconds between_looks{10};
  // What is there now: nobody catches up with a writer who never rests.
  struct stat about {};
  const bool has_size = fstat(file, &about) == 0 && S_ISREG(about.st_mode);
  std::uint64_t left = has_size ? static_cast<std::uint64_t>(about.st_size) : ~std::uint64_t{0};
  JournalScan scan(visitor);
  std::vector<char> buffer(1 << 16);
  while (left > 0 || scan.is_in_line()) {
    const ssize_t count = read(file, buffer.data(), buffer.size());
    if (count < 0 && errno == EINTR) continue;
    if (count < 0) throw std::system_error(errno, std::generic_category(), "cannot be read");
    if (count == 0) {
      if (!scan.is_in_line() || patience.count() <= 0) break;
      std::this_thread::sleep_for(between_looks);
      patience -= between_looks;
      continue;
    }
    std::string_view bytes(buffer.data(), static_cast<std::size_t>(count));
    if (bytes.size() >= left) {
      // And the rest of the line that was being written.
      const std::size_t end = bytes.find('\n', left > 0 ? left - 1 : 0);
      bytes = bytes.substr(0, end == std::string_view::npos ? end : end + 1);
    }
    left -= std::min<std::uint64_t>(left, bytes.size());
    scan.feed(bytes);
  }
  return scan.finish();
}

JournalVerdict read_journal(const std::string& path, const JournalVisitor& visitor,
                            std::chrono::milliseconds patience) {
  const int file = open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (file < 0) throw std::system_error(errno, std::generic_category(), path + ": cannot be read");
  struct Closed {
    int file;
    ~Closed() { close(file); }
  } const closed{file};
  try {
    return read_journal(file, visitor, patience);
  } catch (const std::system_error& error) {
    throw std::system_error(error.code(), path + ": cannot be read");
  }
}

}  // namespace weakgrid
