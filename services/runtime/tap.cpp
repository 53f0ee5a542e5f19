// Tap over Fast DDS: see the header.
#include "services/runtime/tap.hpp"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <condition_variable>
#include <deque>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>
#include <map>
#include <mutex>
#include <nlohmann/json.hpp>
#include <sstream>
#include <thread>

#include "services/runtime/announcer.hpp"
#include "services/runtime/participant.hpp"
#include "services/runtime/wire.hpp"

namespace weakgrid {

namespace {

constexpr std::uint32_t unknown_writer = ~std::uint32_t{0};
// A burst that may come before a reader's thread runs again; more pushes out the oldest, which shows as a
// gap.
constexpr int history_depth = 4096;
// Of one topic. Some writers name the instance of each sample, as those of Fast DDS 3 do; of the others all
// are one.
constexpr int instances_max = 4096;

/// Any type: the bytes as they came, never parsed.
class RawType : public OpaqueType {
 public:
  using OpaqueType::OpaqueType;

 private:
  bool take(std::span<const std::byte> payload, void* sample) override {
    auto& out = *static_cast<std::vector<std::byte>*>(sample);
    out.assign(payload.begin(), payload.end());
    // RTPS carries payloads in fours; what this process hears of itself has not been on the wire.
    out.resize((out.size() + 3) / 4 * 4);
    return true;
  }
  void* make() override { return new std::vector<std::byte>; }
  void destroy(void* sample) override { delete static_cast<std::vector<std::byte>*>(sample); }
  /// Where their writers do not name any, all samples as one instance.
  bool key_of(const void*, rtps::InstanceHandle_t& key) override {
    key.value[0] = 1;
    return true;
  }
};

std::string text_of(const rtps::GUID_t& guid) {
  std::ostringstream out;
  out << guid;
  return out.str();
}

double seconds(const Duration_t& duration) {
  return duration == c_TimeInfinite ? -1.0 : static_cast<double>(duration.to_ns()) * 1e-9;
}

std::string qos_text(const FoundWriter& writer) {
  static constexpr const char* durabilities[] = {"volatile", "transient local", "transient", "persistent"};
  static constexpr const char* livelinesses[] = {"automatic", "manual by participant", "manual by topic"};
  nlohmann::json representations = nlohmann::json::array();
  for (const auto representation : writer.representation.m_value)
    representations.push_back(static_cast<int>(representation));
  // Spans in seconds, -1 = infinite.
  return nlohmann::json{
      {"reliability", writer.reliability.kind == dds::RELIABLE_RELIABILITY_QOS ? "reliable" : "best effort"},
      {"durability", durabilities[std::min<std::size_t>(writer.durability.kind, 3)]},
      {"ownership", writer.ownership.kind == dds::EXCLUSIVE_OWNERSHIP_QOS ? "exclusive" : "shared"},
      {"ownership_strength", writer.ownership_strength.value},
      {"liveliness", livelinesses[std::min<std::size_t>(writer.liveliness.kind, 2)]},
      {"liveliness_lease_s", seconds(writer.liveliness.lease_duration)},
      {"deadline_s", seconds(writer.deadline.period)},
      {"lifespan_s", seconds(writer.lifespan.duration)},
      {"representations", representations}}
      .dump();
}

bool is_internal(const std::string& topic) { return topic.rfind("_fastdds_statistics", 0) == 0; }

}  // namespace

struct Tap::Impl : WriterListener {
  /// What a reader must ask for to match a writer: one reader for each.
  struct Class {
    std::string topic;
    bool reliable, transient_local, exclusive;
    auto operator<=>(const Class&) const = default;
  };
  struct Known {
    Class of;
    std::string type;
    bool keyed;
    std::uint32_t index;          // unknown_writer: only looked at, not recorded
    std::uint64_t readers_by_us;  // made up to and with the one for this writer; 0 = none yet
    bool is_gone = false;         // its last samples may still come, and it may return
  };

  /// Hands on what comes from writers of its own class: a best-effort reader also matches reliable ones, for
  /// which there is another reader.
  struct Ear : dds::DataReaderListener {
    Impl& tap;
    const Class of;
    dds::DataReader* reader = nullptr;
    std::vector<std::byte> bytes;
    dds::SampleInfo info;
    rtps::GUID_t last_guid;
    std::uint32_t last_index = unknown_writer;

    Ear(Impl& owner, Class its) : tap(owner), of(std::move(its)) {}

