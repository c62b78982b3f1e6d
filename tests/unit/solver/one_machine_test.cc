// SPDX-License-Identifier: Apache-2.0
// What one instance allows, against all schedules of it.
#include "solver/one_machine.h"

#include <algorithm>
#include <atomic>
#include <vector>

#include <gtest/gtest.h>

#include "base/index.h"
#include "solver/exact.h"

#include "brute_force.h"
#include "problem_random.h"

namespace xauto::solver {
namespace {

/// Can all be done in their windows on one preemptive instance? Earliest deadline first, microsecond
/// by microsecond.
bool in_time_on_one(const std::vector<Time>& work, const std::vector<Time>& r,
                    const std::vector<Time>& d) {
  std::vector<Time> left = work;
  for (Time now = 0; now < 80; ++now) {
    int run = -1;
    for (std::size_t i = 0; i < left.size(); ++i)
      if (left[i] > 0 && r[i] <= now && (run < 0 || d[i] < d[at(run)])) run = static_cast<int>(i);
    if (run >= 0 && --left[at(run)] == 0 && now + 1 > d[at(run)]) return false;
  }
  return std::all_of(left.begin(), left.end(), [](Time rest) { return rest == 0; });
}

/// `inside` XNodes of a GPU, each between one that comes before it and one that comes after it, on
/// the CPU. The last one of the GPU may also go to the CPU.
struct Sandwich {
  Problem problem;
  Windows w;
  std::vector<Time> work, r, d;  ///< of those inside
};

Sandwich sandwich(test::Dice& dice, int inside) {
  Platform platform;
  platform.name = "two";
  platform.xpus = {{"cpu0", "cpu", true, 0, 0, -1}, {"gpu0", "gpu", true, 0, 0, -1}};
  AppSpec app;
  app.name = "sandwich";
  Sandwich s;
  for (int i = 0; i < inside; ++i) {
    s.work.push_back(dice.roll(1, 6));
    app.xnodes.push_back({test::numbered("x", i), "m", {{"gpu", s.work.back()}}});
    app.xnodes.push_back({test::numbered("before", i), "m", {{"cpu", 1}}});
    app.xnodes.push_back({test::numbered("after", i), "m", {{"cpu", 1}}});
    app.edges.emplace_back(3 * i + 1, 3 * i);
    app.edges.emplace_back(3 * i, 3 * i + 2);
  }
  app.xnodes[at(3 * (inside - 1))].wcet_us["cpu"] = 1;
  s.problem = *Problem::create(app, platform);
  const auto n = app.xnodes.size();
  const int gpu = s.problem.type_name[0] == "gpu" ? 0 : 1;
  Windows& w = s.w;
  w.r.assign(n, 0);
  w.d.assign(n, 80);
  w.types.assign(n, TypeSet{1} << (1 - gpu));
  w.place.assign(n, -1);
  for (auto* times : {&w.extra, &w.paid, &w.cut}) times->assign(n, 0);
  w.starter.assign(n, 0);
  for (int i = 0; i < inside; ++i) {
    const std::size_t x = at(3 * i);
    w.types[x] = TypeSet{1} << gpu;
    w.r[x] = dice.roll(20, 28);  // the CPU has room for all others before and after
    w.d[x] = w.r[x] + s.work[at(i)] + dice.roll(0, 8);
    s.r.push_back(w.r[x]);
    s.d.push_back(w.d[x]);
  }
  return s;
}

TEST(OneMachine, SaysExactlyWhatSchedulesOfOneInstanceAllow) {
  int impossible = 0, narrowed = 0;
  for (std::uint64_t seed = 1; seed <= 4000; ++seed) {
    test::Dice dice(seed);
    const int inside = dice.roll(2, 6);
    Sandwich s = sandwich(dice, inside);
    OneMachine machine(s.problem);
    const OneMachine::Answer answer = machine.narrow(s.w);
    ASSERT_EQ(answer != OneMachine::Answer::kImpossible, in_time_on_one(s.work, s.r, s.d)) << seed;
    if (answer == OneMachine::Answer::kImpossible) {
      ++impossible;
      continue;
    }
    for (int i = 0; i < inside; ++i) {
      // The least end that some schedule reaches, the latest start.
      std::vector<Time> to = s.d, from = s.r;
      for (to[at(i)] = s.r[at(i)]; !in_time_on_one(s.work, s.r, to);) ++to[at(i)];
      for (from[at(i)] = s.d[at(i)]; !in_time_on_one(s.work, from, s.d);) --from[at(i)];
      ASSERT_EQ(s.w.r[at(3 * i + 2)], to[at(i)]) << seed;
      ASSERT_EQ(s.w.d[at(3 * i + 1)], from[at(i)]) << seed;
      narrowed += to[at(i)] > s.r[at(i)] + s.work[at(i)];
    }
  }
  EXPECT_GT(impossible, 500);
  EXPECT_GT(narrowed, 500);
}

TEST(OneMachine, TakesATypeFromWhomItHasNoRoomFor) {
  int taken = 0, left = 0;
  for (std::uint64_t seed = 1; seed <= 4000; ++seed) {
    test::Dice dice(seed);
    const int inside = dice.roll(2, 5);
    Sandwich s = sandwich(dice, inside);
    const std::size_t last = at(3 * (inside - 1));
    const bool fits = in_time_on_one(s.work, s.r, s.d);
    const TypeSet gpu = s.w.types[last];
    s.w.types[last] = 3;
    OneMachine machine(s.problem);
    if (machine.narrow(s.w) == OneMachine::Answer::kImpossible) continue;
    ASSERT_EQ((s.w.types[last] & gpu) != 0, fits) << seed;
    (fits ? left : taken) += 1;
  }
  EXPECT_GT(taken, 300);
  EXPECT_GT(left, 300);
}

/// What is proven where the best policy that is known takes `known`.
Time proven_beside(const Problem& problem, Time known) {
  const std::atomic<Time> incumbent{known};
  ProofControl control;
  control.incumbent = &incumbent;
  control.max_lps = 1000;
  return prove_bound(problem, control);
}

TEST(OneMachine, NoProofWithItIsAboveWhatAPolicyReaches) {
  // Several instances of a type, costs, levels, XPUs that do not preempt. The incumbent is above
  // the optimum, so that a bound could be, too.
  int reached = 0;
  constexpr int kCases = 300;
  for (int k = 0; k < kCases; ++k) {
    test::Dice dice(910'000 + static_cast<std::uint64_t>(k));
    test::Shape shape;
    shape.min_nodes = 4;
    shape.max_nodes = 6;
    const Platform platform = test::random_platform(dice, shape);
    const Problem problem = *Problem::create(test::random_app(dice, shape, platform), platform);
    const Time best = test::brute_force_policies(problem).makespan;
    const Time bound = proven_beside(problem, best + dice.roll(1, 3));
    ASSERT_LE(bound, best) << "case " << k;
    reached += bound == best;
  }
  EXPECT_GE(reached, kCases - 5);
}

TEST(OneMachine, NoProofOnManyInstancesIsAboveTheOptimum) {
  // Free preemption, so that priorities alone reach it and exhaustion can be of more XNodes.
  int reached = 0;
  constexpr int kCases = 300;
  for (int k = 0; k < kCases; ++k) {
    test::Dice dice(920'000 + static_cast<std::uint64_t>(k));
    test::Shape shape;
    shape.min_nodes = 6;
    shape.edge_percent = 10;
    shape.max_preempt = shape.non_preemptive_percent = shape.levels_percent = 0;
    const Platform platform = test::random_platform(dice, shape);
    const Problem problem = *Problem::create(test::random_app(dice, shape, platform), platform);
    const Time best = test::brute_force(problem).makespan;
    const Time bound = proven_beside(problem, best + dice.roll(1, 3));
    ASSERT_LE(bound, best) << "case " << k;
    reached += bound == best;
  }
  EXPECT_GE(reached, kCases - 5);
}

}  // namespace
}  // namespace xauto::solver
