// SPDX-License-Identifier: Apache-2.0
// Branch and cut over the paper's model: docs/ilp.md, "How it is solved".
#include "solver/ilp.h"

#include <algorithm>
#include <bit>
#include <numeric>

#include "base/index.h"
#include "solver/bounds.h"
#include "solver/heft.h"
#include "solver/ilp_lp.h"
#include "solver/ilp_ranges.h"
#include "solver/simulate.h"

namespace xauto::solver {
namespace {

/// What the model has, which knows no cost of preemption.
Problem without_costs(const Problem& problem) {
  Problem free = problem;
  std::fill(free.preemptive.begin(), free.preemptive.end(), 1);
  std::fill(free.preempt.begin(), free.preempt.end(), 0);
  std::fill(free.levels.begin(), free.levels.end(), 0);
  return free;
}

class BranchAndCut {
 public:
  BranchAndCut(const Problem& problem, IlpAnswer& answer, Until until)
      : p_(problem),
        free_(without_costs(problem)),
        answer_(answer),
        until_(until),
        ranges_(problem),
        relaxation_(problem, ranges_),
        weight_(at(problem.num_xnodes), 1.0),
        limit_(answer.makespan - 1) {}

  void run() {
    raise_bound();
    IlpNode root = ranges_.root(limit_);
    std::vector<Window> windows;
    if (probe(root, windows)) descend(std::move(root), std::move(windows));
    answer_.finished = !until_.over();
    answer_.lps = relaxation_.solved();
    if (answer_.finished) answer_.bound = std::max(answer_.bound, limit_ + 1);
  }

 private:
  using Window = IlpWindow;

  bool refuted(IlpNode& node, Time limit, std::vector<Window>& windows) {
    if (!ranges_.tighten(node, limit)) {
      ++answer_.by_ranges;
      return true;
    }
    if (all_decided(node) || !relaxation_.refuted(node, windows, until_)) return false;
    ++answer_.by_lp;
    return true;
  }

  /// The root alone refutes shorter and shorter makespans: what is left of a bound where time ends.
  void raise_bound() {
    constexpr Time kPart = 2000;  // of the makespan: how close; chosen
    Time low = answer_.bound, high = limit_;
    while (low <= high && !until_.over()) {
      const Time guess = high == limit_ ? high : low + (high - low) / 2;
      if (guess != limit_ && high - low < std::max<Time>(1, high / kPart)) break;
      IlpNode node = ranges_.root(guess);
      std::vector<Window> windows;
      if (refuted(node, guess, windows))
        low = guess + 1;
      else
        high = guess - 1;
    }
    answer_.bound = std::max(answer_.bound, low);
  }

  /// Each class of each XNode alone: what is refuted is left out of the root. False: nothing is left.
  bool probe(IlpNode& root, std::vector<Window>& windows) {
    for (bool changed = true; changed && !until_.over();) {
      changed = false;
      if (refuted(root, limit_, windows)) return false;
      for (int i = 0; i < p_.num_xnodes; ++i)
        for (std::uint64_t left = root.classes[at(i)]; left != 0; left &= left - 1) {
          if (std::has_single_bit(root.classes[at(i)]) || until_.over()) break;
          IlpNode trial = root;
          trial.classes[at(i)] = left & -left;
          std::vector<Window> to_try = windows;
          if (!refuted(trial, limit_, to_try)) continue;
          root.classes[at(i)] &= ~(left & -left);
          changed = true;
          if (!ranges_.tighten(root, limit_)) return false;
        }
    }
    return true;
  }

  void descend(IlpNode node, std::vector<Window> windows) {
    if (until_.over()) return;
    ++answer_.nodes;
    if (refuted(node, limit_, windows)) {
      if (branched_ >= 0) weight_[at(branched_)] += 1;
      return;
    }
    if (!all_decided(node)) return decide(node, windows);
    branched_ = -1;
    if (const int i = to_place(node); i >= 0) return place(node, i);
    if (!try_as_schedule(node)) return;
    relate(node);
  }

