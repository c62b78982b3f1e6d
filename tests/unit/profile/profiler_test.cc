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

#include "base/rt.h"
#include "model/json.h"

#include "../engine/fates.h"
#include "../engine/test_app.h"
#include "profile/below.h"

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

/// On an XPU with levels: on the highest, beside XNodes of other modules on the lowest.
TEST(Profiler, OnLevelsEachXNodeIsTimedBesideLessUrgentOnes) {
  TestApp app;
  app.session.platform.xpus[1] = {.id = "npu0", .type = "npu", .preemptive = true, .levels = 3};
  std::mutex mutex;
  std::map<std::string, std::thread::id> inside;  // on npu0 -> by which thread
  std::map<std::thread::id, int> level;
  std::set<std::pair<std::string, std::string>> met;                   // (above, below)
  std::set<std::pair<std::string, std::vector<std::string>>> met_all;  // ..., those at a time
  std::map<std::thread::id, std::set<int>> cores;
  app.handle = [&] {
    EXPECT_EQ(levels({"npu0", XPU("npu"), 0}), 3);
    return SchedHandle::on_levels([&](int on) -> Status {
      const std::lock_guard lock(mutex);
      level[std::this_thread::get_id()] = on;
      return {};
    });
  };
  const auto look = [&](const std::string& node, std::thread::id me) {
    std::map<int, std::string> below;
    for (const auto& [other, thread] : inside)
      if (thread != me && level[me] == 2 && level[thread] < 2) {
        met.insert({node, other});
        EXPECT_TRUE(below.emplace(level[thread], other).second) << "two on one level";
      }
    std::vector<std::string> all;
    for (const auto& [on, other] : below) all.push_back(other);
    met_all.insert({node, all});
  };
  std::thread::id measures;
  app.exec = [&](const std::string& node, std::uint64_t) -> Status {
    const auto me = std::this_thread::get_id();
    {
      const std::lock_guard lock(mutex);
      if (measures == std::thread::id()) measures = me;
      for (const int core : rt::allowed_cores()) cores[me].insert(core);
      look(node, me);
      inside[node] = me;
    }
    std::this_thread::sleep_for(2ms);
    const std::lock_guard lock(mutex);
    look(node, me);
    inside.erase(node);
    return {};
  };
  app.session.mode = Mode::kProfile;
  app.session.profile.warmup = 1;
  app.session.profile.repetitions = 9;
  const std::atomic<bool> stop{false};
  const auto profiled = profile(app.spec, app.session, stop);
  ASSERT_TRUE(profiled) << profiled.error().to_string();
  const auto read = parse_profile(profiled->text, "profile");
  ASSERT_TRUE(read) << read.error().to_string();
  for (const XNodeProfile& x : read->xnodes) {
    EXPECT_EQ(x.on.at("npu0").count, 9) << x.name;
    ASSERT_TRUE(x.beside.contains("npu")) << x.name;
    EXPECT_EQ(x.beside.at("npu").at("npu0").count, 9) << x.name;
    EXPECT_FALSE(x.beside.at("npu").contains("cpu0")) << x.name << ": a core has no levels";
  }
  // Both wait for the XPU by looking: on one core they would wait for each other.
  ASSERT_EQ(cores.size(), 3u);
  if (rt::allowed_cores().size() > 1) {
    for (const auto& [thread, of] : cores)
      for (const int core : of) EXPECT_EQ(cores[measures].contains(core), thread == measures);
  }
  EXPECT_EQ(read->conditions.beside.at("npu"),
            "XNodes of other modules on lower levels, each alone and several at a time");
  // In the pass in which all are on npu0: each above each of another module.
  for (const char* above : {"a1", "a2", "b1", "c1"})
    for (const char* below : {"a1", "a2", "b1", "c1"})
      EXPECT_EQ(met.contains({above, below}), above[0] != below[0]) << above << " above " << below;
  // Two modules may be below it at a time, either on the lower level; of one module one XNode.
  using All = std::vector<std::string>;
  for (const All& all : {All{"b1", "c1"}, All{"c1", "b1"}})
    EXPECT_TRUE(met_all.contains({"a1", all})) << all.front();
  for (const All& all : {All{"a1", "c1"}, All{"c1", "a2"}})
    EXPECT_TRUE(met_all.contains({"b1", all})) << all.front();
}

