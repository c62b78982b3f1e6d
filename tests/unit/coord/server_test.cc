// SPDX-License-Identifier: Apache-2.0
// Real ports against a real server in another thread: shared memory, sockets, doorbells, death.
#include "coord/server.h"

#include <atomic>
#include <chrono>
#include <functional>
#include <future>
#include <random>
#include <thread>

#include <gtest/gtest.h>
#include <sys/eventfd.h>
#include <sys/mman.h>
#include <unistd.h>

#include "base/clock.h"
#include "base/memory_file.h"
#include "base/socket.h"
#include "coord/observer.h"
#include "coord/port.h"
#include "coord/protocol.h"
#include "model/xpu_status.h"

#include "address.h"

namespace xauto::coord {
namespace {

using namespace std::chrono_literals;

Job numbered(std::uint32_t xnode, std::uint64_t sequence, std::int64_t priority) {
  return {xnode, sequence, key_of_priority(priority)};
}

/// A coordinator in a thread.
class Running {
 public:
  explicit Running(Discipline discipline, OrderPairs order = {}, int levels = 0)
      : address_(unique_address()), order_(std::move(order)), stop_(eventfd(0, EFD_CLOEXEC)) {
    auto server = Server::create({.address = address_,
                                  .xpu = "gpu0",
                                  .discipline = discipline,
                                  .xnodes = std::vector<std::string>(16, "node"),
                                  .order = order_,
                                  .levels = levels});
    EXPECT_TRUE(server) << server.error().to_string();
    server_ = std::move(*server);
    thread_ = std::thread([this] { EXPECT_TRUE(server_->run(stop_.get())); });
  }
  ~Running() { end(); }
  void end() {
    if (!thread_.joinable()) return;
    signal_eventfd(stop_.get());
    thread_.join();
    server_.reset();  // its sockets close: to the ports, this is death
  }
  std::unique_ptr<Port> port(std::uint32_t xnode) {
    auto port = Port::connect(address_, "worker" + std::to_string(xnode), {xnode}, order_);
    EXPECT_TRUE(port) << port.error().to_string();
    return std::move(*port);
  }
  [[nodiscard]] const std::string& address() const { return address_; }

 private:
  std::string address_;
  OrderPairs order_;
  UniqueFd stop_;
  std::unique_ptr<Server> server_;
  std::thread thread_;
};

/// A worker's management thread that obeys at once and counts.
class Obedient {
 public:
  explicit Obedient(Port& port)
      : port_(port), thread_([this] {
          for (;;) {
            switch (port_.wait_command()) {
              case Command::kSuspend:
                suspended.store(true);
                suspends.fetch_add(1);
                port_.acknowledge(true);
                break;
              case Command::kResume:
                suspended.store(false);
                port_.acknowledge(true);
                break;
              case Command::kLost:
                suspended.store(false);
                break;
              case Command::kNothing:
                break;
              case Command::kInterrupted:
                return;
            }
          }
        }) {}
  ~Obedient() {
    port_.interrupt();
    thread_.join();
  }
  std::atomic<bool> suspended{false};
  std::atomic<int> suspends{0};

