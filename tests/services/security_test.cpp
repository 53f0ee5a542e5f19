// DDS Security with real participants and the real programs, keys made by the project's own script: who may
// what, who gets nothing, and that a secured loop does what the plain one does.
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <cstdlib>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <filesystem>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <thread>

#include "services/runtime/participant.hpp"
#include "services/runtime/wire.hpp"
#include "tests/services/bystander.hpp"

namespace weakgrid {
namespace {

namespace fs = std::filesystem;
using Roles = std::set<Role>;
using enum Role;

constexpr Role all_roles[] = {plant, controller, gateway, recorder, console, client, unit, replayer};

// From what the programs do and the contract of idl/README.md says, not from deploy/security/access.
struct Rights {
  const char* name;
  Roles writers, readers;
};
const std::vector<Rights>& contract() {
  static const std::vector<Rights> topics{
      {"weakgrid/measurement",
       {plant, unit, replayer},
       {controller, gateway, recorder, console, client, unit}},
      {"weakgrid/modulation",
       {controller, unit, replayer},
       {plant, controller, recorder, console, client, unit}},
      {"weakgrid/setpoint_request", {console, client, replayer}, {gateway, recorder}},
      {"weakgrid/setpoint_decision", {gateway, replayer}, {recorder, console, client}},
      {"weakgrid/reference", {gateway, replayer}, {plant, controller, recorder, console, unit}},
      {"weakgrid/envelope", {gateway, replayer}, {recorder, console, client}},
      {"weakgrid/operation", {gateway, client, replayer}, {plant, recorder, unit}},
      {"weakgrid/controller_state", {controller, unit, replayer}, {controller, recorder, console}},
      {"weakgrid/health",
       {plant, controller, gateway, recorder, console, unit, replayer},
       {gateway, recorder, console, client}},
      {"weakgrid/manifest",
       {plant, controller, gateway, recorder, console, client, unit, replayer},
       {recorder, console, client}},
      {"weakgrid/ping", {plant}, {controller}},
      {"weakgrid/pong", {controller}, {plant}},
      {"somebody/else", {}, {}}};
  return topics;
}

void shell(const std::string& command) {
  EXPECT_EQ(std::system((command + " > /dev/null 2>&1").c_str()), 0) << command;
}

// A folder of keys as long as it lives.
class Keys {
 public:
  explicit Keys(const std::string& options = "") : Keys(empty) {
    std::string roles;
    for (const Role role : all_roles) roles += std::string(" --role ") + name_of(role);
    shell(WEAKGRID_SETTINGS_FOLDER "/../security/make " + folder_ + " --domain 215-229" + options + roles);
  }
  enum Empty { empty };
  explicit Keys(Empty) {
    std::string name = (fs::temp_directory_path() / "weakgrid-test-keys-XXXXXX").string();
    folder_ = mkdtemp(name.data());
  }
  ~Keys() { fs::remove_all(folder_); }
  Keys(const Keys&) = delete;
  Keys& operator=(const Keys&) = delete;
  std::string operator/(const std::string& file) const { return folder_ + "/" + file; }
  const std::string& folder() const { return folder_; }
  DdsSettings settings() const {
    DdsSettings settings;
    settings.security = folder_;
    return settings;
  }
  void copy(const Keys& from, const std::string& file, const std::string& as = "") const {
    fs::copy_file(from / file, *this / (as.empty() ? file : as), fs::copy_options::overwrite_existing);
  }

 private:
  static const char* name_of(Role role) { return weakgrid::name(role); }
  std::string folder_;
};

std::string read(const std::string& path) {
  std::ifstream file(path);
  return {std::istreambuf_iterator<char>(file), {}};
}
void write(const std::string& path, const std::string& text) { std::ofstream(path) << text; }
void replace(const std::string& path, const std::string& what, const std::string& by) {
  std::string text = read(path);
  ASSERT_NE(text.find(what), std::string::npos) << path << " has no " << what;
  write(path, text.replace(text.find(what), what.size(), by));
}

// A participant and what it has on topics, all of one type: rights go by the topic's name.
class Peer {
 public:
  using Type = Topic<Measurement>::Type;
  using Sample = Topic<Measurement>::Wire;

