// SPDX-License-Identifier: Apache-2.0
// What the move of one XNode would bring, asked for several at a time.
#include "solver/keys/what_if.h"

#include <numeric>

#include <gtest/gtest.h>

#include "base/index.h"

#include "keys_random.h"

namespace xauto::solver::keys {
namespace {

struct Solved {
  AppSpec app;
  Platform platform;
  Policy policy;
  std::vector<int> xnodes;  ///< all of them
};

std::vector<Solved> solved_apps(int wanted) {
  std::vector<Solved> apps;
  for (std::uint64_t seed = 1; static_cast<int>(apps.size()) < wanted; ++seed) {
    solver::test::Dice dice(seed);
    Solved made{random_rated_app(dice, {}), random_rated_platform(dice), {}, {}};
    auto answer = solve(made.app, made.platform, brief(50));
    if (!answer || answer->outcome != Outcome::kPolicy) continue;
    made.policy = std::move(answer->policy);
    made.xnodes.resize(made.app.xnodes.size());
    std::iota(made.xnodes.begin(), made.xnodes.end(), 0);
    apps.push_back(std::move(made));
  }
  return apps;
}

TEST(Moves, SeveralAtATimeAreThoseOfOneAfterTheOther) {
  std::size_t tried = 0;
  for (const Solved& of : solved_apps(12)) {
    Options alone = brief(20), beside = alone;
    beside.threads = 3;
    const auto a = moves(of.app, of.platform, of.policy, of.xnodes, alone);
    const auto b = moves(of.app, of.platform, of.policy, of.xnodes, beside);
    ASSERT_TRUE(a && b);
    EXPECT_EQ(a->untried + b->untried, 0u);
    ASSERT_EQ(a->tried.size(), b->tried.size());
    tried += a->tried.size();
    for (std::size_t k = 0; k < a->tried.size(); ++k) {
      EXPECT_EQ(a->tried[k].change, b->tried[k].change);
      EXPECT_EQ(a->tried[k].outcome, b->tried[k].outcome);
      EXPECT_EQ(a->tried[k].worst_case_us, b->tried[k].worst_case_us) << a->tried[k].change;
    }
  }
  EXPECT_GT(tried, 20u);
}

/// Each other XPU of an XNode's types is tried once, where XPUs of a type that serve nobody are one.
TEST(Moves, EachOtherXpuOnce) {
  for (const Solved& of : solved_apps(12)) {
    std::vector<std::string> expected;
    for (const int i : of.xnodes)
      for (int x = 0; x < static_cast<int>(of.platform.xpus.size()); ++x) {
        const Xpu& xpu = of.platform.xpus[at(x)];
        // These platforms have at most two of a type: an idle one has no idle twin but where the type serves nobody.
        const bool twin =
            xpu.id == "cpu1" && std::ranges::none_of(of.policy.placements, [&](const Placement& p) {
              return of.platform.xpus[at(p.xpu)].type == "cpu";
            });
        if (x != of.policy.placements[at(i)].xpu && of.app.xnodes[at(i)].wcet_on(xpu.type) && !twin)
          expected.push_back(of.app.xnodes[at(i)].name + " on " + xpu.id);
      }
    const auto made = moves(of.app, of.platform, of.policy, of.xnodes, brief(20));
    ASSERT_TRUE(made);
    std::vector<std::string> changes;
    for (const WhatIf& tried : made->tried) changes.push_back(tried.change);
    EXPECT_EQ(changes, expected);
  }
}

TEST(Moves, OnesThatWereStoppedAreToldAsUntried) {
  const Solved of = solved_apps(3).back();
  const std::atomic<bool> stop{true};
  Options options = brief(20);
  options.threads = 2;
  options.stop = &stop;
  const auto made = moves(of.app, of.platform, of.policy, of.xnodes, options);
  ASSERT_TRUE(made);
  EXPECT_TRUE(made->tried.empty());
  const auto all = moves(of.app, of.platform, of.policy, of.xnodes, brief(20));
  EXPECT_EQ(made->untried, all->tried.size());
}

}  // namespace
}  // namespace xauto::solver::keys
