// SPDX-License-Identifier: Apache-2.0
#include "solver/problem.h"

#include <gtest/gtest.h>

#include "problem_random.h"

namespace xauto::solver::test {
namespace {

TEST(Problem, KeepsTypesInPlatformOrderAndMarksMissingImplementations) {
  AppSpec app;
  app.name = "t";
  app.xnodes = {{"a", "A", {{"gpu", 7}}}, {"b", "B", {{"cpu", 9}, {"dla", 5}}}};
  app.edges = {{0, 1}};
  const Platform platform = *Platform::builtin("large");
  const Problem p = *Problem::create(app, platform);
  EXPECT_EQ(p.type_name, (std::vector<std::string>{"cpu", "gpu", "dla"}));
  EXPECT_EQ(p.num_xpus, 11);
  EXPECT_EQ(p.type_xpus[2], (std::vector<int>{9, 10}));
  EXPECT_EQ(p.wcet(0, 0), kCannotRun);
  EXPECT_EQ(p.wcet_on(0, 8), 7);
  EXPECT_EQ(p.wcet_on(1, 10), 5);
  EXPECT_EQ(p.preempt[8], 275);
  EXPECT_EQ(p.topo, (std::vector<int>{0, 1}));
}

TEST(Problem, XNodeWithoutAnyXpuIsInfeasibleAndNamed) {
  AppSpec app;
  app.name = "t";
  app.xnodes = {{"vision.npu", "A", {{"npu", 7}}}};
  const auto p = Problem::create(app, *Platform::builtin("small"));
  ASSERT_FALSE(p);
  EXPECT_EQ(p.error().code, ErrorCode::kInfeasible);
  EXPECT_NE(p.error().to_string().find("vision.npu"), std::string::npos);
}

TEST(Problem, CycleIsInvalid) {
  AppSpec app;
  app.name = "t";
  app.xnodes = {{"a", "A", {{"cpu", 7}}}, {"b", "B", {{"cpu", 7}}}};
  app.edges = {{0, 1}, {1, 0}};
  const auto p = Problem::create(app, *Platform::builtin("small"));
  ASSERT_FALSE(p);
  EXPECT_EQ(p.error().code, ErrorCode::kInvalid);
}

TEST(Problem, PrioritiesByKeyAreUniqueAndEarlierIsMoreUrgent) {
  EXPECT_EQ(priorities_by_key({5, 2, 5, 9}), (std::vector<std::int64_t>{3, 4, 2, 1}));
}

}  // namespace
}  // namespace xauto::solver::test
