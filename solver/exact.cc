// SPDX-License-Identifier: Apache-2.0
// See exact.h.
#include "solver/exact.h"

#include <algorithm>
#include <bit>
#include <iterator>
#include <map>
#include <set>

#include "base/index.h"
#include "solver/bounds.h"
#include "solver/composite.h"
#include "solver/energy_lp.h"
#include "solver/evaluate.h"
#include "solver/instance_fit.h"
#include "solver/one_machine.h"
#include "solver/rules.h"

namespace xauto::solver {
namespace {

/// One attempt: is a makespan of at most T impossible?
class Refuter : private Rules {
 public:
  Refuter(const Problem& problem, const ProofControl& control)
      : Rules(problem),
        control_(control),
        lp_(problem, [&control] { return control.stopped(); }),
        machine_(problem),
        fit_(problem),
        evaluator_(problem),
        weight_(at(problem.num_xnodes), 1.0) {
    // A large app's windows begin with what its load says; shaving finds that in a small one.
    if (n_ > kLarge) start_ = composite_bound(problem, 1, {control.deadline, control.stop});
  }

  enum class Answer { kRefuted, kOpen };

  /// What is branched on first once all types are decided: the instance of an XNode, or pairs. Where
  /// instances are short of room pairs first is a tree without end, and the other way round where
  /// pairs are what is tight.
  void take_turns() { pairs_first_ = !pairs_first_; }
  [[nodiscard]] bool pairs_first() const { return pairs_first_; }

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
    windows.place.assign(at(n_), -1);
    for (int i = 0; i < n_; ++i)
      for (int t = 0; t < problem_.num_types; ++t)
        if (problem_.wcet(i, t) != kCannotRun && !problem_.type_xpus[at(t)].empty())
          windows.types[at(i)] |= TypeSet{1} << t;
    for (const auto& group : problem_.groups) {
      TypeSet common = ~TypeSet{0};
      for (int i : group) common &= windows.types[at(i)];
      for (int i : group) windows.types[at(i)] = common;
    }
    if (n_ > kLarge)
      for (int i = 0; i < n_; ++i) {
        windows.r[at(i)] = start_.heads[at(i)];
        windows.d[at(i)] = makespan - start_.tails[at(i)];
      }
    return windows;
  }

  Answer refute(Time makespan, std::int64_t max_nodes, int shaving_rounds) {
    nodes_left_ = max_nodes;
    open_leaf_ = false;
    guess_ = makespan;
    decided_ = -1;
    Windows windows = root(makespan);
    const auto known = known_.lower_bound(makespan);
    if (known != known_.end()) narrow(windows, known->second.windows);
    if (!tighten(windows) || !lp_.feasible(windows)) return Answer::kRefuted;
    bool settled = known != known_.end() && known->first == makespan && known->second.settled;
    for (int round = 0; round < shaving_rounds && !settled; ++round) {
      const int answer = shave(windows);
      if (answer < 0) return Answer::kRefuted;
      settled = answer == 0 && !stopped();
      if (answer == 0) break;
    }
    if (shaving_rounds > 0) remember(makespan, windows, settled);
    if (max_nodes <= 1) return Answer::kOpen;
    return descend(windows, 0) ? Answer::kRefuted : Answer::kOpen;
  }

 private:
  /// What shaving has left for a makespan; it holds for all shorter ones, too.
  struct Known {
    Windows windows;
    bool settled = false;  ///< another round would leave the same
  };

  static void narrow(Windows& w, const Windows& by) {
    for (std::size_t i = 0; i < w.r.size(); ++i) {
      w.r[i] = std::max(w.r[i], by.r[i]);
      w.d[i] = std::min(w.d[i], by.d[i]);
      w.types[i] &= by.types[i];
    }
  }

  void remember(Time makespan, const Windows& windows, bool settled) {
    constexpr std::size_t kMost = 16;
    known_.insert_or_assign(makespan, Known{windows, settled});
    if (known_.size() > kMost) known_.erase(std::prev(known_.end()));
  }

