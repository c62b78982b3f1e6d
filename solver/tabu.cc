// SPDX-License-Identifier: Apache-2.0
// See tabu.h.
#include "solver/tabu.h"

#include <algorithm>
#include <numeric>

#include "base/index.h"
#include "solver/disjunctive.h"
#include "solver/random.h"

namespace xauto::solver {
namespace {

// None is tuned: each was chosen with the first tabu search. Measured is only the search as a
// whole (docs/results/solver.txt).

constexpr std::size_t kPool = 12;           ///< schedules that a new beginning may lie between
constexpr std::int64_t kPatience = 12'000;  ///< moves without a better schedule
/// Moves that what was undone stays forbidden for: this and the mean length of an XPU's list, and
/// by chance up to half as many again.
constexpr std::int64_t kTenure = 4;
constexpr int kMovesPerLook = 32;
/// A new beginning counts as so many moves. So what was forbidden is not any more, with lists of up
/// to 660 XNodes.
constexpr std::int64_t kPast = 1000;
/// A new beginning between two lies so far on the way from one to the other, and up to so much
/// further.
constexpr double kNearest = 0.3, kFurther = 0.4;
/// A new beginning near one: XNodes move by up to this share of all places, and one in so many to
/// an XPU by chance.
constexpr double kShaken = 0.3;
constexpr std::uint64_t kOneInElsewhere = 10;

}  // namespace

class TabuSearch::Walk {
 public:
  Walk(const Problem& problem, std::uint64_t seed)
      : problem_(problem), n_(at(problem.num_xnodes)), graph_(problem), random_(seed) {
    order_until_.assign(n_ * n_, 0);
    xpu_until_.assign(n_ * at(problem.num_xpus), 0);
    options_.resize(n_);
    for (std::size_t i = 0; i < n_; ++i)
      for (int x = 0; x < problem.num_xpus; ++x)
        if (problem.wcet_on(static_cast<int>(i), x) != kCannotRun) options_[i].push_back(x);
  }

  Solution run(const Solution& start, const StopWhen& stop_when, const SearchCallbacks& callbacks) {
    if (best_.sequence.empty() || start.makespan < best_.makespan) {
      graph_.reset(start.xpu, start.sequence);
      begin_at(current());
      best_ = local_;
      if (callbacks.on_better) callbacks.on_better(best_);
    }
    std::int64_t reported = 0;
    evaluations_ = 0;
    const auto over = [&] {
      if (callbacks.on_evaluations) callbacks.on_evaluations(evaluations_ - reported);
      reported = evaluations_;
      return stop_when.stopped() ||
             (stop_when.max_evaluations > 0 && evaluations_ >= stop_when.max_evaluations) ||
             (stop_when.target != nullptr &&
              best_.makespan <= stop_when.target->load(std::memory_order_relaxed));
    };
    for (std::int64_t move = 1; move % kMovesPerLook != 0 || !over(); ++move) {
      if (!step() || idle_ > kPatience) {
        begin_anew();
        continue;
      }
      if (graph_.makespan() >= best_.makespan) continue;
      best_ = current();
      if (callbacks.on_better) callbacks.on_better(best_);
    }
    return best_;
  }

 private:
  struct Move {
    int xnode = -1, xpu = -1;
    std::size_t place = 0;
    Time estimate = 0;
  };

  [[nodiscard]] Solution current() const {
    return {graph_.xpu(), graph_.sequence(), graph_.makespan(), true, {}};
  }

  void begin_at(const Solution& solution) {
    local_ = solution;
    idle_ = 0;
    // What was forbidden lies in the past from now on.
    now_ += kPast;
  }

  /// The critical path, and its blocks: [begin, end) of path_.
  void find_path() {
    path_.clear();
    int i = -1;
    std::uint64_t ties = 0;
    for (const int k : graph_.sequence())
      if (graph_.head(k) == 0 && graph_.critical(k) && random_.below(++ties) == 0) i = k;
    while (i >= 0) {
      path_.push_back(i);
      const auto& list = graph_.on(graph_.xpu()[at(i)]);
      const std::size_t place = graph_.place(i);
      int next = -1;
      if (place + 1 < list.size() && graph_.head(list[place + 1]) == graph_.done(i) &&
          graph_.critical(list[place + 1]))
        next = list[place + 1];
      if (next < 0 || random_.below(2) == 0)
        if (const int s = graph_.critical_successor(i); s >= 0) next = s;
      i = graph_.left(i) > graph_.work(i) ? next : -1;
    }
  }

