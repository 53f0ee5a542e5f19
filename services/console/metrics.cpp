// Metrics: see the header.
#include "services/console/metrics.hpp"

#include <prometheus/text_serializer.h>

#include <algorithm>
#include <limits>
#include <set>

#include "services/decision_text.hpp"

namespace weakgrid {

namespace {

using prometheus::ClientMetric;
using prometheus::MetricFamily;
using prometheus::MetricType;
using Labels = std::vector<ClientMetric::Label>;

// A domain has that many at most; what is beyond is somebody who invents them.
constexpr std::size_t series_max = 1024;
constexpr std::int64_t silent_ns = 5'000'000'000;

/// The counters of health (services/README.md) and what they are. Others are not shown: whoever is in the domain can say
/// anything.
struct Known {
  const char *name, *help;
  bool is_gauge = false;
};
constexpr Known counters[] = {
    {"holds", "Steps without an answer in time."},
    {"resends", "Samples repeated while the controller was silent."},
    {"late_modulations", "Answers that came when their step had been held."},
    {"overruns", "Times that the plant woke a period late or more."},
    {"missed_steps", "Steps made up after an overrun."},
    {"saturated", "Answers at the limit of the modulation."},
    {"refused_modulations", "Answers not finite or beyond the limit."},
    {"refused_references", "References that no correct gateway gives."},
    {"refused_operations", "Operations for a step that has passed or not for that state."},
    {"foreign_modulations", "Answers of a second controller."},
    {"foreign_measurements", "Samples of a second plant."},
    {"controller_changes", "Times that another controller took over."},
    {"malformed", "Messages that no correct peer sends."},
    {"overflow", "References lost because newer ones came before the next sample."},
    {"lease_ends", "Fallbacks begun because a lease was over."},
    {"unit_state", "0 running, 1 holding, 2 tripped, 3 off, 4 precharge, 5 ready.", true},
    {"tripped", "1 while the unit is tripped.", true},
    {"trip_step", "Step of the last trip.", true},
    {"bad_measurement", "Samples that a controller cannot use."},
    {"low_voltage", "Samples with too low a voltage at the point of common coupling."},
    {"gap", "Samples behind a gap."},
    {"wrong_timing", "Samples with another period, delay, hold or sampling than the controller's."},
    {"started", "Times that the law began anew."},
    {"fallback", "Samples answered on the way to the fallback or on it."},
    {"stale", "Samples older than the last."},
    {"unsent", "Messages that found no room."},
    {"epoch", "Of the controller that answers.", true},
    {"takeovers", "Times that the second of two controllers has taken over."},
    {"accepted", "Requests accepted."},
    {"rejected", "Requests rejected."},
    {"unwritten", "Entries that are missing in the journal."},
    {"unsynced", "Entries of the journal that are not on the disk yet.", true},
    {"messages", "Messages recorded or replayed."},
    {"bytes", "Bytes of their payloads."},
    {"dropped", "Messages that were not recorded though they came."},
    {"missing", "Messages that never came, by their writers' sequence numbers."},
    {"after_stop", "Messages that came when recording had ended."},
    {"writers", "Writers heard.", true},
    {"left_out", "Writers that are not recorded."},
    {"files", "Files of the recording.", true},
    {"late", "Messages replayed more than a millisecond late."},
    {"heard", "Messages that the console has heard."},
    {"connections", "HTTP connections open now.", true},
    {"conversations", "WebSockets open now.", true},
    {"requests", "HTTP requests answered."},
    {"refused", "Of these refused, and what was no HTTP."},
    {"frames_dropped", "WebSocket frames to peers that were too slow."},
};

/// What the network says, as text that any reader takes.
std::string clean(std::string text) {
  std::replace_if(
      text.begin(), text.end(), [](char c) { return c < ' ' || c > '~'; }, '?');
  return text;
}

class Families {
 public:
  /// counter: the name gets _total.
  void add(const std::string& name, const std::string& help, MetricType type, Labels labels, double value) {
    ClientMetric& metric = put(name, help, type, std::move(labels));
    (type == MetricType::Counter ? metric.counter.value : metric.gauge.value) = value;
  }
  void add(const std::string& name, const std::string& help, Labels labels, const StageTiming& timing) {
    ClientMetric::Histogram& histogram =
        put(name, help, MetricType::Histogram, std::move(labels)).histogram;
    histogram.sample_count = timing.count;
    histogram.sample_sum = static_cast<double>(timing.sum_ns) * 1e-9;
    for (std::size_t n = 0; n < timing_bounds_ns.size(); ++n)
      histogram.bucket.push_back({timing.at_most[n], static_cast<double>(timing_bounds_ns[n]) / 1e9});
    histogram.bucket.push_back({timing.count, std::numeric_limits<double>::infinity()});
  }
  std::string text() const { return prometheus::TextSerializer().Serialize(families_); }

 private:
  ClientMetric& put(const std::string& name, const std::string& help, MetricType type, Labels labels) {
    const auto [place, is_new] = places_.emplace(name, families_.size());
    if (is_new) families_.push_back({"weakgrid_" + name, help, type, {}});
    ClientMetric& metric = families_[place->second].metric.emplace_back();
    metric.label = std::move(labels);
    return metric;
  }

