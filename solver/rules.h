// SPDX-License-Identifier: Apache-2.0
// What must hold of every policy at a node of the proof (exact.h): windows from the precedence
// graph, pairs of XNodes on one instance, who pays for a suspension. A policy is an assignment,
// priorities, and any run-time order pairs: an XPU may stay idle while an XNode of it is ready.
// Each rule only narrows the windows; the arguments are in docs/solver.md, "Proof".
#pragma once

#include <algorithm>
#include <vector>

#include "base/index.h"
#include "solver/energy_lp.h"
#include "solver/problem.h"

namespace xauto::solver {

class Rules {
 public:
  explicit Rules(const Problem& problem);

  /// How two XNodes of one instance may share it; see docs/solver.md, "pairs".
  enum Relation : unsigned { kFirst = 1, kSecond = 2, kInFirst = 4, kInSecond = 8 };

  /// Windows from the precedence graph, types from the windows; false: empty.
  [[nodiscard]] bool tighten(Windows& w) const;
  [[nodiscard]] Time least(const Windows& w, int i) const;
  /// Both are on one instance, whichever it is.
  [[nodiscard]] bool share(const Windows& w, int i, int j) const;
  /// They may be on one instance at one time.
  [[nodiscard]] bool may_share(const Windows& w, int i, int j) const;
  /// What a suspension costs at least on an instance of `type`; -1 if none suspends.
  [[nodiscard]] Time suspension(int type) const;
  [[nodiscard]] unsigned relations(const Windows& w, int i, int j, int type) const;
  /// Can `inner` become eligible after `outer` has started? Otherwise it runs first. Its last
  /// predecessor finishes after that, or it waits, by run-time order, for somebody else nested in
  /// `outer`; the first of those does not wait, so that its last predecessor finishes after that.
  [[nodiscard]] bool may_come_late(const Windows& w, int outer, int inner, int type) const;
  [[nodiscard]] Time latest_ready(const Windows& w, int i) const;
  void relate(Windows& w, int i, int j, int type, Relation relation) const;
  /// All that is nested in `outer` runs within its span, and each pays; or, where who starts as another one ends does
  /// not, the first suspension costs at least once.
  void nest(Windows& w, int outer, int inner, int type, Time cost) const;
  /// Of those nested in one XNode, whoever starts first has suspended it, hence pays. So does one
  /// that starts after all earlier ones have ended: in between, the suspended one was back. Certain
  /// once no other XNode can join them: that all who may share the XPU with the one that is
  /// suspended are known not to, or how.
  [[nodiscard]] bool charge_starters(Windows& w) const;
  /// An XNode starts the moment its predecessors and those before it on its XPU have finished, and
  /// only what is nested in it delays its end: a latest finish, for all whose instance is known and
  /// whose relation to all that may share it. Only where uniform().
  [[nodiscard]] bool end_as_ready(Windows& w) const;
  /// Every WCET is positive, and the instances of each type cannot be told apart: by the user's
  /// constraints, by what a suspension costs, or by levels, of which there are enough for all. All
  /// pairs then say what happens, exactly.
  [[nodiscard]] bool uniform() const { return uniform_; }
  [[nodiscard]] bool starts_before(const Windows& w, int k, int i) const;
  /// Pairs on one instance: decides those with one relation left; false: a pair has none.
  /// `open_*`: the tightest pair that is still open, -1 if all are decided.
  [[nodiscard]] bool settle_pairs(Windows& w, int& open_i, int& open_j) const;
  /// Marks pairs whose relation is decided in settled_, or unmarks them.
  bool settle_marked(Windows& w, int& open_i, int& open_j) const;
  void mark_settled(const Windows& w, char as) const;
  /// All predecessors of `i` done by `t` / `i` cannot start before `t`: the two halves of a split.
  void ready_by(Windows& w, int i, Time t) const;
  void done_by_others(Windows& w, int i, Time t) const;

 protected:
  const Problem& problem_;
  const int n_;

 private:
  [[nodiscard]] bool settled(int i, int j) const {
    return settled_[at(std::min(i, j)) * at(n_) + at(std::max(i, j))] != 0;
  }
  bool charge_marked(Windows& w) const;

  bool uniform_ = true;
  std::vector<char> all_pay_;      ///< [type] whoever is nested: its XPUs have levels
  mutable std::vector<Time> end_;  ///< end_as_ready(): by XNode, -1 where it says nothing
  mutable std::vector<char> pays_;
  mutable std::vector<char> settled_;  ///< settle_pairs(): [lesser * n + greater]; 0 between calls
};

}  // namespace xauto::solver
