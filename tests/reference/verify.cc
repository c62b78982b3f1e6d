// SPDX-License-Identifier: Apache-2.0
// The checks, in the order in which policy.json states its numbers.
#include "reference/verify.h"

#include <algorithm>
#include <numeric>
#include <random>

#include "base/index.h"
#include "model/claims.h"

#include "reference/valid_plan.h"
#include "reference/verify_world.h"

namespace xauto::solver {
namespace {

using verification::Candidate;
using verification::Execution;
using verification::Proof;
using verification::Us;
using verification::World;

constexpr int kExactXNodes = 10;  ///< up to here executions are enumerated
constexpr std::int64_t kTypeProofNodes = 200'000;
constexpr std::int64_t kWork = 4'000'000;  ///< XNode visits that the schedules tried may cost
constexpr int kMostByTypes = 2000;         ///< XNodes; a node of that proof is quadratic in them

std::string us(Us value) {
  return std::to_string(value) + " us";
}

class Check {
 public:
  Check(const AppSpec& app, const Platform& platform, const PriorityPlan& policy,
        const VerifyOptions& options)
      : app_(app),

        policy_(policy),
        options_(options),
        world_(app, platform),
        kinds_(world_),
        engine_(options.seed) {
    for (const PriorityPlacement& p : policy.placements) {
      candidate_.xpu.push_back(p.xpu);
      candidate_.priority.push_back(p.priority);
    }
    candidate_.order_before.resize(at(world_.n));
    for (const auto& [u, v] : policy.order) candidate_.order_before[at(v)].push_back(u);
    for (int i = 0; i < world_.n; ++i)
      wcet_.push_back(*world_.wcet[at(i)][at(candidate_.xpu[at(i)])]);
    wishes(platform);
  }

  Verification run() {
    schedule();
    lower_bound();
    optimal();
    deadlines();
    return std::move(v_);
  }

 private:
  void lie(std::string text) { v_.lies.push_back(std::move(text)); }
  void shown(std::string text) { v_.shown.push_back(std::move(text)); }
  void taken(std::string text) { v_.taken.push_back(std::move(text)); }
  [[nodiscard]] const std::string& name(int i) const { return app_.xnodes[at(i)].name; }
  /// What one execution costs, in visits of XNodes; many edges and the queues of a huge app count.
  [[nodiscard]] std::int64_t size() const {
    const std::size_t visits = std::max(app_.xnodes.size(), app_.edges.size() / 8);
    return static_cast<std::int64_t>(world_.n > kMostByTypes ? 5 * visits : visits);
  }
  std::uint64_t below(std::uint64_t bound) { return engine_() % bound; }

  // ---- what was asked for

  /// -1 and a lie where the app has no such XNode.
  int asked_xnode(const std::string& called) {
    for (int i = 0; i < world_.n; ++i)
      if (name(i) == called) return i;
    lie("'" + called + "' was asked for, but no XNode is called that");
    return -1;
  }

