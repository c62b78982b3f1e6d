// SPDX-License-Identifier: Apache-2.0
// One worker, or two that hand a chain over, where nobody schedules: threads, errors, what inits
// have made, an exec that does not return.
#include "runtime/worker.h"

#include <chrono>
#include <functional>
#include <future>
#include <stdexcept>
#include <thread>
#include <vector>

#include <gtest/gtest.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <xauto/emu.h>

#include "base/clock.h"
#include "base/socket.h"
#include "base/unique_fd.h"
#include "coord/port.h"
#include "coord/server.h"
#include "emu/client.h"
#include "emu/server.h"

namespace xauto::runtime {
namespace {

using namespace std::chrono_literals;

/// A module of two XNodes "a" and "b", on the workers that a test says.
class WorkerTest : public ::testing::Test, public ModuleHost {
 protected:
  WorkerTest() {
    spec_.name = "M";
    spec_.make_state = []() -> std::shared_ptr<void> { return std::make_shared<int>(); };
    spec_.inputs = {*detail::topic_spec(Topic<int>("in"))};
    graph_.modules.push_back({"M", &spec_, {}, {}, {}, true});
    graph_.single_rate = true;
    module_ =
        std::make_unique<ModuleRuntime>(graph_, 0, *this, std::vector<const transport::Channel*>{});
    row_.module = 0;
    row_.runtime = module_.get();
    row_.activation = &module_->activation(0);
    for (const char* name : {"a", "b"}) {
      auto impl = std::make_unique<detail::ImplSpec>();
      impl->init = [](const XpuId&, void*, std::shared_ptr<void>&) { return SchedHandle::gate(); };
      impl->exec = [this, name = std::string(name)](void*, void*, const Input& input) {
        say(name + std::to_string(input.sequence()));
        return Status();
      };
      Placed placed;
      placed.name = name;
      placed.xnode = placed.task = static_cast<std::uint32_t>(row_.nodes.size());
      placed.impl = impl.get();
      impls_.push_back(std::move(impl));
      row_.nodes.push_back(std::move(placed));
    }
    threads_ = std::move(*xpu::CpuThreads::create({}));
  }

  /// Both XNodes on it.
  Worker& only() {
    Worker& worker = add("M@npu0");
    for (Placed& placed : row_.nodes) placed.worker = &worker;
    return worker;
  }
  Worker& add(const std::string& name) {
    WorkerOptions options{name, 0, {npu_, {"npu0", XPU("npu"), 0}}, {}, 0, 0, {}, {}};
    options.backend.scheduled = false;
    workers_.push_back(std::make_unique<Worker>(options, row_, nullptr, *threads_));
    return *workers_.back();
  }
  /// Jobs of "a" say that they run, and go on until they may leave.
  void stay(std::promise<void>& inside, std::promise<void>& leave) {
    impls_[0]->exec = [&](void*, void*, const Input&) -> Status {
      inside.set_value();
      leave.get_future().wait();
      return {};
    };
  }
  /// An activation, and its end.
  bool run(std::uint64_t sequence) {
    over_ = std::promise<bool>();
    auto over = over_.get_future();
    module_->receive(0, {std::make_shared<const int>(0), 1, sequence});
    return over.wait_for(30s) == std::future_status::ready && over.get();
  }
  void say(const std::string& what) {
    const Guard lock(mutex_);
    said_ += (said_.empty() ? "" : " ") + what;
  }
  std::string said() {
    const Guard lock(mutex_);
    return said_;
  }

  void activate(int, Activation&) override { row_.nodes.front().worker->submit(0); }
  void proceed(int, Activation&, std::size_t node) override {
    row_.nodes[node].worker->submit(node);
  }
  void done(int, const Activation&) override { over_.set_value(true); }
  void dropped(int, std::uint64_t, std::uint32_t) override { over_.set_value(false); }
  void skip(int, std::uint64_t) override {}

  const Xpu npu_{"npu0", "npu", false};
  detail::XModuleSpec spec_;
  Graph graph_;
  std::unique_ptr<ModuleRuntime> module_;
  std::vector<std::unique_ptr<detail::ImplSpec>> impls_;
  NodeRow row_;
  std::unique_ptr<xpu::CpuThreads> threads_;
  std::promise<bool> over_;
  std::vector<std::unique_ptr<Worker>> workers_;

