// SPDX-License-Identifier: Apache-2.0
// The profiler on a whole app in this process. No time is judged.
#include "profile/profiler.h"

#include <algorithm>
#include <atomic>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <thread>
#include <utility>
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

/// Each pass begins with fresh states: an init that fills one is called for each of them, the others are not.
TEST(Profiler, AnInitThatSeesTheStateIsCalledForEachState) {
  TestApp app;
  std::set<std::pair<std::string, std::shared_ptr<void>>> filled;  // which keeps the states
  std::map<std::string, int> inits;
  std::map<void*, std::shared_ptr<void>> states;
  int strange = 0;
  for (const auto& module : app.spec.modules) {
    module->make_state = [&states, make = module->make_state] {
      auto state = make();
      states[state.get()] = state;
      return state;
    };
    for (const auto& node : module->nodes)
      for (detail::ImplSpec& impl : node->impls) {
        impl.init_sees_state = node->name == "a1";
        impl.init = [&, name = node->name, init = impl.init](const XpuId& xpu, void* state,
                                                             std::shared_ptr<void>& object) {
          ++inits[name];
          filled.insert({name, states.at(state)});
          return init(xpu, state, object);
        };
        impl.exec = [&, name = node->name, exec = impl.exec](void* object, void* state,
                                                             const Input& input) {
          strange += name == "a1" && !filled.contains({name, states.at(state)});
          return exec(object, state, input);
        };
      }
  }
  app.session.mode = Mode::kProfile;
  app.session.profile.warmup = 1;
  app.session.profile.repetitions = 2;
  const std::atomic<bool> stop{false};
  const auto profiled = profile(app.spec, app.session, stop);
  ASSERT_TRUE(profiled) << profiled.error().to_string();
  EXPECT_EQ(strange, 0);
  EXPECT_EQ(inits["a2"], 2);  // an XPU each
  EXPECT_GE(inits["a1"], 2);
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
