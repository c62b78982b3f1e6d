// SPDX-License-Identifier: Apache-2.0
// Which thread runs what, on an XPU that takes one job at a time: none of it may change the order of
// jobs, or keep one from being seen, or leave one without a thread.
#include <algorithm>
#include <map>
#include <numeric>
#include <random>
#include <set>

#include <gtest/gtest.h>
#include <uapi/xauto/event.h>

#include "base/memory_file.h"
#include "trace/trace.h"

#include "test_app.h"

namespace xauto::runtime {
namespace {

/// Modules of one to three XNodes, all on npu0. The first one reads the camera, each other one or two
/// of those before it. No two XNodes are equally urgent.
struct RandomApp {
  struct Module {
    std::vector<std::string> nodes;
    std::vector<std::size_t> reads;  ///< modules
  };
  TestApp app{TestApp::Bare{}};
  std::vector<Module> modules;
  std::map<std::string, int> priority;

  explicit RandomApp(unsigned seed) {
    std::mt19937 dice(seed);
    const std::size_t count = 3 + dice() % 6;
    int next = 0;
    for (std::size_t m = 0; m < count; ++m) {
      const std::string name = "M" + std::to_string(m);
      Module module;
      std::vector<detail::TopicSpec> inputs;
      if (m == 0) inputs.push_back(*detail::topic_spec(app.camera));
      std::set<std::size_t> reads;
      for (std::size_t i = 0; m > 0 && i < 1 + dice() % 2; ++i) reads.insert(dice() % m);
      for (const std::size_t from : reads)
        inputs.push_back(*detail::topic_spec(Topic<int>("m" + std::to_string(from))));
      module.reads.assign(reads.begin(), reads.end());
      for (std::size_t n = 0; n < 1 + dice() % 3; ++n)
        module.nodes.push_back(name + "." + std::to_string(n));
      for (const std::string& node : module.nodes) {
        const int index = next++;
        app.session.app.xnodes.push_back({node, name, {{"npu", 10}}});
        if (node != module.nodes.front()) app.session.app.edges.emplace_back(index - 1, index);
      }
      for (const std::size_t from : module.reads)
        app.session.app.edges.emplace_back(index_of(modules[from].nodes.back()),
                                           index_of(module.nodes.front()));
      app.add(name, module.nodes, inputs, Topic<int>("m" + std::to_string(m)));
      modules.push_back(module);
    }
    std::vector<int> priorities(app.session.app.xnodes.size());
    std::iota(priorities.begin(), priorities.end(), 1);
    std::shuffle(priorities.begin(), priorities.end(), dice);
    for (std::size_t i = 0; i < priorities.size(); ++i) {
      app.session.policy.placements.push_back({1, priorities[i]});
      priority[app.session.app.xnodes[i].name] = priorities[i];
    }
  }

  int index_of(const std::string& node) const {
    const auto& all = app.session.app.xnodes;
    return static_cast<int>(
        std::find_if(all.begin(), all.end(), [&](const auto& x) { return x.name == node; }) -
        all.begin());
  }

