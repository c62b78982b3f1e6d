// SPDX-License-Identifier: Apache-2.0
// See exact.h.
#include "solver/exact.h"

#include <algorithm>
#include <bit>

#include "solver/bounds.h"
#include "solver/composite.h"
#include "solver/energy_lp.h"

namespace xauto::solver {
namespace {

std::size_t at(int index) {
  return static_cast<std::size_t>(index);
}

/// One attempt: is a makespan of at most T impossible?
class Refuter {
 public:
  /// `with_deadlines`: those of the goal must be met too.
  Refuter(const Problem& problem, const ProofControl& control, bool with_deadlines = false)
      : problem_(problem),
        control_(control),
        lp_(problem),
        n_(problem.num_xnodes),
        with_deadlines_(with_deadlines && !problem.goal.plain()) {
    // A large app's windows begin with what its load says; shaving finds that in a small one.
    if (n_ > kLarge) start_ = composite_bound(problem);
  }

  enum class Answer { kRefuted, kOpen };

  /// The last refute() met a leaf that nothing refutes, with nodes and time to spare.
  [[nodiscard]] bool met_open_leaf() const { return open_leaf_; }

  [[nodiscard]] bool stopped() const {
    return (control_.max_lps > 0 && lp_.solved() >= control_.max_lps) || control_.stopped();
  }

  Windows root(Time makespan) const {
    Windows windows;
    windows.r.assign(at(n_), 0);
    windows.d.assign(at(n_), makespan);
    windows.types.assign(at(n_), 0);
    windows.extra.assign(at(n_), 0);
    windows.paid.assign(at(n_), 0);
    windows.cut.assign(at(n_), 0);
    windows.starter.assign(at(n_), 0);
    for (int i = 0; i < n_; ++i)
      for (int t = 0; t < problem_.num_types; ++t)
        if (problem_.wcet(i, t) != kCannotRun && !problem_.type_xpus[at(t)].empty())
          windows.types[at(i)] |= 1u << t;
    for (const auto& group : problem_.groups) {
      std::uint32_t common = ~0u;
      for (int i : group) common &= windows.types[at(i)];
      for (int i : group) windows.types[at(i)] = common;
    }
    if (n_ > kLarge)
      for (int i = 0; i < n_; ++i) {
        windows.r[at(i)] = start_.heads[at(i)];
        windows.d[at(i)] = makespan - start_.tails[at(i)];
      }
    if (with_deadlines_)
      for (int i = 0; i < n_; ++i)
        windows.d[at(i)] = std::min(windows.d[at(i)], problem_.goal.deadline[at(i)]);
    return windows;
  }

  Answer refute(Time makespan, std::int64_t max_nodes, int shaving_rounds) {
    nodes_left_ = max_nodes;
    open_leaf_ = false;
    Windows windows = root(makespan);
    if (!tighten(windows) || !lp_.feasible(windows)) return Answer::kRefuted;
    for (int round = 0; round < shaving_rounds; ++round) {
      const int answer = shave(windows);
      if (answer < 0) return Answer::kRefuted;
      if (answer == 0) break;
    }
    if (max_nodes <= 1) return Answer::kOpen;
    return descend(windows, 0) ? Answer::kRefuted : Answer::kOpen;
  }

 private:
  /// Windows from the precedence graph, types from the windows; false: empty.
  bool tighten(Windows& w) const {
    bool again = true;
    while (again) {
      again = false;
      for (int i : problem_.topo) {
        Time& r = w.r[at(i)];
        for (int p : problem_.pred[at(i)]) r = std::max(r, w.r[at(p)] + least(w, p));
      }
      for (std::size_t k = problem_.topo.size(); k-- > 0;) {
        const int i = problem_.topo[k];
        Time& d = w.d[at(i)];
        for (int s : problem_.succ[at(i)]) d = std::min(d, w.d[at(s)] - least(w, s));
      }
      for (const auto& [i, j] : w.arcs) {
        again |= raise(w.r[at(j)], w.r[at(i)] + least(w, i));
        again |= lower(w.d[at(i)], w.d[at(j)] - least(w, j));
      }
      for (const auto& [i, j] : w.nested) {
        again |= raise(w.r[at(j)], w.r[at(i)] + 1);
        again |= lower(w.d[at(j)], w.d[at(i)] - 1);
      }
      for (int i = 0; i < n_; ++i) {
        std::uint32_t& types = w.types[at(i)];
        for (int t = 0; t < problem_.num_types; ++t) {
          if ((types >> t & 1u) == 0 ||
              w.r[at(i)] + problem_.wcet(i, t) + w.extra[at(i)] <= w.d[at(i)])
            continue;
          types &= ~(1u << t);
          again = true;
        }
        if (types == 0) return false;
      }
    }
    return true;
  }

