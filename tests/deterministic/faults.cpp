// What becomes of processes in a run: who is stopped, killed, doubled, and when it is started again.
#include <spdlog/spdlog.h>

#include <string_view>

#include "tests/deterministic/world.hpp"

namespace weakgrid::deterministic {

void World::plan_faults() {
  scheduler_.after(dice_.time(50ms, 1500ms), [this] {
    disturb();
    plan_faults();
  });
}

Process* World::any_running() {
  std::vector<Process*> running;
  for (const auto& process : processes_)
    if (process->runs && process.get() != clients_) running.push_back(process.get());
  return running.empty() ? nullptr : running[dice_.below(running.size())];
}

void World::disturb() {
  Process* process = any_running();
  if (process == nullptr) return;
  const std::size_t what = dice_.below(10);
  if (what < 3) {
    kill(*process);
  } else if (what < 4) {
    stop_in_order(*process);
  } else if (what < 8) {
    // Mostly shorter than others have patience for, now and then longer: then a zombie comes back.
    const nanoseconds longest = dice_.one_in(3) ? 8s : 100ms;
    const nanoseconds pause = dice_.time(1ms, longest);
    process->goes_on = std::max(process->goes_on, now() + pause);
    spdlog::info("{}: {} {} stops for {} ms", when(), process->service, process->id, pause / 1ms);
  } else if (what < 9) {
    if (plants_.size() + controllers_.size() < 12) {
      dice_.one_in(3) ? start_plant() : start_controller(true_settings_.controller.redundancy);
    }
  } else if (!gateways_.empty() && gateways_.back()->runs) {
    gateways_.back()->dies_before_word(static_cast<std::uint32_t>(dice_.below(4)));
  }
}

void World::kill(Process& process) {
  if (!process.runs) return;
  process.runs = false;
  ++outcome_.kills;
  spdlog::info("{}: {} {} is killed", when(), process.service, process.id);
  // Its host's discovery says so at once, or nothing does until its lease is over.
  process.gone = now() + (dice_.one_in(2) ? dice_.time(1ms, 50ms) : dice_.time(5s, 20s));
  if (std::string_view(process.service) == "gateway") {
    // With its host, now and then.
    const bool is_host_too = dice_.one_in(3);
    is_host_too ? journal_.cut_power(dice_, now()) : journal_.close();
    if (is_host_too) spdlog::info("{}: and its host", when());
  }
  scheduler_.after(dice_.time(50ms, 600ms), [this, &process] { start_again(process); });
}

void World::stop_in_order(Process& process) {
  if (auto* gateway = dynamic_cast<GatewayProcess*>(&process)) gateway->stop();
  if (!process.runs) return;
  process.runs = false;
  process.gone = now();
  if (std::string_view(process.service) == "gateway") {
    journal_.flush();
    journal_.close();
  }
  scheduler_.after(dice_.time(50ms, 600ms), [this, &process] { start_again(process); });
}

}  // namespace weakgrid::deterministic
