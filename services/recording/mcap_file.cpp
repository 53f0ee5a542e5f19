// POSIX reads and writes under MCAP, with every return value looked at.
#include "services/recording/mcap_file.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <system_error>
#include <utility>

namespace weakgrid::mcap {

namespace {

// Large enough that reading costs few system calls, small enough for the cache.
constexpr std::uint64_t window_bytes_min = 1 << 20;

Status system_fault(const char* what) { return {Fault::system, errno, what}; }

}  // namespace

bool Status::disk_full() const {
  return fault == Fault::system && (error == ENOSPC || error == EDQUOT || error == EFBIG);
}

std::string Status::text() const {
  if (ok()) return "ok";
  std::string text = what;
  if (fault == Fault::system) text += ": " + std::generic_category().message(error);
  return text;
}

OutputFile::~OutputFile() {
  if (is_open()) ::close(descriptor_);
}

Status OutputFile::create(const std::string& path) {
  if (is_open()) return {Fault::refused, 0, "a file is already open"};
  descriptor_ = ::open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0644);
  if (!is_open()) return system_fault("cannot create the recording");
  torn_ = false;
  size_ = 0;
  return {};
}

Status OutputFile::append(ByteView bytes) {
  if (!is_open()) return {Fault::closed, 0, "no recording is open"};
  if (torn_) return {Fault::system, EIO, "the recording ends in a torn record"};
  std::size_t done = 0;
  while (done < bytes.size()) {
    const ByteView rest = bytes.subspan(done);
    const ssize_t count = ::pwrite(descriptor_, rest.data(), rest.size(), static_cast<off_t>(size_ + done));
    if (count < 0 && errno == EINTR) continue;
    if (count <= 0) {
      const int error = count < 0 ? errno : EIO;
      return done == 0 ? Status{Fault::system, error, "cannot write to the recording"} : take_back(error);
    }
    done += static_cast<std::size_t>(count);
  }
  size_ += bytes.size();
  return {};
}

Status OutputFile::take_back(int error) {
  int result = 0;
  do result = ::ftruncate(descriptor_, static_cast<off_t>(size_));
  while (result != 0 && errno == EINTR);
  torn_ = result != 0;
  return {Fault::system, error, "cannot write to the recording"};
}

Status OutputFile::sync() {
  if (!is_open()) return {Fault::closed, 0, "no recording is open"};
  return ::fdatasync(descriptor_) == 0 ? Status{} : system_fault("cannot sync the recording");
}

Status OutputFile::close() {
  if (!is_open()) return {Fault::closed, 0, "no recording is open"};
  const int descriptor = std::exchange(descriptor_, -1);
  return ::close(descriptor) == 0 ? Status{} : system_fault("cannot close the recording");
}

InputFile::~InputFile() { close(); }

void InputFile::close() {
  if (descriptor_ >= 0) ::close(descriptor_);
  descriptor_ = -1;
  size_ = 0;
  memory_ = {};
  window_bytes_ = 0;
}

Status InputFile::open(const std::string& path) {
  close();
  // Without O_NONBLOCK the open of a pipe would wait for its writer.
  descriptor_ = ::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
  if (descriptor_ < 0) return system_fault("cannot open the recording");
  struct stat about {};
  if (::fstat(descriptor_, &about) != 0) return system_fault("cannot look at the recording");
  if (!S_ISREG(about.st_mode)) {
    close();
    return {Fault::refused, 0, "the recording is not a regular file"};
  }
  size_ = static_cast<std::uint64_t>(about.st_size);
  return {};
}

void InputFile::open(ByteView bytes) {
  close();
  memory_ = bytes;
  size_ = bytes.size();
}

ByteView InputFile::view(std::uint64_t offset, std::uint64_t count) {
  if (offset > size_ || count > size_ - offset) return {};
  const auto bytes = static_cast<std::size_t>(count);
  if (descriptor_ < 0) return memory_.subspan(static_cast<std::size_t>(offset), bytes);
  const bool inside = offset >= window_offset_ && offset - window_offset_ <= window_bytes_ &&
                      bytes <= window_bytes_ - (offset - window_offset_);
  if (!inside && !fill(offset, bytes)) return {};
  return {window_.get() + (offset - window_offset_), bytes};
}

bool InputFile::fill(std::uint64_t offset, std::size_t count) {
  const std::size_t wanted =
      std::max(count, static_cast<std::size_t>(std::min(window_bytes_min, size_ - offset)));
  if (wanted > window_capacity_) {
    window_.reset(new std::byte[wanted]);  // uninitialised on purpose: it is read into at once
    window_capacity_ = wanted;
  }
  window_offset_ = offset;
  window_bytes_ = 0;
  while (window_bytes_ < wanted) {
    const ssize_t got = ::pread(descriptor_, window_.get() + window_bytes_, wanted - window_bytes_,
                                static_cast<off_t>(offset + window_bytes_));
    if (got < 0 && errno == EINTR) continue;
    if (got <= 0) break;  // an error, or the file was cut under us
    window_bytes_ += static_cast<std::size_t>(got);
  }
  return window_bytes_ >= count;
}

}  // namespace weakgrid::mcap
