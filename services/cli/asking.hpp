// A request as options of a command, the gateway's decision, and how it is printed.
#pragma once

#include <CLI/CLI.hpp>
#include <string>

#include "services/cli/client.hpp"
#include "services/cli/commands.hpp"

namespace weakgrid {

/// What every request has, whatever it asks for.
struct Asking {
  Where where;
  std::string name, source = "operation";
  double timeout_s = 5.0;
  double lease_s = 0.0;
  bool hold = false;
  bool json = false;
};

void add_asking(CLI::App& command, Asking& asking);
/// For what has a lease.
void add_lease(CLI::App& command, Asking& asking);

/// Asks, prints the decision, and with `hold` stays and renews until it is interrupted or somebody takes
/// over. Exit code; throws if no gateway answers.
int ask(const Asking& asking, Request request);
/// The same for a client that goes on.
int ask(Client& client, const Settings& settings, const Asking& asking, Request request);

}  // namespace weakgrid