    void on_data_available(dds::DataReader* from) override {
      while (is_ok(from->take_next_sample(&bytes, &info))) {
        const rtps::GUID_t& guid = info.sample_identity.writer_guid();
        if (guid != last_guid) {
          last_guid = guid;
          last_index = tap.index_of(guid, of);
        }
        if (last_index == unknown_writer) continue;
        const std::int64_t reception_ns = info.reception_timestamp.to_ns();
        const std::int64_t source_ns = info.source_timestamp.to_ns();
        RawSample sample{.writer = last_index,
                         .has_data = info.valid_data,
                         .sequence = info.sample_identity.sequence_number().to64long(),
                         .source_ns = source_ns > 0 ? source_ns : reception_ns,
                         .reception_ns = reception_ns};
        if (info.valid_data) sample.payload = bytes;
        tap.take(sample);
      }
    }
    void on_requested_incompatible_qos(dds::DataReader*,
                                       const dds::RequestedIncompatibleQosStatus& status) override {
      spdlog::debug("{}: a writer does not match this class of readers (policy {})", of.topic,
                    static_cast<int>(status.last_policy_id));
    }
  };

  /// A reader of manifests made after others: whoever's manifest comes to it has been told of those before.
  struct Echo : dds::DataReaderListener {
    Impl& tap;
    const std::uint64_t readers_before;
    dds::DataReader* reader = nullptr;
    std::vector<std::byte> bytes;
    dds::SampleInfo info;

    Echo(Impl& owner, std::uint64_t readers) : tap(owner), readers_before(readers) {}
    void on_data_available(dds::DataReader* from) override {
      while (is_ok(from->take_next_sample(&bytes, &info))) {
        const std::lock_guard lock(tap.mutex);
        auto& known = tap.told[info.sample_identity.writer_guid().guidPrefix];
        known = std::max(known, readers_before);
      }
    }
  };

  Options options;
  SeeWriter see;
  TakeSample take;
  dds::DomainParticipant* participant = nullptr;
  dds::Subscriber* subscriber = nullptr;

  mutable std::mutex mutex;
  std::condition_variable work;
  bool stopping = false;
  std::uint32_t count = 0;
  std::uint64_t left_out = 0;
  std::map<rtps::GUID_t, Known> writers;
  std::deque<rtps::GUID_t> to_read;                    // writers that may need a reader
  std::map<rtps::GuidPrefix_t, std::uint64_t> told;    // participant → readers of ours it knows of
  std::map<rtps::GuidPrefix_t, rtps::GUID_t> echoing;  // participants with a manifest, its writer

  // Of the worker alone.
  std::map<Class, std::pair<std::unique_ptr<Ear>, std::uint64_t>>
      ears;  // and how many readers there were then
  std::uint64_t readers = 0;
  std::unique_ptr<Echo> echo;
  std::thread worker;

  std::uint32_t index_of(const rtps::GUID_t& guid, const Class& of) const {
    const std::lock_guard lock(mutex);
    const auto known = writers.find(guid);
    return known == writers.end() || known->second.of != of ? unknown_writer : known->second.index;
  }

  bool is_wanted(const std::string& topic) const {
    return !is_internal(topic) && options.filter.wants(topic);
  }

  void on_writer_gone(const rtps::GUID_t& guid) override {
    const std::lock_guard lock(mutex);
    const auto gone = echoing.find(guid.guidPrefix);
    if (gone != echoing.end() && gone->second == guid) echoing.erase(gone);
    const auto known = writers.find(guid);
    if (known != writers.end()) known->second.is_gone = true;
  }

  // On a thread of the bus: no entity may be made here.
  void on_writer(const rtps::GUID_t& guid, const FoundWriter& writer) override {
    const std::lock_guard lock(mutex);
    if (writer.topic == Topic<Manifest>::name) echoing[guid.guidPrefix] = guid;
    if (const auto known = writers.find(guid); known != writers.end()) {
      known->second.is_gone = false;
      return;
    }
    if (!is_wanted(writer.topic)) return;
    if (count >= options.writers_max) {
      ++left_out;
      return;
    }
    Known known{.of = {writer.topic, writer.reliability.kind == dds::RELIABLE_RELIABILITY_QOS,
                       writer.durability.kind != dds::VOLATILE_DURABILITY_QOS,
                       writer.ownership.kind == dds::EXCLUSIVE_OWNERSHIP_QOS},
                .type = writer.type,
                .keyed = writer.keyed,
                .index = count++,
                .readers_by_us = 0};
    SourceWriter seen{.index = known.index,
                      .guid = text_of(guid),
                      .topic = writer.topic,
                      .type = known.type,
                      .keyed = known.keyed,
                      .reliable = known.of.reliable,
                      .transient_local = known.of.transient_local,
                      .exclusive = known.of.exclusive,
                      .partitions = writer.partitions,
                      .qos_full = qos_text(writer)};
    writers.emplace(guid, std::move(known));
    see(seen);
    to_read.push_back(guid);
    work.notify_one();
  }

