// SPDX-License-Identifier: Apache-2.0
// What is told of a run besides its picture: who its modules are.
#include "story/story.h"

#include <gtest/gtest.h>

#include "tiny_run.h"

namespace xauto::story {
namespace {

using test::Tiny;

TEST(Story, WhoSendsToAnotherModuleIsNoSink) {
  Tiny tiny;
  const std::vector<ModuleInfo> modules = modules_of(tiny.app, {"CAM", "BIG"});
  ASSERT_EQ(modules.size(), 2U);
  EXPECT_EQ(modules[0].name, "CAM");
  EXPECT_EQ(modules[1].name, "BIG");
  EXPECT_TRUE(modules[0].sink && modules[1].sink);
  tiny.app.edges.emplace_back(1, 2);
  EXPECT_FALSE(modules_of(tiny.app, {"CAM", "BIG"})[0].sink);
}

}  // namespace
}  // namespace xauto::story
