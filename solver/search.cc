// SPDX-License-Identifier: Apache-2.0
// See search.h.
#include "solver/search.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <queue>
#include <tuple>

#include "base/index.h"
#include "solver/bounds.h"
#include "solver/ordered.h"
#include "solver/random.h"

namespace xauto::solver {
namespace {

// ---- constants of the search --------------------------------------------------------------------
// Unless it says more, a value was set with the first search, on apps of up to 60 XNodes, and
// stayed: no measurement of its neighbours is kept, so there is room to tune. `make bench` shows
// what a change does.

// Temperatures, as shares of the best makespan. How they fall with the app's size was tuned on the
// synthetic app of 1000 XNodes: its gap went from 5.1 % after 60 s to 4.3 % after 25 s; up to
// kLarge XNodes nothing changes. Where a round begins was tuned on the first 15 DAGs of N = 40, one
// thread, without the proof: mean makespan above the best that was seen, 0.31 -> 0.09 % of `small`
// (5 million evaluations, one seed), 0.23 -> 0.07 % of `large` (2 million, two seeds). 0.012 and
// 0.03 were before; 0.006 and 0.03, 0.006 and 0.012, 0.01 and 0.025 lie between.
constexpr double kHot = 0.008;     ///< a round begins here
constexpr double kHottest = 0.02;  ///< ... or here, every kHottestEvery-th time, to leave a basin
constexpr int kHottestEvery = 3;
constexpr double kCold = 0.0002;  ///< and ends here

// Steps of a round, half as many again every other round.
constexpr std::int64_t kStepsPerXNode = 200, kStepsAtLeast = 2000;
constexpr int kStepsPerTemperature = 64;  ///< the temperature falls every so many steps
constexpr int kStepsPerChain = 8;         ///< accepted moves make the critical chain stale
constexpr std::uint64_t kRoundsPerStay =
    4;  ///< one in so many goes on where it is, not at the best

// Moves, in percent: to another XPU, exchange of places with an XNode elsewhere; the rest are
// shifts in the sequence.
constexpr std::uint64_t kMovePercent = 40, kExchangePercent = 15;
constexpr std::uint64_t kMostHops = 3;  ///< of a shift: past so many neighbours on its XPU

// Between two looks at the clock: as many XNodes and edges as take some ten milliseconds at most,
// on the machines that this was written on.
constexpr std::int64_t kVisitsPerLook = 400'000, kMostStepsPerLook = 1024;
constexpr int kPollsPerReport = 16;

/// A priced list: an XNode may go to types that cost at most this much more than its cheapest.
constexpr double kPriceSlack = 1.1;
/// Weights of the use of an XPU in the constructive lists; negative: by prices.
constexpr double kSpreads[] = {0.0, 0.5, 1.0, -1.0};

/// Non-preemptive insertion-free list scheduling: by descending rank, each XNode goes where it ends
/// first.
/// `prices`, if not empty: an XNode may go only where price * wcet is within kPriceSlack of its
/// least.
Solution list_schedule(const Problem& problem, const std::vector<double>& rank, double spread,
                       const std::vector<std::int64_t>& prices = {}) {
  const std::size_t n = at(problem.num_xnodes);
  Solution solution;
  solution.xpu.assign(n, -1);
  std::vector<Time> free_at(at(problem.num_xpus), 0), finish(n, 0);
  std::vector<int> missing(n, 0);
  // Highest rank first; of equals, whoever became ready first.
  using Waiting = std::tuple<double, int, int>;  // rank, - order of arrival, XNode
  std::priority_queue<Waiting> ready;
  int arrivals = 0;
  const auto arrive = [&](int i) { ready.emplace(rank[at(i)], --arrivals, i); };
  for (std::size_t i = 0; i < n; ++i) {
    missing[i] = static_cast<int>(problem.pred[i].size());
    if (missing[i] == 0) arrive(static_cast<int>(i));
  }
  std::vector<double> start(n, 0);
  while (!ready.empty()) {
    const int i = std::get<2>(ready.top());
    ready.pop();
    Time released = 0;
    for (int p : problem.pred[at(i)]) released = std::max(released, finish[at(p)]);
    double best_score = 0;
    double cheapest = 1e300;
    const auto charge = [&](int x) {
      return prices.empty() ? 0
                            : static_cast<double>(prices[at(problem.xpu_type[at(x)])]) *
                                  static_cast<double>(problem.wcet_on(i, x));
    };
    for (int x = 0; x < problem.num_xpus; ++x)
      if (problem.wcet_on(i, x) != kCannotRun) cheapest = std::min(cheapest, charge(x));
    for (int x = 0; x < problem.num_xpus; ++x) {
      const Time wcet = problem.wcet_on(i, x);
      if (wcet == kCannotRun || charge(x) > kPriceSlack * cheapest) continue;
      const Time begin = std::max(released, free_at[at(x)]);
      // `spread` charges the use of the XPU itself, so that scarce fast XPUs go to those who gain
      // most.
      const double score = static_cast<double>(begin + wcet) + spread * static_cast<double>(wcet);
      if (solution.xpu[at(i)] < 0 || score < best_score) {
        best_score = score;
        solution.xpu[at(i)] = x;
        start[at(i)] = static_cast<double>(begin);
        finish[at(i)] = begin + wcet;
      }
    }
    free_at[at(solution.xpu[at(i)])] = finish[at(i)];
    for (int s : problem.succ[at(i)])
      if (--missing[at(s)] == 0) arrive(s);
  }
  solution.sequence.resize(n);
  std::iota(solution.sequence.begin(), solution.sequence.end(), 0);
  std::stable_sort(solution.sequence.begin(), solution.sequence.end(), [&](int a, int b) {
    return start[at(a)] != start[at(b)] ? start[at(a)] < start[at(b)] : rank[at(a)] > rank[at(b)];
  });
  return solution;
}

/// `Eval`: Evaluator or OrderedEvaluator; `kMixed`: XNodes may wait for each other.
template <class Eval, bool kMixed = false>
class Annealer {
 public:
  /// `around`: for an evaluator that takes it.
  template <class... Around>
  Annealer(const Problem& problem, std::uint64_t seed, const StopWhen& stop_when,
           const SearchCallbacks& callbacks, const Around*... around)
      : problem_(problem),
        stop_when_(stop_when),
        callbacks_(callbacks),
        evaluator_(problem, around...),
        random_(seed) {
    const std::size_t n = at(problem.num_xnodes);
    options_.resize(n);
    for (std::size_t i = 0; i < n; ++i) {
      for (int x = 0; x < problem.num_xpus; ++x)
        if (problem.wcet_on(static_cast<int>(i), x) != kCannotRun) options_[i].push_back(x);
    }
    std::int64_t size = problem.num_xnodes;
    for (const auto& list : problem.succ) size += static_cast<std::int64_t>(list.size());
    look_ = std::clamp<std::int64_t>(kVisitsPerLook / size, 1, kMostStepsPerLook);
    group_of_.assign(n, nullptr);
    for (const auto& group : problem.groups)
      for (int i : group) group_of_[at(i)] = &group;
  }

