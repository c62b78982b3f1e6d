// SPDX-License-Identifier: Apache-2.0
// Small random apps and platforms for the solver's tests: few microseconds each, so that a
// simulator that steps through every microsecond stays fast, and ties happen often.
#pragma once

#include <algorithm>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "model/app.h"
#include "model/platform.h"
#include "solver/problem.h"

namespace xauto::solver::test {

class Dice {
 public:
  explicit Dice(std::uint64_t seed) : engine_(seed) {}
  /// Uniform enough in [low, high], the same on every machine.
  int roll(int low, int high) {
    return low + static_cast<int>(engine_() % static_cast<std::uint64_t>(high - low + 1));
  }
  bool chance(int percent) { return roll(1, 100) <= percent; }

 private:
  std::mt19937_64 engine_;
};

/// "x7"; two steps, because gcc 12 warns about "x" + std::to_string(7).
inline std::string numbered(std::string prefix, int i) {
  prefix += std::to_string(i);
  return prefix;
}

struct Shape {
  int min_nodes = 2, max_nodes = 8;
  int max_wcet = 12;
  int edge_percent = 25;
  int max_preempt = 4;  ///< 0: free preemption
  int max_cpus = 3, max_gpus = 2;
  int non_preemptive_percent = 25;  ///< of the XPUs
  int levels_percent = 30;          ///< of those that preempt: two or three levels
};

inline Platform random_platform(Dice& dice, const Shape& shape) {
  Platform platform;
  platform.name = "random";
  const auto add = [&](const std::string& type, int count) {
    const bool preemptive = !dice.chance(shape.non_preemptive_percent);
    const int preempt = dice.roll(0, shape.max_preempt);
    const int levels = preemptive && dice.chance(shape.levels_percent) ? dice.roll(2, 3) : 0;
    for (int i = 0; i < count; ++i)
      platform.xpus.push_back({numbered(type, i), type, preemptive, preempt, 3, -1, levels});
  };
  add("cpu", dice.roll(1, shape.max_cpus));
  add("gpu", dice.roll(0, shape.max_gpus));
  return platform;
}

inline AppSpec random_app(Dice& dice, const Shape& shape, const Platform& platform) {
  AppSpec app;
  app.name = "random";
  const int n = dice.roll(shape.min_nodes, shape.max_nodes);
  const std::vector<std::string> types = platform.types();
  for (int i = 0; i < n; ++i) {
    XNodeSpec xnode;
    xnode.name = numbered("x", i);
    xnode.module = numbered("m", i);
    for (const std::string& type : types)
      if (dice.chance(70)) xnode.wcet_us[type] = dice.roll(1, shape.max_wcet);
    if (xnode.wcet_us.empty()) xnode.wcet_us[types.front()] = dice.roll(1, shape.max_wcet);
    app.xnodes.push_back(std::move(xnode));
  }
  // Edges follow a random order, so that indices are not topological.
  std::vector<int> order(static_cast<std::size_t>(n));
  for (int i = 0; i < n; ++i) order[static_cast<std::size_t>(i)] = i;
  for (int i = n - 1; i > 0; --i)
    std::swap(order[static_cast<std::size_t>(i)], order[static_cast<std::size_t>(dice.roll(0, i))]);
  for (int i = 0; i < n; ++i)
    for (int j = i + 1; j < n; ++j)
      if (dice.chance(shape.edge_percent))
        app.edges.emplace_back(order[static_cast<std::size_t>(i)],
                               order[static_cast<std::size_t>(j)]);
  return app;
}

/// The same problem in which every instance is a type of its own, so that what single instances
/// are forbidden is plainly a missing implementation.
struct Apart {
  AppSpec app;
  Platform platform;
};
inline Apart instance_by_instance(const AppSpec& app, const Platform& platform,
                                  const std::vector<std::pair<int, int>>& forbidden) {
  Apart apart{app, platform};
  for (Xpu& xpu : apart.platform.xpus) xpu.type = xpu.id;
  for (std::size_t i = 0; i < app.xnodes.size(); ++i) {
    apart.app.xnodes[i].wcet_us.clear();
    for (std::size_t x = 0; x < platform.xpus.size(); ++x) {
      const auto wcet = app.xnodes[i].wcet_on(platform.xpus[x].type);
      const bool gone =
          std::find(forbidden.begin(), forbidden.end(),
                    std::pair(static_cast<int>(i), static_cast<int>(x))) != forbidden.end();
      if (wcet && !gone) apart.app.xnodes[i].wcet_us[platform.xpus[x].id] = *wcet;
    }
  }
  return apart;
}

/// Pairs (XNode, instance), never the last instance of an XNode.
inline std::vector<std::pair<int, int>> random_forbids(Dice& dice, const AppSpec& app,
                                                       const Platform& platform, int percent) {
  std::vector<std::pair<int, int>> forbidden;
  for (std::size_t i = 0; i < app.xnodes.size(); ++i) {
    int left = 0;
    for (const Xpu& xpu : platform.xpus) left += app.xnodes[i].wcet_on(xpu.type).has_value();
    for (std::size_t x = 0; x < platform.xpus.size(); ++x) {
      if (!app.xnodes[i].wcet_on(platform.xpus[x].type) || left < 2 || !dice.chance(percent))
        continue;
      --left;
      forbidden.emplace_back(static_cast<int>(i), static_cast<int>(x));
    }
  }
  return forbidden;
}

/// Any legal assignment, any unique priorities.
inline Decision random_decision(Dice& dice, const Problem& problem) {
  Decision decision;
  std::vector<Time> key;
  for (int i = 0; i < problem.num_xnodes; ++i) {
    int xpu = 0;
    do {
      xpu = dice.roll(0, problem.num_xpus - 1);
    } while (problem.wcet_on(i, xpu) == kCannotRun);
    decision.xpu.push_back(xpu);
    key.push_back(dice.roll(0, 1'000'000));
  }
  decision.priority = priorities_by_key(key);
  return decision;
}

/// Some run-time order pairs that cannot form a cycle with the edges: they follow `problem.topo`.
inline void add_random_order(Dice& dice, const Problem& problem, Decision& decision, int percent) {
  for (std::size_t a = 0; a < problem.topo.size(); ++a)
    for (std::size_t b = a + 1; b < problem.topo.size(); ++b) {
      const int u = problem.topo[a], v = problem.topo[b];
      if (decision.xpu[static_cast<std::size_t>(u)] == decision.xpu[static_cast<std::size_t>(v)] &&
          dice.chance(percent))
        decision.order.emplace_back(u, v);
    }
}

inline Problem random_problem(Dice& dice, int max_nodes) {
  Shape shape;
  shape.max_nodes = max_nodes;
  shape.edge_percent = 15;
  const Platform platform = random_platform(dice, shape);
  return Problem::create(random_app(dice, shape, platform), platform).value();
}

}  // namespace xauto::solver::test
