// One thread of another process that stands still while the others go on, as if what it waits for never came.
#pragma once

#include <sys/types.h>

#include <string>

namespace weakgrid::test {

/// Stops it as a debugger does; it goes on when this ends. Made and ended by the same thread, and ended
/// before the process is killed. Throws std::runtime_error where that cannot be.
class HeldThread {
 public:
  enum class Where { anywhere, sending };  ///< sending: about to send to a socket
  HeldThread(pid_t thread, Where where = Where::anywhere);
  ~HeldThread();
  HeldThread(const HeldThread&) = delete;
  HeldThread& operator=(const HeldThread&) = delete;

 private:
  pid_t thread_;
};

/// The thread of this name.
pid_t thread_named(pid_t process, const std::string& name);
/// The one, beside the first, that computes most from now on, for 0.3 s: what has computed most by now may
/// have done so at the start.
pid_t busiest_thread(pid_t process);

}  // namespace weakgrid::test
