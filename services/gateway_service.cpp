// weakgrid-gateway: requests in, decisions and references out.
#include <atomic>
#include <memory>
#include <mutex>
#include <nlohmann/json.hpp>
#include <utility>
#include <vector>

#include "services/gateway_dialogue.hpp"
#include "services/runtime/announcer.hpp"
#include "services/runtime/program.hpp"
#include "services/runtime/service_manager.hpp"

namespace weakgrid {
namespace {

// The supervisor of one unit, on the bus.
class GatewayUnit : GatewayOutlet {
 public:
  /// memory: what the journal of an earlier start tells; settings hold the grid of it already.
  GatewayUnit(const Settings& settings, const GatewayMemory& memory, std::optional<Journal>& journal,
              Bus& bus)
      : journal_(journal),
        announcer_(bus, settings, "gateway", {}),
        references_(bus, settings.unit.number),
        decisions_(bus, settings.unit.number),
        envelopes_(bus, settings.unit.number),
        operations_(bus, settings.unit.number),
        dialogue_(settings, announcer_.instance(), name_in_log(settings), memory, *this, Clock::now()) {}

  ~GatewayUnit() override {
    const std::lock_guard lock(mutex_);
    dialogue_.stop();
  }

  void say(std::uint64_t malformed) {
    Health health;
    {
      const std::lock_guard lock(mutex_);
      dialogue_.look_after(Clock::now());
      health = dialogue_.health(Clock::now());
    }
    health.counters.push_back({"unsynced", journal_ ? journal_->unsynced() : 0});
    health.counters.push_back({"foreign_measurements", foreign_});
    health.counters.push_back({"malformed", malformed});
    announcer_.say(health);
  }

  const Health& said() const { return announcer_.said(); }

  // On threads of the bus.
  void decide(const Request& request) {
    const std::lock_guard lock(mutex_);
    dialogue_.decide(request, Clock::now());
  }
  void watch(const Measurement& measurement, const Arrival& from, const Reader<Measurement>& reader) {
    const auto verdict = one_plant_.admit(from.writer, reader);
    if (verdict == OneWriter::Verdict::refused) {
      foreign_.fetch_add(1, std::memory_order_relaxed);
      return;
    }
    const std::lock_guard lock(mutex_);
    dialogue_.watch(measurement, verdict == OneWriter::Verdict::changed, Clock::now());
  }
  void hear(const Health& health) {
    const std::lock_guard lock(mutex_);
    dialogue_.hear(health, Clock::now());
  }

 private:
  using Clock = std::chrono::steady_clock;

  bool write(const Reference& reference) override { return references_.write(reference); }
  bool write(const Operation& operation) override { return operations_.write(operation); }
  bool write(const DecisionMessage& decision) override { return decisions_.write(decision); }
  bool write(const Envelope& envelope) override { return envelopes_.write(envelope); }
  bool keeps() const override { return journal_.has_value(); }
  bool keep(std::string_view kind, nlohmann::json body) override {
    return journal_->append(kind, std::move(body));
  }

  std::optional<Journal>& journal_;
  OneWriter one_plant_;
  std::atomic<std::uint64_t> foreign_{0};

  Announcer announcer_;
  Writer<Reference> references_;
  Writer<DecisionMessage> decisions_;
  Writer<Envelope> envelopes_;
  Writer<Operation> operations_;
  std::mutex mutex_;
  GatewayDialogue dialogue_;  // with mutex_ held
};

// Units number … number + count − 1 of the settings; one journal for all.
class Gateways {
 public:
  Gateways(const Settings& settings, std::optional<Journal>& journal, Bus& bus)
      : served_(settings.unit.number, settings.unit.count) {
    for (std::uint32_t n = 0; n < settings.unit.count; ++n) {
      Settings known = numbered(settings, n);
      const GatewayMemory memory =
          journal ? recall(settings.gateway.journal, known.unit.number) : GatewayMemory{};
      if (memory.grid) {
        known.gateway.grid_resistance = memory.grid->R_g;
        known.gateway.grid_reactance = memory.grid->X_g;
        known.gateway.grid_voltage = memory.grid->V;
      }
      units_.push_back(std::make_unique<GatewayUnit>(known, memory, journal, bus));
    }
    health_.emplace(bus, served_, [this](const Health& h, Arrival a) { unit(a).hear(h); });
    measurements_.emplace(bus, served_,
                          [this](const Measurement& m, Arrival a) { unit(a).watch(m, a, *measurements_); });
    requests_.emplace(bus, served_, [this](const Request& r, Arrival a) { unit(a).decide(r); });
  }
  void say() {
    for (std::uint32_t n = 0; n < served_.count; ++n)
      units_[n]->say(requests_->malformed(served_.first + n) + measurements_->malformed(served_.first + n));
  }
  std::string status() const {
    std::vector<const Health*> said;
    for (const auto& unit : units_) said.push_back(&unit->said());
    return one_line(said);
  }

 private:
  GatewayUnit& unit(const Arrival& from) { return *units_[from.unit - served_.first]; }

  const Units served_;
  std::vector<std::unique_ptr<GatewayUnit>> units_;
  std::optional<Reader<Health>> health_;
  std::optional<Reader<Measurement>> measurements_;
  std::optional<Reader<Request>> requests_;
};

}  // namespace
}  // namespace weakgrid

int main(int argc, char** argv) {
  using namespace weakgrid;
  return run_service(argc, argv, "weakgrid-gateway",
                     "Accepts setpoints inside the steady-state envelope and issues references to its units.",
                     {}, [](const Settings& settings, StopSignal& stop) {
                       std::optional<Journal> journal;
                       // A gateway that was killed a moment ago still holds it.
                       for (int patience = 50; !journal && !settings.gateway.journal.empty(); --patience)
                         try {
                           journal.emplace(settings.gateway.journal);
                         } catch (const SettingsError&) {
                           throw;
                         } catch (const std::runtime_error&) {
                           if (patience == 0 || stop.wait(std::chrono::milliseconds(100))) throw;
                         }
                       Bus bus(settings.unit.domain, settings.dds, Role::gateway);
                       Gateways gateways(settings, journal, bus);
                       ServiceManager manager({.status = [&] { return gateways.status(); },
                                               .stuck = {[&] { return bus.stuck(); }}});
                       while (!stop.wait(std::chrono::milliseconds(5))) {
                         gateways.say();  // waits for the thread that decides
                         manager.tell();
                       }
                     });
}
