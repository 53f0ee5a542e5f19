// The supervisor's journal: what was asked, decided, changed and tripped, in a file that only grows and whose
// every line holds the hash of the one before it. Survives kill -9 at once and a power cut as soon as synced.
#pragma once

#include <condition_variable>
#include <cstdint>
#include <mutex>
#include <string>
#include <string_view>
#include <thread>

#include "services/journal/journal_reader.hpp"

namespace weakgrid {

/// From any thread. An append costs some 10 µs and one write(2), which may wait for a busy disk: keep it off
/// a control loop.
class Journal {
 public:
  /// Creates the file or goes on with it: checks all that is there, sets a torn last line aside and says so
  /// in an entry "recovered". Throws SettingsError if the file is no journal or its chain is broken, which
  /// changes nothing, and std::runtime_error if it cannot be opened, locked, written or synced.
  explicit Journal(const std::string& path);
  /// What was appended is on disk afterwards, if the disk does as asked.
  ~Journal();
  Journal(const Journal&) = delete;
  Journal& operator=(const Journal&) = delete;

  /// Once it returns true, a kill -9 loses nothing. False: not written, see fault(), and the file is as
  /// before; the next append that works is preceded by an entry "lost" with the count. What a body may be and
  /// what becomes of NaN: journal_line().
  [[nodiscard]] bool append(std::string_view kind, nlohmann::json body);

  /// Waits until all that was appended is on disk; false: the disk has failed once, which leaves what it
  /// holds unknown until the file is opened anew.
  [[nodiscard]] bool sync();
  /// Entries that a power cut may take.
  std::uint64_t unsynced() const;

  std::uint64_t entries() const;  ///< in the file
  std::uint64_t refused() const;  ///< appends that returned false
  std::string head() const;       ///< the hash of the last entry
  /// Why the last append was refused, or that the disk cannot be synced; empty: all is well.
  std::string fault() const;

 private:
  struct Descriptor {
    int number = -1;
    ~Descriptor();
  };
  void open_locked();
  void check_and_recover();
  void set_aside(std::uint64_t from);
  bool tell_what_is_lost(std::string_view kind, const nlohmann::json& body);
  bool write_entry(std::string_view kind, nlohmann::json body);
  bool write_line(const std::string& bytes);
  bool is_as_left();
  bool refuse(std::string reason);
  void sync_in_background();

  std::string path_;
  Descriptor file_;

  mutable std::mutex append_mutex_;  // held over the write: lines stand in the order of their numbers
  std::uint64_t entries_ = 0, size_ = 0, refused_ = 0, lost_ = 0;
  std::string head_ = journal_beginning(), append_fault_;
  bool has_remainder_ = false;  // of a write that came back short and could not be undone

  mutable std::mutex sync_mutex_;
  std::condition_variable work_, done_;
  std::uint64_t written_ = 0, tried_ = 0, synced_ = 0;  // entries of this process
  int sync_error_ = 0;
  bool stopping_ = false;
  std::thread thread_;
};

}  // namespace weakgrid