 private:
  Port& port_;
  std::thread thread_;
};

void wait_for(const std::function<bool()>& condition) {
  while (!condition()) std::this_thread::yield();  // the test's own time limit is the net
}

/// [worker] what the coordinator at this address says that it is at.
std::string states_at(const std::string& address) {
  const auto asker = connect_abstract(address);
  const auto kind = static_cast<std::uint32_t>(MessageKind::kStatus);
  std::string text(kMaxStatusBytes, '\0'), states;
  if (!asker || !send_packet(asker->get(), &kind, sizeof kind)) return "nobody answers";
  const auto size = receive_packet(asker->get(), text.data(), text.size());
  if (!size) return "no answer";
  const auto json = Json::parse(text.substr(0, *size));
  if (!json) return "no JSON";
  const auto status = parse_xpu_status(*json);
  if (!status) return "no answer";
  for (const WorkerStatus& worker : status->workers)
    states += worker.worker + " " + worker.state + "; ";
  return states;
}

TEST(Server, WhatRunsBelowAnotherOnALevelIsShownAsRunning) {
  Running running(Discipline::kLevels, {}, 3);
  const auto low = running.port(0), middle = running.port(1), high = running.port(2);
  low->start(numbered(0, 0, 1));
  middle->start(numbered(1, 0, 2));
  EXPECT_EQ(states_at(running.address()), "worker0 running; worker1 running; worker2 idle; ");
  high->start(numbered(2, 0, 3));
  EXPECT_EQ(states_at(running.address()), "worker0 running; worker1 running; worker2 running; ");
  high->finish();
  middle->finish();
  EXPECT_EQ(states_at(running.address()), "worker0 running; worker1 idle; worker2 idle; ");
  low->finish();
}

TEST(Server, AJobIsToldItsLevelAndTheOneAboveAllWaits) {
  Running running(Discipline::kLevels, {}, 2);
  const auto low = running.port(0), middle = running.port(1), high = running.port(2);
  low->start(numbered(0, 0, 1));
  EXPECT_EQ(low->level(), 0);
  middle->start(numbered(1, 0, 2));  // returns although `low` runs
  EXPECT_EQ(middle->level(), 1);
  auto waits = std::async(std::launch::async, [&] { high->start(numbered(2, 0, 3)); });
  EXPECT_EQ(waits.wait_for(20ms), std::future_status::timeout) << "no level is above the second";
  middle->finish();
  waits.get();
  EXPECT_EQ(high->level(), 1) << "the first job has not ended";
  high->finish();
  low->finish();
  high->start(numbered(2, 1, 3));
  EXPECT_EQ(high->level(), 0);
  high->finish();
}

/// How long a suspension lasts is known to who runs meanwhile, and to nobody else; by no clock of the test's.
TEST(Server, WhoTakesTheXpuKnowsForHowLongTheOtherWasStillOnIt) {
  Running running(Discipline::kPreemptive);
  const auto low = running.port(0), high = running.port(1);
  std::promise<void> may_suspend, may_resume;
  std::thread manager([&] {
    EXPECT_EQ(low->wait_command(), Command::kSuspend);
    may_suspend.get_future().wait();
    low->acknowledge(true);
    EXPECT_EQ(low->wait_command(), Command::kResume);
    may_resume.get_future().wait();
    low->acknowledge(true);
  });
  low->start(numbered(0, 0, 1));
  EXPECT_EQ(low->beside_ns(now_ns() - 1'000'000, now_ns()), 0) << "it took the XPU from nobody";
  high->start(numbered(1, 0, 2));
  const std::int64_t since = now_ns();
  sleep_until_ns(since + 3'000'000);
  EXPECT_EQ(high->beside_ns(since, since + 2'000'000), 2'000'000) << "as yet all of its time";
  const std::int64_t before = now_ns();
  may_suspend.set_value();
  std::int64_t beside = 0;
  wait_for([&] {
    return (beside = high->beside_ns(since, since + 3'600'000'000'000)) < 3'600'000'000'000;
  });
  const std::int64_t after = now_ns();
  EXPECT_GE(beside, before - since - 1000) << "in whole us";
  EXPECT_LE(beside, after - since + 1000);
  EXPECT_EQ(high->beside_ns(after, after + 1'000'000), 0) << "it was suspended before";
  high->finish();
  may_resume.set_value();
  manager.join();
  EXPECT_EQ(high->beside_ns(since, now_ns()), 0) << "nobody is suspended for it";
  low->finish();
}

TEST(Server, UncontendedStartAndFinishNeedNoCoordinator) {
  Running running(Discipline::kPreemptive);
  const auto port = running.port(0);
  running.end();  // nobody is there to decide
  for (std::uint64_t i = 0; i < 1000; ++i) {
    port->start({0, i, 1});
    port->finish();
  }
}

TEST(Server, MoreUrgentJobSuspendsTheRunningOneUntilItEnds) {
  Running running(Discipline::kPreemptive);
  const auto low = running.port(0), high = running.port(1);
  Obedient low_mgmt(*low), high_mgmt(*high);
  low->start(numbered(0, 0, 1));
  high->start(numbered(1, 0, 2));
  wait_for([&] { return low_mgmt.suspended.load(); });
  high->finish();
  wait_for([&] { return !low_mgmt.suspended.load(); });
  low->finish();
  EXPECT_EQ(low_mgmt.suspends.load(), 1);
  EXPECT_EQ(high_mgmt.suspends.load(), 0);
}

TEST(Server, GateAdmitsOneAtATime) {
  Running running(Discipline::kGate);
  std::vector<std::unique_ptr<Port>> ports;
  for (std::uint32_t i = 0; i < 4; ++i) ports.push_back(running.port(i));
  std::atomic<int> inside{0}, most{0};
  std::vector<std::thread> threads;
  for (std::uint32_t i = 0; i < 4; ++i)
    threads.emplace_back([&, i] {
      for (std::uint64_t k = 0; k < 500; ++k) {
        ports[i]->start({i, k, static_cast<std::int64_t>(i)});
        const int now = inside.fetch_add(1) + 1;
        if (now > most.load()) most.store(now);
        if (k % 7 == i) std::this_thread::yield();
        inside.fetch_sub(1);
        ports[i]->finish();
      }
    });
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(most.load(), 1);
}

TEST(Server, NoStartIsLostUnderContention) {
  Running running(Discipline::kPreemptive);
  std::vector<std::unique_ptr<Port>> ports;
  std::vector<std::unique_ptr<Obedient>> managers;
  for (std::uint32_t i = 0; i < 5; ++i) {
    ports.push_back(running.port(i));
    managers.push_back(std::make_unique<Obedient>(*ports.back()));
  }
  std::atomic<std::uint64_t> done{0};
  std::vector<std::thread> threads;
  for (std::uint32_t i = 0; i < 5; ++i)
    threads.emplace_back([&, i] {
      std::mt19937 random(i);
      for (std::uint64_t k = 0; k < 1000; ++k) {
        ports[i]->start({i, k, static_cast<std::int64_t>(random() % 100)});
        if (random() % 4 == 0) std::this_thread::yield();
        ports[i]->finish();
        done.fetch_add(1);
      }
    });
  for (std::thread& thread : threads) thread.join();  // a lost START would hang here
  EXPECT_EQ(done.load(), 5000u);
  for (const auto& manager : managers) wait_for([&] { return !manager->suspended.load(); });
}

TEST(Server, OrderIsKeptAcrossWorkers) {
  for (const Discipline d : {Discipline::kPreemptive, Discipline::kGate, Discipline::kKernel}) {
    Running running(d, {{0, 1}});
    const auto first = running.port(0), second = running.port(1);
    Obedient first_mgmt(*first), second_mgmt(*second);
    std::atomic<std::uint64_t> finished_first{0};
    bool kept = true;
    std::thread thread([&] {
      for (std::uint64_t k = 0; k < 300; ++k) {
        second->start({1, k, 9});
        kept = kept && finished_first.load() > k;
        second->finish();
      }
    });
    for (std::uint64_t k = 0; k < 300; ++k) {
      if (k % 3 == 0) std::this_thread::yield();
      if (k % 50 == 49) {  // this one is dropped: nobody may wait for it
        finished_first.store(k + 1);
        first->skip(0, k);
        continue;
      }
      first->start({0, k, 1});
      finished_first.store(k + 1);
      first->finish();
    }
    thread.join();
    EXPECT_TRUE(kept);
  }
}

TEST(Server, AFollowerNeedsNoCoordinator) {
  for (const Discipline d :
       {Discipline::kPreemptive, Discipline::kGate, Discipline::kLevels, Discipline::kKernel}) {
    Running running(d, {{0, 1}}, 2);
    const auto first = running.port(0), second = running.port(1);
    running.end();  // nobody is there to decide
    // Before it has asked, and while it waits. What a START meets that falls into the other's FINISH may be the
    // coordinator's to decide, so it never does; protocol_test.cc tries those.
    std::atomic<std::uint64_t> finishing{0}, ended{0}, asked{0}, second_over{0};
    std::thread thread([&] {
      for (std::uint64_t k = 0; k < 300; ++k) {
        if (k % 3 == 0) wait_for([&] { return ended.load() > k; });
        second->begin(numbered(1, k, 9));
        asked.store(k + 1);
        second->wait();
        EXPECT_GE(finishing.load(), k + 1);
        second->finish();
        second_over.store(k + 1);
      }
    });
    for (std::uint64_t k = 0; k < 300; ++k) {
      wait_for([&] { return k % 3 == 0 || asked.load() > k; });
      first->start(numbered(0, k, 1));
      finishing.store(k + 1);
      first->finish();
      ended.store(k + 1);
      wait_for([&] { return second_over.load() > k; });
    }
    thread.join();
  }
}

TEST(Server, WorkerThatDiesWhileRunningLetsTheOthersRun) {
  Running running(Discipline::kGate);
  auto dying = running.port(0);
  const auto waiting = running.port(1);
  dying->start(numbered(0, 0, 1));
  std::thread thread([&] {
    waiting->start(numbered(1, 0, 1));
    waiting->finish();
  });
  dying.reset();  // its socket closes, as when its process is killed
  thread.join();
}

TEST(Server, CoordinatorThatDiesFreesWaitersAndSuspendedJobs) {
  Running running(Discipline::kPreemptive);
  const auto low = running.port(0), high = running.port(1), lowest = running.port(2);
  Obedient low_mgmt(*low), high_mgmt(*high), lowest_mgmt(*lowest);
  low->start(numbered(0, 0, 1));
  high->start(numbered(1, 0, 2));
  wait_for([&] { return low_mgmt.suspended.load(); });
  std::thread thread([&] { lowest->start(numbered(2, 0, 0)); });
  running.end();
  thread.join();
  wait_for([&] { return !low_mgmt.suspended.load(); });
  high->finish();
  low->finish();
  lowest->finish();
  EXPECT_TRUE(low->lost());
}

/// What outlives a coordinator, as the parent of a run keeps it.
TEST(Server, WorkersThatCameBackWhileItsSuccessorStoodStillAreHeardBeforeTheyAreGivenUp) {
  const std::string address = unique_address();
  auto listener = listen_abstract(address);
  ASSERT_TRUE(listener) << listener.error().to_string();
  const UniqueFd memory = private_memfd("test", MFD_ALLOW_SEALING);
  const UniqueFd doorbell(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK));
  const auto coordinator = [&] {
    return *Server::create({address,
                            "gpu0",
                            Discipline::kPreemptive,
                            std::vector<std::string>(16, "node"),
                            {},
                            dup(listener->get()),
                            dup(memory.get()),
                            dup(doorbell.get())});
  };
  const UniqueFd stop(eventfd(0, EFD_CLOEXEC));
  auto first = coordinator();
  std::thread thread([&] { EXPECT_TRUE(first->run(stop.get())); });
  const auto connect = [&](std::uint32_t xnode) {
    return *Port::connect(address, "worker" + std::to_string(xnode), {xnode}, {});
  };
  const auto low = connect(0), high = connect(1);
  Obedient low_mgmt(*low), high_mgmt(*high);
  signal_eventfd(stop.get());
  thread.join();
  first.reset();
  drain_eventfd(stop.get());

