/* Somebody else's program on the bus: Cyclone DDS, C, and what its own compiler makes of weakgrid.idl. Reads every topic
 * of a unit, asks for a setpoint, and says in one line of JSON for each topic what it has seen.
 *
 *   cyclone_peer DOMAIN UNIT P Q SECONDS
 *
 * exit status: 0 every topic was heard and the setpoint was accepted; 1 not within so many seconds; 2 bad usage;
 * 3 DDS failed */
#include <dds/dds.h>
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "weakgrid.h"

/* Loopback does no multicast: peers are told. */
static const char* const configuration =
    "<General><Interfaces><NetworkInterface address=\"127.0.0.1\"/></Interfaces>"
    "<AllowMulticast>false</AllowMulticast></General>"
    "<Discovery><ParticipantIndex>auto</ParticipantIndex>"
    "<Peers><Peer Address=\"127.0.0.1\"/></Peers></Discovery>"
    "<Tracing><Verbosity>none</Verbosity></Tracing>";

/* As qos.hpp of the services: best effort or reliable, with or without what was said before. */
enum qos_class { SAMPLE, COMMAND, STATE };

struct topic {
  const char* name;
  const dds_topic_descriptor_t* type;
  enum qos_class qos_class;
  dds_entity_t reader;
  uint64_t count;
};

enum { MEASUREMENT, MODULATION, REQUEST, DECISION, ENVELOPE, REFERENCE, OPERATION, CONTROLLER_STATE, HEALTH, MANIFEST,
       TOPICS };

static struct topic topics[TOPICS] = {
    {"weakgrid/measurement", &weakgrid_wire_Measurement_desc, SAMPLE, 0, 0},
    {"weakgrid/modulation", &weakgrid_wire_Modulation_desc, SAMPLE, 0, 0},
    {"weakgrid/setpoint_request", &weakgrid_wire_SetpointRequest_desc, COMMAND, 0, 0},
    {"weakgrid/setpoint_decision", &weakgrid_wire_SetpointDecision_desc, COMMAND, 0, 0},
    {"weakgrid/envelope", &weakgrid_wire_Envelope_desc, STATE, 0, 0},
    {"weakgrid/reference", &weakgrid_wire_Reference_desc, STATE, 0, 0},
    {"weakgrid/operation", &weakgrid_wire_Operation_desc, COMMAND, 0, 0},
    {"weakgrid/controller_state", &weakgrid_wire_ControllerState_desc, SAMPLE, 0, 0},
    {"weakgrid/health", &weakgrid_wire_Health_desc, STATE, 0, 0},
    {"weakgrid/manifest", &weakgrid_wire_Manifest_desc, STATE, 0, 0},
};

static dds_entity_t made(dds_entity_t entity, const char* what) {
  if (entity >= 0) return entity;
  fprintf(stderr, "cyclone_peer: %s cannot be made: %s\n", what, dds_strretcode(-entity));
  exit(3);
}

static dds_qos_t* qos_of(enum qos_class qos_class) {
  dds_qos_t* qos = dds_create_qos();
  dds_qset_reliability(qos, qos_class == SAMPLE ? DDS_RELIABILITY_BEST_EFFORT : DDS_RELIABILITY_RELIABLE, DDS_SECS(1));
  dds_qset_durability(qos, qos_class == STATE ? DDS_DURABILITY_TRANSIENT_LOCAL : DDS_DURABILITY_VOLATILE);
  dds_qset_history(qos, qos_class == COMMAND ? DDS_HISTORY_KEEP_ALL : DDS_HISTORY_KEEP_LAST, 1);
  return qos;
}

