// SPDX-License-Identifier: Apache-2.0
// Search: assignment, keys, holds and windows on shared XPUs, by annealing from constructed starts. Before that, of
// components that go one after the other, the order (search_line_up.cc).
// Deterministic for a seed where `max_evaluations` ends it.
#pragma once

#include <functional>
#include <memory>
#include <vector>

#include "model/policy.h"
#include "solver/keys/evaluate.h"
#include "solver/keys/line_up.h"
#include "solver/keys/problem.h"
#include "solver/random.h"
#include "solver/until.h"

namespace xauto::solver::keys {

class TypicalPlay;

struct Candidate {
  Decision decision;
  Figures figures;
};

/// What is minimised, once no deadline is missed.
enum class Aim {
  kMix,  ///< the sum of worst case / deadline, the largest of them not above kWithin times the least found
  kLargest,  ///< the largest, of equal ones the sum
  kSum,      ///< the sum
};
inline constexpr double kWithin = 1.05;

/// The best so far; of a mix also that whose largest is the least.
class Incumbents {
 public:
  Incumbents(const Problem& problem, const std::vector<Tick>& reference, Aim aim);

  /// Of valid ones: whether it would change anything.
  [[nodiscard]] bool improved_by(const Figures& figures) const;
  /// True: it is best() now.
  bool add(const Candidate& candidate);
  /// As long as there is none: the one that is nearest to being valid.
  void add_invalid(const Candidate& candidate);

  [[nodiscard]] bool any() const { return best_.figures.valid; }
  [[nodiscard]] const Candidate& best() const { return best_; }
  [[nodiscard]] const Candidate& least() const { return mixes_ ? least_ : best_; }
  /// Of the mix there are two: first the least is looked for.
  [[nodiscard]] bool mixes() const { return mixes_; }
  [[nodiscard]] Goal first_goal() const;
  [[nodiscard]] Goal goal() const;
  /// No policy has less of the largest.
  [[nodiscard]] bool least_is_known() const {
    return least().figures.largest <= bound_ * kRounding;
  }
  /// There is one that misses no deadline.
  [[nodiscard]] bool is_in_time() const {
    return any() && (!deadlines_ || least().figures.largest <= 1);
  }
  /// As long as a deadline is missed that may be met, the largest alone counts.
  [[nodiscard]] bool may_sum() const { return any() && (!in_time_ || is_in_time()); }

 private:
  static constexpr double kRounding = 1 + 1e-12;
  bool deadlines_ = false, in_time_ = false, sums_ = false, mixes_ = false;
  double bound_ = 0;  ///< of the largest
  Candidate best_, least_;
};

/// What of a hint stays.
enum class Keep {
  kNothing,    ///< it is where the search begins
  kPlacement,  ///< every XNode is where it was
};

struct SearchLimits {
  Until until;
  Until finish_until;  ///< later: a construction that was begun in time is evaluated and certified
  std::int64_t max_evaluations = 0;  ///< 0: no limit
  /// Of a mix, for the least of the largest: a part of the former.
  Until least_until;
  /// Adds other threads' answers; may be empty.
  std::function<void(Incumbents&)> exchange;
};
/// Part of the evaluations, and of the time, for the least of the largest. Chosen.
inline constexpr double kForLeast = 0.4;

class Search {
 public:
  /// `on_better` of run(): each certified improvement.
  Search(const Problem& problem, const std::vector<Tick>& reference, Aim aim, std::uint64_t seed);

  /// Constructs, then anneals from the best until the limits. `hint` may be null.
  void run(const SearchLimits& limits, const Policy* hint, Keep keep,
           const std::function<void(const Candidate&)>& on_better);
  /// Candidates beside `best`, which is certified, that claim no more of any chain: that with the least
  /// typical latency, without holds that are not needed.
  void least_typical(TypicalPlay& play, const SearchLimits& limits, Keep keep, Candidate& best);
  [[nodiscard]] const Incumbents& found() const { return found_; }
  [[nodiscard]] std::int64_t evaluations() const { return evaluator_.evaluations(); }

