// SPDX-License-Identifier: Apache-2.0
// The shared-memory protocol, exhaustively: never two owners of a gate, the most urgent job runs or
// is being resumed, no wake-up is lost, every suspension ends, whoever dies at whatever access.
#include <algorithm>
#include <array>
#include <cstdlib>

#include <gtest/gtest.h>

#include "protocol_explorer.h"

namespace xauto::coord {
namespace {

using testing::ProtocolExplorer;
using testing::ProtocolResult;
using testing::ProtocolWorld;

ProtocolWorld::Task task(std::uint32_t xnode, std::int64_t priority, int xpu = 0) {
  return {xpu, {xnode, 0, key_of_priority(priority)}};
}

ProtocolResult expect_clean(const ProtocolWorld& world, std::uint64_t at_least_states) {
  const ProtocolResult result = ProtocolExplorer(world).run();
  std::string trail;
  for (const std::string& step : result.trail) trail += "\n  " + step;
  EXPECT_EQ(result.violation, "") << trail;
  EXPECT_TRUE(result.complete) << "more than " << world.limit << " states";
  EXPECT_GE(result.states, at_least_states);
  ::testing::Test::RecordProperty("states", std::to_string(result.states));
  if (std::getenv("XAUTO_EXPLORER_STATES") != nullptr)
    std::printf("%lu states, %lu steps\n", static_cast<unsigned long>(result.states),
                static_cast<unsigned long>(result.steps));
  return result;
}

constexpr Discipline kBoth[] = {Discipline::kPreemptive, Discipline::kGate};
constexpr Discipline kAsked[] = {Discipline::kPreemptive, Discipline::kGate, Discipline::kLevels};

bool full() {
  return std::getenv("XAUTO_EXPLORER_FULL") != nullptr;
}
/// Worth a minute: XAUTO_FULL=1, as `make check-full` has it. Worth hours: XAUTO_EXPLORER_FULL=1.
bool long_ones() {
  return std::getenv("XAUTO_FULL") != nullptr || full();
}

/// The explorer has one thread and no pointers of its own worth watching: under a sanitizer, which
/// makes it a hundred times slower, small worlds do.
#if defined(__SANITIZE_THREAD__) || defined(__SANITIZE_ADDRESS__)
constexpr bool kSmallOnly = true;
#else
constexpr bool kSmallOnly = false;
#endif

ProtocolWorld world(std::vector<Discipline> xpus,
                    std::vector<std::vector<ProtocolWorld::Task>> modules) {
  ProtocolWorld w;
  w.xpus = std::move(xpus);
  w.modules = std::move(modules);
  return w;
}

// Every access of everybody is a step.

TEST(Protocol, TwoJobsEveryAccessWithTheDeathOfAWorkerAnywhere) {
  for (const Discipline d : kAsked) {
    ProtocolWorld w = world({d}, {{task(0, 1)}, {task(2, 3)}});
    w.deaths = 1;
    expect_clean(w, 5000);
  }
}

TEST(Protocol, TwoJobsEveryAccessWithSuspensionsThatFail) {
  ProtocolWorld w = world({Discipline::kPreemptive}, {{task(0, 1)}, {task(2, 3)}});
  w.may_refuse = true;
  expect_clean(w, 1000);
}

TEST(Protocol, ThreeJobsEveryAccessOnAGate) {
  expect_clean(world({Discipline::kGate}, {{task(0, 1)}, {task(1, 3)}, {task(2, 2)}}), 4000);
}

/// Where there are three levels all may have started; where there are two the third waits for one.
TEST(Protocol, ThreeJobsOnLevels) {
  for (const int levels : {2, 3}) {
    if (levels == 3 && !kSmallOnly && !long_ones()) continue;
    ProtocolWorld w = world({Discipline::kLevels}, {{task(0, 1)}, {task(1, 3)}, {task(2, 2)}});
    w.levels = levels;
    w.coarse = !full();
    w.deaths = levels == 3 || kSmallOnly ? 0 : 1;
    w.coordinator_deaths = levels == 3 && !kSmallOnly ? 1 : 0;
    w.limit = 400'000'000;
    expect_clean(w, 1000);
  }
}

/// Each above the one before it, and one down with each FINISH. A START that does not look on which level the owner
/// is shows in it after a tenth of a second.
TEST(Protocol, ThreeJobsAboveOneAnotherOnLevels) {
  ProtocolWorld w = world({Discipline::kLevels}, {{task(0, 3)}, {task(1, 2)}, {task(2, 1)}});
  w.levels = 3;
  w.coarse = true;
  w.limit = 400'000'000;
  expect_clean(w, 1000);
}

TEST(Protocol, EveryAccessWithTheDeathOfTheCoordinatorAnywhere) {
  if (!full()) GTEST_SKIP() << "millions of states: XAUTO_EXPLORER_FULL=1";
  for (const Discipline d : kAsked) {
    ProtocolWorld w = world({d}, {{task(0, 1)}, {task(2, 3)}});
    w.coordinator_deaths = 1;
    w.limit = 200'000'000;
    expect_clean(w, 100'000);
  }
}

TEST(Protocol, ThreeJobsEveryAccessPreemptive) {
  if (!full()) GTEST_SKIP() << "millions of states: XAUTO_EXPLORER_FULL=1";
  ProtocolWorld w = world({Discipline::kPreemptive}, {{task(0, 1)}, {task(1, 3)}, {task(2, 2)}});
  w.limit = 400'000'000;
  expect_clean(w, 100'000);
}

// Every access of the workers is a step, each look of the coordinator is one.

/// One that parks while the XPU is taken is heard of after it is given back. The whole world has a
/// million states, a protocol that forgets it breaks in the first 12,000. The priorities were chosen
/// for that fault: three of the six orders show it within 250,000 states, this one soonest. So a
/// world without a fault in these states says nothing of other faults; the long worlds do.
TEST(Protocol, WhoParksWhileAnXpuIsTakenIsNotForgotten) {
  ProtocolWorld w = world({Discipline::kPreemptive}, {{task(0, 3)}, {task(1, 2)}, {task(2, 1)}});
  w.coarse = true;
  w.limit = kSmallOnly ? 20'000 : 100'000;
  const ProtocolResult result = ProtocolExplorer(w).run();
  EXPECT_EQ(result.violation, "");
  EXPECT_GE(result.states, w.limit);
}

TEST(Protocol, ThreeJobsOnOneXpuWithADeath) {
  for (const Discipline d : kAsked) {
    if (d == Discipline::kPreemptive && (kSmallOnly || !long_ones())) continue;
    ProtocolWorld w = world({d}, {{task(0, 1)}, {task(1, 3)}, {task(2, 2)}});
    w.coarse = true;
    w.deaths = 1;
    w.limit = 10'000'000;
    expect_clean(w, 20'000);
  }
}

TEST(Protocol, ThreeJobsOnOneXpuWithDeathsOfAWorkerAndOfTheCoordinator) {
  for (const Discipline d : kAsked) {
    if ((d == Discipline::kPreemptive && !full()) || kSmallOnly) continue;
    if (d == Discipline::kLevels && !long_ones()) continue;
    ProtocolWorld w = world({d}, {{task(0, 1)}, {task(1, 3)}, {task(2, 2)}});
    w.coarse = true;
    w.deaths = w.coordinator_deaths = 1;
    w.limit = 400'000'000;
    expect_clean(w, 100'000);
  }
}

TEST(Protocol, TwoJobsOnTwoXpusWithDeaths) {
  for (const Discipline d : kAsked)
    for (const int first : {0, 1}) {
      if (first == 0 && kSmallOnly) continue;
      ProtocolWorld w = world(
          {d, d}, {{task(0, 1, 0), task(1, 4, 1)}, {task(2, 3, first), task(3, 2, 1 - first)}});
      w.coarse = true;
      w.deaths = 1;
      expect_clean(w, 1000);
    }
}

/// A chain of two XNodes, on XPU `first` and then on the other one, as one activation of it after the
/// other comes; `keys`: of its two XNodes, from their nominal release on.
std::vector<ProtocolWorld::Task> activations(std::uint32_t xnode, int first,
                                             std::array<Key, 2> keys,
                                             const std::vector<std::uint64_t>& releases) {
  constexpr Key kPeriod = 3;
  std::vector<ProtocolWorld::Task> tasks;
  for (const std::uint64_t k : releases)
    for (const int i : {0, 1}) {
      const Key key = static_cast<Key>(k) * kPeriod + keys[static_cast<std::size_t>(i)];
      tasks.push_back({(first + i) % 2, {xnode + static_cast<std::uint32_t>(i), k, key}});
    }
  return tasks;
}

// A policy of keys whose releases overlap: a module has releases 0 and 1 in flight, a worker for each.

TEST(Protocol, TwoReleasesInFlightOnTwoXpusWithDeaths) {
  for (const Discipline d : kBoth)
    for (const std::array<Key, 2> keys : {std::array<Key, 2>{2, 5}, std::array<Key, 2>{1, 3}}) {
      const bool smaller = keys[0] == 1;
      if (kSmallOnly && (d == Discipline::kPreemptive || smaller)) continue;
      if (d == Discipline::kPreemptive && smaller && !long_ones()) continue;
      ProtocolWorld w = world({d, d}, {activations(0, 0, keys, {0}), activations(0, 0, keys, {1})});
      w.coarse = true;
      w.deaths = 1;
      w.coordinator_deaths = full() ? 1 : 0;
      w.limit = 100'000'000;
      expect_clean(w, 1000);
    }
}

/// Another module's chain meets them, the same way or the other way round.
TEST(Protocol, TwoReleasesInFlightMeetAnotherModules) {
  for (const Discipline d : kBoth)
    for (const int first : {0, 1}) {
      if (kSmallOnly || (d == Discipline::kPreemptive && !full())) continue;
      ProtocolWorld w =
          world({d, d}, {activations(0, 0, {2, 5}, {0}), activations(0, 0, {2, 5}, {1}),
                         activations(2, first, {3, 6}, {0})});
      w.coarse = true;
      w.deaths = full() ? 1 : 0;
      w.limit = 400'000'000;
      expect_clean(w, 10'000);
    }
}

TEST(Protocol, WorkersThatBringSeveralJobs) {
  for (const Discipline d : kAsked) {
    if (d == Discipline::kPreemptive && kSmallOnly) continue;
    ProtocolWorld w = world({d}, {{task(0, 1), task(1, 4)}, {task(2, 3), task(3, 2)}});
    w.coarse = true;
    expect_clean(w, 1000);
  }
}

/// One that is given back is taken again, at any moment until it runs.
ProtocolWorld taken_twice() {
  ProtocolWorld w = world({Discipline::kPreemptive}, {{task(0, 1)}, {task(2, 3), task(3, 2)}});
  w.coarse = true;
  return w;
}

TEST(Protocol, OneThatIsBeingResumedIsTakenFromAgain) {
  ProtocolWorld w = taken_twice();
  w.may_refuse = true;
  expect_clean(w, 500);
  w.may_refuse = false;
  w.deaths = 1;
  w.coordinator_deaths = long_ones() ? 1 : 0;
  expect_clean(w, 1000);
}

/// Modules in the order in which this fault shows soonest: after 17,517 states.
TEST(Protocol, TheExplorerFindsOneThatIsTakenFromBeforeItIsToldToResume) {
  ProtocolWorld w = world({Discipline::kPreemptive}, {{task(0, 3)}, {task(1, 1)}, {task(2, 2)}});
  w.coarse = true;
  w.blind_taking = true;
  w.limit = 50'000;
  EXPECT_NE(ProtocolExplorer(w).run().violation, "");
}

TEST(Protocol, OrderConstraintsHoldAndNobodyWaitsForTheDead) {
  for (const Discipline d :
       {Discipline::kPreemptive, Discipline::kGate, Discipline::kLevels, Discipline::kKernel}) {
    ProtocolWorld w = world({d}, {{task(0, 1)}, {task(1, 9)}});
    if (full()) w.modules.push_back({task(2, 4)});
    w.limit = 400'000'000;
    w.order = {{0, 1}};
    w.coarse = true;
    w.deaths = 1;
    w.coordinator_deaths = kSmallOnly ? 0 : 1;
    expect_clean(w, 100);
  }
}

// Pairs of a policy's order: the FINISH of the first grants the second.

constexpr Discipline kAll[] = {Discipline::kPreemptive, Discipline::kGate, Discipline::kLevels,
                               Discipline::kKernel};

ProtocolWorld ordered(Discipline d, OrderPairs order,
                      std::vector<std::vector<ProtocolWorld::Task>> modules) {
  ProtocolWorld w = world({d}, std::move(modules));
  w.order = std::move(order);
  w.coarse = true;
  return w;
}
ProtocolWorld::Task lost(std::uint32_t xnode, std::uint64_t release) {
  return {0, {xnode, release, key_of_priority(1)}, true};
}
ProtocolWorld::Task release(std::uint32_t xnode, std::int64_t priority, std::uint64_t number) {
  return {0, {xnode, number, key_of_priority(priority)}};
}

TEST(Protocol, APairEveryAccess) {
  for (const Discipline d : kAll) {
    ProtocolWorld w = ordered(d, {{0, 1}}, {{task(0, 1)}, {task(1, 9)}});
    w.coarse = false;
    w.deaths = kSmallOnly || (d == Discipline::kPreemptive && !long_ones()) ? 0 : 1;
    expect_clean(w, 100);
  }
}

/// Of three, all ways where they are few, and else some of them.
void expect_some_clean(const ProtocolWorld& world) {
  const Discipline d = world.xpus.front();
  if (d == Discipline::kKernel || (d == Discipline::kGate && world.deaths == 0) || full()) {
    expect_clean(world, 100);
    return;
  }
  const ProtocolResult result = ProtocolExplorer(world).walk(kSmallOnly ? 200 : 1'000, 1);
  std::string trail;
  for (const std::string& step : result.trail) trail += "\n  " + step;
  EXPECT_EQ(result.violation, "") << trail;
}

/// Whoever comes between the two goes before the second, or after it, or waits for the first.
TEST(Protocol, APairAndAThird) {
  for (const Discipline d : kAll)
    for (const std::int64_t third : {0, 5, 10}) {
      ProtocolWorld w = ordered(d, {{0, 1}}, {{task(0, 1)}, {task(1, 9)}, {task(2, third)}});
      w.limit = 400'000'000;
      expect_some_clean(w);
      w.deaths = 1;
      if (d != Discipline::kPreemptive || !full()) expect_some_clean(w);
    }
}

/// Two wait for one, one waits for two, and each waits for the one before.
TEST(Protocol, SeveralPairs) {
  for (const Discipline d : kAll)
    for (const OrderPairs& order :
         {OrderPairs{{0, 1}, {0, 2}}, OrderPairs{{0, 2}, {1, 2}}, OrderPairs{{0, 1}, {1, 2}}}) {
      ProtocolWorld w = ordered(d, order, {{task(0, 1)}, {task(1, 3)}, {task(2, 2)}});
      w.limit = 400'000'000;
      expect_some_clean(w);
    }
}

TEST(Protocol, APairOfTwoReleases) {
  for (const Discipline d : kAll) {
    if (d == Discipline::kPreemptive && kSmallOnly) continue;
    ProtocolWorld w = ordered(
        d, {{0, 1}}, {{release(0, 1, 0), release(0, 1, 1)}, {release(1, 9, 0), release(1, 9, 1)}});
    w.deaths = d == Discipline::kPreemptive && !long_ones() ? 0 : 1;
    expect_clean(w, 100);
  }
}

/// Who waits for a release that is lost goes on, at once if it is the most urgent.
TEST(Protocol, APairWhoseFirstIsLost) {
  for (const Discipline d : kAll) {
    for (const std::int64_t third : {5, 10}) {
      ProtocolWorld w = ordered(d, {{0, 1}}, {{lost(0, 0)}, {task(1, 9)}, {task(2, third)}});
      w.deaths = d == Discipline::kPreemptive && !long_ones() ? 0 : 1;
      expect_clean(w, 100);
    }
    // Every access: the second is lost while the coordinator looks at what the first one changed.
    ProtocolWorld w = ordered(d, {{0, 1}}, {{lost(0, 0), lost(0, 1)}, {release(1, 9, 1)}});
    w.coarse = false;
    expect_clean(w, 100);
  }
}

/// Modules in the order in which this fault shows soonest.
TEST(Protocol, TheExplorerFindsAFollowerThatIsGrantedEarly) {
  for (const Discipline d : kAll) {
    ProtocolWorld w = ordered(d, {{0, 1}}, {{task(1, 9)}, {task(2, 5)}, {task(0, 1)}});
    if (d == Discipline::kKernel) w.order.emplace_back(2, 1);  // nobody else grants there
    w.blind_finish = true;
    w.limit = 1'000;
    EXPECT_NE(ProtocolExplorer(w).run().violation, "");
  }
}

TEST(Protocol, TheExplorerFindsAFollowerThatIsNeverGranted) {
  for (const Discipline d : kAll) {
    ProtocolWorld w = ordered(d, {{0, 1}}, {{task(0, 1)}, {task(1, 9)}});
    w.limit = 10'000;
    w.look_once = true;
    EXPECT_NE(ProtocolExplorer(w).run().violation, "");
    w.look_once = false;
    w.lose_wakes = true;
    EXPECT_NE(ProtocolExplorer(w).run().violation, "");
  }
}

/// The least urgent may become the most urgent at any moment, also while others take the XPU from it,
/// give it back, or come; and what is lent to a job is not lent to the next one of its worker.
TEST(Protocol, AKeyThatIsLentDecidesAndEndsWithItsJob) {
  for (const Discipline d : kBoth) {
    ProtocolWorld w = world({d}, {{task(0, 1), task(0, 1)}, {task(2, 3)}});
    w.lends = key_of_priority(9);
    w.coarse = true;
    w.deaths = long_ones() ? 1 : 0;
    expect_clean(w, 1000);
    w = world({d}, {{task(0, 1)}, {task(2, 3)}});
    w.lends = key_of_priority(9);
    w.coarse = true;
    w.deaths = 1;
    expect_clean(w, 1000);
    if (d == Discipline::kPreemptive && (kSmallOnly || !long_ones())) continue;
    w = world({d}, {{task(0, 1)}, {task(1, 3)}, {task(2, 2)}});
    w.lends = key_of_priority(9);
    w.coarse = true;
    w.limit = 20'000'000;
    expect_clean(w, 10'000);
  }
}

/// Among three, whatever the order: too many ways for all of them.
TEST(Protocol, AKeyThatIsLentAmongThree) {
  std::array<std::int64_t, 3> order{1, 2, 3};
  do {
    ProtocolWorld w =
        world({Discipline::kPreemptive},
              {{task(0, 2 * order[0])}, {task(1, 2 * order[1])}, {task(2, 2 * order[2])}});
    w.coarse = true;
    for (const int lent : {5, 7}) {
      w.lends = key_of_priority(lent);
      const ProtocolResult result = ProtocolExplorer(w).walk(kSmallOnly ? 200 : 2'000, 1);
      EXPECT_EQ(result.violation, "");
    }
  } while (std::next_permutation(order.begin(), order.end()));
}

TEST(Protocol, TwoJobsEveryAccessWhenKeysAreLent) {
  if (!long_ones()) GTEST_SKIP() << "the coordinator's accesses, too: XAUTO_FULL=1";
  for (const Discipline d : kBoth) {
    if (d == Discipline::kPreemptive && !full()) continue;
    ProtocolWorld w = world({d}, {{task(0, 1)}, {task(2, 3)}});
    w.lends = key_of_priority(9);
    w.limit = 400'000'000;
    expect_clean(w, 5000);
  }
}

// Runs that are not trusted: module 0 is of one.

ProtocolWorld::Task with_key(std::uint32_t xnode, Key key) {
  return {0, {xnode, 0, key}};
}

/// `keys`: of the jobs of module 0, which come one after the other, and of one job of each other module.
ProtocolWorld not_trusted(const std::vector<Key>& keys, std::size_t jobs = 1) {
  ProtocolWorld w = world({Discipline::kPreemptive}, {{}});
  for (std::size_t i = 0; i < jobs; ++i) w.modules[0].push_back(with_key(0, keys[0]));
  for (std::uint32_t m = 1; m < keys.size(); ++m) w.modules.push_back({with_key(m, keys[m])});
  w.regulated = {true};
  return w;
}

TEST(Protocol, WhoIsNotTrustedIsOffItsXpuWhenItsBudgetIsSpent) {
  for (const Key other : {10, 90}) {
    ProtocolWorld w = not_trusted({50, other}, 2);
    w.cuts = 2;
    w.coarse = !long_ones();
    w.deaths = kSmallOnly ? 0 : 1;
    expect_clean(w, 500);
  }
}

/// Two that are trusted, one of them more urgent: it may come while the other one takes, gives back, or waits.
TEST(Protocol, WhoIsNotTrustedBetweenTwoThatAre) {
  for (const std::vector<Key>& keys : {std::vector<Key>{50, 10, 90}, {10, 50, 90}, {90, 10, 50}}) {
    ProtocolWorld w = not_trusted(keys);
    w.cuts = 1;
    w.coarse = true;
    w.limit = 20'000'000;
    if (long_ones()) {
      expect_clean(w, 10'000);
      continue;
    }
    const ProtocolResult result = ProtocolExplorer(w).walk(kSmallOnly ? 200 : 2'000, 1);
    EXPECT_EQ(result.violation, "");
  }
}

TEST(Protocol, TwoThatAreNotTrusted) {
  ProtocolWorld w = not_trusted({50, 40, 45});
  w.regulated = {true, true, false};
  w.cuts = 2;
  w.coarse = true;
  w.limit = 20'000'000;
  expect_clean(w, 1'000);
}

/// It writes into its page what it likes, whenever it likes, and may have the XPU for its budget: the job of who is
/// trusted is run to its end.
TEST(Protocol, WhateverIsWrittenIntoAPageOthersGoOn) {
  for (const Key other : {10, 90}) {
    ProtocolWorld w = not_trusted({50, other}, long_ones() ? 2 : 1);
    w.forged = long_ones() ? 2 : 1;
    w.cuts = 8;
    w.coarse = true;
    w.deaths = long_ones() ? 1 : 0;
    w.limit = 20'000'000;
    expect_clean(w, 1'000);
  }
}

TEST(Protocol, TheExplorerFindsABudgetThatNobodyLooksAt) {
  ProtocolWorld w = not_trusted({50, 90});
  w.cuts = 1;
  w.coarse = true;
  w.lose_alarm = true;
  EXPECT_NE(ProtocolExplorer(w).run().violation, "");
}

TEST(Protocol, TheExplorerFindsACoreThatIsNotTaken) {
  for (const Key other : {10, 90}) {
    ProtocolWorld w = not_trusted({50, other});
    w.cuts = other == 90 ? 1 : 0;
    w.coarse = true;
    w.lose_take = true;
    EXPECT_NE(ProtocolExplorer(w).run().violation, "");
  }
}

/// The coordinator gives up after one round, where something was missed; then it has to look again.
ProtocolWorld impatient(Discipline d) {
  ProtocolWorld w = world({d}, {{task(0, 1)}, {task(2, 3)}});
  w.max_rounds = 1;
  return w;
}

TEST(Protocol, ACoordinatorThatGivesUpLooksAgain) {
  for (const Discipline d : kAsked) expect_clean(impatient(d), 100);
}

TEST(Protocol, TheExplorerFindsALookThatIsNotTakenAgain) {
  int found = 0;
  for (const Discipline d : kAsked) {
    ProtocolWorld w = impatient(d);
    w.lose_again = true;
    found += ProtocolExplorer(w).run().violation.empty() ? 0 : 1;
  }
  EXPECT_GT(found, 0);
}

TEST(Protocol, TheExplorerFindsALostWakeUp) {
  for (const Discipline d : kAsked) {
    ProtocolWorld w = world({d}, {{task(0, 1)}, {task(2, 3)}});
    w.lose_wakes = true;
    EXPECT_NE(ProtocolExplorer(w).run().violation, "");
  }
}

}  // namespace
}  // namespace xauto::coord