 private:
  PiMutex mutex_;
  std::string said_ XAUTO_GUARDED_BY(mutex_);
};

TEST_F(WorkerTest, RunsTheChainInOrderOnOneThreadOfItsOwn) {
  std::vector<std::thread::id> ids;  // execution thread; read after its end
  for (auto& impl : impls_)
    impl->exec = [&, exec = impl->exec](void* object, void* state, const Input& input) {
      ids.push_back(std::this_thread::get_id());
      return exec(object, state, input);
    };
  Worker& worker = only();
  ASSERT_TRUE(worker.start());
  EXPECT_TRUE(run(0));
  EXPECT_TRUE(run(1));
  EXPECT_TRUE(worker.stop());
  EXPECT_EQ(said(), "a0 b0 a1 b1");
  ASSERT_EQ(ids.size(), 4u);
  for (const std::thread::id id : ids) {
    EXPECT_EQ(id, ids.front());
    EXPECT_NE(id, std::this_thread::get_id());
  }
}

/// A coordinator or an emulator, in a thread.
template <class Server>
class Serving {
 public:
  explicit Serving(std::unique_ptr<Server> server) : server_(std::move(server)) {
    thread_ = std::thread([this] { EXPECT_TRUE(server_->run(stop_.get())); });
  }
  ~Serving() {
    signal_eventfd(stop_.get());
    thread_.join();
  }

