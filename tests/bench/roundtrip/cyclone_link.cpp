// Cyclone DDS over UDP on loopback, laid out and set as the raw Fast DDS of fastdds_link.cpp.
#include <dds/dds.h>

#include "tests/bench/roundtrip/link.hpp"
#include "weakgrid.h"

namespace weakgrid::bench {
namespace {

// Loopback does no multicast here: peers are told.
constexpr const char* configuration =
    "<General><Interfaces><NetworkInterface address=\"127.0.0.1\"/></Interfaces>"
    "<AllowMulticast>false</AllowMulticast></General>"
    "<Discovery><ParticipantIndex>auto</ParticipantIndex>"
    "<Peers><Peer Address=\"127.0.0.1\"/></Peers></Discovery>"
    "<Tracing><Verbosity>none</Verbosity></Tracing>";

dds_entity_t made(dds_entity_t entity, const char* what) {
  if (entity < 0)
    throw LinkError(std::string("Cyclone DDS: ") + what + " cannot be made: " + dds_strretcode(-entity));
  return entity;
}

// Calls take(entity's argument) from the thread that receives.
class End {
 public:
  using Listen = void (*)(dds_entity_t reader, void* argument);
  End(const Place& place, const dds_topic_descriptor_t& out_type, const char* out_topic,
      const dds_topic_descriptor_t& in_type, const char* in_topic, Listen listen, void* argument) {
    domain_ = made(dds_create_domain(place.domain, configuration), "domain");
    const dds_entity_t participant =
        made(dds_create_participant(place.domain, nullptr, nullptr), "participant");
    dds_qos_t* qos = dds_create_qos();
    dds_qset_reliability(qos, DDS_RELIABILITY_BEST_EFFORT, 0);
    dds_qset_durability(qos, DDS_DURABILITY_VOLATILE);
    dds_qset_history(qos, DDS_HISTORY_KEEP_LAST, 1);
    dds_listener_t* listener = dds_create_listener(argument);
    dds_lset_data_available(listener, listen);
    const auto topic = [&](const dds_topic_descriptor_t& type, const char* name) {
      return made(dds_create_topic(participant, &type, name, nullptr, nullptr), name);
    };
    writer_ = made(dds_create_writer(participant, topic(out_type, out_topic), qos, nullptr), "writer");
    reader_ = made(dds_create_reader(participant, topic(in_type, in_topic), qos, listener), "reader");
    dds_delete_listener(listener);
    dds_delete_qos(qos);
  }
  End(const End&) = delete;
  End& operator=(const End&) = delete;

  // No call of listen comes after this.
  void close() {
    dds_set_listener(reader_, nullptr);
    dds_delete(domain_);
  }
  bool is_matched() const {
    dds_publication_matched_status_t publication;
    dds_subscription_matched_status_t subscription;
    return dds_get_publication_matched_status(writer_, &publication) == DDS_RETCODE_OK &&
           dds_get_subscription_matched_status(reader_, &subscription) == DDS_RETCODE_OK &&
           publication.current_count > 0 && subscription.current_count > 0;
  }
  dds_entity_t writer() const { return writer_; }

 private:
  dds_entity_t domain_, writer_, reader_;
};

template <class In, class Take>
void take_all(dds_entity_t reader, Take take) {
  In in;
  void* samples[] = {&in};
  dds_sample_info_t info;
  while (dds_take(reader, samples, &info, 1, 1) > 0)
    if (info.valid_data) take(in);
}

class CycloneCaller : public Caller {
 public:
  explicit CycloneCaller(const Place& place)
      : end_(place, weakgrid_wire_Measurement_desc, "sample", weakgrid_wire_Modulation_desc, "answer", listen,
             this) {}
  ~CycloneCaller() override { end_.close(); }
  bool is_matched() override { return end_.is_matched(); }
  bool exchange(std::uint64_t step, const timespec& deadline) override {
    sample_.step = step;
    dds_write(end_.writer(), &sample_);
    return handover_.wait_for(step, deadline);
  }

 private:
  static void listen(dds_entity_t reader, void* argument) {
    take_all<weakgrid_wire_Modulation>(reader, [&](const weakgrid_wire_Modulation& answer) {
      static_cast<CycloneCaller*>(argument)->handover_.give(answer.step);
    });
  }
  weakgrid_wire_Measurement sample_{};
  Handover handover_;
  End end_;
};

class CycloneEcho : public Echo {
 public:
  explicit CycloneEcho(const Place& place)
      : end_(place, weakgrid_wire_Modulation_desc, "answer", weakgrid_wire_Measurement_desc, "sample", listen,
             this) {
    writer_ = end_.writer();
  }
  ~CycloneEcho() override { end_.close(); }

 private:
  static void listen(dds_entity_t reader, void* argument) {
    auto& echo = *static_cast<CycloneEcho*>(argument);
    take_all<weakgrid_wire_Measurement>(reader, [&](const weakgrid_wire_Measurement& sample) {
      echo.answer_.step = sample.step;
      // A sample that comes before the constructor has ended is asked again.
      if (const dds_entity_t writer = echo.writer_; writer != 0) dds_write(writer, &echo.answer_);
    });
  }
  weakgrid_wire_Modulation answer_{};
  std::atomic<dds_entity_t> writer_{0};
  End end_;
};

std::unique_ptr<Caller> make_caller(const Place& place) { return std::make_unique<CycloneCaller>(place); }
std::unique_ptr<Echo> make_echo(const Place& place) { return std::make_unique<CycloneEcho>(place); }

}  // namespace

const Kind cyclone_udp{"cyclone_udp", make_caller, make_echo};

}  // namespace weakgrid::bench
