// UnitWatch: see the header.
#include "tests/faults/unit_watch.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace weakgrid::faults {

namespace {

using Clock = std::chrono::steady_clock;

// [protection] as it is by default.
bool is_within_protection(const Measurement& m) {
  return finite(m.v_p) && finite(m.i) && abs(m.i) <= 2.0 && m.v_c >= 1.2 && m.v_c <= 2.6;
}

bool is_same_order(const Reference& a, const Reference& b) {
  return a.p == b.p && a.q == b.q && a.v_c == b.v_c && a.effective_step == b.effective_step &&
         a.lease_end_step == b.lease_end_step && a.renews == b.renews;
}

}  // namespace

UnitWatch::UnitWatch(std::uint32_t domain, const DdsSettings& dds)
    : client_(domain, 1, dds),
      references_(client_.bus(), 1, [this](const Reference& r, Arrival) { see(r); }),
      modulations_(client_.bus(), 1, [this](const Modulation& m, Arrival) { see(m); }),
      healths_(client_.bus(), 1, [this](const Health& h, Arrival) { see(h); }),
      measurements_(client_.bus(), 1, [this](const Measurement& m, Arrival a) { see(m, a.writer); }) {}

void UnitWatch::see(const Measurement& m, WriterId writer) {
  const std::lock_guard lock(mutex_);
  const auto [last, is_new] = last_step_.try_emplace(writer, m.step);
  if (!is_new && m.step < last->second)
    violated("a plant goes back from step " + std::to_string(last->second) + " to " + std::to_string(m.step));
  last->second = m.step;
  if (!m.blocked && !is_within_protection(m))
    violated("step " + std::to_string(m.step) + ": |i| " + std::to_string(abs(m.i)) + ", v_c " +
             std::to_string(m.v_c) + " and not blocked");
  if (m.blocked && m.p_i != 0.0) violated("step " + std::to_string(m.step) + ": blocked, the source is open");
  // The order may be heard after the sample that follows it: its lease is looked at later.
  if (m.reference_id != 0 && !m.blocked && !m.fallback) followed_until_[m.reference_id] = m.step;
  const bool is_answered = m.state == UnitState::running && m.reference_id != 0 && !m.fallback;
  const bool goes_on = sample_ && plant_ == writer && sample_->reference_id == m.reference_id && !m.blocked;
  if (!goes_on) answered_ = 0;
  if (is_answered) ++answered_;
  sample_ = m;
  plant_ = writer;
  heard_at_ = Clock::now();
}

void UnitWatch::see(const Modulation& m) {
  const std::lock_guard lock(mutex_);
  if (!finite(m.mu) || abs(m.mu) > Converter{}.mu_max * (1.0 + 1e-12))
    violated("step " + std::to_string(m.step) + ": |mu| " + std::to_string(abs(m.mu)));
  answer_ = m;
}

void UnitWatch::see(const Reference& r) {
  const std::lock_guard lock(mutex_);
  const auto [known, is_new] = issued_.try_emplace(r.id, r);
  if (!is_new && !is_same_order(known->second, r))
    violated("id " + std::to_string(r.id) + " is given to two references");
  std::uint64_t end = r.lease_end_step;
  // A renewal never shortens what it renews.
  if (r.renews != 0)
    for (auto order = lease_ends_.lower_bound(r.renews); order != lease_ends_.end() && order->first < r.id;
         ++order)
      end = end == 0 || order->second == 0 ? 0 : std::max(end, order->second);
  lease_ends_[r.id] = end;
}

void UnitWatch::see(const Health& h) {
  const std::lock_guard lock(mutex_);
  if (h.state != ServiceState::stopped) said_[h.service] = {h, Clock::now()};
}

void UnitWatch::check_leases() {
  for (const auto& [id, step] : followed_until_) {
    const auto end = lease_ends_.find(id);
    if (end != lease_ends_.end() && end->second != 0 && step >= end->second)
      violated("reference " + std::to_string(id) + " stands at step " + std::to_string(step) +
               ", its lease ended at " + std::to_string(end->second));
  }
}

std::vector<std::string> UnitWatch::take_violations() {
  const std::lock_guard lock(mutex_);
  check_leases();
  // What was judged is not judged again; who has heard nothing of an id keeps it.
  std::erase_if(followed_until_, [this](const auto& order) { return lease_ends_.contains(order.first); });
  return std::exchange(violations_, {});
}

std::set<std::uint32_t> UnitWatch::followed_unheard() const {
  const std::lock_guard lock(mutex_);
  std::set<std::uint32_t> ids;
  for (const auto& [id, step] : followed_until_)
    if (!lease_ends_.contains(id)) ids.insert(id);
  return ids;
}

std::optional<Measurement> UnitWatch::sample() const {
  const std::lock_guard lock(mutex_);
  return sample_;
}

bool UnitWatch::follows(std::uint32_t id) const {
  const std::lock_guard lock(mutex_);
  return sample_ && answer_ && sample_->reference_id == id && answer_->reference_id == id &&
         !sample_->blocked && answered_ >= enough_answered;
}

bool UnitWatch::is_well(const std::string& service, Time since) const {
  const std::lock_guard lock(mutex_);
  const auto said = said_.find(service);
  return said != said_.end() && said->second.at > since && said->second.health.state == ServiceState::running;
}

std::uint64_t UnitWatch::count(const std::string& service, const std::string& name) const {
  const std::lock_guard lock(mutex_);
  const auto said = said_.find(service);
  return said == said_.end() ? 0 : counter(said->second.health, name);
}

std::int64_t UnitWatch::wall_time_ns(const std::string& service) const {
  const std::lock_guard lock(mutex_);
  const auto said = said_.find(service);
  return said == said_.end() ? 0 : said->second.health.wall_time_ns;
}

std::string UnitWatch::words() const {
  const std::lock_guard lock(mutex_);
  std::string text;
  const auto ago = [](Time at) {
    return std::to_string(std::chrono::duration<double>(Clock::now() - at).count()) + " s ago";
  };
  if (sample_)
    text += "\n  sample " + std::to_string(sample_->step) + " " + name(sample_->state) +
            (sample_->fallback ? " fallback" : "") + ", reference " + std::to_string(sample_->reference_id) +
            ", " + ago(heard_at_);
  if (answer_)
    text += "\n  answer " + std::to_string(answer_->step) + ", reference " +
            std::to_string(answer_->reference_id);
  for (const auto& [service, said] : said_)
    text += "\n  " + service + ": " + name(said.health.state) + ", step " + std::to_string(said.health.step) +
            ", reference " + std::to_string(said.health.reference_id) + " " + said.health.text + ", " +
            ago(said.at);
  return text;
}

}  // namespace weakgrid::faults
