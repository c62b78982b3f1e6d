// SPDX-License-Identifier: Apache-2.0
#include "runtime/placing.h"

#include <algorithm>

#include <gtest/gtest.h>

#include "../engine/test_app.h"

namespace xauto::runtime {
namespace {

/// What of the plan this machine does not keep.
std::string unkept(const TestApp& app) {
  const Graph graph = Graph::build(app.spec).value();
  Placing placing = Placing::of(app.session, graph);
  placing.compare_with_certificate(app.session);
  std::string all;
  for (const std::string& line : placing.unkept) all += line + "\n";
  return all;
}

/// a2, b1 and c1, of three modules, are on npu0.
TEST(Placing, StreamPrioritiesOrderTheWorkOfOneProcess) {
  TestApp app;
  app.session.platform.xpus[1] = {.id = "npu0", .type = "npu", .preemptive = true, .levels = 2};
  app.session.keys.emplace();
  app.session.keys->placements = {{0, {100'000}}, {1, {100'000}}, {1, {100'000}}, {1, {100'000}}};
  const std::string apart = "work on npu0 is ordered within one process";
  EXPECT_EQ(unkept(app).find(apart), std::string::npos) << unkept(app);
  app.session.parts.modules = {{"A", "B", "C"}};
  EXPECT_EQ(unkept(app).find(apart), std::string::npos) << "all in another process than the tool's";
  app.session.parts.modules = {{"A"}, {"B"}};
  EXPECT_NE(unkept(app).find(apart + ", and 3 have some"), std::string::npos) << unkept(app);
  app.session.platform.xpus[1].levels = 0;
  EXPECT_EQ(unkept(app).find(apart), std::string::npos) << "who suspends does so in each process";
}

}  // namespace
}  // namespace xauto::runtime
