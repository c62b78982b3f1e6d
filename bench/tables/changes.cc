// SPDX-License-Identifier: Apache-2.0
#include "bench/tables/changes.h"

#include <algorithm>
#include <limits>
#include <vector>

#include "solver/random.h"

namespace xauto::bench {
namespace {

using Us = std::int64_t;

/// What a release needs to be played; indices are of XNodes and of the platform's XPUs.
struct World {
  std::vector<std::vector<int>> before;                 ///< edges
  std::vector<std::vector<std::vector<Us>>> wcet;       ///< [scenario][xnode][xpu]; -1: cannot
  std::vector<std::vector<std::vector<int>>> queue_of;  ///< [table][xpu] its XNodes, in order
};

/// The order in which a table runs the XNodes of an XPU: its priorities agree with its pairs.
std::vector<std::vector<int>> queues(const Table& table, std::size_t xpus) {
  std::vector<std::vector<int>> all(xpus);
  for (std::size_t i = 0; i < table.xpu.size(); ++i)
    all[static_cast<std::size_t>(table.xpu[i])].push_back(static_cast<int>(i));
  for (auto& queue : all)
    std::sort(queue.begin(), queue.end(), [&](int a, int b) {
      return table.priority[static_cast<std::size_t>(a)] >
             table.priority[static_cast<std::size_t>(b)];
    });
  return all;
}

World world_of(const AppSpec& app, const Platform& platform, const Tables& tables) {
  World w;
  w.before.resize(app.xnodes.size());
  for (const auto& [u, v] : app.edges) w.before[static_cast<std::size_t>(v)].push_back(u);
  for (const Scenario& scenario : tables.scenarios) {
    const AppSpec scaled = app_under(app, scenario);
    w.wcet.emplace_back();
    for (const XNodeSpec& x : scaled.xnodes) {
      w.wcet.back().emplace_back();
      for (const Xpu& xpu : platform.xpus)
        w.wcet.back().back().push_back(x.wcet_on(xpu.type).value_or(-1));
    }
  }
  for (const Table& table : tables.tables)
    w.queue_of.push_back(queues(table, platform.xpus.size()));
  return w;
}

/// One release, instant by instant. `share`: of its WCET, in 1/1000, per XNode. A job that is under
/// way at the change takes its share of the larger WCET. `moves`: what has not begun by then goes to
/// table q's XPUs. Each XPU runs its queue in order.
Us play(const World& w, std::size_t s, std::size_t t, std::size_t p, std::size_t q, Us change,
        const std::vector<int>& share, bool moves) {
  const std::size_t n = w.before.size(), xpus = w.queue_of[p].size();
  constexpr Us kNotYet = -1;
  std::vector<Us> end(n, kNotYet), free_at(xpus, 0);
  std::vector<char> begun(n, 0);
  std::vector<std::size_t> next(xpus, 0);
  std::vector<std::vector<int>> queue = w.queue_of[p];
  bool changed = false;
  Us latency = 0;
  for (std::size_t left = n; left > 0;) {
    // The earliest start among the heads of all queues.
    Us best = std::numeric_limits<Us>::max();
    std::size_t on = 0;
    for (std::size_t x = 0; x < xpus; ++x) {
      while (next[x] < queue[x].size() && begun[static_cast<std::size_t>(queue[x][next[x]])] != 0)
        ++next[x];
      if (next[x] == queue[x].size()) continue;
      Us ready = free_at[x];
      for (const int u : w.before[static_cast<std::size_t>(queue[x][next[x]])])
        ready = end[static_cast<std::size_t>(u)] == kNotYet
                    ? std::numeric_limits<Us>::max()
                    : std::max(ready, end[static_cast<std::size_t>(u)]);
      if (ready < best) {
        best = ready;
        on = x;
      }
    }
    if (best == std::numeric_limits<Us>::max()) return best;  // they wait for each other
    if (moves && !changed && best >= change) {
      changed = true;
      queue = w.queue_of[q];
      std::fill(next.begin(), next.end(), 0);
      for (Us& at : free_at) at = std::max(at, change);
      continue;
    }
    const auto i = static_cast<std::size_t>(queue[on][next[on]]);
    const Us before = w.wcet[s][i][on], after = w.wcet[t][i][on];
    const auto takes = [&](Us wcet) { return wcet * share[i] / 1000; };
    Us time = best >= change ? takes(after) : takes(before);
    if (best < change && best + time > change) time = takes(std::max(before, after));
    begun[i] = 1;
    end[i] = free_at[on] = best + time;
    latency = std::max(latency, end[i]);
    --left;
  }
  return latency;
}

}  // namespace

Attack attack_changes(const AppSpec& app, const Platform& platform, const Tables& tables,
                      std::int64_t releases, std::uint64_t seed) {
  const World w = world_of(app, platform, tables);
  solver::Random random(seed);
  std::vector<const Change*> claimed;
  for (const Change& change : tables.changes)
    if (change.worst_case_us) claimed.push_back(&change);
  Attack attack;
  if (claimed.empty()) return attack;
  const std::int64_t each = releases / static_cast<std::int64_t>(claimed.size()) + 1;
  for (const Change* const change : claimed) {
    const auto s = static_cast<std::size_t>(change->from), t = static_cast<std::size_t>(change->to);
    const auto p = static_cast<std::size_t>(tables.serves[s].table),
               q = static_cast<std::size_t>(tables.serves[t].table);
    const Us bound = *change->worst_case_us;
    const Us either = std::max(tables.serves[s].worst_case_us, tables.serves[t].worst_case_us);
    // Each protocol has its own climb.
    for (const bool moves : {false, true}) {
      std::vector<int> worst(app.xnodes.size(), 1000), shares = worst;
      Us worst_instant = 0, longest = 0;
      for (std::int64_t k = 0; k < each; ++k) {
        Us instant = static_cast<Us>(random.below(static_cast<std::uint64_t>(either) + 1));
        if (k % 3 == 1) {
          shares = worst;  // around the worst so far
          shares[random.below(shares.size())] = static_cast<int>(random.below(1001));
          instant = worst_instant;
        } else {
          for (int& share : shares)
            share = random.below(4) == 0 ? static_cast<int>(random.below(1001)) : 1000;
        }
        const Us latency = play(w, s, t, p, q, instant, shares, moves);
        if (latency >= longest) {
          longest = latency;
          worst = shares;
          worst_instant = instant;
        }
        if (moves) {
          attack.moved_above += latency > either;
        } else {
          ++attack.releases;
          attack.above += latency > bound;
        }
      }
      double& most = moves ? attack.moved_worst : attack.nearest;
      most = std::max(most,
                      static_cast<double>(longest) / static_cast<double>(moves ? either : bound));
    }
  }
  return attack;
}

}  // namespace xauto::bench
