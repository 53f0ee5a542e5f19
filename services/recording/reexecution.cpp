// Reexecution: see the header.
#include "services/recording/reexecution.hpp"

#include <algorithm>
#include <charconv>
#include <nlohmann/json.hpp>
#include <utility>

#include "services/manifest_constants.hpp"
#include "services/recording/recorder.hpp"
#include "services/runtime/announcer.hpp"
#include "services/runtime/payload.hpp"

namespace weakgrid {

std::uint64_t ReexecutionFindings::compared() const {
  std::uint64_t sum = 0;
  for (const ControllerFindings& c : controllers) sum += c.compared;
  for (const GatewayFindings& g : gateways) sum += g.decisions + g.references;
  return sum;
}

std::uint64_t ReexecutionFindings::unchecked() const {
  std::uint64_t sum = 0;
  for (const ControllerFindings& c : controllers)
    for (const Unchecked& u : c.unchecked) sum += u.count;
  for (const GatewayFindings& g : gateways)
    for (const Unchecked& u : g.unchecked) sum += u.count;
  return sum;
}

void Reexecution::run(RecordingSource& source) {
  while (const auto message = source.next()) {
    for (const mcap::Metadata& metadata : source.metadata()) see(metadata);
    source.metadata().clear();
    see(*message);
  }
  findings_.file_faults = source.faults();
  finish();
}

void Reexecution::see(const RecordedMessage& message) {
  constexpr std::string_view ours = "weakgrid::wire::";
  const std::string& type = message.writer->type;
  if (type.rfind(ours, 0) != 0) return;
  const std::string_view name = std::string_view(type).substr(ours.size());
  if (name == "Measurement") return see_as<Measurement>(message);
  if (name == "Modulation") return see_as<Modulation>(message);
  if (name == "ControllerState") return see_as<ControllerState>(message);
  if (name == "SetpointRequest") return see_as<Request>(message);
  if (name == "SetpointDecision") return see_as<DecisionMessage>(message);
  if (name == "Reference") return see_as<Reference>(message);
  if (name == "Manifest") return see_as<Manifest>(message);
}

template <class Message>
void Reexecution::see_as(const RecordedMessage& message) {
  const auto decoded = from_payload<Message>(message.payload);
  if (!decoded) return refuse(message);
  const std::uint32_t number = decoded->unit;
  const Message& content = decoded->message;
  if constexpr (std::is_same_v<Message, Manifest>) {
    see(*message.writer, number, content);
  } else {
    Unit& unit = units_[number];
    if (unit.first_type.empty()) {
      unit.first_type = message.writer->type;
      unit.first_step = step_of(message);
    }
    if constexpr (std::is_same_v<Message, Measurement>) {
      unit.inputs.see(message.writer->guid, content);
      note_holds(unit, content);
      last_steps_[message.writer->index] = content.step;
      for (auto& [index, replica] : unit.controllers) replica->note_sample();
    } else if constexpr (std::is_same_v<Message, Request>) {
      unit.requests.emplace(std::pair{content.client, content.id}, content);
    } else if constexpr (std::is_same_v<Message, Modulation>) {
      ControllerReplica& replica = controller_of(unit, number, *message.writer);
      replica.see(message.sequence, content);
      replica.process(false);
      note_loop(unit, content);
    } else if constexpr (std::is_same_v<Message, ControllerState>) {
      // Of the same process as the modulations: the newest of that participant.
      for (auto at = unit.controllers.rbegin(); at != unit.controllers.rend(); ++at)
        if (at->second->findings().writer.rfind(message.writer->participant() + "|", 0) == 0)
          return at->second->see(content);
    } else if constexpr (std::is_same_v<Message, DecisionMessage>) {
      gateway_of(unit, number, *message.writer).see(message.sequence, content, unit.inputs.plants.size());
    } else if constexpr (std::is_same_v<Message, Reference>) {
      unit.inputs.references[content.id] = content;
      gateway_of(unit, number, *message.writer).see(content);
    }
  }
}

void Reexecution::see(const RecordedWriter& writer, std::uint32_t unit, const Manifest& manifest) {
  check_manifest(unit, manifest);
  if (!manifests_seen_.try_emplace({unit, manifest.instance}, true).second) return;
  Process process{unit, manifest.service, writer.participant(), manifest.build, {}};
  try {
    process.settings = parse_settings(manifest.settings, "manifest of " + manifest.service);
  } catch (const SettingsError& error) {
    findings_.differences.add({.unit = unit,
                               .step = 0,
                               .what = "manifest",
                               .which = manifest.service,
                               .field = "settings",
                               .recorded = std::string(error.what()),
                               .computed = std::string("settings that can be read")});
    return;
  }
  processes_.push_back(std::move(process));
}

// The same manifests, as each part of a recording repeats them; a part that begins in the midst has no
// others.
void Reexecution::see(const mcap::Metadata& metadata) {
  if (metadata.name != manifest_metadata) return;
  const auto text = [&](const char* key) {
    const auto entry = metadata.entries.find(key);
    return entry == metadata.entries.end() ? std::string() : entry->second;
  };
  Manifest manifest{.service = text("service"),
                    .build = text("build"),
                    .settings = text("settings"),
                    .constants = {},
                    .digest = text("digest")};
  const std::string instance = text("instance"), unit_text = text("unit");
  std::uint32_t unit = 0;
  std::from_chars(instance.data(), instance.data() + instance.size(), manifest.instance, 16);
  std::from_chars(unit_text.data(), unit_text.data() + unit_text.size(), unit);
  const auto constants = nlohmann::json::parse(text("constants"), nullptr, false);
  if (constants.is_array())
    for (const auto& constant : constants)
      if (constant.is_array() && constant.size() == 2 && constant[0].is_string() && constant[1].is_number())
        manifest.constants.push_back({constant[0].get<std::string>(), constant[1].get<double>()});
  see(RecordedWriter{.topic = {}, .type = {}, .guid = text("writer")}, unit, manifest);
}

void Reexecution::check_manifest(std::uint32_t unit, const Manifest& manifest) {
  ++findings_.manifests;
  const auto add = [&](const std::string& field, WireField::Value recorded, WireField::Value computed) {
    findings_.differences.add({.unit = unit,
                               .step = 0,
                               .what = "manifest",
                               .which = manifest.service,
                               .field = field,
                               .recorded = std::move(recorded),
                               .computed = std::move(computed)});
  };
  if (const std::string digest = digest_of(unit, manifest); digest != manifest.digest)
    add("digest", manifest.digest, digest);
  if (manifest.service != "controller") return;
  std::vector<Constant> derived;
  try {
    derived = constants_of(derive_constants(
        controller_configuration(parse_settings(manifest.settings, "manifest of controller"))));
  } catch (const SettingsError&) {
    return;  // said by whoever sees it
  }
  for (std::size_t n = 0; n < derived.size(); ++n) {
    const bool is_there = n < manifest.constants.size() && manifest.constants[n].name == derived[n].name;
    const WireField::Value recorded =
        is_there ? WireField::Value(manifest.constants[n].value) : std::string("missing");
    if (!is_same(recorded, derived[n].value)) add("constants." + derived[n].name, recorded, derived[n].value);
  }
}

// The step that a message names; of a sample that cannot be believed the one after its writer's last.
std::uint64_t Reexecution::step_of(const RecordedMessage& message) {
  const auto last = last_steps_.find(message.writer->index);
  if (last != last_steps_.end()) return last->second + 1;
  const auto fields = fields_of_payload(message.writer->type, message.payload);
  if (!fields) return 0;
  for (const WireField& field : *fields)
    for (const char* name : {"step", "decided_step", "effective_step"})
      if (field.name == std::string_view(name)) return std::get<std::uint64_t>(field.value);
  return 0;
}

// No correct peer has sent this.
void Reexecution::refuse(const RecordedMessage& message) {
  findings_.differences.add({.unit = 0,
                             .step = step_of(message),
                             .what = "message",
                             .which = message.writer->type,
                             .field = "payload",
                             .recorded = std::uint64_t{message.payload.size()},
                             .computed = std::string("bytes of that type")});
}

// Where manifests tell who is there, messages of a unit that none names are of no unit.
void Reexecution::check_units() {
  if (processes_.empty()) return;
  for (const auto& [number, unit] : units_) {
    const bool is_known = std::any_of(processes_.begin(), processes_.end(),
                                      [n = number](const Process& p) { return p.unit == n; });
    if (is_known) continue;
    findings_.differences.add({.unit = number,
                               .step = unit.first_step,
                               .what = "message",
                               .which = unit.first_type,
                               .field = "unit",
                               .recorded = std::uint64_t{number},
                               .computed = std::string("a unit that a manifest names")});
  }
}

// By participant; where several of a service share one (a replay), in the order of their appearance.
Reexecution::Process* Reexecution::process_of(std::uint32_t unit, const std::string& service,
                                              const std::string& participant) {
  Process* any = nullptr;
  for (Process& process : processes_) {
    if (process.unit != unit || process.service != service || process.taken) continue;
    if (process.participant == participant) return &process;
    any = &process;
  }
  return any;
}

ControllerReplica& Reexecution::controller_of(Unit& unit, std::uint32_t number,
                                              const RecordedWriter& writer) {
  auto& replica = unit.controllers[writer.index];
  if (!replica) {
    replica = std::make_unique<ControllerReplica>(
        number, writer.guid, unit.inputs, findings_.differences,
        ControllerReplica::Options{options_.from_step, options_.other_settings.has_value()});
    if (options_.watch)
      replica->watch = [this, number](const Measurement& sample, const Modulation& answer,
                                      const Controller& controller) {
        options_.watch(number, sample, answer, controller);
      };
  }
  if (replica->is_configured()) return *replica;
  if (Process* process = process_of(number, "controller", writer.participant())) {
    process->taken = true;
    replica->configure(controller_configuration(options_.other_settings.value_or(process->settings)),
                       process->build);
  }
  return *replica;
}

GatewayReplica& Reexecution::gateway_of(Unit& unit, std::uint32_t number, const RecordedWriter& writer) {
  const std::string participant = writer.participant();
  GatewayReplica& replica = unit.gateways.try_emplace(participant, number, participant).first->second;
  if (replica.is_configured()) return replica;
  if (Process* process = process_of(number, "gateway", participant)) {
    process->taken = true;
    const Settings& settings = options_.other_settings.value_or(process->settings);
    replica.configure(arbiter_configuration(settings), !settings.gateway.journal.empty(), process->build);
  }
  return replica;
}

// What a what-if needs to know of the loop. A reference that is heard later than it was used is looked up
// then.
void Reexecution::note_loop(Unit& unit, const Modulation& answer) {
  if (answer.step > unit.loop.last_step + 1)
    unit.loop.unanswered.push_back({unit.loop.last_step + 1, answer.step - 1});
  unit.loop.last_step = std::max(unit.loop.last_step, answer.step);
  if (answer.newest_reference_id == unit.newest_reference) return;
  unit.newest_reference = answer.newest_reference_id;
  Reference named;
  named.id = answer.newest_reference_id;
  unit.loop.accepted.emplace_back(answer.step, named);
}

// Whether an answer was used shows in the sample that follows it: the unit holds, or has tripped for one hold
// too many. Steps between two samples were missed by the plant, and all held. Of a unit that has tripped it
// is all the same.
void Reexecution::note_holds(Unit& unit, const Measurement& sample) {
  if (sample.step <= unit.newest_sample.step) return;
  const Measurement before = std::exchange(unit.newest_sample, sample);
  const bool has_missed = sample.step > before.step + 1;
  const bool was_held =
      sample.state == UnitState::holding ||
      (sample.state == UnitState::tripped && (before.state != UnitState::running || has_missed));
  if (!was_held) return;
  auto& held = unit.loop.held;
  if (!held.empty() && held.back().last + 1 == before.step)
    held.back().last = sample.step - 1;
  else
    held.push_back({before.step, sample.step - 1});
}

void Reexecution::finish() {
  check_units();
  GatewayReplica::Strays strays;
  for (const auto& [number, unit] : units_) {
    strays.requests.insert(unit.requests.begin(), unit.requests.end());
    if (unit.gateways.size() == 1 && !unit.gateways.begin()->second.is_configured())
      for (const auto& [id, reference] : unit.inputs.references) strays.references.push_back(reference);
  }
  for (auto& [number, unit] : units_) {
    RecordedLoop& loop = unit.loop;
    std::erase_if(loop.accepted,
                  [&heard = unit.inputs.references](const auto& a) { return heard.count(a.second.id) == 0; });
    for (auto& [step, reference] : loop.accepted) reference = unit.inputs.references.at(reference.id);
    loop.plants = unit.inputs.plants.size();
    if (loop.plants > 0) loop.first_step = unit.inputs.plants.front().first_step;
    for (const Process& process : processes_)
      if (process.unit == number && process.service == "plant") loop.plant = process.settings;
    findings_.loops.emplace(number, loop);
    for (auto& [index, replica] : unit.controllers) {
      replica->process(true);
      findings_.controllers.push_back(replica->findings());
    }
    for (auto& [participant, gateway] : unit.gateways) {
      gateway.process(unit.inputs, unit.requests, strays, findings_.differences);
      findings_.gateways.push_back(gateway.findings());
    }
  }
}

}  // namespace weakgrid
