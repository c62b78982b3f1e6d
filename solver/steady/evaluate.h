// SPDX-License-Identifier: Apache-2.0
// Evaluate: one candidate of the search, from decision to worst cases.
//
// A decision says who is where, a key per XNode that orders the simulated rule, and what each
// domain gets of an XPU that several share. What comes of it are windows: the finishes of the
// simulated schedule, each domain by itself. An XPU of one domain needs no more proof (exhibit.h);
// a shared one is put to the demand bound.
#pragma once

#include <vector>

#include "solver/steady/certificate.h"
#include "solver/steady/exhibit.h"
#include "solver/steady/problem.h"
#include "solver/steady/windows.h"

namespace xauto::solver::steady {

struct Decision {
  std::vector<int> xpu;    ///< [xnode]
  std::vector<Tick> key;   ///< [xnode] after the nominal release: who goes first
  std::vector<Tick> hold;  ///< [xnode] whole microseconds; 0: none
  /// [xpu * domains + domain] 1..kWhole: on a shared XPU the domain is simulated that much slower.
  /// They need not add up to kWhole: the demand bound decides.
  std::vector<int> share;
  std::vector<Tick> delay;  ///< [xnode] on a shared XPU its key is that much later; 0: none
};
inline constexpr int kWhole = 64;

struct Figures {
  bool valid = false;
  Windows w;
  Schedule schedule;
  Charges needed;           ///< what the windows ask for, at most what was simulated with
  std::vector<Tick> chain;  ///< [chain] worst case
  double late = 0;          ///< largest worst case / deadline, 0 without deadlines
  double sum = 0;           ///< weighted sum of the worst cases
  /// For the annealer: both as one number, about 1 for a good answer; above kInvalidCost what makes
  /// it invalid.
  double cost = 0;

  [[nodiscard]] bool better_than(const Figures& other) const;
};
inline constexpr double kInvalidCost = 1e4;

class Evaluator {
 public:
  /// `reference`: [chain] what the sum is measured in (lower bounds).
  Evaluator(const Problem& problem, const std::vector<Tick>& reference);

  /// `charges`: a guess, by which it begins; empty: none. `most`: what costs more may come back
  /// invalid, sooner.
  void evaluate(const Decision& decision, const Charges& charges, double most, Figures& out,
                const Until& until = {});
  [[nodiscard]] std::int64_t evaluations() const { return evaluations_; }
  /// [chain] XNodes that its end waits for, on any of its ways.
  [[nodiscard]] const std::vector<std::vector<int>>& chain_xnodes() const { return chain_xnodes_; }
  /// Simulates again with the keys of `out`: where all XPUs are preemptive, the same windows or
  /// earlier ones. Elsewhere the delays for blocking may change the order of keys; where this ends
  /// with the order it began with, the certificate holds. True if `out` changed, to something
  /// better unless `worse_too`.
  bool settle(const Decision& decision, Figures& out, bool worse_too, const Until& until = {});

 private:
  bool simulate(const Decision& decision, const Figures* keys, Charges& charges, Figures& out,
                const Until& until);
  void set_costs(Figures& out) const;
  void set_limits(double most);
  [[nodiscard]] double overload(const Decision& decision) const;

  const Problem& p_;
  std::vector<Tick> reference_;
  double reference_sum_ = 0;
  bool deadlines_ = false;
  std::vector<Exhibitor> exhibitors_;  ///< one per domain
  Rule rule_;
  std::vector<std::vector<int>> chain_xnodes_;  ///< [chain] those that its end waits for
  Charges used_, now_;
  std::vector<Tick> pad_;  ///< [xpu]
  std::vector<char> shared_;
  std::int64_t evaluations_ = 0;
};

}  // namespace xauto::solver::steady
