// SPDX-License-Identifier: Apache-2.0
// Groups whose XNodes have different clocks, as callback groups of ROS 2 have.
#include <gtest/gtest.h>

#include "model/components.h"
#include "model/periodic.h"
#include "solver/keys/solve.h"

namespace xauto::solver::keys {
namespace {

TEST(KeysGroups, OfSeveralClocksShareOneXpu) {
  AppSpec app;
  app.name = "groups";
  app.clocks.push_back({"camera", 100});
  app.sources = {{"camera", {49'300, 1}, 0, 18'694, 1}, {"tick", {20'000, 1}, 0, 121}};
  app.xnodes = {{"tick", "tick", {{"cpu", 3081}}},
                {"camera", "camera", {{"cpu", 4950}}, {0}},
                {"timer", "timer", {{"cpu", 2102}}, {1}}};
  app.edges = {{2, 0}};
  complete_modules(app);
  complete_chains(app);
  ASSERT_TRUE(validate(app));
  Platform platform;
  platform.name = "four";
  for (int c = 0; c < 4; ++c) platform.xpus.push_back({"cpu" + std::to_string(c), "cpu"});
  for (const std::uint64_t seed : {1u, 2u, 3u}) {
    Options options;
    options.seed = seed;
    options.max_evaluations = 3000;
    options.wishes.groups = {{"tick", "camera"}};
    const auto answer = solve(app, platform, options);
    ASSERT_TRUE(answer) << answer.error().to_string();
    ASSERT_EQ(answer->outcome, Outcome::kPolicy);
    EXPECT_EQ(answer->policy.placements[0].xpu, answer->policy.placements[1].xpu) << seed;
  }
}

}  // namespace
}  // namespace xauto::solver::keys
