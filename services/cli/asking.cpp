// Asking: see the header.
#include "services/cli/asking.hpp"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <nlohmann/json.hpp>

#include "services/decision_json.hpp"
#include "services/decision_text.hpp"
#include "services/runtime/program.hpp"

namespace weakgrid {

namespace {

std::string own_name() {
  char host[64] = {};
  (void)::gethostname(host, sizeof host - 1);
  const char* user = std::getenv("USER");
  return fmt::format("{}@{}", user != nullptr ? user : "somebody", host).substr(0, 23);
}

}  // namespace

void add_asking(CLI::App& command, Asking& asking) {
  asking.name = own_name();
  command.add_option("--name", asking.name, "in whose name, at most 23 bytes")
      ->check([](const std::string& text) {
        return text.empty() || text.size() > 23 ? std::string("allowed: 1 to 23 bytes") : std::string();
      })
      ->capture_default_str();
  command.add_option("--as", asking.source, "operation, schedule or test: who stands above may take over")
      ->check(CLI::IsMember({"operation", "schedule", "test"}))
      ->capture_default_str();
  command.add_option("--timeout", asking.timeout_s, "how long to wait for the gateway, seconds")
      ->check(CLI::Range(0.1, 3600.0))
      ->capture_default_str();
  command.add_flag("--json", asking.json, "print JSON");
  add_where(command, asking.where);
}

void add_lease(CLI::App& command, Asking& asking) {
  command.add_option("--lease", asking.lease_s,
                     "seconds until the unit falls back, unless renewed (default: the gateway's)");
  command.add_flag("--hold", asking.hold, "stay and renew until interrupted");
}

namespace {

Holder holder_of(const Asking& asking) {
  Holder holder;
  holder.source = asking.source == "operation"  ? Source::operation
                  : asking.source == "schedule" ? Source::schedule
                                                : Source::test;
  std::copy_n(asking.name.begin(), std::min(asking.name.size(), holder.name.text.size() - 1),
              holder.name.text.begin());
  return holder;
}

void print(const DecisionMessage& answer, const Asking& asking, const Timing& timing) {
  const Decision& decision = answer.decision;
  if (asking.json) {
    fmt::print("{}\n", to_json(decision, timing).dump(2));
    return;
  }
  fmt::print("{}\n", describe(decision, timing));
  for (const LimitMargin& margin : decision.margins)
    fmt::print("  {:<34}{:>12.6f}{}\n", name(margin.limit), margin.margin,
               violated(margin)  ? "  violated"
               : margin.enforced ? ""
                                 : "  for information");
}

bool is_held_by_another(const Client& client, const Holder& who) {
  const auto envelope = client.envelope();
  return envelope && envelope->held_until_step != 0 && envelope->holder != who;
}

DecisionMessage answered(Client& client, const Settings& settings, const Asking& asking,
                         const Request& request) {
  const auto answer = client.ask(request, Patience(static_cast<std::int64_t>(asking.timeout_s * 1e3)));
  if (!answer)
    throw std::runtime_error(
        fmt::format("no gateway of unit {} answers in domain {}; is weakgrid-gateway running?",
                    settings.unit.number, settings.unit.domain));
  return *answer;
}

}  // namespace

int ask(Client& client, const Settings& settings, const Asking& asking, Request request) {
  StopSignal stop;
  request.who = holder_of(asking);
  request.lease_s = asking.lease_s;
  DecisionMessage answer = answered(client, settings, asking, request);
  print(answer, asking, timing(settings));
  if (answer.decision.verdict != Verdict::accepted) return exit_no;
  if (!asking.hold) return exit_done;
  Request renewal;
  renewal.kind = RequestKind::renew;
  renewal.who = request.who;
  renewal.lease_s = asking.lease_s != 0.0 ? asking.lease_s : settings.gateway.lease_s;
  // A third of the lease: two renewals may be lost. A unit in lockstep may live faster than the clock: its
  // pace shows from one decision to the next. Who is overruled asks at once, and is told by whom.
  constexpr std::chrono::duration<double> soon(0.05);
  std::chrono::duration<double> every = soon;
  auto renewed = std::chrono::steady_clock::now();
  while (!stop.wait(Patience(20))) {
    const auto now = std::chrono::steady_clock::now();
    const std::chrono::duration<double> passed = now - renewed;
    if (passed < every && !is_held_by_another(client, request.who)) continue;
    const std::uint64_t before = answer.decision.decided_step;
    answer = answered(client, settings, asking, renewal);
    const double steps = static_cast<double>(std::max(answer.decision.decided_step, before) - before);
    const double pace = std::max(1.0, steps * period_s(timing(settings)) / passed.count());
    every = std::max(soon, std::chrono::duration<double>(renewal.lease_s / (3.0 * pace)));
    renewed = now;
    if (answer.decision.verdict == Verdict::accepted) continue;
    print(answer, asking, timing(settings));
    return exit_no;
  }
  return exit_done;
}

int ask(const Asking& asking, Request request) {
  const Settings settings = asking.where.settings();
  Client client(settings.unit.domain, settings.unit.number, settings.dds);
  return ask(client, settings, asking, request);
}

}  // namespace weakgrid