 private:
  /// Whether the policy says for every job where it runs, by when, and in a way that fits this app.
  [[nodiscard]] bool fits(const Policy& hint) const;
  void begin_with(const Policy& hint, const std::function<void(const Candidate&)>& on_better);
  /// A decision from a policy's placements, its latest keys in ticks. Whoever has none is constructed.
  [[nodiscard]] Decision from_hint(const Policy& hint);
  [[nodiscard]] double typical_of(TypicalPlay& play, const Candidate& candidate, Windows& w) const;
  [[nodiscard]] bool over() const;
  /// Whether the least of the largest has been looked for long enough.
  [[nodiscard]] bool may_sum() const;
  [[nodiscard]] const Candidate& front() const {
    return goal_.sum ? found_.best() : found_.least();
  }
  void set_goal();
  [[nodiscard]] bool improves(const Figures& figures) const;
  void evaluate(Candidate& candidate);
  /// A line-up and what comes of it.
  struct Line {
    std::vector<int> order;   ///< components
    std::vector<char> waits;  ///< [sample] who reads is held until that has ended
    std::vector<Tick> hold;   ///< [xnode]
    bool interrupts = false;  ///< also where that costs
    LineUp::Where where;
    LineUp::Value planned;
    Candidate candidate;
  };
  void plan(Line& line);
  void decide(Line& line) const;
  void evaluate(Line& line);
  [[nodiscard]] bool hold_readers(Line& line) const;
  [[nodiscard]] bool plans_better(const LineUp::Value& a, const LineUp::Value& b) const;
  /// The components one after the other; then who goes first, and who waits.
  void line_up(const std::function<void(const Candidate&)>& on_better);
  void improve_line(const std::function<void(const Candidate&)>& on_better);
  [[nodiscard]] bool change_line(const Line& from, Line& next);
  /// With its windows.
  void try_start(Decision decision, const std::function<void(const Candidate&)>& on_better);
  void construct(const std::function<void(const Candidate&)>& on_better);
  [[nodiscard]] Decision constructed(const std::vector<std::int64_t>& weights, double greed,
                                     int rule, bool charge);
  /// Windows on shared XPUs: of each module's longest way `part` of what it has.
  void spread_windows(Decision& d, double part) const;
  [[nodiscard]] bool change_window(const Candidate& from, Decision& next, int xnode);
  void balance(std::vector<int>& xpu, int steps);
  void detour(Decision& d);
  void anneal(std::int64_t steps, double hot, bool elsewhere,
              const std::function<void(const Candidate&)>& on_better);
  void keep(const Candidate& candidate, const std::function<void(const Candidate&)>& on_better);
  void take(Candidate& candidate, const std::function<void(const Candidate&)>& on_better);
  void shift_holds(Decision& next, int v);
  [[nodiscard]] bool change_reader(const Candidate& from, Decision& next);
  [[nodiscard]] bool change_meeting(const Candidate& from, Decision& next);
  [[nodiscard]] bool mutate(const Candidate& from, Decision& next);
  void put(Decision& d, int xnode, int xpu) const;
  [[nodiscard]] int pick(const Candidate& from);
  void set_critical(const Candidate& of);

  const Problem& p_;
  std::vector<Tick> reference_;
  Evaluator evaluator_;
  Random random_;
  SearchLimits limits_;
  Keep keep_ = Keep::kNothing;
  bool proven_ = false;  ///< every chain is at its bound
  Incumbents found_;
  Goal goal_;
  std::unique_ptr<LineUp> lines_;
  Line line_;                  ///< the best of them; without an order there is none
  int stays_ = -1;             ///< XNode that keeps its XPU in this turn; -1: none
  std::vector<int> critical_;  ///< XNodes of the chain that sets the cost
  std::vector<int> readers_;

  std::vector<char> shared_;  ///< [xpu] of the annealer's state
};

}  // namespace xauto::solver::keys
