// What services tell their service manager, over a real socket: when they serve, whether they go on, that
// they stop.
#include <fcntl.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/file.h>

#include <filesystem>
#include <thread>

#include "tests/services/bystander.hpp"
#include "tests/support/held_thread.hpp"
#include "tests/support/notify_socket.hpp"

namespace weakgrid {
namespace {

using namespace std::chrono_literals;

/// A service that is managed, with a socket of its own.
struct Managed {
  Managed(const std::string& service, std::vector<std::string> arguments,
          std::chrono::microseconds watchdog = 0s)
      : name(service) {
    const test::NotifySocket::Environment environment(socket, watchdog);
    program = std::make_unique<test::Program>("weakgrid-" + service, arguments);
  }
  std::string name;
  test::NotifySocket socket;
  std::unique_ptr<test::Program> program;
};

class Notify : public testing::Test {
 protected:
  Notify()
      : recording_(std::filesystem::temp_directory_path() / ("weakgrid-notify-" + domain_.text() + ".mcap")) {
    std::filesystem::remove(recording_);
  }
  ~Notify() override { std::filesystem::remove(recording_); }

  std::unique_ptr<Managed> start(const std::string& service, std::chrono::microseconds how_often = 0s) {
    std::vector<std::string> arguments{"--domain", domain_.text()};
    if (service == "recorder") arguments.insert(arguments.end(), {"--output", recording_.string()});
    return std::make_unique<Managed>(service, arguments, how_often);
  }

  // Held, it is not told for at least 1.5 times the watchdog's time that it goes on; let go, it is again.
  void stands_while_held(Managed& service, pid_t thread, test::HeldThread::Where where,
                         const std::string& words) {
    ASSERT_TRUE(service.socket.hears("WATCHDOG=1")) << service.name << service.socket.words();
    std::size_t before = 0;
    {
      const test::HeldThread held(thread, where);
      // What moved last is seen to stand at the second look from now on.
      std::this_thread::sleep_for(watchdog * 3 / 4);
      before = service.socket.count("WATCHDOG=1");
      std::this_thread::sleep_for(watchdog * 3 / 2);
      EXPECT_EQ(service.socket.count("WATCHDOG=1"), before) << service.name << service.socket.words();
      if (!words.empty()) {
        EXPECT_EQ(service.socket.count("STATUS=stands still: " + words), 1u)
            << service.name << service.socket.words();
      }
    }
    EXPECT_TRUE(test::wait_until([&] { return service.socket.count("WATCHDOG=1") > before; }))
        << service.name << service.socket.words();
  }

  static void expect_to_stop(Managed& service) {
    EXPECT_EQ(service.socket.count("STOPPING=1"), 0u) << service.name;
    service.program->send(SIGTERM);
    EXPECT_EQ(service.program->wait(), 0) << service.name;
    EXPECT_EQ(service.socket.count("STOPPING=1"), 1u) << service.name << service.socket.words();
    EXPECT_EQ(service.socket.count("READY=1"), 1u) << service.name;
  }