  Time least(const Windows& w, int i) const {
    Time least = kNever;
    for (std::uint32_t types = w.types[at(i)]; types != 0; types &= types - 1)
      least = std::min(least, problem_.wcet(i, std::countr_zero(types)));
    return least + w.extra[at(i)];
  }

  static bool raise(Time& value, Time to) {
    if (to <= value) return false;
    value = to;
    return true;
  }
  static bool lower(Time& value, Time to) {
    if (to >= value) return false;
    value = to;
    return true;
  }

  /// How two XNodes of a type with one instance may share it; see docs/solver.md, "pairs".
  enum Relation : unsigned { kFirst = 1, kSecond = 2, kInFirst = 4, kInSecond = 8 };

  [[nodiscard]] unsigned relations(const Windows& w, int i, int j, int type) const {
    const int x = problem_.type_xpus[at(type)].front();
    const Time wi = problem_.wcet(i, type), wj = problem_.wcet(j, type);
    const Time di = wi + w.extra[at(i)], dj = wj + w.extra[at(j)];
    unsigned possible = 0;
    if (w.r[at(i)] + di + dj <= w.d[at(j)]) possible |= kFirst;
    if (w.r[at(j)] + di + dj <= w.d[at(i)]) possible |= kSecond;
    if (!problem_.preemptive[at(x)]) return possible;
    const Time cost = problem_.preempt[at(x)];
    // Under fixed priorities only what becomes ready after the other has started can suspend it.
    if (latest_ready(w, j) > w.r[at(i)] &&
        w.r[at(i)] + di + wj + cost - w.cut[at(i)] <= w.d[at(i)] &&
        std::max(w.r[at(i)] + 1, w.r[at(j)]) + dj < w.d[at(i)] && w.r[at(i)] + 1 + dj <= w.d[at(j)])
      possible |= kInFirst;
    if (latest_ready(w, i) > w.r[at(j)] &&
        w.r[at(j)] + dj + wi + cost - w.cut[at(j)] <= w.d[at(j)] &&
        std::max(w.r[at(j)] + 1, w.r[at(i)]) + di < w.d[at(j)] && w.r[at(j)] + 1 + di <= w.d[at(i)])
      possible |= kInSecond;
    return possible;
  }

  [[nodiscard]] Time latest_ready(const Windows& w, int i) const {
    Time latest = 0;
    for (int p : problem_.pred[at(i)]) latest = std::max(latest, w.d[at(p)]);
    return latest;
  }

  void relate(Windows& w, int i, int j, int type, Relation relation) const {
    const Time cost = problem_.preempt[at(problem_.type_xpus[at(type)].front())];
    switch (relation) {
      case kFirst:
        w.arcs.emplace_back(i, j);
        break;
      case kSecond:
        w.arcs.emplace_back(j, i);
        break;
      case kInFirst:
        w.nested.emplace_back(i, j);
        interrupt(w, i, problem_.wcet(j, type), cost);
        break;
      case kInSecond:
        w.nested.emplace_back(j, i);
        interrupt(w, j, problem_.wcet(i, type), cost);
        break;
    }
  }

  /// All that is nested in `outer` runs within its span, and the first suspension of it costs at
  /// least once.
  static void interrupt(Windows& w, int outer, Time inner_work, Time cost) {
    w.extra[at(outer)] += inner_work + cost - w.cut[at(outer)];
    w.paid[at(outer)] += cost - w.cut[at(outer)];
    w.cut[at(outer)] = cost;
  }

