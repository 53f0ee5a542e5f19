// Raw Fast DDS, transports and discovery as Weakgrid sets them, with and without data-sharing. Best effort,
// KEEP_LAST 1, synchronous publish.
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>

#include "roundtripPubSubTypes.h"
#include "services/runtime/participant.hpp"
#include "tests/bench/roundtrip/link.hpp"
#include "weakgrid.h"

namespace weakgrid::bench {
namespace {

namespace dds = eprosima::fastdds::dds;
using eprosima::fastrtps::types::ReturnCode_t;
using ::roundtrip::Answer;
using ::roundtrip::AnswerPubSubType;
using ::roundtrip::Sample;
using ::roundtrip::SamplePubSubType;

template <class Pointer>
Pointer* made(Pointer* entity, const char* what) {
  if (entity == nullptr) throw LinkError(std::string("Fast DDS: ") + what + " cannot be made");
  return entity;
}

// Writes Out and takes In, each as it comes.
template <class Out, class OutType, class In, class InType>
class End : dds::DataReaderListener {
 public:
  End(const Place& place, bool data_sharing, const char* out_topic, const char* in_topic) {
    if (Sample::getMaxCdrSerializedSize() != wire::Measurement::getMaxCdrSerializedSize() ||
        Answer::getMaxCdrSerializedSize() != wire::Modulation::getMaxCdrSerializedSize())
      throw LinkError("roundtrip.idl is not of the sizes of weakgrid.idl's loop messages: change it");
    participant_ = made(factory()->create_participant(place.domain, participant_qos("bench", {"127.0.0.1"})),
                        "participant");
    publisher_ = made(participant_->create_publisher(dds::PUBLISHER_QOS_DEFAULT), "publisher");
    subscriber_ = made(participant_->create_subscriber(dds::SUBSCRIBER_QOS_DEFAULT), "subscriber");
    dds::DataWriterQos writer_qos;
    apply(data_sharing, writer_qos);
    writer_qos.publish_mode().kind = dds::SYNCHRONOUS_PUBLISH_MODE;
    writer_ = made(publisher_->create_datawriter(topic<OutType>(out_topic), writer_qos), "writer");
    dds::DataReaderQos reader_qos;
    apply(data_sharing, reader_qos);
    reader_ = made(subscriber_->create_datareader(topic<InType>(in_topic), reader_qos, this,
                                                  dds::StatusMask::data_available()),
                   "reader");
  }
  virtual ~End() = default;
  End(const End&) = delete;
  End& operator=(const End&) = delete;

 protected:
  // Before the members of who derives are gone.
  void close() {
    reader_->set_listener(nullptr);
    participant_->delete_contained_entities();
    factory()->delete_participant(participant_);
  }
  bool is_matched() const {
    dds::PublicationMatchedStatus publication;
    dds::SubscriptionMatchedStatus subscription;
    writer_->get_publication_matched_status(publication);
    reader_->get_subscription_matched_status(subscription);
    return publication.current_count > 0 && subscription.current_count > 0;
  }
  void write(std::uint64_t step) {
    out_.step(step);
    writer_->write(&out_);
  }
  virtual void take(std::uint64_t step) = 0;

 private:
  static dds::DomainParticipantFactory* factory() { return dds::DomainParticipantFactory::get_instance(); }

  template <class Qos>
  static void apply(bool data_sharing, Qos& qos) {
    if (data_sharing)
      qos.data_sharing().on("");
    else
      qos.data_sharing().off();
    qos.reliability().kind = dds::BEST_EFFORT_RELIABILITY_QOS;
    qos.durability().kind = dds::VOLATILE_DURABILITY_QOS;
    qos.history().kind = dds::KEEP_LAST_HISTORY_QOS;
    qos.history().depth = 1;
    qos.endpoint().history_memory_policy = eprosima::fastrtps::rtps::PREALLOCATED_MEMORY_MODE;
  }

  template <class Type>
  dds::Topic* topic(const char* name) {
    dds::TypeSupport type(new Type());
    type.register_type(participant_);
    return made(participant_->create_topic(name, type.get_type_name(), dds::TOPIC_QOS_DEFAULT), name);
  }

  void on_data_available(dds::DataReader* from) override {
    while (from->take_next_sample(&in_, &info_) == ReturnCode_t::RETCODE_OK)
      if (info_.valid_data) take(in_.step());
  }

  dds::DomainParticipant* participant_;
  dds::Publisher* publisher_;
  dds::Subscriber* subscriber_;
  dds::DataWriter* writer_;
  dds::DataReader* reader_ = nullptr;
  Out out_;
  In in_;
  dds::SampleInfo info_;
};

class FastDdsCaller : public Caller, End<Sample, SamplePubSubType, Answer, AnswerPubSubType> {
 public:
  FastDdsCaller(const Place& place, bool data_sharing) : End(place, data_sharing, "sample", "answer") {}
  ~FastDdsCaller() override { close(); }
  bool is_matched() override { return End::is_matched(); }
  bool exchange(std::uint64_t step, const timespec& deadline) override {
    write(step);
    return handover_.wait_for(step, deadline);
  }

 private:
  void take(std::uint64_t step) override { handover_.give(step); }
  Handover handover_;
};

class FastDdsEcho : public Echo, End<Answer, AnswerPubSubType, Sample, SamplePubSubType> {
 public:
  FastDdsEcho(const Place& place, bool data_sharing) : End(place, data_sharing, "answer", "sample") {}
  ~FastDdsEcho() override { close(); }

 private:
  void take(std::uint64_t step) override { write(step); }
};

template <bool data_sharing>
std::unique_ptr<Caller> make_caller(const Place& place) {
  return std::make_unique<FastDdsCaller>(place, data_sharing);
}
template <bool data_sharing>
std::unique_ptr<Echo> make_echo(const Place& place) {
  return std::make_unique<FastDdsEcho>(place, data_sharing);
}

}  // namespace

const Kind fastdds_udp{"fastdds_udp", make_caller<false>, make_echo<false>};
const Kind fastdds_data_sharing{"fastdds_data_sharing", make_caller<true>, make_echo<true>};

}  // namespace weakgrid::bench
