// SPDX-License-Identifier: Apache-2.0
// examples/driving keeps its times in one place, times.h; its app.json must say the same.
#include <gtest/gtest.h>

#include "model/json.h"

#include "examples/driving/times.h"

namespace xauto {
namespace {

TEST(Driving, AppJsonHoldsTheTimesOfTheProgram) {
  const auto app = load_app(std::string(XAUTO_SOURCE_DIR) + "/examples/driving/app.json");
  ASSERT_TRUE(app) << app.error().to_string();
  ASSERT_EQ(app->xnodes.size(), std::size(driving::kStages));
  for (std::size_t i = 0; i < app->xnodes.size(); ++i) {
    const driving::Stage& stage = driving::kStages[i];
    EXPECT_EQ(app->xnodes[i].name, stage.xnode);
    EXPECT_EQ(app->xnodes[i].module, stage.module);
    EXPECT_EQ(app->xnodes[i].wcet_on("cpu").value_or(0), stage.cpu_us) << stage.xnode;
    EXPECT_EQ(app->xnodes[i].wcet_on("gpu").value_or(0), stage.gpu_us) << stage.xnode;
    EXPECT_EQ(app->xnodes[i].wcet_on("dla").value_or(0), stage.dla_us) << stage.xnode;
  }
}

}  // namespace
}  // namespace xauto