  [[nodiscard]] bool forbidden(int xpu, std::size_t from, std::size_t to) const {
    const auto& list = graph_.on(xpu);
    const int moved = list[from];
    if (from < to) {
      for (std::size_t k = from + 1; k <= to; ++k)
        if (order_until_[at(list[k]) * n_ + at(moved)] > now_) return true;
    } else {
      for (std::size_t k = to; k < from; ++k)
        if (order_until_[at(moved) * n_ + at(list[k])] > now_) return true;
    }
    return false;
  }

  void consider(const Move& move, bool tabu) {
    if (tabu && move.estimate >= local_.makespan) {
      if (random_.below(++tabu_moves_) == 0) any_ = move;
      return;
    }
    if (chosen_.xnode >= 0 && move.estimate > chosen_.estimate) return;
    ties_ = chosen_.xnode >= 0 && move.estimate == chosen_.estimate ? ties_ + 1 : 1;
    if (random_.below(ties_) == 0) chosen_ = move;
  }

  void consider_shift(int xpu, std::size_t from, std::size_t to) {
    if (from < to ? !graph_.may_follow(xpu, from, to) : !graph_.may_precede(xpu, from, to)) return;
    consider({graph_.on(xpu)[from], xpu, to, graph_.after_shift(xpu, from, to)},
             forbidden(xpu, from, to));
  }

  void consider_block(int xpu, std::size_t first, std::size_t last, bool starts, bool ends) {
    // Within the path's first block nothing is gained at its beginning, nor at the end of the last.
    if (!ends)
      for (std::size_t k = first; k < last; ++k) consider_shift(xpu, k, last);
    if (!starts)
      for (std::size_t k = first + 1; k <= last; ++k)
        if (k > first + 1 || ends) consider_shift(xpu, k, first);
    if (!starts)
      for (std::size_t k = first + 1; k < last; ++k) consider_shift(xpu, first, k);
    if (!ends)
      for (std::size_t k = first + 1; k < last; ++k)
        if (k > first + 1 || starts) consider_shift(xpu, last, k);
  }

  void consider_elsewhere(int i) {
    for (const int x : options_[at(i)]) {
      if (x == graph_.xpu()[at(i)]) continue;
      const auto places = graph_.places(i, x);
      const bool tabu = xpu_until_[at(i) * at(problem_.num_xpus) + at(x)] > now_;
      for (std::size_t k = places.first; k <= places.last; ++k)
        consider({i, x, k, graph_.after_insertion(i, x, k)}, tabu);
    }
  }

  /// One move, one evaluation: estimates are cheap beside it. False: there is none, or it went wrong.
  bool step() {
    ++evaluations_;
    find_path();
    chosen_ = any_ = {};
    tabu_moves_ = ties_ = 0;
    for (std::size_t begin = 0; begin < path_.size();) {
      const int x = graph_.xpu()[at(path_[begin])];
      std::size_t end = begin + 1;
      while (end < path_.size() && graph_.xpu()[at(path_[end])] == x &&
             graph_.place(path_[end]) == graph_.place(path_[end - 1]) + 1)
        ++end;
      if (end - begin > 1)
        consider_block(x, graph_.place(path_[begin]), graph_.place(path_[end - 1]), begin == 0,
                       end == path_.size());
      begin = end;
    }
    for (const int i : path_)
      if (options_[at(i)].size() > 1) consider_elsewhere(i);
    const Move& move = chosen_.xnode >= 0 ? chosen_ : any_;
    if (move.xnode < 0) return false;
    forbid_return(move);
    graph_.move(move.xnode, move.xpu, move.place);
    ++now_;
    ++idle_;
    if (!graph_.update()) return false;
    if (graph_.makespan() < local_.makespan) {
      local_ = current();
      idle_ = 0;
    }
    return true;
  }