  Solution run(const Solution& start) {
    reset(start);
    best_.makespan = kNever;
    note_if_better();
    // Rounds of growing length; each cools down from a temperature that suits the current solution.
    std::int64_t length =
        kStepsPerXNode * static_cast<std::int64_t>(problem_.num_xnodes) + kStepsAtLeast;
    for (int k = 0; k < stop_when_.effort; ++k) length += length / 2;
    for (int round = 0; !done_; ++round) {
      // Temperatures follow the size of one XNode's effect, which falls as the app grows; and a
      // large app has no time to cool down from anything that is far from its start.
      const double share =
          std::min(1.0, static_cast<double>(kLarge) / static_cast<double>(problem_.num_xnodes));
      const double scale = share * share;
      const double hot = (round % kHottestEvery == 2 ? kHottest : kHot) * scale;
      // That of a part (ordered.h) may be nothing, or less.
      const auto base = static_cast<double>(std::max<Time>(1, best_.makespan));
      cool(length, hot * base, kCold * scale * base);
      if (round % 2 == 1) length += length / 2;
      if (random_.below(kRoundsPerStay) != 0) reset(best_);
    }
    if (callbacks_.on_evaluations) callbacks_.on_evaluations(evaluator_.evaluations() - reported_);
    return best_;
  }

 private:
  void reset(const Solution& solution) {
    if constexpr (kMixed)
      evaluator_.reset(solution.xpu, solution.sequence, solution.waits_for);
    else
      evaluator_.reset(solution.xpu, solution.sequence);
  }

