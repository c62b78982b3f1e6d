// SPDX-License-Identifier: Apache-2.0
// See stretches.h.
#include "solver/stretches.h"

#include <algorithm>
#include <iterator>
#include <numeric>

#include "base/index.h"
#include "solver/random.h"

namespace xauto::solver {
namespace {

// Tried on five apps of 100 to 1000 XNodes, 6 s, one thread: 20 to 60, 60 to 240 and 100 to 300
// XNodes, and 60 to 1000 evaluations each, all ended higher on most of them.
constexpr std::size_t kShortest = 30, kLongest = 120;  ///< XNodes of a stretch
constexpr std::int64_t kEvaluationsPerXNode = 200, kEvaluationsAtLeast = 2000;

template <class T>
void append_rows(std::vector<T>& to, const std::vector<T>& table, std::size_t row,
                 std::size_t width) {
  const auto begin = std::next(table.begin(), static_cast<std::ptrdiff_t>(row * width));
  to.insert(to.end(), begin, std::next(begin, static_cast<std::ptrdiff_t>(width)));
}

}  // namespace

void follow(DisjunctiveGraph& graph, Solution& schedule) {
  graph.reset(schedule.xpu, schedule.sequence);
  schedule.makespan = graph.makespan();
  std::stable_sort(schedule.sequence.begin(), schedule.sequence.end(),
                   [&](int a, int b) { return graph.head(a) < graph.head(b); });
}

Stretch stretch_of(const Problem& problem, const DisjunctiveGraph& graph, const Solution& schedule,
                   std::size_t first, std::size_t length) {
  const std::size_t n = at(problem.num_xnodes), m = at(problem.num_xpus),
                    types = at(problem.num_types), end = first + length;
  const std::vector<int>& sequence = schedule.sequence;
  Stretch stretch;
  stretch.members.assign(std::next(sequence.begin(), static_cast<std::ptrdiff_t>(first)),
                         std::next(sequence.begin(), static_cast<std::ptrdiff_t>(end)));
  const std::vector<int>& members = stretch.members;
  Problem& part = stretch.part;
  part.num_xnodes = static_cast<int>(length);
  part.num_xpus = problem.num_xpus;
  part.num_types = problem.num_types;
  part.xpu_type = problem.xpu_type;
  part.type_xpus = problem.type_xpus;
  part.pred.resize(length);
  part.succ.resize(length);
  part.topo.resize(length);
  std::iota(part.topo.begin(), part.topo.end(), 0);
  stretch.now.xpu.resize(length);
  stretch.now.sequence = part.topo;

  // Temperatures are shares of a makespan. So time counts from the first start of the stretch, and
  // up to where its least tail begins.
  const Time from = graph.head(members.front());
  Time least_tail = graph.tail(members.front());
  for (int i : members) least_tail = std::min(least_tail, graph.tail(i));
  stretch.outside = from + least_tail;
  Surroundings& around = stretch.around;
  around.released.assign(length, -from);
  around.behind.assign(length, -least_tail);
  around.free_at.assign(m, -from);
  around.after.assign(m, -least_tail);
  std::vector<int> place(n, -1);
  for (std::size_t k = 0; k < length; ++k) place[at(members[k])] = static_cast<int>(k);
  for (std::size_t k = 0; k < length; ++k) {
    const std::size_t i = at(members[k]);
    stretch.now.xpu[k] = schedule.xpu[i];
    append_rows(part.wcet_flat, problem.wcet_flat, i, types);
    if (!problem.forbidden.empty()) append_rows(part.forbidden, problem.forbidden, i, m);
    for (int p : problem.pred[i]) {
      if (place[at(p)] >= 0)
        part.pred[k].push_back(place[at(p)]);
      else
        around.released[k] = std::max(around.released[k], graph.done(p) - from);
    }
    for (int s : problem.succ[i]) {
      if (place[at(s)] >= 0)
        part.succ[k].push_back(place[at(s)]);
      else
        around.behind[k] = std::max(around.behind[k], graph.left(s) - least_tail);
    }
  }
  for (std::size_t k = 0; k < first; ++k)
    around.free_at[at(schedule.xpu[at(sequence[k])])] = graph.done(sequence[k]) - from;
  for (std::size_t k = n; k-- > end;)
    around.after[at(schedule.xpu[at(sequence[k])])] = graph.left(sequence[k]) - least_tail;
  return stretch;
}

bool stretches_serve(const Problem& problem) {
  return problem.goal.plain() && problem.groups.empty();
}

Solution anneal_stretches(const Problem& problem, const Solution& start, std::uint64_t seed,
                          const StopWhen& stop_when, const SearchCallbacks& callbacks) {
  const std::size_t n = at(problem.num_xnodes);
  Random random(seed);
  Solution best = start;
  DisjunctiveGraph graph(problem);
  follow(graph, best);
  if (callbacks.on_better) callbacks.on_better(best);
  std::int64_t evaluations = 0;
  SearchCallbacks counting;
  counting.on_evaluations = [&](std::int64_t count) {
    evaluations += count;
    if (callbacks.on_evaluations) callbacks.on_evaluations(count);
  };
  const auto over = [&] {
    return stop_when.stopped() ||
           (stop_when.max_evaluations > 0 && evaluations >= stop_when.max_evaluations) ||
           (stop_when.target != nullptr &&
            best.makespan <= stop_when.target->load(std::memory_order_relaxed));
  };
  while (!over()) {
    const std::size_t length = std::min(n, kShortest + random.below(kLongest - kShortest));
    // Half a stretch may lie beside the schedule: its ends are met as often as its middle.
    const std::size_t drawn = random.below(n + length);
    const std::size_t first = std::min(drawn - std::min(drawn, length / 2), n - length);
    const Stretch stretch = stretch_of(problem, graph, best, first, length);
    StopWhen mine = stop_when;
    mine.target = nullptr;
    mine.effort = 0;
    const auto most =
        kEvaluationsPerXNode * static_cast<std::int64_t>(length) + kEvaluationsAtLeast;
    mine.max_evaluations = stop_when.max_evaluations > 0
                               ? std::min(most, stop_when.max_evaluations - evaluations)
                               : most;
    const Solution found =
        anneal_ordered(stretch.part, stretch.now, random.next(), mine, counting, &stretch.around);
    for (std::size_t k = 0; k < length; ++k) {
      best.xpu[at(stretch.members[k])] = found.xpu[k];
      best.sequence[first + k] = stretch.members[at(found.sequence[k])];
    }
    const Time was = best.makespan;
    follow(graph, best);
    if (best.makespan < was && callbacks.on_better) callbacks.on_better(best);
  }
  return best;
}

}  // namespace xauto::solver
