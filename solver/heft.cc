// SPDX-License-Identifier: Apache-2.0
#include "solver/heft.h"

#include <algorithm>
#include <numeric>

#include "base/index.h"

namespace xauto::solver {
namespace {

/// Mean WCET over the instances it can run on, in units of 1/num_xpus us: integers keep ties exact.
std::vector<Time> upward_ranks(const Problem& p) {
  std::vector<Time> rank(at(p.num_xnodes), 0);
  for (auto it = p.topo.rbegin(); it != p.topo.rend(); ++it) {
    const int i = *it;
    Time sum = 0, count = 0, tail = 0;
    for (int m = 0; m < p.num_xpus; ++m)
      if (p.wcet_on(i, m) != kCannotRun) {
        sum += p.wcet_on(i, m);
        ++count;
      }
    for (const int s : p.succ[at(i)]) tail = std::max(tail, rank[at(s)]);
    rank[at(i)] = sum * p.num_xpus / count + tail;
  }
  return rank;
}

/// XNodes by descending rank, precedence kept among equals.
std::vector<int> by_rank(const Problem& p) {
  const std::vector<Time> rank = upward_ranks(p);
  std::vector<int> order = p.topo;
  std::stable_sort(order.begin(), order.end(),
                   [&](int a, int b) { return rank[at(a)] > rank[at(b)]; });
  return order;
}

class Insertion {
 public:
  Insertion(const Problem& p, const Until& until)
      : p_(p), until_(until), busy_(at(p.num_xpus)), finish_(at(p.num_xnodes), 0) {
    decision_.xpu.assign(at(p.num_xnodes), -1);
    start_.assign(at(p.num_xnodes), 0);
  }

  /// Puts `i` on the one of `xpus` where it finishes first.
  void place(int i, const std::vector<int>& xpus) {
    hurry_ = hurry_ || (++placed_ % 64 == 0 && until_.over());
    Time ready = 0;
    for (const int u : p_.pred[at(i)]) ready = std::max(ready, finish_[at(u)]);
    int best = -1;
    Time best_start = 0, best_finish = 0;
    for (const int m : xpus) {
      const Time wcet = p_.wcet_on(i, m);
      if (wcet == kCannotRun) continue;
      const Time start = first_gap(m, ready, wcet);
      if (best < 0 || start + wcet < best_finish) {
        best = m;
        best_start = start;
        best_finish = start + wcet;
      }
    }
    decision_.xpu[at(i)] = best;
    start_[at(i)] = best_start;
    finish_[at(i)] = best_finish;
    auto& busy = busy_[at(best)];
    busy.insert(std::upper_bound(busy.begin(), busy.end(), std::pair(best_start, best_finish)),
                {best_start, best_finish});
  }

  Decision decision() {
    decision_.priority = priorities_by_key(start_);
    return std::move(decision_);
  }

 private:
  [[nodiscard]] Time first_gap(int m, Time ready, Time wcet) const {
    const auto& busy = busy_[at(m)];
    if (busy.empty()) return ready;
    if (hurry_) return std::max(ready, busy.back().second);
    // Apart from each other, they end in the order in which they begin.
    auto next = std::upper_bound(busy.begin(), busy.end(), ready,
                                 [](Time time, const auto& span) { return time < span.second; });
    Time start = ready;
    for (; next != busy.end() && start + wcet > next->first; ++next)
      start = std::max(start, next->second);
    return start;
  }

  const Problem& p_;
  const Until until_;
  bool hurry_ = false;  ///< no gaps any more
  int placed_ = 0;
  std::vector<std::vector<std::pair<Time, Time>>> busy_;  ///< [xpu] by begin
  std::vector<Time> start_, finish_;
  Decision decision_;
};

}  // namespace

Decision heft(const Problem& problem, const Until& until) {
  std::vector<int> all(at(problem.num_xpus));
  std::iota(all.begin(), all.end(), 0);
  Insertion insertion(problem, until);
  for (const int i : by_rank(problem)) insertion.place(i, all);
  return insertion.decision();
}

Decision local(const Problem& problem, const Until& until) {
  Insertion insertion(problem, until);
  for (const int i : by_rank(problem)) {
    int fastest = -1;
    for (int t = 0; t < problem.num_types; ++t)
      if (problem.wcet(i, t) != kCannotRun &&
          (fastest < 0 || problem.wcet(i, t) < problem.wcet(i, fastest)))
        fastest = t;
    insertion.place(i, problem.type_xpus[at(fastest)]);
  }
  return insertion.decision();
}

}  // namespace xauto::solver
