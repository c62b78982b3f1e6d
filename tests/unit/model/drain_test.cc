// SPDX-License-Identifier: Apache-2.0
// For how long a change of tables drains, by hand. Plays are in solver/handover_test.cc.
#include "model/drain.h"

#include <gtest/gtest.h>

namespace xauto {
namespace {

/// `a` on the CPU, then `b` on the GPU, every 10 ms.
struct Chain {
  AppSpec app;
  Platform platform{"p", {{"cpu0", "cpu", true, 100}, {"gpu0", "gpu", false, 0}}};
  Policy keys;
  Chain() {
    app.name = "chain";
    app.clocks = {{"main", 0}};
    app.sources = {{"s", {10'000, 1}}};
    app.xnodes = {{"a", "A", {{"cpu", 1000}}, {0}}, {"b", "B", {{"cpu", 9000}, {"gpu", 3000}}}};
    app.edges = {{0, 1}};
    app.modules = {{"A", 1}, {"B", 1}};
    keys.placements = {{0, {2000}}, {1, {6500}}};
  }
  [[nodiscard]] std::int64_t drains(std::int64_t notice_us = 0) const {
    return drain_us(app, platform, keys, notice_us);
  }
};

TEST(Drain, WhatIsUnderWayRunsOneAfterTheOtherAtWorst) {
  Chain c;
  // Released up to 10 000 + key before: two of each. `a` may preempt, at a cost.
  EXPECT_EQ(c.drains(), 2 * 1100 + 2 * 3000);
  // A third `b`, released 20 000 before, may not have ended.
  EXPECT_EQ(c.drains(3500), 2 * 1100 + 3 * 3000);
  c.app.transfers = {{0, "cpu", "gpu", 400}, {0, "cpu", "cpu", 50}};
  EXPECT_EQ(c.drains(), 2 * 1100 + 2 * (3000 + 400));
}

TEST(Drain, WhatIsOnOtherXpusIsNotWaitedFor) {
  Chain c;
  c.platform.xpus.push_back({"cpu1", "cpu", true, 0});
  c.app.sources.push_back({"t", {10'000, 1}});
  c.app.xnodes.push_back({"c", "C", {{"cpu", 4000}}, {1}});
  c.app.modules.push_back({"C", 1});
  c.keys.placements.push_back({2, {5000}});
  EXPECT_EQ(c.drains(), 2 * 1100 + 2 * 3000);
  c.keys.placements.back().xpu = 0;
  EXPECT_EQ(c.drains(), 2 * 1100 + 2 * 4100 + 2 * 3000);
}

TEST(Drain, FirstItWaitsForSensorsAndHolds) {
  Chain c;
  c.app.sources[0].jitter_us = 700;
  EXPECT_EQ(c.drains(), 700 + 2 * 1100 + 2 * 3000);
  c.keys.placements[1].hold_us = {2500};
  EXPECT_EQ(c.drains(), 2500 + 2 * 1100 + 2 * 3000);
}

TEST(Drain, AClockThatIsFastReleasesMore) {
  Chain c;
  c.keys.placements[1].key_us = {9990};
  EXPECT_EQ(c.drains(), 2 * 1100 + 2 * 3000);
  c.app.clocks[0].ppm = 1000;
  EXPECT_EQ(c.drains(), 2 * 1100 + 3 * 3000);
}

}  // namespace
}  // namespace xauto