static double seconds_now(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* One sample of a topic. What it says is not trusted to be of our unit. */
static bool take(struct topic* topic, void** sample) {
  dds_sample_info_t info;
  *sample = NULL;
  if (dds_take(topic->reader, sample, &info, 1, 1) <= 0) return false;
  if (info.valid_data) ++topic->count;
  return true;
}

static void give_back(const struct topic* topic, void** sample) { dds_return_loan(topic->reader, sample, 1); }

int main(int argc, char** argv) {
  if (argc != 6) {
    fprintf(stderr, "usage: cyclone_peer DOMAIN UNIT P Q SECONDS\n");
    return 2;
  }
  const dds_domainid_t domain = (dds_domainid_t)strtoul(argv[1], NULL, 10);
  const uint32_t unit = (uint32_t)strtoul(argv[2], NULL, 10);
  const double p = strtod(argv[3], NULL), q = strtod(argv[4], NULL), patience = strtod(argv[5], NULL);

  made(dds_create_domain(domain, configuration), "domain");
  const dds_entity_t participant = made(dds_create_participant(domain, NULL, NULL), "participant");
  dds_entity_t request_topic = 0;
  for (int k = 0; k < TOPICS; ++k) {
    struct topic* t = &topics[k];
    dds_qos_t* qos = qos_of(t->qos_class);
    const dds_entity_t topic = made(dds_create_topic(participant, t->type, t->name, NULL, NULL), t->name);
    t->reader = made(dds_create_reader(participant, topic, qos, NULL), t->name);
    if (k == REQUEST) request_topic = topic;
    dds_delete_qos(qos);
  }
  dds_qos_t* qos = qos_of(COMMAND);
  const dds_entity_t writer = made(dds_create_writer(participant, request_topic, qos, NULL), "writer");
  dds_delete_qos(qos);

  weakgrid_wire_SetpointRequest request = {0};
  request.unit = unit;
  request.client = ((uint64_t)dds_time() << 1) | 1;
  request.id = 1;
  request.given = weakgrid_wire_GIVEN_ACTIVE_POWER | weakgrid_wire_GIVEN_REACTIVE_POWER;
  request.kind = weakgrid_wire_SET;
  request.source = weakgrid_wire_SOURCE_OPERATION;
  request.active_power = p;
  request.reactive_power = q;
  strcpy(request.name, "cyclone");

  bool answered = false, accepted = false, is_followed = false;
  uint32_t reference_id = 0;
  double active_power = 0.0, reactive_power = 0.0, asked_at = -1.0;
  const double deadline = seconds_now() + patience;
  for (bool all = false; !all && seconds_now() < deadline; dds_sleepfor(DDS_MSECS(1))) {
    /* A repeat is answered with the same decision: so it is asked until it is answered. */
    dds_publication_matched_status_t matched;
    if (!answered && seconds_now() > asked_at + 0.5 &&
        dds_get_publication_matched_status(writer, &matched) == DDS_RETCODE_OK && matched.current_count > 0) {
      dds_write(writer, &request);
      asked_at = seconds_now();
    }
    void* sample;
    for (int k = 0; k < TOPICS; ++k)
      for (int drained = 0; drained < 64 && take(&topics[k], &sample); ++drained) {
        if (k == DECISION) {
          const weakgrid_wire_SetpointDecision* d = sample;
          if (d->unit == unit && d->client == request.client && d->id == request.id) {
            answered = true;
            accepted = d->verdict == weakgrid_wire_ACCEPTED;
            reference_id = d->reference_id;
            if (!accepted) fprintf(stderr, "cyclone_peer: refused: %s\n", d->text);
          }
        } else if (k == MEASUREMENT) {
          const weakgrid_wire_Measurement* m = sample;
          /* s = v_p conj(i) */
          active_power = m->pcc_voltage_alpha * m->current_alpha + m->pcc_voltage_beta * m->current_beta;
          reactive_power = m->pcc_voltage_beta * m->current_alpha - m->pcc_voltage_alpha * m->current_beta;
          const double dp = active_power - p, dq = reactive_power - q;
          is_followed = accepted && m->unit == unit && m->reference_id == reference_id && dp * dp + dq * dq < 1e-6;
        }
        give_back(&topics[k], &sample);
      }
    all = answered && (!accepted || is_followed);
    for (int k = 0; k < TOPICS; ++k) all = all && topics[k].count > 0;
  }

  bool all_heard = true;
  for (int k = 0; k < TOPICS; ++k) {
    printf("{\"topic\": \"%s\", \"count\": %" PRIu64 "}\n", topics[k].name, topics[k].count);
    all_heard = all_heard && topics[k].count > 0;
  }
  printf("{\"answered\": %s, \"accepted\": %s, \"reference_id\": %" PRIu32 ", \"p\": %.6f, \"q\": %.6f}\n",
         answered ? "true" : "false", accepted ? "true" : "false", reference_id, active_power, reactive_power);
  dds_delete(participant);
  return all_heard && is_followed ? 0 : 1;
}