  bool all_decided(const IlpNode& node) const {
    return std::all_of(node.classes.begin(), node.classes.end(),
                       [](std::uint64_t left) { return std::has_single_bit(left); });
  }

  /// The p of one XNode, of the class with the largest share first.
  void decide(const IlpNode& node, const std::vector<Window>& windows) {
    int chosen = -1;
    double most = 0;
    for (int i = 0; i < p_.num_xnodes; ++i) {
      if (std::has_single_bit(node.classes[at(i)])) continue;
      double largest = 0;
      for (std::size_t c = 0; c < ranges_.classes().size(); ++c)
        largest = std::max(largest, relaxation_.share(i, static_cast<int>(c)));
      constexpr double kWhole = 1e-3;  // what a share that is whole counts
      const double score = weight_[at(i)] * (kWhole + 1 - std::min(1.0, largest));
      if (score <= most) continue;
      most = score;
      chosen = i;
    }
    std::vector<std::pair<double, int>> order;
    for (std::uint64_t left = node.classes[at(chosen)]; left != 0; left &= left - 1) {
      const int c = std::countr_zero(left);
      order.emplace_back(-relaxation_.share(chosen, c), c);
    }
    std::sort(order.begin(), order.end());
    for (const auto& [share, c] : order) {
      IlpNode child = node;
      child.classes[at(chosen)] = std::uint64_t{1} << c;
      branched_ = chosen;
      descend(std::move(child), windows);
    }
  }

  [[nodiscard]] int met(const IlpNode& node, int i) const {
    int others = 0;
    for (int j = 0; j < p_.num_xnodes; ++j)
      others += j != i && node.classes[at(j)] == node.classes[at(i)] && IlpRanges::meet(node, i, j);
    return others;
  }

  /// The XNode with the least room of those that so many others may meet that none of its instances is certain to be free.
  [[nodiscard]] int to_place(const IlpNode& node) const {
    int found = -1;
    Time tightest = 0;
    for (int i = 0; i < p_.num_xnodes; ++i) {
      const int c = ranges_.class_of(node, i);
      if (node.place[at(i)] >= 0 ||
          met(node, i) < static_cast<int>(ranges_.classes()[at(c)].size()))
        continue;
      const Time room = node.d[at(i)] - node.r[at(i)] - ranges_.wcet(i, c);
      if (found >= 0 && room >= tightest) continue;
      found = i;
      tightest = room;
    }
    return found;
  }

  /// Of instances that have nobody yet, one.
  void place(const IlpNode& node, int i) {
    for (const int x : ranges_.classes()[at(ranges_.class_of(node, i))]) {
      const bool fresh = std::find(node.place.begin(), node.place.end(), x) == node.place.end();
      IlpNode child = node;
      child.place[at(i)] = x;
      descend(std::move(child), {});
      if (fresh) break;
    }
  }

  /// Who has no instance yet finds one that nobody whom it meets is on.
  [[nodiscard]] std::vector<int> places(const IlpNode& node) const {
    std::vector<int> place = node.place;
    for (int i = 0; i < p_.num_xnodes; ++i) {
      if (place[at(i)] >= 0) continue;
      for (const int x : ranges_.classes()[at(ranges_.class_of(node, i))]) {
        bool taken = false;
        for (int j = 0; j < p_.num_xnodes; ++j)
          taken = taken || (j != i && place[at(j)] == x && IlpRanges::meet(node, i, j));
        if (taken) continue;
        place[at(i)] = x;
        break;
      }
    }
    return place;
  }

  /// The shortest schedule of the b that are decided, if all are: priorities by latest finish. False: the node ends.
  bool try_as_schedule(IlpNode& node) {
    Decision decision{places(node), {}, {}};
    for (;;) {
      std::vector<int> order(at(p_.num_xnodes));
      std::iota(order.begin(), order.end(), 0);
      const auto rank = [&](int i) {
        return std::pair(node.d[at(i)], std::popcount(node.no_later[at(i)]));
      };
      std::stable_sort(order.begin(), order.end(), [&](int i, int j) { return rank(i) < rank(j); });
      decision.priority.assign(at(p_.num_xnodes), 0);
      for (std::size_t k = 0; k < order.size(); ++k)
        decision.priority[at(order[k])] = p_.num_xnodes - static_cast<int>(k);
      const Simulation simulation = simulate(free_, decision);
      if (simulation.makespan > limit_) return true;
      found(decision, simulation);
      if (!ranges_.tighten(node, limit_)) return false;
    }
  }

