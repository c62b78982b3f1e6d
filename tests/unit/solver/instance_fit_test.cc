// SPDX-License-Identifier: Apache-2.0
// Distribution over instances against exhaustion, with a scheduler that steps through time.
#include "solver/instance_fit.h"

#include <gtest/gtest.h>

#include "base/index.h"
#include "solver/bounds.h"
#include "solver/exact.h"
#include "solver/simulate.h"

#include "problem_random.h"

namespace xauto::solver {
namespace {

/// XNodes without edges, on `cpus` XPUs of one type.
Problem alike(const std::vector<int>& wcets, int cpus) {
  Platform platform;
  platform.name = "alike";
  for (int c = 0; c < cpus; ++c)
    platform.xpus.push_back({test::numbered("cpu", c), "cpu", true, 0, 3, -1});
  AppSpec app;
  app.name = "alike";
  for (std::size_t i = 0; i < wcets.size(); ++i) {
    XNodeSpec xnode;
    xnode.name = test::numbered("x", static_cast<int>(i));
    xnode.module = test::numbered("m", static_cast<int>(i));
    xnode.wcet_us["cpu"] = wcets[i];
    app.xnodes.push_back(std::move(xnode));
  }
  return *Problem::create(app, platform);
}

Windows open_windows(const Problem& problem) {
  const auto n = at(problem.num_xnodes);
  Windows w;
  w.r.assign(n, 0);
  w.d.assign(n, 0);
  w.types.assign(n, 1);
  w.place.assign(n, -1);
  w.extra.assign(n, 0);
  w.paid.assign(n, 0);
  w.cut.assign(n, 0);
  w.starter.assign(n, 0);
  return w;
}

/// Earliest deadline first on each instance, microsecond by microsecond.
bool in_time(const Problem& problem, const Windows& w, const std::vector<int>& on, Time end) {
  std::vector<Time> left;
  for (int i = 0; i < problem.num_xnodes; ++i) left.push_back(problem.wcet(i, 0));
  for (Time now = 0; now < end; ++now)
    for (int x = 0; x < problem.num_xpus; ++x) {
      int run = -1;
      for (int i = 0; i < problem.num_xnodes; ++i)
        if (on[at(i)] == x && left[at(i)] > 0 && w.r[at(i)] <= now &&
            (run < 0 || w.d[at(i)] < w.d[at(run)]))
          run = i;
      if (run >= 0 && --left[at(run)] == 0 && now + 1 > w.d[at(run)]) return false;
    }
  for (const Time rest : left)
    if (rest > 0) return false;
  return true;
}

TEST(InstanceFit, AgreesWithExhaustion) {
  int possible = 0, impossible = 0, decided = 0;
  for (std::uint64_t seed = 1; seed <= 600; ++seed) {
    test::Dice dice(seed);
    const int n = dice.roll(3, 7), cpus = dice.roll(1, 3);
    std::vector<int> wcets;
    for (int i = 0; i < n; ++i) wcets.push_back(dice.roll(1, 6));
    const Problem problem = alike(wcets, cpus);
    Windows w = open_windows(problem);
    for (int i = 0; i < n; ++i) {
      w.r[at(i)] = dice.roll(0, 6);
      w.d[at(i)] = w.r[at(i)] + wcets[at(i)] + dice.roll(0, 3);
    }
    if (dice.chance(50)) {
      w.place[0] = 0;
      w.place[1] = dice.roll(0, std::min(1, cpus - 1));
      ++decided;
    }
    bool exists = false;
    int ways = 1;
    for (int i = 0; i < n; ++i) ways *= cpus;
    for (int way = 0; way < ways && !exists; ++way) {
      std::vector<int> on;
      for (int i = 0, rest = way; i < n; ++i, rest /= cpus) on.push_back(rest % cpus);
      if (w.place[0] >= 0 && (on[0] == on[1]) != (w.place[0] == w.place[1])) continue;
      exists = in_time(problem, w, on, 40);
    }
    InstanceFit fit(problem);
    ASSERT_EQ(fit.possible(w, 1'000'000), exists) << seed;
    (exists ? possible : impossible) += 1;
    if (!exists) continue;
    EXPECT_TRUE(in_time(problem, w, fit.xpu(), 40)) << seed;
  }
  EXPECT_GT(possible, 100);
  EXPECT_GT(impossible, 100);
  EXPECT_GT(decided, 100);
}

TEST(InstanceFit, WithoutStepsNothingIsRefuted) {
  const Problem problem = alike({3, 3, 3, 3}, 3);
  Windows w = open_windows(problem);
  w.d.assign(4, 4);
  InstanceFit fit(problem);
  EXPECT_FALSE(fit.possible(w, 1000));
  EXPECT_TRUE(fit.possible(w, 2));
  EXPECT_EQ(fit.xpu(), std::vector<int>(4, -1));
}

TEST(InstanceFit, AProofKnowsThatXNodesDoNotMoveBetweenCpus) {
  // Four times 3 us on three CPUs: 4 us if XNodes could move from one to another.
  const Problem problem = alike({3, 3, 3, 3}, 3);
  EXPECT_EQ(quick_bound(problem), 4);
  const std::atomic<Time> incumbent{6};
  ProofControl control;
  control.incumbent = &incumbent;
  EXPECT_EQ(prove_bound(problem, control), 6);
}

TEST(InstanceFit, AProofThatMeetsAPolicyTellsIt) {
  const Problem problem = alike({5, 4, 3, 3, 3}, 2);
  std::atomic<Time> incumbent{18};
  Solution best;
  ProofControl control;
  control.incumbent = &incumbent;
  control.on_solution = [&](const Solution& solution) {
    EXPECT_LT(solution.makespan, incumbent.load());
    EXPECT_EQ(simulate(problem, to_decision(solution)).makespan, solution.makespan);
    best = solution;
    incumbent = solution.makespan;
  };
  EXPECT_EQ(prove_bound(problem, control), 9);
  EXPECT_EQ(best.makespan, 9);
}

}  // namespace
}  // namespace xauto::solver
