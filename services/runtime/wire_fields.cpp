// WireFields: see the header. The lists follow weakgrid.idl line by line; a test holds them to it.
#include "services/runtime/wire_fields.hpp"

#include <fmt/format.h>

#include <bit>

#include "services/runtime/payload_cdr.hpp"
#include "services/runtime/wire.hpp"

namespace weakgrid {

namespace {

using Value = WireField::Value;

template <class Whole>
std::enable_if_t<std::is_integral_v<Whole>, Value> value_of(Whole number) {
  if constexpr (std::is_same_v<Whole, bool>)
    return number;
  else if constexpr (std::is_signed_v<Whole>)
    return static_cast<std::int64_t>(number);
  else
    return static_cast<std::uint64_t>(number);
}
Value value_of(double number) { return number; }
template <class Text>
auto value_of(const Text& text) -> decltype(text.c_str(), Value{}) {
  return std::string(text.c_str());
}

// What no enumerator stands for is shown as the number that it is.
template <class Enum, std::size_t n>
Value enumerator(Enum value, const char* const (&names)[n]) {
  const auto number = static_cast<std::size_t>(value);
  return number < n ? std::string(names[number]) : std::to_string(number);
}

Value value_of(wire::Verdict value) {
  return enumerator(value, {"ACCEPTED", "OUTSIDE_ENVELOPE", "BAD_REQUEST", "STALE_REQUEST", "UNIT_BLOCKED",
                            "NOT_AUTHORISED", "PATH_OUTSIDE", "NOT_STABLE", "NO_SUCH_OFFER", "NOTHING_STANDS",
                            "INTERLOCKED"});
}
Value value_of(wire::RequestField value) {
  return enumerator(value,
                    {"NO_FIELD", "FIELD_CLIENT", "FIELD_ID", "FIELD_GIVEN", "FIELD_ACTIVE_POWER",
                     "FIELD_REACTIVE_POWER", "FIELD_DC_VOLTAGE", "FIELD_RAMP_S", "FIELD_EFFECTIVE_STEP",
                     "FIELD_SOURCE", "FIELD_LEASE_S", "FIELD_GRID", "FIELD_KIND"});
}
Value value_of(wire::RequestKind value) {
  return enumerator(value, {"SET", "ACCEPT", "RENEW", "TAKE", "RELEASE", "SET_GRID", "START_UNIT",
                            "STOP_UNIT", "RESET_UNIT", "REVALIDATE"});
}
Value value_of(wire::Source value) {
  return enumerator(value, {"SOURCE_TEST", "SOURCE_SCHEDULE", "SOURCE_OPERATION", "SOURCE_PROTECTION"});
}
Value value_of(wire::OfferPolicy value) {
  return enumerator(value,
                    {"MINIMUM_DISTANCE", "KEEP_ACTIVE_POWER", "KEEP_REACTIVE_POWER", "KEEP_POWER_FACTOR"});
}
Value value_of(wire::LimitName value) {
  return enumerator(value, {"STEADY_STATE", "CURRENT", "CONTROL", "CONTROL_ROUGH", "PCC_VOLTAGE_MIN",
                            "PCC_VOLTAGE_MAX", "DC_VOLTAGE_MIN", "DC_VOLTAGE_MAX", "DECAY", "TRANSIENT"});
}
Value value_of(wire::OperationKind value) {
  return enumerator(value, {"ADVANCE", "RESET_TRIP", "START", "STOP"});
}
Value value_of(wire::ServiceState value) {
  return enumerator(value, {"STARTING", "RUNNING", "WAITING", "BLOCKED_BY_TRIP", "STOPPED"});
}

template <class Sequence, class Describe>
Value sequence(const Sequence& items, Describe describe) {
  std::string text;
  for (const auto& item : items) {
    if (!text.empty()) text += ";";
    text += describe(item);
  }
  return text;
}

std::string margin_text(const wire::LimitMargin& item) {
  std::string text = to_text(value_of(item.limit())) + ":" + to_text(item.enforced());
  for (const double number : {item.margin(), item.required(), item.grid_resistance(),
                              item.grid_inductance_s(), item.grid_voltage()})
    text += ":" + to_text(number);
  return text;
}

#define FIELD(name) \
  { #name, value_of(m.name()) }

WireFields list(const wire::Measurement& m) {
  return {FIELD(unit),
          FIELD(period_ns),
          FIELD(flags),
          FIELD(reference_id),
          FIELD(step),
          FIELD(time_ns),
          FIELD(pcc_voltage_alpha),
          FIELD(pcc_voltage_beta),
          FIELD(current_alpha),
          FIELD(current_beta),
          FIELD(dc_voltage),
          FIELD(source_power)};
}

WireFields list(const wire::Modulation& m) {
  return {FIELD(unit),
          FIELD(period_ns),
          FIELD(reference_id),
          FIELD(status),
          FIELD(newest_reference_id),
          FIELD(measurement_fingerprint),
          FIELD(step),
          FIELD(epoch),
          FIELD(modulation_alpha),
          FIELD(modulation_beta)};
}

WireFields list(const wire::SetpointRequest& m) {
  return {FIELD(unit),
          FIELD(given),
          FIELD(client),
          FIELD(id),
          FIELD(kind),
          FIELD(source),
          FIELD(policy),
          FIELD(token),
          FIELD(active_power),
          FIELD(reactive_power),
          FIELD(dc_voltage),
          FIELD(ramp_s),
          FIELD(lease_s),
          FIELD(effective_step),
          FIELD(grid_resistance_min),
          FIELD(grid_resistance_max),
          FIELD(grid_reactance_min),
          FIELD(grid_reactance_max),
          FIELD(grid_voltage_min),
          FIELD(grid_voltage_max),
          FIELD(name)};
}

WireFields list(const wire::SetpointDecision& m) {
  return {FIELD(unit),
          FIELD(id),
          FIELD(client),
          FIELD(kind),
          FIELD(verdict),
          FIELD(field),
          FIELD(active_power),
          FIELD(reactive_power),
          FIELD(dc_voltage),
          FIELD(reference_id),
          FIELD(renews),
          FIELD(ramp_steps),
          FIELD(steps_to_reach),
          FIELD(effective_step),
          FIELD(lease_end_step),
          FIELD(reference_active_power),
          FIELD(reference_reactive_power),
          FIELD(reference_dc_voltage),
          FIELD(fallback_active_power),
          FIELD(fallback_reactive_power),
          FIELD(fallback_dc_voltage),
          FIELD(fallback_ramp_steps),
          FIELD(offer_token),
          FIELD(offer_is_detour),
          FIELD(offer_active_power),
          FIELD(offer_reactive_power),
          FIELD(offer_dc_voltage),
          FIELD(offer_valid_until_step),
          FIELD(leaves_at_active_power),
          FIELD(leaves_at_reactive_power),
          FIELD(leaves_at_dc_voltage),
          FIELD(holder_source),
          FIELD(holder_name),
          FIELD(held_until_step),
          FIELD(decided_step),
          FIELD(standing_reference_id),
          FIELD(request_fingerprint),
          FIELD(unit_state),
          FIELD(measured_grid_voltage_min),
          FIELD(measured_grid_voltage_max),
          {"margins", sequence(m.margins(), margin_text)},
          FIELD(text)};
}

WireFields list(const wire::Envelope& m) {
  return {FIELD(unit),
          FIELD(reference_id),
          FIELD(step),
          FIELD(grid_resistance_min),
          FIELD(grid_resistance_max),
          FIELD(grid_reactance_min),
          FIELD(grid_reactance_max),
          FIELD(grid_voltage_min),
          FIELD(grid_voltage_max),
          FIELD(active_power),
          FIELD(reactive_power),
          FIELD(dc_voltage),
          FIELD(lease_end_step),
          FIELD(fallen_back),
          FIELD(fallback_holds),
          FIELD(holder_source),
          FIELD(holder_name),
          FIELD(held_until_step),
          {"margins", sequence(m.margins(), margin_text)}};
}

WireFields list(const wire::Reference& m) {
  return {FIELD(unit),
          FIELD(id),
          FIELD(renews),
          FIELD(ramp_steps),
          FIELD(active_power),
          FIELD(reactive_power),
          FIELD(dc_voltage),
          FIELD(effective_step),
          FIELD(lease_end_step),
          FIELD(fallback_active_power),
          FIELD(fallback_reactive_power),
          FIELD(fallback_dc_voltage),
          FIELD(fallback_ramp_steps)};
}

WireFields list(const wire::Operation& m) {
  return {FIELD(unit), FIELD(client), FIELD(id), FIELD(kind), FIELD(until_step)};
}

WireFields list(const wire::Health& m) {
  return {FIELD(unit),
          FIELD(service),
          FIELD(instance),
          FIELD(state),
          FIELD(step),
          FIELD(reference_id),
          FIELD(wall_time_ns),
          {"counters", sequence(m.counters(),
                                [](const wire::Counter& item) {
                                  return std::string(item.name().c_str()) + ":" +
                                         std::to_string(item.value());
                                })},
          FIELD(digest),
          FIELD(text),
          {"timings", sequence(m.timings(), [](const wire::StageTiming& item) {
             std::string text = item.stage().c_str();
             for (const std::uint64_t value : {item.count(), item.p50_ns(), item.p99_ns(), item.p999_ns(),
                                               item.max_ns(), item.sum_ns()})
               text += ":" + std::to_string(value);
             text += ":";
             for (const std::uint64_t value : item.at_most())
               text += (text.back() == ':' ? "" : "/") + std::to_string(value);
             return text;
           })}};
}

WireFields list(const wire::Manifest& m) {
  return {FIELD(unit),
          FIELD(service),
          FIELD(instance),
          FIELD(build),
          FIELD(settings),
          {"constants", sequence(m.constants(),
                                 [](const wire::Constant& item) {
                                   return std::string(item.name().c_str()) + ":" + to_text(item.value());
                                 })},
          FIELD(digest)};
}

#define RAMP(name)                                                                                          \
  {#name ".from", m.name().from()}, {#name ".to", m.name().to()}, {#name ".slope", m.name().slope()},       \
      {#name ".start_step", value_of(m.name().start_step())}, {#name ".steps", value_of(m.name().steps())}, \
  {                                                                                                         \
#name ".slope_steps", value_of(m.name().slope_steps())                                                  \
  }

#define PART(name, field) \
  { #name "." #field, value_of(m.name().field()) }
#define REFERENCE(name)                                                                                   \
  PART(name, unit), PART(name, id), PART(name, renews), PART(name, ramp_steps), PART(name, active_power), \
      PART(name, reactive_power), PART(name, dc_voltage), PART(name, effective_step),                     \
      PART(name, lease_end_step), PART(name, fallback_active_power), PART(name, fallback_reactive_power), \
      PART(name, fallback_dc_voltage), PART(name, fallback_ramp_steps)

WireFields list(const wire::ControllerState& m) {
  return {FIELD(unit),
          FIELD(older_in_a_row),
          FIELD(step),
          FIELD(started),
          FIELD(fallen_back),
          FIELD(accepted_reference_id),
          FIELD(order_id),
          FIELD(reference_id),
          FIELD(newest_reference_id),
          FIELD(status),
          FIELD(measurement_fingerprint),
          FIELD(period_ns),
          FIELD(modulation_alpha),
          FIELD(modulation_beta),
          FIELD(filtered_pcc_voltage_alpha),
          FIELD(filtered_pcc_voltage_beta),
          FIELD(pcc_voltage_alpha),
          FIELD(pcc_voltage_beta),
          FIELD(energy_error),
          FIELD(reactive_energy_error),
          FIELD(energy_error_integral),
          FIELD(reactive_energy_error_integral),
          FIELD(reactive_power_error),
          FIELD(reactive_energy_error_kept),
          FIELD(active_power_reference),
          FIELD(modulation_before_alpha),
          FIELD(modulation_before_beta),
          FIELD(modulation_in_force_alpha),
          FIELD(modulation_in_force_beta),
          FIELD(command_alpha),
          FIELD(command_beta),
          RAMP(reactive_power_ramp),
          RAMP(dc_voltage_ramp),
          REFERENCE(in_force),
          REFERENCE(pending)};
}

#undef REFERENCE
#undef PART
#undef RAMP
#undef FIELD

// use<Type>() with the type support that has this name.
template <class Use>
void with_type(std::string_view type, Use use) {
#define TRY(Message) \
  if (type == "weakgrid::wire::" #Message) return use.template operator()<wire::Message##PubSubType>();
  TRY(Measurement)
  TRY(Modulation)
  TRY(SetpointRequest)
  TRY(SetpointDecision)
  TRY(Envelope)
  TRY(Reference)
  TRY(Operation)
  TRY(ControllerState)
  TRY(Health)
  TRY(Manifest)
#undef TRY
}

}  // namespace

template <class Message>
WireFields fields_of(std::uint32_t unit, const Message& message) {
  typename Topic<Message>::Wire wire;
  wire.unit(unit);
  encode(message, wire);
  return list(wire);
}

std::optional<WireFields> fields_of_payload(std::string_view type, std::span<const std::byte> payload) {
  std::optional<WireFields> fields;
  with_type(type, [&]<class Type>() {
    typename Type::type wire;
    if (deserialize<Type>(payload, wire)) fields = list(wire);
  });
  return fields;
}

std::vector<std::string> field_names(std::string_view type) {
  std::vector<std::string> names;
  with_type(type, [&]<class Type>() {
    for (const WireField& field : list(typename Type::type{})) names.emplace_back(field.name);
  });
  return names;
}

std::string to_text(const Value& value) {
  return std::visit(
      [](const auto& v) {
        if constexpr (std::is_same_v<std::decay_t<decltype(v)>, bool>)
          return std::string(v ? "1" : "0");
        else
          return fmt::format("{}", v);
      },
      value);
}

std::string to_hex(const Value& value) {
  if (const auto* number = std::get_if<double>(&value))
    return fmt::format("{:#018x}", std::bit_cast<std::uint64_t>(*number));
  if (const auto* text = std::get_if<std::string>(&value)) {
    std::string hex = "0x";
    for (const char byte : *text) hex += fmt::format("{:02x}", static_cast<unsigned char>(byte));
    return hex;
  }
  if (const auto* number = std::get_if<std::int64_t>(&value))
    return fmt::format("{:#x}", static_cast<std::uint64_t>(*number));
  if (const auto* flag = std::get_if<bool>(&value)) return *flag ? "0x1" : "0x0";
  return fmt::format("{:#x}", std::get<std::uint64_t>(value));
}

bool is_same(const Value& a, const Value& b) {
  const auto* x = std::get_if<double>(&a);
  const auto* y = std::get_if<double>(&b);
  if (x != nullptr && y != nullptr)
    return std::bit_cast<std::uint64_t>(*x) == std::bit_cast<std::uint64_t>(*y);
  return a == b;
}

#define WEAKGRID_INSTANTIATE(Message) template WireFields fields_of<Message>(std::uint32_t, const Message&);
WEAKGRID_MESSAGES(WEAKGRID_INSTANTIATE)
#undef WEAKGRID_INSTANTIATE

}  // namespace weakgrid