  auto second = coordinator();
  std::this_thread::sleep_for(2500ms);  // longer than it waits for those that do not come
  thread = std::thread([&] { EXPECT_TRUE(second->run(stop.get())); });
  low->start(numbered(0, 0, 1));
  high->start(numbered(1, 0, 2));
  wait_for([&] { return low_mgmt.suspended.load(); });
  high->finish();
  wait_for([&] { return !low_mgmt.suspended.load(); });
  low->finish();
  EXPECT_FALSE(low->lost());
  EXPECT_FALSE(high->lost());
  signal_eventfd(stop.get());
  thread.join();
}

/// An app of several rates keeps no order, whatever the policy says: what the coordinator alone
/// kept left jobs waiting for seconds.
TEST(Server, OrderThatTheWorkersDoNotKeepIsNotKept) {
  for (const auto discipline : {Discipline::kPreemptive, Discipline::kGate, Discipline::kKernel}) {
    Running running(discipline, {{1, 2}});
    auto first = Port::connect(running.address(), "first", {1}, {});
    auto second = Port::connect(running.address(), "second", {2}, {});
    ASSERT_TRUE(first && second);
    std::promise<void> through;
    std::thread other([&] {
      // Contended, so that the coordinator decides; 1 never finishes release 7.
      (*first)->begin(numbered(1, 0, 9));
      (*second)->begin(numbered(2, 7, 5));
      (*first)->wait();
      (*first)->finish();
      (*second)->wait();
      (*second)->finish();
      through.set_value();
    });
    const bool done = through.get_future().wait_for(10s) == std::future_status::ready;
    EXPECT_TRUE(done) << "release 7 of 2 waits for release 7 of 1, which never comes";
    if (!done) (*second)->interrupt();
    other.join();
    auto ordered = Port::connect(running.address(), "ordered", {3}, {{1, 2}});
    EXPECT_FALSE(ordered) << "one of them would wait for ever";
  }
}

TEST(Server, OrderThatTheWorkersKeepIsKept) {
  Running running(Discipline::kGate, {{1, 2}});
  const auto first = running.port(1);
  const auto second = running.port(2);
  second->begin(numbered(2, 0, 9));
  first->begin(numbered(1, 0, 5));
  first->wait();  // the less urgent one, since the other is not eligible
  first->finish();
  second->wait();
  second->finish();
  EXPECT_FALSE(Port::connect(running.address(), "unordered", {3}, {}));
}

/// A suspended job that is lent the key of the most urgent one goes on, and that one waits for it.
TEST(Server, WhoIsLentAKeyGoesOn) {
  Running server(Discipline::kPreemptive);
  auto low = server.port(1), high = server.port(2);
  const auto observer = Observer::connect(server.address());
  ASSERT_TRUE(observer) << observer.error().to_string();
  const auto running = [&] {
    std::vector<Observer::Running> jobs;
    (*observer)->running(jobs);
    return jobs.size() == 1 ? jobs[0].xnode : UINT32_MAX;
  };
  {
    Obedient low_manages(*low), high_manages(*high);
    low->start(numbered(1, 7, 1));
    EXPECT_EQ(running(), 1u);
    high->start(numbered(2, 0, 5));
    wait_for([&] { return low_manages.suspended.load(); });
    EXPECT_EQ(running(), 2u);

    EXPECT_FALSE(low->begun(1, 6));  // is over
    EXPECT_FALSE(low->begun(2, 7));
    const auto job = low->begun(1, 7);
    ASSERT_TRUE(job);
    EXPECT_EQ(job->key, key_of_priority(1));
    low->lend(*job, key_of_priority(5));
    wait_for([&] {
      return !low_manages.suspended.load() && high_manages.suspended.load() && running() == 1;
    });
    EXPECT_EQ(low->begun(1, 7)->key, key_of_priority(5));
    low->finish();
    wait_for([&] { return !high_manages.suspended.load() && running() == 2; });
    high->finish();
    // Its next job goes by its own key.
    high->start(numbered(2, 1, 3));
    low->begin(numbered(1, 8, 1));
    EXPECT_EQ(low->begun(1, 8)->key, key_of_priority(1));
    EXPECT_EQ(running(), 2u);
    high->finish();
    low->wait();
    low->finish();
  }
  EXPECT_EQ(running(), UINT32_MAX);
}

TEST(Server, TellsItsStateInWords) {
  Running running(Discipline::kPreemptive);
  const auto port = running.port(3);
  port->start(numbered(3, 7, 5));
  auto socket = connect_abstract(running.address());
  ASSERT_TRUE(socket);
  const auto kind = static_cast<std::uint32_t>(MessageKind::kStatus);
  ASSERT_TRUE(send_packet(socket->get(), &kind, sizeof kind));
  std::string text(kMaxStatusBytes, '\0');
  const auto size = receive_packet(socket->get(), text.data(), text.size());
  ASSERT_TRUE(size);
  text.resize(*size);
  EXPECT_NE(text.find("\"worker\":\"worker3\",\"state\":\"running\",\"xnode\":\"node\",\"job\":7,"
                      "\"priority\":5"),
            std::string::npos)
      << text;
  port->finish();
}

TEST(Server, WhoAsksAndDoesNotReadIsCutOffAndNobodyElseWaits) {
  Running running(Discipline::kPreemptive);
  const auto port = running.port(3);
  for (const MessageKind word : {MessageKind::kStatus, MessageKind::kObserve}) {
    const auto kind = static_cast<std::uint32_t>(word);
    const auto asker = connect_abstract(running.address());
    ASSERT_TRUE(asker);
    // Until the coordinator has hung up: it neither reads for ever nor waits.
    Status asked;
    while (asked || asked.error().code == ErrorCode::kTimeout)
      asked = send_packet(asker->get(), &kind, sizeof kind);
    const auto other = connect_abstract(running.address());
    const auto status = static_cast<std::uint32_t>(MessageKind::kStatus);
    ASSERT_TRUE(send_packet(other->get(), &status, sizeof status));
    std::string text(kMaxStatusBytes, '\0');
    EXPECT_TRUE(receive_packet(other->get(), text.data(), text.size()));
  }
  port->start(numbered(3, 7, 5));
  port->finish();
}

TEST(Server, RefusesWhatIsNoHello) {
  Running running(Discipline::kPreemptive);
  const auto refused = [&](const void* data, std::size_t bytes) {
    auto socket = connect_abstract(running.address());
    EXPECT_TRUE(socket);
    EXPECT_TRUE(send_packet(socket->get(), data, bytes));
    Refused answer;
    const auto size = receive_packet(socket->get(), &answer, sizeof answer);
    return !size || answer.kind == static_cast<std::uint32_t>(MessageKind::kRefused);
  };
  Hello hello;
  hello.version = 99;
  EXPECT_TRUE(refused(&hello, sizeof hello));
  hello = {};
  hello.num_xnodes = kMaxWorkerXNodes + 1;
  EXPECT_TRUE(refused(&hello, sizeof hello));
  hello = {};
  hello.num_xnodes = 1;
  hello.xnodes[0] = 16;  // the app has 0..15
  EXPECT_TRUE(refused(&hello, sizeof hello));
  hello = {};
  std::fill(std::begin(hello.worker), std::end(hello.worker), 'x');
  EXPECT_TRUE(refused(&hello, sizeof hello));
  hello = {};
  EXPECT_TRUE(refused(&hello, sizeof hello - 1));
  EXPECT_TRUE(refused("?", 1));
  EXPECT_TRUE(running.port(1));  // and it serves on
}

}  // namespace
}  // namespace xauto::coord
