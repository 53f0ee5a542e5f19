// Ping and Pong: see the header. Participant and QoS as the bus makes them, nothing of ours on the way.
#include "services/runtime/ping_pong.hpp"

#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>

#include "services/runtime/participant.hpp"
#include "services/runtime/qos.hpp"
#include "services/runtime/semaphore.hpp"
#include "services/runtime/wire.hpp"

namespace weakgrid {

namespace {

// Writes Out and takes In, each as it comes, from listen() to close().
template <class Out, class In>
struct End : dds::DataReaderListener {
  End(const Settings& settings, Role role, const char* out_topic, const char* in_topic)
      : participant(make_participant(settings.unit.domain, settings.dds, role)) {
    dds::DataWriterQos writer_qos;
    apply<Out>(false, settings.dds.loop, writer_qos);
    writer_qos.publish_mode().kind = dds::SYNCHRONOUS_PUBLISH_MODE;
    dds::Publisher* publisher = made(participant->create_publisher(dds::PUBLISHER_QOS_DEFAULT), "publisher");
    writer = made(publisher->create_datawriter(topic<Out>(out_topic), writer_qos), out_topic);
    dds::DataReaderQos reader_qos;
    apply<In>(true, settings.dds.loop, reader_qos);
    dds::Subscriber* subscriber =
        made(participant->create_subscriber(dds::SUBSCRIBER_QOS_DEFAULT), "subscriber");
    reader = made(subscriber->create_datareader(topic<In>(in_topic), reader_qos), in_topic);
  }
  void listen() { reader->set_listener(this, dds::StatusMask::data_available()); }
  void close() { reader->set_listener(nullptr); }
  ~End() override {
    participant->delete_contained_entities();
    dds::DomainParticipantFactory::get_instance()->delete_participant(participant);
  }
  End(const End&) = delete;
  End& operator=(const End&) = delete;

  template <class Pointer>
  static Pointer* made(Pointer* entity, const std::string& what) {
    if (entity == nullptr) throw BusError("DDS: " + what + " cannot be made" + reason());
    return entity;
  }
  template <class Message>
  dds::Topic* topic(const char* name) {
    dds::TypeSupport type(new typename Topic<Message>::Type());
    type.register_type(participant);
    return made(participant->create_topic(name, type.get_type_name(), dds::TOPIC_QOS_DEFAULT), name);
  }
  bool is_matched() const {
    dds::PublicationMatchedStatus publication;
    dds::SubscriptionMatchedStatus subscription;
    writer->get_publication_matched_status(publication);
    reader->get_subscription_matched_status(subscription);
    return publication.current_count > 0 && subscription.current_count > 0;
  }
  void write(std::uint64_t step) {
    out.step(step);
    writer->write(&out);
  }
  void on_data_available(dds::DataReader* from) override {
    while (is_ok(from->take_next_sample(&in, &info)))
      if (info.valid_data) take(in.step());
  }
  virtual void take(std::uint64_t step) = 0;

  dds::DomainParticipant* participant;
  dds::DataWriter* writer;
  dds::DataReader* reader;
  typename Topic<Out>::Wire out;
  typename Topic<In>::Wire in;
  dds::SampleInfo info;
};

}  // namespace

struct Ping::Impl : End<Measurement, Modulation> {
  explicit Impl(const Settings& settings) : End(settings, Role::plant, "weakgrid/ping", "weakgrid/pong") {
    listen();
  }
  ~Impl() override { close(); }
  void take(std::uint64_t step) override {
    last.store(step, std::memory_order_release);
    wake.post();
  }
  std::atomic<std::uint64_t> last{0};
  Semaphore wake;
};

Ping::Ping(const Settings& settings) : impl_(std::make_unique<Impl>(settings)) {}
Ping::~Ping() = default;
bool Ping::is_matched() const { return impl_->is_matched(); }

bool Ping::exchange(std::uint64_t step, const timespec& deadline) {
  impl_->write(step);
  while (impl_->wake.wait_until(deadline))
    if (impl_->last.load(std::memory_order_acquire) == step) return true;
  return false;
}

struct Pong::Impl : End<Modulation, Measurement> {
  explicit Impl(const Settings& settings)
      : End(settings, Role::controller, "weakgrid/pong", "weakgrid/ping") {
    listen();
  }
  ~Impl() override { close(); }
  void take(std::uint64_t step) override { write(step); }
};

Pong::Pong(const Settings& settings) : impl_(std::make_unique<Impl>(settings)) {}
Pong::~Pong() = default;

}  // namespace weakgrid
