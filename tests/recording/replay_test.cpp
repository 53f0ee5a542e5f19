// weakgrid-replayer over real DDS: the bytes, the order and the times of the recording, and it says what it
// does not do.
#include <fcntl.h>
#include <signal.h>
#include <sys/socket.h>
#include <unistd.h>

#include <mutex>
#include <nlohmann/json.hpp>
#include <set>
#include <thread>

#include "services/recording/recorder.hpp"
#include "services/runtime/payload_cdr.hpp"
#include "services/runtime/raw_writer.hpp"
#include "services/runtime/tap.hpp"
#include "services/runtime/wire.hpp"
#include "tests/recording/recording_support.hpp"
#include "tests/support/processes_under_test.hpp"

namespace weakgrid {
namespace {

using mcap::Bytes;
using mcap::Folder;
using nlohmann::json;
using test::wait_until;

constexpr std::uint64_t ms = 1'000'000;

/// What a recorded writer was.
struct Source {
  std::string topic, type = "their::Blob";
  bool keyed = false, reliable = true, transient_local = false;
  std::string writer{};
};

/// A recording made by hand.
class Recorded {
 public:
  explicit Recorded(const std::string& path) : path_(path) {
    mcap::WriterOptions options;
    options.version = "test";
    EXPECT_TRUE(file_.open(path, options).ok());
  }
  ~Recorded() { EXPECT_TRUE(file_.close().ok()); }

  mcap::ChannelId add(const Source& s) {
    const auto text = [](bool flag) { return flag ? "true" : "false"; };
    const std::string qos = std::string("reliability: ") + text(s.reliable) +
                            "\ndurability: " + text(s.transient_local) +
                            "\nownership: false\nkeyed: " + text(s.keyed) + "\n";
    const std::string writer =
        s.writer.empty() ? "01.0f.01|0.0." + std::to_string(++writers_) + ".3" : s.writer;
    return file_.add_channel(file_.add_schema(s.type, "", ""), s.topic, "cdr",
                             {{"qos", qos}, {"partitions", ""}, {"writer", writer}});
  }
  void put(mcap::ChannelId channel, std::uint64_t at_ns, const Bytes& payload) {
    constexpr std::uint64_t begin_ns = 1'700'000'000'000'000'000;
    EXPECT_TRUE(file_.write_message(channel, ++sequence_, begin_ns + at_ns, begin_ns + at_ns, payload).ok());
  }
  void attach_settings(const std::string& toml) {
    EXPECT_TRUE(file_.write_attachment({1, 1, settings_attachment, "", mcap::bytes_of(toml)}).ok());
  }

 private:
  std::string path_;
  mcap::Writer file_;
  std::uint32_t sequence_ = 0, writers_ = 0;
};

Bytes number_payload(std::uint32_t n) {
  Bytes payload{std::byte{0}, std::byte{1}, std::byte{0}, std::byte{0}};
  mcap::put(payload, n);
  return payload;
}

std::uint32_t number_of(const Bytes& payload) { return mcap::load<std::uint32_t>(payload.data() + 4); }

template <class Message>
Bytes payload_of(const Message& message, std::uint32_t unit) {
  typename Topic<Message>::Wire wire;
  encode(message, wire);
  wire.unit(unit);
  const Bytes bytes = serialize<typename Topic<Message>::Type>(wire);
  EXPECT_FALSE(bytes.empty());
  return bytes;
}

/// Hears a whole domain and writes nothing, so that nobody minds.
class Ears {
 public:
  explicit Ears(const test::Domain& domain)
      : tap_(
            {.domain = domain.number(),
             .dds = {},
             .filter = {.topics = {}, .excluded = {"weakgrid/*"}}},
            [this](const SourceWriter& writer) {
              const std::lock_guard lock(mutex_);
              topics_.push_back(writer.topic);
            },
            [this](const RawSample& sample) {
              if (!sample.has_data) return;
              const std::lock_guard lock(mutex_);
              heard_[topics_[sample.writer]].emplace_back(sample.payload.begin(), sample.payload.end());
            }) {}

  std::vector<std::uint32_t> numbers(const std::string& topic) const {
    const std::lock_guard lock(mutex_);
    std::vector<std::uint32_t> numbers;
    if (const auto heard = heard_.find(topic); heard != heard_.end())
      for (const Bytes& payload : heard->second) numbers.push_back(number_of(payload));
    return numbers;
  }
  /// Topics of which anything was heard.
  std::vector<std::string> topics() const {
    const std::lock_guard lock(mutex_);
    std::vector<std::string> topics;
    for (const auto& [topic, payloads] : heard_) topics.push_back(topic);
    return topics;
  }
  std::size_t writers() const {
    const std::lock_guard lock(mutex_);
    return topics_.size();
  }

