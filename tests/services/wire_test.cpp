// Wire ↔ domain: what is sent is what is received, bit for bit, through the wire type and its bytes; what no
// correct peer sends is refused. No network.
#include "services/runtime/wire.hpp"

#include <gtest/gtest.h>

#include <bit>
#include <limits>
#include <random>

#include "services/runtime/payload_cdr.hpp"
#include "services/runtime/wire_fields.hpp"

namespace weakgrid {
namespace {

constexpr int rounds = 2000;

// Seeded per test; bits without a pattern, and now and then what is special about a type.
class Random {
 public:
  template <class Integer>
  Integer whole() {
    constexpr Integer special[] = {Integer{0}, Integer{1}, std::numeric_limits<Integer>::max(),
                                   std::numeric_limits<Integer>::min()};
    const std::uint64_t bits = generator_();
    return bits % 8 == 0 ? special[bits / 8 % 4] : static_cast<Integer>(generator_());
  }
  double real() {
    constexpr double special[] = {0.0,
                                  -0.0,
                                  std::numeric_limits<double>::infinity(),
                                  std::numeric_limits<double>::quiet_NaN(),
                                  std::numeric_limits<double>::denorm_min(),
                                  -std::numeric_limits<double>::max()};
    const std::uint64_t bits = generator_();
    return bits % 4 == 0 ? special[bits / 4 % 6] : std::bit_cast<double>(generator_());
  }
  /// 0 … last.
  std::uint32_t up_to(std::uint32_t last) {
    return static_cast<std::uint32_t>(generator_() % (last + std::uint64_t{1}));
  }
  bool flag() { return generator_() % 2 == 0; }
  std::string text(std::uint32_t most) {
    std::string text(up_to(most), ' ');
    for (char& c : text) c = static_cast<char>(1 + up_to(254));  // any byte but the end
    return text;
  }

