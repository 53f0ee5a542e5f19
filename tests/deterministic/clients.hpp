// Those who ask: operators and schedules who mean well, and strangers who do not.
#pragma once

#include "tests/deterministic/judge.hpp"

namespace weakgrid::deterministic {

class World;

class Clients : public Process {
 public:
  Clients(World& world, WriterId number);
  /// One of them asks something, or asks again.
  void act();
  void take(const Decision& decision);

 private:
  struct Client {
    std::uint64_t id = 0;
    std::uint32_t asked = 0;  // the last request's id
    std::optional<Request> unanswered;
    std::uint32_t token = 0;  // the last offer
  };
  struct Sent {
    Request request;
    Asked asked;
    bool is_hostile;
  };
  Request begin(Client& client);
  void fill_setpoint(Request& request);
  Request good(Client& client);
  bool operate(Request& request);
  Request hostile(Client& client);
  void send(const Request& request, bool is_hostile);
  double lease_s();

  World& world_;
  std::vector<Client> clients_, strangers_;
  std::vector<Sent> sent_;
};

}  // namespace weakgrid::deterministic
