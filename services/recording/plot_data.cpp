// PlotData: see the header.
#include "services/recording/plot_data.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <map>
#include <set>

#include "services/recording/recorder.hpp"
#include "services/recording/reexecution.hpp"
#include "services/runtime/payload.hpp"

namespace weakgrid {

void PlotData::Signal::add(std::uint64_t step, double t, SpaceVector value) {
  alpha.add(step, t, value.re);
  beta.add(step, t, value.im);
  magnitude.add(step, t, abs(value));
}

namespace {

// What the recording itself says, in one pass.
class Gatherer {
 public:
  explicit Gatherer(const PlotSelection& selection) : selection_(selection) {}

  PlotData gather() {
    RecordingSource source(selection_.files);
    while (const auto message = source.next()) {
      for (const mcap::Metadata& metadata : source.metadata()) see(metadata);
      source.metadata().clear();
      see(*message);
    }
    settle(source.faults());
    return std::move(data_);
  }

 private:
  void see(const RecordedMessage& message);
  void see(const RecordedMessage& message, const Measurement& m);
  void see(const RecordedMessage& message, const Modulation& modulation);
  void see(const DecisionMessage& message);
  void see(const mcap::Metadata& metadata);
  template <class Message>
  std::optional<Message> of_my_unit(const RecordedMessage& message);
  bool is_wanted(double t_s) const { return t_s >= selection_.from_s && t_s <= selection_.until_s; }
  void note_loss(std::uint64_t from_step, std::uint64_t to_step, double period);
  void mark(double t_s, const std::string& text);
  void read_manifests();
  void mark_events();
  void settle(const std::string& faults);

