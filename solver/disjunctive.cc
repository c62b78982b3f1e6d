// SPDX-License-Identifier: Apache-2.0
// See disjunctive.h.
#include "solver/disjunctive.h"

#include <algorithm>
#include <functional>
#include <queue>

#include "base/index.h"

namespace xauto::solver {

DisjunctiveGraph::DisjunctiveGraph(const Problem& problem)
    : problem_(problem), n_(at(problem.num_xnodes)) {
  succ_begin_.assign(n_ + 1, 0);
  pred_begin_.assign(n_ + 1, 0);
  for (std::size_t i = 0; i < n_; ++i) {
    succ_.insert(succ_.end(), problem.succ[i].begin(), problem.succ[i].end());
    pred_.insert(pred_.end(), problem.pred[i].begin(), problem.pred[i].end());
    succ_begin_[i + 1] = static_cast<int>(succ_.size());
    pred_begin_[i + 1] = static_cast<int>(pred_.size());
  }
  on_.resize(at(problem.num_xpus));
  for (auto* times : {&work_, &head_, &tail_, &ready_, &behind_}) times->assign(n_, 0);
  place_.assign(n_, 0);
  missing_.assign(n_, 0);
}

void DisjunctiveGraph::reset(const std::vector<int>& xpu, const std::vector<int>& sequence) {
  xpu_ = xpu;
  std::vector<int> wish(n_, 0);
  for (std::size_t k = 0; k < n_; ++k) wish[at(sequence[k])] = static_cast<int>(k);
  using Waiting = std::pair<int, int>;
  std::priority_queue<Waiting, std::vector<Waiting>, std::greater<>> open;
  for (std::size_t i = 0; i < n_; ++i) {
    missing_[i] = pred_begin_[i + 1] - pred_begin_[i];
    if (missing_[i] == 0) open.emplace(wish[i], static_cast<int>(i));
    work_[i] = problem_.wcet_on(static_cast<int>(i), xpu_[i]);
  }
  for (auto& list : on_) list.clear();
  while (!open.empty()) {
    const int i = open.top().second;
    open.pop();
    auto& list = on_[at(xpu_[at(i)])];
    place_[at(i)] = list.size();
    list.push_back(i);
    for (int s : problem_.succ[at(i)])
      if (--missing_[at(s)] == 0) open.emplace(wish[at(s)], s);
  }
  (void)update();  // one order of all XNodes: no cycle
}

void DisjunctiveGraph::move(int xnode, int xpu, std::size_t place) {
  auto& from = on_[at(xpu_[at(xnode)])];
  from.erase(from.begin() + static_cast<std::ptrdiff_t>(place_[at(xnode)]));
  for (std::size_t k = place_[at(xnode)]; k < from.size(); ++k) place_[at(from[k])] = k;
  auto& to = on_[at(xpu)];
  to.insert(to.begin() + static_cast<std::ptrdiff_t>(place), xnode);
  for (std::size_t k = place; k < to.size(); ++k) place_[at(to[k])] = k;
  xpu_[at(xnode)] = xpu;
  work_[at(xnode)] = problem_.wcet_on(xnode, xpu);
}

bool DisjunctiveGraph::update() {
  // Heads, in the order in which XNodes have no unfinished predecessor left.
  sequence_.clear();
  for (std::size_t i = 0; i < n_; ++i) {
    ready_[i] = 0;
    missing_[i] = pred_begin_[i + 1] - pred_begin_[i] + (place_[i] > 0 ? 1 : 0);
    if (missing_[i] == 0) sequence_.push_back(static_cast<int>(i));
  }
  makespan_ = 0;
  for (std::size_t k = 0; k < sequence_.size(); ++k) {
    const std::size_t i = at(sequence_[k]);
    const auto& list = on_[at(xpu_[i])];
    head_[i] = ready_[i];
    if (place_[i] > 0) head_[i] = std::max(head_[i], done(list[place_[i] - 1]));
    const Time end = head_[i] + work_[i];
    makespan_ = std::max(makespan_, end);
    for (int e = succ_begin_[i]; e < succ_begin_[i + 1]; ++e) {
      const std::size_t s = at(succ_[at(e)]);
      ready_[s] = std::max(ready_[s], end);
      if (--missing_[s] == 0) sequence_.push_back(static_cast<int>(s));
    }
    if (place_[i] + 1 < list.size()) {
      const int next = list[place_[i] + 1];
      if (--missing_[at(next)] == 0) sequence_.push_back(next);
    }
  }
  if (sequence_.size() < n_) return false;
  for (std::size_t k = n_; k-- > 0;) {
    const std::size_t i = at(sequence_[k]);
    const auto& list = on_[at(xpu_[i])];
    Time longest = 0;
    for (int e = succ_begin_[i]; e < succ_begin_[i + 1]; ++e)
      longest = std::max(longest, left(succ_[at(e)]));
    behind_[i] = longest;
    if (place_[i] + 1 < list.size()) longest = std::max(longest, left(list[place_[i] + 1]));
    tail_[i] = longest;
  }
  return true;
}

int DisjunctiveGraph::critical_successor(int xnode) const {
  for (int e = succ_begin_[at(xnode)]; e < succ_begin_[at(xnode) + 1]; ++e) {
    const int s = succ_[at(e)];
    if (head(s) == done(xnode) && critical(s)) return s;
  }
  return -1;
}

bool DisjunctiveGraph::may_follow(int xpu, std::size_t from, std::size_t to) const {
  // A path from a successor of the one to the other has a tail that is at least as long.
  const int first = on(xpu)[from], last = on(xpu)[to];
  for (int e = succ_begin_[at(first)]; e < succ_begin_[at(first) + 1]; ++e) {
    const int s = succ_[at(e)];
    if (s == last || tail(s) >= left(last)) return false;
  }
  return true;
}

bool DisjunctiveGraph::may_precede(int xpu, std::size_t from, std::size_t to) const {
  const int last = on(xpu)[from], first = on(xpu)[to];
  for (int e = pred_begin_[at(last)]; e < pred_begin_[at(last) + 1]; ++e) {
    const int p = pred_[at(e)];
    if (p == first || head(p) >= done(first)) return false;
  }
  return true;
}

DisjunctiveGraph::Places DisjunctiveGraph::places(int xnode, int xpu) const {
  Time latest_head = -1, longest_tail = -1;
  for (int e = pred_begin_[at(xnode)]; e < pred_begin_[at(xnode) + 1]; ++e)
    latest_head = std::max(latest_head, head(pred_[at(e)]));
  for (int e = succ_begin_[at(xnode)]; e < succ_begin_[at(xnode) + 1]; ++e)
    longest_tail = std::max(longest_tail, tail(succ_[at(e)]));
  // Those that may lead to a predecessor of `xnode` are done by its head, and so is whoever comes
  // before them; those that a successor may lead to likewise.
  const auto& list = on(xpu);
  const auto place_where = [&](const auto& early) {
    return static_cast<std::size_t>(std::partition_point(list.begin(), list.end(), early) -
                                    list.begin());
  };
  Places places{place_where([&](int other) { return done(other) <= latest_head; }),
                place_where([&](int other) { return left(other) > longest_tail; })};
  for (int e = pred_begin_[at(xnode)]; e < pred_begin_[at(xnode) + 1]; ++e) {
    const int p = pred_[at(e)];
    if (xpu_[at(p)] == xpu) places.first = std::max(places.first, place(p) + 1);
  }
  for (int e = succ_begin_[at(xnode)]; e < succ_begin_[at(xnode) + 1]; ++e) {
    const int s = succ_[at(e)];
    if (xpu_[at(s)] == xpu) places.last = std::min(places.last, place(s));
  }
  if (places.first > places.last) return places;
  // The best place is after those that are done by then, before those that leave no more to do than
  // `xnode` itself, or between the two.
  const std::size_t after = place_where([&](int other) { return done(other) <= ready(xnode); });
  const std::size_t before = place_where([&](int other) { return left(other) > behind(xnode); });
  const std::size_t low = std::min(after, before);
  places.first = std::clamp(low, places.first, places.last);
  places.last = std::clamp(after < before ? before : low, places.first, places.last);
  return places;
}

Time DisjunctiveGraph::after_shift(int xpu, std::size_t from, std::size_t to) {
  const auto& list = on(xpu);
  segment_.clear();
  if (from < to) {
    for (std::size_t k = from + 1; k <= to; ++k) segment_.push_back(list[k]);
    segment_.push_back(list[from]);
  } else {
    segment_.push_back(list[from]);
    for (std::size_t k = to; k < from; ++k) segment_.push_back(list[k]);
  }
  const std::size_t low = std::min(from, to), high = std::max(from, to);
  Time end = low > 0 ? done(list[low - 1]) : 0;
  segment_head_.clear();
  for (const int i : segment_) {
    const Time begin = std::max(end, ready(i));
    segment_head_.push_back(begin);
    end = begin + work(i);
  }
  Time rest = high + 1 < list.size() ? left(list[high + 1]) : 0;
  Time longest = 0;
  for (std::size_t k = segment_.size(); k-- > 0;) {
    const int i = segment_[k];
    rest = std::max(rest, behind(i)) + work(i);
    longest = std::max(longest, segment_head_[k] + rest);
  }
  return longest;
}

Time DisjunctiveGraph::after_insertion(int xnode, int xpu, std::size_t place) const {
  const auto& list = on(xpu);
  const Time begin = std::max(ready(xnode), place > 0 ? done(list[place - 1]) : 0);
  const Time rest = std::max(behind(xnode), place < list.size() ? left(list[place]) : 0);
  return begin + problem_.wcet_on(xnode, xpu) + rest;
}

}  // namespace xauto::solver