  explicit Peer(dds::DomainParticipant* participant) : participant_(participant) {
    if (participant_ == nullptr) return;
    dds::TypeSupport(new Type()).register_type(participant_);
    publisher_ = participant_->create_publisher(dds::PUBLISHER_QOS_DEFAULT);
    subscriber_ = participant_->create_subscriber(dds::SUBSCRIBER_QOS_DEFAULT);
  }
  ~Peer() {
    if (participant_ == nullptr) return;
    participant_->delete_contained_entities();
    dds::DomainParticipantFactory::get_instance()->delete_participant(participant_);
  }
  Peer(const Peer&) = delete;
  Peer& operator=(const Peer&) = delete;

  bool is_there() const { return participant_ != nullptr; }
  bool may_write(const std::string& name) {
    if (!is_there()) return false;
    dds::DataWriterQos qos;
    qos.data_sharing().off();
    qos.durability().kind = dds::TRANSIENT_LOCAL_DURABILITY_QOS;
    return (writers_[name] = publisher_->create_datawriter(topic(name), qos)) != nullptr;
  }
  bool may_read(const std::string& name) {
    if (!is_there()) return false;
    dds::DataReaderQos qos;
    qos.data_sharing().off();
    qos.reliability().kind = dds::RELIABLE_RELIABILITY_QOS;
    qos.durability().kind = dds::TRANSIENT_LOCAL_DURABILITY_QOS;
    qos.history().kind = dds::KEEP_ALL_HISTORY_QOS;
    return (readers_[name] = subscriber_->create_datareader(topic(name), qos)) != nullptr;
  }
  int readers_of(const std::string& name) {
    dds::PublicationMatchedStatus status;
    if (dds::DataWriter* writer = writers_[name]) writer->get_publication_matched_status(status);
    return status.current_count;
  }
  /// Samples say who wrote them.
  void write(const std::string& name, std::uint32_t who) {
    Sample sample;
    sample.unit(who);
    if (dds::DataWriter* writer = writers_[name]) {
      EXPECT_TRUE(is_ok(writer->write(&sample))) << name;
    }
  }
  /// Whose samples have come.
  const std::set<std::uint32_t>& received(const std::string& name) {
    Sample sample;
    dds::SampleInfo info;
    if (dds::DataReader* reader = readers_[name])
      while (is_ok(reader->take_next_sample(&sample, &info)))
        if (info.valid_data) received_[name].insert(sample.unit());
    return received_[name];
  }

