// SPDX-License-Identifier: Apache-2.0
// The compact model: which type each XNode takes, and nothing about order. A relaxation of the
// problem, hence a bound; what it chooses is scheduled by list. Rows in docs/ilp.md.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <map>
#include <set>
#include <tuple>

#include "base/index.h"
#include "solver/bounds.h"
#include "solver/heft.h"
#include "solver/ilp.h"
#include "solver/ilp_model.h"
#include "solver/simulate.h"

namespace xauto::solver {
namespace {

using Term = IlpModel::Term;
using Clock = std::chrono::steady_clock;

constexpr int kRounds = 40;          ///< of adding rows
constexpr double kViolation = 1e-4;  ///< of the horizon

std::string tag(const char* what, int i, int j) {
  return std::string(what) + "_" + std::to_string(i) + "_" + std::to_string(j);
}

class CompactModel {
 public:
  CompactModel(const Problem& problem, Time horizon, Time low)
      : p_(problem),
        unit_(static_cast<double>(horizon) / kHorizon),
        heads_(static_heads(problem)),
        tails_(static_tails(problem)) {
    makespan_ = model_.add_column("T", static_cast<double>(low) / unit_, kHorizon);
    for (int i = 0; i < p_.num_xnodes; ++i) {
      s_.push_back(model_.add_column(tag("s", i, 0), scaled(heads_[at(i)]), kHorizon));
      for (int t = 0; t < p_.num_types; ++t)
        x_.push_back(p_.wcet(i, t) == kCannotRun ? 0 : model_.add_column(tag("x", i, t), 0, 1));
    }
    for (int i = 0; i < p_.num_xnodes; ++i) {
      std::vector<Term> one;
      for (int t = 0; t < p_.num_types; ++t)
        if (x(i, t) > 0) one.push_back({x(i, t), 1});
      model_.equal(tag("one", i, 0), one, 1);
      // Chains at the WCETs chosen.
      for (const int k : p_.succ[at(i)])
        model_.at_least(tag("chain", i, k), after(s_[at(k)], i), 0);
      model_.at_least(tag("end", i, 0), after(makespan_, i), scaled(tails_[at(i)]));
    }
    for (int t = 0; t < p_.num_types; ++t) add_energy(t, 0, 0);
    model_.minimise(makespan_);
  }

  /// Solves the LP, adds the energy rows it violates, until none is; the bound, or nullopt.
  std::optional<double> relax(Clock::time_point deadline, const std::atomic<bool>* stop,
                              int max_rows) {
    std::optional<double> bound;
    for (int round = 0; round < kRounds; ++round) {
      const double left = std::chrono::duration<double>(deadline - Clock::now()).count();
      if (left <= 0 || model_.solve(left, stop) != IlpModel::Outcome::kOptimal) break;
      bound = model_.value(makespan_) * unit_;
      if (!separate(max_rows)) break;
    }
    return bound;
  }

  IlpModel::Outcome branch(double time_limit_s, const std::atomic<bool>* stop) {
    for (const int column : x_)
      if (column > 0) model_.set_binary(column, true);
    return model_.solve(time_limit_s, stop);
  }

  IlpModel& model() { return model_; }
  [[nodiscard]] Time makespan() const {
    return static_cast<Time>(std::ceil(model_.value(makespan_) * unit_ - 0.05));
  }
  [[nodiscard]] double share(int i, int t) const { return x(i, t) > 0 ? model_.value(x(i, t)) : 0; }
  void cut_off(Time makespan) {
    model_.set_range(makespan_, 0, static_cast<double>(makespan) / unit_);
  }

 private:
  [[nodiscard]] int x(int i, int t) const { return x_[at(i) * at(p_.num_types) + at(t)]; }
  [[nodiscard]] double scaled(Time us) const { return static_cast<double>(us) / unit_; }

  /// column - s_i - sum over t of wcet_i^t x_i^t
  [[nodiscard]] std::vector<Term> after(int column, int i) const {
    std::vector<Term> row = {{column, 1}, {s_[at(i)], -1}};
    for (int t = 0; t < p_.num_types; ++t)
      if (x(i, t) > 0) row.push_back({x(i, t), -scaled(p_.wcet(i, t))});
    return row;
  }

  /// What has a head >= h and a tail >= q fits on the instances of t between h and T - q.
  void add_energy(int t, Time h, Time q) {
    if (!known_.insert({t, h, q}).second) return;
    const auto count = static_cast<double>(p_.type_xpus[at(t)].size());
    std::vector<Term> row = {{makespan_, count}};
    for (int i = 0; i < p_.num_xnodes; ++i)
      if (x(i, t) > 0 && heads_[at(i)] >= h && tails_[at(i)] >= q)
        row.push_back({x(i, t), -scaled(p_.wcet(i, t))});
    model_.at_least(
        "energy_" + std::to_string(t) + "_" + std::to_string(h) + "_" + std::to_string(q), row,
        count * (scaled(h) + scaled(q)));
    ++rows_of_type_[t];
  }

