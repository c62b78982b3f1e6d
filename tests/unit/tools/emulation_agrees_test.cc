// SPDX-License-Identifier: Apache-2.0
// The simulator's time-sharing models and the emulated devices are two programs for one text of
// rules. Here random apps run on both, in virtual time, and must finish every XNode at the same
// microsecond. So do the simulator of policies, and those devices under the coordinator's decisions.
#include <algorithm>
#include <limits>
#include <map>
#include <random>

#include <gtest/gtest.h>

#include "emu/machine.h"
#include "solver/simulate.h"
#include "solver/solve.h"

#include "../cases.h"
#include "bench/synthetic/emulate.h"
#include "bench/synthetic/time_sharing.h"

namespace xauto {
namespace {

using emu::Nanos;

AppSpec random_app(std::mt19937& random) {
  AppSpec app;
  app.name = "random";
  const int n = 3 + static_cast<int>(random() % 12);
  for (int i = 0; i < n; ++i) {
    XNodeSpec x{"n" + std::to_string(i), "m", {}};
    const auto time = [&] { return static_cast<std::int64_t>(1 + random() % 5000); };
    if (random() % 3 != 0) x.wcet_us["cpu"] = time();
    if (random() % 2 == 0) x.wcet_us["gpu"] = time();
    if (x.wcet_us.empty() || random() % 4 == 0) x.wcet_us["dla"] = time();
    app.xnodes.push_back(x);
    for (int p = 0; p < i; ++p)
      if (random() % 5 == 0) app.edges.emplace_back(p, i);
  }
  return app;
}

/// The app on the emulator, every XNode on the device given; finish times in us.
std::vector<std::int64_t> emulate(const AppSpec& app, const Platform& platform,
                                  const std::vector<int>& xpu, bool cpu_pool) {
  emu::Machine machine = std::move(*emu::Machine::create(platform));
  std::vector<emu::ContextId> context;
  std::map<emu::ContextId, int> xnode_of;
  std::vector<int> waits_for(app.xnodes.size(), 0);
  for (const auto& [u, v] : app.edges) ++waits_for[static_cast<std::size_t>(v)];
  for (std::size_t i = 0; i < app.xnodes.size(); ++i) {
    const Xpu& x = platform.xpus[static_cast<std::size_t>(xpu[i])];
    context.push_back(*machine.open(cpu_pool && x.type == "cpu" ? "cpu" : x.id, 0));
    xnode_of[context.back()] = static_cast<int>(i);
  }
  const auto submit = [&](std::size_t i, Nanos now) {
    const std::string& type = platform.xpus[static_cast<std::size_t>(xpu[i])].type;
    EXPECT_TRUE(machine.submit(context[i], i, *app.xnodes[i].wcet_on(type) * 1000, now));
  };
  for (std::size_t i = 0; i < app.xnodes.size(); ++i)
    if (waits_for[i] == 0) submit(i, 0);
  std::vector<std::int64_t> finish(app.xnodes.size(), -1);
  std::vector<emu::Event> events;
  for (Nanos now; (now = machine.next_event()) != std::numeric_limits<Nanos>::max();) {
    events.clear();
    machine.advance(now, events);
    std::vector<std::size_t> ready;
    for (const emu::Event& event : events) {
      const int done = xnode_of.at(event.context);
      finish[static_cast<std::size_t>(done)] = (event.time + 999) / 1000;
      for (const auto& [u, v] : app.edges)
        if (u == done && --waits_for[static_cast<std::size_t>(v)] == 0)
          ready.push_back(static_cast<std::size_t>(v));
    }
    std::sort(ready.begin(), ready.end());
    for (const std::size_t i : ready) submit(i, now);
  }
  return finish;
}

void compare(bench::Sharing sharing) {
  const Platform platform = *Platform::builtin("large");
  for (unsigned seed = 0; seed < 500; ++seed) {
    std::mt19937 random(seed);
    const AppSpec app = random_app(random);
    const auto problem = solver::Problem::create(app, platform);
    ASSERT_TRUE(problem) << problem.error().to_string();
    solver::Decision decision;
    for (int i = 0; i < problem->num_xnodes; ++i) {
      int m;
      do m = static_cast<int>(random() % static_cast<unsigned>(problem->num_xpus));
      while (problem->wcet_on(i, m) == solver::kCannotRun);
      decision.xpu.push_back(m);
      decision.priority.push_back(i);
    }
    const solver::Simulation simulated = bench::share_time(*problem, platform, sharing, decision);
    EXPECT_EQ(emulate(app, platform, simulated.xpu, sharing == bench::Sharing::kRos2),
              simulated.finish)
        << "seed " << seed;
  }
}

/// Policies of random priorities and some order, where a preemption costs nothing: how the cost of one
/// within another is paid differs by a rule of the devices.
TEST(EmulationAgrees, UnderTheCoordinatorsDecisionsWithTheRuleThatPoliciesArePlannedBy) {
  int preemptions = 0, limited = 0;
  const auto seeds = static_cast<unsigned>(test::cases(1200, 4000));
  for (unsigned seed = 0; seed < seeds; ++seed) {
    std::mt19937 random(seed);
    // Jobs come to the GPU from everywhere: chains over all XPUs, with some edges between them.
    AppSpec app;
    app.name = "chains";
    const int chains = 4 + static_cast<int>(random() % 8);
    for (int c = 0; c < chains; ++c)
      for (unsigned k = 0, length = 1 + random() % 4; k < length; ++k) {
        const int i = static_cast<int>(app.xnodes.size());
        app.xnodes.push_back({"n" + std::to_string(i), "m" + std::to_string(c), {}});
        // No two instants are alike: the order of what comes at one is nobody's promise.
        for (const char* type : {"cpu", "gpu", "dla"})
          if (random() % 2 == 0) app.xnodes.back().wcet_us[type] = 1000 + random() % 200'000;
        if (app.xnodes.back().wcet_us.empty()) app.xnodes.back().wcet_us["gpu"] = 9'973;
        if (k > 0) app.edges.emplace_back(i - 1, i);
        if (i > 1 && random() % 8 == 0) app.edges.emplace_back(random() % unsigned(i - 1), i);
      }
    Platform platform = *Platform::builtin("small");
    for (Xpu& xpu : platform.xpus) {
      xpu.preempt_us = 0;
      const unsigned kind = random() % 4;
      if (kind == 0) xpu.preemptive = false;
      if (kind > 1 && xpu.type != "cpu") xpu.levels = static_cast<int>(random() % 2 + 2);
    }
    const auto problem = solver::Problem::create(app, platform);
    ASSERT_TRUE(problem) << problem.error().to_string();
    solver::Decision decision;
    std::vector<std::int64_t> priority;
    for (int i = 0; i < problem->num_xnodes; ++i) {
      int m;
      do m = static_cast<int>(random() % static_cast<unsigned>(problem->num_xpus));
      while (problem->wcet_on(i, m) == solver::kCannotRun);
      decision.xpu.push_back(m);
      priority.push_back(i + 1);
    }
    std::shuffle(priority.begin(), priority.end(), random);
    decision.priority = priority;
    for (int v = 0; v < problem->num_xnodes; ++v)
      for (int u = 0; u < v; ++u)
        if (decision.xpu[static_cast<std::size_t>(u)] ==
                decision.xpu[static_cast<std::size_t>(v)] &&
            random() % 12 == 0)
          decision.order.emplace_back(u, v);
    const solver::Simulation simulated = solver::simulate(*problem, decision);
    const PriorityPlan policy = solver::make_policy(app, platform, *problem, decision, "random");
    const auto emulated = bench::emulate(app, platform, policy);
    ASSERT_TRUE(emulated) << emulated.error().to_string();
    ASSERT_EQ(emulated->finish_us, simulated.finish) << "seed " << seed;
    preemptions += static_cast<int>(simulated.preemptions);
    Platform free = platform;
    for (Xpu& xpu : free.xpus) xpu.levels = 0;
    limited +=
        solver::simulate(*solver::Problem::create(app, free), decision).finish != simulated.finish;
  }
  EXPECT_GT(preemptions, 1000);
  EXPECT_GT(limited, 10);
}

TEST(EmulationAgrees, WithTheSimulatorsRos2Model) {
  compare(bench::Sharing::kRos2);
}
TEST(EmulationAgrees, WithTheSimulatorsTimesharing) {
  compare(bench::Sharing::kTimeshare);
}

}  // namespace
}  // namespace xauto
