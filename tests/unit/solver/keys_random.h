// SPDX-License-Identifier: Apache-2.0
// Tiny random apps of several rates: few microseconds each, so that ties and tight windows are common.
#pragma once

#include <algorithm>
#include <string>
#include <utility>

#include "model/app.h"
#include "model/platform.h"
#include "solver/keys/solve.h"

#include "problem_random.h"

namespace xauto::solver::keys {

struct RatedShape {
  int max_components = 2, max_nodes = 3;  ///< nodes per component
  int max_wcet = 4;
  int least_period = 10, most_period = 24;
  int clocks = 1;
  int ppm = 0;
  bool urgent = false;  ///< sources may be urgent
  bool fractions = false, transfers = true, jitter = true, offsets = true;
};

/// Ended by its budget, so that the answer does not depend on the machine.
inline Options brief(std::int64_t evaluations) {
  Options options;
  options.time_limit_s = 60;
  options.max_evaluations = evaluations;
  return options;
}

inline Platform random_rated_platform(solver::test::Dice& dice) {
  Platform platform;
  platform.name = "tiny";
  platform.xpus.push_back({"cpu0", "cpu", true, 0});
  if (dice.chance(40)) platform.xpus.push_back({"cpu1", "cpu", true, 0});
  const bool preemptive = dice.chance(60);
  platform.xpus.push_back({"gpu0", "gpu", preemptive, preemptive ? dice.roll(0, 2) : 0});
  return platform;
}

/// The same with `factor` times the microseconds: else what is rounded up is more than what drifts.
inline void stretch(AppSpec& app, Platform& platform, std::int64_t factor) {
  for (SourceSpec& source : app.sources) {
    source.period.num *= factor;
    source.offset_us *= factor;
    source.jitter_us *= factor;
  }
  for (XNodeSpec& xnode : app.xnodes)
    for (auto& [type, us] : xnode.wcet_us) us *= factor;
  for (TransferSpec& transfer : app.transfers) transfer.transfer_us *= factor;
  for (Xpu& xpu : platform.xpus) xpu.preempt_us *= factor;
}

inline AppSpec random_rated_app(solver::test::Dice& dice, const RatedShape& shape) {
  AppSpec app;
  app.name = "tiny";
  for (int c = 1; c < shape.clocks; ++c)
    app.clocks.push_back({solver::test::numbered("clock", c), shape.ppm});
  const int components = dice.roll(1, shape.max_components);
  std::vector<int> first, count;
  const int grain = dice.roll(shape.least_period, shape.most_period);
  for (int c = 0; c < components; ++c) {
    SourceSpec source;
    source.name = solver::test::numbered("source", c);
    // Periods with short hyperperiods.
    source.period = {grain * dice.roll(1, 3), 1};
    if (shape.fractions && dice.chance(50)) source.period = {source.period.num * 3 + 1, 3};
    if (shape.offsets) source.offset_us = dice.roll(0, std::min(3, grain - 1));
    if (shape.jitter) source.jitter_us = dice.chance(40) ? dice.roll(0, 4) : 0;
    source.clock = dice.roll(0, shape.clocks - 1);
    if (shape.fractions && c > 0) source.period = app.sources[0].period;
    if (shape.urgent && dice.chance(60)) {
      const int period = static_cast<int>(source.period.num / source.period.den);
      source.urgent = {dice.roll(1, dice.chance(70) ? 6 : period),
                       period * dice.roll(1, 4) + dice.roll(0, 1)};
    }
    app.sources.push_back(source);
    first.push_back(static_cast<int>(app.xnodes.size()));
    const int nodes = dice.roll(1, shape.max_nodes);
    count.push_back(nodes);
    const int in_a_module = dice.roll(1, 3);
    for (int i = 0; i < nodes; ++i) {
      XNodeSpec x;
      x.name = solver::test::numbered(solver::test::numbered("c", c) + ".x", i);
      x.module = solver::test::numbered(solver::test::numbered("c", c) + "m", i / in_a_module);
      const int where = dice.roll(0, 2);
      if (where != 1) x.wcet_us["cpu"] = dice.roll(1, shape.max_wcet);
      if (where != 0) x.wcet_us["gpu"] = dice.roll(1, shape.max_wcet);
      if (i == 0) x.sources = {c};
      app.xnodes.push_back(x);
      if (i > 0) {
        app.edges.emplace_back(first[static_cast<std::size_t>(c)] + i - 1,
                               first[static_cast<std::size_t>(c)] + i);
        if (i > 1 && dice.chance(30))
          app.edges.emplace_back(first[static_cast<std::size_t>(c)],
                                 first[static_cast<std::size_t>(c)] + i);
      }
      if (app.modules.empty() || app.modules.back().name != x.module)
        app.modules.push_back({x.module, dice.roll(1, 2)});
    }
  }
  const auto last = [&](int c) {
    return first[static_cast<std::size_t>(c)] + count[static_cast<std::size_t>(c)] - 1;
  };
  for (int c = 1; c < components; ++c) {
    const int from = dice.roll(0, c - 1);
    app.samples.emplace_back(last(from), first[static_cast<std::size_t>(c)] +
                                             dice.roll(0, count[static_cast<std::size_t>(c)] - 1));
    app.chains.push_back({solver::test::numbered("across", c), from, last(c)});
  }
  for (int c = 0; c < components; ++c)
    app.chains.push_back({solver::test::numbered("own", c), c, last(c)});
  if (shape.transfers && !app.edges.empty() && dice.chance(60)) {
    const auto [u, v] = app.edges.front();
    const auto& from = app.xnodes[static_cast<std::size_t>(u)].wcet_us;
    const auto& to = app.xnodes[static_cast<std::size_t>(v)].wcet_us;
    for (const auto& [a, b] : {std::pair{"cpu", "gpu"}, std::pair{"gpu", "cpu"}})
      if (from.contains(a) && to.contains(b)) app.transfers.push_back({0, a, b, dice.roll(1, 3)});
  }
  return app;
}

}  // namespace xauto::solver::keys
