// Seeds: see the header.
#include "tests/fuzz/seeds.hpp"

#include <filesystem>
#include <fstream>
#include <stdexcept>

#include "services/journal/journal_line.hpp"
#include "services/recording/idl_text.hpp"
#include "services/recording/mcap_writer.hpp"
#include "services/runtime/settings.hpp"
#include "tests/recording/payload_of.hpp"

namespace weakgrid::fuzz {

namespace {

struct Sample {
  const char *topic, *type;
  mcap::Bytes payload;
};

template <class Message>
Sample sample(const char* type, const Message& message) {
  return {Topic<Message>::name, type, payload_of(1, message)};
}

std::vector<Sample> samples() {
  Measurement measurement;
  measurement.step = 7;
  measurement.timing.period_ns = 100'000;
  measurement.v_p = {1.0, -0.5};
  DecisionMessage decision;
  for (const Limit limit : {Limit::current, Limit::control, Limit::dc_voltage_max})
    decision.decision.margins.add({limit, true, -0.1});
  decision.text = "outside the envelope";
  Health health;
  health.service = "plant";
  health.counters = {{"holds", 3}, {"resends", 0}};
  health.digest = std::string(64, 'a');
  health.text = "waits for a \"controller\",\nand waits";
  const Manifest manifest{.service = "gateway",
                          .instance = 1,
                          .build = "test",
                          .settings = "[unit]\nnumber = 1\n",
                          .constants = {{"a", 0.1}, {"b", 1e300}},
                          .digest = std::string(64, 'b')};
  Envelope envelope;
  envelope.held_until_step = 1000;
  envelope.holder.name.text = {'a', 'n', 'n'};
  envelope.margins.add({Limit::current, true, 0.25});
  return {sample("weakgrid::wire::Measurement", measurement),
          sample("weakgrid::wire::Modulation", Modulation{}),
          sample("weakgrid::wire::SetpointRequest", Request{}),
          sample("weakgrid::wire::SetpointDecision", decision),
          sample("weakgrid::wire::Envelope", envelope),
          sample("weakgrid::wire::Reference", Reference{.id = 1, .p = 0.5, .v_c = 1.8}),
          sample("weakgrid::wire::Operation", Operation{.client = 1, .id = 2, .until_step = 3}),
          sample("weakgrid::wire::ControllerState", ControllerState{}),
          sample("weakgrid::wire::Health", health),
          sample("weakgrid::wire::Manifest", manifest)};
}

void check(const mcap::Status& status) {
  if (!status.ok()) throw std::runtime_error("a seed cannot be written: " + status.text());
}

void write_recording(const std::string& path, mcap::Compression compression) {
  mcap::Writer writer;
  mcap::WriterOptions options;
  options.version = "fuzz";
  options.compression = compression;
  options.chunk_bytes = 1024;
  check(writer.open(path, options));
  check(writer.write_metadata("version", {{"release", "fuzz"}, {"empty", ""}}));
  check(writer.write_attachment({5, 0, "settings.toml", "text/plain", mcap::Bytes(40, std::byte{'x'})}));
  std::uint32_t count = 0;
  for (int round = 0; round < 2; ++round)
    for (const Sample& of : samples()) {
      // A schema's text is of no use to a reader of ours, and would be most of a seed.
      const auto schema = writer.add_schema(of.type, "omgidl", "module m { };");
      const auto channel = writer.add_channel(schema, of.topic, "cdr", {{"writer", "01|2"}});
      const std::uint64_t log_ns = 1000 + count - (count % 5 == 0 ? 3 : 0);
      check(writer.write_message(channel, ++count, log_ns, log_ns - 1, of.payload));
    }
  check(writer.write_metadata("end", {}));
  check(writer.close());
}

}  // namespace

std::vector<mcap::Bytes> payload_seeds() {
  std::vector<mcap::Bytes> seeds;
  for (Sample& of : samples()) seeds.push_back(std::move(of.payload));
  return seeds;
}

std::vector<mcap::Bytes> recording_seeds(const std::string& folder) {
  std::vector<mcap::Bytes> seeds;
  const std::string path = folder + "/seed.mcap";
  for (const auto compression : {mcap::Compression::none, mcap::Compression::zstd, mcap::Compression::lz4}) {
    write_recording(path, compression);
    std::ifstream file{path, std::ios::binary};
    const std::string text{std::istreambuf_iterator<char>{file}, {}};
    const auto bytes = std::as_bytes(std::span{text});
    seeds.emplace_back(bytes.begin(), bytes.end());
    std::filesystem::remove(path);
  }
  return seeds;
}

std::vector<std::string> settings_seeds() {
  Settings settings;
  settings.gateway.grid_resistance = Interval{0.1, 0.2};
  Scenario& scenario = settings.scenario.emplace();
  scenario.title = "fuzz \"µ\"";
  scenario.end_s = 1.0;
  scenario.setpoints = {{.at_s = 0.1,
                         .active_power = 0.5,
                         .reactive_power = {},
                         .dc_voltage = {},
                         .ramp_s = 0.1,
                         .lease_s = 0.0}};
  scenario.events = {{.at_s = 0.2, .quantity = Quantity::source_power, .value = 1.0, .ramp_s = 0.0}};
  return {"", to_toml(Settings{}), to_toml(settings), "[unit]\nnumber = 0\n",
          "unit = { number = 1, domain = 2 }\n"};
}

std::vector<std::string> schedule_seeds() {
  return {"at_s,active_power\n0,0.5\n1.5,0.25\n",
          "# a day\nat_s, active_power, reactive_power, dc_voltage, ramp_s, lease_s\n"
          "0, 0.5, -0.1, 1.84, 0.1, 60\n\n3600, , 0.2, , ,\n\"7200\",1e-3,,2,60,86400\r\n"};
}

std::vector<std::string> journal_seeds() {
  std::string text, previous = journal_beginning();
  std::vector<std::string> seeds;
  const std::vector<nlohmann::json> bodies{{{"text", "accepted"}, {"p", 0.707}},
                                           nlohmann::json::object(),
                                           {{"margins", {{"current", {1e300, "nan"}}}}, {"text", "\n\"µ\""}}};
  for (const nlohmann::json& body : bodies) {
    const auto line =
        journal_line(seeds.size() + 1, 1'000'000'000 * seeds.size(), "decision", body, previous);
    if (!line) throw std::runtime_error("a seed cannot be written: " + body.dump());
    text += line->bytes;
    previous = line->hash;
    seeds.push_back(text);
  }
  return seeds;
}

}  // namespace weakgrid::fuzz