  /// Of those nested in one XNode, whoever starts first has suspended it, hence pays. So does one
  /// that starts after all earlier ones have ended: in between, the suspended one was back. Certain
  /// once no other XNode can join them: all types that could are decided, and all pairs.
  bool charge_starters(Windows& w) const {
    bool changed = false;
    for (int outer = 0; outer < n_; ++outer) {
      if (w.cut[at(outer)] == 0) continue;
      const int type = std::countr_zero(w.types[at(outer)]);
      bool open = false;
      for (int i = 0; i < n_ && !open; ++i)
        open = (w.types[at(i)] >> type & 1u) != 0 && !std::has_single_bit(w.types[at(i)]) &&
               w.r[at(i)] < w.d[at(outer)] && w.r[at(outer)] < w.d[at(i)];
      if (open) continue;
      const Time cost = w.cut[at(outer)];
      Time within = 0;
      bool first_known = false;
      for (const auto& [o, i] : w.nested) {
        if (o != outer) continue;
        within += problem_.wcet(i, type);
        bool first = true, pays = true;
        for (const auto& [o2, k] : w.nested) {
          if (o2 != outer || k == i || starts_before(w, i, k)) continue;
          first = false;  // k starts earlier, or may
          pays = pays && w.d[at(k)] < w.r[at(i)];
        }
        if (pays && w.starter[at(i)] == 0) {
          w.starter[at(i)] = 1;
          w.extra[at(i)] += cost;
          w.paid[at(i)] += cost;
          changed = true;
        }
        first_known = first_known || first;
        if (w.starter[at(i)] == 0) continue;
        within += cost;
        // It has started the moment it was ready, and only what is nested in it delays its end.
        Time end = latest_ready(w, i) + problem_.wcet(i, type) + cost;
        for (const auto& [o2, k] : w.nested)
          if (o2 == i) end += problem_.wcet(k, type) + cost;
        changed |= lower(w.d[at(i)], end);
      }
      if (!first_known) continue;
      // The XPU's loss now counts with those that suspend.
      w.paid[at(outer)] = w.starter[at(outer)] != 0 ? cost : 0;
      changed |= raise(w.extra[at(outer)], within + (w.starter[at(outer)] != 0 ? cost : 0));
    }
    return changed;
  }

  /// Once something is nested, the policy goes by fixed priorities alone, and no XPU idles while
  /// one of its XNodes is ready: from there to its end, i waits only for what may run in between.
  bool conserve_work(Windows& w) const {
    if (w.nested.empty()) return false;
    const auto is_nested = [&](int i) {
      return std::any_of(w.nested.begin(), w.nested.end(),
                         [&](const auto& pair) { return pair.second == i; });
    };
    const auto contains = [&](int outer, int i) {
      return std::find(w.nested.begin(), w.nested.end(), std::pair(outer, i)) != w.nested.end();
    };
    bool changed = false;
    for (int i = 0; i < n_; ++i) {
      if (!std::has_single_bit(w.types[at(i)])) continue;
      const int type = std::countr_zero(w.types[at(i)]);
      if (problem_.type_xpus[at(type)].size() != 1) continue;
      const Time cost = problem_.preempt[at(problem_.type_xpus[at(type)].front())];
      Time earliest = 0;
      for (int p : problem_.pred[at(i)]) earliest = std::max(earliest, w.r[at(p)] + least(w, p));
      Time end = latest_ready(w, i) + problem_.wcet(i, type) + (is_nested(i) ? cost : 0);
      for (int k = 0; k < n_; ++k) {
        if (k == i || (w.types[at(k)] >> type & 1u) == 0 || w.d[at(k)] <= earliest) continue;
        // Those behind i start after its end; the one it suspends has a lower priority.
        const bool decided = std::has_single_bit(w.types[at(k)]);
        if (decided && (contains(k, i) || (starts_before(w, i, k) && !contains(i, k)))) continue;
        end += problem_.wcet(k, type) + (!decided || is_nested(k) ? cost : 0);
      }
      changed |= lower(w.d[at(i)], end);
    }
    return changed;
  }

  [[nodiscard]] bool starts_before(const Windows& w, int k, int i) const {
    if (w.d[at(k)] <= w.r[at(i)]) return true;
    const auto has = [&](const std::vector<std::pair<int, int>>& list) {
      return std::find(list.begin(), list.end(), std::pair(k, i)) != list.end();
    };
    return has(w.arcs) || has(w.nested);
  }