  void cool(std::int64_t length, double hot, double cold) {
    const std::int64_t temperatures = length / kStepsPerTemperature + 1;
    const double factor = std::pow(cold / hot, 1.0 / static_cast<double>(temperatures));
    double temperature = hot;
    evaluator_.critical_chain(chain_);
    for (std::int64_t step = 0; step < length; ++step) {
      if (step % kStepsPerTemperature == 0) {
        temperature *= factor;
        if (check_limits()) return;
      }
      if (step % look_ == 0 && stop_when_.stopped()) {
        done_ = true;
        return;
      }
      propose();
      const double slack = -temperature * std::log(random_.unit());
      const Time limit = evaluator_.makespan() + static_cast<Time>(slack) + 1;
      if (evaluator_.evaluate(limit) == kNever) {
        evaluator_.rollback();
        continue;
      }
      evaluator_.commit();
      note_if_better();
      if (step % kStepsPerChain == 0 || chain_.empty()) evaluator_.critical_chain(chain_);
    }
  }

  void propose() {
    const int n = problem_.num_xnodes;
    const std::uint64_t kind = random_.below(100);
    // Half of the moves start from the chain that sets the makespan.
    const int i = (kind % 2 == 0 && !chain_.empty())
                      ? chain_[random_.below(chain_.size())]
                      : static_cast<int>(random_.below(static_cast<std::uint64_t>(n)));
    if constexpr (kMixed) {
      if (random_.below(2) == 0) {
        change_waiting(i);
        return;
      }
    }
    if (kind < kMovePercent && options_[at(i)].size() > 1) {
      move_to(i, other_xpu(i));
    } else if (kind < kMovePercent + kExchangePercent) {
      // Exchange of places with an XNode on another XPU.
      const int j = static_cast<int>(random_.below(static_cast<std::uint64_t>(n)));
      const int xi = evaluator_.xpu()[at(i)], xj = evaluator_.xpu()[at(j)];
      if (xi == xj || group_of_[at(i)] != nullptr || group_of_[at(j)] != nullptr ||
          problem_.wcet_on(i, xj) == kCannotRun || problem_.wcet_on(j, xi) == kCannotRun) {
        shift(i);
        return;
      }
      const int pi = evaluator_.position(i), pj = evaluator_.position(j);
      evaluator_.assign(i, xj);
      evaluator_.assign(j, xi);
      evaluator_.reposition(i, pj);
      evaluator_.reposition(j, pi);
    } else {
      shift(i);
    }
  }

  /// `i` waits no more; those that wait for it go on waiting for whom it waited for, or for nobody.
  void leave(int i) {
    const std::vector<int>& waits_for = evaluator_.waits_for();
    const int before = random_.below(2) == 0 ? waits_for[at(i)] : -1;
    for (int j = 0; j < problem_.num_xnodes; ++j)
      if (waits_for[at(j)] == i) evaluator_.wait_for(j, before);
    evaluator_.wait_for(i, -1);
  }

  /// `i` waits for another one of its XPU; those that wait for that one then wait for `i`, or not.
  void join(int i) {
    const std::vector<int>& waits_for = evaluator_.waits_for();
    mates_.clear();
    for (int j = 0; j < problem_.num_xnodes; ++j)
      if (j != i && evaluator_.xpu()[at(j)] == evaluator_.xpu()[at(i)]) mates_.push_back(j);
    if (mates_.empty()) return;
    const int other = mates_[random_.below(mates_.size())];
    if (random_.below(2) == 0)
      for (int j : mates_)
        if (waits_for[at(j)] == other) evaluator_.wait_for(j, i);
    evaluator_.wait_for(i, other);
  }

  void change_waiting(int i) {
    const bool waited = evaluator_.waits_for()[at(i)] >= 0;
    leave(i);
    if (waited && random_.below(2) == 0)
      shift(i);
    else
      join(i);
  }

  int other_xpu(int i) {
    const auto& options = options_[at(i)];
    while (true) {
      const int x = options[random_.below(options.size())];
      if (x != evaluator_.xpu()[at(i)]) return x;
    }
  }