  void run() {
    std::unique_lock lock(mutex);
    while (!stopping) {
      if (to_read.empty()) {
        ask_for_echo(lock);
        work.wait_for(lock, std::chrono::milliseconds(20));
        continue;
      }
      const rtps::GUID_t guid = to_read.front();
      to_read.pop_front();
      const auto known = writers.find(guid);
      if (known == writers.end()) continue;
      const Known writer = known->second;
      lock.unlock();
      const std::uint64_t made = listen(writer);
      lock.lock();
      const auto still = writers.find(guid);
      if (still != writers.end()) still->second.readers_by_us = made;
      if (made == 0) ++left_out;
    }
  }

  /// How many readers we had once there was one for this writer; 0 = there can be none.
  std::uint64_t listen(const Known& writer) {
    const auto there = ears.find(writer.of);
    if (there != ears.end()) return there->second.second;
    dds::Topic* topic = topic_of(writer.of.topic, writer.type, writer.keyed);
    if (topic == nullptr) return 0;
    auto ear = std::make_unique<Ear>(*this, writer.of);
    ear->reader = subscriber->create_datareader(topic, reader_qos(writer.of), ear.get(),
                                                dds::StatusMask::data_available()
                                                    << dds::StatusMask::requested_incompatible_qos());
    if (ear->reader == nullptr) {
      spdlog::warn("{}: no reader can be made, so it is not recorded{}", writer.of.topic, reason());
      return 0;
    }
    ears.emplace(writer.of, std::pair{std::move(ear), ++readers});
    return readers;
  }

  // Readers of our own topics are there before any writer is: a client may be gone a few ms after it came.
  void expect_ours() {
    const auto expect = [this]<class Message>(const Message*) {
      using T = Topic<Message>;
      const bool is_sample = T::qos == QosClass::sample;
      if (is_wanted(T::name))
        listen({.of = {T::name, !is_sample, !is_sample, false},
                .type = name_of(typename T::Type()),
                .keyed = is_keyed(typename T::Type()),
                .index = unknown_writer,
                .readers_by_us = 0});
    };
#define WEAKGRID_EXPECT(Message) expect(static_cast<const Message*>(nullptr));
    WEAKGRID_MESSAGES(WEAKGRID_EXPECT)
#undef WEAKGRID_EXPECT
  }

  dds::Topic* topic_of(const std::string& name, const std::string& type_name, bool keyed) {
    if (dds::TopicDescription* known = participant->lookup_topicdescription(name)) {
      auto* topic = static_cast<dds::Topic*>(known);
      if (topic->get_type_name() == type_name && is_keyed(*participant->find_type(type_name)) == keyed)
        return topic;
      spdlog::warn("{}: a writer with type {} ({}) is not recorded: the topic is known as {}", name,
                   type_name, keyed ? "keyed" : "without key", topic->get_type_name());
      return nullptr;
    }
    dds::TypeSupport type = participant->find_type(type_name);
    if (type.empty()) {
      type.reset(new RawType(type_name, keyed));
      if (!is_ok(type.register_type(participant))) return nullptr;
    }
    if (is_keyed(*type) != keyed) {
      spdlog::warn("{}: a writer is not recorded: type {} is known with another key", name, type_name);
      return nullptr;
    }
    return participant->create_topic(name, type_name, dds::TOPIC_QOS_DEFAULT);
  }

  static dds::DataReaderQos reader_qos(const Class& of) {
    dds::DataReaderQos qos;
    qos.data_sharing().off();
    qos.reliability().kind = of.reliable ? dds::RELIABLE_RELIABILITY_QOS : dds::BEST_EFFORT_RELIABILITY_QOS;
    qos.durability().kind =
        of.transient_local ? dds::TRANSIENT_LOCAL_DURABILITY_QOS : dds::VOLATILE_DURABILITY_QOS;
    qos.ownership().kind = of.exclusive ? dds::EXCLUSIVE_OWNERSHIP_QOS : dds::SHARED_OWNERSHIP_QOS;
    qos.history().kind = dds::KEEP_LAST_HISTORY_QOS;
    qos.history().depth = history_depth;
    qos.resource_limits().max_instances = instances_max;
    qos.resource_limits().max_samples_per_instance = history_depth;
    qos.resource_limits().max_samples = instances_max * history_depth;
    qos.resource_limits().allocated_samples = 64;
    qos.endpoint().history_memory_policy = rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
    accept_representations(qos, {dds::XCDR_DATA_REPRESENTATION, dds::XCDR2_DATA_REPRESENTATION});
    return qos;
  }