  /// Pairs on one-instance types: decides those with one relation left; false: a pair has none.
  /// `open_*`: the tightest pair that is still open, -1 if all are decided.
  bool settle_pairs(Windows& w, int& open_i, int& open_j) const {
    bool again = true;
    while (again) {
      again = false;
      open_i = open_j = -1;
      Time tightest = kNever;
      for (int i = 0; i < n_; ++i) {
        if (!std::has_single_bit(w.types[at(i)])) continue;
        const int type = std::countr_zero(w.types[at(i)]);
        if (problem_.type_xpus[at(type)].size() != 1) continue;
        for (int j = i + 1; j < n_; ++j) {
          if (w.types[at(j)] != w.types[at(i)]) continue;
          if (w.r[at(j)] >= w.d[at(i)] || w.r[at(i)] >= w.d[at(j)]) continue;
          if (settled(w, i, j)) continue;
          const unsigned possible = relations(w, i, j, type);
          if (possible == 0) return false;
          if (std::has_single_bit(possible)) {
            relate(w, i, j, type, static_cast<Relation>(possible));
            if (!tighten(w)) return false;
            again = true;
            continue;
          }
          const Time room = std::max(w.d[at(i)], w.d[at(j)]) - std::min(w.r[at(i)], w.r[at(j)]) -
                            problem_.wcet(i, type) - problem_.wcet(j, type);
          if (room < tightest) {
            tightest = room;
            open_i = i;
            open_j = j;
          }
        }
      }
    }
    return true;
  }

  static bool settled(const Windows& w, int i, int j) {
    const auto has = [&](const std::vector<std::pair<int, int>>& list) {
      return std::any_of(list.begin(), list.end(), [&](const std::pair<int, int>& pair) {
        return (pair.first == i && pair.second == j) || (pair.first == j && pair.second == i);
      });
    };
    return has(w.arcs) || has(w.nested);
  }

  bool dead(Windows& w) { return !tighten(w) || !lp_.feasible(w); }

  /// All predecessors of `i` done by `t` / `i` cannot start before `t`: the two halves of a split.
  void ready_by(Windows& w, int i, Time t) const {
    for (int p : problem_.pred[at(i)]) w.d[at(p)] = std::min(w.d[at(p)], t);
  }
  void done_by_others(Windows& w, int i, Time t) const {
    for (int s : problem_.succ[at(i)]) w.r[at(s)] = std::max(w.r[at(s)], t);
  }

  /// Shaving: assume the extreme part of a window, refute it, cut it off. -1 refuted, 1 changed, 0
  /// not.
  int shave(Windows& w) {
    bool changed = false;
    for (int i = 0; i < n_; ++i) {
      if (stopped()) return 0;
      for (int t = 0; t < problem_.num_types; ++t) {
        if (std::has_single_bit(w.types[at(i)]) || (w.types[at(i)] >> t & 1u) == 0) continue;
        Windows trial = w;
        trial.types[at(i)] = 1u << t;
        if (!dead(trial)) continue;
        w.types[at(i)] &= ~(1u << t);
        changed = true;
        if (!tighten(w)) return -1;
      }
    }
    for (int i : problem_.topo) {
      if (stopped()) return 0;
      const int answer = shave_head(w, i);
      if (answer < 0) return -1;
      changed = changed || answer > 0;
    }
    for (std::size_t k = problem_.topo.size(); k-- > 0;) {
      if (stopped()) return 0;
      const int answer = shave_tail(w, problem_.topo[k]);
      if (answer < 0) return -1;
      changed = changed || answer > 0;
    }
    return changed ? 1 : 0;
  }

  int shave_head(Windows& w, int i) {
    if (problem_.pred[at(i)].size() < 2) return 0;
    Time lo = w.r[at(i)], hi = w.d[at(i)] - least(w, i);
    const Time resolution = std::max<Time>(1, (hi - lo) / 64);
    const Time before = lo;
    // Largest t such that "ready by t" is refuted; then r >= t + 1.
    Time step = std::max<Time>(resolution, (hi - lo) / 8);
    while (lo <= hi) {
      const Time t = std::min(hi, lo + step - 1);
      Windows trial = w;
      ready_by(trial, i, t);
      if (dead(trial)) {
        lo = t + 1;
      } else if (step > resolution) {
        step = std::max(resolution, step / 4);
      } else {
        break;
      }
    }
    if (lo == before) return 0;
    w.r[at(i)] = lo;
    return tighten(w) ? 1 : -1;
  }

  int shave_tail(Windows& w, int i) {
    if (problem_.succ[at(i)].size() < 2) return 0;
    Time lo = w.r[at(i)] + least(w, i), hi = w.d[at(i)];
    const Time resolution = std::max<Time>(1, (hi - lo) / 64);
    const Time before = hi;
    Time step = std::max<Time>(resolution, (hi - lo) / 8);
    while (lo <= hi) {
      const Time t = std::max(lo, hi - step + 1);
      Windows trial = w;
      done_by_others(trial, i, t);
      if (dead(trial)) {
        hi = t - 1;
      } else if (step > resolution) {
        step = std::max(resolution, step / 4);
      } else {
        break;
      }
    }
    if (hi == before) return 0;
    w.d[at(i)] = hi;
    return tighten(w) ? 1 : -1;
  }

