// Who may give orders: one named holder at a time, for as long as its lease, unless somebody of a higher
// source takes over.
#pragma once

#include <array>
#include <cstdint>

namespace weakgrid {

/// In the order of priority, lowest first. protection is the gateway itself.
enum class Source : std::uint8_t { test, schedule, operation, protection };

/// At most 23 bytes; what is over is not told apart.
struct Name {
  std::array<char, 24> text{};
  friend constexpr bool operator==(const Name&, const Name&) = default;
  constexpr bool empty() const { return text[0] == '\0'; }
};

struct Holder {
  Source source = Source::operation;
  Name name;
  friend constexpr bool operator==(const Holder&, const Holder&) = default;
};

class Authority {
 public:
  /// Nobody once the lease is over.
  bool is_held(std::uint64_t step) const noexcept { return until_step_ > step; }
  const Holder& holder() const noexcept { return holder_; }
  std::uint64_t until_step() const noexcept { return until_step_; }

  bool may_order(const Holder& who, std::uint64_t step) const noexcept {
    return !is_held(step) || who == holder_;
  }
  /// Nobody holds it, or it is one's own, or one's source stands above the holder's.
  bool may_take(const Holder& who, std::uint64_t step) const noexcept {
    return may_order(who, step) || who.source > holder_.source;
  }
  void give(const Holder& who, std::uint64_t until_step) noexcept {
    holder_ = who;
    until_step_ = until_step;
  }
  void release() noexcept { until_step_ = 0; }

 private:
  Holder holder_;
  std::uint64_t until_step_ = 0;
};

}  // namespace weakgrid