  std::vector<MetricFamily> families_;
  std::map<std::string, std::size_t> places_;
};

}  // namespace

void Metrics::hear(std::uint32_t unit, const Health& health, std::int64_t now_ns, std::int64_t wall_ns) {
  const Key key{unit, clean(health.service)};
  const auto known = services_.find(key);
  if (known == services_.end() && services_.size() >= series_max) return;
  Heard& heard = services_[key];
  // The first word of a start may be the last one of somebody long dead; later ones come as they are said.
  const std::int64_t age_ns =
      heard.health.instance == health.instance ? 0 : std::max<std::int64_t>(0, wall_ns - health.wall_time_ns);
  heard = {health, now_ns - age_ns};
}

void Metrics::hear(std::uint32_t unit, const Manifest& manifest) {
  const Key key{unit, clean(manifest.service)};
  if (builds_.contains(key) || builds_.size() < series_max) builds_[key] = clean(manifest.build);
}

void Metrics::hear(std::uint32_t unit, const Measurement& measurement, std::int64_t now_ns) {
  if (points_.contains(unit) || points_.size() < series_max) points_[unit] = {measurement, now_ns};
}

void Metrics::hear(std::uint32_t unit, const Decision& decision) {
  if (decision.repeated) return;
  if (!decided_.contains(unit) && decided_.size() >= series_max) return;
  Decided& decided = decided_[unit];
  ++decided.by_verdict[decision.verdict];
  if (decision.verdict == Verdict::accepted) return;
  for (const LimitMargin& margin : decision.margins)
    if (violated(margin)) ++decided.by_limit[margin.limit];
}

std::string Metrics::text(std::int64_t now_ns) const {
  Families out;
  constexpr auto counter = MetricType::Counter, gauge = MetricType::Gauge;
  const auto seconds_since = [&](std::int64_t at_ns) { return static_cast<double>(now_ns - at_ns) * 1e-9; };
  const auto count = [](std::uint64_t n) { return static_cast<double>(n); };
  for (const auto& [key, build] : builds_)
    out.add("build_info", "The build of a service.", gauge,
            {{"unit", std::to_string(key.first)}, {"service", key.second}, {"build", build}}, 1.0);
  for (const auto& [key, heard] : services_) {
    const Health& h = heard.health;
    const Labels labels{{"unit", std::to_string(key.first)}, {"service", key.second}};
    const auto with = [&](const char* name, const std::string& value) {
      Labels more = labels;
      more.push_back({name, value});
      return more;
    };
    out.add("service_up", "1 if the service has spoken in the last 5 s and has not said goodbye.", gauge, labels,
            h.state != ServiceState::stopped && now_ns - heard.at_ns < silent_ns ? 1.0 : 0.0);
    out.add("service_heard_seconds", "Since the service has spoken last.", gauge, labels,
            seconds_since(heard.at_ns));
    for (const ServiceState state : {ServiceState::starting, ServiceState::running, ServiceState::waiting,
                                     ServiceState::blocked_by_trip, ServiceState::stopped})
      out.add("service_state", "1 for the state that the service said last.", gauge, with("state", name(state)),
              state == h.state ? 1.0 : 0.0);
    out.add("service_step", "Step that the service is at.", gauge, labels, count(h.step));
    out.add("service_reference", "Id of the newest reference that the service knows.", gauge, labels,
            h.reference_id);
    std::set<std::string> said;  // a series twice would cost Prometheus the whole page
    for (const Counter& one : h.counters) {
      if (!said.insert(one.name).second) continue;
      const auto known = std::find_if(std::begin(counters), std::end(counters),
                                      [&](const Known& k) { return one.name == k.name; });
      if (known != std::end(counters))
        out.add(known->is_gauge ? one.name : one.name + "_total", known->help,
                known->is_gauge ? gauge : counter, labels, count(one.value));
    }
    for (const StageTiming& timing : h.timings)
      if (said.insert("stage " + timing.stage).second)
        out.add("stage_duration_seconds", "Of the stages of a step: services/README.md.",
                with("stage", clean(timing.stage)), timing);
  }
  for (const auto& [unit, point] : points_) {
    const Measurement& m = point.measurement;
    const SpaceVector s = power(m.v_p, m.i);
    const Labels labels{{"unit", std::to_string(unit)}};
    out.add("active_power_ratio", "At the point of common coupling, per unit.", gauge, labels, s.re);
    out.add("reactive_power_ratio", "At the point of common coupling, per unit.", gauge, labels, s.im);
    out.add("pcc_voltage_ratio", "At the point of common coupling, per unit.", gauge, labels, abs(m.v_p));
    out.add("current_ratio", "Of the converter, per unit.", gauge, labels, abs(m.i));
    out.add("dc_voltage_ratio", "Of the DC link, per unit.", gauge, labels, m.v_c);
    out.add("measurement_heard_seconds", "Since the last sample.", gauge, labels, seconds_since(point.at_ns));
  }
  for (const auto& [unit, decided] : decided_) {
    for (const auto& [verdict, number] : decided.by_verdict)
      out.add("decisions_total", "Decisions heard since the console began.", counter,
              {{"unit", std::to_string(unit)}, {"verdict", name(verdict)}}, count(number));
    for (const auto& [limit, number] : decided.by_limit)
      out.add("violated_limits_total", "Limits that rejected requests would violate.", counter,
              {{"unit", std::to_string(unit)}, {"limit", name(limit)}}, count(number));
  }
  return out.text();
}

}  // namespace weakgrid