 private:
  mutable std::mutex mutex_;
  std::vector<std::string> topics_;
  std::map<std::string, std::vector<Bytes>> heard_;
  Tap tap_;
};

std::vector<std::uint32_t> numbers(std::uint32_t from, std::uint32_t until) {
  std::vector<std::uint32_t> all;
  for (std::uint32_t n = from; n < until; ++n) all.push_back(n);
  return all;
}

test::Ended replay(const test::Domain& domain, const std::string& file, std::vector<std::string> more = {}) {
  more.insert(more.begin(), {file, "--domain", domain.text(), "--json"});
  if (std::find(more.begin(), more.end(), "--wait") == more.end()) more.insert(more.end(), {"--wait", "20"});
  return test::run("weakgrid-replayer", more);
}

json report_of(const test::Ended& ended) {
  EXPECT_EQ(ended.status, 0) << ended.err;
  json report = json::parse(ended.out, nullptr, false);
  EXPECT_FALSE(report.is_discarded()) << ended.out << ended.err;
  return report;
}

/// A replayer at whose stdin a person sits.
class Typed {
 public:
  Typed(const test::Domain& domain, const std::string& file, std::vector<std::string> more) {
    more.insert(more.begin(), {file, "--domain", domain.text(), "--json"});
    if (std::find(more.begin(), more.end(), "--wait") == more.end())
      more.insert(more.end(), {"--wait", "20"});
    int ends[2];
    if (socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends) != 0) std::abort();
    const int before = fcntl(STDIN_FILENO, F_DUPFD_CLOEXEC, 3);
    dup2(ends[1], STDIN_FILENO);
    program_.emplace("weakgrid-replayer", more);
    if (before >= 0)
      dup2(before, STDIN_FILENO), close(before);
    else
      close(STDIN_FILENO);
    close(ends[1]);
    input_ = ends[0];
  }
  ~Typed() { close(input_); }
  void type(const std::string& line) {
    const std::string text = line + "\n";
    EXPECT_EQ(send(input_, text.data(), text.size(), MSG_NOSIGNAL), static_cast<ssize_t>(text.size()));
  }
  bool says(const std::string& words) {
    return wait_until(
               [&] { return program_->err().find(words) != std::string::npos || !program_->runs(); }) &&
           program_->err().find(words) != std::string::npos;
  }
  std::string said() const { return program_->err(); }
  /// Nobody types any more.
  void leave() { shutdown(input_, SHUT_WR); }
  test::Ended ended() {
    const int status = program_->wait().value_or(-1);
    return {status, program_->out(), program_->err()};
  }