  /// Windows from the precedence graph and from each instance, until neither changes them.
  bool narrow(Windows& w) {
    for (;;) {
      if (!tighten(w)) return false;
      const OneMachine::Answer answer = machine_.narrow(w);
      if (answer != OneMachine::Answer::kNarrowed) return answer == OneMachine::Answer::kSame;
    }
  }

  bool dead(Windows& w) { return !narrow(w) || !lp_.feasible(w); }

  /// Shaving: assume the extreme part of a window, refute it, cut it off. -1 refuted, 1 changed, 0
  /// not.
  int shave(Windows& w) {
    bool changed = false;
    for (int i = 0; i < n_; ++i) {
      if (stopped()) return 0;
      for (int t = 0; t < problem_.num_types; ++t) {
        if (std::has_single_bit(w.types[at(i)]) || (w.types[at(i)] >> t & 1u) == 0) continue;
        Windows trial = w;
        trial.types[at(i)] = TypeSet{1} << t;
        if (!dead(trial)) continue;
        w.types[at(i)] &= ~(TypeSet{1} << t);
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

  bool dead_end(Windows& w, int& open_i, int& open_j) {
    if (!narrow(w) || !settle_pairs(w, open_i, open_j)) return true;
    for (;;) {
      const bool charged = charge_starters(w);
      if (!end_as_ready(w) && !charged) break;
      if (!narrow(w) || !settle_pairs(w, open_i, open_j)) return true;
    }
    return !lp_.feasible(w) || !fit_.possible(w, kSteps);
  }

  /// Both halves: `xnode` is of this type; it is not.
  bool decide(Windows& w, int xnode, int type, int depth) {
    Windows yes = w;
    yes.types[at(xnode)] = TypeSet{1} << type;
    decided_ = xnode;
    if (!descend(yes, depth + 1)) return false;
    w.types[at(xnode)] &= ~(TypeSet{1} << type);
    decided_ = xnode;
    return descend(w, depth + 1);
  }

  /// A type that is to be decided for an XNode; -1: none.
  struct Choice {
    int xnode = -1, type = -1;
  };

  /// The XNode whose type is least decided, by the work that hangs on it.
  [[nodiscard]] Choice least_decided(const Windows& w) const {
    Choice choice;
    double best = 1e-6;
    for (int i = 0; i < n_; ++i) {
      if (std::has_single_bit(w.types[at(i)])) continue;
      double top = 0;
      int top_type = 0;
      Time high = 0;
      for (TypeSet types = w.types[at(i)]; types != 0; types &= types - 1) {
        const int t = std::countr_zero(types);
        high = std::max(high, problem_.wcet(i, t));
        if (lp_.share(i, t) > top) {
          top = lp_.share(i, t);
          top_type = t;
        }
      }
      const double score = weight_[at(i)] * (1 - top) * static_cast<double>(high);
      if (score > best) {
        best = score;
        choice = {i, top_type};
      }
    }
    return choice;
  }

  /// Where the LP's answer is whole: a type whose alternatives keep a window looser than it may be.
  [[nodiscard]] Choice loosest(const Windows& w) const {
    Choice choice;
    Time looseness = 0;
    for (int i = 0; i < n_; ++i) {
      if (std::has_single_bit(w.types[at(i)])) continue;
      for (TypeSet types = w.types[at(i)]; types != 0; types &= types - 1) {
        const int t = std::countr_zero(types);
        if (lp_.share(i, t) < 0.5) continue;
        const Time gain = 1 + problem_.wcet(i, t) - least(w, i);
        if (gain <= looseness) continue;
        looseness = gain;
        choice = {i, t};
      }
    }
    return choice;
  }

  /// A child for each instance that `xnode` may have.
  bool place_each(const Windows& w, int xnode, int depth) {
    const int shared = std::countr_zero(w.types[at(xnode)]);
    int used = 0;
    for (int i = 0; i < n_; ++i)
      if (w.types[at(i)] == w.types[at(xnode)]) used = std::max(used, w.place[at(i)] + 1);
    const auto instances = static_cast<int>(problem_.type_xpus[at(shared)].size());
    // Instances that have nobody yet are alike: one of them stands for all.
    for (int k = 0; k <= std::min(used, instances - 1); ++k) {
      Windows child = w;
      child.place[at(xnode)] = k;
      if (!descend(child, depth + 1)) return false;
    }
    return true;
  }

  /// A child for each relation that the pair may have.
  bool relate_each(const Windows& w, int i, int j, int depth) {
    const int shared = std::countr_zero(w.types[at(i)]);
    const unsigned possible = relations(w, i, j, shared);
    for (const Relation relation : {kFirst, kSecond, kInFirst, kInSecond}) {
      if ((possible & relation) == 0) continue;
      Windows child = w;
      relate(child, i, j, shared, relation);
      if (!descend(child, depth + 1)) return false;
    }
    return true;
  }

  /// Both halves of when an XNode becomes ready: its predecessors are all done by the middle, or it
  /// cannot start before. Each half is narrower, so that this ends.
  bool split_ready(Windows& w, int depth) {
    int widest_of = -1;
    Time widest = 0;
    for (int i = 0; i < n_; ++i) {
      const Time width = latest_ready(w, i) - w.r[at(i)];
      if (width <= widest) continue;
      widest = width;
      widest_of = i;
    }
    if (widest_of < 0) {
      if (!fit_.possible(w, kMostSteps)) return true;
      open_leaf_ = true;
      return false;
    }
    const Time middle = w.r[at(widest_of)] + (widest - 1) / 2;
    Windows early = w;
    ready_by(early, widest_of, middle);
    if (!descend(early, depth + 1)) return false;
    w.r[at(widest_of)] = middle + 1;
    return descend(w, depth + 1);
  }

  /// True: refuted. False: open, or out of nodes or time; the whole attempt has then failed.
  bool descend(Windows& w, int depth) {
    if (depth > 400) open_leaf_ = true;  // as good as: a larger budget ends here again
    improving_left_ += kEvaluationsPerNode;
    if (--nodes_left_ < 0 || stopped() || depth > 400) return false;
    int open_i = -1, open_j = -1;
    if (dead_end(w, open_i, open_j)) {
      if (decided_ >= 0) weight_[at(decided_)] += 1;
      return true;
    }
    if (const Choice choice = least_decided(w); choice.xnode >= 0)
      return decide(w, choice.xnode, choice.type, depth);
    if (const Choice choice = loosest(w); choice.xnode >= 0)
      return decide(w, choice.xnode, choice.type, depth);
    decided_ = -1;
    if (try_as_policy(w)) return false;
    int branch = pairs_first_ && open_i >= 0 ? -1 : unplaced(w, false);
    if (branch < 0 && open_i < 0 && uniform()) {
      branch = unplaced(w, true);
      if (branch < 0) {
        const Outcome outcome = execute(w);
        if (outcome == Outcome::kPolicy) open_leaf_ = true;
        if (outcome != Outcome::kUnknown) return outcome == Outcome::kNone;
      }
    }
    if (branch >= 0) return place_each(w, branch, depth);
    if (open_i >= 0) return relate_each(w, open_i, open_j, depth);
    return split_ready(w, depth);
  }

  /// The XNode whose instance is to be decided next: the one with the least room, of those that so
  /// many others may meet that none of its instances is certain to be free; `all`: of those that may
  /// meet another, or start as it ends. -1: there is none.
  [[nodiscard]] int unplaced(const Windows& w, bool all) const {
    int found = -1;
    Time tightest = kNever;
    for (int i = 0; i < n_; ++i) {
      const std::size_t instances = problem_.type_xpus[at(std::countr_zero(w.types[at(i)]))].size();
      const Time room = w.d[at(i)] - w.r[at(i)] - least(w, i);
      if (w.place[at(i)] >= 0 || instances == 1 || room >= tightest) continue;
      std::size_t meets = 0;
      for (int j = 0; j < n_; ++j)
        meets += j != i && w.types[at(j)] == w.types[at(i)] &&
                 w.r[at(j)] < w.d[at(i)] + (all ? 1 : 0) && w.r[at(i)] < w.d[at(j)] + (all ? 1 : 0);
      if (meets < (all ? 1 : instances)) continue;
      found = i;
      tightest = room;
    }
    return found;
  }

  /// All types are decided: earliest deadline first, by the windows, may be a better policy. True:
  /// it is as short as the guess, which therefore is not refuted.
  bool try_as_policy(const Windows& w) {
    if (!control_.on_solution || !problem_.goal.plain() || !problem_.groups.empty()) return false;
    std::vector<int> xpu = fit_.xpu();
    for (int i = 0; i < n_; ++i)
      if (xpu[at(i)] < 0 || problem_.wcet_on(i, xpu[at(i)]) == kCannotRun) return false;
    std::vector<int> sequence = problem_.topo;
    std::stable_sort(sequence.begin(), sequence.end(),
                     [&](int i, int j) { return w.d[at(i)] < w.d[at(j)]; });
    evaluator_.reset(xpu, sequence);
    Solution solution{std::move(xpu), std::move(sequence), evaluator_.makespan(), false, {}};
    if (improving_left_ >= kEvaluations && improved_.insert(w.types).second)
      solution = improved(w, solution);
    if (solution.makespan >= control_.incumbent->load(std::memory_order_relaxed)) return false;
    control_.on_solution(solution);
    return solution.makespan <= guess_;
  }

  /// The best of a short search with the types that are decided, from `start` on.
  Solution improved(const Windows& w, const Solution& start) {
    Problem narrowed = problem_;
    for (int i = 0; i < n_; ++i)
      for (int t = 0; t < problem_.num_types; ++t)
        if ((w.types[at(i)] >> t & 1u) == 0)
          narrowed.wcet_flat[at(i) * at(problem_.num_types) + at(t)] = kCannotRun;
    StopWhen when;
    when.deadline = control_.deadline;
    when.stop = control_.stop;
    when.stop_too = control_.stop_too;
    when.max_evaluations = kEvaluations;
    improving_left_ -= kEvaluations;
    return anneal(narrowed, start, improved_.size(), when);
  }

  enum class Outcome { kNone, kPolicy, kUnknown };

  /// Types, instances and pairs are decided: whatever policy is left does one and the same thing
  /// (docs/solver.md, "What all pairs say"). kNone: that is not within the windows. kUnknown: not
  /// found out what it is.
  Outcome execute(const Windows& w) {
    Solution solution{fit_.xpu(), problem_.topo, kNever, false, std::vector<int>(at(n_), -1)};
    for (int i = 0; i < n_; ++i)
      if (solution.xpu[at(i)] < 0) return Outcome::kUnknown;
    std::stable_sort(solution.sequence.begin(), solution.sequence.end(),
                     [&](int i, int j) { return w.d[at(i)] < w.d[at(j)]; });
    std::vector<Time> end = w.d;
    for (int pass = 0; pass < 2; ++pass) {
      // Of those that come before it, an XNode waits for the one that ends last.
      solution.waits_for.assign(at(n_), -1);
      for (const auto& [i, j] : w.arcs) {
        int& last = solution.waits_for[at(j)];
        if (last < 0 || end[at(i)] > end[at(last)]) last = i;
      }
      evaluator_.reset(solution.xpu, solution.sequence, solution.waits_for);
      if (evaluator_.makespan() >= kNever) return Outcome::kUnknown;
      if (as_related(w, solution.xpu)) break;
      if (pass == 1) return Outcome::kUnknown;
      for (int i = 0; i < n_; ++i) end[at(i)] = evaluator_.finish(i);
    }
    for (int i = 0; i < n_; ++i)
      if (evaluator_.start(i) < w.r[at(i)] || evaluator_.finish(i) > w.d[at(i)])
        return Outcome::kNone;
    solution.makespan = evaluator_.makespan();
    if (w.arcs.empty()) solution.waits_for.clear();
    if (control_.on_solution && problem_.goal.plain() &&
        solution.makespan < control_.incumbent->load(std::memory_order_relaxed))
      control_.on_solution(solution);
    return Outcome::kPolicy;
  }

  /// Does the evaluator's schedule have each two XNodes of an XPU in the relation that `w` has?
  [[nodiscard]] bool as_related(const Windows& w, const std::vector<int>& xpu) const {
    const auto before = [&](int i, int j) { return evaluator_.finish(i) <= evaluator_.start(j); };
    for (const auto& [i, j] : w.arcs)
      if (!before(i, j)) return false;
    for (const auto& [i, j] : w.nested)
      if (evaluator_.start(i) >= evaluator_.start(j) ||
          evaluator_.finish(j) >= evaluator_.finish(i))
        return false;
    for (int i = 0; i < n_; ++i)
      for (int j = 0; j < n_; ++j)
        if (i != j && xpu[at(i)] == xpu[at(j)] && w.d[at(i)] <= w.r[at(j)] && !before(i, j))
          return false;
    return true;
  }

  // Distributions over instances that are tried at a node, at the last node of a branch.
  static constexpr std::int64_t kSteps = 300, kMostSteps = 100'000;
  // Evaluations of one search from a leaf, and how many each node allows: a tenth of its time.
  static constexpr std::int64_t kEvaluations = 4000, kEvaluationsPerNode = 4;

  const ProofControl& control_;
  EnergyLp lp_;
  OneMachine machine_;
  InstanceFit fit_;
  Evaluator evaluator_;
  CompositeBound start_;
  std::map<Time, Known> known_;  ///< by makespan
  std::int64_t nodes_left_ = 0;
  /// How often deciding an XNode's type was refuted at once: those are decided first. Kept from one
  /// attempt to the next.
  std::vector<double> weight_;
  int decided_ = -1;  ///< the XNode whose type was decided last; -1: something else was
  Time guess_ = 0;
  std::set<std::vector<TypeSet>> improved_;          ///< types from which improved() has searched
  std::int64_t improving_left_ = 10 * kEvaluations;  ///< evaluations
  bool open_leaf_ = false;
  bool pairs_first_ = true;
};

/// A node budget that no clock lets be used up; rounds that end early would otherwise overflow it.
constexpr std::int64_t kMostNodes = std::int64_t{1} << 50;

}  // namespace

Time prove_bound(const Problem& problem, const ProofControl& control) {
  Time bound = std::max(control.known_bound, quick_bound(problem));
  if (problem.num_types > kMostTypes) return bound;
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
  std::int64_t nodes = 200;
  while (!refuter.stopped() && bound < incumbent()) {
    bool any = false, more_nodes_help = false;
    for (const double part : {1.0, 0.4, 0.1}) {
      if (refuter.stopped() || bound >= incumbent()) break;
      const Time best = incumbent(), gap = best - bound;
      const Time t =
          bound + std::max<Time>(0, static_cast<Time>(part * static_cast<double>(gap)) - 1);
      // What shaving leaves for the greatest guess holds for the others; to do it for each of them
      // costs as much as this many nodes.
      constexpr std::int64_t kWorthShaving = 1000;
      const int rounds = part == 1.0 || nodes >= kWorthShaving ? 2 : 0;
      const bool refuted = refuter.refute(t, nodes, rounds) == Answer::kRefuted;
      more_nodes_help = more_nodes_help || !refuter.met_open_leaf();
      if (refuted) raise(t);
      any = refuted || incumbent() < best;
      if (any) break;
    }
    if (any) continue;
    if (!more_nodes_help) break;
    refuter.take_turns();
    if (!refuter.pairs_first()) continue;
    nodes = std::min(kMostNodes, nodes * 3);
  }
  return bound;
}

}  // namespace xauto::solver
