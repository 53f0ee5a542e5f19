// What the classes of topics ask of DDS: the one place that sets reliability, history and memory.
#pragma once

#include <algorithm>
#include <fastdds/dds/publisher/qos/DataWriterQos.hpp>
#include <fastdds/dds/subscriber/qos/DataReaderQos.hpp>

#include "services/runtime/fastdds_version.hpp"
#include "services/runtime/settings.hpp"
#include "services/runtime/wire.hpp"

namespace weakgrid {

// Instances of one topic that one process may meet: 64 units, each with eight services that say their health.
// More are refused by the middleware.
inline constexpr int max_instances = 512;
// What a loop, a command and a state topic ask of DDS; the same for both ends.
template <class Message, class Qos>
void apply(bool is_reader, LoopTransport loop, Qos& qos) {
  const QosClass qos_class = Topic<Message>::qos;
  const bool keyed = is_keyed(typename Topic<Message>::Type());
  // Fast DDS shares memory for types without a key only: those of the loop.
  const bool shares = !keyed && loop == LoopTransport::data_sharing;
  if (shares)
    qos.data_sharing().automatic();
  else
    qos.data_sharing().off();
  switch (qos_class) {
    case QosClass::sample:
      // Best effort: a late sample is worthless, and reliability costs allocations at each write.
      qos.reliability().kind = dds::BEST_EFFORT_RELIABILITY_QOS;
      qos.durability().kind = dds::VOLATILE_DURABILITY_QOS;
      qos.history().kind = dds::KEEP_LAST_HISTORY_QOS;
      // A reader that shares the writer's memory reads there: what is overwritten is lost.
      qos.history().depth = is_reader || shares ? 8 : 1;
      break;
    case QosClass::command:
      qos.reliability().kind = dds::RELIABLE_RELIABILITY_QOS;
      // The writer keeps what it wrote for a recorder that hears of it late; whoever acts on it must not be
      // late.
      qos.durability().kind = is_reader ? dds::VOLATILE_DURABILITY_QOS : dds::TRANSIENT_LOCAL_DURABILITY_QOS;
      qos.history().kind = dds::KEEP_ALL_HISTORY_QOS;
      break;
    case QosClass::state:
      qos.reliability().kind = dds::RELIABLE_RELIABILITY_QOS;
      qos.durability().kind = dds::TRANSIENT_LOCAL_DURABILITY_QOS;
      qos.history().kind = dds::KEEP_LAST_HISTORY_QOS;
      qos.history().depth = 1;
      break;
  }
  const int per_instance = qos_class == QosClass::command ? 1024 : qos.history().depth;
  const int instances = keyed ? max_instances : 1;
  qos.resource_limits().max_instances = instances;
  qos.resource_limits().max_samples_per_instance = per_instance;
  qos.resource_limits().max_samples = instances * per_instance;
  qos.resource_limits().allocated_samples = std::min(per_instance, 64);
  qos.endpoint().history_memory_policy = qos_class == QosClass::sample
                                             ? rtps::PREALLOCATED_MEMORY_MODE
                                             : rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
}

}  // namespace weakgrid