 private:
  std::mt19937_64 generator_{20240229};
};

std::uint64_t bits(double x) { return std::bit_cast<std::uint64_t>(x); }

#define EXPECT_SAME_BITS(a, b) EXPECT_EQ(bits(a), bits(b))
#define EXPECT_SAME_VECTOR(a, b)    \
  EXPECT_SAME_BITS((a).re, (b).re); \
  EXPECT_SAME_BITS((a).im, (b).im)

// Through the wire type, its bytes, and back.
template <class Message>
Message sent_and_received(const Message& message) {
  typename Topic<Message>::Wire out, in;
  encode(message, out);
  using Type = typename Topic<Message>::Type;
  const std::vector<std::byte> bytes = serialize<Type>(out);
  EXPECT_TRUE(deserialize<Type>(bytes, in));
  Message received;
  EXPECT_TRUE(decode(in, received));
  return received;
}

Measurement random_measurement(Random& random) {
  Measurement m;
  m.step = random.whole<std::uint64_t>();
  m.timing.period_ns = random.whole<std::uint32_t>();
  m.timing.delay = random.flag() ? 1 : 0;
  m.timing.hold = random.flag() ? Hold::still : Hold::turning;
  m.timing.sampling = random.flag() ? Sampling::period_mean : Sampling::instantaneous;
  m.reference_id = random.whole<std::uint32_t>();
  m.state = static_cast<UnitState>(random.up_to(5));
  m.blocked = is_blocked(m.state);
  m.fallback = random.flag();
  m.v_p = {random.real(), random.real()};
  m.i = {random.real(), random.real()};
  m.v_c = random.real();
  m.p_i = random.real();
  return m;
}

TEST(Wire, MeasurementIsReceivedAsSentBitForBit) {
  Random random;
  for (int n = 0; n < rounds; ++n) {
    const Measurement sent = random_measurement(random);
    const Measurement received = sent_and_received(sent);
    EXPECT_EQ(received.step, sent.step);
    EXPECT_TRUE(received.timing == sent.timing);
    EXPECT_EQ(received.reference_id, sent.reference_id);
    EXPECT_EQ(received.blocked, sent.blocked);
    EXPECT_EQ(received.fallback, sent.fallback);
    EXPECT_EQ(received.state, sent.state);
    EXPECT_SAME_VECTOR(received.v_p, sent.v_p);
    EXPECT_SAME_VECTOR(received.i, sent.i);
    EXPECT_SAME_BITS(received.v_c, sent.v_c);
    EXPECT_SAME_BITS(received.p_i, sent.p_i);
    ASSERT_FALSE(HasFailure()) << "round " << n;
  }
}

TEST(Wire, ModulationIsReceivedAsSentBitForBit) {
  Random random;
  for (int n = 0; n < rounds; ++n) {
    const Modulation sent{.step = random.whole<std::uint64_t>(),
                          .period_ns = random.whole<std::uint32_t>(),
                          .reference_id = random.whole<std::uint32_t>(),
                          .status = random.whole<std::uint32_t>(),
                          .newest_reference_id = random.whole<std::uint32_t>(),
                          .measurement_fingerprint = random.whole<std::uint32_t>(),
                          .mu = {random.real(), random.real()}};
    const Modulation received = sent_and_received(sent);
    EXPECT_EQ(received.step, sent.step);
    EXPECT_EQ(received.period_ns, sent.period_ns);
    EXPECT_EQ(received.reference_id, sent.reference_id);
    EXPECT_EQ(received.status, sent.status);
    EXPECT_EQ(received.newest_reference_id, sent.newest_reference_id);
    EXPECT_EQ(received.measurement_fingerprint, sent.measurement_fingerprint);
    EXPECT_SAME_VECTOR(received.mu, sent.mu);
    ASSERT_FALSE(HasFailure()) << "round " << n;
  }
}

Holder random_holder(Random& random) {
  Holder holder{static_cast<Source>(random.up_to(3)), {}};
  const std::string text = random.text(23);
  std::copy(text.begin(), text.end(), holder.name.text.begin());
  return holder;
}

TEST(Wire, RequestIsReceivedAsSentBitForBit) {
  Random random;
  for (int n = 0; n < rounds; ++n) {
    Request sent;
    sent.client = random.whole<std::uint64_t>();
    sent.id = random.whole<std::uint32_t>();
    sent.kind = static_cast<RequestKind>(random.up_to(9));
    sent.who = random_holder(random);
    sent.policy = static_cast<Policy>(random.up_to(3));
    sent.token = random.whole<std::uint32_t>();
    sent.given = random.whole<std::uint32_t>();
    for (double* number : {&sent.p, &sent.q, &sent.v_c, &sent.ramp_s, &sent.lease_s, &sent.R_g.low,
                           &sent.R_g.high, &sent.X_g.low, &sent.X_g.high, &sent.V.low, &sent.V.high})
      *number = random.real();
    sent.effective_step = random.whole<std::uint64_t>();
    const Request received = sent_and_received(sent);
    EXPECT_EQ(fingerprint(received), fingerprint(sent));
    EXPECT_EQ(received.kind, sent.kind);
    EXPECT_EQ(received.who, sent.who);
    EXPECT_EQ(received.policy, sent.policy);
    EXPECT_EQ(received.token, sent.token);
    EXPECT_EQ(received.client, sent.client);
    EXPECT_EQ(received.id, sent.id);
    EXPECT_EQ(received.given, sent.given);
    EXPECT_SAME_BITS(received.p, sent.p);
    EXPECT_SAME_BITS(received.q, sent.q);
    EXPECT_SAME_BITS(received.v_c, sent.v_c);
    EXPECT_SAME_BITS(received.ramp_s, sent.ramp_s);
    EXPECT_EQ(received.effective_step, sent.effective_step);
    ASSERT_FALSE(HasFailure()) << "round " << n;
  }
}

Reference random_reference(Random& random) {
  return {.id = random.whole<std::uint32_t>(),
          .p = random.real(),
          .q = random.real(),
          .v_c = random.real(),
          .effective_step = random.whole<std::uint64_t>(),
          .ramp_steps = random.whole<std::uint32_t>(),
          .renews = random.whole<std::uint32_t>(),
          .lease_end_step = random.whole<std::uint64_t>(),
          .fallback_p = random.real(),
          .fallback_q = random.real(),
          .fallback_v_c = random.real(),
          .fallback_ramp_steps = random.whole<std::uint32_t>()};
}

void expect_same(const Reference& received, const Reference& sent) {
  EXPECT_EQ(received.id, sent.id);
  EXPECT_SAME_BITS(received.p, sent.p);
  EXPECT_SAME_BITS(received.q, sent.q);
  EXPECT_SAME_BITS(received.v_c, sent.v_c);
  EXPECT_EQ(received.effective_step, sent.effective_step);
  EXPECT_EQ(received.ramp_steps, sent.ramp_steps);
  EXPECT_EQ(received.renews, sent.renews);
  EXPECT_EQ(received.lease_end_step, sent.lease_end_step);
  EXPECT_SAME_BITS(received.fallback_p, sent.fallback_p);
  EXPECT_SAME_BITS(received.fallback_q, sent.fallback_q);
  EXPECT_SAME_BITS(received.fallback_v_c, sent.fallback_v_c);
  EXPECT_EQ(received.fallback_ramp_steps, sent.fallback_ramp_steps);
}

TEST(Wire, ReferenceIsReceivedAsSentBitForBit) {
  Random random;
  for (int n = 0; n < rounds; ++n) {
    const Reference sent = random_reference(random);
    expect_same(sent_and_received(sent), sent);
    ASSERT_FALSE(HasFailure()) << "round " << n;
  }
}

DecisionMessage random_decision(Random& random) {
  DecisionMessage m;
  m.decision.client = random.whole<std::uint64_t>();
  m.decision.id = random.whole<std::uint32_t>();
  m.decision.kind = static_cast<RequestKind>(random.up_to(9));
  m.decision.verdict = static_cast<Verdict>(random.up_to(10));
  m.decision.field = static_cast<Field>(random.up_to(12));
  m.decision.unit_state = static_cast<UnitState>(random.up_to(5));
  m.decision.measured_V = {random.real(), random.real()};
  m.decision.setpoint = {random.real(), random.real(), random.real()};
  m.decision.leaves_at = {random.real(), random.real(), random.real()};
  m.decision.holder = random_holder(random);
  m.decision.held_until_step = random.whole<std::uint64_t>();
  m.decision.steps_to_reach = random.whole<std::uint32_t>();
  for (std::uint32_t n = random.up_to(margin_count); n > 0; --n)
    m.decision.margins.add({static_cast<Limit>(random.up_to(9)),
                            random.flag(),
                            random.real(),
                            random.real(),
                            {random.real(), random.real(), random.real()}});
  if (random.flag())
    m.decision.offer = Offer{random.whole<std::uint32_t>() | 1,
                             {random.real(), random.real(), random.real()},
                             random.flag(),
                             random.whole<std::uint64_t>()};
  if (random.flag()) {
    m.decision.reference = random_reference(random);
    m.decision.reference->id |= 1;
  }
  m.decision.decided_step = random.whole<std::uint64_t>();
  m.decision.standing_reference_id = random.whole<std::uint32_t>();
  m.decision.request_fingerprint = random.whole<std::uint32_t>();
  m.text = random.text(255);
  return m;
}

TEST(Wire, DecisionIsReceivedAsSentBitForBit) {
  Random random;
  for (int n = 0; n < rounds; ++n) {
    const DecisionMessage sent = random_decision(random);
    const DecisionMessage received = sent_and_received(sent);
    EXPECT_EQ(received.text, sent.text);
    const Decision &in = received.decision, &out = sent.decision;
    EXPECT_EQ(in.client, out.client);
    EXPECT_EQ(in.id, out.id);
    EXPECT_EQ(in.kind, out.kind);
    EXPECT_EQ(in.unit_state, out.unit_state);
    EXPECT_SAME_BITS(in.measured_V.low, out.measured_V.low);
    EXPECT_SAME_BITS(in.measured_V.high, out.measured_V.high);
    EXPECT_EQ(in.holder, out.holder);
    EXPECT_EQ(in.held_until_step, out.held_until_step);
    EXPECT_EQ(in.steps_to_reach, out.steps_to_reach);
    EXPECT_SAME_BITS(in.leaves_at.q, out.leaves_at.q);
    ASSERT_EQ(in.offer.has_value(), out.offer.has_value());
    if (out.offer) {
      EXPECT_EQ(in.offer->token, out.offer->token);
      EXPECT_SAME_BITS(in.offer->setpoint.p, out.offer->setpoint.p);
      EXPECT_EQ(in.offer->is_detour, out.offer->is_detour);
      EXPECT_EQ(in.offer->valid_until_step, out.offer->valid_until_step);
    }
    EXPECT_EQ(in.verdict, out.verdict);
    EXPECT_EQ(in.field, out.field);
    EXPECT_EQ(in.decided_step, out.decided_step);
    EXPECT_EQ(in.standing_reference_id, out.standing_reference_id);
    EXPECT_EQ(in.request_fingerprint, out.request_fingerprint);
    EXPECT_SAME_BITS(in.setpoint.p, out.setpoint.p);
    EXPECT_SAME_BITS(in.setpoint.q, out.setpoint.q);
    EXPECT_SAME_BITS(in.setpoint.v_c, out.setpoint.v_c);
    ASSERT_EQ(in.margins.size(), out.margins.size());
    for (std::size_t k = 0; k < out.margins.size(); ++k) {
      EXPECT_EQ(in.margins.begin()[k].limit, out.margins.begin()[k].limit);
      EXPECT_EQ(in.margins.begin()[k].enforced, out.margins.begin()[k].enforced);
      EXPECT_SAME_BITS(in.margins.begin()[k].margin, out.margins.begin()[k].margin);
      EXPECT_SAME_BITS(in.margins.begin()[k].required, out.margins.begin()[k].required);
      EXPECT_SAME_BITS(in.margins.begin()[k].grid.L_g, out.margins.begin()[k].grid.L_g);
    }
    ASSERT_EQ(in.reference.has_value(), out.reference.has_value());
    if (out.reference) expect_same(*in.reference, *out.reference);
    ASSERT_FALSE(HasFailure()) << "round " << n;
  }
}

Envelope random_envelope(Random& random) {
  Envelope e;
  e.step = random.whole<std::uint64_t>();
  e.reference_id = random.whole<std::uint32_t>();
  for (Interval* x : {&e.grid.R_g, &e.grid.X_g, &e.grid.V}) *x = {random.real(), random.real()};
  e.setpoint = {random.real(), random.real(), random.real()};
  e.lease_end_step = random.whole<std::uint64_t>();
  e.fallen_back = random.flag();
  e.fallback_holds = random.flag();
  e.holder = random_holder(random);
  e.held_until_step = random.whole<std::uint64_t>();
  for (std::uint32_t n = random.up_to(margin_count); n > 0; --n)
    e.margins.add({static_cast<Limit>(random.up_to(9)), random.flag(), random.real(), random.real(), {}});
  return e;
}

// The fields tell whether two are the same; that they are all of them, the test against the IDL tells.
TEST(Wire, EnvelopeIsReceivedAsSentBitForBit) {
  Random random;
  for (int n = 0; n < rounds; ++n) {
    const Envelope sent = random_envelope(random);
    const Envelope received = sent_and_received(sent);
    EXPECT_SAME_BITS(received.grid.X_g.high, sent.grid.X_g.high);
    EXPECT_SAME_BITS(received.setpoint.q, sent.setpoint.q);
    EXPECT_EQ(received.holder, sent.holder);
    const auto before = fields_of(1, sent), after = fields_of(1, received);
    ASSERT_EQ(before.size(), after.size());
    for (std::size_t k = 0; k < before.size(); ++k)
      EXPECT_TRUE(is_same(before[k].value, after[k].value)) << before[k].name;
    ASSERT_FALSE(HasFailure()) << "round " << n;
  }
}

ControllerState random_controller_state(Random& random) {
  ControllerState s;
  for (SpaceVector* v : {&s.law.v_p_hat, &s.law.v_p, &s.law.e1, &s.law.y, &s.law.mu_before, &s.law.mu,
                         &s.law.command, &s.last.mu})
    *v = {random.real(), random.real()};
  for (double* x : {&s.law.q_error, &s.law.eta_error, &s.law.p_r}) *x = random.real();
  for (Ramp* r : {&s.references.q, &s.references.v_c})
    *r = {random.real(),
          random.real(),
          random.real(),
          random.whole<std::uint64_t>(),
          random.whole<std::uint32_t>(),
          random.whole<std::uint32_t>()};
  ReferenceTrack& track = s.references.track;
  for (std::optional<Reference>* reference : {&track.in_force, &track.pending})
    if (random.flag()) {
      *reference = random_reference(random);
      (*reference)->id |= 1;
    }
  track.newest_id = random.whole<std::uint32_t>();
  track.order_id = random.whole<std::uint32_t>();
  track.fallen_back = random.flag();
  s.last.step = random.whole<std::uint64_t>();
  for (std::uint32_t* n : {&s.last.period_ns, &s.last.reference_id, &s.last.status,
                           &s.last.newest_reference_id, &s.last.measurement_fingerprint})
    *n = random.whole<std::uint32_t>();
  s.started = random.flag();
  s.older = random.up_to(17);
  return s;
}

// The fields tell whether two are the same; that they are all of them, the test against the IDL tells.
TEST(Wire, ControllerStateIsReceivedAsSentBitForBit) {
  Random random;
  for (int n = 0; n < rounds; ++n) {
    const ControllerState sent = random_controller_state(random);
    const ControllerState received = sent_and_received(sent);
    EXPECT_SAME_VECTOR(received.law.v_p_hat, sent.law.v_p_hat);
    EXPECT_SAME_VECTOR(received.law.v_p, sent.law.v_p);
    EXPECT_SAME_VECTOR(received.law.e1, sent.law.e1);
    EXPECT_SAME_VECTOR(received.law.y, sent.law.y);
    EXPECT_SAME_BITS(received.law.q_error, sent.law.q_error);
    EXPECT_SAME_BITS(received.law.eta_error, sent.law.eta_error);
    EXPECT_SAME_BITS(received.law.p_r, sent.law.p_r);
    EXPECT_SAME_VECTOR(received.law.mu_before, sent.law.mu_before);
    EXPECT_SAME_VECTOR(received.law.mu, sent.law.mu);
    EXPECT_SAME_VECTOR(received.law.command, sent.law.command);
    EXPECT_SAME_VECTOR(received.last.mu, sent.last.mu);
    const auto before = fields_of(1, sent), after = fields_of(1, received);
    ASSERT_EQ(before.size(), after.size());
    for (std::size_t k = 0; k < before.size(); ++k)
      EXPECT_TRUE(is_same(before[k].value, after[k].value)) << before[k].name;
    const ReferenceTrack &out = sent.references.track, &in = received.references.track;
    EXPECT_EQ(in.pending.has_value(), out.pending.has_value());
    EXPECT_EQ(in.in_force.has_value(), out.in_force.has_value());
    EXPECT_EQ(received.started, sent.started);
    ASSERT_FALSE(HasFailure()) << "round " << n;
  }
}

TEST(Wire, AnyOtherBitInASampleOrRequestGivesAnotherFingerprint) {
  Random random;
  for (int n = 0; n < rounds / 10; ++n) {
    const Measurement m = random_measurement(random);
    for (double Measurement::*x : {&Measurement::v_c, &Measurement::p_i})
      for (int bit = 0; bit < 64; ++bit) {
        Measurement other = m;
        other.*x = std::bit_cast<double>(bits(m.*x) ^ std::uint64_t{1} << bit);
        EXPECT_NE(fingerprint(other), fingerprint(m));
      }
    for (SpaceVector Measurement::*v : {&Measurement::v_p, &Measurement::i})
      for (double SpaceVector::*x : {&SpaceVector::re, &SpaceVector::im}) {
        Measurement other = m;
        other.*v.*x = std::bit_cast<double>(bits(m.*v.*x) ^ std::uint64_t{1} << random.up_to(63));
        EXPECT_NE(fingerprint(other), fingerprint(m));
      }
    Measurement others[7] = {m, m, m, m, m, m, m};
    others[0].step ^= std::uint64_t{1} << random.up_to(63);
    others[1].reference_id ^= 1u << random.up_to(31);
    others[2].blocked = !m.blocked;
    others[3].timing.delay = m.timing.delay == 1 ? 0 : 1;
    others[4].timing.period_ns ^= 1 << random.up_to(30);
    others[5].fallback = !m.fallback;
    others[6].state = static_cast<UnitState>((static_cast<std::uint32_t>(m.state) + 1 + random.up_to(4)) % 6);
    for (const Measurement& other : others) EXPECT_NE(fingerprint(other), fingerprint(m));
    ASSERT_FALSE(HasFailure()) << "round " << n;
  }
}

TEST(Wire, OperationIsReceivedAsSent) {
  Random random;
  for (int n = 0; n < rounds; ++n) {
    const Operation sent{.client = random.whole<std::uint64_t>(),
                         .id = random.whole<std::uint32_t>(),
                         .kind = static_cast<OperationKind>(random.up_to(3)),
                         .until_step = random.whole<std::uint64_t>()};
    const Operation received = sent_and_received(sent);
    EXPECT_EQ(received.client, sent.client);
    EXPECT_EQ(received.id, sent.id);
    EXPECT_EQ(received.kind, sent.kind);
    EXPECT_EQ(received.until_step, sent.until_step);
    ASSERT_FALSE(HasFailure()) << "round " << n;
  }
}

TEST(Wire, HealthIsReceivedAsSent) {
  Random random;
  for (int n = 0; n < rounds; ++n) {
    Health sent;
    sent.service = random.text(15);
    sent.instance = random.whole<std::uint64_t>();
    sent.state = static_cast<ServiceState>(random.up_to(4));
    sent.step = random.whole<std::uint64_t>();
    sent.reference_id = random.whole<std::uint32_t>();
    sent.wall_time_ns = random.whole<std::int64_t>();
    for (std::uint32_t k = random.up_to(32); k > 0; --k)
      sent.counters.push_back({random.text(31), random.whole<std::uint64_t>()});
    sent.digest = random.text(64);
    sent.text = random.text(255);
    const Health received = sent_and_received(sent);
    EXPECT_EQ(received.service, sent.service);
    EXPECT_EQ(received.instance, sent.instance);
    EXPECT_EQ(received.state, sent.state);
    EXPECT_EQ(received.step, sent.step);
    EXPECT_EQ(received.reference_id, sent.reference_id);
    EXPECT_EQ(received.wall_time_ns, sent.wall_time_ns);
    EXPECT_TRUE(received.counters == sent.counters);
    EXPECT_EQ(received.digest, sent.digest);
    EXPECT_EQ(received.text, sent.text);
    ASSERT_FALSE(HasFailure()) << "round " << n;
  }
}

TEST(Wire, ManifestIsReceivedAsSent) {
  Random random;
  for (int n = 0; n < rounds / 10; ++n) {
    Manifest sent{.service = random.text(15),
                  .instance = random.whole<std::uint64_t>(),
                  .build = random.text(255),
                  .settings = random.text(8191),
                  .constants = {},
                  .digest = random.text(64)};
    for (std::uint32_t k = random.up_to(64); k > 0; --k)
      sent.constants.push_back({random.text(31), random.real()});
    const Manifest received = sent_and_received(sent);
    EXPECT_EQ(received.service, sent.service);
    EXPECT_EQ(received.instance, sent.instance);
    EXPECT_EQ(received.build, sent.build);
    EXPECT_EQ(received.settings, sent.settings);
    EXPECT_EQ(received.digest, sent.digest);
    ASSERT_EQ(received.constants.size(), sent.constants.size());
    for (std::size_t k = 0; k < sent.constants.size(); ++k) {
      EXPECT_EQ(received.constants[k].name, sent.constants[k].name);
      EXPECT_SAME_BITS(received.constants[k].value, sent.constants[k].value);
    }
    ASSERT_FALSE(HasFailure()) << "round " << n;
  }
}

TEST(Wire, TextsLongerThanTheContractAreCut) {
  const std::string much(10'000, 'x');
  const DecisionMessage decision = sent_and_received(DecisionMessage{.decision = {}, .text = much});
  EXPECT_EQ(decision.text, std::string(255, 'x'));
  Health health;
  health.service = health.digest = health.text = much;
  health.counters = {{much, 1}};
  health = sent_and_received(health);
  EXPECT_EQ(health.service, std::string(15, 'x'));
  EXPECT_EQ(health.digest, std::string(64, 'x'));
  EXPECT_EQ(health.text, std::string(255, 'x'));
  EXPECT_EQ(health.counters.at(0).name, std::string(31, 'x'));
  const Manifest manifest = sent_and_received(Manifest{.service = much,
                                                       .instance = 1,
                                                       .build = much,
                                                       .settings = much,
                                                       .constants = {{much, 1.0}},
                                                       .digest = much});
  EXPECT_EQ(manifest.digest, std::string(64, 'x'));
  EXPECT_EQ(manifest.service, std::string(15, 'x'));
  EXPECT_EQ(manifest.build, std::string(255, 'x'));
  EXPECT_EQ(manifest.settings, std::string(8191, 'x'));
  EXPECT_EQ(manifest.constants.at(0).name, std::string(31, 'x'));
}

TEST(Wire, MeasurementWithAnUnknownFlagIsRefused) {
  Random random;
  for (std::uint32_t bit = 8; bit < 32; ++bit) {
    wire::Measurement wire;
    encode(random_measurement(random), wire);
    wire.flags(wire.flags() | 1u << bit);
    Measurement m;
    EXPECT_FALSE(decode(wire, m)) << "bit " << bit;
  }
}

TEST(Wire, MeasurementWhoseStateIsNoneOrDoesNotGoWithBlockedIsRefused) {
  Random random;
  for (int n = 0; n < rounds; ++n) {
    wire::Measurement wire;
    encode(random_measurement(random), wire);
    const std::uint32_t right = wire.flags();
    Measurement m;
    wire.flags(right ^ wire::BLOCKED);
    EXPECT_FALSE(decode(wire, m)) << right;
    for (const std::uint32_t none : {192u, 224u}) {
      wire.flags((right & ~static_cast<std::uint32_t>(wire::STATE_MASK)) | none);
      EXPECT_FALSE(decode(wire, m)) << right;
    }
  }
}

TEST(Wire, MeasurementWhoseTimeIsNotStepTimesPeriodIsRefused) {
  Random random;
  for (int n = 0; n < rounds; ++n) {
    wire::Measurement wire;
    encode(random_measurement(random), wire);
    const std::int64_t right = wire.time_ns();
    Measurement m;
    for (const std::int64_t wrong : {right ^ 1, right ^ (std::int64_t{1} << random.up_to(62)), ~right}) {
      wire.time_ns(wrong);
      EXPECT_FALSE(decode(wire, m)) << wrong << " instead of " << right;
    }
  }
}

// Every value from the first that no enumerator has.
template <class Wire, class Message, class Enumerator, class Put>
void expect_enumerators_refused(const Message& message, Enumerator last_one, Put put) {
  const auto last = static_cast<std::uint32_t>(last_one);
  for (const std::uint32_t value : {last + 1, last + 2, 255u, 256u, 0x8000'0000u, 0xffff'ffffu}) {
    Wire wire;
    encode(message, wire);
    put(wire, value);
    Message received;
    EXPECT_FALSE(decode(wire, received)) << value;
  }
}

TEST(Wire, EnumeratorOutOfRangeIsRefused) {
  expect_enumerators_refused<wire::Envelope>(
      Envelope{}, wire::Source::SOURCE_PROTECTION,
      [](auto& wire, std::uint32_t value) { wire.holder_source(static_cast<wire::Source>(value)); });
  DecisionMessage decision;
  expect_enumerators_refused<wire::SetpointDecision>(
      decision, static_cast<std::uint32_t>(UnitState::ready),
      [](auto& wire, std::uint32_t value) { wire.unit_state(value); });
  expect_enumerators_refused<wire::SetpointDecision>(
      decision, wire::RequestKind::REVALIDATE,
      [](auto& wire, std::uint32_t value) { wire.kind(static_cast<wire::RequestKind>(value)); });
  decision.decision.margins.add({Limit::current, true, 0.1});
  expect_enumerators_refused<wire::SetpointDecision>(
      decision, wire::Verdict::INTERLOCKED,
      [](auto& wire, std::uint32_t value) { wire.verdict(static_cast<wire::Verdict>(value)); });
  expect_enumerators_refused<wire::SetpointDecision>(
      decision, wire::LimitName::TRANSIENT,
      [](auto& wire, std::uint32_t value) { wire.margins()[0].limit(static_cast<wire::LimitName>(value)); });
  expect_enumerators_refused<wire::SetpointDecision>(
      decision, wire::RequestField::FIELD_KIND,
      [](auto& wire, std::uint32_t value) { wire.field(static_cast<wire::RequestField>(value)); });
  expect_enumerators_refused<wire::Operation>(
      Operation{}, wire::OperationKind::STOP,
      [](auto& wire, std::uint32_t value) { wire.kind(static_cast<wire::OperationKind>(value)); });
  expect_enumerators_refused<wire::Health>(
      Health{}, wire::ServiceState::STOPPED,
      [](auto& wire, std::uint32_t value) { wire.state(static_cast<wire::ServiceState>(value)); });
}

TEST(Wire, EveryEnumeratorHasItsNameInTheContract) {
  EXPECT_EQ(static_cast<wire::Verdict>(Verdict::outside_envelope), wire::Verdict::OUTSIDE_ENVELOPE);
  EXPECT_EQ(static_cast<wire::Verdict>(Verdict::bad_request), wire::Verdict::BAD_REQUEST);
  EXPECT_EQ(static_cast<wire::Verdict>(Verdict::stale_request), wire::Verdict::STALE_REQUEST);
  EXPECT_EQ(static_cast<wire::Verdict>(Verdict::unit_blocked), wire::Verdict::UNIT_BLOCKED);
  EXPECT_EQ(static_cast<wire::RequestField>(Field::none), wire::RequestField::NO_FIELD);
  EXPECT_EQ(static_cast<wire::RequestField>(Field::client), wire::RequestField::FIELD_CLIENT);
  EXPECT_EQ(static_cast<wire::RequestField>(Field::id), wire::RequestField::FIELD_ID);
  EXPECT_EQ(static_cast<wire::RequestField>(Field::given), wire::RequestField::FIELD_GIVEN);
  EXPECT_EQ(static_cast<wire::RequestField>(Field::p), wire::RequestField::FIELD_ACTIVE_POWER);
  EXPECT_EQ(static_cast<wire::RequestField>(Field::q), wire::RequestField::FIELD_REACTIVE_POWER);
  EXPECT_EQ(static_cast<wire::RequestField>(Field::v_c), wire::RequestField::FIELD_DC_VOLTAGE);
  EXPECT_EQ(static_cast<wire::RequestField>(Field::ramp_s), wire::RequestField::FIELD_RAMP_S);
  EXPECT_EQ(static_cast<wire::RequestField>(Field::effective_step), wire::RequestField::FIELD_EFFECTIVE_STEP);
  EXPECT_EQ(static_cast<wire::LimitName>(Limit::steady_state), wire::LimitName::STEADY_STATE);
  EXPECT_EQ(static_cast<wire::LimitName>(Limit::current), wire::LimitName::CURRENT);
  EXPECT_EQ(static_cast<wire::LimitName>(Limit::control), wire::LimitName::CONTROL);
  EXPECT_EQ(static_cast<wire::LimitName>(Limit::control_rough), wire::LimitName::CONTROL_ROUGH);
  EXPECT_EQ(static_cast<wire::LimitName>(Limit::pcc_voltage_min), wire::LimitName::PCC_VOLTAGE_MIN);
  EXPECT_EQ(static_cast<wire::LimitName>(Limit::pcc_voltage_max), wire::LimitName::PCC_VOLTAGE_MAX);
  EXPECT_EQ(static_cast<wire::LimitName>(Limit::dc_voltage_min), wire::LimitName::DC_VOLTAGE_MIN);
  EXPECT_EQ(static_cast<wire::LimitName>(Limit::dc_voltage_max), wire::LimitName::DC_VOLTAGE_MAX);
  EXPECT_EQ(static_cast<wire::OperationKind>(OperationKind::advance), wire::OperationKind::ADVANCE);
  EXPECT_EQ(static_cast<wire::OperationKind>(OperationKind::reset_trip), wire::OperationKind::RESET_TRIP);
  EXPECT_EQ(static_cast<wire::OperationKind>(OperationKind::start), wire::OperationKind::START);
  EXPECT_EQ(static_cast<wire::OperationKind>(OperationKind::stop), wire::OperationKind::STOP);
  EXPECT_EQ(static_cast<wire::ServiceState>(ServiceState::starting), wire::ServiceState::STARTING);
  EXPECT_EQ(static_cast<wire::ServiceState>(ServiceState::running), wire::ServiceState::RUNNING);
  EXPECT_EQ(static_cast<wire::ServiceState>(ServiceState::waiting), wire::ServiceState::WAITING);
  EXPECT_EQ(static_cast<wire::ServiceState>(ServiceState::blocked_by_trip),
            wire::ServiceState::BLOCKED_BY_TRIP);
  EXPECT_EQ(static_cast<wire::ServiceState>(ServiceState::stopped), wire::ServiceState::STOPPED);
}

TEST(Wire, MoreMarginsThanThereAreLimitsAreRefused) {
  wire::SetpointDecision wire;
  encode(DecisionMessage{}, wire);
  wire.margins().resize(margin_count + 1);
  DecisionMessage received;
  EXPECT_FALSE(decode(wire, received));
}

}  // namespace
}  // namespace weakgrid
