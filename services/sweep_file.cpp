// SweepFile: see the header.
#include "services/sweep_file.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cstdio>
#include <cstring>
#include <stdexcept>
#include <utility>

#include "services/csv_text.hpp"

namespace weakgrid {

namespace {

constexpr std::size_t block_bytes = 1 << 20;
constexpr std::string_view mark = "# weakgrid sweep";

std::string_view line_at(std::string_view text, std::size_t from) {
  return text.substr(from, text.find('\n', from) - from);
}

}  // namespace

SweepFile::SweepFile(const std::string& path, const SweepPlan& plan, const std::string& version,
                     const std::vector<std::string>& columns)
    : path_(path), plan_(plan), head_(fmt::format("{}, weakgrid {}\n", mark, version)) {
  for (const std::string& line : plan.identity()) head_ += "# " + line + "\n";
  head_ += "run";
  for (const Axis& axis : plan.axes()) (head_ += ',') += axis.key;
  for (const std::string& column : columns) (head_ += ',') += column;
  head_ += '\n';
  rows_.resize(plan.runs());
  try {
    open();
    read();
  } catch (...) {
    if (file_ >= 0) close(file_);
    throw;
  }
}

SweepFile::~SweepFile() { close(file_); }

void SweepFile::fail(const std::string& what) const {
  throw std::runtime_error(fmt::format("{}: {}: {}", path_, what, std::strerror(errno)));
}

void SweepFile::open() {
  // Never waits, whatever it is: a pipe would.
  file_ = ::open(path_.c_str(), O_RDWR | O_CREAT | O_APPEND | O_CLOEXEC | O_NONBLOCK, 0644);
  if (file_ < 0) fail("cannot be opened for writing");
  struct stat about {};
  if (fstat(file_, &about) != 0) fail("cannot be read");
  if (!S_ISREG(about.st_mode)) throw SettingsError(path_ + ": is not a file; a sweep needs one");
  if (flock(file_, LOCK_EX | LOCK_NB) != 0) {
    if (errno != EWOULDBLOCK) fail("cannot be locked");
    throw std::runtime_error(path_ + ": another sweep writes this file; only one can");
  }
  size_ = static_cast<std::uint64_t>(about.st_size);
}

void SweepFile::read() {
  const std::string there = bytes_at(0, std::min<std::uint64_t>(size_, head_.size()));
  if (!head_.starts_with(there)) of_another_sweep(there);
  if (size_ >= head_.size()) return read_rows();
  // New, or killed before its head was whole.
  if (ftruncate(file_, 0) != 0) fail("cannot be emptied");
  write(file_, head_);
  size_ = head_.size();
}

void SweepFile::of_another_sweep(std::string_view there) const {
  if (!there.starts_with(mark.substr(0, there.size())))
    throw SettingsError(path_ + ": is there and no sweep's; name another file");
  std::size_t from = 0;
  while (line_at(there, from) == line_at(head_, from)) from += line_at(head_, from).size() + 1;
  throw SettingsError(fmt::format(
      "{}: is of another sweep: it has '{}' where this one has '{}'; name another file, or move it "
      "away to begin anew",
      path_, line_at(there, from), line_at(head_, from)));
}

void SweepFile::read_rows() {
  std::string text;
  std::uint64_t offset = head_.size();  // of text
  auto number = static_cast<std::uint64_t>(std::count(head_.begin(), head_.end(), '\n'));
  for (std::uint64_t read = offset; read < size_;) {
    const std::uint64_t count = std::min<std::uint64_t>(block_bytes, size_ - read);
    text += bytes_at(read, count);
    read += count;
    std::size_t from = 0;
    for (std::size_t end; (end = text.find('\n', from)) != text.npos; from = end + 1)
      take(std::string_view(text).substr(from, end + 1 - from), offset + from, ++number);
    text.erase(0, from);
    offset += from;
  }
  if (text.empty()) return;
  // A line that a kill has torn.
  if (ftruncate(file_, static_cast<off_t>(offset)) != 0) fail("cannot be cut");
  size_ = offset;
}

void SweepFile::take(std::string_view line, std::uint64_t offset, std::uint64_t number) {
  std::uint64_t n = 0;
  const auto [end, error] = std::from_chars(line.data(), line.data() + line.size(), n);
  if (error != std::errc{} || n >= rows_.size() || has(n) || !line.starts_with(row_head(n)))
    throw SettingsError(
        fmt::format("{}:{}: no row of this sweep; something else has changed the file: move it "
                    "away to begin anew",
                    path_, number));
  rows_[n] = {offset, static_cast<std::uint32_t>(line.size())};
  in_order_ = in_order_ && newest_ <= n;
  newest_ = n;
  ++done_;
}

std::string SweepFile::row_head(std::uint64_t n) const {
  std::string text = std::to_string(n);
  for (const std::string& value : plan_.values(n)) put_csv_text(text += ',', value);
  return text += ',';
}

void SweepFile::append(std::uint64_t n, const std::string& cells) {
  if (is_torn_) throw std::runtime_error(path_ + ": ends in a torn line");
  const std::string line = row_head(n) + cells + '\n';
  try {
    write(file_, line);
  } catch (...) {
    // Half a line may not be followed by another.
    is_torn_ = ftruncate(file_, static_cast<off_t>(size_)) != 0;
    throw;
  }
  rows_[n] = {size_, static_cast<std::uint32_t>(line.size())};
  size_ += line.size();
  in_order_ = in_order_ && newest_ <= n;
  newest_ = n;
  ++done_;
}

std::string SweepFile::cells(std::uint64_t n) const {
  const std::size_t head = row_head(n).size();
  return bytes_at(rows_[n].offset + head, rows_[n].bytes - head - 1);
}

void SweepFile::finish() {
  if (done_ < rows_.size() || in_order_) return;
  const std::string sorted = path_ + ".sorted";
  const int to = ::open(sorted.c_str(), O_RDWR | O_CREAT | O_TRUNC | O_CLOEXEC, 0644);
  if (to < 0) fail("cannot be put in order");
  try {
    std::string text = head_;
    for (const Row& row : rows_) {
      text += bytes_at(row.offset, row.bytes);
      if (text.size() < block_bytes) continue;
      write(to, text);
      text.clear();
    }
    write(to, text);
    if (fdatasync(to) != 0 || std::rename(sorted.c_str(), path_.c_str()) != 0) fail("cannot be put in order");
  } catch (...) {
    close(to);
    unlink(sorted.c_str());
    throw;
  }
  close(std::exchange(file_, to));
  std::uint64_t offset = head_.size();
  for (Row& row : rows_) {
    row.offset = offset;
    offset += row.bytes;
  }
  in_order_ = true;
}

void SweepFile::write(int file, std::string_view bytes) const {
  while (!bytes.empty()) {
    const ssize_t count = ::write(file, bytes.data(), bytes.size());
    if (count < 0 && errno == EINTR) continue;
    if (count <= 0) fail("cannot be written");
    bytes.remove_prefix(static_cast<std::size_t>(count));
  }
}

std::string SweepFile::bytes_at(std::uint64_t offset, std::uint64_t count) const {
  std::string bytes(count, '\0');
  for (std::size_t done = 0; done < count;) {
    const ssize_t read = pread(file_, bytes.data() + done, count - done, static_cast<off_t>(offset + done));
    if (read < 0 && errno == EINTR) continue;
    if (read < 0) fail("cannot be read");
    if (read == 0) throw std::runtime_error(path_ + ": has become shorter under this sweep");
    done += static_cast<std::size_t>(read);
  }
  return bytes;
}

}  // namespace weakgrid