 private:
  dds::Topic* topic(const std::string& name) {
    if (dds::TopicDescription* known = participant_->lookup_topicdescription(name))
      return static_cast<dds::Topic*>(known);
    return participant_->create_topic(name, name_of(Type()), dds::TOPIC_QOS_DEFAULT);
  }
  dds::DomainParticipant* participant_;
  dds::Publisher* publisher_ = nullptr;
  dds::Subscriber* subscriber_ = nullptr;
  std::map<std::string, dds::DataWriter*> writers_;
  std::map<std::string, dds::DataReader*> readers_;
  std::map<std::string, std::set<std::uint32_t>> received_;
};

TEST(Security, EachRoleWritesAndReadsWhatItsProgramNeedsAndNothingElse) {
  const test::Domain domain;
  const Keys keys;
  for (const Role role : all_roles) {
    Peer peer(make_participant(domain.number(), keys.settings(), role));
    for (const auto& [topic, writers, readers] : contract()) {
      EXPECT_EQ(peer.may_write(topic), writers.contains(role)) << name(role) << " writes " << topic;
      EXPECT_EQ(peer.may_read(topic), readers.contains(role)) << name(role) << " reads " << topic;
    }
  }
}

// A client's files as somebody may have spoilt or made them, each case in a folder of its own.
struct Case {
  const char* name;
  const char* named;  // what the refusal names
  std::function<void(const Keys& own, const Keys& foreign)> spoil;
  // What the intruder's own Fast DDS is told, so that it has nothing against it: the others must have.
  const char* permissions_ca = "permissions_ca.pem";
  const char* governance = "governance.p7s";
  bool is_client = false;  // by all that others can see: may do what a client may
};

// Signs a document in `folder` with a certificate and its key, attached as OpenSSL does.
void sign(const Keys& keys, const std::string& xml, const std::string& document, const std::string& signer,
          const std::string& key) {
  shell("openssl smime -sign -text -in " + (keys / xml) + " -out " + (keys / document) + " -signer " +
        signer + " -inkey " + key);
}
// The text that was signed.
void extract(const Keys& keys, const std::string& document, const std::string& xml) {
  shell("openssl smime -verify -noverify -text -in " + (keys / document) + " -out " + (keys / xml));
}

const std::vector<Case>& cases() {
  static const std::vector<Case> all{
      {"identity expired", "client.pem",
       [](const Keys& own, const Keys&) {
         shell("openssl req -new -key " + (own / "client.key") + " -subj /O=Weakgrid/CN=client -out " +
               (own / "client.csr"));
         // To the end of this second: newer OpenSSL makes none that ends before it begins.
         shell("openssl x509 -req -in " + (own / "client.csr") + " -days 0 -set_serial 7 -CA " +
               (own / "identity_ca.pem") + " -CAkey " + (own / "ca/identity_ca.key") + " -out " +
               (own / "client.pem"));
       }},
      {"identity of another CA", "client.pem",
       [](const Keys& own, const Keys& foreign) {
         for (const char* file : {"client.pem", "client.key"}) own.copy(foreign, file);
       }},
      {"identity and its CA another's", "",
       [](const Keys& own, const Keys& foreign) {
         for (const char* file : {"client.pem", "client.key", "identity_ca.pem"}) own.copy(foreign, file);
       }},
      {"identity changed", "client.pem",
       [](const Keys& own, const Keys&) {
         // Near the end: in the signature.
         std::string text = read(own / "client.pem");
         const std::size_t at = text.rfind("-----END") - 20;
         text[at] = text[at] == 'A' ? 'B' : 'A';
         write(own / "client.pem", text);
       }},
      {"key of somebody else", "client.key",
       [](const Keys& own, const Keys&) { own.copy(own, "console.key", "client.key"); }},
      {"permissions expired", "client.p7s",
       [](const Keys& own, const Keys&) {
         extract(own, "client.p7s", "client.xml");
         std::string text = read(own / "client.xml");
         const std::size_t at = text.find("<not_after>") + 11;
         write(own / "client.xml", text.replace(at, 4, "2020"));
         sign(own, "client.xml", "client.p7s", own / "permissions_ca.pem", own / "ca/permissions_ca.key");
       }},
      {"permissions changed", "client.p7s",
       [](const Keys& own, const Keys&) {
         replace(own / "client.p7s", "weakgrid/operation", "weakgrid/reference");
       }},
      {"permissions of another CA", "client.p7s",
       [](const Keys& own, const Keys& foreign) { own.copy(foreign, "client.p7s"); }, "theirs.pem",
       "theirs.p7s"},
      {"permissions signed by the identity", "client.p7s",
       [](const Keys& own, const Keys&) {
         extract(own, "client.p7s", "client.xml");
         replace(own / "client.xml", "weakgrid/operation", "weakgrid/reference");
         sign(own, "client.xml", "client.p7s", own / "client.pem", own / "client.key");
         extract(own, "governance.p7s", "own.xml");
         sign(own, "own.xml", "own.p7s", own / "client.pem", own / "client.key");
       },
       "client.pem", "own.p7s"},
      {"permissions signed by who has a certificate of the permissions CA", "client.p7s",
       [](const Keys& own, const Keys&) {
         // That CA issues none and may not; should it have: Fast DDS before 2.9.2 asks for a chain, not for
         // the CA.
         shell("openssl req -new -key " + (own / "client.key") + " -subj /O=Weakgrid/CN=client -out " +
               (own / "client.csr"));
         shell("openssl x509 -req -in " + (own / "client.csr") + " -days 9 -set_serial 7 -CA " +
               (own / "permissions_ca.pem") + " -CAkey " + (own / "ca/permissions_ca.key") + " -out " +
               (own / "issued.pem"));
         extract(own, "client.p7s", "client.xml");
         replace(own / "client.xml", "weakgrid/operation", "weakgrid/reference");
         sign(own, "client.xml", "client.p7s", own / "issued.pem", own / "client.key");
         extract(own, "governance.p7s", "own.xml");
         sign(own, "own.xml", "own.p7s", own / "issued.pem", own / "client.key");
       },
       "issued.pem", "own.p7s"},
      {"permissions of another role", "",
       [](const Keys& own, const Keys&) { own.copy(own, "gateway.p7s", "client.p7s"); }},
      {"governance changed", "governance.p7s",
       [](const Keys& own, const Keys&) {
         replace(own / "governance.p7s", "<enable_write_access_control>true",
                 "<enable_write_access_control>false");
       }},
      {"governance of another CA", "governance.p7s",
       [](const Keys& own, const Keys& foreign) { own.copy(foreign, "governance.p7s"); }, "both.pem",
       "governance.p7s", true},
      // Everything of it is right, but at home it asks for no access control: what a client may not, others
      // must refuse.
      {"a governance of its own", "", [](const Keys&, const Keys&) {}, "both.pem", "lawless.p7s", true}};
  return all;
}

// What an intruder makes for itself, to please its own Fast DDS.
void arm(const Keys& own, const Keys& foreign) {
  own.copy(foreign, "permissions_ca.pem", "theirs.pem");
  own.copy(foreign, "governance.p7s", "theirs.p7s");
  write(own / "both.pem", read(own / "permissions_ca.pem") + read(foreign / "permissions_ca.pem"));
  extract(foreign, "governance.p7s", "governance.xml");
  for (const char* right : {"read", "write"})
    replace(foreign / "governance.xml", std::string("<enable_") + right + "_access_control>true",
            std::string("<enable_") + right + "_access_control>false");
  sign(foreign, "governance.xml", "lawless.p7s", foreign / "permissions_ca.pem",
       foreign / "ca/permissions_ca.key");
  own.copy(foreign, "lawless.p7s");
}

// A participant that has not looked at its files: without what weakgrid::secure() refuses first.
dds::DomainParticipant* unchecked(std::uint32_t domain, const Keys& keys, const Case& of) {
  dds::DomainParticipantQos qos;
  auto transport = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
  transport->interfaceWhiteList = {"127.0.0.1"};
  qos.transport().use_builtin_transports = false;
  qos.transport().user_transports.push_back(transport);
  const auto set = [&](const std::string& name, const std::string& value) {
    qos.properties().properties().emplace_back("dds.sec." + name, value);
  };
  const auto file = [&](const std::string& name) { return "file://" + (keys / name); };
  set("auth.plugin", "builtin.PKI-DH");
  set("auth.builtin.PKI-DH.identity_ca", file("identity_ca.pem"));
  set("auth.builtin.PKI-DH.identity_certificate", file("client.pem"));
  set("auth.builtin.PKI-DH.private_key", file("client.key"));
  set("access.plugin", "builtin.Access-Permissions");
  set("access.builtin.Access-Permissions.permissions_ca", file(of.permissions_ca));
  set("access.builtin.Access-Permissions.governance", file(of.governance));
  set("access.builtin.Access-Permissions.permissions", file("client.p7s"));
  set("crypto.plugin", "builtin.AES-GCM-GMAC");
  return dds::DomainParticipantFactory::get_instance()->create_participant(domain, qos);
}

TEST(Security, WhoComesWithSpoiltOrForeignOrExpiredDocumentsOrNoneGetsNothing) {
  const test::Domain domain;
  const Keys keys, foreign;
  // A gateway and a plant that are what they say, each with a topic that a client may and one that it may not
  // have.
  Peer gate(make_participant(domain.number(), keys.settings(), gateway));
  for (const char* topic : {"weakgrid/envelope", "weakgrid/reference"}) ASSERT_TRUE(gate.may_write(topic));
  ASSERT_TRUE(gate.may_read("weakgrid/setpoint_request"));
  Peer unit(make_participant(domain.number(), keys.settings(), plant));
  for (const char* topic : {"weakgrid/reference", "weakgrid/operation"}) ASSERT_TRUE(unit.may_read(topic));
  // One after the other: several handshakes at a time within one process do not always come to an end in Fast
  // DDS 2.9.
  ASSERT_TRUE(test::wait_until([&] { return gate.readers_of("weakgrid/reference") == 1; }));
  Peer good(make_participant(domain.number(), keys.settings(), client));
  ASSERT_TRUE(good.may_read("weakgrid/envelope") && good.may_write("weakgrid/setpoint_request"));
  ASSERT_TRUE(test::wait_until([&] {
    return gate.readers_of("weakgrid/envelope") == 1 && good.readers_of("weakgrid/setpoint_request") == 1;
  }));

  struct Intruder {
    std::string name;
    std::unique_ptr<Keys> keys;
    std::unique_ptr<Peer> peer;
    bool is_client = false;  // by all that others can see
  };
  std::vector<Intruder> intruders;
  for (const Case& one : cases()) {
    auto own = std::make_unique<Keys>(Keys::empty);
    fs::copy(keys.folder(), own->folder(),
             fs::copy_options::recursive | fs::copy_options::overwrite_existing);
    one.spoil(*own, foreign);
    if (*one.named != '\0') {
      try {
        make_participant(domain.number(), own->settings(), client);
        ADD_FAILURE() << one.name << " is not refused";
      } catch (const SettingsError& error) {
        EXPECT_NE(std::string(error.what()).find(*own / one.named), std::string::npos)
            << one.name << ": " << error.what();
      }
    }
    arm(*own, foreign);
    auto peer = std::make_unique<Peer>(unchecked(domain.number(), *own, one));
    intruders.push_back({one.name, std::move(own), std::move(peer), one.is_client});
  }
  intruders.push_back(
      {"no security at all", nullptr, std::make_unique<Peer>(make_participant(domain.number(), {}, client))});
  const char* const wanted[] = {"weakgrid/envelope", "weakgrid/reference"};
  const char* const told[] = {"weakgrid/setpoint_request", "weakgrid/reference", "weakgrid/operation"};
  for (Intruder& one : intruders) {
    for (const char* topic : wanted) one.peer->may_read(topic);
    for (const char* topic : told) one.peer->may_write(topic);
  }
  // Time to meet: the good ones have needed less than one second each.
  std::this_thread::sleep_for(std::chrono::seconds(3));
  constexpr std::uint32_t of_gate = 1, of_good = 2, of_intruders = 100;
  for (const char* topic : wanted) gate.write(topic, of_gate);
  good.write("weakgrid/setpoint_request", of_good);
  for (std::uint32_t n = 0; n < intruders.size(); ++n)
    for (const char* topic : told) intruders[n].peer->write(topic, of_intruders + n);
  EXPECT_TRUE(test::wait_until([&] { return good.received("weakgrid/envelope").contains(of_gate); }));
  EXPECT_TRUE(test::wait_until([&] { return gate.received("weakgrid/setpoint_request").contains(of_good); }));
  EXPECT_TRUE(test::wait_until([&] { return unit.received("weakgrid/reference").contains(of_gate); }));
  std::this_thread::sleep_for(std::chrono::milliseconds(500));
  for (std::uint32_t n = 0; n < intruders.size(); ++n) {
    Intruder& one = intruders[n];
    EXPECT_FALSE(one.peer->received("weakgrid/reference").contains(of_gate)) << one.name;
    EXPECT_FALSE(unit.received("weakgrid/reference").contains(of_intruders + n)) << one.name;
    if (one.is_client) continue;  // has what a client may have, and no more
    EXPECT_FALSE(one.peer->received("weakgrid/envelope").contains(of_gate)) << one.name;
    EXPECT_FALSE(gate.received("weakgrid/setpoint_request").contains(of_intruders + n)) << one.name;
    EXPECT_FALSE(unit.received("weakgrid/operation").contains(of_intruders + n)) << one.name;
  }
}

TEST(Security, WhatIsMissingOrOutOfPlaceIsNamedAndTheProgramDoesNotStart) {
  const test::Domain domain;
  const Keys keys;
  const auto plant_says = [&](const std::string& folder, const test::Domain& in) {
    const test::TextFile file("[dds]\nsecurity = \"" + folder + "\"\n");
    return test::run("weakgrid-plant", {"--settings", file.path(), "--domain", in.text()});
  };
  test::Ended ended = plant_says(keys / "nowhere", domain);
  EXPECT_EQ(ended.status, 2);
  EXPECT_NE(ended.err.find(keys / "nowhere"), std::string::npos) << ended.err;
  for (const char* name :
       {"identity_ca.pem", "permissions_ca.pem", "governance.p7s", "plant.pem", "plant.key", "plant.p7s"}) {
    fs::rename(keys / name, keys / "aside");
    ended = plant_says(keys.folder(), domain);
    EXPECT_EQ(ended.status, 2) << name;
    EXPECT_NE(ended.err.find((keys / name) + ": No such file"), std::string::npos) << ended.err;
    write(keys / name, "nonsense\n");
    ended = plant_says(keys.folder(), domain);
    EXPECT_EQ(ended.status, 2) << name;
    EXPECT_NE(ended.err.find(keys / name), std::string::npos) << ended.err;
    fs::rename(keys / "aside", keys / name);
  }
  // What they hold is right, but not for this domain.
  shell(WEAKGRID_SETTINGS_FOLDER "/../security/make " + keys.folder() + " --renew --role plant --domain 1-2");
  ended = plant_says(keys.folder(), domain);
  EXPECT_EQ(ended.status, 2) << ended.err;
  EXPECT_NE(ended.err.find((keys / "governance.p7s") + ": is not for domain " + domain.text()),
            std::string::npos)
      << ended.err;
}

TEST(Security, TheScriptKeepsKeysPrivateAndOverwritesNothing) {
  const Keys keys;
  for (const char* name : {"plant.key", "unit.key", "ca/identity_ca.key", "ca/permissions_ca.key"}) {
    struct stat about {};
    ASSERT_EQ(stat((keys / name).c_str(), &about), 0) << name;
    EXPECT_EQ(about.st_mode & 0777, 0600u) << name;
  }
  const auto make = [&](const std::string& options) {
    const int status = std::system(
        (WEAKGRID_SETTINGS_FOLDER "/../security/make " + keys.folder() + " " + options + " > /dev/null 2>&1")
            .c_str());
    return WEXITSTATUS(status);
  };
  const std::string before = read(keys / "plant.pem"), ca = read(keys / "identity_ca.pem");
  EXPECT_EQ(make(""), 1);
  EXPECT_EQ(make("--role plant"), 1);
  EXPECT_EQ(read(keys / "plant.pem"), before);
  EXPECT_EQ(make("--renew --role plant"), 0);
  EXPECT_NE(read(keys / "plant.pem"), before);
  EXPECT_EQ(read(keys / "identity_ca.pem"), ca) << "who has the old certificates still trusts the new";
  for (const char* bad :
       {"--days 0", "--days x", "--domain 231", "--domain 5-4", "--role king", "--days", "--what"})
    EXPECT_EQ(make(bad), 2) << bad;
}

// A whole loop, everybody secured: the bits of a plain one, and a recording that proves it.
TEST(Security, ASecuredLoopDoesWhatAPlainOneDoesToTheBit) {
  const test::Domain domain;
  const Keys keys;
  const std::string scenario =
      "[grid]\nreactance = 0.3\n[scenario]\ntitle = \"secured\"\nend_s = 0.2\n"
      "[[scenario.setpoint]]\nat_s = 0.01\nactive_power = 0.5\nreactive_power = 0.1\n"
      "[dds]\n";
  const test::TextFile plain(scenario), secured(scenario + "security = \"" + keys.folder() + "\"\n");
  const std::string recording = keys / "run.mcap";
  const auto played = [&](const std::string& file, const std::vector<std::string>& further = {}) {
    std::vector<std::string> arguments{"run", file, "--json", "--domain", domain.text()};
    arguments.insert(arguments.end(), further.begin(), further.end());
    // Some five programs start in one moment: Fast DDS 2.9 then leaves a secured pair apart now and then, and
    // only starting again helps (deploy/security/README.md).
    test::Ended ended;
    nlohmann::json report;
    for (int attempt = 0; attempt < 3 && !report.contains("modulation_digest"); ++attempt) {
      if (!further.empty()) std::filesystem::remove(recording);  // of the attempt before
      ended = test::run("weakgrid", arguments);
      report = nlohmann::json::parse(ended.out, nullptr, false);
    }
    EXPECT_FALSE(report.is_discarded()) << ended.out << ended.err;
    return report.is_object() ? report : nlohmann::json::object();
  };
  const auto with = played(secured.path(), {"--record", recording}), without = played(plain.path());
  ASSERT_EQ(with.value("modulation_digest", "").size(), 64u) << with.dump(2);
  EXPECT_EQ(with["modulation_digest"], without["modulation_digest"]);
  ASSERT_EQ(with["decisions"].size(), 1u);
  EXPECT_EQ(with["decisions"][0]["verdict"], "accepted") << with.dump(2);
  const test::Ended verified = test::run("weakgrid", {"verify", recording});
  EXPECT_EQ(verified.status, 0) << verified.out << verified.err;
  // Plant and controller in one process, under an identity of its own, answer to the same gateway and client.
  test::Services services(domain, secured.path());
  services.start("unit");
  services.start("gateway");
  const test::Ended set =
      test::run("weakgrid", {"set", "--settings", secured.path(), "--domain", domain.text(), "--p", "0.3",
                             "--q", "0", "--vc", "1.8385", "--timeout", "60"});
  EXPECT_EQ(set.status, 0) << set.out << set.err;
  const test::Ended outsider = test::run("weakgrid", {"set", "--settings", plain.path(), "--domain",
                                                      domain.text(), "--p", "0.1", "--timeout", "3"});
  EXPECT_EQ(outsider.status, 3) << outsider.out << outsider.err;
}

}  // namespace
}  // namespace weakgrid
