// Schedule file: see the header.
#include "services/cli/schedule_file.hpp"

#include <fstream>
#include <sstream>

#include "services/cli/commands.hpp"
#include "services/cli/schedule_table.hpp"

namespace weakgrid {

namespace {

// The lease of each that has none, up to a second after the next; the last one's up to `end_s`, if there is
// one.
void fill_leases(std::vector<TimedSetpoint>& setpoints, double end_s) {
  for (std::size_t k = 0; k < setpoints.size(); ++k) {
    const double next_s = k + 1 < setpoints.size() ? setpoints[k + 1].at_s : end_s;
    if (setpoints[k].lease_s == 0.0 && next_s > 0.0) setpoints[k].lease_s = next_s - setpoints[k].at_s + 1.0;
  }
}

}  // namespace

std::vector<TimedSetpoint> load_schedule(const std::string& file) {
  std::vector<TimedSetpoint> setpoints;
  double end_s = 0.0;
  if (file.ends_with(".csv")) {
    std::ifstream in(file);
    std::ostringstream text;
    if (!in || !(text << in.rdbuf())) throw SettingsError(file + ": cannot be read");
    setpoints = parse_table(text.str(), file);
  } else {
    const Settings settings = load_scenario(file);
    setpoints = settings.scenario->setpoints;
    end_s = settings.scenario->end_s;
    if (setpoints.empty())
      throw SettingsError(file + ": scenario.setpoint: missing; a schedule needs at least one");
  }
  fill_leases(setpoints, end_s);
  return setpoints;
}

}  // namespace weakgrid
