// SPDX-License-Identifier: Apache-2.0
// The relaxation of the paper's model at a node, on lp_solve: fractions of p, and the windows of equations 4 and 5 that
// a solution violates. What lp_solve refutes counts only if its multipliers do so in integers (docs/ilp.md).
#pragma once

#include <vector>

#include "solver/ilp_model.h"
#include "solver/ilp_ranges.h"
#include "solver/until.h"

namespace xauto::solver {

/// Work on a class within times [a, b], or from the start of XNode a to the finish of XNode b.
struct IlpWindow {
  int of_class;
  bool of_xnodes;
  Time a, b;
  friend bool operator==(const IlpWindow&, const IlpWindow&) = default;
};

/// Threads: one owner; keep `problem` and `ranges` alive.
class IlpRelaxation {
 public:
  IlpRelaxation(const Problem& problem, const IlpRanges& ranges);

  /// True: proven that no schedule is in the node. `windows`: those to begin with; then those that counted.
  [[nodiscard]] bool refuted(const IlpNode& node, std::vector<IlpWindow>& windows,
                             const Until& until);
  /// Of the last call that refuted nothing; 0 everywhere where lp_solve gave up.
  [[nodiscard]] double share(int xnode, int of_class) const {
    return share_[static_cast<std::size_t>(xnode) * ranges_.classes().size() +
                  static_cast<std::size_t>(of_class)];
  }
  [[nodiscard]] std::int64_t solved() const { return solved_; }  ///< LPs

 private:
  /// sum of terms >= right, or equal to it; in microseconds, but for the shares.
  struct Row {
    std::vector<std::pair<int, Time>> terms;
    Time right;
    bool equal;
    int window;  ///< index of its window; -1: it has none
  };
  struct Lp;

  static double scaled(const Lp& lp, const Row& row, const std::pair<int, Time>& term);
  static void add(Lp& lp, Row row);
  void add_columns(Lp& lp, const IlpNode& node) const;
  void add_equations(Lp& lp, const IlpNode& node) const;
  void add_window(Lp& lp, const IlpNode& node, const IlpWindow& window) const;
  bool separate(Lp& lp, const IlpNode& node) const;
  void violated_times(const Lp& lp, const IlpNode& node, int of_class,
                      std::vector<IlpWindow>& found) const;
  void violated_xnodes(const Lp& lp, int of_class, std::vector<IlpWindow>& found) const;
  static std::vector<double> multipliers(const Lp& lp);
  static bool holds_in_integers(const Lp& lp);

  const Problem& p_;
  const IlpRanges& ranges_;
  std::vector<double> share_;
  std::int64_t solved_ = 0;
};

}  // namespace xauto::solver
