// SPDX-License-Identifier: Apache-2.0
// The rule of problem.h, event by event: the next event is the earliest end of a running XNode.
#include "solver/simulate.h"

#include <algorithm>
#include <limits>
#include <queue>
#include <utility>

#include "base/index.h"

namespace xauto::solver {
namespace {

constexpr Time kNoEvent = std::numeric_limits<Time>::max();

class Run {
 public:
  Run(const Problem& problem, const Decision& decision, const SimulateOptions& options)
      : p_(problem), d_(decision), options_(options) {
    const std::size_t n = at(p_.num_xnodes);
    waits_for_.assign(n, 0);
    left_.resize(n);
    result_.xpu = d_.xpu;
    result_.start.assign(n, -1);
    result_.finish.assign(n, 0);
    order_succ_.resize(n);
    for (std::size_t i = 0; i < n; ++i) {
      waits_for_[i] = static_cast<int>(p_.pred[i].size());
      left_[i] =
          options_.actual.empty() ? p_.wcet_on(static_cast<int>(i), d_.xpu[i]) : options_.actual[i];
    }
    // An order predecessor holds an XNode back exactly as a precedence does: it is not eligible
    // before.
    for (const auto& [u, v] : d_.order) {
      order_succ_[at(u)].push_back(v);
      ++waits_for_[at(v)];
    }
    ready_.resize(at(p_.num_xpus));
    running_.assign(at(p_.num_xpus), -1);
    since_.assign(at(p_.num_xpus), 0);
    switching_.assign(n, 0);
    open_.assign(at(p_.num_xpus), 0);
  }

  Simulation run() {
    for (int i = 0; i < p_.num_xnodes; ++i)
      if (waits_for_[at(i)] == 0) wait(i);
    Time now = 0;
    for (;;) {
      // Everything that ends now ends before anybody decides. What takes no time (an actual
      // execution time of 0) ends at the instant it is put on its XPU, hence the loop.
      do {
        for (int m = 0; m < p_.num_xpus; ++m) decide(m, now);
      } while (complete(now));
      Time next = kNoEvent;
      for (int m = 0; m < p_.num_xpus; ++m)
        if (running_[at(m)] >= 0) next = std::min(next, since_[at(m)] + left_[at(running_[at(m)])]);
      if (next == kNoEvent) break;
      now = next;
      complete(now);
    }
    for (const Time finish : result_.finish) result_.makespan = std::max(result_.makespan, finish);
    return std::move(result_);
  }

 private:
  /// Ends what is due at `now`; true if anything ended.
  bool complete(Time now) {
    bool any = false;
    for (int m = 0; m < p_.num_xpus; ++m) {
      const int i = running_[at(m)];
      if (i < 0 || since_[at(m)] + left_[at(i)] > now) continue;
      put_off(m, now);
      result_.finish[at(i)] = now;
      --open_[at(m)];
      any = true;
      for (const int s : p_.succ[at(i)]) release(s);
      for (const int s : order_succ_[at(i)]) release(s);
    }
    return any;
  }

  void release(int i) {
    if (--waits_for_[at(i)] == 0) wait(i);
  }

  void wait(int i) { ready_[at(d_.xpu[at(i)])].emplace(d_.priority[at(i)], i); }

  void decide(int m, Time now) {
    auto& ready = ready_[at(m)];
    if (ready.empty()) return;
    const int current = running_[at(m)];
    if (current >= 0 && !p_.preemptive[at(m)]) return;
    if (current >= 0 && p_.levels[at(m)] > 0 && open_[at(m)] >= p_.levels[at(m)]) return;
    const int i = ready.top().second;
    if (current >= 0 && d_.priority[at(i)] <= d_.priority[at(current)]) return;
    ready.pop();
    const bool first = result_.start[at(i)] < 0;
    if (current >= 0) {
      put_off(m, now);
      wait(current);
    }
    if (current >= 0 || (p_.levels[at(m)] > 0 && open_[at(m)] > 0 && first)) {
      left_[at(i)] += p_.preempt[at(m)];
      switching_[at(i)] += p_.preempt[at(m)];
      ++result_.preemptions;
    }
    running_[at(m)] = i;
    since_[at(m)] = now;
    if (first) {
      result_.start[at(i)] = now;
      ++open_[at(m)];
    }
  }

  /// Takes the running XNode off its XPU and accounts for what it did.
  void put_off(int m, Time now) {
    const int i = running_[at(m)];
    const Time ran = now - since_[at(m)];
    left_[at(i)] -= ran;
    if (options_.slices && ran > 0) {
      // What the preemption costs comes first.
      const Time cost = std::min(ran, switching_[at(i)]);
      switching_[at(i)] -= cost;
      if (cost > 0) result_.slices.push_back({i, m, since_[at(m)], since_[at(m)] + cost, true});
      if (ran > cost) result_.slices.push_back({i, m, since_[at(m)] + cost, now, false});
    }
    running_[at(m)] = -1;
  }

  const Problem& p_;
  const Decision& d_;
  const SimulateOptions& options_;
  Simulation result_;
  std::vector<int> waits_for_;
  std::vector<Time> left_;
  std::vector<std::vector<int>> order_succ_;
  /// [xpu] most urgent first, (priority, XNode)
  std::vector<std::priority_queue<std::pair<std::int64_t, int>>> ready_;
  std::vector<int> running_;     ///< [xpu] XNode or -1
  std::vector<Time> since_;      ///< [xpu] when the running XNode was put on
  std::vector<int> open_;        ///< [xpu] of its XNodes, how many have started and not ended
  std::vector<Time> switching_;  ///< [xnode] preemption cost still to be paid
};

}  // namespace

Simulation simulate(const Problem& problem, const Decision& decision,
                    const SimulateOptions& options) {
  return Run(problem, decision, options).run();
}

}  // namespace xauto::solver
