// SPDX-License-Identifier: Apache-2.0
#include "coord/arbiter.h"

#include <gtest/gtest.h>

#include "explorer.h"

namespace xauto::coord {
namespace {

using testing::Explored;
using testing::Explorer;
using testing::World;
using Kind = Action::Kind;

Job job(std::uint32_t xnode, std::int64_t priority, std::uint64_t sequence = 0) {
  static std::uint64_t asked = 0;
  return {xnode, sequence, key_of_priority(priority), ++asked};
}

struct Bench {
  explicit Bench(Discipline discipline, OrderPairs order = {}, int levels = 0)
      : arbiter(discipline, std::move(order), levels) {}
  std::vector<Action> take() { return std::exchange(out, {}); }
  Arbiter arbiter;
  std::vector<Action> out;
};

TEST(Arbiter, StartOfMoreUrgentJobSuspendsTheRunningOne) {
  Bench b(Discipline::kPreemptive);
  b.arbiter.start(0, job(0, 1), b.out);
  EXPECT_EQ(b.take(), (std::vector<Action>{{Kind::kGrant, 0}}));
  b.arbiter.start(1, job(1, 2), b.out);
  EXPECT_EQ(b.take(), (std::vector<Action>{{Kind::kSuspend, 0}, {Kind::kGrant, 1}}));
  b.arbiter.suspended(0, true, b.out);
  EXPECT_TRUE(b.take().empty());
  b.arbiter.finish(1, b.out);
  EXPECT_EQ(b.take(), (std::vector<Action>{{Kind::kResume, 0}}));
}

TEST(Arbiter, StartOfLessUrgentJobWaitsWithoutTouchingItsQueue) {
  Bench b(Discipline::kPreemptive);
  b.arbiter.start(0, job(0, 2), b.out);
  b.take();
  b.arbiter.start(1, job(1, 1), b.out);
  EXPECT_TRUE(b.take().empty());
  b.arbiter.finish(0, b.out);
  EXPECT_EQ(b.take(), (std::vector<Action>{{Kind::kGrant, 1}}));
}

TEST(Arbiter, AdoptedJobCountsAsRunning) {
  Bench b(Discipline::kPreemptive);
  b.arbiter.adopt(0, job(0, 1), b.out);
  EXPECT_TRUE(b.take().empty());
  b.arbiter.start(1, job(1, 2), b.out);
  EXPECT_EQ(b.take(), (std::vector<Action>{{Kind::kSuspend, 0}, {Kind::kGrant, 1}}));
}

TEST(Arbiter, FinishThatOvertakesTheSuspensionGetsItsQueueBack) {
  Bench b(Discipline::kPreemptive);
  b.arbiter.start(0, job(0, 1), b.out);
  b.arbiter.start(1, job(1, 2), b.out);
  b.take();
  b.arbiter.finish(0, b.out);
  EXPECT_TRUE(b.take().empty());
  b.arbiter.start(0, job(2, 3), b.out);  // its queue is still being suspended
  EXPECT_EQ(b.take(), (std::vector<Action>{{Kind::kSuspend, 1}}));
  b.arbiter.suspended(0, true, b.out);
  EXPECT_EQ(b.take(), (std::vector<Action>{{Kind::kResume, 0}}));
  b.arbiter.resumed(0, b.out);
  EXPECT_EQ(b.take(), (std::vector<Action>{{Kind::kGrant, 0}}));
}

TEST(Arbiter, GateLetsARunningJobEnd) {
  Bench b(Discipline::kGate);
  b.arbiter.start(0, job(0, 1), b.out);
  b.take();
  b.arbiter.start(1, job(1, 2), b.out);
  b.arbiter.start(2, job(2, 3), b.out);
  EXPECT_TRUE(b.take().empty());
  b.arbiter.finish(0, b.out);
  EXPECT_EQ(b.take(), (std::vector<Action>{{Kind::kGrant, 2}}));
}

TEST(Arbiter, EqualPrioritiesKeepTheirOrder) {
  Bench b(Discipline::kGate);
  b.arbiter.start(0, job(0, 9), b.out);
  b.arbiter.start(2, job(2, 5), b.out);
  b.arbiter.start(1, job(1, 5), b.out);
  b.take();
  b.arbiter.finish(0, b.out);
  EXPECT_EQ(b.take(), (std::vector<Action>{{Kind::kGrant, 2}}));
}

TEST(Arbiter, OrderHoldsAJobBackThoughTheXpuIsIdle) {
  for (const Discipline d : {Discipline::kPreemptive, Discipline::kGate, Discipline::kKernel}) {
    Bench b(d, {{0, 1}});
    b.arbiter.start(1, job(1, 9), b.out);
    EXPECT_TRUE(b.take().empty());
    b.arbiter.start(0, job(0, 1), b.out);
    EXPECT_EQ(b.take(), (std::vector<Action>{{Kind::kGrant, 0}}));
    b.arbiter.finish(0, b.out);
    EXPECT_EQ(b.take(), (std::vector<Action>{{Kind::kGrant, 1}}));
  }
}

TEST(Arbiter, OrderIsPerActivation) {
  Bench b(Discipline::kPreemptive, {{0, 1}});
  b.arbiter.finished(0, 4, b.out);  // activations 0..3
  b.arbiter.start(1, job(1, 9, 3), b.out);
  EXPECT_EQ(b.take(), (std::vector<Action>{{Kind::kGrant, 1}}));
  b.arbiter.finish(1, b.out);
  b.arbiter.start(1, job(1, 9, 4), b.out);
  EXPECT_TRUE(b.take().empty());
  b.arbiter.finished(0, 5, b.out);  // skipped: it will never come
  EXPECT_EQ(b.take(), (std::vector<Action>{{Kind::kGrant, 1}}));
}

TEST(Arbiter, DeathOfTheRunningWorkerLetsTheNextRun) {
  Bench b(Discipline::kPreemptive);
  b.arbiter.start(0, job(0, 1), b.out);
  b.arbiter.start(1, job(1, 2), b.out);
  b.arbiter.suspended(0, true, b.out);
  b.take();
  b.arbiter.gone(1, b.out);
  EXPECT_EQ(b.take(), (std::vector<Action>{{Kind::kResume, 0}}));
}

void expect_clean(const World& world, std::uint64_t at_least_states) {
  const Explored explored = Explorer(world).run();
  std::string trail;
  for (const std::string& step : explored.trail) trail += "\n  " + step;
  EXPECT_EQ(explored.violation, "") << trail;
  EXPECT_GE(explored.states, at_least_states);
}

TEST(Arbiter, AMoreUrgentJobIsStartedOnALevelAboveAsLongAsThereIsOne) {
  Bench b(Discipline::kLevels, {}, 2);
  b.arbiter.start(0, job(0, 1), b.out);
  EXPECT_EQ(b.take(), (std::vector<Action>{{Kind::kGrant, 0, 0}}));
  b.arbiter.start(1, job(1, 2), b.out);
  EXPECT_EQ(b.take(), (std::vector<Action>{{Kind::kGrant, 1, 1}}));
  b.arbiter.start(2, job(2, 3), b.out);
  EXPECT_TRUE(b.take().empty()) << "nothing is above the second level";
  b.arbiter.finish(1, b.out);
  EXPECT_EQ(b.take(), (std::vector<Action>{{Kind::kGrant, 2, 1}}));
  b.arbiter.start(1, job(1, 2), b.out);
  EXPECT_TRUE(b.take().empty()) << "less urgent than what runs";
  b.arbiter.finish(2, b.out);
  EXPECT_EQ(b.take(), (std::vector<Action>{{Kind::kGrant, 1, 1}})) << "job 0 has not ended";
  b.arbiter.finish(0, b.out);
  b.arbiter.start(0, job(0, 9), b.out);
  EXPECT_TRUE(b.take().empty()) << "only the lowest level is free, and what runs is not on it";
  EXPECT_TRUE(b.arbiter.settled()) << "what runs hands over, and job 0 is then on the lowest";
  b.arbiter.finish(1, b.out);
  EXPECT_EQ(b.take(), (std::vector<Action>{{Kind::kGrant, 0, 0}}));
}

constexpr Discipline kAll[] = {Discipline::kPreemptive, Discipline::kGate, Discipline::kKernel,
                               Discipline::kLevels};

TEST(ArbiterExplorer, FourJobsOfFourWorkersKeepEveryInvariant) {
  for (const Discipline d : kAll)
    expect_clean({d, {}, {{job(0, 1)}, {job(1, 2)}, {job(2, 3)}, {job(3, 4)}}, false, false, 3},
                 80);
}

TEST(ArbiterExplorer, ThreeWorkersOfTwoJobsEachWithDeathsAndRefusals) {
  for (const Discipline d : kAll)
    expect_clean({d,
                  {},
                  {{job(0, 1), job(1, 5)}, {job(2, 3), job(3, 2)}, {job(4, 4), job(5, 6)}},
                  true,
                  true,
                  2},
                 300);
}

TEST(ArbiterExplorer, OrderConstraintsWithDeathsLeaveNobodyWaiting) {
  for (const Discipline d : kAll)
    expect_clean(
        {d, {{0, 2}, {2, 1}}, {{job(0, 1), job(1, 5)}, {job(2, 9)}, {job(3, 4)}}, true, true, 2},
        100);
}

TEST(ArbiterExplorer, EqualPrioritiesKeepEveryInvariant) {
  expect_clean({Discipline::kPreemptive,
                {},
                {{job(0, 7)}, {job(1, 7)}, {job(2, 7), job(3, 7)}},
                true,
                false},
               100);
}

TEST(ArbiterExplorer, FindsTheDeadlockOfAnOrderThatContradictsTheChain) {
  // Worker 0 brings XNode 0 before XNode 1, but 0 is ordered after 1: a policy that `validate`
  // refuses.
  const Explored explored =
      Explorer({Discipline::kPreemptive, {{1, 0}}, {{job(0, 1), job(1, 2)}}, false, false}).run();
  EXPECT_EQ(explored.violation, "a job is never run: nothing can happen any more");
}

}  // namespace
}  // namespace xauto::coord