  void move_to(int i, int x) {
    if constexpr (kMixed)
      if (random_.below(2) == 0) leave(i);
    if (group_of_[at(i)] != nullptr) {
      for (int member : *group_of_[at(i)]) evaluator_.assign(member, x);
    } else {
      evaluator_.assign(i, x);
    }
    if constexpr (kMixed)
      if (random_.below(2) == 0) join(i);
    if (random_.below(2) == 0) shift(i);
  }

  /// Puts `i` just before or after another XNode of its XPU.
  void shift(int i) {
    const int x = evaluator_.xpu()[at(i)];
    const int n = problem_.num_xnodes;
    const int from = evaluator_.position(i);
    // Up to a few neighbours away, in either direction.
    const bool earlier = random_.below(2) == 0;
    auto hops = static_cast<int>(1 + random_.below(kMostHops));
    int target = from;
    for (int p = from + (earlier ? -1 : 1); p >= 0 && p < n; p += earlier ? -1 : 1) {
      if (evaluator_.xpu()[at(evaluator_.sequence()[at(p)])] != x) continue;
      target = p;
      if (--hops == 0) break;
    }
    if (target != from) evaluator_.reposition(i, target);
  }

  void note_if_better() {
    if (evaluator_.makespan() >= best_.makespan) return;
    best_ = {evaluator_.xpu(), evaluator_.sequence(), evaluator_.makespan()};
    if constexpr (kMixed) best_.waits_for = active_waiting();
    if (callbacks_.on_better) callbacks_.on_better(best_);
  }

  /// Without the dormant ones; empty if nobody waits.
  std::vector<int> active_waiting() const {
    std::vector<int> waits_for = evaluator_.waits_for();
    bool any = false;
    for (std::size_t i = 0; i < waits_for.size(); ++i) {
      int& other = waits_for[i];
      if (other >= 0 && evaluator_.xpu()[at(other)] != evaluator_.xpu()[i]) other = -1;
      any = any || other >= 0;
    }
    if (!any) waits_for.clear();
    return waits_for;
  }

  bool check_limits() {
    const std::int64_t evaluations = evaluator_.evaluations();
    if (stop_when_.max_evaluations > 0 && evaluations >= stop_when_.max_evaluations) done_ = true;
    if (stop_when_.target != nullptr &&
        best_.makespan <= stop_when_.target->load(std::memory_order_relaxed))
      done_ = true;
    if (++polls_ % kPollsPerReport == 0) {
      if (callbacks_.on_evaluations) callbacks_.on_evaluations(evaluations - reported_);
      reported_ = evaluations;
    }
    return done_;
  }

