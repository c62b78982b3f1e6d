// SPDX-License-Identifier: Apache-2.0
// See explain.h.
#include "solver/explain.h"

#include <algorithm>
#include <cstdio>
#include <map>

#include "base/index.h"
#include "solver/bounds.h"
#include "solver/simulate.h"

namespace xauto::solver {
namespace {

std::string ms(Time us) {
  char text[32];
  std::snprintf(text, sizeof text, "%.2f ms", static_cast<double>(us) / 1000);
  return text;
}

Decision decision_of(const Policy& policy) {
  Decision decision;
  for (const Placement& placement : policy.placements) {
    decision.xpu.push_back(placement.xpu);
    decision.priority.push_back(placement.priority);
  }
  decision.order = policy.order;
  return decision;
}

Result<WhatIf> try_change(const AppSpec& app, const Platform& platform, const Policy& policy,
                          const SolveOptions& options, std::string change) {
  SolveOptions quiet = options;
  quiet.on_progress = nullptr;
  quiet.report = nullptr;
  XAUTO_ASSIGN(const Policy changed, solve(app, platform, quiet));
  WhatIf what;
  what.change = std::move(change);
  what.latency_us = changed.latency_us;
  what.lower_bound_us = changed.lower_bound_us;
  // A larger choice never makes the old answer impossible.
  what.latency_us = std::min(what.latency_us, policy.latency_us);
  what.gain = static_cast<double>(policy.latency_us - what.latency_us) /
              static_cast<double>(std::max<Time>(1, policy.latency_us));
  return what;
}

}  // namespace

Result<Explanation> explain(const AppSpec& app, const Platform& platform, const Policy& policy) {
  XAUTO_ASSIGN(const Problem problem, Problem::create(app, platform));
  SimulateOptions with_slices;
  with_slices.slices = true;
  const Simulation run = simulate(problem, decision_of(policy), with_slices);
  Explanation answer;
  answer.critical_path_us = critical_path_bound(problem);

  int current = 0;
  for (int i = 0; i < problem.num_xnodes; ++i)
    if (run.finish[at(i)] > run.finish[at(current)]) current = i;
  while (current >= 0) {
    ChainLink link;
    link.xnode = current;
    link.start_us = run.start[at(current)];
    link.finish_us = run.finish[at(current)];
    link.wcet_us = problem.wcet_on(current, policy.placements[at(current)].xpu);
    int next = -1;
    for (int p : problem.pred[at(current)]) {
      link.ready_us = std::max(link.ready_us, run.finish[at(p)]);
      if (next < 0 || run.finish[at(p)] > run.finish[at(next)]) next = p;
    }
    for (const Slice& slice : run.slices) {
      if (slice.xnode == current || slice.xpu != policy.placements[at(current)].xpu ||
          slice.end <= link.ready_us || slice.begin >= link.finish_us)
        continue;
      if (std::find(link.behind.begin(), link.behind.end(), slice.xnode) == link.behind.end())
        link.behind.push_back(slice.xnode);
    }
    answer.running_us += link.wcet_us;
    answer.chain.push_back(std::move(link));
    current = next;
  }
  std::reverse(answer.chain.begin(), answer.chain.end());

  std::map<int, Time> spent;
  for (const ChainLink& link : answer.chain)
    spent[policy.placements[at(link.xnode)].xpu] += link.finish_us - link.ready_us;
  for (const auto& [xpu, time] : spent) {
    if (time <= answer.limiting_us) continue;
    answer.limiting_us = time;
    answer.limiting_xpu = xpu;
  }
  const auto percent = [&](Time part) {
    char text[16];
    std::snprintf(
        text, sizeof text, "%.0f %%",
        100 * static_cast<double>(part) / static_cast<double>(std::max<Time>(1, run.makespan)));
    return std::string(text);
  };
  answer.sentence = "The latency of " + ms(run.makespan) + " is set by the chain from " +
                    app.xnodes[at(answer.chain.front().xnode)].name + " to " +
                    app.xnodes[at(answer.chain.back().xnode)].name + ": it runs for " +
                    ms(answer.running_us) + " and waits for " +
                    ms(run.makespan - answer.running_us) + ". " +
                    platform.xpus[at(answer.limiting_xpu)].id + " limits it: the chain spends " +
                    percent(answer.limiting_us) + " of its time there, running or waiting.";
  return answer;
}

Result<WhatIf> what_if_implemented(const AppSpec& app, const Platform& platform,
                                   const Policy& policy, const std::string& xnode,
                                   const std::string& type, Time wcet_us,
                                   const SolveOptions& options) {
  const int i = app.find(xnode);
  if (i < 0) return fail(ErrorCode::kInvalid, "no XNode is called '" + xnode + "'", "what-if");
  if (platform.instances_of(type).empty())
    return fail(ErrorCode::kInvalid, "the platform has no " + type, "what-if");
  AppSpec changed = app;
  changed.xnodes[at(i)].wcet_us[type] = wcet_us;
  return try_change(changed, platform, policy, options,
                    xnode + " on " + type + ", if " + ms(wcet_us));
}

Result<std::vector<WhatIf>> what_if(const AppSpec& app, const Platform& platform,
                                    const Policy& policy, const SolveOptions& options) {
  std::vector<WhatIf> answers;
  const auto stopped = [&] { return options.stop != nullptr && options.stop->load(); };
  for (const std::string& type : platform.types()) {
    Platform larger = platform;
    Xpu more = larger.xpus[at(larger.instances_of(type).front())];
    for (int k = 0; larger.find(more.id) >= 0; ++k) more.id = type + std::to_string(k);
    larger.xpus.push_back(more);
    if (stopped()) return answers;
    XAUTO_ASSIGN(WhatIf what, try_change(app, larger, policy, options, "one more " + type));
    answers.push_back(std::move(what));
  }
  XAUTO_ASSIGN(const Explanation why, explain(app, platform, policy));
  for (const std::string& type : platform.types()) {
    double ratio = 0;
    int both = 0;
    const auto least = [&](const XNodeSpec& xnode) {
      Time best = 0;
      for (const auto& [other, wcet] : xnode.wcet_us)
        if (other != type && (best == 0 || wcet < best)) best = wcet;
      return best;
    };
    for (const XNodeSpec& xnode : app.xnodes) {
      const auto wcet = xnode.wcet_on(type);
      const Time other = least(xnode);
      if (!wcet || other == 0) continue;
      ratio += static_cast<double>(*wcet) / static_cast<double>(other);
      ++both;
    }
    if (both == 0) continue;
    for (const ChainLink& link : why.chain) {
      const XNodeSpec& xnode = app.xnodes[at(link.xnode)];
      if (xnode.wcet_on(type)) continue;
      if (stopped()) return answers;
      const auto assumed =
          std::max<Time>(1, static_cast<Time>(static_cast<double>(least(xnode)) * ratio / both));
      // Nobody writes an implementation to be slower: whoever would asks with its WCET.
      if (assumed >= least(xnode)) continue;
      XAUTO_ASSIGN(WhatIf what,
                   what_if_implemented(app, platform, policy, xnode.name, type, assumed, options));
      answers.push_back(std::move(what));
    }
  }
  std::stable_sort(answers.begin(), answers.end(),
                   [](const WhatIf& a, const WhatIf& b) { return a.gain > b.gain; });
  return answers;
}

}  // namespace xauto::solver
