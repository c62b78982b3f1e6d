// SPDX-License-Identifier: Apache-2.0
// What a node of the branch and cut (ilp.cc) knows: ranges of the paper's s and f, the p and b that are left. Narrowed
// by what equations 2 to 5 say of the ranges alone: docs/ilp.md, "Ranges".
#pragma once

#include <cstdint>
#include <vector>

#include "solver/problem.h"

namespace xauto::solver {

/// XNodes of the paper's model, at most: sets of them are bits of a word.
inline constexpr int kMostOfModel = 60;

struct IlpNode {
  std::vector<Time> r, e, l, d;        ///< [xnode] s in [r, l], f in [e, d]
  std::vector<std::uint64_t> classes;  ///< [xnode] on an instance of one of these
  std::vector<int> place;              ///< [xnode] on this XPU; -1: on any of its classes
  std::vector<std::uint64_t>
      no_later;  ///< [xnode] of those on its XPU, who has b = 1 to it: finishes no later
};

/// Threads: one owner; keep `problem` alive.
class IlpRanges {
 public:
  explicit IlpRanges(const Problem& problem);

  /// Nothing is decided; f within `horizon`.
  [[nodiscard]] IlpNode root(Time horizon) const;
  /// Until nothing changes. False: no schedule within `horizon` is in the node.
  [[nodiscard]] bool tighten(IlpNode& node, Time horizon);

  /// Instances that nothing of the model tells apart: neither type nor who may run there.
  [[nodiscard]] const std::vector<std::vector<int>>& classes() const { return classes_; }
  /// kCannotRun where it may not.
  [[nodiscard]] Time wcet(int xnode, int of_class) const;
  [[nodiscard]] bool before(int i, int j) const;  ///< by precedence
  /// Least part of the WCET of `i`, on `of_class`, that lies within [a, b].
  [[nodiscard]] Time energy(const IlpNode& node, int i, int of_class, Time a, Time b) const;
  /// The class of `i`; -1: it has several.
  [[nodiscard]] int class_of(const IlpNode& node, int i) const;
  /// They may be at work at one time.
  [[nodiscard]] static bool meet(const IlpNode& node, int i, int j);

 private:
  bool follow_edges(IlpNode& node) const;
  bool narrow_instance(IlpNode& node, const std::vector<int>& on, int of_class,
                       bool& changed) const;
  bool narrow_window(IlpNode& node, const std::vector<int>& on, int of_class, Time a, Time b,
                     bool& changed) const;
  bool narrow_pairs(IlpNode& node, const std::vector<int>& on, int of_class, bool& changed) const;
  bool class_fits(const IlpNode& node, int of_class) const;

  const Problem& p_;
  std::vector<std::vector<int>> classes_;
  std::vector<std::uint64_t> behind_;  ///< [xnode] whom edges put behind it
};

}  // namespace xauto::solver