  /// True: refuted. False: open, or out of nodes or time; the whole attempt has then failed.
  bool descend(Windows& w, int depth) {
    if (depth > 400) open_leaf_ = true;  // as good as: a larger budget ends here again
    if (--nodes_left_ < 0 || stopped() || depth > 400) return false;
    int open_i = -1, open_j = -1;
    if (!tighten(w) || !settle_pairs(w, open_i, open_j)) return true;
    while (open_i < 0 && (charge_starters(w) || conserve_work(w)))
      if (!tighten(w) || !settle_pairs(w, open_i, open_j)) return true;
    if (!lp_.feasible(w)) return true;
    // The XNode whose type is least decided, by the work that hangs on it.
    int branch = -1, type = -1;
    double best = 1e-6;
    for (int i = 0; i < n_; ++i) {
      if (std::has_single_bit(w.types[at(i)])) continue;
      double top = 0;
      int top_type = 0;
      Time low = kNever, high = 0;
      for (std::uint32_t types = w.types[at(i)]; types != 0; types &= types - 1) {
        const int t = std::countr_zero(types);
        low = std::min(low, problem_.wcet(i, t));
        high = std::max(high, problem_.wcet(i, t));
        if (lp_.share(i, t) > top) {
          top = lp_.share(i, t);
          top_type = t;
        }
      }
      const double score = (1 - top) * static_cast<double>(high);
      if (score > best) {
        best = score;
        branch = i;
        type = top_type;
      }
    }
    if (branch >= 0) {
      Windows yes = w;
      yes.types[at(branch)] = 1u << type;
      if (!descend(yes, depth + 1)) return false;
      w.types[at(branch)] &= ~(1u << type);
      return descend(w, depth + 1);
    }
    // The LP's answer is whole: decide a type whose alternatives keep a window looser than it may
    // be.
    Time looseness = 0;
    for (int i = 0; i < n_; ++i) {
      if (std::has_single_bit(w.types[at(i)])) continue;
      for (std::uint32_t types = w.types[at(i)]; types != 0; types &= types - 1) {
        const int t = std::countr_zero(types);
        if (lp_.share(i, t) < 0.5) continue;
        const Time gain = 1 + problem_.wcet(i, t) - least(w, i);
        if (gain <= looseness) continue;
        looseness = gain;
        branch = i;
        type = t;
      }
    }
    if (branch >= 0) {
      Windows yes = w;
      yes.types[at(branch)] = 1u << type;
      if (!descend(yes, depth + 1)) return false;
      w.types[at(branch)] &= ~(1u << type);
      return descend(w, depth + 1);
    }
    if (open_i >= 0) {
      const int shared = std::countr_zero(w.types[at(open_i)]);
      const unsigned possible = relations(w, open_i, open_j, shared);
      for (const Relation relation : {kFirst, kSecond, kInFirst, kInSecond}) {
        if ((possible & relation) == 0) continue;
        Windows child = w;
        relate(child, open_i, open_j, shared, relation);
        if (!descend(child, depth + 1)) return false;
      }
      return true;
    }
    // Split when an XNode becomes ready: its predecessors are all done by the middle, or it cannot
    // start before. Each half is narrower, so that this ends.
    Time widest = 0;
    for (int i = 0; i < n_; ++i) {
      const Time width = latest_ready(w, i) - w.r[at(i)];
      if (width <= widest) continue;
      widest = width;
      branch = i;
    }
    if (branch < 0) {
      open_leaf_ = true;
      return false;
    }
    const Time middle = w.r[at(branch)] + (widest - 1) / 2;
    Windows early = w;
    ready_by(early, branch, middle);
    if (!descend(early, depth + 1)) return false;
    w.r[at(branch)] = middle + 1;
    return descend(w, depth + 1);
  }

