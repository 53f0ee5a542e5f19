// A DDS domain to be alone in, and how to wait for a condition.
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <string>

namespace weakgrid::test {

using std::chrono::milliseconds;

/// How long a condition may take on a machine that is busy with other things. Tests wait for conditions,
/// never for time, so a quick machine does not wait.
inline constexpr milliseconds long_enough{60'000};

/// Asks every few ms; false: not true within `patience`.
bool wait_until(const std::function<bool()>& condition, milliseconds patience = long_enough);

/// A DDS domain that no other test on this machine has meanwhile. 215 … 229: out of the way of what people
/// start by hand, and with ports above those that the system hands out; one so taken would silence a domain.
class Domain {
 public:
  Domain();
  ~Domain();
  Domain(const Domain&) = delete;
  Domain& operator=(const Domain&) = delete;
  std::uint32_t number() const { return number_; }
  std::string text() const { return std::to_string(number_); }

 private:
  std::uint32_t number_ = 0;
  int lock_ = -1;
};

}  // namespace weakgrid::test