 private:
  UniqueFd stop_{eventfd(0, EFD_CLOEXEC)};
  std::unique_ptr<Server> server_;
  std::thread thread_;
};

/// The coordinator starts it on the second level, which one of the two emulated GPUs does not have.
TEST_F(WorkerTest, TakesTheLevelThatItIsTold) {
  for (const int levels : {0, 2}) {
    const std::string self = "xauto-test/level-" + std::to_string(getpid()) + "-";
    const std::string emulator = self + "emud" + std::to_string(levels),
                      arbiter = self + "gpu0" + std::to_string(levels);
    const Xpu gpu{.id = "gpu0", .type = "gpu", .levels = levels};
    auto emulated = emu::Server::create({"one", {gpu}}, {.address = emulator});
    ASSERT_TRUE(emulated) << emulated.error().to_string();
    const Serving<emu::Server> devices(std::move(*emulated));
    auto decides = coord::Server::create({.address = arbiter,
                                          .xpu = "gpu0",
                                          .discipline = Discipline::kLevels,
                                          .xnodes = {"a", "b", "other"},
                                          .levels = 2});
    ASSERT_TRUE(decides) << decides.error().to_string();
    const Serving<coord::Server> coordinator(std::move(*decides));
    emu::set_this_threads_site(std::make_shared<emu::Site>(emu::Site{.address = emulator}));
    std::vector<std::shared_ptr<emu::Context>> open;
    for (auto& impl : impls_)
      impl->init = [&](const XpuId& xpu, void*, std::shared_ptr<void>&) {
        open.push_back(std::make_shared<emu::Context>(std::move(*emu::Context::open(xpu))));
        return open.back()->handle();
      };
    for (Placed& placed : row_.nodes) {
      placed.urgency = Urgency::of_priority(9);
      placed.here = std::make_shared<Instance>();
    }
    ContextCounts counts;
    Worker worker({.name = "M@gpu0",
                   .xpu = 0,
                   .backend = {.xpu = gpu, .id = {"gpu0", XPU::GPU, 0}, .emulated = true},
                   .coordinator = arbiter,
                   .contexts = &counts},
                  row_, nullptr, *threads_);
    for (Placed& placed : row_.nodes) placed.worker = &worker;
    ASSERT_TRUE(worker.start());
    const auto other = std::move(*coord::Port::connect(arbiter, "other", {2}, {}));
    other->start({2, 0, coord::key_of_priority(1)});
    EXPECT_TRUE(run(levels == 0 ? 0 : 1));
    other->finish();
    EXPECT_EQ(counts.misplaced.load(), levels == 0 ? 2u : 0u) << levels;
    EXPECT_TRUE(worker.stop());
    emu::set_this_threads_site(nullptr);
  }
}

TEST_F(WorkerTest, AnXNodeIsToldByWhenItIsToEndAndTheModuleWhenItWasMissed) {
  std::vector<std::optional<std::chrono::nanoseconds>> due,
      result;  // execution thread's, till its end
  std::vector<bool> time;
  for (auto& impl : impls_)
    impl->exec = [&](void*, void*, const Input& input) {
      due.push_back(input.due());
      result.push_back(input.result_due());
      time.push_back(input.time_for(1s));
      return Status();
    };
  spec_.on_miss = [this](std::uint64_t sequence, std::chrono::nanoseconds late) {
    if (late > 1s) say("missed" + std::to_string(sequence));
    throw std::runtime_error("is logged");
  };
  Worker& worker = only();
  ASSERT_TRUE(worker.start());
  EXPECT_TRUE(run(0));  // origins are 1 ns: long ago
  row_.nodes[0].urgency = Urgency::of_keys({5}, {});
  row_.nodes[1].urgency = Urgency::of_keys({1'000'000'000'000'000, 7}, {});
  EXPECT_TRUE(run(1));
  EXPECT_TRUE(run(2));  // the second XNode has ages
  EXPECT_TRUE(worker.stop());
  EXPECT_EQ(said(), "missed1");
  ASSERT_EQ(due.size(), 6u);
  EXPECT_EQ(due[0], std::nullopt);
  EXPECT_EQ(due[1], std::nullopt);
  EXPECT_EQ(due[2], 5001ns);
  EXPECT_EQ(due[3], 7001ns);
  EXPECT_EQ(due[5], 1'000'000'000'000'000us + 1ns);
  EXPECT_EQ(result[0], std::nullopt);
  EXPECT_EQ(result[2], 7001ns);
  EXPECT_EQ(result[4], due[5]);
  EXPECT_EQ(time, (std::vector{true, true, false, false, false, true}));
}

TEST_F(WorkerTest, AnUrgencyThatIsAskedForIsTheNextJobs) {
  XNodeLine line;
  std::vector<std::optional<std::chrono::nanoseconds>> due;  // execution thread's, till its end
  impls_[0]->exec = [&](void*, void*, const Input& input) {
    due.push_back(input.due());
    return Status();
  };
  row_.nodes[0].line = &line;
  for (Placed& placed : row_.nodes) placed.urgency = Urgency::of_keys({5}, {});
  Worker& worker = only();
  ASSERT_TRUE(worker.start());
  EXPECT_TRUE(run(0));  // origins are 1 ns
  line.asked.store(9);
  EXPECT_TRUE(run(1));
  line.asked.store(XNodeLine::kAsPlanned);
  EXPECT_TRUE(run(2));
  EXPECT_TRUE(worker.stop());
  EXPECT_EQ(due, (std::vector<std::optional<std::chrono::nanoseconds>>{5001ns, 9001ns, 5001ns}));
  EXPECT_EQ(Urgency::of_priority(3).asked(1, 8), coord::key_of_priority(8));
}

TEST_F(WorkerTest, HandsTheChainOverToTheNextWorker) {
  Worker& first = add("M@npu0");
  Worker& second = add("M@npu1");
  row_.nodes[0].worker = &first;
  row_.nodes[1].worker = &second;
  ASSERT_TRUE(first.start());
  ASSERT_TRUE(second.start());
  for (std::uint64_t k = 0; k < 3; ++k) EXPECT_TRUE(run(k));
  EXPECT_EQ(said(), "a0 b0 a1 b1 a2 b2");
  // Either may be gone first.
  EXPECT_TRUE(second.stop());
  EXPECT_TRUE(first.stop());
}

TEST_F(WorkerTest, AnInitThatThrowsIsNamedAndNothingRuns) {
  impls_[1]->init = [](const XpuId&, void*, std::shared_ptr<void>&) -> SchedHandle {
    throw std::runtime_error("no engine");
  };
  Worker& worker = only();
  const Status started = worker.start();
  ASSERT_FALSE(started);
  EXPECT_EQ(started.error().what, "threw: no engine");
  EXPECT_EQ(started.error().where, "init of XNode 'b' on npu0");
  EXPECT_TRUE(worker.stop());
  EXPECT_EQ(said(), "");
}

TEST_F(WorkerTest, AnExecThatFailsEndsItsActivationOnly) {
  impls_[0]->exec = [](void*, void*, const Input& input) -> Status {
    if (input.sequence() == 0) return fail(ErrorCode::kUnavailable, "no image");
    if (input.sequence() == 1) throw 7;
    return {};
  };
  Worker& worker = only();
  ASSERT_TRUE(worker.start());
  EXPECT_EQ(worker.first_failure(), "");
  EXPECT_FALSE(run(0));
  EXPECT_FALSE(run(1));
  EXPECT_TRUE(run(2));
  EXPECT_TRUE(worker.stop());
  EXPECT_EQ(said(), "b2");
  EXPECT_NE(worker.first_failure().find("exec of XNode 'a' on npu0"), std::string::npos);
  EXPECT_NE(worker.first_failure().find("no image"), std::string::npos) << worker.first_failure();
}

TEST_F(WorkerTest, WhatInitsHaveMadeGoesOnTheirThreadTheLastOneFirst) {
  std::vector<std::thread::id> ids;
  for (std::size_t n = 0; n < 2; ++n)
    impls_[n]->init = [&, n](const XpuId& id, void*, std::shared_ptr<void>& object) {
      ids.push_back(std::this_thread::get_id());
      object = std::shared_ptr<void>(new int(0), [&, n](int* made) {
        ids.push_back(std::this_thread::get_id());
        say("end" + std::to_string(n));
        delete made;
      });
      say("init" + std::to_string(n) + "@" + id.name);
      return SchedHandle::gate();
    };
  Worker& worker = only();
  ASSERT_TRUE(worker.start());
  EXPECT_TRUE(run(0));
  EXPECT_TRUE(worker.stop());
  EXPECT_EQ(said(), "init0@npu0 init1@npu0 a0 b0 end1 end0");
  for (const std::thread::id id : ids) EXPECT_EQ(id, ids.front());
}

TEST_F(WorkerTest, AWatchedJobIsToldWhenItIsAsLongAsSomeScenarioAllowsAndNobodyLooksBefore) {
  constexpr std::int64_t kTellNs = 4'000'000, kNeverNs = 3'600'000'000'000;
  std::promise<void> inside, leave;
  stay(inside, leave);
  XNodeLine line;
  row_.nodes[0].limit({.tell_ns = kTellNs}, true, line);
  Worker& worker = only();
  const std::shared_ptr<Alarm> alarm = *Alarm::make();
  alarm->set(now_ns() + kNeverNs);
  worker.times().ask(alarm);
  ASSERT_TRUE(worker.start());
  const std::int64_t before_ns = now_ns();
  std::thread driver([&] { EXPECT_TRUE(run(0)); });
  inside.get_future().wait();
  const std::int64_t began_ns = alarm->wait() - kTellNs;
  EXPECT_GE(began_ns, before_ns);
  // Too early: it asks for the rest.
  alarm->set(now_ns() + kNeverNs);
  worker.times().tell_time(began_ns + 1'000'000);
  EXPECT_EQ(line.seen_job.load(), 0u);
  EXPECT_EQ(alarm->wait(), began_ns + kTellNs);
  alarm->set(now_ns() + kNeverNs);
  worker.times().tell_time(began_ns + kTellNs);
  EXPECT_EQ(XNodeLine::ns_of(line.seen_job.load()), kTellNs);
  EXPECT_EQ(alarm->wait(), began_ns + kTellNs + 1'000'000) << "as long as it runs";
  leave.set_value();
  driver.join();
  EXPECT_TRUE(worker.stop());
}

TEST_F(WorkerTest, AnExecThatDoesNotReturnIsFoundOnce) {
  std::promise<void> inside, leave;
  stay(inside, leave);
  XNodeLine line;
  row_.nodes[0].limit({0, 1'000'000}, false, line);
  Worker& worker = only();
  ASSERT_TRUE(worker.start());
  std::thread driver([&] { EXPECT_TRUE(run(0)); });
  inside.get_future().wait();
  const auto hung = worker.times().find_hung(now_ns() + 5'000'000);
  ASSERT_TRUE(hung);
  EXPECT_EQ(hung->placed->name, "a");
  EXPECT_EQ(hung->sequence, 0u);
  EXPECT_FALSE(worker.times().find_hung(now_ns() + 6'000'000)) << "once is enough";
  EXPECT_TRUE(worker.in_exec());
  leave.set_value();
  driver.join();
  EXPECT_TRUE(worker.stop());
  EXPECT_FALSE(worker.in_exec());
}

TEST_F(WorkerTest, AJobPastItsWcetIsToldBeforeItEndsAndCountedOnce) {
  std::promise<void> inside, leave;
  impls_[0]->exec = [&](void*, void*, const Input& input) -> Status {
    if (input.sequence() > 0) return {};
    inside.set_value();
    leave.get_future().wait();
    return {};
  };
  XNodeLine line;
  row_.nodes[0].limit({0, 0, 100'000'000}, false, line);
  Worker& worker = only();
  ASSERT_TRUE(worker.start());
  std::thread driver([&] { EXPECT_TRUE(run(0)); });
  inside.get_future().wait();
  const std::int64_t now = now_ns();
  for (const std::int64_t later_s : {1, 2, 9})
    worker.times().tell_past_wcet(now + later_s * 1'000'000'000);
  EXPECT_EQ(line.unended, 1u);
  EXPECT_GE(line.unended_ns, 8'900'000'000);
  EXPECT_EQ(line.unended_wcet_ns, 100'000'000);
  EXPECT_EQ(line.over_wcet, 0u) << "those that ended";
  EXPECT_EQ(line.jobs, 0u);
  leave.set_value();
  driver.join();
  EXPECT_EQ(line.unended, 0u);
  EXPECT_EQ(line.unended_ns, 0);
  EXPECT_EQ(line.over_wcet, 1u) << "what was told stays told";
  EXPECT_TRUE(run(1));
  worker.times().tell_past_wcet(now_ns() + 9'000'000'000);
  EXPECT_TRUE(worker.stop());
  EXPECT_EQ(line.jobs, 2u);
  EXPECT_EQ(line.over_wcet, 1u) << "unless the machine stood still for 100 ms";
  EXPECT_EQ(line.unended, 0u) << "none runs";
}

/// Modules M and S on one XPU that takes a job at a time, a worker each; S hears M and has no output.
class TwoOfACrew : public ::testing::Test, public ModuleHost {
 protected:
  TwoOfACrew() {
    for (const std::size_t m : {0u, 1u}) {
      specs_[m].name = m == 0 ? "M" : "S";
      specs_[m].make_state = []() -> std::shared_ptr<void> { return std::make_shared<int>(); };
      specs_[m].inputs = {*detail::topic_spec(Topic<int>(m == 0 ? "in" : "between"))};
      graph_.modules.push_back({specs_[m].name, &specs_[m], {}, {}, {}, m == 1});
      graph_.modules.back().numbered = false;
    }
    specs_[0].outputs = {
        {*detail::topic_spec(Topic<int>("between")),
         [](void*, detail::MessageMemory*) { return std::make_shared<const int>(0); }}};
    between_.subscribe([this](const detail::Envelope& e) { modules_[1]->receive(0, e); });
    const std::string address = "xauto-test/crew-" + std::to_string(getpid());
    coordinator_ = std::make_unique<Serving<coord::Server>>(
        std::move(*coord::Server::create({.address = address,
                                          .xpu = "npu0",
                                          .discipline = Discipline::kGate,
                                          .xnodes = {"m", "s"}})));
    for (const std::size_t m : {0u, 1u}) {
      std::vector<const transport::Channel*> outputs;
      if (m == 0) outputs.push_back(&between_);
      modules_[m] =
          std::make_unique<ModuleRuntime>(graph_, static_cast<int>(m), *this, std::move(outputs));
      modules_[m]->set_overload({Overload::Kind::kQueue, 4});
      impls_[m].init = [](const XpuId&, void*, std::shared_ptr<void>&) {
        return SchedHandle::gate();
      };
      impls_[m].exec = [this, m](void*, void*, const Input& input) -> Status {
        {
          const Guard lock(mutex_);
          ran_.push_back((m == 0 ? "m" : "s") + std::to_string(input.sequence()));
          threads_of_.push_back(std::this_thread::get_id());
        }
        if (during_) during_(m, input.sequence());
        return {};
      };
      rows_[m].module = static_cast<int>(m);
      rows_[m].runtime = modules_[m].get();
      rows_[m].activation = &modules_[m]->activation(0);
      Placed placed;
      placed.name = m == 0 ? "m" : "s";
      placed.xnode = placed.task = static_cast<std::uint32_t>(m);
      placed.impl = &impls_[m];
      placed.urgency = Urgency::of_priority(static_cast<std::int64_t>(9 - m));
      rows_[m].nodes.push_back(std::move(placed));
      workers_[m] = std::make_unique<Worker>(
          WorkerOptions{.name = specs_[m].name,
                        .xpu = 0,
                        .backend = {.xpu = npu_, .id = {"npu0", XPU("npu"), 0}},
                        .coordinator = address},
          rows_[m], nullptr, *threads_);
      workers_[m]->share(crew_);
      rows_[m].nodes.front().worker = workers_[m].get();
      EXPECT_TRUE(workers_[m]->start());
    }
  }
  ~TwoOfACrew() override {
    for (const auto& worker : workers_) EXPECT_TRUE(worker->stop());
  }

  void message(std::size_t module, std::uint64_t sequence) {
    modules_[module]->receive(0, {std::make_shared<const int>(0), 1, sequence});
  }
  /// As the sensor's thread does, which is woken when a release has ended.
  void message_from_elsewhere(std::size_t module, std::uint64_t sequence) {
    std::thread([&] { message(module, sequence); }).join();
  }
  void wait_for(std::size_t jobs) {
    for (const std::int64_t limit = now_ns() + 30'000'000'000; now_ns() < limit;
         std::this_thread::sleep_for(1ms)) {
      const Guard lock(mutex_);
      if (ended_ >= jobs) return;
    }
    ADD_FAILURE() << "jobs have no thread";
  }

  void activate(int m, Activation&) override {
    rows_[static_cast<std::size_t>(m)].nodes.front().worker->submit(0);
  }
  void proceed(int, Activation&, std::size_t) override {}
  void done(int m, const Activation& activation) override {
    if (after_) after_(static_cast<std::size_t>(m), activation.sequence());
  }
  void left(int) override {
    const Guard lock(mutex_);
    ++ended_;
  }
  void dropped(int, std::uint64_t, std::uint32_t) override { ADD_FAILURE(); }
  void skip(int, std::uint64_t) override {}

  const Xpu npu_{"npu0", "npu", false};
  detail::XModuleSpec specs_[2];
  Graph graph_;
  transport::Channel between_;
  std::unique_ptr<Serving<coord::Server>> coordinator_;
  std::unique_ptr<xpu::CpuThreads> threads_ = std::move(*xpu::CpuThreads::create({}));
  std::unique_ptr<ModuleRuntime> modules_[2];
  detail::ImplSpec impls_[2];
  NodeRow rows_[2];
  Crew crew_;
  std::function<void(std::size_t, std::uint64_t)> during_, after_;  ///< an exec; a module's end
  PiMutex mutex_;
  std::vector<std::string> ran_ XAUTO_GUARDED_BY(mutex_);
  std::vector<std::thread::id> threads_of_ XAUTO_GUARDED_BY(mutex_);
  std::size_t ended_ XAUTO_GUARDED_BY(mutex_) = 0;
  std::unique_ptr<Worker> workers_[2];
};

TEST_F(TwoOfACrew, WhoHearsOfAnEndFindsItsThreadFree) {
  after_ = [&](std::size_t m, std::uint64_t k) {
    if (m == 1 && k < 3) message_from_elsewhere(0, k + 1);
  };
  message(0, 0);
  wait_for(8);
  const Guard lock(mutex_);
  EXPECT_EQ(ran_, (std::vector<std::string>{"m0", "s0", "m1", "s1", "m2", "s2", "m3", "s3"}));
  for (const std::thread::id id : threads_of_) EXPECT_EQ(id, threads_of_.front());
}

/// S's end makes S's next job ready, on the thread that had nothing to do any more.
TEST_F(TwoOfACrew, AThreadThatIsNotFreeAfterAllKeepsBothJobs) {
  for (const bool chosen : {false, true}) {
    during_ = [&](std::size_t m, std::uint64_t k) {
      if (m == 1 && k == 0) message_from_elsewhere(1, 1);
    };
    after_ = [&](std::size_t m, std::uint64_t k) {
      if (m == 1 && k == 0 && chosen) message_from_elsewhere(0, 2);
    };
    {
      const Guard lock(mutex_);
      ran_.clear();
      ended_ = 0;
    }
    message(0, 0);
    wait_for(chosen ? 5 : 3);
    const Guard lock(mutex_);
    EXPECT_EQ(ran_, chosen ? (std::vector<std::string>{"m0", "s0", "m2", "s1", "s2"})
                           : (std::vector<std::string>{"m0", "s0", "s1"}));
  }
}

}  // namespace
}  // namespace xauto::runtime