  const Problem& problem_;
  const ProofControl& control_;
  EnergyLp lp_;
  int n_;
  CompositeBound start_;
  bool with_deadlines_;
  std::int64_t nodes_left_ = 0;
  bool open_leaf_ = false;
};

/// The same problem with each instance of a two-instance type as a type of its own: branching on
/// types then decides instances, and pairs are decided on each. WCETs are those of the type.
Problem per_instance(const Problem& problem) {
  Problem split = problem;
  split.num_types = 0;
  split.type_name.clear();
  split.type_xpus.clear();
  std::vector<int> from;
  for (int t = 0; t < problem.num_types; ++t) {
    const auto& xpus = problem.type_xpus[at(t)];
    const bool apart = xpus.size() == 2;
    for (std::size_t k = 0; k < (apart ? 2 : 1); ++k) {
      split.type_name.push_back(problem.type_name[at(t)]);
      split.type_xpus.push_back(apart ? std::vector<int>{xpus[k]} : xpus);
      for (int x : split.type_xpus.back()) split.xpu_type[at(x)] = split.num_types;
      ++split.num_types;
      from.push_back(t);
    }
  }
  split.wcet_flat.assign(at(problem.num_xnodes) * from.size(), kCannotRun);
  for (int i = 0; i < problem.num_xnodes; ++i)
    for (std::size_t t = 0; t < from.size(); ++t)
      split.wcet_flat[at(i) * from.size() + t] = problem.wcet(i, from[t]);
  return split;
}

/// A node budget that no clock lets be used up; rounds that end early would otherwise overflow it.
constexpr std::int64_t kMostNodes = std::int64_t{1} << 50;

}  // namespace

bool deadlines_refuted(const Problem& problem, Time makespan_limit, const ProofControl& control) {
  if (problem.num_types > 16) return false;
  Refuter refuter(problem, control, true);
  for (std::int64_t nodes = 1; !refuter.stopped(); nodes = std::min(kMostNodes, nodes * 4 + 100)) {
    if (refuter.refute(makespan_limit, nodes, nodes > 1 ? 2 : 0) == Refuter::Answer::kRefuted)
      return true;
    if (refuter.met_open_leaf()) return false;
  }
  return false;
}

Time prove_bound(const Problem& problem, const ProofControl& control) {
  Time bound = std::max(control.known_bound, quick_bound(problem));
  if (problem.num_types > 16) return bound;
  Refuter refuter(problem, control);
  auto raise = [&](Time refuted) {
    if (refuted + 1 <= bound) return;
    bound = refuted + 1;
    if (control.on_bound) control.on_bound(bound);
  };
  auto incumbent = [&] { return control.incumbent->load(std::memory_order_relaxed); };
  using Answer = Refuter::Answer;

  // 1. At the root alone: bisect for the largest makespan that is refuted, first without shaving.
  for (int shaving : {0, 1, 3}) {
    Time hi = incumbent() - 1;
    Time lo = bound;
    while (lo <= hi && !refuter.stopped()) {
      // The likeliest end first: a proof of optimality.
      const Time t = hi == incumbent() - 1 ? hi : lo + (hi - lo) / 2;
      if (hi - lo < std::max<Time>(1, hi / 2000) && t != incumbent() - 1) break;
      if (refuter.refute(t, 1, shaving) == Answer::kRefuted) {
        raise(t);
        lo = t + 1;
      } else {
        hi = t - 1;
      }
    }
  }
  // 2. With branching: ever more nodes, ever closer guesses.
  const Problem split = per_instance(problem);
  Refuter apart(split, control);
  const bool has_pairs_of_instances = split.num_types > problem.num_types && split.num_types <= 16;
  std::int64_t nodes = 200;
  while (!refuter.stopped() && bound < incumbent()) {
    bool any = false, more_nodes_help = false;
    for (const double part : {1.0, 0.5, 0.25, 0.1}) {
      if (refuter.stopped() || bound >= incumbent()) break;
      const Time gap = incumbent() - bound;
      const Time t =
          bound + std::max<Time>(0, static_cast<Time>(part * static_cast<double>(gap)) - 1);
      bool refuted = refuter.refute(t, nodes, 2) == Answer::kRefuted;
      bool ended = refuter.met_open_leaf();
      if (!refuted && has_pairs_of_instances && !refuter.stopped()) {
        refuted = apart.refute(t, nodes, 2) == Answer::kRefuted;
        ended = ended && apart.met_open_leaf();
      }
      more_nodes_help = more_nodes_help || !ended;
      if (refuted) {
        raise(t);
        any = true;
        break;
      }
    }
    if (any) continue;
    if (!more_nodes_help) break;
    nodes = std::min(kMostNodes, nodes * 3);
  }
  return bound;
}

}  // namespace xauto::solver
