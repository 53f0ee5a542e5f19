// Raw Fast DDS, with and without shared memory: services/runtime/ping_pong.hpp, as `weakgrid latency`
// measures it.
#include "services/runtime/ping_pong.hpp"
#include "tests/bench/roundtrip/link.hpp"

namespace weakgrid::bench {
namespace {

Settings settings(const Place& place, LoopTransport loop) {
  Settings settings;
  settings.unit.domain = place.domain;
  settings.dds.loop = loop;
  return settings;
}

class FastDdsCaller : public Caller {
 public:
  explicit FastDdsCaller(const Settings& settings) : ping_(settings) {}
  bool is_matched() override { return ping_.is_matched(); }
  bool exchange(std::uint64_t step, const timespec& deadline) override {
    return ping_.exchange(step, deadline);
  }

 private:
  Ping ping_;
};

class FastDdsEcho : public Echo {
 public:
  explicit FastDdsEcho(const Settings& settings) : pong_(settings) {}

 private:
  Pong pong_;
};

template <LoopTransport loop>
std::unique_ptr<Caller> make_caller(const Place& place) {
  return std::make_unique<FastDdsCaller>(settings(place, loop));
}
template <LoopTransport loop>
std::unique_ptr<Echo> make_echo(const Place& place) {
  return std::make_unique<FastDdsEcho>(settings(place, loop));
}

}  // namespace

const Kind fastdds_udp{"fastdds_udp", make_caller<LoopTransport::udp>, make_echo<LoopTransport::udp>};
const Kind fastdds_data_sharing{"fastdds_data_sharing", make_caller<LoopTransport::data_sharing>,
                                make_echo<LoopTransport::data_sharing>};

}  // namespace weakgrid::bench