  /// In which order one machine runs a release by fixed priorities, without preemption.
  std::vector<std::string> simulate() const {
    std::vector<std::string> order;
    std::vector<std::size_t> at(modules.size()), missing;
    std::set<std::size_t> ready{0};
    for (const Module& module : modules) missing.push_back(module.reads.size());
    while (!ready.empty()) {
      const std::size_t m = *std::max_element(ready.begin(), ready.end(), [&](auto a, auto b) {
        return priority.at(modules[a].nodes[at[a]]) < priority.at(modules[b].nodes[at[b]]);
      });
      order.push_back(modules[m].nodes[at[m]]);
      if (++at[m] < modules[m].nodes.size()) continue;
      ready.erase(m);
      for (std::size_t reader = 0; reader < modules.size(); ++reader)
        for (const std::size_t from : modules[reader].reads)
          if (from == m && --missing[reader] == 0) ready.insert(reader);
    }
    return order;
  }
};

TEST(Crew, OneReleaseRunsInTheOrderOfItsUrgencies) {
  for (unsigned seed = 1; seed <= 60; ++seed) {
    RandomApp random(seed);
    random.app.session.releases.activations = 1;
    const auto report = random.app.run();
    ASSERT_TRUE(report) << seed << ": " << report.error().to_string();
    std::vector<std::string> expected = random.simulate();
    for (std::string& job : expected) job += "#0";
    EXPECT_EQ(random.app.log(), expected) << seed;
  }
}

TEST(Crew, WhateverComesHasAThread) {
  for (unsigned seed = 1; seed <= 6; ++seed) {
    RandomApp random(seed);
    TestApp& app = random.app;
    app.session.releases.lockstep = false;
    app.session.releases.activations = 100;
    app.session.deployment.defaults.overload = Overload{Overload::Kind::kQueue, 128};
    std::atomic<int> turn{0};
    app.exec = [&](const std::string&, std::uint64_t) -> Status {
      std::this_thread::sleep_for(std::chrono::microseconds(turn.fetch_add(37) % 300));
      return {};
    };
    const auto report = app.run();
    ASSERT_TRUE(report) << seed << ": " << report.error().to_string();
    EXPECT_TRUE(report->complete) << seed << ": " << report->note;
    EXPECT_EQ(report->lost_releases, 0u) << seed << ": " << report->note;
  }
}

/// c1#0 waits for the NPU, which b1#1 has, in the thread that ran a2#0. Then a2#1 comes, which is more
/// urgent than c1#0.
TEST(Crew, AMoreUrgentJobDoesNotWaitForItsThread) {
  TestApp app;
  app.session.releases.lockstep = false;
  app.session.releases.activations = 2;
  app.session.deployment.defaults.overload = Overload{Overload::Kind::kQueue, 64};
  const auto memory = make_memory_file("trace");
  ASSERT_TRUE(memory);
  app.session.trace_fd = memory->get();
  app.session.trace_keep_s = 60;
  constexpr std::uint16_t kA2 = 1, kB1 = 2, kC1 = 3;  // as app.xnodes has them
  const auto wait_for = [&](std::uint16_t kind, std::uint16_t xnode, std::uint64_t k) -> Status {
    const auto limit = std::chrono::steady_clock::now() + 5s;
    while (std::chrono::steady_clock::now() < limit) {
      const auto trace = trace::read(memory->get());
      if (trace && std::any_of(trace->events.begin(), trace->events.end(), [&](const auto& event) {
            return event.kind == kind && event.xnode == xnode && event.seq == k;
          }))
        return {};
      std::this_thread::sleep_for(1ms);
    }
    return fail(ErrorCode::kTimeout, "no such event");
  };
  app.exec = [&](const std::string& node, std::uint64_t k) -> Status {
    if (node == "a1" && k == 0) return wait_for(XAUTO_EV_RUN, kB1, 0);
    if (node == "b1" && k == 0) return wait_for(XAUTO_EV_START, kA2, 0);
    if (node == "a2" && k == 0) return wait_for(XAUTO_EV_START, kB1, 1);
    if (node == "b1" && k == 1) {
      XAUTO_TRY(wait_for(XAUTO_EV_START, kC1, 0));
      XAUTO_TRY(wait_for(XAUTO_EV_START, kA2, 1));
      std::this_thread::sleep_for(100ms);  // the event is written just before the START
    }
    return {};
  };
  const auto report = app.run();
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_TRUE(report->complete) << report->note;
  EXPECT_EQ(report->lost_releases, 0u) << report->note;
  std::vector<std::string> on_npu = app.log();
  std::erase_if(on_npu, [](const std::string& job) { return job.starts_with("a1"); });
  EXPECT_EQ(on_npu, (std::vector<std::string>{"b1#0", "a2#0", "b1#1", "a2#1", "c1#0", "c1#1"}));
}

}  // namespace
}  // namespace xauto::runtime
