// SPDX-License-Identifier: Apache-2.0
// A whole app in this process, with real coordinators in threads: every job runs, in the policy's
// order, faults of user code are contained, and everything is accounted for. No time is measured.
#include "engine/engine.h"

#include <condition_variable>
#include <future>
#include <mutex>
#include <thread>

#include <gtest/gtest.h>

#include "base/memory_file.h"

#include "fates.h"
#include "test_app.h"

namespace xauto::runtime {
namespace {

TEST(Engine, RunsEveryXNodeOfEveryRelease) {
  for (const Scheduling scheduling :
       {Scheduling::kXAuto, Scheduling::kTimeshare, Scheduling::kRos2}) {
    TestApp app;
    app.session.scheduling = scheduling;
    const auto report = app.run();
    ASSERT_TRUE(report) << report.error().to_string();
    EXPECT_TRUE(report->complete);
    EXPECT_EQ(report->releases.size(), 50u);
    for (const ReleaseRecord& release : report->releases) EXPECT_GE(release.latency_us, 0);
    for (const char* node : {"a1", "a2", "b1", "c1"})
      EXPECT_EQ(count(app.log(), node), 50u) << node;
  }
}

/// a2 is more urgent than b1, and becomes ready while b1 runs, which ends only when a2 has: on a gate it never would.
TEST(Engine, AMoreUrgentJobIsStartedOnALevelAboveThatOfTheOneThatRuns) {
  TestApp app;
  app.session.platform.xpus[1] = {.id = "npu0", .type = "npu", .preemptive = true, .levels = 2};
  static thread_local int level;
  app.handle = [] {
    EXPECT_EQ(levels({"npu0", XPU("npu"), 0}), 2) << "an init is told";
    return SchedHandle::on_levels([](int on) -> Status {
      level = on;
      return {};
    });
  };
  std::mutex mutex;
  std::condition_variable changed;
  std::map<std::string, std::uint64_t> begun, ended;
  std::vector<std::string> on;
  const auto wait_for = [&](std::map<std::string, std::uint64_t>& of, const char* node,
                            std::uint64_t k) {
    std::unique_lock lock(mutex);
    EXPECT_TRUE(changed.wait_for(lock, 60s, [&] { return of[node] > k; })) << node << k;
  };
  app.exec = [&](const std::string& node, std::uint64_t k) -> Status {
    {
      const std::lock_guard lock(mutex);
      ++begun[node];
      if (node != "a1") on.push_back(node + ":" + std::to_string(level));
      changed.notify_all();
    }
    if (node == "a1") wait_for(begun, "b1", k);
    if (node == "b1") wait_for(ended, "a2", k);
    const std::lock_guard lock(mutex);
    ++ended[node];
    changed.notify_all();
    return {};
  };
  const auto report = app.run();
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_TRUE(report->complete);
  ASSERT_EQ(on.size(), 150u);
  for (std::size_t k = 0; k < 150; k += 3)
    EXPECT_EQ((std::vector<std::string>{on[k], on[k + 1], on[k + 2]}),
              (std::vector<std::string>{"b1:0", "a2:1", "c1:0"}))
        << k;
}

TEST(Engine, WhatPutsNoWorkOnLevelsIsRefusedWhereThereAreSome) {
  TestApp app;
  app.session.platform.xpus[1] = {.id = "npu0", .type = "npu", .preemptive = true, .levels = 2};
  const auto report = app.run();
  ASSERT_FALSE(report);
  EXPECT_NE(report.error().what.find(
                "has \"levels\" in the platform file, and its scheduling handle is gate()"),
            std::string::npos)
      << report.error().what;
}

TEST(Engine, ATakeThatFailsIsCountedAndTheJobRuns) {
  TestApp app;
  app.session.platform.xpus[1] = {.id = "npu0", .type = "npu", .preemptive = true, .levels = 2};
  app.handle = [] {
    return SchedHandle::on_levels([](int) -> Status { throw std::runtime_error("no stream"); });
  };
  const auto report = app.run();
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_TRUE(report->complete);
  EXPECT_EQ(count(app.log(), "a2"), 50u);
}

TEST(Engine, OrderConstraintHoldsTheXNodeBackInEveryActivation) {
  TestApp app;
  app.session.policy.order = {{1, 2}};  // a2 before b1, though b1 is ready first
  ASSERT_TRUE(app.run());
  const auto log = app.log();
  for (std::uint64_t k = 0; k < 50; ++k) {
    const auto at = [&](const std::string& what) {
      return std::find(log.begin(), log.end(), what + "#" + std::to_string(k)) - log.begin();
    };
    EXPECT_LT(at("a2"), at("b1")) << k;
  }
}

TEST(Engine, ExceptionDropsTheActivationAndTheRestGoesOn) {
  TestApp app;
  app.session.policy.order = {{1, 2}};  // and nobody waits for the one that failed
  app.exec = [](const std::string& node, std::uint64_t k) -> Status {
    if (node == "a1" && k % 5 == 3) throw std::runtime_error("boom");
    if (node == "b1" && k % 5 == 4) return fail(ErrorCode::kIo, "no frame");
    if (node == "c1" && k == 10) throw 42;
    return {};
  };
  const auto report = app.run();
  ASSERT_TRUE(report);
  EXPECT_TRUE(report->complete);
  EXPECT_EQ(report->releases.size(), 50u);
  std::uint64_t lost = 0;
  for (const ReleaseRecord& release : report->releases) lost += release.latency_us < 0 ? 1 : 0;
  EXPECT_EQ(lost, 21u);
  EXPECT_EQ(report->modules[0].failed, 10u);
  EXPECT_EQ(report->modules[1].failed, 10u);
  EXPECT_EQ(report->modules[2].failed, 1u);
  EXPECT_EQ(report->modules[2].dropped, 20u);
  EXPECT_EQ(count(app.log(), "c1"), 30u);
  EXPECT_NE(report->note.find("exec of XNode 'a1' on cpu0: threw: boom"), std::string::npos)
      << report->note;
}

TEST(Engine, FailingInitNamesTheXNode) {
  TestApp app;
  for (auto& impl : app.spec.modules[0]->nodes[1]->impls)
    impl.init = [](const XpuId&, void*, std::shared_ptr<void>&) -> SchedHandle {
      throw std::runtime_error("no weights");
    };
  const auto report = app.run();
  ASSERT_FALSE(report);
  EXPECT_EQ(report.error().where, "init of XNode 'a2' on npu0");
  EXPECT_EQ(report.error().what, "threw: no weights");
}

TEST(Engine, AssignmentWithoutImplementationNamesBoth) {
  TestApp app;
  auto& impls = app.spec.modules[1]->nodes[0]->impls;
  std::erase_if(impls, [](const auto& impl) { return impl.xpu.type() == "npu"; });
  const auto report = app.run();
  ASSERT_FALSE(report);
  EXPECT_NE(report.error().what.find("is assigned to npu0 but has no implementation for 'npu'"),
            std::string::npos);
}

TEST(Engine, RefusesAnAppThatIsNotTheSessions) {
  TestApp app;
  app.session.app.xnodes[2].module = "Z";
  const auto report = app.run();
  ASSERT_FALSE(report);
  EXPECT_EQ(report.error().what, "XNode 'b1' is in XModule 'B', app.json says 'Z'");
}

TEST(Engine, OverrunsAreCountedAndNothingHangs) {
  TestApp app;
  app.session.releases.lockstep = false;
  app.session.releases.activations = 40;
  app.exec = [](const std::string& node, std::uint64_t) -> Status {
    if (node == "c1") std::this_thread::sleep_for(3ms);  // the sources come every millisecond
    return {};
  };
  const auto report = app.run();
  ASSERT_TRUE(report);
  EXPECT_TRUE(report->complete);
  EXPECT_EQ(report->releases.size(), 40u);
  const ModuleReport& c = report->modules[2];
  EXPECT_EQ(c.activations + c.dropped, 40u);
}

TEST(Engine, ReleasesAreInFlightTogetherAndEndInOrder) {
  TestApp app;
  app.session.releases.lockstep = false;
  // Nothing is lost however late a release is: each waits for its turn.
  app.session.deployment.defaults.overload = Overload{Overload::Kind::kQueue, 64};
  std::mutex mutex;
  std::condition_variable changed;
  std::uint64_t begun = 0;
  std::vector<std::uint64_t> ended;
  app.exec = [&](const std::string& node, std::uint64_t k) -> Status {
    std::unique_lock lock(mutex);
    if (node == "a1") {
      begun = k + 1;
      changed.notify_all();
    }
    if (node != "c1") return {};
    ended.push_back(k);
    // The next release is under way before this one ends: without that, nothing would go on.
    const bool next = k + 1 == app.session.releases.activations ||
                      changed.wait_for(lock, 20s, [&] { return begun > k + 1; });
    return next ? Status() : Status(fail(ErrorCode::kTimeout, "no other release is in flight"));
  };
  const auto report = app.run();
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_TRUE(report->complete) << report->note;
  EXPECT_EQ(report->lost_releases, 0u) << report->note;
  ASSERT_EQ(ended.size(), app.session.releases.activations);
  EXPECT_TRUE(std::is_sorted(ended.begin(), ended.end()));
}

TEST(Engine, AHungActivationIsGivenUpAndTheOthersGoOn) {
  TestApp app;
  app.session.policy.placements = {{0, 4}, {1, 3}, {0, 2}, {1, 1}};  // B on cpu0
  for (auto& xnode : app.session.app.xnodes) xnode.wcet_us = {{"cpu", 10}, {"npu", 10}};
  ModuleDeployment& b = app.session.deployment.modules["B"];
  b.hang_us = 300'000;
  b.on_hang = OnHang::kDrop;
  std::promise<void> release;
  std::future<void> released = release.get_future();
  std::atomic<bool> once{false};
  app.exec = [&](const std::string& node, std::uint64_t k) -> Status {
    if (node == "b1" && k == 5) released.wait();
    // In lockstep release 7 comes when 5 and 6 are settled, so B was given up, and lost 6.
    if (node == "a1" && k == 7 && !once.exchange(true)) release.set_value();
    return {};
  };
  const auto report = app.run();
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_TRUE(report->complete);
  EXPECT_EQ(report->num_releases, 50u);
  EXPECT_EQ(report->releases.at(5).latency_us, -1);
  EXPECT_EQ(report->releases.at(6).latency_us, -1);
  EXPECT_GE(report->lost_releases, 2u);
  for (const ModuleReport& m : report->modules)
    EXPECT_EQ(m.activations + m.failed + m.dropped, 50u) << m.name;
  EXPECT_EQ(report->modules[0].activations, 50u);  // A is not affected
  ASSERT_EQ(report->xnodes.size(), 1u);
  EXPECT_EQ(report->xnodes[0].name, "b1");
  EXPECT_GE(report->xnodes[0].hangs, 1u);
  EXPECT_NE(report->note.find("XNode 'b1' on cpu0 ran past its hang limit of 300 ms"),
            std::string::npos)
      << report->note;
}

TEST(Engine, JobsOverTheirBudgetAreCounted) {
  TestApp app;
  app.session.app.xnodes[3].wcet_us = {{"npu", 100}};
  app.session.deployment.defaults.budget_pct = 100'000'000;
  app.session.deployment.budgets_us["c1"] = 2'000;
  app.exec = [](const std::string& node, std::uint64_t k) -> Status {
    if (node == "c1" && k % 10 == 0) std::this_thread::sleep_for(3ms);
    return {};
  };
  const auto report = app.run();
  ASSERT_TRUE(report) << report.error().to_string();
  ASSERT_EQ(report->xnodes.size(), 4u);
  for (const XNodeReport& xnode : report->xnodes) {
    EXPECT_EQ(xnode.jobs, 50u);
    EXPECT_EQ(xnode.hangs, 0u);
    if (xnode.name == "c1")
      EXPECT_GE(xnode.overruns, 5u);  // a busy machine may add to them
    else
      EXPECT_EQ(xnode.overruns, 0u) << xnode.name;
  }
}

/// Asleep on a real core it keeps its chain as long as if it computed.
TEST(Engine, WhereAWorstCaseIsClaimedJobsOverTheirWcetAreCounted) {
  TestApp app;
  app.session.app.xnodes[0].wcet_us = {{"cpu", 2'000}};
  app.session.keys.emplace();
  app.session.keys->placements = {{0, {100'000}}, {1, {100'000}}, {1, {100'000}}, {1, {100'000}}};
  app.exec = [](const std::string& node, std::uint64_t k) -> Status {
    if (node == "a1" && k % 10 == 0) std::this_thread::sleep_for(3ms);
    return {};
  };
  const auto report = app.run();
  ASSERT_TRUE(report) << report.error().to_string();
  ASSERT_EQ(report->xnodes.size(), 4u);
  EXPECT_EQ(report->xnodes[0].name, "a1");
  EXPECT_EQ(report->xnodes[0].jobs, 50u);
  EXPECT_GE(report->xnodes[0].over_wcet, 5u);  // a busy machine may add to them
  EXPECT_EQ(report->xnodes[0].overruns, 0u);   // there is no budget
  EXPECT_GE(report->xnodes[0].longest_us, 3'000);
}

TEST(Engine, SourcesOfTwoPeriodsGiveEveryChainItsOwnLatency) {
  TestApp app;
  const Topic<int> slow("slow");
  app.spec.sources.push_back(
      {*detail::topic_spec(slow), Period{3000},
       [](std::uint64_t k, detail::MessageMemory*) -> std::shared_ptr<const void> {
         return std::make_shared<const int>(static_cast<int>(k));
       }});
  app.spec.modules[1]->inputs = {*detail::topic_spec(slow)};  // B
  app.session.releases.lockstep = false;
  app.session.releases.activations = 20;
  const auto report = app.run();
  ASSERT_TRUE(report) << report.error().to_string();
  ASSERT_EQ(report->account.chains.size(), 2u);
  EXPECT_EQ(report->account.chains[0].name, "camera -> C");
  EXPECT_EQ(report->account.chains[1].name, "slow -> C");
  const std::uint64_t results = report->modules[2].activations;
  EXPECT_GE(results, 1u);
  for (const ChainAccount& route : report->account.chains) {
    EXPECT_EQ(route.latency_us.count(), results);
    EXPECT_EQ(route.age_us.count(), results - 1);
  }
}

TEST(Engine, TraceTellsEveryStepOfEveryJobInOrder) {
  TestApp app;
  const auto memory = make_memory_file("trace");
  ASSERT_TRUE(memory);
  app.session.trace_fd = memory->get();
  app.session.trace_keep_s = 10;
  ASSERT_TRUE(app.run());
  const auto trace = trace::read(memory->get());
  ASSERT_TRUE(trace);
  EXPECT_EQ(trace->lost, 0u);
  std::vector<std::uint16_t> kinds;
  for (const trace::Event& event : trace->events)
    if (event.xnode == 0 && event.seq == 7) kinds.push_back(event.kind);
  EXPECT_EQ(kinds, (std::vector<std::uint16_t>{XAUTO_EV_READY, XAUTO_EV_START, XAUTO_EV_RUN,
                                               XAUTO_EV_FINISH}));
}

/// b1 is on the NPU when a2, which is more urgent, comes: the app's own functions take b1 off (a2 may
/// begin before that is done, and waits for it here), and put it back when a2 is through.
TEST(Engine, AnXpuOfTheAppsOwnIsSuspendedByItsCallbacks) {
  TestApp app;
  app.session.platform.xpus[1].preemptive = true;
  app.session.releases.activations = 20;
  std::atomic<int> running{0}, suspends{0}, resumes{0}, out_of_place{0};
  std::atomic<bool> away{false};
  app.handle = [&] {
    return SchedHandle::custom(
        [&]() -> Status {
          away.store(true);
          ++suspends;
          return {};
        },
        [&]() -> Status {
          if (away.exchange(false)) ++resumes;
          return {};
        });
  };
  const auto wait_for = [](auto&& condition) {
    const auto limit = std::chrono::steady_clock::now() + 10s;
    while (!condition() && std::chrono::steady_clock::now() < limit)
      std::this_thread::sleep_for(100us);
    return condition();
  };
  app.exec = [&](const std::string& node, std::uint64_t k) -> Status {
    const int round = static_cast<int>(k) + 1;
    if (node == "a1" && !wait_for([&] { return running.load() >= round; }))
      return fail(ErrorCode::kTimeout, "b1 never ran");
    if (node == "a2" && !wait_for([&] { return away.load(); })) ++out_of_place;
    if (node == "b1") {
      ++running;
      if (!wait_for([&] { return resumes.load() >= round; }))
        return fail(ErrorCode::kTimeout, "never resumed");
    }
    return {};
  };
  const auto report = app.run();
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_TRUE(report->complete) << report->note;
  EXPECT_EQ(report->lost_releases, 0u) << report->note;
  EXPECT_EQ(suspends.load(), 20);
  EXPECT_EQ(resumes.load(), 20);
  EXPECT_EQ(out_of_place.load(), 0) << "b1 was not taken off for a2";
}

TEST(Engine, APreemptiveXpuOfTheAppsOwnMustSayHow) {
  TestApp app;
  app.session.platform.xpus[1].preemptive = true;
  const auto report = app.run();
  ASSERT_FALSE(report);
  EXPECT_NE(report.error().hint.find("SchedHandle::custom"), std::string::npos);
}

std::function<std::shared_ptr<void>(const std::string&)> objects_with(Fates& fates) {
  return [&](const std::string& node) { return std::make_shared<Object>(node, fates); };
}

const std::vector<std::string> kAllGone = {"a1", "a2", "b1", "c1"};

TEST(Engine, WhatAnInitOwnsIsItsExecsAndGoesOnItsThreadBeforeTheRunReturns) {
  Fates fates;
  TestApp app;
  app.object = objects_with(fates);
  int left_at_end = -1;
  app.spec.on_end.emplace_back([&] { left_at_end = fates.alive; });
  const auto report = app.run();
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_EQ(app.foreign_objects.load(), 0);
  EXPECT_EQ(count(app.log(), "c1"), 50u);
  EXPECT_EQ(left_at_end, 0);  // "on the worker's thread" implies that run() has waited for it
  EXPECT_EQ(fates.sorted(), kAllGone);
}

TEST(Engine, ObjectsOfOneWorkerGoInTheReverseOrderOfTheirInits) {
  Fates fates;
  TestApp app;
  app.object = objects_with(fates);
  for (auto& placement : app.session.policy.placements) placement.xpu = 1;  // a1 and a2: one worker
  const auto report = app.run();
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_EQ(app.foreign_objects.load(), 0);
  const auto at = [&](const char* node) {
    return std::find(fates.gone.begin(), fates.gone.end(), node) - fates.gone.begin();
  };
  EXPECT_LT(at("a2"), at("a1"));
  EXPECT_EQ(fates.sorted(), kAllGone);
}

TEST(Engine, WhatWasMadeGoesWhenALaterInitThrows) {
  Fates fates;
  TestApp app;
  app.object = [&](const std::string& node) -> std::shared_ptr<void> {
    if (node == "c1") throw std::runtime_error("no weights");
    return std::make_shared<Object>(node, fates);
  };
  const auto report = app.run();
  ASSERT_FALSE(report);
  EXPECT_EQ(report.error().what, "threw: no weights");
  EXPECT_EQ(fates.sorted(), (std::vector<std::string>{"a1", "a2", "b1"}));
}

TEST(Engine, ObjectsGoWhenARunIsStoppedEarly) {
  Fates fates;
  TestApp app;
  app.object = objects_with(fates);
  app.session.releases.activations = 0;  // for ever
  std::atomic<bool> reached{false};
  app.exec = [&](const std::string& node, std::uint64_t k) -> Status {
    if (node == "c1" && k == 7) reached = true;
    return {};
  };
  app.stop_when = &reached;
  const auto report = app.run();
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_GE(count(app.log(), "c1"), 8u);
  EXPECT_EQ(fates.sorted(), kAllGone);
}

/// Commands of the management thread may still name what the object is behind: none comes once it
/// is gone.
TEST(Engine, NoSuspensionMeetsAnObjectThatIsGone) {
  Fates fates;
  std::atomic<int> calls_after{0}, calls{0};
  TestApp app;
  app.session.platform.xpus[1].preemptive = true;
  app.object = objects_with(fates);
  app.handle = [&] {
    const auto look = [&]() -> Status {
      ++calls;
      if (fates.alive.load() == 0) ++calls_after;
      return {};
    };
    return SchedHandle::custom(look, look);
  };
  std::atomic<bool> b1_runs{false};  // at the first release, when a2 comes, which is more urgent
  app.exec = [&](const std::string& node, std::uint64_t) -> Status {
    const auto until = [](const auto& holds) {
      for (int i = 0; i < 5000 && !holds(); ++i) std::this_thread::sleep_for(1ms);
    };
    if (node == "a1") until([&] { return b1_runs.load(); });
    if (node == "b1") b1_runs = true;
    // An a2 that is over at once is resumed from before anybody has suspended b1.
    if (node == "a2" || node == "b1") until([&] { return calls.load() > 0; });
    return {};
  };
  const auto report = app.run();
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_EQ(calls_after.load(), 0);
  EXPECT_GT(calls.load(), 0);
  EXPECT_EQ(fates.sorted(), kAllGone);
}

}  // namespace
}  // namespace xauto::runtime