  /// Takes the implementations away that nobody asked for, and checks the policy against that.
  void wishes(const Platform& platform) {
    std::vector<std::vector<char>> allowed(at(world_.n), std::vector<char>(at(world_.m), 1));
    const auto means = [&](int x, const std::string& target) {
      return platform.xpus[at(x)].id == target ||
             (platform.find(target) < 0 && platform.xpus[at(x)].type == target);
    };
    const auto narrow = [&](const auto& list, bool keep) {
      for (const auto& [called, target] : list) {
        const int i = asked_xnode(called);
        if (i < 0) continue;
        for (int x = 0; x < world_.m; ++x)
          if (means(x, target) != keep) allowed[at(i)][at(x)] = 0;
        if (allowed[at(i)][at(candidate_.xpu[at(i)])] == 0)
          lie("XNode '" + called + (keep ? "' must run on " : "' must not run on ") + target +
              ", it runs on " + platform.xpus[at(candidate_.xpu[at(i)])].id);
        else
          shown("'" + called + (keep ? "' runs on " : "' does not run on ") + target);
      }
    };
    narrow(options_.asked.pins, true);
    narrow(options_.asked.forbids, false);
    group_of_.assign(at(world_.n), -1);
    for (const auto& names : options_.asked.groups) {
      std::vector<int> members;
      for (const std::string& called : names)
        if (const int i = asked_xnode(called); i >= 0) members.push_back(i);
      const bool together = std::all_of(members.begin(), members.end(), [&](int i) {
        return candidate_.xpu[at(i)] == candidate_.xpu[at(members.front())];
      });
      if (!members.empty() && together)
        shown("the group of '" + names.front() + "' runs on one XPU");
      else if (!members.empty())
        lie("the group of '" + names.front() + "' must run on one XPU, it does not");
      for (const int i : members) group_of_[at(i)] = static_cast<int>(groups_.size());
      groups_.push_back(std::move(members));
      exact_ = false;
    }
    for (int i = 0; i < world_.n; ++i)
      for (int x = 0; x < world_.m; ++x) {
        if (allowed[at(i)][at(x)] != 0) continue;
        world_.wcet[at(i)][at(x)] = std::nullopt;
        // For the proofs, which take instances of one kind as equal: gone only if gone on all.
        bool elsewhere = false;
        for (int y = 0; y < world_.m; ++y)
          elsewhere =
              elsewhere || (world_.kind[at(x)] == world_.kind[at(y)] && allowed[at(i)][at(y)] != 0);
        if (elsewhere)
          exact_ = false;
        else
          kinds_.wcet[at(i)][at(x)] = std::nullopt;
      }
    broken_wish_ = !v_.lies.empty();
  }

  /// Of the whole and of every chain: said, not judged, for a policy states no deadlines.
  void deadlines() {
    const auto tell = [&](const std::string& what, Us latency, const std::optional<Us>& deadline) {
      if (deadline && latency > *deadline)
        v_.missed.push_back(what + ": " + us(latency) + ", its deadline is " + us(*deadline));
      else
        shown(what + ": " + us(latency) + (deadline ? " of " + us(*deadline) : ""));
    };
    if (app_.deadline_us) tell("the deadline", v_.latency_us, app_.deadline_us);
    for (const ChainWish& chain : options_.asked.chains) {
      const int to = asked_xnode(chain.to);
      if (asked_xnode(chain.from) < 0 || to < 0) continue;
      tell("chain '" + chain.name + "'", finish_[at(to)], chain.deadline_us);
    }
  }

  void schedule() {
    const Execution e = verification::execute(world_, candidate_, wcet_);
    v_.latency_us = e.latency;
    finish_ = e.finish;
    int wrong = 0;
    for (int i = 0; i < world_.n; ++i) {
      const PriorityPlacement& p = policy_.placements[at(i)];
      if (p.start_us == e.start[at(i)] && p.finish_us == e.finish[at(i)]) continue;
      if (++wrong <= 5)
        lie("XNode '" + name(i) + "' is said to run from " + us(p.start_us) + " to " +
            us(p.finish_us) + ", it runs from " + us(e.start[at(i)]) + " to " +
            us(e.finish[at(i)]));
    }
    if (wrong > 5) lie("and " + std::to_string(wrong - 5) + " more XNodes with wrong times");
    if (wrong == 0) shown("start and finish of all " + std::to_string(world_.n) + " XNodes");
    if (policy_.latency_us != e.latency)
      lie("latency_us is said to be " + us(policy_.latency_us) + ", it is " + us(e.latency));
    else
      shown("latency_us = " + us(e.latency));
  }

