// Makes what is in a file survive a power cut, beside whoever writes it: a disk may take seconds over it.
#pragma once

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <condition_variable>
#include <mutex>
#include <string>
#include <thread>
#include <utility>

namespace weakgrid {

class DiskSync {
 public:
  DiskSync() : thread_([this] { run(); }) {}
  ~DiskSync() {
    {
      const std::lock_guard lock(mutex_);
      stopping_ = true;
    }
    work_.notify_one();
    thread_.join();
  }
  DiskSync(const DiskSync&) = delete;
  DiskSync& operator=(const DiskSync&) = delete;

  /// Soon, what is in the file by then; a request that is still under way covers this one.
  void request(const std::string& path) {
    {
      const std::lock_guard lock(mutex_);
      path_ = path;
    }
    work_.notify_one();
  }
  /// The errno of the last attempt that failed, 0 = none; asked once.
  int take_error() {
    const std::lock_guard lock(mutex_);
    return std::exchange(error_, 0);
  }

 private:
  void run() {
    std::unique_lock lock(mutex_);
    while (true) {
      work_.wait(lock, [this] { return stopping_ || !path_.empty(); });
      if (stopping_) return;
      const std::string path = std::exchange(path_, {});
      lock.unlock();
      const int error = sync(path);
      lock.lock();
      if (error != 0) error_ = error;
    }
  }
  // Any descriptor of the file will do.
  static int sync(const std::string& path) {
    const int descriptor = open(path.c_str(), O_RDONLY | O_CLOEXEC);
    if (descriptor < 0) return errno;
    const int error = fdatasync(descriptor) == 0 ? 0 : errno;
    close(descriptor);
    return error;
  }

  std::mutex mutex_;
  std::condition_variable work_;
  std::string path_;
  int error_ = 0;
  bool stopping_ = false;
  std::thread thread_;
};

}  // namespace weakgrid
