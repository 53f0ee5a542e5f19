// Settings of one unit and, if the file has one, its scenario: one TOML file that every program reads.
// Names, units and ranges: services/README.md. An unknown key is an error.
#pragma once

#include <cstdint>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "controller/controller.hpp"
#include "gateway/arbiter.hpp"
#include "gateway/grid_evidence.hpp"
#include "plant/emulator.hpp"
#include "services/leadership.hpp"

namespace weakgrid {

/// What is wrong with a file: "file:line:column: key: what; what is allowed".
struct SettingsError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// Words and units of the wire, as written in the file.
struct TimedSetpoint {
  double at_s = 0.0;
  std::optional<double> active_power, reactive_power, dc_voltage;
  double ramp_s = 0.0;
  double lease_s = 0.0;  // 0: in a scenario to its end, else the gateway's default
};

struct TimedEvent {
  double at_s = 0.0;
  Quantity quantity = Quantity::source_power;
  double value = 0.0;
  double ramp_s = 0.0;
};

/// What a restarted gateway does with the reference of its journal that still stands.
enum class AfterRestart : std::uint8_t { resume, fallback };

struct Scenario {
  std::string title;
  double end_s = 0.0;
  std::vector<TimedSetpoint> setpoints;  // in the order of at_s
  std::vector<TimedEvent> events;        // in the order of at_s
};

/// How samples of the loop travel between two processes that both say so; all else, and whoever else listens,
/// has UDP.
enum class LoopTransport : std::uint8_t {
  udp,
  data_sharing,  ///< twice as fast; a peer killed while it holds a shared lock can take this process down
};

/// How participants reach each other. Addresses are IPv4, dotted.
struct DdsSettings {
  std::vector<std::string> interfaces = {"127.0.0.1"};  ///< own addresses that are used; no others are
  std::vector<std::string> peers;  ///< hosts asked one by one, this one need not be named; none: multicast
  std::string discovery_server;    ///< "address:port" of the one that is asked; empty: none
  std::string security;            ///< folder made by deploy/security/make; empty: everybody is let in
  LoopTransport loop = LoopTransport::udp;
};

/// How a plant goes from step to step.
enum class Pace : std::uint8_t {
  lockstep,  ///< as its controller answers
  realtime,  ///< on a grid of time, whoever answers
};

/// What becomes of a unit in real time whose plant misses steps: they are held, or it trips.
enum class Overrun : std::uint8_t { hold, block };

/// As written in the file; defaults here.
struct Settings {
  struct {
    std::uint32_t number = 1;
    std::uint32_t count = 1;  // served by one process: number, number + 1, …
    std::uint32_t domain = 0;
    std::uint64_t instance = 0;  // not in the file: the identity of this start, 0 = draw one
  } unit;
  struct {
    double frequency_hz = 50.0;
    double filter_reactance_pu = 0.02;
    double dc_capacitance_s = 4.8e-4;
    double dc_voltage = 1.8384776310850235;  // 1.3·√2
  } converter;
  struct {
    std::uint32_t period_us = 100;
    std::uint32_t delay_steps = 1;
    Hold hold = Hold::turning;
    Sampling sampling = Sampling::instantaneous;
  } timing;
  struct GridSettings {
    double resistance = 0.0;
    double reactance = 0.0;
    double voltage = 1.0;
  } grid;
  struct {
    std::uint32_t substeps = 10;
    double patience_s = 5.0;
    bool starts_running = true;
    double precharge_s = 0.1;
    Pace pace = Pace::lockstep;
    Overrun overrun = Overrun::hold;
  } plant;
  struct {
    double current_max = 2.0;
    double dc_voltage_min = 1.2;
    double dc_voltage_max = 2.6;
    double pcc_voltage_min = 0.3;
    double pcc_voltage_max = 1.6;
    std::uint32_t pcc_voltage_steps = 200;
    std::uint32_t holds_max = 20;
  } protection;
  struct {
    Law law = Law::filtered;
    std::vector<double> settling_times_s = {0.001, 0.0011, 0.040};
    double notch_settling_time_s = 0.050;
    double predictor_rho = 0.6;
    Redundancy redundancy = Redundancy::none;
    double takeover_s = 0.020;
  } controller;
  struct {
    std::optional<Interval> grid_resistance, grid_reactance, grid_voltage;  // none: as in [grid]
    double current_max = 1.0;
    double pcc_voltage_min = 0.8;
    double pcc_voltage_max = 1.2;
    double dc_voltage_min = 1.5;
    double dc_voltage_max = 2.4;
    double steady_state_reserve = 0.0;
    double current_reserve = 0.0;
    double control_reserve = 0.0;
    double pcc_voltage_reserve = 0.0;
    double dc_voltage_reserve = 0.0;
    double decay_min_per_s = 30.0;
    double ramp_s = 0.020;
    double lease_s = 60.0;
    double offer_s = 60.0;
    double fallback_active_power = 0.0;
    double fallback_reactive_power = 0.0;
    std::optional<double> fallback_dc_voltage;  // none: converter.dc_voltage
    double fallback_ramp_s = 0.1;
    std::uint32_t lead_steps = 50;
    double revalidate_s = 0.2;  // 0: what is measured changes nothing
    double grid_voltage_tolerance = 0.02;
    AfterRestart after_restart = AfterRestart::resume;
    std::string journal;  // file; empty: none
  } gateway;
  DdsSettings dds;
  struct {
    std::string address = "127.0.0.1";
    std::uint32_t port = 8080;  // 0: one that is free, said in the log
    std::string certificate, key;  // files, PEM; both or none
    std::string tokens;            // file
    std::vector<std::string> hosts, origins;
  } console;

  struct {
    std::uint32_t priority = 0;  // SCHED_FIFO; 0: as the process was started
    std::int32_t cpu = -1;       // -1: any
    bool lock_memory = false;
    bool dma_latency = false;
  } realtime;

  std::optional<Scenario> scenario;
};

/// Throws SettingsError.
Settings load_settings(const std::string& path);
/// The same for a text; `name` stands for the file in errors.
Settings parse_settings(const std::string& text, const std::string& name);
/// All settings in force, as TOML; parse_settings gives them back exactly.
std::string to_toml(const Settings& settings);

/// Those of the n-th unit that the process serves, from 0.
Settings numbered(const Settings& settings, std::uint32_t n);

Timing timing(const Settings& settings);
Converter converter(const Settings& settings);
Grid grid(const Settings& settings);
EmulatorConfiguration emulator_configuration(const Settings& settings);
ControllerConfiguration controller_configuration(const Settings& settings);
Arbiter::Configuration arbiter_configuration(const Settings& settings);
GridEvidence::Configuration evidence_configuration(const Settings& settings);

/// The step at or just after t seconds.
std::uint64_t step_at(const Settings& settings, double t_s);
/// The scenario's events in steps, in order; empty without a scenario.
std::vector<Event> events(const Settings& settings);
/// What `client` asks for at a timed setpoint; id counts from 1.
Request request(const Settings& settings, const TimedSetpoint& setpoint, std::uint64_t client,
                std::uint32_t id);

}  // namespace weakgrid
