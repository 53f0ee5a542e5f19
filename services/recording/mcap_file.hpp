// The two files under MCAP: one that only grows by whole records, one that is read in windows. POSIX lives
// here.
#pragma once

#include <memory>
#include <string>

#include "services/recording/mcap_format.hpp"
#include "services/recording/mcap_status.hpp"

namespace weakgrid::mcap {

/// Everything in the file was appended whole: a write that fails half-way is taken back by truncation.
class OutputFile {
 public:
  OutputFile() = default;
  ~OutputFile();
  OutputFile(const OutputFile&) = delete;
  OutputFile& operator=(const OutputFile&) = delete;

  /// Never overwrites: an existing path is a system fault, EEXIST.
  Status create(const std::string& path);
  /// One write() unless the system cuts it short. On a fault the file ends where it ended before; if even
  /// that fails, every later append is refused, because what follows a torn record cannot be read.
  Status append(ByteView bytes);
  Status sync();
  Status close();  ///< also when it fails the descriptor is gone

  bool is_open() const { return descriptor_ >= 0; }
  std::uint64_t size() const { return size_; }

 private:
  Status take_back(int error);

  int descriptor_ = -1;
  bool torn_ = false;
  std::uint64_t size_ = 0;
};

/// A file, or bytes in memory that look like one.
class InputFile {
 public:
  InputFile() = default;
  ~InputFile();
  InputFile(const InputFile&) = delete;
  InputFile& operator=(const InputFile&) = delete;

  Status open(const std::string& path);  ///< regular files only; the size is taken now
  void open(ByteView bytes);             ///< `bytes` must outlive the reading

  std::uint64_t size() const { return size_; }
  /// `count` bytes from `offset`, nothing if they are not all there. Holds until the next call. Allocates no
  /// more than the file holds.
  ByteView view(std::uint64_t offset, std::uint64_t count);

 private:
  void close();
  bool fill(std::uint64_t offset, std::size_t count);

  int descriptor_ = -1;
  std::uint64_t size_ = 0;
  ByteView memory_;
  std::unique_ptr<std::byte[]> window_;
  std::size_t window_capacity_ = 0;
  std::uint64_t window_offset_ = 0;
  std::size_t window_bytes_ = 0;
};

}  // namespace weakgrid::mcap
