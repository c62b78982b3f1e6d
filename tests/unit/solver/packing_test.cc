// SPDX-License-Identifier: Apache-2.0
// What packing.h counts, against all that one instance can hold; and a proof that needs it.
#include "solver/packing.h"

#include <atomic>
#include <numeric>

#include <gtest/gtest.h>

#include "solver/bounds.h"
#include "solver/exact.h"
#include "solver/problem.h"

#include "problem_random.h"

namespace xauto::solver {
namespace {

/// The most that works of a sum of at most `left`, none above `largest`, count for.
Time most_of(Time left, Time largest, Time length, Time grain) {
  Time most = 0;
  for (Time work = 1; work <= std::min(left, largest); ++work)
    most = std::max(most, packed(work, length, grain) + most_of(left - work, work, length, grain));
  return most;
}

TEST(Packing, WhatFitsOnOneInstanceCountsForItsRoomAtMost) {
  int reached = 0;
  for (Time length = 1; length <= 17; ++length) {
    for (Time grain = -length; grain <= length; ++grain) {
      const Time most = most_of(length, length, length, grain);
      ASSERT_LE(most, packed_room(length, grain)) << length << " " << grain;
      reached += most == packed_room(length, grain);
    }
  }
  EXPECT_GT(reached, 150);  // nothing is given away
}

TEST(Packing, FindsWhatEnergyDoesNot) {
  // Three of 40 in two windows of 60: the energy just fits.
  Packing packing;
  for (int k = 0; k < 3; ++k) packing.add(40, 1);
  Time grain = 0;
  EXPECT_NEAR(packing.excess(60, 2, grain), 1, 1e-9);
  EXPECT_NE(grain, 0);
  EXPECT_EQ(3 * packed(40, 60, grain), 3 * packed_room(60, grain));
  packing.clear();
  for (int k = 0; k < 4; ++k) packing.add(30, 1);
  EXPECT_LE(packing.excess(60, 2, grain), 1e-9);
}

TEST(Packing, WhatItFindsIsSoInIntegers) {
  int found = 0;
  for (std::uint64_t seed = 1; seed <= 2000; ++seed) {
    test::Dice dice(seed);
    const Time length = dice.roll(1, 1 << dice.roll(1, 24));
    const int instances = dice.roll(1, 4), n = dice.roll(2, 40);
    Packing packing;
    std::vector<Time> works;
    for (int i = 0; i < n; ++i) {
      works.push_back(std::max<Time>(1, length * dice.roll(1, 100) / 100));
      packing.add(works.back(), 1);
    }
    Time grain = 0;
    const double excess = packing.excess(length, instances, grain);
    if (excess <= 0) continue;
    ++found;
    const Time sum = std::accumulate(works.begin(), works.end(), Time{0}, [&](Time so_far, Time w) {
      return so_far + packed(w, length, grain);
    });
    const auto room = static_cast<double>(packed_room(length, grain));
    EXPECT_NEAR(static_cast<double>(sum) / room - instances, excess, 1e-6) << seed;
  }
  EXPECT_GT(found, 500);
}

TEST(Packing, AProofKnowsThatXNodesOfUndecidedTypesDoNotMoveEither) {
  // Between a fork and a join: five of 40 us that two CPUs or a GPU, which takes 100 for one of
  // them, can do. In 60 us the CPUs could do three of them, if one moved. The GPU does none.
  AppSpec app;
  app.name = "five";
  app.xnodes.push_back({"fork", "m", {{"cpu", 10}}});
  for (int i = 0; i < 5; ++i)
    app.xnodes.push_back({test::numbered("x", i), "m", {{"cpu", 40}, {"gpu", 100}}});
  app.xnodes.push_back({"join", "m", {{"cpu", 10}}});
  for (int i = 1; i <= 5; ++i) {
    app.edges.emplace_back(0, i);
    app.edges.emplace_back(i, 6);
  }
  Platform platform;
  platform.name = "two and one";
  for (int c = 0; c < 2; ++c)
    platform.xpus.push_back({test::numbered("cpu", c), "cpu", true, 0, 3, -1});
  platform.xpus.push_back({"gpu0", "gpu", true, 1, 3, -1});
  const Problem problem = *Problem::create(app, platform);
  const std::atomic<Time> incumbent{120};
  ProofControl control;
  control.incumbent = &incumbent;
  control.max_lps = 40;
  EXPECT_EQ(prove_bound(problem, control), 120);
}

}  // namespace
}  // namespace xauto::solver