  const Problem& problem_;
  const StopWhen& stop_when_;
  const SearchCallbacks& callbacks_;
  Eval evaluator_;
  Random random_;
  std::vector<std::vector<int>> options_;
  std::vector<const std::vector<int>*> group_of_;
  std::vector<int> chain_, mates_;
  Solution best_;
  bool done_ = false;
  std::int64_t look_ = 1;  ///< steps between two looks at the clock
  std::int64_t polls_ = 0, reported_ = 0;
};

}  // namespace

std::vector<int> sequence_of(const std::vector<std::int64_t>& priority) {
  std::vector<int> sequence(priority.size());
  std::iota(sequence.begin(), sequence.end(), 0);
  std::stable_sort(sequence.begin(), sequence.end(),
                   [&](int a, int b) { return priority[at(a)] > priority[at(b)]; });
  return sequence;
}

void gather_groups(const Problem& problem, std::vector<int>& xpu) {
  for (const auto& group : problem.groups) {
    std::vector<int> votes(at(problem.num_xpus), 0);
    for (int i : group)
      if (problem.wcet_on(group.front(), xpu[at(i)]) != kCannotRun) ++votes[at(xpu[at(i)])];
    const auto most = std::max_element(votes.begin(), votes.end());
    int target = static_cast<int>(most - votes.begin());
    for (int x = 0; *most == 0 && x < problem.num_xpus; ++x)
      if (problem.wcet_on(group.front(), x) != kCannotRun) target = x;
    for (int i : group) xpu[at(i)] = target;
  }
}

Decision to_decision(const Solution& solution) {
  Decision decision;
  decision.xpu = solution.xpu;
  decision.priority.resize(solution.xpu.size());
  std::int64_t priority = static_cast<std::int64_t>(solution.sequence.size());
  for (int i : solution.sequence) decision.priority[at(i)] = priority--;
  for (std::size_t i = 0; i < solution.waits_for.size(); ++i)
    if (solution.waits_for[i] >= 0)
      decision.order.emplace_back(solution.waits_for[i], static_cast<int>(i));
  return decision;
}

std::vector<Solution> constructive_solutions(const Problem& problem, const Until& until) {
  const std::size_t n = at(problem.num_xnodes);
  std::vector<Solution> solutions;
  Evaluator evaluator(problem);
  std::vector<std::int64_t> prices;
  (void)balanced_load_bound(problem, &prices, until);
  for (int rule = 0; rule < 3; ++rule) {
    std::vector<double> rank(n, 0);
    for (std::size_t k = n; k-- > 0;) {
      const int i = problem.topo[k];
      double least = 1e300, greatest = 0, sum = 0, count = 0;
      for (int t = 0; t < problem.num_types; ++t) {
        const Time wcet = problem.wcet(i, t);
        if (wcet == kCannotRun || problem.type_xpus[at(t)].empty()) continue;
        const auto w = static_cast<double>(wcet);
        least = std::min(least, w);
        greatest = std::max(greatest, w);
        const auto instances = static_cast<double>(problem.type_xpus[at(t)].size());
        sum += w * instances;
        count += instances;
      }
      double tail = 0;
      for (int s : problem.succ[at(i)]) tail = std::max(tail, rank[at(s)]);
      rank[at(i)] = tail + (rule == 0 ? least : rule == 1 ? sum / count : greatest);
    }
    for (const double spread : kSpreads) {
      if (!solutions.empty() && until.over()) break;
      Solution solution = spread < 0 ? list_schedule(problem, rank, 0, prices)
                                     : list_schedule(problem, rank, spread);
      gather_groups(problem, solution.xpu);
      evaluator.reset(solution.xpu, solution.sequence);
      solution.makespan = evaluator.makespan();
      solutions.push_back(std::move(solution));
    }
  }
  std::stable_sort(solutions.begin(), solutions.end(),
                   [](const Solution& a, const Solution& b) { return a.makespan < b.makespan; });
  return solutions;
}

Solution anneal(const Problem& problem, const Solution& start, std::uint64_t seed,
                const StopWhen& stop_when, const SearchCallbacks& callbacks) {
  return Annealer<Evaluator>(problem, seed, stop_when, callbacks).run(start);
}

Solution anneal_ordered(const Problem& problem, const Solution& start, std::uint64_t seed,
                        const StopWhen& stop_when, const SearchCallbacks& callbacks,
                        const Surroundings* around) {
  Solution answer =
      Annealer<OrderedEvaluator>(problem, seed, stop_when, callbacks, around).run(start);
  answer.ordered = true;
  return answer;
}

Solution anneal_mixed(const Problem& problem, const Solution& start, std::uint64_t seed,
                      const StopWhen& stop_when, const SearchCallbacks& callbacks) {
  return Annealer<Evaluator, true>(problem, seed, stop_when, callbacks).run(start);
}

Solution as_waiting(const Solution& ordered) {
  Solution waiting = ordered;
  waiting.ordered = false;
  waiting.waits_for.assign(ordered.xpu.size(), -1);
  std::vector<int> last(ordered.xpu.size(), -1);  // by XPU, of which there may be more
  for (int i : ordered.sequence) {
    const std::size_t x = at(ordered.xpu[at(i)]);
    if (x >= last.size()) last.resize(x + 1, -1);
    waiting.waits_for[at(i)] = last[x];
    last[x] = i;
  }
  return waiting;
}

Solution by_finish(const Problem& problem, const Solution& solution) {
  Evaluator evaluator(problem);
  const Solution waiting = solution.ordered ? as_waiting(solution) : solution;
  evaluator.reset(waiting.xpu, waiting.sequence, waiting.waits_for);
  Solution sorted{solution.xpu, solution.sequence};
  std::stable_sort(sorted.sequence.begin(), sorted.sequence.end(),
                   [&](int a, int b) { return evaluator.finish(a) < evaluator.finish(b); });
  evaluator.reset(sorted.xpu, sorted.sequence);
  sorted.makespan = evaluator.makespan();
  return sorted;
}

}  // namespace xauto::solver