  void lower_bound() {
    const Us claimed = policy_.lower_bound_us;
    if (claimed > v_.latency_us)
      lie("lower_bound_us of " + us(claimed) + " is above the policy's own latency of " +
          us(v_.latency_us));
    // A policy that does not do what was asked: its bound is about another problem.
    if (broken_wish_) return;
    // With what was asked for: the same argument by kinds of XPU, and by single instances.
    v_.own_bound_us =
        std::max(verification::simple_bound(kinds_), verification::simple_bound(world_));
    v_.best_found_us = std::min(v_.latency_us, shortest_tried());
    hold_against(claimed, "this policy claims");
    if (options_.other_bound_us) hold_against(*options_.other_bound_us, "the other policy claims");
    if (v_.best_found_us < claimed && claimed <= v_.latency_us)
      lie("lower_bound_us of " + us(claimed) + " is above a schedule of " + us(v_.best_found_us));
    if (claimed > v_.best_found_us) return;
    v_.bound_proven = claimed <= v_.own_bound_us || prove(claimed);
    if (v_.bound_proven)
      shown("lower_bound_us = " + us(claimed) + ": no schedule of one release is shorter");
    else if (v_.lies.empty())
      taken("lower_bound_us = " + us(claimed) + ": proven here only up to " + us(v_.own_bound_us) +
            "; none of " + std::to_string(schedules_) + " schedules tried is shorter");
  }

  /// Both numbers are of policies that were executed here: nothing else needs to be right.
  void hold_against(Us bound, const std::string& who) {
    if (bound <= v_.best_found_us) return;
    const bool itself = v_.latency_us < bound;
    v_.counterexample = (itself ? "this policy takes " + us(v_.latency_us)
                                : "a policy found here takes " + us(v_.best_found_us)) +
                        ", but " + who + " that none takes less than " + us(bound);
  }

  bool prove(Us claimed) {
    if (world_.n > kMostByTypes) return false;
    const std::int64_t scale = std::max<std::int64_t>(1, world_.n / 20);
    if (verification::prove_by_types(kinds_, claimed,
                                     std::min(kTypeProofNodes, options_.proof_nodes) / scale) ==
        Proof::kHolds)
      return true;
    if (world_.n > kExactXNodes) return false;
    const Proof relaxed =
        verification::prove_by_execution(kinds_.relaxed(), claimed, options_.proof_nodes);
    if (relaxed == Proof::kHolds) return true;
    if (!exact_) return false;  // what beats it may be what was not asked for
    if (relaxed == Proof::kBeaten && world_.preemption_is_free()) {
      lie("lower_bound_us of " + us(claimed) +
          " is too high: an assignment with priorities is shorter");
      return false;
    }
    const Proof real = verification::prove_by_execution(kinds_, claimed, options_.proof_nodes);
    if (real == Proof::kBeaten)
      lie("lower_bound_us of " + us(claimed) +
          " is too high: an assignment with priorities is shorter");
    else if (real == Proof::kHolds)
      taken("lower_bound_us = " + us(claimed) +
            ": no assignment with fixed priorities is shorter (all were tried); schedules that "
            "leave an XPU idle "
            "on purpose were not");
    return false;
  }

  /// Hill climbing over assignment and sequence, from the policy: fixed priorities, fixed
  /// sequences, and one of these on some XPUs with the other on the rest.
  Us shortest_tried() {
    const std::size_t n = at(world_.n);
    std::vector<int> xpu = candidate_.xpu, sequence(n);
    std::iota(sequence.begin(), sequence.end(), 0);
    const Execution planned = verification::execute(world_, candidate_, wcet_);
    std::vector<std::size_t> depth(n);
    for (std::size_t k = 0; k < n; ++k) depth[at(world_.first_to_last[k])] = k;
    std::sort(sequence.begin(), sequence.end(), [&](int a, int b) {
      return std::pair(planned.start[at(a)], depth[at(a)]) <
             std::pair(planned.start[at(b)], depth[at(b)]);
    });
    std::vector<char> in_order(at(world_.m), 0);  // [xpu], of the third kind
    const auto length = [&] {
      Candidate candidate{xpu, std::vector<std::int64_t>(n), std::vector<std::vector<int>>(n)};
      std::vector<Us> takes(n);
      for (std::size_t k = 0; k < n; ++k)
        candidate.priority[at(sequence[k])] = static_cast<std::int64_t>(n - k);
      for (std::size_t i = 0; i < n; ++i) takes[i] = *world_.wcet[i][at(xpu[i])];
      ++schedules_;
      const Us least = std::min(verification::execute(world_, candidate, takes).latency,
                                verification::in_sequence(world_, xpu, sequence));
      for (char& ordered : in_order) ordered = below(2) == 0;
      std::vector<int> last(at(world_.m), -1);
      for (const int i : sequence) {
        int& before = last[at(xpu[at(i)])];
        if (before >= 0 && in_order[at(xpu[at(i)])])
          candidate.order_before[at(i)].push_back(before);
        before = i;
      }
      return std::min(least, verification::execute(world_, candidate, takes).latency);
    };
    Us best = length(), current = best;
    const auto rounds = std::min(options_.schedules, kWork / size());
    for (std::int64_t round = 0; round < rounds && n > 1; ++round) {
      const auto old_xpu = xpu;
      const auto old_sequence = sequence;
      if (below(2) == 0) {
        const std::size_t i = below(n);
        const std::size_t x = below(at(world_.m));
        if (!may_move(i, x)) continue;
        xpu[i] = static_cast<int>(x);
        if (group_of_[i] >= 0)
          for (const int member : groups_[at(group_of_[i])]) xpu[at(member)] = static_cast<int>(x);
      } else if (!move_in(sequence)) {
        continue;
      }
      const Us now = length();
      best = std::min(best, now);
      if (now <= current || below(100) < 2) {
        current = now;
      } else {
        xpu = old_xpu;
        sequence = old_sequence;
      }
    }
    return best;
  }