  /// A schedule of the model. Its finishes, or its starts, which preempt less, give the policy its priorities.
  void found(const Decision& decision, const Simulation& simulation) {
    answer_.model_makespan = simulation.makespan;
    limit_ = simulation.makespan - 1;
    for (const auto* key : {&simulation.finish, &simulation.start}) {
      const Decision policy{decision.xpu, priorities_by_key(*key), {}};
      const Time makespan = simulate(p_, policy).makespan;
      if (makespan >= answer_.makespan) continue;
      answer_.decision = policy;
      answer_.makespan = makespan;
    }
    limit_ = std::min(limit_, answer_.makespan - 1);
  }

  /// b of the two that have the least room beside each other, either way.
  void relate(const IlpNode& node) {
    int first = -1, second = -1;
    Time tightest = 0;
    for (int i = 0; i < p_.num_xnodes; ++i)
      for (int k = i + 1; k < p_.num_xnodes; ++k) {
        if (node.place[at(i)] < 0 || node.place[at(i)] != node.place[at(k)] ||
            (node.no_later[at(i)] >> k & 1U) != 0 || (node.no_later[at(k)] >> i & 1U) != 0)
          continue;
        const Time both = std::min(node.r[at(i)], node.r[at(k)]) +
                          ranges_.wcet(i, ranges_.class_of(node, i)) +
                          ranges_.wcet(k, ranges_.class_of(node, k));
        const Time room = node.d[at(i)] + node.d[at(k)] - 2 * both;
        if (first >= 0 && room >= tightest) continue;
        first = i;
        second = k;
        tightest = room;
      }
    if (first < 0) return;  // all are decided, and their schedule is too long
    if (node.d[at(second)] < node.d[at(first)]) std::swap(first, second);
    for (const auto& [i, k] : {std::pair(first, second), std::pair(second, first)}) {
      IlpNode child = node;
      child.no_later[at(k)] |= std::uint64_t{1} << i;
      descend(std::move(child), {});
    }
  }

  const Problem& p_;
  const Problem free_;
  IlpAnswer& answer_;
  const Until until_;
  IlpRanges ranges_;
  IlpRelaxation relaxation_;
  std::vector<double> weight_;  ///< [xnode] how often deciding its class was refuted at once
  int branched_ = -1;           ///< whose class was decided last; -1: something else was
  Time limit_;                  ///< what is longer is of no interest
};

}  // namespace

Result<IlpAnswer> solve_ilp(const Problem& problem, const IlpOptions& options) {
  if (problem.num_xnodes > kMostOfModel)
    return fail(ErrorCode::kInvalid,
                std::to_string(problem.num_xnodes) +
                    " XNodes are too many for the paper's model, " + std::to_string(kMostOfModel) +
                    " are the most",
                "method ilp", "take method auto: it proves more, faster");
  const Until until{std::chrono::steady_clock::now() +
                        std::chrono::microseconds(static_cast<std::int64_t>(
                            std::clamp(options.time_limit_s, 0.0, kNoLimitS) * 1e6)),
                    options.stop};
  IlpAnswer answer;
  answer.decision = options.incumbent ? *options.incumbent : heft(problem);
  answer.makespan = simulate(problem, *answer.decision).makespan;
  answer.bound = std::min(answer.makespan, std::max(options.known_bound, quick_bound(problem)));
  if (answer.bound == answer.makespan) {
    answer.proven = answer.finished = true;
    return answer;
  }
  BranchAndCut(problem, answer, until).run();
  answer.bound = std::min(answer.bound, answer.makespan);
  answer.proven = answer.bound == answer.makespan;
  return answer;
}

}  // namespace xauto::solver