  void forbid_return(const Move& move) {
    const int x = graph_.xpu()[at(move.xnode)];
    const std::int64_t least = kTenure + static_cast<std::int64_t>(n_) / problem_.num_xpus;
    const std::int64_t until =
        now_ + least +
        static_cast<std::int64_t>(random_.below(static_cast<std::uint64_t>(least / 2 + 1)));
    if (x != move.xpu) {
      xpu_until_[at(move.xnode) * at(problem_.num_xpus) + at(x)] = until;
      return;
    }
    const auto& list = graph_.on(x);
    const std::size_t from = graph_.place(move.xnode);
    for (std::size_t k = from + 1; k <= move.place; ++k)
      order_until_[at(move.xnode) * n_ + at(list[k])] = until;
    for (std::size_t k = move.place; k < from; ++k)
      order_until_[at(list[k]) * n_ + at(move.xnode)] = until;
  }

  /// Keeps what was found, and begins again between two of the pool.
  void begin_anew() {
    const bool known = std::any_of(pool_.begin(), pool_.end(), [&](const Solution& other) {
      return other.makespan == local_.makespan && other.xpu == local_.xpu &&
             other.sequence == local_.sequence;
    });
    if (!known) {
      pool_.push_back(local_);
      std::stable_sort(pool_.begin(), pool_.end(), [](const Solution& a, const Solution& b) {
        return a.makespan < b.makespan;
      });
    }
    if (pool_.size() > kPool) pool_.pop_back();
    if (pool_.size() < kPool) {
      shake(pool_.front());
    } else {
      const std::size_t a = random_.below(kPool);
      const std::size_t b = (a + 1 + random_.below(kPool - 1)) % kPool;
      relink(pool_[a], pool_[b]);
    }
    begin_at(current());
  }

  /// Between two schedules: a weighted mean of two linear extensions of the edges is one, too.
  void relink(const Solution& a, const Solution& b) {
    const double part = kNearest + kFurther * random_.unit();
    std::vector<double> key(n_, 0);
    for (std::size_t k = 0; k < n_; ++k) {
      key[at(a.sequence[k])] += (1 - part) * static_cast<double>(k);
      key[at(b.sequence[k])] += part * static_cast<double>(k);
    }
    std::vector<int> xpu = a.xpu;
    for (std::size_t i = 0; i < n_; ++i)
      if (random_.unit() < part) xpu[i] = b.xpu[i];
    load(xpu, key);
  }

  /// Away from a schedule: places by chance near theirs, some XPUs by chance.
  void shake(const Solution& from) {
    std::vector<double> key(n_, 0);
    const double width = kShaken * static_cast<double>(n_) * random_.unit();
    for (std::size_t k = 0; k < n_; ++k)
      key[at(from.sequence[k])] = static_cast<double>(k) + width * random_.unit();
    std::vector<int> xpu = from.xpu;
    for (std::size_t i = 0; i < n_; ++i)
      if (random_.below(kOneInElsewhere) == 0)
        xpu[i] = options_[i][random_.below(options_[i].size())];
    load(xpu, key);
  }

  void load(const std::vector<int>& xpu, const std::vector<double>& key) {
    std::vector<int> sequence(n_);
    std::iota(sequence.begin(), sequence.end(), 0);
    std::stable_sort(sequence.begin(), sequence.end(),
                     [&](int a, int b) { return key[at(a)] < key[at(b)]; });
    graph_.reset(xpu, sequence);
  }

  const Problem& problem_;
  const std::size_t n_;
  DisjunctiveGraph graph_;
  Random random_;
  std::vector<std::vector<int>> options_;
  std::vector<std::int64_t> order_until_;  ///< [a * n + b]: a must not come before b until then
  std::vector<std::int64_t> xpu_until_;    ///< [xnode * num_xpus + xpu]
  std::vector<int> path_;
  Move chosen_, any_;
  std::uint64_t ties_ = 0, tabu_moves_ = 0;
  std::int64_t now_ = 0, idle_ = 0, evaluations_ = 0;
  Solution best_, local_;  ///< of all, and since the last beginning
  std::vector<Solution> pool_;
};

TabuSearch::TabuSearch(const Problem& problem, std::uint64_t seed)
    : walk_(std::make_unique<Walk>(problem, seed)) {}
TabuSearch::~TabuSearch() = default;

Solution TabuSearch::run(const Solution& start, const StopWhen& stop_when,
                         const SearchCallbacks& callbacks) {
  return walk_->run(start, stop_when, callbacks);
}

}  // namespace xauto::solver
