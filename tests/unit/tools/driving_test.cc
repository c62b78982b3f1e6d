// SPDX-License-Identifier: Apache-2.0
// examples/driving keeps its times in one place, times.h; its app files must say the same.
#include <gtest/gtest.h>

#include "model/components.h"
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

/// Its version with three rates and two clocks has the same stages, and a control loop.
TEST(Driving, RatesJsonHasTheSameStagesAndAControlLoop) {
  const std::string path = std::string(XAUTO_SOURCE_DIR) + "/examples/driving/rates.json";
  const auto app = load_app(path);
  ASSERT_TRUE(app) << app.error().to_string();
  const std::size_t stages = std::size(driving::kStages);
  ASSERT_EQ(app->xnodes.size(), stages + 2);
  for (std::size_t i = 0; i < stages; ++i) {
    EXPECT_EQ(app->xnodes[i].name, driving::kStages[i].xnode);
    EXPECT_EQ(app->xnodes[i].module, driving::kStages[i].module);
    EXPECT_EQ(app->xnodes[i].wcet_on("cpu").value_or(0), driving::kStages[i].cpu_us);
    EXPECT_EQ(app->xnodes[i].wcet_on("gpu").value_or(0), driving::kStages[i].gpu_us);
    EXPECT_EQ(app->xnodes[i].wcet_on("dla").value_or(0), driving::kStages[i].dla_us);
  }
  const Components found = find_components(*app).value();
  ASSERT_EQ(found.domains.size(), 2u);
  EXPECT_EQ(found.components.size(), 5u) << "LA; TD and TC; FCD, RCD, TR and PR; LD; CTL";
  // Cameras at 30 Hz and control at 50 Hz meet every 100 ms.
  EXPECT_EQ(*found.domains[0].hyperperiod_ticks, 100'000 * found.ticks_per_us);
  EXPECT_EQ(found.domains[0].jobs, 3 * 16 + 5 * 2);
  EXPECT_EQ(app->clocks[1], (ClockSpec{"lidar", 5000}));
}

}  // namespace
}  // namespace xauto
