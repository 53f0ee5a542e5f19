// Journal: see the header.
#include "services/journal/journal.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <filesystem>
#include <stdexcept>

#include "services/runtime/settings.hpp"

namespace weakgrid {

namespace {

[[noreturn]] void fail(const std::string& path, const std::string& what) {
  throw std::runtime_error(fmt::format("{}: {}: {}", path, what, std::strerror(errno)));
}

void sync_folder_of(const std::string& path) {
  const auto parent = std::filesystem::path(path).parent_path();
  const std::string folder = parent.empty() ? "." : parent.string();
  const int file = open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  const bool is_synced = file >= 0 && fsync(file) == 0;
  const int error = errno;
  if (file >= 0) close(file);
  errno = error;
  if (!is_synced) fail(folder, "the folder cannot be synced");
}

std::uint64_t now_ns() {
  const auto now = std::chrono::system_clock::now().time_since_epoch();
  return static_cast<std::uint64_t>(std::chrono::duration_cast<std::chrono::nanoseconds>(now).count());
}

std::string no_entry(std::string_view kind) {
  return fmt::format(
      "not an entry: kind '{}' must be 1 to 64 of a-z 0-9 _ -, the body an object of at most {} levels, the "
      "line "
      "of at most {} bytes",
      kind.substr(0, 64), journal_depth_max, journal_line_bytes_max);
}

// A copy of what stands in `from` from the offset on; -1 and errno if it cannot be made.
std::int64_t copy_tail(int from, std::uint64_t offset, int to) {
  std::array<char, 1 << 16> buffer;
  std::int64_t copied = 0;
  while (true) {
    const ssize_t count = pread(from, buffer.data(), buffer.size(), static_cast<off_t>(offset));
    if (count <= 0) return count < 0 ? -1 : copied;
    for (ssize_t done = 0; done < count;) {
      const ssize_t written = write(to, buffer.data() + done, static_cast<std::size_t>(count - done));
      if (written < 0) return -1;
      done += written;
    }
    offset += static_cast<std::uint64_t>(count);
    copied += count;
  }
}

}  // namespace

Journal::Descriptor::~Descriptor() {
  if (number >= 0) close(number);
}

Journal::Journal(const std::string& path) : path_(path) {
  open_locked();
  check_and_recover();
  // A process that was killed may have left lines that are only in memory yet.
  if (fdatasync(file_.number) != 0) fail(path_, "cannot be synced");
  thread_ = std::thread([this] { sync_in_background(); });
}

Journal::~Journal() {
  {
    const std::lock_guard lock(sync_mutex_);
    stopping_ = true;
  }
  work_.notify_one();
  thread_.join();
}

void Journal::open_locked() {
  // Never waits, whatever it is: a pipe would.
  file_.number = open(path_.c_str(), O_RDWR | O_CREAT | O_APPEND | O_CLOEXEC | O_NONBLOCK, 0640);
  if (file_.number < 0) fail(path_, "the journal cannot be opened for writing");
  struct stat about {};
  if (fstat(file_.number, &about) != 0) fail(path_, "cannot be read");
  if (!S_ISREG(about.st_mode)) throw SettingsError(path_ + ": is not a file; a journal must be one");
  if (flock(file_.number, LOCK_EX | LOCK_NB) != 0) {
    if (errno != EWOULDBLOCK) fail(path_, "cannot be locked");
    throw std::runtime_error(path_ + ": another process writes this journal; only one can");
  }
  sync_folder_of(path_);
}

void Journal::check_and_recover() {
  JournalVerdict verdict;
  try {
    verdict = read_journal(file_.number);
  } catch (const std::system_error& error) {
    throw std::runtime_error(path_ + ": " + error.what());
  }
  if (!verdict.is_journal) throw SettingsError(fmt::format("{}: is not a journal; name another file", path_));
  const bool is_torn = verdict.fault && verdict.fault->kind == JournalFaultKind::torn;
  if (verdict.fault && !is_torn)
    throw SettingsError(fmt::format(
        "{}: {}; nothing is appended to a broken journal: keep it, and move it away to begin a new one",
        path_, verdict.text()));
  entries_ = verdict.entries;
  size_ = verdict.bytes;
  head_ = verdict.head;
  if (is_torn) set_aside(verdict.bytes);
}

void Journal::set_aside(std::uint64_t from) {
  std::string aside;
  Descriptor copy;
  for (unsigned n = 1; copy.number < 0; ++n) {
    aside = fmt::format("{}.torn-{}", path_, n);
    copy.number = open(aside.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0640);
    if (copy.number < 0 && errno != EEXIST) fail(aside, "cannot be made for a torn last line");
  }
  const std::int64_t bytes = copy_tail(file_.number, from, copy.number);
  if (bytes < 0 || fsync(copy.number) != 0) {
    const int error = errno;
    unlink(aside.c_str());
    errno = error;
    fail(aside, "a torn last line cannot be kept");
  }
  sync_folder_of(path_);
  if (ftruncate(file_.number, static_cast<off_t>(from)) != 0)
    fail(path_, "a torn last line cannot be cut off");
  const std::string name = std::filesystem::path(aside).filename().string();
  const std::string text = fmt::format("a torn last line of {} bytes was set aside in {}", bytes, name);
  if (!write_entry("recovered", {{"bytes", bytes}, {"set_aside", name}, {"text", text}}))
    throw std::runtime_error(path_ + ": " + append_fault_);
}

bool Journal::append(std::string_view kind, nlohmann::json body) {
  std::uint64_t before = 0, after = 0;
  bool is_written = false;
  {
    const std::lock_guard lock(append_mutex_);
    before = entries_;
    is_written = tell_what_is_lost(kind, body) && write_entry(kind, std::move(body));
    if (is_written) append_fault_.clear();
    after = entries_;
    if (!is_written) {
      ++refused_;
      ++lost_;
    }
  }
  if (after != before) {
    const std::lock_guard lock(sync_mutex_);
    written_ += after - before;
    work_.notify_one();
  }
  return is_written;
}

// True: nothing is, or it is told now. Only before an entry that can follow: else the same gap would be told
// again and again.
bool Journal::tell_what_is_lost(std::string_view kind, const nlohmann::json& body) {
  if (lost_ == 0) return true;
  if (!journal_line(entries_ + 2, now_ns(), kind, body, head_)) return refuse(no_entry(kind));
  const std::string text =
      fmt::format("{} entries before this one could not be written: {}", lost_, append_fault_);
  if (!write_entry("lost", {{"entries", lost_}, {"text", text}})) return false;
  lost_ = 0;
  return true;
}

bool Journal::write_entry(std::string_view kind, nlohmann::json body) {
  const auto line = journal_line(entries_ + 1, now_ns(), kind, std::move(body), head_);
  if (!line) return refuse(no_entry(kind));
  if (!is_as_left() || !write_line(line->bytes)) return false;
  ++entries_;
  size_ += line->bytes.size();
  head_ = line->hash;
  return true;
}

// Whoever wrote, cut or removed the file meanwhile did not take the lock: a line behind that would only look
// as if it were kept.
bool Journal::is_as_left() {
  if (has_remainder_ && ftruncate(file_.number, static_cast<off_t>(size_)) == 0) has_remainder_ = false;
  struct stat about {};
  if (has_remainder_ || fstat(file_.number, &about) != 0) return refuse(std::strerror(errno));
  if (about.st_nlink == 0) return refuse("the file was removed");
  if (about.st_size != static_cast<off_t>(size_))
    return refuse(
        fmt::format("somebody else changed the file: {} bytes instead of {}", about.st_size, size_));
  return true;
}

bool Journal::write_line(const std::string& bytes) {
  ssize_t written = 0;
  do {
    written = write(file_.number, bytes.data(), bytes.size());
  } while (written < 0 && errno == EINTR);
  if (written == static_cast<ssize_t>(bytes.size())) return true;
  refuse(written < 0 ? std::strerror(errno) : "the disk is full: the line was written in part, and cut off");
  if (written > 0) has_remainder_ = ftruncate(file_.number, static_cast<off_t>(size_)) != 0;
  return false;
}

bool Journal::refuse(std::string reason) {
  append_fault_ = std::move(reason);
  return false;
}

void Journal::sync_in_background() {
  std::unique_lock lock(sync_mutex_);
  while (true) {
    work_.wait(lock, [this] { return stopping_ || tried_ < written_; });
    if (tried_ == written_) return;
    const std::uint64_t covered = written_;
    lock.unlock();
    const int error = fdatasync(file_.number) == 0 ? 0 : errno;
    lock.lock();
    tried_ = covered;
    // The kernel reports a page that could not be written once, and calls it clean: no later success counts.
    if (error != 0) sync_error_ = error;
    if (sync_error_ == 0) synced_ = covered;
    done_.notify_all();
  }
}

bool Journal::sync() {
  std::unique_lock lock(sync_mutex_);
  const std::uint64_t until = written_;
  done_.wait(lock, [&] { return sync_error_ != 0 || synced_ >= until; });
  return sync_error_ == 0;
}

std::uint64_t Journal::unsynced() const {
  const std::lock_guard lock(sync_mutex_);
  return written_ - synced_;
}

std::uint64_t Journal::entries() const {
  const std::lock_guard lock(append_mutex_);
  return entries_;
}

std::uint64_t Journal::refused() const {
  const std::lock_guard lock(append_mutex_);
  return refused_;
}

std::string Journal::head() const {
  const std::lock_guard lock(append_mutex_);
  return head_;
}

std::string Journal::fault() const {
  {
    const std::lock_guard lock(append_mutex_);
    if (!append_fault_.empty()) return append_fault_;
  }
  const std::lock_guard lock(sync_mutex_);
  return sync_error_ == 0 ? std::string() : fmt::format("cannot be synced: {}", std::strerror(sync_error_));
}

}  // namespace weakgrid
