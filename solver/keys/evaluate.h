// SPDX-License-Identifier: Apache-2.0
// Evaluate: one candidate of the search, from decision to worst cases.
//
// A decision says who is where, a key per XNode that orders the simulated rule, and how long the
// windows are on an XPU that several domains share. What comes of it are windows: the finishes of
// the simulated schedule, each domain by itself. An XPU of one domain needs no more proof
// (exhibit.h); a shared one is put to the demand bound. Where a preemption costs something, or is
// not possible, jobs are held until their planned start: then only those pay that the plan charges.
#pragma once

#include <algorithm>
#include <limits>
#include <memory>
#include <vector>

#include "solver/keys/certificate.h"
#include "solver/keys/exhibit.h"
#include "solver/keys/problem.h"
#include "solver/keys/windows.h"

namespace xauto::solver::keys {

/// What a policy says of single activations, that the search began with.
struct Given {
  std::vector<Tick> sooner;  ///< [slot] than the latest key of its XNode
  std::vector<Tick> hold;    ///< [slot] 0: none
};

struct Decision {
  std::vector<int> xpu;                ///< [xnode]
  std::vector<Tick> key;               ///< [xnode] after the nominal release: who goes first
  std::vector<Tick> hold;              ///< [xnode] whole microseconds; 0: none
  std::shared_ptr<const Given> given;  ///< may be null
  std::vector<char> held;              ///< [xnode] as it is given, too
  std::vector<Tick> window;            ///< [xnode] on a shared XPU: d - a, whole microseconds
  std::vector<char> polite;            ///< [xnode] in the plan it interrupts nobody
  /// [xnode] it begins as late as those may that hear of it and are sampled in its domain: it reads what is newer.
  std::vector<char> late;
};

struct Figures {
  bool valid = false;
  bool simulated = false;  ///< schedule and windows are those of the decision
  Windows w;
  Schedule schedule;
  std::vector<Tick> pad;        ///< [xpu] what drift takes of it
  std::vector<double> missing;  ///< [xpu] shared: how much time it is short of; 0: it serves all
  std::vector<Tick> chain;      ///< [chain] worst case
  /// Worst case / Chain::by: the largest of those with a deadline, if there are any; the weighted sum of all.
  double largest = 0, sum = 0;
  /// For the annealer: what is minimised as one number, about 1 for a good answer; above kInvalidCost what
  /// makes it invalid.
  double cost = 0;
};
inline constexpr double kInvalidCost = 1e4;

/// What is minimised for now: the largest alone; or the sum, where the largest is not above `limit`.
struct Goal {
  bool in_time =
      false;  ///< first of all no deadline is missed: there are some, and it is not proven impossible
  bool sum = false;
  double limit = std::numeric_limits<double>::infinity();

  /// Of `largest`, with the deadlines.
  [[nodiscard]] double most() const { return in_time ? std::min(limit, 1.0) : limit; }
  /// Valid; in time; then what is minimised.
  [[nodiscard]] bool better(const Figures& a, const Figures& b) const;
};

class Evaluator {
 public:
  /// `reference`: [chain] what costs are measured in (lower bounds).
  Evaluator(const Problem& problem, const std::vector<Tick>& reference);

  /// Costs are of this from now on.
  void set_goal(const Goal& goal) { goal_ = goal; }
  /// Of what is valid.
  [[nodiscard]] double cost_of(const Figures& figures) const;

  /// `most`: what costs more may come back invalid, sooner. `base` (may be null): a decision and its
  /// figures, of which is kept what does not change.
  void evaluate(const Decision& decision, double most, Figures& out, const Until& until = {},
                const Decision* base = nullptr, const Figures* base_figures = nullptr);
  [[nodiscard]] std::int64_t evaluations() const { return evaluations_; }
  /// [chain] XNodes that its end waits for, on any of its ways.
  [[nodiscard]] const std::vector<std::vector<int>>& chain_xnodes() const { return chain_xnodes_; }
  /// Whether Decision::late has a meaning for it.
  [[nodiscard]] bool may_be_late(int xnode) const { return !feeds_[at(xnode)].empty(); }
  /// Keys and holds as `out.w` has them, for what they are: nothing is simulated. Valid if they are certified.
  void take(const Decision& decision, Figures& out, const Until& until = {});
  /// Simulates again with the keys of `out`. True if that was better, and `out` changed.
  bool settle(const Decision& decision, Figures& out, const Until& until = {});

 private:
  bool simulate(const Decision& decision, const Figures* keys, Figures& out, const Until& until);
  bool simulate_counted(const Decision& decision, const Figures* keys, Figures& out,
                        const Until& until);
  bool plan(const Decision& decision, Figures& out, const Until& until);
  bool exhibit(int domain, const Decision& decision, Figures& out, const Until& until);
  [[nodiscard]] Tick slack_behind(const Schedule& schedule, int xnode, int activation) const;
  void find_changes(const Decision& decision, const Figures& out);
  bool serves(const Decision& decision, Figures& out, const Until& until);
  [[nodiscard]] bool as_before(const Decision& decision, int xpu, const Figures& out) const;
  bool deepen_pads(const Decision& decision, Figures& out);
  bool set_costs(Figures& out, const Until& until) const;
  void set_limits(double most);
  [[nodiscard]] double overload(const Decision& decision) const;

  const std::unique_ptr<Problem>
      counted_;  ///< where WCETs depend on windows: with those that are counted
  const Problem& p_;
  std::vector<Tick> reference_;
  double reference_sum_ = 0, reference_largest_ = 0;
  Goal goal_;
  std::vector<Exhibitor> exhibitors_;  ///< one per domain
  Rule rule_;
  std::vector<std::vector<int>> chain_xnodes_;  ///< [chain] those that its end waits for
  Windows urgent_;                              ///< of the candidate, in urgent releases
  Charges charges_;
  std::vector<char> shared_, was_shared_;  ///< [xpu]
  std::vector<std::vector<std::pair<int, int>>>
      feeds_;  ///< [xnode] samples of its domain, of what hears of it; empty: late is not possible
  std::vector<char> rigid_;  ///< [xnode] urgent, after what is not: its window cannot move forward
  std::vector<char> changed_;  ///< [domain] its schedule is not that of the base
  const Decision* base_ = nullptr;
  const Figures* base_figures_ = nullptr;
  double most_ = 0;
  std::int64_t evaluations_ = 0;
};

}  // namespace xauto::solver::keys
