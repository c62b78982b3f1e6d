// SPDX-License-Identifier: Apache-2.0
// ROS 2's executors, played: each expectation is worked out by hand from rclcpp's rules.
#include "solver/executors.h"

#include <algorithm>

#include <gtest/gtest.h>

namespace xauto::solver {
namespace {

/// Timers and subscriptions of one executor.
struct Scene {
  ImportedApp made;

  Scene(ExecutorKind kind, int threads, std::int64_t duration_ms) {
    made.app.name = "scene";
    made.seen.from = "a test";
    made.seen.duration_us = duration_ms * 1000;
    made.seen.cores = 8;
    made.seen.executors.push_back({"executor", kind, threads, {}});
  }
  int xnode(const std::string& name, std::int64_t ms, bool own_group = true) {
    const int x = static_cast<int>(made.app.xnodes.size());
    made.app.xnodes.push_back({name, name, {{"cpu", ms * 1000}}});
    made.seen.xnodes.push_back({{ms * 1000}});
    auto& groups = made.seen.executors[0].groups;
    if (own_group || groups.empty()) groups.emplace_back();
    groups.back().xnodes.push_back(x);
    return x;
  }
  int timer(const std::string& name, std::int64_t ms, std::int64_t period_ms,
            std::int64_t offset_ms = 0, bool own_group = true) {
    const int x = xnode(name, ms, own_group);
    made.app.xnodes[static_cast<std::size_t>(x)].sources = {
        static_cast<int>(made.app.sources.size())};
    made.app.sources.push_back({name + "/tick", {period_ms * 1000, 1}, offset_ms * 1000});
    return x;
  }
  int subscription(const std::string& name, std::int64_t ms, int from, bool own_group = true) {
    const int x = xnode(name, ms, own_group);
    made.app.edges.emplace_back(from, x);
    return x;
  }
  /// "A0 B4": who began when, in ms.
  std::string order() {
    std::string text;
    for (const RanJob& job : play_executors(made).jobs)
      text += (text.empty() ? "" : " ") +
              made.app.xnodes[static_cast<std::size_t>(job.xnode)].name +
              std::to_string(job.start_ns / 1'000'000);
    return text;
  }
};

TEST(Executors, ALookHasTimersBeforeSubscriptionsAndIsWorkedOff) {
  Scene s(ExecutorKind::kSingleThreaded, 1, 20);
  const int a = s.timer("A", 2, 100);
  s.subscription("s", 3, a);
  s.timer("B", 4, 100, 1);  // ready while A runs
  // At 2 A's message and B are ready: the look at 2 has B first, though the message came earlier or at once.
  EXPECT_EQ(s.order(), "A0 B2 s6");
}

TEST(Executors, WhatComesDuringALookWaitsForTheNextHoweverUrgent) {
  Scene s(ExecutorKind::kSingleThreaded, 1, 30);
  const int a = s.timer("A", 2, 100);
  s.subscription("s", 3, a);
  const int b = s.timer("B", 2, 100, 0);
  s.subscription("t", 3, b);
  s.timer("C", 1, 100, 5);  // ready at 5, while s runs
  // Look at 0: A, B. At 4: s and t. C is ready at 5, but t was seen before: then C.
  EXPECT_EQ(s.order(), "A0 B2 s4 t7 C10");
}

TEST(Executors, TheStaticOneHasSubscriptionsFirst) {
  Scene s(ExecutorKind::kStaticSingleThreaded, 1, 20);
  const int a = s.timer("A", 2, 100);
  s.subscription("s", 3, a);
  s.timer("B", 4, 100, 1);
  EXPECT_EQ(s.order(), "A0 s2 B5");
}

TEST(Executors, TheEventsOneIsAQueue) {
  Scene s(ExecutorKind::kEvents, 1, 30);
  const int a = s.timer("A", 2, 100);
  s.subscription("s", 3, a);
  s.timer("B", 4, 100, 1);  // before A's message
  s.timer("C", 1, 100, 3);  // after it
  EXPECT_EQ(s.order(), "A0 B2 s6 C9");
}

TEST(Executors, OfAGroupOneRunsAtATimeOnHoweverManyThreads) {
  Scene s(ExecutorKind::kMultiThreaded, 4, 20);
  s.timer("A", 5, 100);
  s.timer("B", 5, 100, 0, false);  // A's group
  s.timer("C", 5, 100);
  EXPECT_EQ(s.order(), "A0 C0 B5");
  s.made.seen.executors[0].groups[0].reentrant = true;
  EXPECT_EQ(s.order(), "A0 B0 C0");
}

TEST(Executors, NoMoreRunAtOnceThanThreadsOrCores) {
  Scene s(ExecutorKind::kMultiThreaded, 2, 20);
  s.timer("A", 5, 100);
  s.timer("B", 5, 100);
  s.timer("C", 5, 100);
  EXPECT_EQ(s.order(), "A0 B0 C5");
  s.made.seen.executors[0].threads = 3;
  s.made.seen.cores = 1;
  EXPECT_EQ(s.order(), "A0 B5 C10");
}

TEST(Executors, ATimerThatIsLateSkipsWhatHasPassed) {
  Scene s(ExecutorKind::kSingleThreaded, 1, 60);
  s.timer("L", 35, 1000);
  s.timer("A", 1, 10);
  // A is due at 0, 10, 20, 30 while L runs: one call at 35, then at 40, 50, 60.
  EXPECT_EQ(s.order(), "L0 A35 A40 A50 A60");
  EXPECT_EQ(play_executors(s.made).skipped, 3);
}

TEST(Executors, AFullQueueLosesItsOldest) {
  Scene s(ExecutorKind::kMultiThreaded, 2, 40);
  const int a = s.timer("A", 1, 10);
  s.subscription("s", 25, a);
  s.made.seen.xnodes[1].depth = 1;
  const ExecutedRun run = play_executors(s.made);
  // Messages at 1, 11, 21, 31; s runs from 1 to 26, then with the one of 21.
  EXPECT_EQ(run.lost, 1);
  ASSERT_GE(run.jobs.size(), 5u);
  const RanJob& second = *std::find_if(run.jobs.begin(), run.jobs.end(), [](const RanJob& j) {
    return j.xnode == 1 && j.start_ns > 1'000'000;
  });
  EXPECT_EQ(second.start_ns, 26'000'000);
  EXPECT_EQ(run.jobs[static_cast<std::size_t>(second.from)].start_ns, 20'000'000);
}

TEST(Executors, ReactionsAreThoseOfWhoKnowsTheRelease) {
  Scene s(ExecutorKind::kMultiThreaded, 4, 100);
  const int a = s.timer("A", 1, 10);
  const int b = s.timer("B", 2, 20, 5);
  s.made.app.samples = {{a, b}};
  s.made.app.chains = {{"chain", 0, b}};
  const ExecutedRun run = play_executors(s.made);
  const auto times = reaction_times(s.made.app, run.jobs, run.releases);
  // B begins at 5, 25, 45, ... and knows A's release of 0, 20, 40, ...; that of 10 is known with 20's.
  ASSERT_GE(times[0].size(), 5u);
  EXPECT_EQ(times[0][0], 7'000'000);
  EXPECT_EQ(times[0][1], 17'000'000);
  EXPECT_EQ(times[0][2], 7'000'000);
  EXPECT_EQ(times[0][3], 17'000'000);
}

}  // namespace
}  // namespace xauto::solver
