// What the services of a domain say of themselves, as Prometheus reads it: text format 0.0.4. Knows no sockets
// and no DDS.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <utility>

#include "services/runtime/messages.hpp"

namespace weakgrid {

/// Times are of one clock that does not go back, ns; those of health, of the clock of `wall_ns`.
class Metrics {
 public:
  void hear(std::uint32_t unit, const Health& health, std::int64_t now_ns, std::int64_t wall_ns);
  void hear(std::uint32_t unit, const Manifest& manifest);
  void hear(std::uint32_t unit, const Measurement& measurement, std::int64_t now_ns);
  void hear(std::uint32_t unit, const Decision& decision);

  std::string text(std::int64_t now_ns) const;

 private:
  using Key = std::pair<std::uint32_t, std::string>;  // unit, service
  struct Heard {
    Health health;
    std::int64_t at_ns = 0;
  };
  struct Point {
    Measurement measurement;
    std::int64_t at_ns = 0;
  };
  std::map<Key, Heard> services_;
  std::map<Key, std::string> builds_;
  std::map<std::uint32_t, Point> points_;
  struct Decided {
    std::map<Verdict, std::uint64_t> by_verdict;
    std::map<Limit, std::uint64_t> by_limit;  // violated
  };
  std::map<std::uint32_t, Decided> decided_;
};

}  // namespace weakgrid
