// SPDX-License-Identifier: Apache-2.0
#include "bench/keys/rivals.h"

#include <algorithm>
#include <numeric>

#include "base/index.h"
#include "model/components.h"
#include "solver/keys/play.h"
#include "solver/solve.h"

namespace xauto::bench {
namespace {

/// Of the search for one release; a second or two.
constexpr std::int64_t kEvaluations = 20'000;
/// So many activations of everybody unfinished: nobody catches up any more.
constexpr std::int64_t kBacklog = 20;

/// All XNodes in the order of `less`, as ranks.
template <class Less>
std::vector<std::int64_t> ranks(const AppSpec& app, Less less) {
  std::vector<int> order = app.topological_order();
  std::stable_sort(order.begin(), order.end(), less);
  std::vector<std::int64_t> rank(order.size());
  for (std::size_t k = 0; k < order.size(); ++k) rank[at(order[k])] = static_cast<std::int64_t>(k);
  return rank;
}

std::vector<int> fastest(const AppSpec& app, const Platform& platform,
                         const std::vector<double>& period_us) {
  std::vector<int> xpu(app.xnodes.size(), -1);
  std::vector<double> load(platform.xpus.size(), 0);
  for (const int i : app.topological_order()) {
    std::int64_t least = INT64_MAX;
    for (const Xpu& x : platform.xpus)
      if (const auto us = app.xnodes[at(i)].wcet_on(x.type)) least = std::min(least, *us);
    for (std::size_t x = 0; x < platform.xpus.size(); ++x)
      if (app.xnodes[at(i)].wcet_on(platform.xpus[x].type) == least &&
          (xpu[at(i)] < 0 || load[x] < load[at(xpu[at(i)])]))
        xpu[at(i)] = static_cast<int>(x);
    load[at(xpu[at(i)])] += static_cast<double>(least) / period_us[at(i)];
  }
  return xpu;
}

/// One release of everything, as solver/solve.h plans it.
Result<std::vector<std::int64_t>> fixed(const AppSpec& app, const Platform& platform,
                                        const std::vector<int>& xpu) {
  AppSpec once;
  once.name = app.name;
  once.edges = app.edges;
  solver::SolveOptions options;
  options.priorities_only = true;
  options.max_evaluations = kEvaluations;
  options.time_limit_s = 5;
  for (std::size_t i = 0; i < app.xnodes.size(); ++i) {
    const XNodeSpec& x = app.xnodes[i];
    once.xnodes.push_back({x.name, x.module, x.wcet_us});
    options.objectives.pins.emplace_back(x.name, platform.xpus[at(xpu[i])].id);
  }
  XAUTO_ASSIGN(const PriorityPlan policy, solver::solve(once, platform, options));
  return ranks(app, [&](int a, int b) {
    return policy.placements[at(a)].priority > policy.placements[at(b)].priority;
  });
}

/// `policy` says where; nothing else of it is used.
Result<Observed> play_all(const AppSpec& app, const Platform& platform, const Policy& policy,
                          const std::vector<std::int64_t>& rank, const Plays& plays) {
  const Components found = find_components(app).value();
  double jobs_a_second = 0, longest_s = 0;
  for (const Component& c : found.components) {
    const double period_s =
        static_cast<double>(c.period_ticks) / static_cast<double>(found.ticks_per_us) / 1e6;
    jobs_a_second += static_cast<double>(c.xnodes.size()) / period_s;
    longest_s = std::max(longest_s, period_s);
  }
  Observed seen;
  seen.longest_us.assign(app.chains.size(), 0);
  for (int k = 0; k < plays.count; ++k) {
    solver::keys::PlayOptions options;
    // Long enough for the slowest to come a few times.
    options.seconds = std::max<std::int64_t>(
        1, static_cast<std::int64_t>(
               std::max(static_cast<double>(plays.jobs) / jobs_a_second, 3 * longest_s)));
    options.random_times = k % 2 == 1;
    options.jitter = k > 0;
    options.phases = true;
    options.seed = plays.seed * 1000 + static_cast<std::uint64_t>(k);
    options.rank = rank;
    XAUTO_ASSIGN(const auto played, solver::keys::play(app, platform, policy, options));
    for (std::size_t c = 0; c < played.chains.size(); ++c)
      seen.longest_us[c] = std::max(seen.longest_us[c], played.chains[c].longest_us);
    seen.jobs += played.jobs;
    seen.late += played.late;
    seen.backlog = seen.backlog || played.backlog ||
                   played.unfinished > kBacklog * static_cast<std::int64_t>(app.xnodes.size());
  }
  return seen;
}

}  // namespace

Result<std::vector<Rival>> rivals(const AppSpec& app, const Platform& platform,
                                  const Policy& ours) {
  const Components found = find_components(app).value();
  std::vector<double> period_us;
  for (std::size_t i = 0; i < app.xnodes.size(); ++i)
    period_us.push_back(static_cast<double>(found.components[at(found.of[i])].period_ticks) /
                        static_cast<double>(found.ticks_per_us));
  std::vector<int> placed;
  for (const Placement& p : ours.placements) placed.push_back(p.xpu);
  const auto by_rate =
      ranks(app, [&](int a, int b) { return period_us[at(a)] < period_us[at(b)]; });
  XAUTO_ASSIGN(auto once, fixed(app, platform, placed));
  std::vector<Rival> list = {
      {"fixed", placed, std::move(once)},
      {"rm", placed, by_rate},
      {"fcfs", placed, std::vector<std::int64_t>(app.xnodes.size(), 0)},
      {"fastest", fastest(app, platform, period_us), by_rate},
  };
  for (Rival& rival : list) {
    std::vector<double> load(platform.xpus.size(), 0);
    for (std::size_t i = 0; i < rival.xpu.size(); ++i) {
      const std::string& type = platform.xpus[at(rival.xpu[i])].type;
      load[at(rival.xpu[i])] += static_cast<double>(*app.xnodes[i].wcet_on(type)) / period_us[i];
    }
    rival.load = *std::max_element(load.begin(), load.end());
  }
  return list;
}

Result<Observed> observe(const AppSpec& app, const Platform& platform, const Policy& ours,
                         const Rival& rival, const Plays& plays) {
  Policy placed = ours;
  for (std::size_t i = 0; i < rival.xpu.size(); ++i)
    placed.placements[i] = Placement{rival.xpu[i], {1}};
  return play_all(app, platform, placed, rival.rank, plays);
}

Result<Observed> observe(const AppSpec& app, const Platform& platform, const Policy& ours,
                         const Plays& plays) {
  return play_all(app, platform, ours, {}, plays);
}

}  // namespace xauto::bench
