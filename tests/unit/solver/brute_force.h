// SPDX-License-Identifier: Apache-2.0
// The shortest execution over all policies, by exhaustion.
//
// Without run-time order: `enumerate_everything` writes down every assignment and every permutation
// and simulates each (up to 5 XNodes), `brute_force` decides only when the execution needs a
// decision: the instance when an XNode becomes ready, and who is more urgent when two of them want
// one XPU. Decisions are kept as a transitively closed relation, so that each path is an execution
// under one fixed priority order.
//
// With run-time order, whatever `xauto check` accepts: `enumerate_policies` also writes down every
// set of pairs (up to 4 XNodes), `brute_force_policies` every way to let each XNode wait for one
// other one of its XPU, and leaves the rest to `brute_force`. One is enough where every job takes
// its WCET: of those that an XNode waits for, the one that finishes last decides. Tests compare the
// two of each kind.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <limits>
#include <numeric>
#include <vector>

#include "base/index.h"
#include "solver/problem.h"

#include "naive_simulator.h"

namespace xauto::solver::test {

struct BruteForceAnswer {
  Time makespan = std::numeric_limits<Time>::max();
  Decision decision;
  std::int64_t paths = 0;
};

class BruteForce {
 public:
  static constexpr int kMaxNodes = 24;

  explicit BruteForce(const Problem& problem) : p_(problem), tail_(problem.pred.size(), 0) {
    for (auto it = p_.topo.rbegin(); it != p_.topo.rend(); ++it)
      for (const int s : p_.succ[at(*it)])
        tail_[at(*it)] = std::max(tail_[at(*it)], tail_[at(s)] + least(s));
  }

  /// Only what is shorter than `limit` is an answer. `xpu`: the assignment, if it is given.
  BruteForceAnswer run(Time limit = std::numeric_limits<Time>::max(),
                       const std::vector<int>& xpu = {}) {
    best_.makespan = limit;
    State s;
    s.xpu.fill(-1);
    s.on.assign(at(p_.num_xpus), -1);
    s.used.assign(at(p_.num_xpus), 0);
    for (std::size_t i = 0; i < xpu.size(); ++i) {
      s.xpu[i] = xpu[i];
      s.left[i] = p_.wcet_on(static_cast<int>(i), xpu[i]);
      s.used[at(xpu[i])] = 1;
    }
    explore(s);
    return best_;
  }

 private:
  struct State {
    Time now = 0;
    std::uint32_t done = 0, begun = 0;
    std::array<int, kMaxNodes> xpu{};
    std::array<Time, kMaxNodes> left{};
    std::array<std::uint32_t, kMaxNodes>
        above{};  ///< those that are more urgent, transitively closed
    std::vector<int> on;
    std::vector<char> used;
  };

  static std::uint32_t bit(int i) { return 1U << i; }

  [[nodiscard]] Time least(int i) const {
    Time best = std::numeric_limits<Time>::max();
    for (int m = 0; m < p_.num_xpus; ++m)
      if (p_.wcet_on(i, m) != kCannotRun) best = std::min(best, p_.wcet_on(i, m));
    return best;
  }
  [[nodiscard]] bool ready(const State& s, int i) const {
    if (s.done & bit(i)) return false;
    for (const int u : p_.pred[at(i)])
      if (!(s.done & bit(u))) return false;
    return true;
  }
  [[nodiscard]] bool same_kind(int a, int b) const {
    return p_.xpu_type[at(a)] == p_.xpu_type[at(b)] &&
           p_.preemptive[at(a)] == p_.preemptive[at(b)] && p_.preempt[at(a)] == p_.preempt[at(b)] &&
           p_.levels[at(a)] == p_.levels[at(b)];
  }

  [[nodiscard]] int open_on(const State& s, int m) const {
    int open = 0;
    for (int i = 0; i < p_.num_xnodes; ++i)
      open += s.xpu[at(i)] == m && (s.begun & bit(i) & ~s.done) != 0;
    return open;
  }
  [[nodiscard]] bool full(const State& s, int m) const {
    return p_.levels[at(m)] != 0 && open_on(s, m) >= p_.levels[at(m)];
  }

