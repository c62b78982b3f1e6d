// SPDX-License-Identifier: Apache-2.0
// Decision::late: a reader that begins as late as the tick allows that reads its result.
#include <gtest/gtest.h>

#include "solver/keys/certificate.h"
#include "solver/keys/evaluate.h"
#include "solver/keys/solve.h"

#include "keys_random.h"

namespace xauto::solver::keys {
namespace {

/// A LiDAR of its own clock, a camera every 30 ms whose tracker (2 ms) reads what is made of it (1 ms), and control
/// every 15 ms (1 ms), which reads the tracker. That is done at 2 ms, and read at 15. So from the tracker's release on
/// it takes 16 ms, whenever it begins up to 13. The LiDAR's result takes 1 ms, then at most 30 ms less the tracker's
/// earliest start until a tracker reads it: 1 + 30 + 16 = 47 ms, and begun at 13 ms 34.
TEST(KeysLate, AReaderThatBeginsLateReadsWhatIsNewer) {
  AppSpec app;
  app.name = "late";
  app.clocks.push_back({"own", 0});
  app.sources = {{.name = "lidar", .period = {30'000, 1}},
                 {.name = "camera", .period = {30'000, 1}},
                 {.name = "tick", .period = {15'000, 1}}};
  app.sources[0].clock = 1;
  for (int i = 0; i < 3; ++i) {
    XNodeSpec& x = app.xnodes.emplace_back();
    x.name = x.module = solver::test::numbered("x", i);
    x.sources = {i};
    x.wcet_us["cpu"] = i == 1 ? 2'000 : 1'000;
    app.modules.push_back({x.module, 1});
  }
  app.samples = {{0, 1}, {1, 2}};
  app.chains = {{"way", 0, 2, 100'000}, {"control", 2, 2, 1'000}};
  Platform platform;
  platform.name = "three";
  for (const char* name : {"cpu0", "cpu1", "cpu2"}) platform.xpus.push_back({name, "cpu", true, 0});
  const auto p = Problem::create(app, platform);
  ASSERT_TRUE(p);
  Decision decision;
  decision.xpu = {0, 1, 2};
  decision.key = {1, 1, 1};
  decision.hold = decision.window = {0, 0, 0};
  decision.held = decision.polite = decision.late = {0, 0, 0};
  Evaluator evaluator(*p, {1, 1});
  EXPECT_FALSE(evaluator.may_be_late(0)) << "it reads nothing";
  EXPECT_TRUE(evaluator.may_be_late(1));
  EXPECT_FALSE(evaluator.may_be_late(2)) << "a chain ends there";
  Figures figures;
  for (const auto& [late, us] : {std::pair{char{0}, 47'000}, std::pair{char{1}, 34'000}}) {
    decision.late[1] = late;
    evaluator.evaluate(decision, kInvalidCost, figures);
    ASSERT_TRUE(figures.valid);
    EXPECT_EQ(figures.chain[0], us * p->scale);
    EXPECT_TRUE(certify(*p, decision.xpu, figures.w));
  }
  const auto answer = solve(app, platform, brief(1000));
  ASSERT_TRUE(answer);
  EXPECT_EQ(answer->policy.chains[0].worst_case_us, 34'000);
}

}  // namespace
}  // namespace xauto::solver::keys
