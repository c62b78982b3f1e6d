// SPDX-License-Identifier: Apache-2.0
// The shortest fixed-priority execution over all assignments and all priority orders, by
// exhaustion.
//
// Two of them: `enumerate_everything` writes down every assignment and every permutation and
// simulates each (up to 5 XNodes), `brute_force` decides only when the execution needs a decision:
// the instance when an XNode becomes ready, and who is more urgent when two of them want one XPU.
// Decisions are kept as a transitively closed relation, so that each path is an execution under one
// fixed priority order. Run-time order pairs are not searched. A test compares the two.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <limits>
#include <numeric>
#include <vector>

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
  static constexpr int kMaxNodes = 16;

  explicit BruteForce(const Problem& problem) : p_(problem), tail_(problem.pred.size(), 0) {
    for (auto it = p_.topo.rbegin(); it != p_.topo.rend(); ++it)
      for (const int s : p_.succ[at(*it)])
        tail_[at(*it)] = std::max(tail_[at(*it)], tail_[at(s)] + least(s));
  }

  BruteForceAnswer run() {
    State s;
    s.xpu.fill(-1);
    s.on.assign(at(p_.num_xpus), -1);
    s.used.assign(at(p_.num_xpus), 0);
    explore(s);
    return best_;
  }

 private:
  struct State {
    Time now = 0;
    std::uint32_t done = 0;
    std::array<int, kMaxNodes> xpu{};
    std::array<Time, kMaxNodes> left{};
    std::array<std::uint32_t, kMaxNodes>
        above{};  ///< those that are more urgent, transitively closed
    std::vector<int> on;
    std::vector<char> used;
  };

  static std::size_t at(int i) { return static_cast<std::size_t>(i); }
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
           p_.preemptive[at(a)] == p_.preemptive[at(b)] && p_.preempt[at(a)] == p_.preempt[at(b)];
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
        if (s.on[at(m)] >= 0 && !p_.preemptive[at(m)]) continue;
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
        if (s.on[at(m)] >= 0) s.left[at(first)] += p_.preempt[at(m)];
        s.on[at(m)] = first;
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

}  // namespace xauto::solver::test