  static constexpr auto watchdog = 1'000'000us;
  test::Domain domain_;
  std::filesystem::path recording_;
};

const std::vector<std::string> services{"plant", "controller", "gateway", "recorder"};

TEST_F(Notify, ReadyOnceItServesAndStoppingOnceItStops) {
  test::Bystander bystander(domain_);
  std::uint64_t before = 0;
  for (const std::string name : {"plant", "unit", "controller", "gateway", "recorder"}) {
    const auto service = start(name);
    ASSERT_TRUE(service->socket.hears("READY=1")) << name;
    EXPECT_EQ(service->socket.heard().front().text, "READY=1") << name;
    const std::string says = name == "unit" ? "plant" : name;
    EXPECT_TRUE(test::wait_until([&] { return bystander.health(says, before).has_value(); }))
        << name << bystander.words();
    before = name == "plant" ? bystander.instance("plant") : 0;
    expect_to_stop(*service);
    EXPECT_EQ(service->socket.count("WATCHDOG=1"), 0u) << name << ": no watchdog is set";
  }
}

TEST_F(Notify, AReplayerServesAsLongAsItPlays) {
  {
    const auto recorder = start("recorder");
    const auto plant = start("plant"), controller = start("controller");
    test::Bystander bystander(domain_);
    for (const char* name : {"plant", "controller"})
      ASSERT_TRUE(test::wait_until([&] { return bystander.is(name, ServiceState::running); })) << name;
    for (const auto* service : {&plant, &controller, &recorder}) expect_to_stop(**service);
  }
  Managed replayer("replayer", {recording_.string(), "--loop", "--mix", "--domain", domain_.text()},
                   watchdog);
  ASSERT_TRUE(replayer.socket.hears("READY=1"));
  EXPECT_TRUE(test::wait_until([&] { return replayer.socket.count("WATCHDOG=1") >= 3; }))
      << replayer.socket.words();
  expect_to_stop(replayer);
}

TEST_F(Notify, NotReadyWhileItCannotServe) {
  const std::string journal = recording_.string() + ".journal";
  std::filesystem::remove(journal);
  const test::TextFile settings("[gateway]\njournal = \"" + journal + "\"\n");
  // As one that was killed a moment ago: the journal has a holder, and the next gateway waits for it.
  const int holder = open(journal.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600);
  ASSERT_EQ(flock(holder, LOCK_EX), 0);
  Managed gateway("gateway", {"--domain", domain_.text(), "--settings", settings.path()});
  EXPECT_FALSE(gateway.socket.hears("READY=1", 1500ms)) << gateway.socket.words();
  EXPECT_TRUE(gateway.program->runs());
  close(holder);
  EXPECT_TRUE(gateway.socket.hears("READY=1"));
  std::filesystem::remove(journal);

  const test::TextFile bad("[gateway]\nno_such_key = 1\n");
  Managed refused("gateway", {"--domain", domain_.text(), "--settings", bad.path()});
  EXPECT_EQ(refused.program->wait(), 2);
  EXPECT_EQ(refused.socket.heard().size(), 0u) << refused.socket.words();
}

TEST_F(Notify, StatusFollowsWhatTheServiceIsAt) {
  const auto controller = start("controller");
  EXPECT_TRUE(controller->socket.hears("STATUS=waits for a plant")) << controller->socket.words();
  const auto plant = start("plant");
  EXPECT_TRUE(controller->socket.hears("STATUS=running")) << controller->socket.words();
  EXPECT_TRUE(plant->socket.hears("STATUS=running")) << plant->socket.words();
}

TEST_F(Notify, ToldAtLeastTwiceInTheWatchdogsTimeByTheServiceItself) {
  constexpr auto slow = 4'000'000us;
  std::vector<std::unique_ptr<Managed>> managed;
  for (const std::string& name : services) managed.push_back(start(name, slow));
  for (const auto& service : managed)
    EXPECT_TRUE(test::wait_until([&] {
      for (const auto& all : managed) all->socket.heard();  // read when they come
      return service->socket.count("WATCHDOG=1") >= 4;
    })) << service->name
        << service->socket.words();
  for (const auto& service : managed) {
    std::optional<std::chrono::steady_clock::time_point> last;
    for (const auto& word : service->socket.heard()) {
      EXPECT_EQ(word.sender, service->program->pid()) << service->name;
      if (word.text != "READY=1" && word.text != "WATCHDOG=1") continue;
      if (last) {
        EXPECT_LE(word.at - *last, slow / 2) << service->name;
      }
      last = word.at;
    }
  }
}

// The main loop goes on and must not be taken for the service.
TEST_F(Notify, NotToldWhileTheThreadThatWorksStands) {
  const auto recorder = start("recorder", watchdog), plant = start("plant", watchdog);
  for (const auto* service : {&recorder, &plant}) ASSERT_TRUE((*service)->socket.hears("READY=1"));
  const pid_t writer = test::thread_named(recorder->program->pid(), "writer");
  stands_while_held(*recorder, writer, test::HeldThread::Where::anywhere, "the writing to the file");
  // Nobody answers: it waits on and on, and holds no lock of the bus meanwhile.
  const pid_t loop = test::thread_named(plant->program->pid(), "loop 1");
  stands_while_held(*plant, loop, test::HeldThread::Where::anywhere, "the loop of unit 1");
}

TEST_F(Notify, NotToldWhileATakerStandsNorWhileTheMainLoopDoes) {
  const auto plant = start("plant"), controller = start("controller", watchdog),
             gateway = start("gateway", watchdog);
  test::Bystander bystander(domain_);
  ASSERT_TRUE(bystander.runs());
  const pid_t taker = test::busiest_thread(controller->program->pid());
  stands_while_held(*controller, taker, test::HeldThread::Where::sending, "");
  const pid_t main = gateway->program->pid();
  stands_while_held(*gateway, main, test::HeldThread::Where::anywhere, "");
}

// The processes above have their main loop held up too, by what the taker holds. So that this is seen by
// itself:
TEST_F(Notify, ATakerThatDoesNotReturnIsNamedAndOneThatDoesIsNot) {
  Bus bus(domain_.number(), DdsSettings{}, Role::client),
      other(domain_.number(), DdsSettings{}, Role::client);
  std::atomic<bool> let_go{true};
  std::atomic<int> taken{0};
  Reader<Operation> reader(bus, 1u, [&](const Operation&, Arrival) {
    ++taken;
    while (!let_go) std::this_thread::sleep_for(1ms);
  });
  Writer<Operation> writer(other, 1);
  ASSERT_TRUE(test::wait_until([&] { return writer.matched() > 0 && reader.matched() > 0; }));
  const Operation operation{.client = 1, .id = 1, .kind = OperationKind::start, .until_step = 0};
  ASSERT_TRUE(writer.write(operation));
  ASSERT_TRUE(test::wait_until([&] { return taken == 1; }));
  EXPECT_EQ(bus.stuck() + bus.stuck() + bus.stuck(), "") << "nothing is under way";

  let_go = false;
  std::thread sender([&] { (void)writer.write(operation); });  // within a process the taker is called here
  const bool is_taken = test::wait_until([&] { return taken == 2; });
  EXPECT_EQ(bus.stuck(), "") << "it has only just begun";
  EXPECT_EQ(bus.stuck(), "the taker of weakgrid/operation");
  EXPECT_EQ(bus.stuck(), "the taker of weakgrid/operation");
  let_go = true;
  sender.join();
  EXPECT_TRUE(is_taken);
  EXPECT_TRUE(test::wait_until([&] { return bus.stuck().empty(); }));
}

}  // namespace
}  // namespace weakgrid
