// Replay target: see the header.
#include "services/recording/replay_target.hpp"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <chrono>
#include <nlohmann/json.hpp>
#include <set>
#include <stdexcept>

#include "services/recording/replay_source.hpp"

namespace weakgrid {

namespace {

using std::chrono::milliseconds;

constexpr std::size_t window_messages = 256;
constexpr std::size_t window_bytes = 128 << 10;
// A reader that takes nothing for so long, as one that was killed, is not waited for.
constexpr milliseconds window_patience{2000};
constexpr milliseconds between_questions{100};
// A burst that readers may be behind by; beyond it a volatile reliable sample is lost, but nobody waits.
constexpr int reliable_depth = 4096;

std::uint32_t strength_of(const std::string& qos_full) {
  const auto json = nlohmann::json::parse(qos_full, nullptr, false);
  if (!json.is_object()) return 0;
  const auto strength = json.find("ownership_strength");
  return strength != json.end() && strength->is_number_unsigned() ? strength->get<std::uint32_t>() : 0;
}

}  // namespace

ReplayTarget::ReplayTarget(std::uint32_t domain, const DdsSettings& dds)
    : domain_(domain), bus_(domain, dds) {}

void ReplayTarget::refuse_company(const std::vector<SourceWriter>& replayed) const {
  const auto live = bus_.writers_of_others();
  if (const LiveWriter* other = writer_in_the_way(live, replayed))
    throw std::runtime_error(
        fmt::format("topic {} is written in domain {} already, by {}: stop that, give another --domain, or "
                    "--mix",
                    other->topic, domain_, other->guid));
}

void ReplayTarget::make_writers(const std::vector<SourceWriter>& replayed) {
  std::set<std::string> warned;
  for (const SourceWriter& w : replayed) {
    writers_.emplace_back(bus_,
                          RawWriter::Options{.topic = w.topic,
                                             .type = w.type,
                                             .keyed = w.keyed,
                                             .reliable = w.reliable,
                                             .transient_local = w.transient_local,
                                             .exclusive = w.exclusive,
                                             .strength = strength_of(w.qos_full),
                                             .partitions = w.partitions,
                                             .depth = w.reliable && !w.transient_local ? reliable_depth : 1});
    reliable_.push_back(w.reliable);
    if (!writers_.back().knows_key() && warned.insert(w.topic).second)
      spdlog::warn("{}: the key of type {} is not known, each recorded writer is one instance", w.topic,
                   w.type);
  }
}

int ReplayTarget::matched() const {
  int sum = 0;
  for (const RawWriter& writer : writers_) sum += writer.matched();
  return sum;
}

bool ReplayTarget::write(const RawSample& sample) {
  if (!writers_[sample.writer].write(sample.payload)) return false;
  if (reliable_[sample.writer]) {
    ++ahead_messages_;
    ahead_bytes_ += sample.payload.size();
  }
  return true;
}

void ReplayTarget::keep_window(const GoesOn& goes_on) {
  if (ahead_messages_ < window_messages && ahead_bytes_ < window_bytes) return;
  const auto deadline = std::chrono::steady_clock::now() + window_patience;
  wait_until_taken([&] { return goes_on() && std::chrono::steady_clock::now() < deadline; });
}

bool ReplayTarget::wait_until_taken(const GoesOn& goes_on) {
  bool all = true;
  for (std::size_t n = 0; n < writers_.size(); ++n) {
    bool taken = !reliable_[n] || writers_[n].wait_until_taken(between_questions);
    while (!taken && goes_on()) taken = writers_[n].wait_until_taken(between_questions);
    all = all && taken;
  }
  ahead_messages_ = ahead_bytes_ = 0;
  return all;
}

}  // namespace weakgrid
