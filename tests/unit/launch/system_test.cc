// SPDX-License-Identifier: Apache-2.0
// The machine's service with real coordinators, and workers of several runs at them.
#include <algorithm>
#include <array>
#include <atomic>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <functional>
#include <memory>
#include <thread>

#include <gtest/gtest.h>
#include <signal.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include "base/clock.h"
#include "base/socket.h"
#include "coord/port.h"
#include "launch/system_lease.h"
#include "launch/system_service.h"
#include "model/json.h"
#include "model/json_value.h"

namespace xauto::launch {
namespace {

namespace fs = std::filesystem;

constexpr std::int64_t kPatienceNs = 20'000'000'000;

void wait_for(const std::function<bool()>& done) {
  const std::int64_t until = now_ns() + kPatienceNs;
  bool is = done();
  for (; !is && now_ns() < until; is = done()) usleep(1000);
  EXPECT_TRUE(is);
}

/// Work of the one job that a run here demands, by which the tests' admissions know it.
enum Work : std::int64_t { kSome = 1, kSmall, kBig, kTooMuch };
Work work_of(const Demand& demand) {
  return static_cast<Work>(demand.xpus.front().sequences.front().jobs.front().work);
}
std::string demand_of(Work work) {
  DemandOnXpu on;
  on.xpu.id = "cpu0";
  on.xpu.preemptive = true;
  on.sequences = {{.period = 1000, .jobs = {{.key = 100, .work = work}}}};
  return to_json(Demand{1, {on}});
}

/// Admits all but those who ask for too much.
Status by_work(const std::vector<Demand>& demands) {
  if (work_of(demands.back()) == kTooMuch)
    return fail(ErrorCode::kInfeasible,
                "core0 has no room beside " + std::to_string(demands.size() - 1));
  return {};
}

class Service {
 public:
  explicit Service(Admission admission = by_work) {
    char folder[] = "/tmp/xauto-system-XXXXXX";
    folder_ = mkdtemp(folder);
    path_ = folder_ + "/coordinator.sock";
    stop_ = UniqueFd(eventfd(0, EFD_CLOEXEC));
    auto listener = listen_path(path_, 0600);
    EXPECT_TRUE(listener) << listener.error().to_string();
    thread_ = std::thread([this, admission, socket = std::move(*listener)]() mutable {
      SystemService service(
          {.bin = XAUTO_BINARY_DIR "/bin", .listener = std::move(socket), .admission = admission});
      service.run(stop_.get());
    });
  }
  ~Service() {
    signal_eventfd(stop_.get());
    thread_.join();
    fs::remove_all(folder_);
  }
  [[nodiscard]] const std::string& path() const { return path_; }
  [[nodiscard]] Result<SystemLease> lease(const std::string& app, Work work = kSome,
                                          Discipline discipline = Discipline::kPreemptive,
                                          const char* hardware = "core0") const {
    LeaseRequest request{
        .path = path_, .app = app, .num_xnodes = 10, .xpus = {}, .demand = demand_of(work)};
    JoinXpu& xpu = request.xpus.emplace_back();
    std::strcpy(xpu.id, "cpu0");
    std::strcpy(xpu.hardware, hardware);
    xpu.discipline = static_cast<std::uint32_t>(discipline);
    return SystemLease::ask(request);
  }
  [[nodiscard]] Json status() const {
    auto socket = connect_path(path_);
    EXPECT_TRUE(socket) << socket.error().to_string();
    const auto ask = static_cast<std::uint32_t>(coord::MessageKind::kStatus);
    EXPECT_TRUE(send_packet(socket->get(), &ask, sizeof ask));
    std::string text(64 * 1024, '\0');
    const auto size = receive_packet(socket->get(), text.data(), text.size());
    EXPECT_TRUE(size);
    text.resize(*size);
    return *Json::parse(text);
  }

