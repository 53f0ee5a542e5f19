// bench_roundtrip: sample there, answer back, between two processes: Weakgrid's services, raw middleware, and
// what no middleware goes below; in interleaved rounds, so that what else the machine does meets all alike.
#include <fmt/format.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <map>
#include <nlohmann/json.hpp>

#include "services/runtime/program.hpp"
#include "tests/bench/roundtrip/round.hpp"
#include "tests/support/test_domain.hpp"

namespace weakgrid::bench {
namespace {

const Kind* const links[] = {&fastdds_udp, &fastdds_data_sharing, &cyclone_udp, &udp_sockets, &shared_memory};
// Of the real services, and their [dds] loop.
const std::map<std::string, std::string> ours{{"ours", ""}, {"ours_data_sharing", "data_sharing"}};

const Kind* link_of(const std::string& name) {
  const auto* const found = std::ranges::find_if(links, [&](const Kind* kind) { return kind->name == name; });
  return found == std::end(links) ? nullptr : *found;
}

double median(std::vector<double> values) {
  if (values.empty()) return 0.0;
  std::ranges::sort(values);
  const std::size_t n = values.size();
  return 0.5 * (values[(n - 1) / 2] + values[n / 2]);
}

// By kind and round; of a kind that failed, none.
using Rounds = std::map<std::string, std::vector<Figures>>;

double median_of(const std::vector<Figures>& rounds, double Figures::*figure) {
  std::vector<double> values;
  for (const Figures& f : rounds) values.push_back(f.*figure);
  return median(values);
}

// The median over the rounds of p50 to p50 of the same round; 0: there is nothing to compare with.
double ratio(const Rounds& all, const std::string& kind, const std::string& to) {
  const auto base = all.find(to);
  std::vector<double> ratios;
  for (std::size_t n = 0; base != all.end() && n < std::min(base->second.size(), all.at(kind).size()); ++n)
    ratios.push_back(all.at(kind)[n].p50 / base->second[n].p50);
  return median(ratios);
}

nlohmann::json summary(const Rounds& all, const std::vector<std::string>& kinds) {
  nlohmann::json out = nlohmann::json::array();
  for (const std::string& kind : kinds) {
    const auto rounds = all.find(kind);
    if (rounds == all.end()) continue;
    std::uint64_t count = 0, resends = 0;
    for (const Figures& f : rounds->second) {
      count += f.count;
      resends += f.resends;
    }
    out.push_back({{"kind", kind},
                   {"rounds", rounds->second.size()},
                   {"count", count},
                   {"p50_us", median_of(rounds->second, &Figures::p50)},
                   {"p99_us", median_of(rounds->second, &Figures::p99)},
                   {"p999_us", median_of(rounds->second, &Figures::p999)},
                   {"max_us", median_of(rounds->second, &Figures::max)},
                   {"resends", resends},
                   {"to_fastdds_udp", ratio(all, kind, "fastdds_udp")},
                   {"to_fastdds_data_sharing", ratio(all, kind, "fastdds_data_sharing")}});
  }
  return out;
}

std::string times(double ratio) { return ratio > 0.0 ? fmt::format("{:.2f}x", ratio) : "-"; }

void print_table(const nlohmann::json& rows) {
  const auto line = [](const auto&... cells) {
    fmt::print("{:<22}{:>9}{:>9}{:>9}{:>10}{:>9}{:>12}{:>16}\n", cells...);
  };
  line("round trip, us", "p50", "p99", "p99.9", "max", "resends", "to raw udp", "to raw sharing");
  for (const auto& row : rows) {
    const auto us = [&](const char* figure) { return fmt::format("{:.1f}", row[figure].get<double>()); };
    line(row["kind"].get<std::string>(), us("p50_us"), us("p99_us"), us("p999_us"), us("max_us"),
         row["resends"].get<std::uint64_t>(), times(row["to_fastdds_udp"].get<double>()),
         times(row["to_fastdds_data_sharing"].get<double>()));
  }
}

int run(const std::vector<std::string>& kinds, std::uint64_t rounds, const Conditions& conditions,
        bool json) {
  const test::Domain domain;
  const Place place{domain.number(), "/weakgrid-bench-" + std::to_string(getpid())};
  Rounds all;
  std::map<std::string, std::string> failed;
  for (std::uint64_t n = 0; n < rounds; ++n)
    for (const std::string& kind : kinds) {
      if (failed.contains(kind)) continue;
      try {
        const Kind* link = link_of(kind);
        all[kind].push_back(link != nullptr ? link_round(*link, place, conditions)
                                            : services_round(ours.at(kind), place, conditions));
      } catch (const std::exception& error) {
        failed[kind] = error.what();
        all.erase(kind);
      }
    }
  const nlohmann::json rows = summary(all, kinds);
  if (json)
    fmt::print("{}\n", nlohmann::json{{"rows", rows}, {"failed", failed}}.dump(2));
  else
    print_table(rows);
  for (const auto& [kind, why] : failed) fmt::print(stderr, "bench_roundtrip: {}: {}\n", kind, why);
  return failed.empty() ? exit_done : exit_no;
}

}  // namespace
}  // namespace weakgrid::bench

int main(int argc, char** argv) {
  using namespace weakgrid;
  using namespace weakgrid::bench;
  CLI::App app("Measures round trips between two processes, by kind, in interleaved rounds.",
               "bench_roundtrip");
  std::vector<std::string> kinds;
  for (const Kind* kind : links) kinds.push_back(kind->name);
  std::vector<std::string> known = kinds;
  for (const auto& [name, loop] : ours) known.push_back(name);
  Conditions conditions;
  std::uint64_t rounds = 5;
  std::string echo;
  Place place;
  bool json = false;
  app.add_option("--kinds", kinds, "what to measure, in this order")
      ->delimiter(',')
      ->check(CLI::IsMember(known));
  app.add_option("--rounds", rounds, "of each kind; figures are medians over them")->capture_default_str();
  app.add_option("--count", conditions.count, "round trips in each round")->capture_default_str();
  app.add_option("--fifo", conditions.priority, "SCHED_FIFO priority of both loops, 0: as started");
  app.add_option("--cpu", conditions.cpus, "processors of who asks and who answers, -1: any");
  app.add_flag("--dma-latency", conditions.dma_latency, "hold /dev/cpu_dma_latency at 0");
  app.add_flag("--json", json, "print JSON");
  app.add_option("--echo", echo, "answer as this kind until stdin ends; what the child is started with")
      ->check(CLI::IsMember(known));
  app.add_option("--domain", place.domain, "with --echo");
  app.add_option("--memory", place.name, "with --echo");
  app.footer(
      "Example: bench_roundtrip --rounds 7 --count 100000 --fifo 50 --dma-latency --cpu 0 1\n"
      "Exit: 0 done, 1 a kind failed, 2 bad usage, 3 the world failed.");
  CLI11_PARSE(app, argc, argv);
  try {
    set_up_log("bench_roundtrip", "warning");
    if (echo.empty()) return run(kinds, rounds, conditions, json);
    serve_echo(*link_of(echo), place, conditions);
    return exit_done;
  } catch (...) {
    return report_exception("bench_roundtrip");
  }
}