 private:
  std::optional<test::Program> program_;
  int input_ = -1;
};

/// Of a recording in the order of time, without what these two instances say of themselves.
std::vector<std::pair<std::string, Bytes>> payloads(const std::vector<mcap::Entry>& entries,
                                                    const std::set<std::uint64_t>& without = {}) {
  std::vector<std::pair<std::string, Bytes>> all;
  for (const mcap::Entry& entry : entries) {
    std::uint64_t instance = 0;
    if (entry.topic == "weakgrid/health")
      instance = from_payload<Health>(entry.data)->message.instance;
    else if (entry.topic == "weakgrid/manifest")
      instance = from_payload<Manifest>(entry.data)->message.instance;
    if (without.count(instance) == 0) all.emplace_back(entry.topic, entry.data);
  }
  return all;
}

TEST(Replay, ARunRecordedReplayedAndRecordedAgainIsTheSameBytesInTheSameOrder) {
  const test::Domain domain;
  const test::TextFile scenario(
      "[grid]\nreactance = 0.3\n[scenario]\nend_s = 0.3\n"
      "[[scenario.setpoint]]\nat_s = 0.01\nactive_power = 0.5\n");
  const Folder folder;
  const test::Ended run = test::run(
      "weakgrid", {"run", scenario.path(), "--domain", domain.text(), "--record", folder / "first.mcap"});
  ASSERT_EQ(run.status, 0) << run.out << run.err;

  const test::Domain other;
  test::Program recorder("weakgrid-recorder", {"--domain", other.text(), "--output", folder / "second.mcap",
                                               "--instance", "1001"});
  Bus bus(other.number(), {}, Role::client);
  std::atomic<bool> recorder_runs{false};
  const Reader<Health> health(bus, 1, [&](const Health& h, Arrival) {
    if (h.instance == 1001 && h.state == ServiceState::running) recorder_runs = true;
  });
  ASSERT_TRUE(wait_until([&] { return recorder_runs.load(); }));
  const json report = report_of(replay(other, folder / "first.mcap", {"--instance", "1002"}));
  recorder.send(SIGTERM);
  ASSERT_EQ(recorder.wait(), 0) << recorder.err();

  const auto first = payloads(mcap::by_time(folder / "first.mcap"));
  const auto second = payloads(mcap::content_of(folder / "second.mcap").messages, {1001, 1002});
  EXPECT_GT(first.size(), 6000u);
  EXPECT_EQ(report["messages"], first.size());
  EXPECT_EQ(report["unsent"], 0);
  ASSERT_EQ(second.size(), first.size());
  const auto differs = std::mismatch(first.begin(), first.end(), second.begin());
  EXPECT_TRUE(differs.first == first.end())
      << "message " << differs.first - first.begin() << ": " << differs.first->first << " comes back as "
      << differs.second->first;
  std::printf("timing error of %zu messages in %.3f s: %s us\n", first.size(),
              report["duration_s"].get<double>(), report["timing_error_us"].dump().c_str());
  EXPECT_EQ(test::run("weakgrid", {"info", folder / "second.mcap"}).status, 0);
  EXPECT_EQ(test::run("weakgrid", {"verify", folder / "second.mcap"}).status, 0);
}

TEST(Replay, OnlyWhatIsSelectedIsWrittenUnderTheNameAskedFor) {
  const test::Domain domain;
  const Folder folder;
  {
    Recorded file(folder / "a.mcap");
    const auto x = file.add({.topic = "a/x"}), y = file.add({.topic = "a/y"}), z = file.add({.topic = "b/z"});
    for (std::uint32_t n = 0; n < 20; ++n)
      for (const auto channel : {x, y, z}) file.put(channel, n * 10 * ms, number_payload(n));
  }
  const Ears ears(domain);
  const auto report = report_of(replay(domain, folder / "a.mcap",
                                       {"--start", "0.05", "--until", "0.1", "--topic", "a/*", "--topic",
                                        "b/z", "--exclude", "*/y", "--remap", "a/x=c/x"}));
  EXPECT_EQ(ears.topics(), (std::vector<std::string>{"b/z", "c/x"}));
  EXPECT_EQ(ears.numbers("c/x"), numbers(5, 10));
  EXPECT_EQ(ears.numbers("b/z"), numbers(5, 10));
  EXPECT_EQ(report["messages"], 10);
}

TEST(Replay, PartsOfARecordingArePlayedAsOneByTheirTimesAndOnceMoreForEachPass) {
  const test::Domain domain;
  const Folder folder;
  {
    Recorded first(folder / "a.mcap"), second(folder / "a_0002.mcap");
    const Source source{.topic = "a/x", .writer = "01.0f.01|0.0.1.3"};
    const auto x = first.add(source), x_again = second.add(source);
    for (std::uint32_t n = 0; n < 20; ++n)
      n % 3 == 0 ? first.put(x, n * ms, number_payload(n)) : second.put(x_again, n * ms, number_payload(n));
  }
  const Ears ears(domain);
  const auto report =
      report_of(test::run("weakgrid-replayer", {"--domain", domain.text(), "--wait", "20", "--json",
                                                folder / "a_0002.mcap", folder / "a.mcap", "--loop", "3"}));
  std::vector<std::uint32_t> expected;
  for (int pass = 0; pass < 3; ++pass)
    for (std::uint32_t n = 0; n < 20; ++n) expected.push_back(n);
  EXPECT_EQ(ears.numbers("a/x"), expected);
  EXPECT_EQ(ears.writers(), 1u) << "one writer, as was recorded";
  EXPECT_GE(report["duration_s"], 0.057);
}

TEST(Replay, AtRateFourItTakesAQuarterOfTheTime) {
  const test::Domain domain;
  const Folder folder;
  {
    Recorded file(folder / "a.mcap");
    const auto x = file.add({.topic = "a/x"});
    for (std::uint32_t n = 0; n <= 200; ++n) file.put(x, n * 10 * ms, number_payload(n));
  }
  const Ears ears(domain);
  const auto report = report_of(replay(domain, folder / "a.mcap", {"--rate", "4"}));
  EXPECT_GE(report["duration_s"], 0.499);
  EXPECT_LT(report["duration_s"], 1.0);
  EXPECT_EQ(ears.numbers("a/x"), numbers(0, 201));
}

TEST(Replay, AsFastAsPossibleLosesNothingThatIsReliable) {
  const test::Domain domain;
  const Folder folder;
  constexpr std::uint32_t count = 20'000;
  {
    Recorded file(folder / "a.mcap");
    const auto x = file.add({.topic = "a/x"}), y = file.add({.topic = "a/y", .reliable = false});
    Bytes large = number_payload(count);
    large.resize(300'000, std::byte{7});
    for (std::uint32_t n = 0; n < count; ++n) {
      file.put(x, n * 100 * ms, number_payload(n));
      if (n % 4 == 0) file.put(y, n * 100 * ms, number_payload(n));
    }
    file.put(x, count * 100 * ms, large);
  }
  const Ears ears(domain);
  const auto report = report_of(replay(domain, folder / "a.mcap", {"--rate", "max"}));
  EXPECT_TRUE(ears.numbers("a/x") == numbers(0, count + 1)) << ears.numbers("a/x").size();
  EXPECT_EQ(report["messages"], count + 1 + count / 4);
  EXPECT_TRUE(report["timing_error_us"].is_null());
  std::printf("%.0f messages/s\n", report["messages"].get<double>() / report["duration_s"].get<double>());
}

TEST(Replay, StepsPausesAndGoesOnAsTyped) {
  const test::Domain domain;
  const Folder folder;
  constexpr std::uint32_t count = 1000;
  {
    Recorded file(folder / "a.mcap");
    const auto x = file.add({.topic = "a/x"});
    for (std::uint32_t n = 0; n < count; ++n) file.put(x, n * 10 * ms, number_payload(n));
  }
  const Ears ears(domain);
  Bus bus(domain.number(), {}, Role::client);
  std::mutex mutex;
  Health health;
  const Reader<Health> reader(bus, 7, [&](const Health& h, Arrival) {
    const std::lock_guard lock(mutex);
    health = h;
  });
  const auto is_said = [&](ServiceState state, const std::string& text) {
    return wait_until([&] {
      const std::lock_guard lock(mutex);
      return health.service == "replayer" && health.state == state && health.text == text;
    });
  };
  Typed replayer(domain, folder / "a.mcap", {"--step", "--unit", "7"});
  ASSERT_TRUE(replayer.says("paused at 0.000000 s after 0 messages"));
  replayer.type("step 3");
  ASSERT_TRUE(replayer.says("paused at 0.020000 s after 3 messages"));
  EXPECT_TRUE(wait_until([&] { return ears.numbers("a/x") == numbers(0, 3); }));
  EXPECT_TRUE(is_said(ServiceState::waiting, "paused at 0.020000 s after 3 messages"));
  replayer.type("sing");
  EXPECT_TRUE(replayer.says("'sing' is no command; allowed: pause, resume, step [N], rate X|max, quit"));
  replayer.type("step");
  ASSERT_TRUE(replayer.says("after 4 messages"));
  replayer.type("resume");
  ASSERT_TRUE(wait_until([&] { return ears.numbers("a/x").size() >= 10; }));
  EXPECT_TRUE(is_said(ServiceState::running, ""));
  replayer.type("pause");
  const auto stands = [&] {
    const std::string said = replayer.said();
    return said.rfind("paused at") > said.find("after 4 messages");
  };
  ASSERT_TRUE(wait_until(stands));
  const auto heard = ears.numbers("a/x");
  EXPECT_LT(heard.size(), count);
  std::this_thread::sleep_for(test::milliseconds(100));
  EXPECT_EQ(ears.numbers("a/x"), heard) << "while paused nothing comes";
  replayer.type("rate max");
  replayer.type("resume");
  EXPECT_EQ(report_of(replayer.ended())["messages"], count);
  EXPECT_EQ(ears.numbers("a/x"), numbers(0, count));
  EXPECT_TRUE(is_said(ServiceState::stopped, "stopped"));
  EXPECT_EQ(health.counters.front(), (Counter{"messages", count}));
}

TEST(Replay, QuitsAsTypedAndEndsWhenNobodyCanResume) {
  const test::Domain domain;
  const Folder folder;
  {
    Recorded file(folder / "a.mcap");
    const auto x = file.add({.topic = "a/x"});
    for (std::uint32_t n = 0; n < 10; ++n) file.put(x, n * 100'000 * ms, number_payload(n));
  }
  Typed replayer(domain, folder / "a.mcap", {"--interactive", "--wait", "0"});
  ASSERT_TRUE(replayer.says("matches with readers"));
  replayer.type("quit");
  EXPECT_EQ(report_of(replayer.ended())["messages"].get<int>() / 2, 0);
  Typed alone(domain, folder / "a.mcap", {"--step", "--wait", "0"});
  alone.type("step 4");
  alone.leave();
  EXPECT_EQ(report_of(alone.ended())["messages"], 4);
}

TEST(Replay, ADomainWhereSomebodyWritesTheTopicIsRefusedUnlessMixed) {
  const test::Domain domain;
  const Folder folder;
  {
    Recorded file(folder / "a.mcap");
    file.put(file.add({.topic = "a/x"}), 0, number_payload(0));
    file.put(file.add({.topic = "a/y"}), 0, number_payload(0));
  }
  RawBus bus(domain.number(), {});
  const RawWriter writer(bus, {.topic = "a/x", .type = "their::Blob"});
  const test::Ended refused = replay(domain, folder / "a.mcap");
  EXPECT_EQ(refused.status, 3);
  EXPECT_NE(refused.err.find("topic a/x is written in domain " + domain.text()), std::string::npos)
      << refused.err;
  EXPECT_EQ(replay(domain, folder / "a.mcap", {"--exclude", "a/x", "--wait", "0"}).status, 0);
  EXPECT_EQ(replay(domain, folder / "a.mcap", {"--mix", "--wait", "0"}).status, 0);
}

/// Typed readers of two units.
struct Listener {
  explicit Listener(std::uint32_t domain) : bus(domain, {}, Role::client) {}
  void hear(const Health& h, std::uint32_t unit) {
    const std::lock_guard lock(mutex);
    if (h.service != "replayer") healths[{unit, h.service}].push_back(h.step);
  }
  void hear(const Measurement& m, std::uint32_t unit) {
    const std::lock_guard lock(mutex);
    steps[unit].push_back(m.step);
  }
  template <class Heard>
  bool hears(Heard Listener::*what, const Heard& all) {
    return wait_until([&] {
      const std::lock_guard lock(mutex);
      return this->*what == all;
    });
  }
  using Steps = std::vector<std::uint64_t>;
  std::mutex mutex;
  std::map<std::pair<std::uint32_t, std::string>, Steps> healths;
  std::map<std::uint32_t, Steps> steps;
  Bus bus;
  Reader<Health> health_1{bus, 1, [this](const Health& h, Arrival) { hear(h, 1); }};
  Reader<Health> health_2{bus, 2, [this](const Health& h, Arrival) { hear(h, 2); }};
  Reader<Measurement> unit_1{bus, 1, [this](const Measurement& m, Arrival) { hear(m, 1); }};
  Reader<Measurement> unit_2{bus, 2, [this](const Measurement& m, Arrival) { hear(m, 2); }};
};

TEST(Replay, UnitsAndServicesOfOneWriterStayInstancesAlsoForALateJoiner) {
  const test::Domain domain;
  const Folder folder;
  {
    Recorded file(folder / "a.mcap");
    const auto health = file.add({.topic = Topic<Health>::name,
                                  .type = "weakgrid::wire::Health",
                                  .keyed = true,
                                  .transient_local = true});
    const auto sample = file.add({.topic = Topic<Measurement>::name,
                                  .type = "weakgrid::wire::Measurement",
                                  .keyed = true,
                                  .reliable = false});
    std::uint64_t at_ns = 0;
    for (std::uint64_t step = 1; step <= 3; ++step)
      for (const std::uint32_t unit : {1u, 2u}) {
        for (const char* service : {"plant", "gateway"}) {
          Health h;
          h.service = service;
          h.step = step;
          file.put(health, at_ns += ms, payload_of(h, unit));
        }
        Measurement m;
        m.step = 10 * unit + step;
        m.timing.period_ns = 100'000;
        file.put(sample, at_ns += ms, payload_of(m, unit));
      }
    file.put(sample, at_ns + 3600'000 * ms, payload_of(Measurement{}, 1));
  }
  using Steps = Listener::Steps;
  Listener early(domain.number());
  Typed replayer(domain, folder / "a.mcap", {"--interactive"});
  EXPECT_TRUE(early.hears(&Listener::steps, {{1, Steps{11, 12, 13}}, {2, Steps{21, 22, 23}}}));
  const Steps all{1, 2, 3}, last{3};
  EXPECT_TRUE(
      early.hears(&Listener::healths,
                  {{{1, "plant"}, all}, {{1, "gateway"}, all}, {{2, "plant"}, all}, {{2, "gateway"}, all}}));
  Listener late(domain.number());
  EXPECT_TRUE(late.hears(
      &Listener::healths,
      {{{1, "plant"}, last}, {{1, "gateway"}, last}, {{2, "plant"}, last}, {{2, "gateway"}, last}}));
  replayer.type("quit");
  EXPECT_EQ(report_of(replayer.ended())["messages"], 18);
}

TEST(Replay, OfAForeignKeyedTypeEachWriterIsAnInstanceAndThatIsSaidOnce) {
  const test::Domain domain;
  const Folder folder;
  {
    Recorded file(folder / "a.mcap");
    for (std::uint32_t writer = 0; writer < 2; ++writer)
      for (const auto channel = file.add({.topic = "a/x", .type = "their::Keyed", .keyed = true});
           auto n : {0u, 1u})
        file.put(channel, (2 * writer + n) * ms, number_payload(2 * writer + n));
  }
  const Ears ears(domain);
  const test::Ended ended = replay(domain, folder / "a.mcap");
  report_of(ended);
  EXPECT_EQ(ears.numbers("a/x"), numbers(0, 4));
  const std::string warning = "a/x: the key of type their::Keyed is not known";
  EXPECT_NE(ended.err.find(warning), std::string::npos) << ended.err;
  EXPECT_EQ(ended.err.find(warning), ended.err.rfind(warning));
}

TEST(Replay, WithoutADomainItGoesAHundredBesideTheRecordedOneAndSaysSo) {
  const test::Domain domain;
  const Folder folder;
  {
    Recorded file(folder / "a.mcap");
    file.attach_settings("[unit]\ndomain = " + std::to_string(domain.number() - 100) + "\n");
    file.put(file.add({.topic = "a/x"}), 0, number_payload(0));
  }
  const Ears ears(domain);
  const test::Ended ended = test::run("weakgrid-replayer", {folder / "a.mcap", "--wait", "20", "--json"});
  EXPECT_EQ(report_of(ended)["domain"], domain.number());
  EXPECT_NE(ended.err.find("replays into domain " + domain.text()), std::string::npos) << ended.err;
  EXPECT_EQ(ears.numbers("a/x"), numbers(0, 1));
}

TEST(Replay, BadInputIsRefusedByNameAndByWhatIsAllowed) {
  const Folder folder;
  mcap::write_bytes(folder / "text", mcap::bytes_of("not a recording at all"));
  {
    Recorded file(folder / "a.mcap");
    file.put(file.add({.topic = "a/x"}), 0, number_payload(0));
    Recorded other(folder / "b.mcap");
    other.put(other.add({.topic = "a/x", .type = "their::Other"}), 0, number_payload(0));
  }
  const std::string a = folder / "a.mcap";
  const struct {
    std::vector<std::string> arguments;
    std::string said;
  } cases[] = {
      {{folder / "missing"}, folder / "missing"},
      {{folder / "text"}, "not an MCAP file"},
      {{a}, "give --domain"},
      {{a, "--topic", "nothing"}, "no topic is selected"},
      {{a, "--start", "10"}, "no message is selected"},
      {{a, "--start", "2", "--until", "1"}, "--until 1: must be above --start 2"},
      {{a, "--remap", "a/x"}, "--remap a/x: wanted is FROM=TO"},
      {{a, "--remap", "b/y=c"}, "no recording has a topic b/y"},
      {{a, "--remap", "a/x=c", "--remap", "a/x=d"}, "a/x is remapped twice"},
      {{a, folder / "b.mcap"}, "cannot be written together"},
      {{a, "--rate", "0"}, "--rate: 0: allowed is"},
      {{a, "--loop", "0"}, "--loop: 0: allowed is"},
      {{a, "--domain", "231"}, "--domain"},
      {{}, "RECORDING"},
  };
  for (const auto& bad : cases) {
    const test::Ended ended = test::run("weakgrid-replayer", bad.arguments);
    EXPECT_EQ(ended.status, 2) << bad.said;
    EXPECT_NE(ended.err.find(bad.said), std::string::npos) << bad.said << " is not in: " << ended.err;
  }
}

}  // namespace
}  // namespace weakgrid
