// How messages travel between simulated processes: best effort is lost, delayed, doubled and reordered;
// reliable is only delayed. Who is stopped takes what has come when it goes on; who is dead takes nothing.
#pragma once

#include <map>
#include <memory>
#include <utility>

#include "services/runtime/one_writer.hpp"
#include "tests/deterministic/scheduler.hpp"

namespace weakgrid::deterministic {

/// One start of a program; never destroyed before the run ends.
struct Process {
  Process(WriterId is, const char* does) : id(is), service(does) {}
  virtual ~Process() = default;

  const WriterId id;
  const char* const service;
  bool runs = true;
  Time joined{};              ///< has found its peers, and they it
  Time gone = Time::max();    ///< its peers notice that it is
  Time goes_on{};             ///< SIGSTOP until then
  std::uint32_t waiting = 0;  ///< messages that wait for it while it is stopped
};

struct Weather {
  double lost = 0.0, doubled = 0.0, slow = 0.0;
  nanoseconds least = 20us, most = 60us;  ///< on the way
  nanoseconds slow_most = 5ms;
};

class Network {
 public:
  Network(Scheduler& scheduler, Dice& dice, const Weather& weather)
      : scheduler_(scheduler), dice_(dice), weather_(weather) {}

  void best_effort(const Process& from, Process& to, const std::function<void()>& take) {
    if (!are_matched(from, to) || dice_.chance(weather_.lost)) return;
    const int copies = dice_.chance(weather_.doubled) ? 2 : 1;
    for (int n = 0; n < copies; ++n) deliver(to, scheduler_.now() + on_its_way(), take, socket_holds);
  }

  /// In the order of writing; before the two have met, from then on.
  void reliable(const Process& from, Process& to, const std::function<void()>& take) {
    Time& last = last_[{from.id, to.id}];
    last = std::max({last, scheduler_.now() + on_its_way(), from.joined, to.joined});
    deliver(to, last, take, ~0u);
  }

  /// Something that this process does by itself: when it is stopped, as soon as it goes on.
  void at(Process& of, Time when, const std::function<void()>& what) { deliver(of, when, what, ~0u); }

  bool are_matched(const Process& a, const Process& b) const {
    return a.runs && b.runs && scheduler_.now() >= a.joined && scheduler_.now() >= b.joined;
  }

 private:
  static constexpr std::uint32_t socket_holds = 64;  // of messages for a stopped process

  nanoseconds on_its_way() {
    return dice_.chance(weather_.slow) ? dice_.time(weather_.most, weather_.slow_most)
                                       : dice_.time(weather_.least, weather_.most);
  }

  void deliver(Process& to, Time when, const std::function<void()>& take, std::uint32_t waiting_max) {
    scheduler_.at(when, [this, &to, take, waiting_max] {
      if (!to.runs) return;
      if (scheduler_.now() >= to.goes_on) return take();
      if (to.waiting >= waiting_max) return;
      ++to.waiting;
      scheduler_.at(to.goes_on, [this, &to, take, waiting_max] {
        --to.waiting;
        deliver(to, scheduler_.now(), take, waiting_max);
      });
    });
  }

  Scheduler& scheduler_;
  Dice& dice_;
  const Weather weather_;
  std::map<std::pair<WriterId, WriterId>, Time> last_;
};

}  // namespace weakgrid::deterministic
