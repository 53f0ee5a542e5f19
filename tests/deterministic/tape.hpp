// Every call into a dialogue and what came of it, so that it can be made again on a fresh one: the same
// inputs must give the same bits.
#pragma once

#include <bit>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "services/runtime/messages.hpp"

namespace weakgrid::deterministic {

// What a call gave, as a number that tells any two results apart, but for one in 2³² of them.
inline void add(Fingerprint& f, SpaceVector v) {
  f.add(v.re);
  f.add(v.im);
}
inline std::uint32_t bits_of(const Modulation& m) {
  Fingerprint f;
  for (const std::uint64_t word :
       {m.step, std::uint64_t{m.period_ns}, std::uint64_t{m.reference_id}, std::uint64_t{m.status},
        std::uint64_t{m.newest_reference_id}, std::uint64_t{m.measurement_fingerprint}})
    f.add(word);
  add(f, m.mu);
  return f.value();
}
inline std::uint32_t bits_of(const Measurement& m) { return fingerprint(m); }
inline std::uint32_t bits_of(const Reference& r) {
  Fingerprint f;
  for (const std::uint64_t word :
       {std::uint64_t{r.id}, r.effective_step, std::uint64_t{r.ramp_steps}, std::uint64_t{r.renews},
        r.lease_end_step, std::uint64_t{r.fallback_ramp_steps}})
    f.add(word);
  for (const double number : {r.p, r.q, r.v_c, r.fallback_p, r.fallback_q, r.fallback_v_c}) f.add(number);
  return f.value();
}
inline std::uint32_t bits_of(bool b) { return b ? 1u : 2u; }
inline std::uint32_t bits_of(const std::string& text) {
  Fingerprint f;
  for (const char c : text) f.add(std::uint64_t{static_cast<unsigned char>(c)});
  return f.value();
}
template <class T>
std::uint32_t bits_of(const std::optional<T>& o) {
  return o ? bits_of(*o) : 0;
}

template <class Dialogue>
class Taped {
 public:
  template <class... Arguments>
  explicit Taped(Arguments... arguments)
      : make_([arguments...] { return std::make_unique<Dialogue>(arguments...); }), live_(make_()) {}

  /// Calls call(dialogue), and will again.
  template <class Call>
  auto operator()(Call call) {
    using Result = std::invoke_result_t<Call, Dialogue&>;
    if constexpr (std::is_void_v<Result>) {
      tape_.push_back({[call](Dialogue& d) { return call(d), 0u; }, 0});
      call(*live_);
    } else {
      Result result = call(*live_);
      tape_.push_back({[call](Dialogue& d) { return bits_of(call(d)); }, bits_of(result)});
      return result;
    }
  }
  const Dialogue& operator*() const { return *live_; }
  const Dialogue* operator->() const { return live_.get(); }

  /// The first call that gives something else when all are made again.
  std::optional<std::size_t> differs_at() const {
    const auto again = make_();
    for (std::size_t n = 0; n < tape_.size(); ++n)
      if (tape_[n].call(*again) != tape_[n].gave) return n;
    return std::nullopt;
  }

 private:
  struct Made {
    std::function<std::uint32_t(Dialogue&)> call;
    std::uint32_t gave;
  };
  std::function<std::unique_ptr<Dialogue>()> make_;
  std::unique_ptr<Dialogue> live_;
  std::vector<Made> tape_;
};

}  // namespace weakgrid::deterministic