TEST(Profiler, WhatIsBelowIsEachAloneAndOneOfEachModule) {
  using Sets = std::vector<std::vector<int>>;
  EXPECT_EQ(sets_below({}, 6), Sets{});
  EXPECT_EQ(sets_below({{1}}, 6), (Sets{{1}}));
  EXPECT_EQ(sets_below({{1}, {2}}, 2), (Sets{{1}, {2}})) << "one level for all that is below";
  EXPECT_EQ(sets_below({{1}, {2}}, 3), (Sets{{1}, {2}, {1, 2}, {2, 1}}));
  for (const int levels : {3, 4, 6, 16}) {
    const Sets others = {{1, 2, 3}, {4}, {5, 6}, {7}};
    const std::size_t together = std::min<std::size_t>(4, static_cast<std::size_t>(levels) - 1);
    std::set<std::pair<int, std::size_t>> on;  // XNode, level
    for (const std::vector<int>& set : sets_below(others, levels)) {
      std::set<std::size_t> modules;
      for (std::size_t level = 0; level < set.size(); ++level) {
        const auto of = std::find_if(others.begin(), others.end(), [&](const auto& module) {
          return std::count(module.begin(), module.end(), set[level]) > 0;
        });
        EXPECT_TRUE(modules.insert(static_cast<std::size_t>(of - others.begin())).second);
        if (set.size() > 1) on.insert({set[level], level});
      }
      EXPECT_TRUE(set.size() == 1 || set.size() == together) << set.size();
    }
    EXPECT_EQ(on.size(), 7 * together) << "each XNode on each of these levels";
  }
}

TEST(Profiler, WhatFailsBelowIsTold) {
  TestApp app;
  app.session.platform.xpus[1] = {.id = "npu0", .type = "npu", .preemptive = true, .levels = 2};
  std::atomic<bool> above{false};
  app.handle = [&] {
    return SchedHandle::on_levels([&](int on) -> Status {
      above = above || on > 0;
      return {};
    });
  };
  std::atomic<std::thread::id> measures;
  app.exec = [&](const std::string& node, std::uint64_t) -> Status {
    if (!above) measures = std::this_thread::get_id();
    if (above && std::this_thread::get_id() != measures.load())
      throw std::runtime_error("no stream for " + node);
    return {};
  };
  app.session.mode = Mode::kProfile;
  app.session.profile.warmup = 1;
  app.session.profile.repetitions = 3;
  const std::atomic<bool> stop{false};
  const auto profiled = profile(app.spec, app.session, stop);
  ASSERT_FALSE(profiled);
  EXPECT_NE(profiled.error().what.find("no stream for"), std::string::npos)
      << profiled.error().what;
}

/// Its threads are left behind with the app, for good.
TEST(Profiler, WhatHangsBelowIsNamedWithAllThatWereThere) {
  static auto& app = *new TestApp;
  static std::atomic<int> below{0};
  static std::atomic<bool> above{false}, hangs{false};
  app.session.platform.xpus[1] = {.id = "npu0", .type = "npu", .preemptive = true, .levels = 3};
  app.handle = [] {
    return SchedHandle::on_levels([](int on) -> Status {
      above = above || on == 2;
      return {};
    });
  };
  static std::atomic<std::thread::id> measures;
  app.exec = [](const std::string&, std::uint64_t) -> Status {
    if (!above) measures = std::this_thread::get_id();
    if (std::this_thread::get_id() == measures.load()) {
      std::this_thread::sleep_for(5ms);
      return {};
    }
    if (++below == 2) hangs = true;
    do std::this_thread::sleep_for(1ms);
    while (hangs);
    --below;
    return {};
  };
  app.session.mode = Mode::kProfile;
  app.session.profile.warmup = 1;
  app.session.profile.repetitions = 9;
  app.session.profile.exec_limit_s = 1;
  const std::atomic<bool> stop{false};
  const auto profiled = profile(app.spec, app.session, stop);
  ASSERT_TRUE(profiled) << profiled.error().to_string();
  const auto read = parse_profile(profiled->text, "profile");
  ASSERT_TRUE(read) << read.error().to_string();
  const std::string& said = read->incomplete;
  EXPECT_NE(said.find("' or '"), std::string::npos) << said;
  EXPECT_NE(said.find("' below it, did not return within 1 s"), std::string::npos) << said;
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
