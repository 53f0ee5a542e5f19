// An integrator's own Fast DDS program, all of it set by the XML profiles of deploy/dds: reads samples, asks
// for a setpoint, says what came. usage: foreign_peer DOMAIN FILE.xml ...
#include <fmt/format.h>

#include <cstdlib>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <stdexcept>
#include <thread>

#include "services/runtime/fastdds_version.hpp"
#include "services/runtime/wire.hpp"

namespace {

namespace dds = weakgrid::dds;
using weakgrid::is_ok;
using weakgrid::Topic;

template <class Pointer>
Pointer made(Pointer entity, const char* what) {
  if (entity == nullptr) throw std::runtime_error(fmt::format("{} cannot be made", what));
  return entity;
}

template <class Message>
dds::Topic* topic(dds::DomainParticipant* participant) {
  dds::TypeSupport type(new typename Topic<Message>::Type());
  type.register_type(participant);
  return made(participant->create_topic(Topic<Message>::name, type.get_type_name(), dds::TOPIC_QOS_DEFAULT),
              Topic<Message>::name);
}

int talk(std::uint32_t domain, int files, char** file) {
  auto* factory = dds::DomainParticipantFactory::get_instance();
  for (int n = 0; n < files; ++n)
    if (!is_ok(factory->load_XML_profiles_file(file[n])))
      throw std::runtime_error(fmt::format("{} cannot be loaded", file[n]));
  auto* participant = made(factory->create_participant_with_profile(domain, "weakgrid"), "the participant");
  auto* publisher = made(participant->create_publisher(dds::PUBLISHER_QOS_DEFAULT), "a publisher");
  auto* subscriber = made(participant->create_subscriber(dds::SUBSCRIBER_QOS_DEFAULT), "a subscriber");
  auto* samples = made(subscriber->create_datareader_with_profile(topic<weakgrid::Measurement>(participant),
                                                                  "weakgrid_sample"),
                       "a reader of samples");
  auto* healths =
      made(subscriber->create_datareader_with_profile(topic<weakgrid::Health>(participant), "weakgrid_state"),
           "a reader of health");
  auto* decisions = made(subscriber->create_datareader_with_profile(
                             topic<weakgrid::DecisionMessage>(participant), "weakgrid_command"),
                         "a reader of decisions");
  auto* requests = made(
      publisher->create_datawriter_with_profile(topic<weakgrid::Request>(participant), "weakgrid_command"),
      "a writer of requests");

  weakgrid::Request ask{.client = 4711, .id = 1, .given = weakgrid::given_p, .p = 0.4};
  ask.who.name.text = {'p', 'e', 'e', 'r'};
  Topic<weakgrid::Request>::Wire request;
  request.unit(1);
  encode(ask, request);
  Topic<weakgrid::Measurement>::Wire sample;
  Topic<weakgrid::Health>::Wire health;
  Topic<weakgrid::DecisionMessage>::Wire answer;
  weakgrid::DecisionMessage decision;
  dds::SampleInfo info;
  int seen = 0, services = 0;
  bool answered = false;
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(30);
  for (int turn = 0;
       std::chrono::steady_clock::now() < deadline && !(seen >= 100 && services > 0 && answered); ++turn) {
    while (is_ok(samples->take_next_sample(&sample, &info))) seen += info.valid_data;
    while (is_ok(healths->take_next_sample(&health, &info))) services += info.valid_data;
    while (is_ok(decisions->take_next_sample(&answer, &info)))
      answered |= info.valid_data && decode(answer, decision) && decision.decision.client == ask.client;
    if (turn % 100 == 50 && !answered) requests->write(&request);  // a repeat costs nothing
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
  fmt::print("{} samples, {} words of health, request {}\n", seen, services,
             answered ? "decided" : "not answered");
  participant->delete_contained_entities();
  factory->delete_participant(participant);
  return seen >= 100 && services > 0 && answered ? 0 : 1;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    if (argc < 3) throw std::runtime_error("usage: foreign_peer DOMAIN FILE.xml ...");
    return talk(static_cast<std::uint32_t>(std::atoi(argv[1])), argc - 2, argv + 2);
  } catch (const std::exception& error) {
    fmt::print(stderr, "foreign_peer: {}\n", error.what());
    return 2;
  }
}