  [[nodiscard]] bool may_move(std::size_t i, std::size_t x) const {
    if (group_of_[i] < 0) return world_.wcet[i][x].has_value();
    const auto& group = groups_[at(group_of_[i])];
    return std::all_of(group.begin(), group.end(),
                       [&](int member) { return world_.wcet[at(member)][x].has_value(); });
  }

  /// Moves one XNode up to a dozen places forward, as far as its predecessors allow.
  bool move_in(std::vector<int>& sequence) {
    std::size_t k = 1 + below(sequence.size() - 1);
    std::size_t steps = 1 + below(12);
    bool moved = false;
    for (; steps > 0 && k > 0; --steps, --k) {
      const auto& before = world_.before[at(sequence[k])];
      if (std::find(before.begin(), before.end(), sequence[k - 1]) != before.end()) break;
      std::swap(sequence[k], sequence[k - 1]);
      moved = true;
    }
    return moved;
  }

  void optimal() {
    if (!policy_.optimal) return;
    if (v_.latency_us != policy_.lower_bound_us)
      lie("optimal is claimed, but the latency of " + us(v_.latency_us) +
          " is not the lower bound of " + us(policy_.lower_bound_us));
    else if (v_.best_found_us < v_.latency_us)
      lie("optimal is claimed, but a schedule of " + us(v_.best_found_us) + " exists");
    else if (v_.bound_proven)
      shown("optimal: re-proven");
    else
      taken("optimal: the latency equals the bound claimed, which was not re-proven here");
  }

  const AppSpec& app_;

  const PriorityPlan& policy_;
  const VerifyOptions& options_;
  World world_;  ///< with what was asked for, instance by instance
  World kinds_;  ///< the same, but a kind of XPU is open to an XNode if one instance is
  bool broken_wish_ = false;
  bool exact_ = true;  ///< kinds_ says it all: no groups, no single instances
  std::vector<std::vector<int>> groups_;
  std::vector<int> group_of_;
  std::mt19937_64 engine_;
  Candidate candidate_;
  std::vector<Us> wcet_, finish_;
  std::int64_t schedules_ = 0;
  Verification v_;
};

}  // namespace

Verification verify(const AppSpec& app, const Platform& platform, const PriorityPlan& policy,
                    const VerifyOptions& options) {
  for (const Status& status : {validate_graph(app), validate(platform), validate_on(app, platform),
                               reference::validate_plan(policy, app, platform)})
    if (!status) {
      Verification answer;  // nothing else can be derived from it
      answer.lies.push_back(status.error().to_string());
      return answer;
    }
  Verification answer = Check(app, platform, policy, options).run();
  if (!policy.platform.empty() && policy.platform != platform.name)
    answer.lies.push_back("the policy was made for platform '" + policy.platform + "', not for '" +
                          platform.name + "'");
  return answer;
}

}  // namespace xauto::solver
