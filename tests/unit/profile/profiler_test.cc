// SPDX-License-Identifier: Apache-2.0
// The profiler on a whole app in this process. No time is judged.
#include "profile/profiler.h"

#include <algorithm>
#include <atomic>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

#include "../engine/fates.h"
#include "../engine/test_app.h"

namespace xauto::runtime {
namespace {

TEST(Profiler, AnObjectPerXpuInstanceIsMadeAndGoesOnTheThreadThatMeasures) {
  Fates fates;
  TestApp app;
  std::atomic<int> most{0}, made{0};
  app.object = [&](const std::string& node) {
    auto object = std::make_shared<Object>(node, fates);
    ++made;
    most = std::max(most.load(), fates.alive.load());
    return object;
  };
  app.session.mode = Mode::kProfile;
  app.session.profile.warmup = 1;
  app.session.profile.repetitions = 2;
  const std::atomic<bool> stop{false};
  const auto profiled = profile(app.spec, app.session, stop);
  ASSERT_TRUE(profiled) << profiled.error().to_string();
  EXPECT_EQ(app.foreign_objects.load(), 0);
  EXPECT_EQ(made.load(), 8);  // four XNodes, each on two XPUs
  EXPECT_EQ(most.load(), 4);  // the old one goes first: two might not fit into the memory
  EXPECT_EQ(fates.alive.load(), 0);
  EXPECT_EQ(fates.sorted(),
            (std::vector<std::string>{"a1", "a1", "a2", "a2", "b1", "b1", "c1", "c1"}));
}

TEST(Profiler, TakesWhatADriverPublishes) {
  TestApp app;
  detail::SourceSpec& source = app.spec.sources.front();
  source.period = {1};
  source.make = nullptr;
  source.inlet = std::make_shared<detail::Inlet>("camera", 1000);
  Source<int> camera(source.inlet);
  std::thread driver;
  app.spec.on_start.emplace_back([&] {
    driver = std::thread([&] {
      while (camera.publish(7)) std::this_thread::sleep_for(100us);
    });
  });
  app.spec.on_stop.emplace_back([&] { driver.join(); });
  app.session.mode = Mode::kProfile;
  app.session.profile.warmup = 1;
  app.session.profile.repetitions = 3;
  const std::atomic<bool> stop{false};
  const auto profiled = profile(app.spec, app.session, stop);
  ASSERT_TRUE(profiled) << profiled.error().to_string();
  EXPECT_EQ(count(app.log(), "c1"), 2u * 4u);
  // It is no grid that was measured.
  EXPECT_NE(profiled->text.find("\"pushed\": true"), std::string::npos) << profiled->text;
}

}  // namespace
}  // namespace xauto::runtime
