// Wire ↔ domain: translates each message of weakgrid.idl and does nothing else.
// decode gives false for what no correct peer sends: an unknown flag or enumerator, a time that is not
// step·period.
#pragma once

#include "controller/controller.hpp"
#include "gateway/arbiter.hpp"
#include "plant/model.hpp"
#include "services/runtime/messages.hpp"
#include "weakgrid.h"
#include "weakgridPubSubTypes.h"

namespace weakgrid {

enum class QosClass : std::uint8_t {
  sample,   ///< best effort, volatile, the newest
  command,  ///< reliable, volatile, all within a bound
  state,    ///< reliable, transient local, the last one stands
};

/// Of each message: its wire type, its topic and how it travels.
template <class Message>
struct Topic;

#define WEAKGRID_TOPIC(Message, WireType, name_, class_) \
  template <>                                            \
  struct Topic<Message> {                                \
    using Wire = wire::WireType;                         \
    using Type = wire::WireType##PubSubType;             \
    static constexpr const char* name = name_;           \
    static constexpr QosClass qos = QosClass::class_;    \
  };
WEAKGRID_TOPIC(Measurement, Measurement, "weakgrid/measurement", sample)
WEAKGRID_TOPIC(Modulation, Modulation, "weakgrid/modulation", sample)
WEAKGRID_TOPIC(Request, SetpointRequest, "weakgrid/setpoint_request", command)
WEAKGRID_TOPIC(DecisionMessage, SetpointDecision, "weakgrid/setpoint_decision", command)
WEAKGRID_TOPIC(Envelope, Envelope, "weakgrid/envelope", state)
WEAKGRID_TOPIC(Reference, Reference, "weakgrid/reference", state)
WEAKGRID_TOPIC(Operation, Operation, "weakgrid/operation", command)
WEAKGRID_TOPIC(ControllerState, ControllerState, "weakgrid/controller_state", sample)
WEAKGRID_TOPIC(Health, Health, "weakgrid/health", state)
WEAKGRID_TOPIC(Manifest, Manifest, "weakgrid/manifest", state)
#undef WEAKGRID_TOPIC

/// Every message that travels, for what is instantiated for each.
#define WEAKGRID_MESSAGES(DO) \
  DO(Measurement)             \
  DO(Modulation)              \
  DO(Request)                 \
  DO(DecisionMessage) DO(Reference) DO(Operation) DO(ControllerState) DO(Health) DO(Manifest) DO(Envelope)

void encode(const Measurement& message, wire::Measurement& out);
void encode(const Modulation& message, wire::Modulation& out);
void encode(const Request& message, wire::SetpointRequest& out);
void encode(const DecisionMessage& message, wire::SetpointDecision& out);
void encode(const Envelope& message, wire::Envelope& out);
void encode(const Reference& message, wire::Reference& out);
void encode(const Operation& message, wire::Operation& out);
void encode(const ControllerState& message, wire::ControllerState& out);
void encode(const Health& message, wire::Health& out);
void encode(const Manifest& message, wire::Manifest& out);

[[nodiscard]] bool decode(const wire::Measurement& in, Measurement& message);
[[nodiscard]] bool decode(const wire::Modulation& in, Modulation& message);
[[nodiscard]] bool decode(const wire::SetpointRequest& in, Request& message);
[[nodiscard]] bool decode(const wire::SetpointDecision& in, DecisionMessage& message);
[[nodiscard]] bool decode(const wire::Envelope& in, Envelope& message);
[[nodiscard]] bool decode(const wire::Reference& in, Reference& message);
[[nodiscard]] bool decode(const wire::Operation& in, Operation& message);
[[nodiscard]] bool decode(const wire::ControllerState& in, ControllerState& message);
[[nodiscard]] bool decode(const wire::Health& in, Health& message);
[[nodiscard]] bool decode(const wire::Manifest& in, Manifest& message);

}  // namespace weakgrid
