// weakgrid verify on recordings of the real programs: whatever happened to them re-executes to the bit, and
// one wrong bit is found where it is. WEAKGRID_LAW_COUNT sets how many flips are tried (default 60).
#include <signal.h>

#include <nlohmann/json.hpp>
#include <regex>
#include <thread>

#include "services/recording/recorder.hpp"
#include "services/recording/reexecution.hpp"
#include "services/runtime/announcer.hpp"
#include "services/runtime/payload.hpp"
#include "tests/recording/recording_support.hpp"
#include "tests/services/bystander.hpp"

namespace weakgrid {
namespace {

using mcap::Folder;
using nlohmann::json;

const char* const scenario =
    "[grid]\nreactance = 0.3\n[scenario]\nend_s = 0.3\n"
    "[[scenario.setpoint]]\nat_s = 0.01\nactive_power = 0.5\n"
    "[[scenario.setpoint]]\nat_s = 0.05\nactive_power = 0.707\nreactive_power = -0.7\n"
    "[[scenario.setpoint]]\nat_s = 0.1\nreactive_power = 0.1\nramp_s = 0.03\n"
    "[[scenario.event]]\nat_s = 0.2\nquantity = \"grid_reactance\"\nvalue = 0.2\n";
constexpr std::uint64_t scenario_steps = 3000;

/// Messages of a recording as a test may change them.
struct Recorded {
  std::string topic, type;
  mcap::Bytes payload;
  bool keep = true;
};

/// A copy with some messages changed or left out; its checksums are right.
void rewrite(const std::string& from, const std::string& to, const std::function<void(Recorded&)>& edit) {
  mcap::Reader reader;
  ASSERT_TRUE(reader.open(from).ok());
  mcap::Writer writer;
  ASSERT_TRUE(writer.open(to, {.version = "test", .profile = ""}).ok());
  std::map<mcap::ChannelId, mcap::ChannelId> channels;
  std::map<mcap::SchemaId, mcap::SchemaId> schemas;
  while (const auto record = reader.next()) {
    if (const auto* metadata = std::get_if<mcap::Metadata>(&*record)) {
      ASSERT_TRUE(writer.write_metadata(metadata->name, metadata->entries).ok());
    } else if (const auto* message = std::get_if<mcap::Message>(&*record)) {
      const mcap::Channel& channel = reader.channels().at(message->channel_id);
      const mcap::Schema& schema = reader.schemas().at(channel.schema_id);
      Recorded recorded{channel.topic, schema.name, {message->data.begin(), message->data.end()}};
      edit(recorded);
      if (!recorded.keep) continue;
      mcap::SchemaId& schema_id = schemas[schema.id];
      if (schema_id == 0)
        schema_id =
            writer.add_schema(schema.name, schema.encoding,
                              {reinterpret_cast<const char*>(schema.data.data()), schema.data.size()});
      mcap::ChannelId& id = channels[channel.id];
      if (id == 0)
        id = writer.add_channel(schema_id, channel.topic, channel.message_encoding, channel.metadata);
      ASSERT_TRUE(writer
                      .write_message(id, message->sequence, message->log_time_ns, message->publish_time_ns,
                                     recorded.payload)
                      .ok());
    }
  }
  ASSERT_TRUE(writer.close().ok());
}

ReexecutionFindings reexecute(const std::vector<std::string>& files, const ReexecutionOptions& options = {}) {
  RecordingSource source(files);
  Reexecution reexecution(options);
  reexecution.run(source);
  return reexecution.findings();
}

struct Sums {
  std::uint64_t compared = 0, identical = 0, resumed = 0;
};
Sums sums_of(const ReexecutionFindings& findings) {
  Sums sums;
  for (const ControllerFindings& c : findings.controllers) {
    sums.compared += c.compared;
    sums.identical += c.identical;
    sums.resumed += c.resumed;
  }
  return sums;
}

std::string words(const ReexecutionFindings& findings) {
  std::string text;
  for (const Difference& d : findings.differences.kept())
    text += "\n" + d.what + " " + d.which + " unit " + std::to_string(d.unit) + " step " +
            std::to_string(d.step) + " " + d.field + ": recorded " + to_text(d.recorded) + ", computed " +
            to_text(d.computed);
  for (const ControllerFindings& c : findings.controllers)
    for (const Unchecked& u : c.unchecked)
      text += "\nnot compared " + std::to_string(u.count) + " from " + std::to_string(u.first_step) + ": " +
              u.why;
  for (const GatewayFindings& g : findings.gateways)
    for (const Unchecked& u : g.unchecked)
      text +=
          "\nnot decided " + std::to_string(u.count) + " from " + std::to_string(u.first_step) + ": " + u.why;
  return text;
}

/// The scenario played once for all tests that only read.
const std::string& played() {
  static const Folder folder;
  static const std::string file = [] {
    const test::Domain domain;
    const test::TextFile settings(scenario);
    const test::Ended run = test::run(
        "weakgrid", {"run", settings.path(), "--domain", domain.text(), "--record", folder / "a.mcap"});
    EXPECT_LE(run.status, 1) << run.out << run.err;
    return folder / "a.mcap";
  }();
  return file;
}

TEST(Verify, ARunReexecutesToTheBit) {
  const test::Ended verify = test::run("weakgrid", {"verify", played(), "--json"});
  EXPECT_EQ(verify.status, 0) << verify.out << verify.err;
  const json report = json::parse(verify.out, nullptr, false);
  EXPECT_EQ(report["identical"], true);
  EXPECT_EQ(report["unchecked"], 0) << report.dump(2);
  ASSERT_EQ(report["controllers"].size(), 1u);
  EXPECT_GE(report["controllers"][0]["identical"], scenario_steps) << "a plant that waits repeats its sample";
  EXPECT_EQ(report["controllers"][0]["states_identical"], 6);  // every 50 ms
  ASSERT_EQ(report["gateways"].size(), 1u);
  EXPECT_EQ(report["gateways"][0]["decisions_identical"], 3);
  EXPECT_EQ(report["gateways"][0]["references_identical"], 2);
}

// A writer is heard some tenths of a second after it begins.
void let_the_recorder_hear() { std::this_thread::sleep_for(test::milliseconds(700)); }
// The plant goes on without the answers of a controller that stands still, and misses steps itself.
TEST(Verify, ARunInRealTimeReexecutesToTheBitWithItsHolds) {
  const test::Domain domain;
  const Folder folder;
  const test::TextFile settings(
      "[timing]\nperiod_us = 500\n[grid]\nreactance = 0.1\n[plant]\npace = \"realtime\"\n"
      "[protection]\nholds_max = 100000\ncurrent_max = 50.0\ndc_voltage_min = 0.05\ndc_voltage_max = 10.0\n"
      "pcc_voltage_steps = 100000\n"
      "[controller]\nsettling_times_s = [0.005, 0.0055, 0.2]\nnotch_settling_time_s = 0.25\n"
      "[gateway]\ndecay_min_per_s = 0.0\nramp_s = 0.2\n");
  test::Program recorder("weakgrid-recorder", {"--domain", domain.text(), "--output", folder / "a.mcap",
                                               "--await", "weakgrid/measurement", "--await",
                                               "weakgrid/modulation", "--await", "weakgrid/reference"});
  test::Program plant("weakgrid-plant",
                      {"--settings", settings.path(), "--domain", domain.text(), "--until", "0"});
  test::Services others(domain, settings.path());
  test::Program& controller = others.start("controller");
  others.start("gateway");
  test::Bystander bystander(domain);
  ASSERT_TRUE(test::wait_until([&] { return bystander.is("recorder", ServiceState::running); }));
  ASSERT_TRUE(bystander.client().operate(OperationKind::advance, 100'000, test::long_enough));
  ASSERT_TRUE(bystander.runs(test::long_enough, 50));
  ASSERT_TRUE(bystander.order(0.1, 0.05));
  ASSERT_TRUE(bystander.goes_on());
  for (test::Program* program : {&controller, &plant})
    for (const int held_ms : {5, 12, 60}) {
      program->send(SIGSTOP);
      std::this_thread::sleep_for(test::milliseconds(held_ms));
      program->send(SIGCONT);
      ASSERT_TRUE(bystander.goes_on());
    }
  ASSERT_TRUE(test::wait_until([&] {
    return bystander.count("plant", "holds") >= 100 && bystander.count("plant", "missed_steps") >= 50;
  })) << bystander.words();
  recorder.send(SIGTERM);
  ASSERT_EQ(recorder.wait(), 0) << recorder.err();

  const test::Ended verify =
      test::run("weakgrid", {"verify", folder / "a.mcap", "--settings", settings.path(), "--json"});
  EXPECT_EQ(verify.status, 0) << verify.out << verify.err;
  const json report = json::parse(verify.out, nullptr, false);
  EXPECT_EQ(report["identical"], true);
  if (report["unchecked"] != 0) GTEST_SKIP() << "this busy machine's recorder has lost some";
  const json& fared = report["what_if"][0];
  EXPECT_EQ(fared["recorded"], fared["other"]) << "emulated once more, it holds where the plant has held";
}

TEST(Verify, RestartsOfEveryServiceATripAndAResetReexecuteToTheBit) {
  const test::Domain domain;
  const Folder folder;
  const test::TextFile settings(
      "[grid]\nreactance = 0.3\n[plant]\npatience_s = 60.0\n[protection]\nholds_max = 100000\n"
      "[scenario]\nend_s = 1000.0\n"
      "[[scenario.event]]\nat_s = 1.0\nquantity = \"grid_reactance\"\nvalue = 0.25\nramp_s = 0.1\n"
      "[[scenario.event]]\nat_s = 3.0\nquantity = \"source_power\"\nvalue = 5.0\n"
      "[[scenario.event]]\nat_s = 3.2\nquantity = \"source_power\"\nvalue = 0.0\n");
  test::Program recorder("weakgrid-recorder", {"--domain", domain.text(), "--output", folder / "a.mcap"});
  test::Services services(domain, settings.path());
  test::Bystander bystander(domain);
  ASSERT_TRUE(test::wait_until([&] { return bystander.health("recorder").has_value(); }));
  services.start_all();
  ASSERT_TRUE(bystander.runs());
  ASSERT_TRUE(bystander.order(0.5, 0.1));
  ASSERT_TRUE(bystander.goes_on());
  let_the_recorder_hear();
  services["controller"].kill();
  services.start("controller");
  ASSERT_TRUE(bystander.goes_on());
  services["gateway"].kill();
  services.start("gateway");
  let_the_recorder_hear();
  ASSERT_TRUE(bystander.order(0.3, 0.2));
  EXPECT_TRUE(bystander.client().ask({.given = given_q, .q = 0.1}, test::long_enough));
  EXPECT_TRUE(bystander.client().ask({.given = given_q, .q = 3.0}, test::long_enough));
  ASSERT_TRUE(test::wait_until([&] { return bystander.is("plant", ServiceState::blocked_by_trip); }))
      << bystander.words();
  EXPECT_TRUE(bystander.client().ask({.given = given_q, .q = 0.0}, test::long_enough));
  ASSERT_TRUE(test::wait_until([&] {
    bystander.client().operate(OperationKind::reset_trip, 0, test::long_enough);
    return bystander.is("plant", ServiceState::running);
  }));
  ASSERT_TRUE(bystander.order(0.2, 0.0));
  services["plant"].kill();
  services.start("plant");
  ASSERT_TRUE(bystander.runs());
  EXPECT_TRUE(bystander.client().ask({.given = given_p | given_q | given_v_c, .p = 0.4, .v_c = 1.84},
                                     test::long_enough));
  ASSERT_TRUE(bystander.goes_on(test::long_enough, 1000));
  recorder.send(SIGTERM);
  ASSERT_EQ(recorder.wait(), 0) << recorder.err();

  const ReexecutionFindings findings = reexecute({folder / "a.mcap"});
  EXPECT_EQ(findings.differences.count(), 0u) << words(findings);
  EXPECT_EQ(findings.controllers.size(), 2u);
  EXPECT_EQ(findings.gateways.size(), 2u);
  // A writer is heard some tenths of a second after it begins; how many steps that is the machine decides.
  EXPECT_LE(findings.unchecked(), 2 * 10'000u) << words(findings);
  const Sums sums = sums_of(findings);
  EXPECT_EQ(sums.identical, sums.compared);
  EXPECT_GT(sums.compared, 3000u);
  std::uint64_t decisions = 0, references = 0;
  for (const GatewayFindings& g : findings.gateways) {
    decisions += g.decisions_identical;
    references += g.references_identical;
  }
  EXPECT_GE(decisions, 7u);
  EXPECT_GE(references, 6u) << "the gateway withdraws on a trip and a restart";
}

TEST(Verify, AuthorityOffersLeasesAChangedGridAndARememberingGatewayReexecuteToTheBit) {
  const test::Domain domain;
  const Folder folder;
  const test::TextFile settings(
      "[grid]\nreactance = 0.3\n[gateway]\ngrid_reactance = [0.25, 0.35]\njournal = \"" +
      (folder / "journal") +
      "\"\n[scenario]\nend_s = 1000.0\n"
      "[[scenario.event]]\nat_s = 2.5\nquantity = \"grid_voltage\"\nvalue = 0.88\nramp_s = 0.02\n");
  test::Program recorder("weakgrid-recorder", {"--domain", domain.text(), "--output", folder / "a.mcap"});
  test::Services services(domain, settings.path());
  test::Bystander bystander(domain);
  ASSERT_TRUE(test::wait_until([&] { return bystander.health("recorder").has_value(); }));
  services.start("plant", {"--until", "20000"});
  services.start("controller");
  services.start("gateway");
  ASSERT_TRUE(test::wait_until([&] {
    return bystander.is("plant", ServiceState::waiting) && bystander.is("gateway", ServiceState::running);
  })) << bystander.words();
  Client& client = bystander.client();
  const auto asks = [&](const char* name, Source source, Request request) {
    request.who.source = source;
    for (std::size_t k = 0; name[k] != '\0'; ++k) request.who.name.text[k] = name[k];
    const auto answer = client.ask(request, test::long_enough);
    EXPECT_TRUE(answer) << "no answer";
    return answer ? answer->decision : Decision{};
  };
  const auto set = [](double p, double q) {
    return Request{.given = given_p | given_q, .p = p, .q = q, .lease_s = 3000.0};
  };
  const auto of_kind = [](RequestKind kind) { return Request{.kind = kind, .lease_s = 3000.0}; };
  let_the_recorder_hear();
  EXPECT_EQ(asks("plan", Source::schedule, set(0.3, 0.0)).verdict, Verdict::accepted);
  EXPECT_EQ(asks("ann", Source::operation, set(0.2, 0.0)).verdict, Verdict::not_authorised);
  EXPECT_EQ(asks("ann", Source::operation, of_kind(RequestKind::take)).verdict, Verdict::accepted);
  const Decision refused = asks("ann", Source::operation, set(0.7, -0.6));
  ASSERT_TRUE(refused.offer);
  Request accept = of_kind(RequestKind::accept);
  accept.token = refused.offer->token;
  EXPECT_EQ(asks("ann", Source::operation, accept).verdict, Verdict::accepted);
  EXPECT_EQ(asks("ann", Source::operation, of_kind(RequestKind::renew)).verdict, Verdict::accepted);
  services["gateway"].kill();
  services.start("gateway");
  EXPECT_EQ(asks("bob", Source::operation, set(0.2, 0.0)).verdict, Verdict::not_authorised);
  let_the_recorder_hear();
  EXPECT_EQ(asks("ann", Source::operation, of_kind(RequestKind::start)).verdict, Verdict::interlocked);
  Request grid = of_kind(RequestKind::set_grid);
  grid.X_g = {0.28, 0.32};
  grid.V = {0.98, 1.02};
  EXPECT_EQ(asks("ann", Source::operation, grid).verdict, Verdict::accepted);
  EXPECT_EQ(asks("ann", Source::operation, set(0.9, 0.1)).verdict, Verdict::accepted);
  ASSERT_TRUE(client.operate(OperationKind::advance, ~std::uint64_t{0}, test::long_enough));
  ASSERT_TRUE(test::wait_until([&] {
    const auto envelope = client.envelope();
    return envelope && envelope->grid.V.low < 0.9;
  })) << "the grid gives way, and the gateway sees it";
  ASSERT_TRUE(bystander.goes_on(test::long_enough, 1000));
  EXPECT_EQ(asks("bob", Source::test, of_kind(RequestKind::stop)).verdict, Verdict::accepted);
  ASSERT_TRUE(test::wait_until([&] { return bystander.measurement()->state == UnitState::off; }));
  EXPECT_EQ(asks("bob", Source::test, of_kind(RequestKind::start)).verdict, Verdict::accepted);
  ASSERT_TRUE(bystander.goes_on(test::long_enough, 1000));
  recorder.send(SIGTERM);
  ASSERT_EQ(recorder.wait(), 0) << recorder.err();

  const ReexecutionFindings findings = reexecute({folder / "a.mcap"});
  EXPECT_EQ(findings.differences.count(), 0u) << words(findings);
  std::uint64_t decisions = 0;
  for (const GatewayFindings& g : findings.gateways) decisions += g.decisions_identical;
  EXPECT_GE(decisions, 12u) << words(findings);
}

// Discovery is a race that a command may lose; what it asked is then stated as missing, and never taken for
// another's.
TEST(Verify, WhatCommandsThatLiveForAMomentAskIsInTheRecordingButForAFew) {
  const test::Domain domain;
  const Folder folder;
  const test::TextFile settings("[grid]\nreactance = 0.3\n");
  test::Program recorder("weakgrid-recorder", {"--domain", domain.text(), "--output", folder / "a.mcap"});
  test::Services services(domain, settings.path());
  services.start_all();
  test::Bystander bystander(domain);
  ASSERT_TRUE(bystander.runs());
  ASSERT_TRUE(test::wait_until([&] { return bystander.is("recorder", ServiceState::running); }));
  let_the_recorder_hear();
  constexpr int commands = 6;
  for (int n = 0; n < commands; ++n) {
    const test::Ended set =
        test::run("weakgrid", {"set", "--p", "0.2", "--q", std::to_string(0.01 * (n % 2)), "--domain",
                               domain.text(), "--name", "ann", "--timeout", "60"});
    ASSERT_EQ(set.status, 0) << set.out << set.err;
  }
  recorder.send(SIGTERM);
  ASSERT_EQ(recorder.wait(), 0) << recorder.err();
  const ReexecutionFindings findings = reexecute({folder / "a.mcap"});
  ASSERT_EQ(findings.gateways.size(), 1u);
  EXPECT_EQ(findings.differences.count(), 0u) << words(findings);
  EXPECT_GE(findings.gateways[0].decisions_identical, commands / 2) << words(findings);
}

/// A plant that loses samples on their way, as best effort may: it holds, and the controller sees a gap.
TEST(Verify, SamplesThatTheControllerNeverGotReexecuteAsGaps) {
  const test::Domain domain;
  const Folder folder;
  const test::TextFile file("[grid]\nreactance = 0.3\n[protection]\nholds_max = 100000\n");
  const Settings settings = load_settings(file.path());
  test::Program recorder("weakgrid-recorder",
                         {"--domain", domain.text(), "--output", folder / "a.mcap", "--await",
                          "weakgrid/measurement", "--await", "weakgrid/modulation"});
  test::Services services(domain, file.path());
  services.start("controller");
  Client client(domain.number(), 1, {});
  Emulator emulator(emulator_configuration(settings), {});
  std::mutex mutex;
  std::condition_variable came;
  std::optional<Modulation> answer;
  Writer<Measurement> measurements(client.bus(), 1);
  const Reader<Modulation> reader(client.bus(), 1, [&](const Modulation& m, Arrival) {
    const std::lock_guard lock(mutex);
    answer = m;
    came.notify_all();
  });
  ASSERT_TRUE(test::wait_until([&] {
    return client.wait_for("recorder", Patience(5),
                           [](const Health& h) { return h.state == ServiceState::running; }) &&
           measurements.matched() >= 2 && reader.matched() > 0;
  }));
  mcap::Random random{11};
  std::uint64_t lost = 0;
  while (emulator.step() < 3000) {
    // Single ones, and now and then more than the controller turns on over.
    const bool loses = emulator.step() % 1000 > 900 ? emulator.step() % 1000 < 930 : random() % 20 == 0;
    const Measurement sample = emulator.sample();
    if (loses) {
      ++lost;
      emulator.advance(std::nullopt);
      continue;
    }
    std::unique_lock lock(mutex);
    do ASSERT_TRUE(measurements.write(sample));
    while (
        !came.wait_for(lock, test::milliseconds(20), [&] { return answer && answer->step == sample.step; }));
    emulator.advance(command(*answer));
  }
  recorder.send(SIGTERM);
  ASSERT_EQ(recorder.wait(), 0) << recorder.err();
  EXPECT_GT(lost, 100u);
  const ReexecutionFindings findings = reexecute({folder / "a.mcap"});
  EXPECT_EQ(findings.differences.count(), 0u) << words(findings);
  // On a busy machine the recorder may lose one, too: then what follows up to the next state is not compared.
  EXPECT_LE(findings.unchecked(), 1000u) << words(findings);
  EXPECT_GE(sums_of(findings).identical, 2000 - lost);
}

TEST(Verify, WhatTheRecordingHasLostIsStatedAndTheRestReexecutes) {
  const Folder folder;
  mcap::Random random{3};
  std::uint64_t lost = 0;
  rewrite(played(), folder / "lossy.mcap", [&](Recorded& m) {
    const bool may_be_lost = m.topic == "weakgrid/measurement" || m.topic == "weakgrid/modulation";
    m.keep = !may_be_lost || random() % 500 != 0;
    if (!m.keep) ++lost;
  });
  ASSERT_GT(lost, 3u);
  const test::Ended verify = test::run("weakgrid", {"verify", folder / "lossy.mcap", "--json"});
  EXPECT_EQ(verify.status, 0) << verify.out;
  const json report = json::parse(verify.out, nullptr, false);
  const json& controller = report["controllers"][0];
  EXPECT_GT(report["unchecked"], 0);
  EXPECT_GT(controller["resumed"], 0);
  EXPECT_EQ(controller["identical"], controller["modulations"]);
  for (const json& stretch : controller["unchecked"])
    EXPECT_NE(stretch["why"].get<std::string>().find("not in the recording"), std::string::npos)
        << stretch.dump();
}

TEST(Verify, ACutRecordingVerifiesUpToTheCut) {
  const Folder folder;
  const mcap::Bytes whole = mcap::file_bytes(played());
  for (const double part : {0.5, 0.7, 0.9}) {
    const auto size = static_cast<std::size_t>(part * static_cast<double>(whole.size()));
    mcap::write_bytes(folder / "cut.mcap", mcap::ByteView{whole}.first(size));
    const ReexecutionFindings findings = reexecute({folder / "cut.mcap"});
    const Sums sums = sums_of(findings);
    EXPECT_EQ(findings.differences.count(), 0u) << words(findings);
    EXPECT_GT(sums.compared, 100u);
    EXPECT_EQ(sums.identical, sums.compared);
    EXPECT_FALSE(findings.file_faults.empty());
  }
}

TEST(Verify, BeginsAtAnyRecordedState) {
  for (const std::uint64_t from : {1u, 700u, 2400u}) {
    const ReexecutionFindings findings =
        reexecute({played()}, {.from_step = from, .other_settings = {}, .watch = {}});
    const Sums sums = sums_of(findings);
    EXPECT_EQ(findings.differences.count(), 0u) << words(findings);
    EXPECT_EQ(sums.resumed, 1u);
    EXPECT_GE(sums.compared, scenario_steps - (from + 499) / 500 * 500 - 1);
    EXPECT_LE(sums.compared, scenario_steps - from + 4) << "a plant that waits repeats its sample";
  }
}

TEST(Verify, APartThatBeginsInTheMidstVerifiesByItself) {
  const test::Domain domain;
  const Folder folder;
  const test::TextFile settings("[grid]\nreactance = 0.3\n");
  test::Program recorder("weakgrid-recorder",
                         {"--domain", domain.text(), "--output", folder / "a.mcap", "--max-bytes", "600000"});
  test::Services services(domain, settings.path());
  test::Bystander bystander(domain);
  ASSERT_TRUE(test::wait_until([&] { return bystander.health("recorder").has_value(); }));
  services.start_all();
  ASSERT_TRUE(bystander.runs());
  ASSERT_TRUE(bystander.order(0.5, 0.1));
  ASSERT_TRUE(test::wait_until([&] { return bystander.count("recorder", "files") >= 3; }));
  // More than one: a request and its decision may come to lie in two parts.
  for (const double q : {0.2, 0.1, 0.15}) {
    ASSERT_TRUE(bystander.client().ask({.given = given_q, .q = q}, test::long_enough));
    ASSERT_TRUE(bystander.goes_on());
  }
  recorder.send(SIGTERM);
  ASSERT_EQ(recorder.wait(), 0) << recorder.err();
  std::vector<std::string> parts{folder / "a.mcap"};
  for (int n = 2; std::filesystem::exists(folder / ("a_000" + std::to_string(n) + ".mcap").c_str()); ++n)
    parts.push_back(folder / ("a_000" + std::to_string(n) + ".mcap").c_str());
  ASSERT_GE(parts.size(), 3u);
  const ReexecutionFindings all = reexecute(parts);
  EXPECT_EQ(all.differences.count(), 0u) << words(all);
  EXPECT_LE(all.unchecked(), 3000u) << words(all);  // until every writer is heard
  std::uint64_t decisions = 0;
  for (const std::string& part : parts) {
    const ReexecutionFindings findings = reexecute({part});
    EXPECT_EQ(findings.differences.count(), 0u) << part << words(findings);
    // The last may have begun a moment before its end.
    if (part != parts.back()) {
      EXPECT_GT(sums_of(findings).compared, 100u) << part;
    }
    for (const GatewayFindings& g : findings.gateways) decisions += g.decisions_identical;
  }
  EXPECT_GE(decisions, 2u)
      << "also the one that gives q alone, where the part has only the standing reference";
}

/// The step at which a changed message must be found.
std::uint64_t step_named(const Recorded& m) {
  const auto fields = fields_of_payload(m.type, m.payload);
  for (const char* name : {"step", "decided_step"})
    for (const WireField& field : *fields)
      if (field.name == std::string_view(name)) return std::get<std::uint64_t>(field.value);
  return 0;
}

TEST(Verify, OneFlippedBitInAnyInputIsReportedAtItsStep) {
  const Folder folder;
  // What may be flipped, and the steps at which decisions were taken on requests and with references.
  std::map<std::string, std::vector<std::size_t>> inputs;
  std::map<std::uint32_t, std::uint64_t> step_of_reference;
  std::map<std::uint32_t, std::uint64_t> step_of_request;
  std::map<std::uint32_t, int> copies;  // a request is repeated until it is decided
  std::size_t count = 0;
  std::vector<Recorded> all;
  rewrite(played(), folder / "copy.mcap", [&](Recorded& m) {
    for (const char* type : {"Measurement", "SetpointRequest", "Reference", "Manifest"})
      if (m.type == std::string("weakgrid::wire::") + type) inputs[type].push_back(count);
    if (m.topic == "weakgrid/setpoint_request") ++copies[from_payload<Request>(m.payload)->message.id];
    if (const auto d = from_payload<DecisionMessage>(m.payload);
        m.topic == "weakgrid/setpoint_decision" && d) {
      step_of_request[d->message.decision.id] = d->message.decision.decided_step;
      if (d->message.decision.reference)
        step_of_reference[d->message.decision.reference->id] = d->message.decision.decided_step;
    }
    all.push_back(m);
    ++count;
  });
  ASSERT_EQ(inputs.size(), 4u);
  mcap::Random random{5};
  const char* const types[] = {"Measurement",     "Measurement", "Measurement",
                               "SetpointRequest", "Reference",   "Manifest"};
  for (std::uint32_t n = 0; n < mcap::law_count(60); ++n) {
    const std::string type = types[n % std::size(types)];
    const std::size_t chosen = inputs[type][mcap::below(random, inputs[type].size())];
    const Recorded& original = all[chosen];
    if (type == "SetpointRequest" && copies[from_payload<Request>(original.payload)->message.id] > 1) continue;
    Recorded flipped = original;
    const std::size_t bit = 32 + mcap::below(random, (flipped.payload.size() - 4) * 8);
    flipped.payload[bit / 8] ^= static_cast<std::byte>(1u << bit % 8);
    const auto before = fields_of_payload(original.type, original.payload);
    const auto after = fields_of_payload(flipped.type, flipped.payload);
    bool says_the_same = before && after;
    for (std::size_t k = 0; says_the_same && k < before->size(); ++k)
      says_the_same = is_same((*before)[k].value, (*after)[k].value);
    if (says_the_same) continue;  // padding, or behind the end of a text
    std::uint64_t expected = step_named(original);
    if (type == "SetpointRequest")
      expected = step_of_request.at(from_payload<Request>(original.payload)->message.id);
    if (type == "Reference")
      expected = step_of_reference.at(from_payload<Reference>(original.payload)->message.id);
    SCOPED_TRACE(type + " " + std::to_string(chosen) + " bit " + std::to_string(bit) + ", expected at step " +
                 std::to_string(expected));
    const std::string file = folder / ("flip" + std::to_string(n) + ".mcap").c_str();
    std::size_t at = 0;
    rewrite(played(), file, [&](Recorded& m) {
      if (at++ == chosen) m.payload = flipped.payload;
    });
    const ReexecutionFindings findings = reexecute({file});
    ASSERT_GT(findings.differences.count(), 0u) << words(findings);
    const auto& kept = findings.differences.kept();
    const bool is_found = std::any_of(kept.begin(), kept.end(), [&](const Difference& d) {
      // Bytes that are no message any more have no step.
      if (d.what == "message") return true;
      return d.step == expected && (type != "Manifest" || d.what == "manifest");
    });
    EXPECT_TRUE(is_found) << words(findings);
    std::filesystem::remove(file);
  }
}

TEST(Verify, OneFlippedBitInAnAnswerIsReportedInHexAndDecimal) {
  const Folder folder;
  rewrite(played(), folder / "flip.mcap", [&](Recorded& m) {
    if (m.topic != "weakgrid/modulation" || from_payload<Modulation>(m.payload)->message.step != 1234) return;
    m.payload[m.payload.size() - 8] ^= std::byte{1};  // the last bit of modulation_beta
  });
  const test::Ended verify = test::run("weakgrid", {"verify", folder / "flip.mcap"});
  EXPECT_EQ(verify.status, 1);
  EXPECT_NE(verify.out.find("unit 1 step 1234: modulation field modulation_beta: recorded "),
            std::string::npos)
      << verify.out;
  EXPECT_NE(verify.out.find("(0x"), std::string::npos);
  std::smatch counts;
  ASSERT_TRUE(std::regex_search(verify.out, counts, std::regex("([0-9]+) of ([0-9]+) modulations identical")));
  EXPECT_EQ(std::stoul(counts[1]) + 1, std::stoul(counts[2])) << verify.out;
}

TEST(Verify, OtherSettingsTellHowTheOutcomeDiffers) {
  const test::TextFile same(scenario),
      other(std::string(scenario) + "[controller]\nsettling_times_s = [0.0012, 0.0013, 0.045]\n");
  const test::Ended as_recorded =
      test::run("weakgrid", {"verify", played(), "--settings", same.path(), "--json"});
  EXPECT_EQ(as_recorded.status, 0) << as_recorded.out << as_recorded.err;
  const json unchanged = json::parse(as_recorded.out, nullptr, false)["what_if"][0];
  EXPECT_EQ(unchanged["recorded"], unchanged["other"])
      << "emulated with the same settings it is the same run";
  const test::Ended what_if =
      test::run("weakgrid", {"verify", played(), "--settings", other.path(), "--json"});
  EXPECT_EQ(what_if.status, 1) << what_if.err;
  const json report = json::parse(what_if.out, nullptr, false);
  EXPECT_GT(report["controllers"][0]["mu_distance_max"], 0.0);
  EXPECT_LT(report["controllers"][0]["identical"], scenario_steps);
  const json& outcome = report["what_if"][0];
  EXPECT_NE(outcome["recorded"]["mean |q - q_r|"], outcome["other"]["mean |q - q_r|"]);
  EXPECT_GT(outcome["other"]["v_c min"], 1.5) << "still held";
  const json& gateway = report["gateways"][0];
  EXPECT_LT(gateway["decisions_identical"], 3) << "the decay is another with other gains";
  EXPECT_EQ(gateway["accepted_recorded"], gateway["accepted_computed"]) << "but enough";
}

TEST(Verify, RefusesWhatIsNoRecordingAndSaysWhenThereIsNothingToCompare) {
  const Folder folder;
  mcap::write_bytes(folder / "text", mcap::bytes_of("not a recording"));
  EXPECT_EQ(test::run("weakgrid", {"verify", folder / "text"}).status, 2);
  rewrite(played(), folder / "empty.mcap", [](Recorded& m) { m.keep = m.topic == "weakgrid/health"; });
  const test::Ended verify = test::run("weakgrid", {"verify", folder / "empty.mcap"});
  EXPECT_EQ(verify.status, 1);
  EXPECT_NE(verify.out.find("NOTHING to compare"), std::string::npos) << verify.out;
}

}  // namespace
}  // namespace weakgrid