 private:
  std::string folder_, path_;
  UniqueFd stop_;
  std::thread thread_;
};

/// A worker whose management thread obeys at once.
class Worker {
 public:
  Worker(const SystemLease& lease, std::uint32_t xnode, const char* hardware = "core0") {
    auto port = coord::Port::connect(lease.address(hardware), "w", {xnode}, {});
    EXPECT_TRUE(port) << port.error().to_string();
    port_ = std::move(*port);
    thread_ = std::thread([this] {
      for (;;) switch (port_->wait_command()) {
          case coord::Command::kSuspend:
            suspended.store(true);
            ++suspensions;
            port_->acknowledge(true);
            break;
          case coord::Command::kResume:
            suspended.store(false);
            port_->acknowledge(true);
            break;
          case coord::Command::kNothing:
            break;
          case coord::Command::kLost:
          case coord::Command::kInterrupted:
            return;
        }
    });
  }
  ~Worker() {
    port_->interrupt();
    thread_.join();
  }
  coord::Port& port() { return *port_; }
  std::atomic<bool> suspended{false};
  std::atomic<int> suspensions{0};

 private:
  std::unique_ptr<coord::Port> port_;
  std::thread thread_;
};

coord::Job job(std::uint32_t xnode, std::uint64_t number, coord::Key key) {
  return {xnode, number, key};
}

/// Children of ours that are coordinators.
std::vector<pid_t> coordinators() {
  std::vector<pid_t> found;
  std::error_code error;
  for (fs::directory_iterator it("/proc", error), end; it != end; it.increment(error)) {
    const std::string name = it->path().filename().string();
    if (name.find_first_not_of("0123456789") != std::string::npos) continue;
    std::string text(512, '\0');  // a stream would throw where the process is just dying
    FILE* const file = std::fopen((it->path() / "stat").c_str(), "r");
    if (file == nullptr) continue;
    text.resize(std::fread(text.data(), 1, text.size(), file));
    std::fclose(file);
    const auto open = text.find('('), close = text.rfind(')');
    if (open == std::string::npos || text.substr(open + 1, close - open - 1) != "xauto-coordinat")
      continue;
    char state = 0;
    int parent = 0;
    if (std::sscanf(text.c_str() + close + 1, " %c %d", &state, &parent) == 2 &&
        parent == getpid() && state != 'Z')
      found.push_back(std::stoi(name));
  }
  return found;
}
/// The only one; -1: there are none, or several.
pid_t coordinator() {
  const std::vector<pid_t> all = coordinators();
  return all.size() == 1 ? all.front() : -1;
}

TEST(System, TheMoreUrgentJobOfAnotherRunGoesFirst) {
  const Service service;
  const auto a = service.lease("a"), b = service.lease("b");
  ASSERT_TRUE(a) << a.error().to_string();
  ASSERT_TRUE(b) << b.error().to_string();
  Worker slow(*a, 3), fast(*b, 3);
  slow.port().start(job(3, 0, 900));
  fast.port().start(job(3, 0, 100));
  wait_for([&] { return slow.suspended.load(); });
  fast.port().finish();
  wait_for([&] { return !slow.suspended.load(); });
  slow.port().finish();
  EXPECT_EQ(fast.suspensions.load(), 0);
}

TEST(System, WhoIsRefusedIsToldWhyAndDisturbsNobody) {
  const Service service;
  const auto a = service.lease("a");
  ASSERT_TRUE(a);
  Worker worker(*a, 0);
  const auto refused = service.lease("b", kTooMuch);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kInfeasible);
  EXPECT_NE(refused.error().what.find("core0 has no room beside 1"), std::string::npos)
      << refused.error().what;
  const auto otherwise = service.lease("c", kSome, Discipline::kGate);
  ASSERT_FALSE(otherwise);
  EXPECT_NE(otherwise.error().what.find("core0 is shared as"), std::string::npos);
  worker.port().start(job(0, 0, 1));
  worker.port().finish();
  EXPECT_EQ(service.status().at("apps").elements().size(), 1u);
}

/// docs/keys.md, "Apps compose": a share is free when its XPUs have been idle since. Here one is admitted at a time.
TEST(System, WhoComesWaitsUntilWhoLeftHasGivenBackWhatHeHad) {
  std::atomic<int> refused{0};
  const Service service([&](const std::vector<Demand>& demands) -> Status {
    const auto big = [](const Demand& one) { return work_of(one) == kBig; };
    if (!big(demands.back()) || std::none_of(demands.begin(), demands.end() - 1, big)) return {};
    ++refused;
    return fail(ErrorCode::kInfeasible, "core0 is full");
  });
  const auto small = service.lease("small", kSmall);
  ASSERT_TRUE(small);
  Worker worker(*small, 0);
  worker.port().start(job(0, 0, 1));  // core0 is not idle
  {
    const auto first = service.lease("first", kBig);
    ASSERT_TRUE(first);
  }
  std::thread ends([&] {
    wait_for([&] { return refused.load() >= 8; });
    worker.port().finish();
  });
  const std::int64_t begun = now_ns();
  const auto second = service.lease("second", kBig);
  EXPECT_TRUE(second) << second.error().to_string();
  EXPECT_GE(refused.load(), 8);
  EXPECT_LT(now_ns() - begun, kGiveBackNs);
  ends.join();
}

TEST(System, RunsHaveXNodesOfTheirOwn) {
  const Service service;
  const auto a = service.lease("a"), b = service.lease("b");
  ASSERT_TRUE(a && b);
  const auto first = coord::parse_door(a->address("core0")),
             second = coord::parse_door(b->address("core0"));
  ASSERT_TRUE(first && second);
  EXPECT_EQ(first->lease.num_xnodes, 10u);
  EXPECT_GE(second->lease.first_xnode, first->lease.first_xnode + 10);
  EXPECT_FALSE(coord::own_xnode(*first, second->lease.first_xnode));
  const auto stranger = coord::Port::connect(a->address("core0"), "w", {10}, {});
  ASSERT_FALSE(stranger);
  EXPECT_NE(stranger.error().what.find("unknown XNode"), std::string::npos)
      << stranger.error().what;
}

TEST(System, NobodyComesInWithoutALease) {
  const Service service;
  const auto a = service.lease("a");
  ASSERT_TRUE(a);
  auto door = coord::parse_door(a->address("core0"));
  ASSERT_TRUE(door);
  door->lease.secret ^= 1;
  auto port = coord::Port::connect(door->to_text(), "w", {0}, {});
  ASSERT_FALSE(port);
  EXPECT_NE(port.error().what.find("no lease"), std::string::npos) << port.error().what;
  port = coord::Port::connect(a->address("core1"), "w", {0}, {});
  ASSERT_FALSE(port);
  EXPECT_NE(port.error().what.find("joined without this XPU"), std::string::npos);
  port = coord::Port::connect(a->address("core0"), "w", {0}, {{0, 1}});
  ASSERT_FALSE(port);
  EXPECT_EQ(port.error().code, ErrorCode::kInvalid);
}

TEST(System, ARunThatDiesGivesBackWhatItHad) {
  const Service service;
  const auto a = service.lease("a");
  ASSERT_TRUE(a);
  Worker waits(*a, 0);
  for (int i = 0; i < 20; ++i) {
    auto b = std::make_unique<Result<SystemLease>>(service.lease("b"));
    ASSERT_TRUE(*b);
    Worker dies(**b, 0);
    dies.port().start(job(0, 0, 1));
    waits.port().begin(job(0, static_cast<std::uint64_t>(i), 5));
    if (i % 2 == 0) b.reset();  // its process is gone; a child of it still has the XPU
    if (i % 2 != 0) dies.port().finish();
    waits.port().wait();
    waits.port().finish();
  }
  wait_for([&] { return service.status().at("apps").elements().size() == 1; });
}

TEST(System, ACoordinatorThatIsKilledCostsNoJob) {
  const Service service;
  const auto a = service.lease("a"), b = service.lease("b");
  ASSERT_TRUE(a && b);
  Worker first(*a, 0), second(*b, 0);
  std::atomic<bool> over{false};
  std::array<std::atomic<int>, 2> jobs{};
  const auto work = [&](Worker& worker, int which, coord::Key key) {
    for (std::uint64_t n = 0; !over.load(); ++n) {
      worker.port().start(job(0, n, key + static_cast<coord::Key>(n % 3)));
      usleep(200);
      worker.port().finish();
      ++jobs[static_cast<std::size_t>(which)];
    }
  };
  std::jthread one(work, std::ref(first), 0, 1), two(work, std::ref(second), 1, 2);
  for (int i = 0; i < 10; ++i) {
    wait_for([] { return coordinator() > 0; });
    const pid_t victim = coordinator();
    if (victim <= 0) break;
    kill(victim, SIGKILL);
    wait_for([&] { return coordinator() > 0 && coordinator() != victim; });
    const int before[] = {jobs[0].load(), jobs[1].load()};
    wait_for([&] { return jobs[0].load() > before[0] + 5 && jobs[1].load() > before[1] + 5; });
  }
  over.store(true);
  one.join();
  two.join();
  EXPECT_FALSE(first.port().lost());
  EXPECT_FALSE(second.port().lost());
}

TEST(System, ACoordinatorGoesWithTheLastRun) {
  const Service service;
  {
    const auto a = service.lease("a");
    ASSERT_TRUE(a);
    EXPECT_EQ(coordinators().size(), 1u);
    const auto b = service.lease("b", kSome, Discipline::kGate, "gpu0");
    ASSERT_TRUE(b);
    EXPECT_EQ(coordinators().size(), 2u);
  }
  wait_for([] { return coordinators().empty(); });
  const auto again = service.lease("c", kSome, Discipline::kGate);
  EXPECT_TRUE(again);  // nobody has it otherwise any more
}

TEST(System, GarbageAndSilenceAreSentAway) {
  const Service service;
  std::vector<UniqueFd> silent;
  for (int i = 0; i < 20; ++i) {
    auto socket = connect_path(service.path());
    ASSERT_TRUE(socket);
    std::string bytes(static_cast<std::size_t>(1 + i * 97), static_cast<char>(0x10 + i));
    if (i % 2 == 0) (void)send_packet(socket->get(), bytes.data(), bytes.size());
    silent.push_back(std::move(*socket));
  }
  Join join{.num_xnodes = 1, .num_xpus = 1, .demand_bytes = 10};
  std::strcpy(join.app, "half");
  std::strcpy(join.xpus[0].id, "cpu0");
  std::strcpy(join.xpus[0].hardware, "../core0");
  auto half = connect_path(service.path());
  ASSERT_TRUE(half);
  ASSERT_TRUE(send_packet(half->get(), &join, sizeof join));
  NotAdmitted answer;
  const auto size = receive_packet(half->get(), &answer, sizeof answer);
  ASSERT_TRUE(size);
  EXPECT_EQ(*size, sizeof answer);
  EXPECT_NE(std::string(answer.reason).find("XPU that can be none"), std::string::npos);
  const auto a = service.lease("a");
  EXPECT_TRUE(a) << a.error().to_string();
  for (const UniqueFd& socket : silent) {
    char byte;
    EXPECT_TRUE(wait_readable(socket.get(), 10'000));
    EXPECT_FALSE(receive_packet(socket.get(), &byte, 1));
  }
}

TEST(System, NobodyServesThere) {
  const auto none = SystemLease::ask({.path = "/tmp/xauto-nobody.sock",
                                      .app = "a",
                                      .num_xnodes = 1,
                                      .xpus = {JoinXpu{}},
                                      .demand = "d"});
  ASSERT_FALSE(none);
  EXPECT_EQ(none.error().code, ErrorCode::kNotFound);
}

}  // namespace
}  // namespace xauto::launch