  const PlotSelection& selection_;
  PlotData data_;
  std::set<std::uint32_t> units_;
  std::set<std::size_t> plants_;                                            // writers
  std::size_t plant_ = 0;                                                   // the one drawn
  std::map<std::pair<std::uint32_t, std::string>, std::string> manifests_;  // settings, by unit and service
  std::optional<Settings> settings_;                                        // of any service
  std::optional<Scenario> scenario_;
  double period_s_ = period_s(Timing{});
  std::optional<std::uint64_t> last_step_;
  std::uint64_t lost_ = 0, strange_setpoints_ = 0;
  bool is_blocked_ = false, was_tripped_ = false;
};

template <class Message>
std::optional<Message> Gatherer::of_my_unit(const RecordedMessage& message) {
  auto decoded = from_payload<Message>(message.payload);
  if (!decoded) return std::nullopt;
  if constexpr (std::is_same_v<Message, Measurement>) {
    units_.insert(decoded->unit);
    if (data_.unit == 0) data_.unit = selection_.unit.value_or(decoded->unit);
  }
  if (decoded->unit != data_.unit) return std::nullopt;
  return std::move(decoded->message);
}

void Gatherer::see(const RecordedMessage& message) {
  const std::string& type = message.writer->type;
  if (type == "weakgrid::wire::Measurement") {
    if (const auto m = of_my_unit<Measurement>(message)) see(message, *m);
  } else if (type == "weakgrid::wire::Modulation") {
    if (const auto modulation = of_my_unit<Modulation>(message)) see(message, *modulation);
  } else if (type == "weakgrid::wire::SetpointDecision") {
    if (const auto decision = of_my_unit<DecisionMessage>(message)) see(*decision);
  } else if (type == "weakgrid::wire::Reference") {
    if (const auto reference = of_my_unit<Reference>(message)) data_.standing_v_c = reference->v_c;
  } else if (type == "weakgrid::wire::Manifest") {
    if (const auto manifest = from_payload<Manifest>(message.payload))
      manifests_[{manifest->unit, manifest->message.service}] = manifest->message.settings;
  }
}

void Gatherer::see(const RecordedMessage& message, const Measurement& m) {
  if (plants_.empty()) plant_ = message.writer->index;
  plants_.insert(message.writer->index);
  const double T = period_s_ = period_s(m.timing);
  const double t = static_cast<double>(m.step) * T;
  if (message.writer->index != plant_ || !is_wanted(t)) return;
  data_.timings.see_sample(m.step, message.publish_time_ns, message.log_time_ns);
  if (last_step_ && m.step <= *last_step_) return;  // sent again
  if (!last_step_)
    data_.first_s = t;
  else if (m.step != *last_step_ + 1)
    note_loss(*last_step_ + 1, m.step - 1, T);
  last_step_ = m.step;
  data_.last_s = t;
  data_.end_s = t + T;
  ++data_.samples;

  const SpaceVector s = power(m.v_p, m.i);
  data_.v_p.add(m.step, t, m.v_p);
  data_.i.add(m.step, t, m.i);
  data_.p.add(m.step, t, s.re);
  data_.q.add(m.step, t, s.im);
  data_.v_c.add(m.step, t, m.v_c);
  data_.path.add({s.re, s.im});
  if (m.blocked != is_blocked_ && data_.samples > 1)
    mark(t, !m.blocked ? was_tripped_ ? "reset" : "start" : m.state == UnitState::tripped ? "trip" : "stop");
  is_blocked_ = m.blocked;
  was_tripped_ = m.state == UnitState::tripped;
}

void Gatherer::see(const RecordedMessage& message, const Modulation& modulation) {
  const double t = static_cast<double>(modulation.step) * static_cast<double>(modulation.period_ns) * 1e-9;
  if (!is_wanted(t)) return;
  data_.timings.see_answer(modulation.step, message.publish_time_ns, message.log_time_ns);
}

void Gatherer::note_loss(std::uint64_t from_step, std::uint64_t to_step, double period) {
  lost_ += to_step - from_step + 1;
  if (data_.losses.size() < PlotData::losses_max)
    data_.losses.push_back({static_cast<double>(from_step) * period, static_cast<double>(to_step) * period});
}

void Gatherer::mark(double t_s, const std::string& text) {
  if (data_.marks.size() < PlotData::marks_max) data_.marks.push_back({t_s, text});
}

void Gatherer::see(const DecisionMessage& message) {
  const Decision& decision = message.decision;
  const double t = static_cast<double>(decision.decided_step) * period_s_;
  if (!is_wanted(t) || decision.repeated) return;
  const bool has_place = decision.verdict == Verdict::accepted ||
                         decision.verdict == Verdict::outside_envelope ||
                         decision.verdict == Verdict::unit_blocked;
  if (has_place && data_.setpoints.size() < PlotData::setpoints_max)
    data_.setpoints.push_back({t, decision.setpoint, decision.verdict});
  else
    ++strange_setpoints_;
}

// The same manifests, as each part of a recording repeats them.
void Gatherer::see(const mcap::Metadata& metadata) {
  if (metadata.name != manifest_metadata) return;
  const auto text = [&](const char* key) {
    const auto entry = metadata.entries.find(key);
    return entry == metadata.entries.end() ? std::string() : entry->second;
  };
  const std::string unit_text = text("unit");
  std::uint32_t unit = 0;
  std::from_chars(unit_text.data(), unit_text.data() + unit_text.size(), unit);
  manifests_[{unit, text("service")}] = text("settings");
}

void Gatherer::read_manifests() {
  for (const auto& [whose, text] : manifests_) {
    const auto& [unit, service] = whose;
    if (unit != data_.unit || service == "recorder") continue;
    try {
      settings_ = parse_settings(text, "manifest of " + service);
    } catch (const SettingsError&) {
      data_.incomplete.push_back(fmt::format("the settings of the {} cannot be read", service));
      continue;
    }
    if (service == "gateway") data_.gateway = settings_;
    if (settings_->scenario) scenario_ = settings_->scenario;
  }
}

// What the scenario did to the grid and the source.
void Gatherer::mark_events() {
  if (!scenario_) return;
  data_.title = scenario_->title;
  constexpr const char* names[] = {"p_i", "R_g", "X_g", "|v_g|"};
  for (const TimedEvent& event : scenario_->events)
    if (event.at_s >= data_.first_s && event.at_s <= data_.last_s)
      mark(event.at_s,
           fmt::format("{} → {:.3g}", names[static_cast<std::size_t>(event.quantity)], event.value));
  std::stable_sort(data_.marks.begin(), data_.marks.end(),
                   [](const PlotMark& a, const PlotMark& b) { return a.t_s < b.t_s; });
}

void Gatherer::settle(const std::string& faults) {
  const auto units = [this] { return fmt::format("{}", fmt::join(units_, ", ")); };
  if (units_.empty()) throw SettingsError(selection_.files.front() + ": nothing to plot: no sample in it");
  if (units_.count(data_.unit) == 0)
    throw SettingsError(fmt::format("unit {}: not in the recording; there is: {}", data_.unit, units()));
  if (!selection_.unit && units_.size() > 1)
    throw SettingsError(
        fmt::format("{}: units {} are in it; choose one with --unit", selection_.files.front(), units()));
  if (data_.samples == 0)
    throw SettingsError(fmt::format("nothing to plot: no sample of unit {} from {} s until {} s", data_.unit,
                                    selection_.from_s, selection_.until_s));
  read_manifests();
  if (settings_) data_.frequency_hz = settings_->converter.frequency_hz;
  if (data_.standing_v_c == 0.0)
    data_.standing_v_c = data_.gateway.value_or(settings_.value_or(Settings{})).converter.dc_voltage;
  mark_events();

  auto& incomplete = data_.incomplete;
  if (!faults.empty()) incomplete.push_back(faults.substr(0, faults.size() - 1));
  if (lost_ > 0)
    incomplete.push_back(fmt::format("{} samples are not in the recording, the first after {:.6g} s", lost_,
                                     data_.losses.front().from_s));
  if (plants_.size() > 1)
    incomplete.push_back(fmt::format("{} plants served unit {} one after another: the first one is drawn",
                                     plants_.size(), data_.unit));
  if (strange_setpoints_ > 0)
    incomplete.push_back(fmt::format("{} requests were bad or stale or too many: no place in the p-q plane",
                                     strange_setpoints_));
}

// What controllers do not publish, from their re-execution.
void reexecute(const PlotSelection& selection, PlotData& data) {
  ReexecutionOptions how;
  how.watch = [&](std::uint32_t unit, const Measurement& m, const Modulation&, const Controller& controller) {
    const double T = period_s(m.timing);
    const double t = static_cast<double>(m.step) * T;
    if (unit != data.unit || t < data.first_s || t > data.last_s) return;
    const ControllerState state = controller.state();
    data.v_p_hat.add(m.step, t, controller.v_p_hat());
    data.q_r.add(m.step, t, state.references.q.at(m.step).value);
    data.p_r.add(m.step + 1, t + T, state.law.p_r);  // one step ahead of the sample
  };
  RecordingSource source(selection.files);
  Reexecution reexecution(how);
  reexecution.run(source);
  const ReexecutionFindings& findings = reexecution.findings();
  for (const ControllerFindings& c : findings.controllers) {
    if (c.unit != data.unit || c.unchecked.empty()) continue;
    std::uint64_t count = 0;
    for (const Unchecked& u : c.unchecked) count += u.count;
    data.incomplete.push_back(
        fmt::format("of {} answers the filtered voltage and the references are not known: {}", count,
                    c.unchecked.front().why));
  }
  if (data.v_p_hat.magnitude.empty() && findings.controllers.empty())
    data.incomplete.push_back("no answer of a controller: filtered voltage and references are not known");
  if (findings.differences.count() > 0)
    data.incomplete.push_back("re-executed, the recording differs: weakgrid verify tells where");
}

}  // namespace

PlotData plot_data(const PlotSelection& selection) {
  PlotData data = Gatherer(selection).gather();
  if (selection.reexecutes) reexecute(selection, data);
  return data;
}

}  // namespace weakgrid