  void explore(State s) {
    for (;;) {
      // An XNode that became ready needs an instance; unused ones of a kind are interchangeable.
      for (int i = 0; i < p_.num_xnodes; ++i) {
        if (!ready(s, i) || s.xpu[at(i)] >= 0) continue;
        for (int m = 0; m < p_.num_xpus; ++m) {
          if (p_.wcet_on(i, m) == kCannotRun) continue;
          bool twin = false;
          for (int k = 0; k < m && !s.used[at(m)]; ++k)
            twin = twin || (!s.used[at(k)] && same_kind(k, m));
          if (twin) continue;
          State next = s;
          next.xpu[at(i)] = m;
          next.left[at(i)] = p_.wcet_on(i, m);
          next.used[at(m)] = 1;
          explore(std::move(next));
        }
        return;
      }
      for (int i = 0; i < p_.num_xnodes; ++i)
        if (ready(s, i) && s.now + s.left[at(i)] + tail_[at(i)] >= best_.makespan) return;
      for (int m = 0; m < p_.num_xpus; ++m) {
        if (s.on[at(m)] >= 0 && (!p_.preemptive[at(m)] || full(s, m))) continue;
        std::uint32_t want = 0;
        for (int i = 0; i < p_.num_xnodes; ++i)
          if (s.xpu[at(i)] == m && ready(s, i)) want |= bit(i);
        if (want == 0) continue;
        int first = -1;
        bool known = false;
        for (int i = 0; i < p_.num_xnodes && !known; ++i) {
          if (!(want & bit(i))) continue;
          known = true;
          for (int j = 0; j < p_.num_xnodes; ++j)
            if ((want & bit(j)) && j != i && !(s.above[at(j)] & bit(i))) known = false;
          if (known) first = i;
        }
        if (!known) {
          for (int i = 0; i < p_.num_xnodes; ++i) {
            if (!(want & bit(i)) || (s.above[at(i)] & want)) continue;
            State next = s;
            put_above(next, i, want & ~bit(i));
            explore(std::move(next));
          }
          return;
        }
        if (first == s.on[at(m)]) continue;
        if (s.on[at(m)] >= 0 ||
            (p_.levels[at(m)] != 0 && (s.begun & bit(first)) == 0 && open_on(s, m) > 0))
          s.left[at(first)] += p_.preempt[at(m)];
        s.on[at(m)] = first;
        s.begun |= bit(first);
      }
      Time step = std::numeric_limits<Time>::max();
      for (const int i : s.on)
        if (i >= 0) step = std::min(step, s.left[at(i)]);
      if (step == std::numeric_limits<Time>::max()) break;
      s.now += step;
      for (int& i : s.on)
        if (i >= 0 && (s.left[at(i)] -= step) == 0) {
          s.done |= bit(i);
          i = -1;
        }
    }
    ++best_.paths;
    if (s.now >= best_.makespan) return;
    best_.makespan = s.now;
    std::vector<Time> key;
    for (int i = 0; i < p_.num_xnodes; ++i) key.push_back(__builtin_popcount(s.above[at(i)]));
    best_.decision.priority = priorities_by_key(key);
    best_.decision.xpu.assign(s.xpu.begin(), s.xpu.begin() + p_.num_xnodes);
  }

  void put_above(State& s, int i, std::uint32_t below) const {
    const std::uint32_t top = s.above[at(i)] | bit(i);
    for (int j = 0; j < p_.num_xnodes; ++j)
      if ((below & bit(j)) || (s.above[at(j)] & below)) s.above[at(j)] |= top;
  }

  const Problem& p_;
  std::vector<Time> tail_;
  BruteForceAnswer best_;
};

inline BruteForceAnswer brute_force(const Problem& problem) {
  return BruteForce(problem).run();
}

inline BruteForceAnswer enumerate_everything(const Problem& p) {
  BruteForceAnswer best;
  const auto n = static_cast<std::size_t>(p.num_xnodes);
  Decision d;
  d.xpu.assign(n, 0);
  for (;;) {
    bool legal = true;
    for (std::size_t i = 0; i < n; ++i)
      legal = legal && p.wcet_on(static_cast<int>(i), d.xpu[i]) != kCannotRun;
    d.priority.resize(n);
    std::iota(d.priority.begin(), d.priority.end(), 1);
    while (legal) {
      const Time makespan = naive_simulate(p, d).makespan;
      ++best.paths;
      if (makespan < best.makespan) {
        best.makespan = makespan;
        best.decision = d;
      }
      if (!std::next_permutation(d.priority.begin(), d.priority.end())) break;
    }
    std::size_t k = 0;
    while (k < n && ++d.xpu[k] == p.num_xpus) d.xpu[k++] = 0;
    if (k == n) return best;
  }
}

/// Every assignment, every XNode waiting for at most one other one of its XPU, every priority
/// order.
class PolicyBruteForce {
 public:
  explicit PolicyBruteForce(const Problem& problem)
      : p_(problem), n_(at(problem.num_xnodes)), xpu_(n_, -1), waits_for_(n_, -1) {
    for (auto it = p_.topo.rbegin(); it != p_.topo.rend(); ++it)
      for (const int s : p_.succ[at(*it)]) behind_[at(*it)] |= bit(s) | behind_[at(s)];
  }

  BruteForceAnswer run() {
    best_ = BruteForce(p_).run();
    assign(0);
    return best_;
  }

 private:
  static std::uint32_t bit(int i) { return 1U << i; }

  void assign(std::size_t i) {
    if (i == n_) return hold(0);
    for (int m = 0; m < p_.num_xpus; ++m) {
      if (p_.wcet_on(static_cast<int>(i), m) == kCannotRun || has_unused_twin(i, m)) continue;
      xpu_[i] = m;
      assign(i + 1);
    }
  }

