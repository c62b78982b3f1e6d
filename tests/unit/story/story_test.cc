// SPDX-License-Identifier: Apache-2.0
// What is told of a run besides its picture: who its modules are, and which jobs outran their WCET.
#include "story/story.h"

#include <gtest/gtest.h>

#include "tiny_run.h"

namespace xauto::story {
namespace {

using test::Tiny;

TEST(Story, ModulesAreKnownFromTheTraceAlone) {
  Tiny tiny;
  tiny.release(0, 0);
  const std::vector<ModuleInfo> modules = modules_of(tiny.app, tiny.trace);
  ASSERT_EQ(modules.size(), 2U);
  EXPECT_EQ(modules[0].name, "CAM");
  EXPECT_EQ(modules[1].name, "BIG");
  EXPECT_TRUE(modules[0].sink && modules[1].sink);
  tiny.app.edges.emplace_back(1, 2);
  EXPECT_FALSE(modules_of(tiny.app, tiny.trace)[0].sink);
}

TEST(Story, JobsThatOutranTheirWcetAreCounted) {
  Tiny tiny;
  tiny.release(0, 0);
  tiny.release(2000, 1);
  const auto told = story_of(tiny.app, tiny.platform, tiny.scene.modules, tiny.trace);
  ASSERT_TRUE(told.has_value()) << told.error().to_string();
  std::vector<std::int64_t> longest(tiny.app.xnodes.size(), 0);
  for (const JobStory& job : told->jobs) {
    std::int64_t ran_ns = 0;
    for (const Phase& phase : job.phases)
      if (phase.kind == PhaseKind::kRunning) ran_ns += phase.end_ns - phase.begin_ns;
    auto& most = longest[static_cast<std::size_t>(job.xnode)];
    most = std::max(most, ran_ns / 1000);
  }
  for (std::size_t i = 0; i < longest.size(); ++i)
    for (auto& [type, us] : tiny.app.xnodes[i].wcet_us) us = longest[i];
  const std::vector<bool> all = {true, true};
  EXPECT_EQ(overruns_of(tiny.app, tiny.platform, *told, all).count, 0U);

  tiny.app.xnodes[0].wcet_us["cpu"] = longest[0] - 7;
  tiny.app.xnodes[2].wcet_us["gpu"] = longest[2] - 9;
  const Overruns over = overruns_of(tiny.app, tiny.platform, *told, all);
  EXPECT_EQ(over.count, 4U);
  EXPECT_EQ(over.worst, 2);
  EXPECT_EQ(over.worst_us, 9);

  // On a real CPU the kernel may have run somebody else meanwhile: nothing is said.
  const Overruns seen = overruns_of(tiny.app, tiny.platform, *told, {false, true});
  EXPECT_EQ(seen.count, 2U);
  EXPECT_EQ(overruns_of(tiny.app, tiny.platform, *told, {false, false}).worst, -1);
}

}  // namespace
}  // namespace xauto::story