  bool separate(int max_rows) {
    struct Violated {
      double by;
      int type;
      Time h, q;
    };
    std::vector<Violated> found;
    const double T = model_.value(makespan_);
    for (int t = 0; t < p_.num_types; ++t) {
      if (rows_of_type_[t] >= max_rows) continue;
      const auto count = static_cast<double>(p_.type_xpus[at(t)].size());
      std::vector<int> members;
      for (int i = 0; i < p_.num_xnodes; ++i)
        if (x(i, t) > 0 && model_.value(x(i, t)) > 1e-9) members.push_back(i);
      std::sort(members.begin(), members.end(),
                [&](int a, int b) { return heads_[at(a)] > heads_[at(b)]; });
      std::set<Time> tails;
      for (const int i : members) tails.insert(tails_[at(i)]);
      for (const Time q : tails) {
        double work = 0;
        Violated most{kViolation * kHorizon, -1, 0, 0};
        for (std::size_t k = 0; k < members.size(); ++k) {
          const int i = members[k];
          if (tails_[at(i)] < q) continue;
          work += scaled(p_.wcet(i, t)) * model_.value(x(i, t));
          const double by = work / count + scaled(heads_[at(i)]) + scaled(q) - T;
          if (by > most.by) most = {by, t, heads_[at(i)], q};
        }
        if (most.type >= 0) found.push_back(most);
      }
    }
    std::sort(found.begin(), found.end(),
              [](const Violated& a, const Violated& b) { return a.by > b.by; });
    if (found.size() > 12) found.resize(12);
    const std::size_t before = known_.size();
    for (const Violated& row : found) add_energy(row.type, row.h, row.q);
    return known_.size() > before;
  }

  const Problem& p_;
  const double unit_;
  const std::vector<Time> heads_, tails_;
  IlpModel model_;
  int makespan_ = 0;
  std::vector<int> s_, x_;
  std::set<std::tuple<int, Time, Time>> known_;
  std::map<int, int> rows_of_type_;
};

Clock::time_point deadline_of(const IlpOptions& options) {
  return Clock::now() + std::chrono::microseconds(static_cast<std::int64_t>(
                            std::clamp(options.time_limit_s, 0.0, 1e7) * 1e6));
}

/// A bound from floating point: a hair down, then up to the next microsecond.
Time safe_bound(double bound) {
  return static_cast<Time>(std::ceil(bound * (1 - 1e-8) - 0.05));
}

}  // namespace

Decision decision_from_types(const Problem& problem, const std::vector<int>& types) {
  Problem narrowed = problem;
  for (int i = 0; i < problem.num_xnodes; ++i)
    for (int t = 0; t < problem.num_types; ++t)
      if (t != types[at(i)]) narrowed.wcet_flat[at(i) * at(problem.num_types) + at(t)] = kCannotRun;
  Decision decision = heft(narrowed);
  Decision by_finish = decision;
  by_finish.priority = priorities_by_key(simulate(problem, decision).finish);
  return simulate(problem, by_finish).makespan < simulate(problem, decision).makespan ? by_finish
                                                                                      : decision;
}

Result<LpBound> lp_bound(const Problem& problem, const IlpOptions& options) {
  const Decision incumbent = options.incumbent ? *options.incumbent : heft(problem);
  const Time horizon = simulate(problem, incumbent).makespan;
  CompactModel compact(problem, horizon, 0);
  const auto bound = compact.relax(deadline_of(options), options.stop, options.max_rows_per_type);
  LpBound answer;
  answer.bound = std::max(options.known_bound, quick_bound(problem));
  if (bound) {
    answer.bound = std::max(answer.bound, safe_bound(*bound));
    for (int i = 0; i < problem.num_xnodes; ++i)
      for (int t = 0; t < problem.num_types; ++t) answer.share.push_back(compact.share(i, t));
  }
  return answer;
}

Result<IlpAnswer> solve_ilp_compact(const Problem& problem, const IlpOptions& options) {
  IlpAnswer answer;
  answer.decision = options.incumbent ? *options.incumbent : heft(problem);
  answer.makespan = simulate(problem, *answer.decision).makespan;
  answer.bound = std::max(options.known_bound, quick_bound(problem));
  const Clock::time_point deadline = deadline_of(options);
  CompactModel compact(problem, answer.makespan, 0);
  if (const auto relaxed = compact.relax(deadline, options.stop, options.max_rows_per_type))
    answer.bound = std::max(answer.bound, safe_bound(*relaxed));
  answer.rows = compact.model().rows();
  answer.columns = compact.model().columns();
  if (!options.write_model.empty() && !compact.model().write(options.write_model))
    return fail(ErrorCode::kIo, "cannot write the model", options.write_model);
  answer.status = "the relaxation meets the incumbent";
  answer.finished = answer.bound >= answer.makespan;
  if (!answer.finished) {
    const double left = std::chrono::duration<double>(deadline - Clock::now()).count();
    using Outcome = IlpModel::Outcome;
    const Outcome outcome = compact.branch(std::max(left, 0.0), options.stop);
    answer.nodes = compact.model().nodes();
    if (outcome == Outcome::kOptimal || outcome == Outcome::kFeasible) {
      answer.model_makespan = compact.makespan();
      std::vector<int> types;
      for (int i = 0; i < problem.num_xnodes; ++i) {
        int best = 0;
        for (int t = 1; t < problem.num_types; ++t)
          if (compact.share(i, t) > compact.share(i, best)) best = t;
        types.push_back(best);
      }
      Decision found = decision_from_types(problem, types);
      const Time makespan = simulate(problem, found).makespan;
      if (makespan < answer.makespan) {
        answer.decision = std::move(found);
        answer.makespan = makespan;
      }
    }
    answer.finished = outcome == Outcome::kOptimal || outcome == Outcome::kInfeasible;
    if (outcome == Outcome::kOptimal) answer.bound = std::max(answer.bound, answer.model_makespan);
    answer.status = outcome == Outcome::kOptimal      ? "optimal assignment"
                    : outcome == Outcome::kFeasible   ? "feasible assignment"
                    : outcome == Outcome::kInfeasible ? "infeasible"
                    : outcome == Outcome::kStopped    ? "stopped"
                    : outcome == Outcome::kTimeLimit  ? "time limit"
                                                      : "lp_solve gave up";
  }
  answer.bound = std::min(answer.bound, answer.makespan);
  answer.proven = answer.bound == answer.makespan;
  return answer;
}

}  // namespace xauto::solver
