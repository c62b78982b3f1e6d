// SPDX-License-Identifier: Apache-2.0
// The relaxation inside the proof (exact.h): can the XNodes be shared out over the types so that
// every time window of every type holds the work that must fall into it?
//
//   Windows [r_i, d_i] per XNode. If XNode i runs on type t, at least
//     e_it(a, b) = max(0, min(b - a, w_it - max(0, a - r_i) - max(0, d_i - b)))
//   of its work lies in [a, b], preemption allowed: outside it has no more room than a - r_i and
//   d_i - b. With x_it the fraction of i on t, an assignment that works satisfies for all t, a < b
//     sum over i of e_it(a, b) x_it  <=  (b - a) * instances(t),
// and for every chain i_1, ..., i_k of XNodes, each of which finishes before the next one starts,
//     sum over j, t of (w_(i_j) t + extra_(i_j)) x_(i_j) t  <=  d_(i_k) - r_(i_1).
// An XNode stays on one instance, so that the first holds for the functions of e in packing.h, too.
//
// Source: energetic reasoning (Erschler, Lopez 1991; Baptiste, Le Pape, Nuijten, "Constraint-based
// scheduling", 2001, section 3.3.3), here for fractional assignments, as an LP whose rows are
// separated as needed. The simplex works in floating point; a refutation counts only after its
// multipliers, rounded to integers, have been checked in exact arithmetic (Farkas).
#pragma once

#include <cstdint>
#include <functional>
#include <utility>
#include <vector>

#include "base/index.h"
#include "solver/packing.h"
#include "solver/problem.h"

namespace xauto::solver {

using TypeSet = std::uint64_t;
inline constexpr int kMostTypes = 64;  ///< that a proof can tell apart

/// What is left of the problem at a node of the proof.
struct Windows {
  std::vector<Time> r, d;      ///< earliest start, latest finish
  std::vector<TypeSet> types;  ///< bit t: type t still possible
  std::vector<int> place;      ///< decided: which instance of its type; -1 where it is not
  std::vector<Time> extra;     ///< least time beyond its WCET between an XNode's start and finish
  std::vector<Time>
      paid;  ///< preemption cost that its XPU is certain to lose between its start and finish
  std::vector<Time> cut;      ///< preemption cost in `extra` because it is suspended at least once
  std::vector<char> starter;  ///< it starts by suspending another: it pays for that itself
  std::vector<std::pair<int, int>> arcs;  ///< decided: first finishes before second starts
  std::vector<std::pair<int, int>>
      nested;  ///< decided: second starts and finishes while first is suspended
};

class EnergyLp {
 public:
  /// `stop`: asked now and then; then feasible() gives up, which is "not refuted".
  explicit EnergyLp(const Problem& problem, std::function<bool()> stop = {});

  /// False: refuted, with proof. True: not refuted; share() then holds the fractions.
  [[nodiscard]] bool feasible(const Windows& windows);
  /// Fraction of `xnode` on `type` in the last feasible solution.
  [[nodiscard]] double share(int xnode, int type) const {
    return share_[at(xnode) * at(types_) + at(type)];
  }
  [[nodiscard]] std::int64_t solved() const { return solved_; }

 private:
  struct Row {
    int type;  ///< kShares: the fractions of one XNode sum to at most 1 (xnode in `a`)
    Time a, b;
    Time grain = 0;               ///< how the work in a window is counted (packing.h)
    std::vector<int> chain = {};  ///< type kChain: its XNodes; [a, b] is the time that it has

    bool operator==(const Row&) const = default;
    /// What there is of one instance, in the unit of the coefficients.
    [[nodiscard]] Time room() const { return packed_room(b - a, grain); }
  };
  /// A window of a type and how many of its instances it fills.
  struct Full {
    double instances;
    Time a, b;
  };
  /// What an XNode may have to run on a type: its window, its work, and the fraction that is there.
  struct Work {
    Time r, d, w;
    double x;
  };
  static constexpr int kShares = -1, kChain = -2, kNone = -3;

  [[nodiscard]] Time energy(const Windows& windows, std::size_t i, int type, Time a, Time b) const;
  void start(const Windows& windows);
  void add_row(const Windows& windows, const Row& row);
  /// 1 optimal, 0 infeasible in `bad_row_`, -1 gave up.
  int dual_simplex();
  void read_shares(const Windows& windows);
  int separate(const Windows& windows);
  int separate_chains(const Windows& windows);
  /// Adds the windows that hold more of a type's work than its instances can do.
  int separate_windows(const Windows& windows, int type);
  void read_works(const Windows& windows, int type);
  /// The energy in windows from `a` on, by where they end.
  void read_slopes(Time a);
  int separate_packing(const Windows& windows);
  /// The row's coefficient of the fraction of `i` on `type`.
  [[nodiscard]] Time coefficient(const Windows& windows, const Row& row, std::size_t i,
                                 int type) const;
  [[nodiscard]] bool refutation_holds(const Windows& windows);
  double& cell(std::size_t row, std::size_t col) { return tableau_[row * stride_ + col]; }

  const Problem& problem_;
  std::function<bool()> stop_;
  int n_, types_;
  std::vector<double> share_;
  std::vector<Row> pool_;  ///< rows that were tight lately: the first ones of the next LP

  // Tableau: row k says  basic_k = rhs_k - sum over columns j of cell(k, j) * nonbasic_j, all >= 0.
  std::vector<int> var_xnode_, var_type_;  ///< structural variables
  std::vector<int> var_of_;                ///< [xnode * types + type] -> structural variable or -1
  std::vector<int> base_;                  ///< type that takes what the variables of an XNode leave
  std::vector<double> tableau_, rhs_, cost_;
  std::size_t stride_ = 0, columns_ = 0;
  std::vector<int> column_var_,
      row_var_;  ///< < structurals: structural; else slack of rows_[v - structurals]
  std::vector<Row> rows_;
  std::vector<std::vector<Full>> full_;  ///< by type: windows that separate() found nearly full
  Packing packing_;
  // Of separate_windows(): works, and where their windows begin and end.
  std::vector<Work> works_;
  std::vector<Time> begins_, ends_;
  std::vector<double> slope_, level_;  ///< by end: the energy so far is slope * length + level
  std::vector<double> spans_, heads_;  ///< separate_chains(): fractional, by XNode
  std::vector<int> before_;
  std::size_t bad_row_ = 0;
  std::int64_t solved_ = 0;
};

}  // namespace xauto::solver
