// weakgrid run: plant, controller and gateway as processes, a scenario played through the gateway, a verdict.
#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <nlohmann/json.hpp>
#include <set>

#include "services/cli/client.hpp"
#include "services/cli/commands.hpp"
#include "services/cli/processes.hpp"
#include "services/cli/report.hpp"
#include "services/decision_text.hpp"
#include "services/runtime/announcer.hpp"
#include "services/runtime/program.hpp"

namespace weakgrid {

namespace {

constexpr Patience to_start{30'000};  // three processes on a busy machine
constexpr Patience to_answer{10'000};

struct Options {
  std::string file;
  std::string log = "warning";
  std::optional<std::uint32_t> domain;
  std::string record;
  bool json = false;
};

// What a recording of a run must have from its first sample on.
constexpr const char* recorded_topics[] = {"weakgrid/measurement",      "weakgrid/modulation",
                                           "weakgrid/setpoint_request", "weakgrid/setpoint_decision",
                                           "weakgrid/reference",        "weakgrid/operation"};

// One scenario against services that run.
class Conductor {
 public:
  using Instances = std::set<std::pair<std::string, std::uint64_t>>;  // (service, instance)

  Conductor(const Settings& settings, Instances mine, Processes& processes, Processes& recorder,
            StopSignal& stop)
      : settings_(settings),
        processes_(processes),
        recorder_(recorder),
        stop_(stop),
        mine_(std::move(mine)),
        client_(settings.unit.domain, settings.unit.number, settings.dds),
        record_(settings),
        measurements_(client_.bus(), settings.unit.number,
                      [this](const Measurement& m, Arrival) {
                        const std::lock_guard lock(mutex_);
                        if (m.step == next_to_see_)
                          ++next_to_see_;
                        else if (m.step > next_to_see_)
                          next_to_see_ = m.step + 1;
                        else
                          return;  // sent again
                        record_.see(m);
                      }),
        modulations_(client_.bus(), settings.unit.number, [this](const Modulation& mu, Arrival) {
          const std::lock_guard lock(mutex_);
          record_.see(mu);
        }) {}

  Outcome play(bool is_recorded) {
    Outcome outcome;
    outcome.over_dds = true;
    outcome.in_lockstep = settings_.plant.pace == Pace::lockstep;
    wait("the services to start", [this](Patience p) {
      return client_.wait_for(p, [this](const Client::Peers& peers) {
        return std::all_of(mine_.begin(), mine_.end(),
                           [&](const auto& key) { return peers.count(key) != 0; });
      });
    });
    wait("whoever served this unit before to be gone",
         [this](Patience) { return company() == Company::none; });
    // It listens first whether another does.
    wait("the gateway to serve", [this](Patience p) {
      return client_.wait_for("gateway", p, [this](const Health& h) {
        return is_mine(h) && h.state == ServiceState::running;
      });
    });
    if (is_recorded) start_recording();
    wait("plant and observer to meet", [this](Patience) {
      stop_.wait(Patience(5));
      return measurements_.matched() > 0 && modulations_.matched() > 0;
    });
    for (const auto& setpoint : settings_.scenario->setpoints) {
      const std::uint64_t step = step_at(settings_, setpoint.at_s);
      advance(step, outcome);
      const auto answer = client_.ask(request(settings_, setpoint, 0, 0), to_answer);
      if (!answer) throw std::runtime_error("the gateway does not answer");
      outcome.decisions.push_back(answer->decision);
      {
        const std::lock_guard lock(mutex_);
        record_.see(answer->decision);
      }
      if (!answer->decision.reference) continue;
      const std::uint32_t id = answer->decision.reference->id;
      for (const char* reader : {"plant", "controller"})
        wait(fmt::format("the {} to take reference {}", reader, id), [&](Patience p) {
          return client_.wait_for(reader, p,
                                  [&](const Health& h) { return is_mine(h) && h.reference_id >= id; });
        });
    }
    advance(record_.end_step(), outcome);
    finish(outcome);
    return outcome;
  }

 private:
  // `attempt` waits a while and says whether it has come; between attempts: is everybody still there?
  void wait(const std::string& what, const std::function<bool(Patience)>& attempt) {
    const auto deadline = std::chrono::steady_clock::now() + to_start;
    while (!attempt(Patience(50))) {
      if (stop_.wait(Patience(0))) throw std::runtime_error("stopped by a signal");
      check_processes();
      refuse_company();
      if (std::chrono::steady_clock::now() > deadline)
        throw std::runtime_error("gave up waiting for " + what);
    }
  }

  // Says what it plays, so that the recording tells; then everybody has met the recorder.
  void start_recording() {
    Writer<Manifest>& manifest = manifest_.emplace(client_.bus(), settings_.unit.number);
    Manifest what{.service = "run",
                  .instance = random_identity(),
                  .build = build_text(),
                  .settings = to_toml(settings_),
                  .constants = {},
                  .digest = {}};
    what.digest = digest_of(settings_.unit.number, what);
    if (!manifest.write(what)) throw BusError("DDS: the manifest cannot be written");
    wait("the recorder to hear everybody", [this](Patience p) {
      return client_.wait_for(
          "recorder", p, [this](const Health& h) { return is_mine(h) && h.state == ServiceState::running; });
    });
  }

  void check_processes() {
    for (Processes* some : {&processes_, &recorder_})
      if (const std::string name = some->ended(); !name.empty())
        throw std::runtime_error(name + " has ended by itself; its reason is above");
  }

  enum class Company : std::uint8_t { none, silent, alive };
  // Somebody else's services of this unit: alive if one has spoken since this run began; silent ones may be
  // dead, and then say nothing for longer than the second that health takes.
  Company company() const {
    Company company = Company::none;
    for (const auto& [key, health] : client_.peers()) {
      if (health.state == ServiceState::stopped || mine_.count(key) != 0) continue;
      if (key.first == "recorder") continue;  // listens, serves nobody
      if (health.wall_time_ns >= started_ns_) return Company::alive;
      if (wall_time_ns() - started_ns_ < 2'000'000'000) company = Company::silent;
    }
    return company;
  }
  void refuse_company() const {
    if (company() == Company::alive)
      throw std::runtime_error(fmt::format("unit {} is already served in domain {}: give another --domain",
                                           settings_.unit.number, settings_.unit.domain));
  }

  // Lets the unit go on to `step` and wait there.
  void advance(std::uint64_t step, Outcome& outcome) {
    const auto start = std::chrono::steady_clock::now();
    if (!client_.operate(OperationKind::advance, step, to_answer))
      throw std::runtime_error("the plant takes no operation");
    std::uint64_t last_step = 0;
    auto deadline = std::chrono::steady_clock::now() + to_start;
    while (!client_.wait_for("plant", Patience(200), [&](const Health& h) {
      return is_mine(h) && h.state == ServiceState::waiting && h.step >= step && !h.digest.empty();
    })) {
      if (stop_.wait(Patience(0))) throw std::runtime_error("stopped by a signal");
      check_processes();
      const std::uint64_t now_at = health_of("plant").step;
      if (now_at == 0) refuse_company();  // whoever has begun stays
      const auto now = std::chrono::steady_clock::now();
      if (now_at > last_step) deadline = now + to_start;
      last_step = now_at;
      if (now > deadline) throw std::runtime_error(fmt::format("the unit stands still at step {}", now_at));
    }
    outcome.wall_s += std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    // What is asked next is judged at this step. Samples are best effort: without the last one it goes on
    // too.
    if (step > 0)
      (void)client_.wait_for("gateway", Patience(500),
                             [&](const Health& h) { return is_mine(h) && h.step + 1 >= step; });
  }

  // Should another start serve the same unit meanwhile, its word does not count.
  bool is_mine(const Health& health) const { return mine_.count({health.service, health.instance}) != 0; }
  Health health_of(const std::string& service) const {
    for (const auto& [key, health] : client_.peers())
      if (key.first == service && is_mine(health)) return health;
    return {};
  }

  void finish(Outcome& outcome) {
    const Health plant = health_of("plant");
    outcome.holds = counter(plant, "holds");
    outcome.resends = counter(plant, "resends");
    outcome.digest = plant.digest;
    const std::lock_guard lock(mutex_);
    outcome.summary = record_.summary();
    outcome.summary.saturated = counter(plant, "saturated");
    if (counter(plant, "tripped") != 0) {
      outcome.trip = plant.text;
      outcome.trip_step = counter(plant, "trip_step");
    }
  }

  const Settings& settings_;
  Processes& processes_;
  Processes& recorder_;
  StopSignal& stop_;
  const Instances mine_;
  const std::int64_t started_ns_ = wall_time_ns();
  Client client_;
  std::optional<Writer<Manifest>> manifest_;
  std::mutex mutex_;
  RunRecord record_;
  std::uint64_t next_to_see_ = 0;
  Reader<Measurement> measurements_;
  Reader<Modulation> modulations_;
};

int run(const Options& options) {
  Settings settings = load_scenario(options.file);
  settings.unit.domain = options.domain.value_or(settings.unit.domain);
  StopSignal stop;
  Processes recorder, processes;
  Conductor::Instances instances;
  const auto start = [&](Processes& among, const std::string& service, const std::vector<std::string>& more) {
    const std::uint64_t instance = random_identity();
    std::vector<std::string> arguments{"--settings", options.file,
                                       "--log",      options.log,
                                       "--domain",   std::to_string(settings.unit.domain),
                                       "--instance", std::to_string(instance)};
    arguments.insert(arguments.end(), more.begin(), more.end());
    among.start("weakgrid-" + service, arguments);
    instances.emplace(service, instance);
  };
  if (!options.record.empty()) {
    std::vector<std::string> how{"--output", options.record};
    for (const char* topic : recorded_topics) how.insert(how.end(), {"--await", topic});
    start(recorder, "recorder", how);
  }
  start(processes, "controller", {});
  start(processes, "gateway", {});
  start(processes, "plant", {"--until", "0"});
  if (isatty(STDERR_FILENO) != 0)
    fmt::print(stderr, "weakgrid: plays \"{}\" over DDS, domain {}\n", settings.scenario->title,
               settings.unit.domain);

  Outcome outcome = Conductor(settings, instances, processes, recorder, stop).play(!options.record.empty());
  // The recorder last: it hears the goodbyes of the others.
  const bool services_stopped_well = processes.stop();
  const bool stopped_well = recorder.stop() && services_stopped_well;
  if (options.json)
    fmt::print("{}\n", to_json(settings, outcome).dump(2));
  else
    print_table(settings, outcome);
  if (!stopped_well) throw std::runtime_error("a service did not end well");
  return outcome.is_good() ? exit_done : exit_no;
}

}  // namespace

Command add_run(CLI::App& app) {
  auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand(
      "run", "Starts plant, controller and gateway, plays a scenario over DDS, prints a verdict.");
  command->add_option("SCENARIO", options->file, "scenario file, TOML")->required();
  command->add_option("--domain", options->domain, "DDS domain, instead of the file's")
      ->check(CLI::Range(0, 230));
  command->add_option("--record", options->record, "MCAP file or folder to record everything into");
  command->add_option("--log", options->log, "what the services print on stderr")
      ->check(CLI::IsMember({"debug", "info", "warning", "error"}))
      ->capture_default_str();
  command->add_flag("--json", options->json, "print JSON");
  command->footer(
      "Example: weakgrid run deploy/settings/paper-weak.toml\n"
      "Exit: 0 settled where the closed form says, 1 not, 2 bad usage or input, 3 the world failed.");
  return [options] { return run(*options); };
}

}  // namespace weakgrid
