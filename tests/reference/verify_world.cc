// SPDX-License-Identifier: Apache-2.0
#include "reference/verify_world.h"

#include <algorithm>
#include <limits>
#include <queue>
#include <set>
#include <tuple>

#include "base/index.h"

namespace xauto::solver::verification {
World::World(const AppSpec& app, const Platform& platform)
    : n(static_cast<int>(app.xnodes.size())), m(static_cast<int>(platform.xpus.size())) {
  before.resize(at(n));
  after.resize(at(n));
  std::vector<int> missing(at(n), 0);
  for (const auto& [u, v] : app.edges) {
    before[at(v)].push_back(u);
    after[at(u)].push_back(v);
    ++missing[at(v)];
  }
  for (int i = 0; i < n; ++i)
    if (missing[at(i)] == 0) first_to_last.push_back(i);
  for (std::size_t k = 0; k < first_to_last.size(); ++k)
    for (const int v : after[at(first_to_last[k])])
      if (--missing[at(v)] == 0) first_to_last.push_back(v);
  std::vector<std::tuple<std::string, bool, Us, int>> kinds;
  for (const Xpu& xpu : platform.xpus) {
    preemptive.push_back(xpu.preemptive ? 1 : 0);
    preempt_us.push_back(xpu.preempt_us);
    levels.push_back(xpu.levels);
    const std::tuple key(xpu.type, xpu.preemptive, xpu.preempt_us, xpu.levels);
    const auto found = std::find(kinds.begin(), kinds.end(), key);
    kind.push_back(static_cast<int>(found - kinds.begin()));
    if (found == kinds.end()) kinds.push_back(key);
  }
  wcet.resize(at(n));
  for (int i = 0; i < n; ++i)
    for (const Xpu& xpu : platform.xpus) wcet[at(i)].push_back(app.xnodes[at(i)].wcet_on(xpu.type));
}

Us World::least(int xnode) const {
  Us best = std::numeric_limits<Us>::max();
  for (const auto& us : wcet[at(xnode)])
    if (us) best = std::min(best, *us);
  return best;
}

bool World::preemption_is_free() const {
  for (int x = 0; x < m; ++x)
    if (!preemptive[at(x)] || preempt_us[at(x)] != 0 || levels[at(x)] != 0) return false;
  return true;
}

World World::relaxed() const {
  World free = *this;
  std::fill(free.preemptive.begin(), free.preemptive.end(), char{1});
  std::fill(free.preempt_us.begin(), free.preempt_us.end(), Us{0});
  std::fill(free.levels.begin(), free.levels.end(), 0);
  return free;
}

Execution execute(const World& world, const Candidate& candidate, const std::vector<Us>& takes) {
  struct Processor {
    std::priority_queue<std::pair<std::int64_t, int>> waiting;  // (priority, xnode)
    int job = -1;
    int begun = 0;  // and not done
    Us until = 0;
  };
  Execution result;
  result.start.assign(at(world.n), -1);
  result.finish.assign(at(world.n), -1);
  std::vector<Processor> processors(at(world.m));
  std::vector<Us> rest = takes;
  std::vector<std::size_t> missing(at(world.n));
  std::vector<std::vector<int>> unlocks(at(world.n));
  for (int i = 0; i < world.n; ++i) {
    missing[at(i)] = world.before[at(i)].size() + candidate.order_before[at(i)].size();
    for (const int u : candidate.order_before[at(i)]) unlocks[at(u)].push_back(i);
    if (missing[at(i)] == 0)
      processors[at(candidate.xpu[at(i)])].waiting.emplace(candidate.priority[at(i)], i);
  }
  const auto unlock = [&](int i) {
    if (--missing[at(i)] == 0)
      processors[at(candidate.xpu[at(i)])].waiting.emplace(candidate.priority[at(i)], i);
  };
  for (Us now = 0;;) {
    for (std::size_t x = 0; x < processors.size(); ++x) {
      Processor& p = processors[x];
      if (p.waiting.empty()) continue;
      const int next = p.waiting.top().second;
      if (p.job >= 0) {
        if (!world.preemptive[x] || candidate.priority[at(next)] < candidate.priority[at(p.job)])
          continue;
        if (world.levels[x] != 0 && p.begun == world.levels[x]) continue;
        rest[at(p.job)] = p.until - now;
        p.waiting.pop();
        p.waiting.emplace(candidate.priority[at(p.job)], p.job);
        rest[at(next)] += world.preempt_us[x];
      } else {
        p.waiting.pop();
        // Levels: what was begun below goes on at once, and is preempted.
        const bool begins = result.start[at(next)] < 0;
        if (world.levels[x] != 0 && p.begun > 0 && begins) rest[at(next)] += world.preempt_us[x];
      }
      p.job = next;
      p.until = now + rest[at(next)];
      if (result.start[at(next)] >= 0) continue;
      result.start[at(next)] = now;
      ++p.begun;
    }
    std::optional<Us> soonest;
    for (const Processor& p : processors)
      if (p.job >= 0 && (!soonest || p.until < *soonest)) soonest = p.until;
    if (!soonest) break;
    now = *soonest;
    for (Processor& p : processors) {
      if (p.job < 0 || p.until != now) continue;
      const int done = p.job;
      p.job = -1;
      --p.begun;
      result.finish[at(done)] = now;
      for (const int v : world.after[at(done)]) unlock(v);
      for (const int v : unlocks[at(done)]) unlock(v);
    }
    result.latency = now;
  }
  return result;
}

Us in_sequence(const World& world, const std::vector<int>& xpu, const std::vector<int>& sequence) {
  std::vector<Us> finish(at(world.n), 0), free_at(at(world.m), 0);
  Us latency = 0;
  for (const int i : sequence) {  // respects the edges: the caller's duty
    Us start = free_at[at(xpu[at(i)])];
    for (const int u : world.before[at(i)]) start = std::max(start, finish[at(u)]);
    finish[at(i)] = start + *world.wcet[at(i)][at(xpu[at(i)])];
    free_at[at(xpu[at(i)])] = finish[at(i)];
    latency = std::max(latency, finish[at(i)]);
  }
  return latency;
}

Us simple_bound(const World& world) {
  std::vector<Us> end(at(world.n), 0);
  Us bound = 0;
  for (const int i : world.first_to_last) {
    for (const int u : world.before[at(i)]) end[at(i)] = std::max(end[at(i)], end[at(u)]);
    end[at(i)] += world.least(i);
    bound = std::max(bound, end[at(i)]);
  }
  // The XNodes whose every implementation lies within a set of instances share that set's time. The
  // sets worth a look are those that some XNode names.
  std::set<std::vector<char>> sets;
  std::vector<std::vector<char>> can(at(world.n), std::vector<char>(at(world.m), 0));
  for (int i = 0; i < world.n; ++i) {
    for (int x = 0; x < world.m; ++x) can[at(i)][at(x)] = world.wcet[at(i)][at(x)].has_value();
    sets.insert(can[at(i)]);
  }
  for (const std::vector<char>& set : sets) {
    Us work = 0, instances = 0;
    for (const char in : set) instances += in;
    for (int i = 0; i < world.n; ++i) {
      bool inside = true;
      for (int x = 0; x < world.m; ++x) inside = inside && (!can[at(i)][at(x)] || set[at(x)]);
      if (inside) work += world.least(i);
    }
    bound = std::max(bound, (work + instances - 1) / instances);
  }
  return bound;
}

}  // namespace xauto::solver::verification