  /// With the lock held. A new echo only once the last has had its time, or there are new readers.
  void ask_for_echo(std::unique_lock<std::mutex>& lock) {
    const bool all_told = std::all_of(echoing.begin(), echoing.end(), [this](const auto& one) {
      const auto known = told.find(one.first);
      return known != told.end() && known->second >= readers;
    });
    if (all_told || readers == 0 || (echo && echo->readers_before == readers)) return;
    lock.unlock();
    drop_echo();
    using T = Topic<Manifest>;
    if (dds::Topic* topic = topic_of(T::name, name_of(typename T::Type()), true)) {
      echo = std::make_unique<Echo>(*this, readers);
      echo->reader = subscriber->create_datareader(topic, reader_qos({T::name, true, true, false}),
                                                   echo.get(), dds::StatusMask::data_available());
    }
    lock.lock();
    if (!echo) echoing.clear();  // another program holds the topic's name: nothing can be proved
  }

  void drop_echo() {
    if (!echo || echo->reader == nullptr) return;
    echo->reader->set_listener(nullptr);
    subscriber->delete_datareader(echo->reader);
    echo.reset();
  }

  void start() {
    auto* factory = dds::DomainParticipantFactory::get_instance();
    // Discovery begins with enable(), when there is somebody to hear it.
    dds::DomainParticipantFactoryQos factory_qos, before;
    factory->get_qos(before);
    factory_qos = before;
    factory_qos.entity_factory().autoenable_created_entities = false;
    factory->set_qos(factory_qos);
    try {
      // The buffer: what comes while this process waits for a processor.
      participant = make_participant(options.domain, options.dds, options.role, this, 4 << 20);
    } catch (...) {
      factory->set_qos(before);
      throw;
    }
    factory->set_qos(before);
    if (!is_ok(participant->enable()))
      throw BusError("DDS: participant in domain " + std::to_string(options.domain) + " cannot be enabled" +
                     reason());
    dds::SubscriberQos subscriber_qos;
    // Writers without a partition, and those in any; where there is security, nobody may use one.
    if (options.dds.security.empty()) {
      subscriber_qos.partition().push_back("");
      subscriber_qos.partition().push_back("*");
    }
    subscriber = participant->create_subscriber(subscriber_qos);
    if (subscriber == nullptr) throw BusError("DDS: subscriber cannot be made");
    expect_ours();
    worker = std::thread([this] { run(); });
  }

  ~Impl() override {
    {
      const std::lock_guard lock(mutex);
      stopping = true;
    }
    work.notify_one();
    if (worker.joinable()) worker.join();
    if (participant == nullptr) return;
    participant->set_listener(nullptr);
    drop_echo();
    for (auto& [of, ear] : ears) ear.first->reader->set_listener(nullptr);
    participant->delete_contained_entities();
    dds::DomainParticipantFactory::get_instance()->delete_participant(participant);
  }
};

Tap::Tap(const Options& options, SeeWriter see, TakeSample take) : impl_(std::make_unique<Impl>()) {
  impl_->options = options;
  impl_->see = std::move(see);
  impl_->take = std::move(take);
  impl_->start();
}

Tap::~Tap() = default;

bool Tap::hears(const std::string& topic) const {
  const std::lock_guard lock(impl_->mutex);
  return std::any_of(impl_->writers.begin(), impl_->writers.end(), [&](const auto& entry) {
    const auto& [guid, writer] = entry;
    if (writer.of.topic != topic || writer.is_gone || writer.readers_by_us == 0) return false;
    if (impl_->echoing.count(guid.guidPrefix) == 0) return true;
    const auto told = impl_->told.find(guid.guidPrefix);
    return told != impl_->told.end() && told->second >= writer.readers_by_us;
  });
}

std::uint64_t Tap::left_out() const {
  const std::lock_guard lock(impl_->mutex);
  return impl_->left_out;
}

}  // namespace weakgrid