  /// An instance like `m`, before it, that nobody has yet: the same again.
  [[nodiscard]] bool has_unused_twin(std::size_t i, int m) const {
    const auto is_used = [&](int x) {
      return std::find(xpu_.begin(), xpu_.begin() + static_cast<std::ptrdiff_t>(i), x) !=
             xpu_.begin() + static_cast<std::ptrdiff_t>(i);
    };
    if (is_used(m)) return false;
    for (int k = 0; k < m; ++k)
      if (p_.xpu_type[at(k)] == p_.xpu_type[at(m)] &&
          p_.preemptive[at(k)] == p_.preemptive[at(m)] && p_.preempt[at(k)] == p_.preempt[at(m)] &&
          p_.levels[at(k)] == p_.levels[at(m)] && p_.forbidden.empty() && !is_used(k))
        return true;
    return false;
  }

  void hold(std::size_t v) {
    if (v == n_) return simulate_all();
    waits_for_[v] = -1;
    hold(v + 1);
    for (std::size_t u = 0; u < n_; ++u) {
      const int a = static_cast<int>(u), b = static_cast<int>(v);
      if (u == v || xpu_[u] != xpu_[v] || (behind_[u] & bit(b)) || (behind_[v] & bit(a))) continue;
      waits_for_[v] = a;
      hold(v + 1);
    }
    waits_for_[v] = -1;
  }

  void simulate_all() {
    Problem held = p_;
    bool any = false;
    for (std::size_t v = 0; v < n_; ++v) {
      if (waits_for_[v] < 0) continue;
      any = true;
      held.pred[v].push_back(waits_for_[v]);
      held.succ[at(waits_for_[v])].push_back(static_cast<int>(v));
    }
    if (!any) return;  // done first, all assignments at once
    held.topo.clear();
    std::vector<std::size_t> missing;
    for (std::size_t i = 0; i < n_; ++i) {
      missing.push_back(held.pred[i].size());
      if (missing[i] == 0) held.topo.push_back(static_cast<int>(i));
    }
    for (std::size_t k = 0; k < held.topo.size(); ++k)
      for (const int s : held.succ[at(held.topo[k])])
        if (--missing[at(s)] == 0) held.topo.push_back(s);
    if (held.topo.size() < n_) return;  // waits for itself
    BruteForceAnswer answer = BruteForce(held).run(best_.makespan, xpu_);
    best_.paths += answer.paths;
    if (answer.makespan >= best_.makespan) return;
    best_.makespan = answer.makespan;
    best_.decision = std::move(answer.decision);
    for (std::size_t v = 0; v < n_; ++v)
      if (waits_for_[v] >= 0) best_.decision.order.emplace_back(waits_for_[v], static_cast<int>(v));
  }

  const Problem& p_;
  std::size_t n_;
  std::vector<int> xpu_, waits_for_;
  std::array<std::uint32_t, BruteForce::kMaxNodes> behind_{};
  BruteForceAnswer best_;
};

inline BruteForceAnswer brute_force_policies(const Problem& problem) {
  return PolicyBruteForce(problem).run();
}

/// Every assignment, every set of pairs on one XPU, every permutation of priorities. A set that
/// deadlocks is none.
inline BruteForceAnswer enumerate_policies(const Problem& p) {
  BruteForceAnswer best;
  const auto n = static_cast<std::size_t>(p.num_xnodes);
  Decision d;
  d.xpu.assign(n, 0);
  for (;;) {
    bool legal = true;
    for (std::size_t i = 0; i < n; ++i)
      legal = legal && p.wcet_on(static_cast<int>(i), d.xpu[i]) != kCannotRun;
    std::vector<std::pair<int, int>> pairs;
    for (int u = 0; u < p.num_xnodes; ++u)
      for (int v = 0; v < p.num_xnodes; ++v)
        if (u != v && d.xpu[static_cast<std::size_t>(u)] == d.xpu[static_cast<std::size_t>(v)])
          pairs.emplace_back(u, v);
    for (std::uint32_t set = 0; legal && set < (1U << pairs.size()); ++set) {
      d.order.clear();
      for (std::size_t k = 0; k < pairs.size(); ++k)
        if (set >> k & 1U) d.order.push_back(pairs[k]);
      d.priority.resize(n);
      std::iota(d.priority.begin(), d.priority.end(), 1);
      do {
        const NaiveSchedule schedule = naive_simulate(p, d);
        const bool hangs = std::any_of(schedule.finish.begin(), schedule.finish.end(),
                                       [](Time finish) { return finish < 0; });
        if (hangs) break;
        ++best.paths;
        if (schedule.makespan >= best.makespan) continue;
        best.makespan = schedule.makespan;
        best.decision = d;
      } while (std::next_permutation(d.priority.begin(), d.priority.end()));
    }
    std::size_t k = 0;
    while (k < n && ++d.xpu[k] == p.num_xpus) d.xpu[k++] = 0;
    if (k == n) return best;
  }
}

}  // namespace xauto::solver::test
