// SPDX-License-Identifier: Apache-2.0
// See ordered.h.
#include "solver/ordered.h"

#include <algorithm>
#include <functional>
#include <queue>

#include "base/index.h"
#include "solver/bounds.h"
#include "solver/evaluate.h"

namespace xauto::solver {

OrderedEvaluator::OrderedEvaluator(const Problem& problem, const Surroundings* around)
    : problem_(problem), n_(at(problem.num_xnodes)), m_(at(problem.num_xpus)) {
  position_.assign(n_, 0);
  start_.assign(n_, 0);
  finish_.assign(n_, 0);
  try_finish_.assign(n_, 0);
  free_at_.assign(m_, 0);
  if (around != nullptr)
    around_ = *around;
  else
    around_ = {std::vector<Time>(m_, 0), std::vector<Time>(n_, 0), std::vector<Time>(n_, 0),
               std::vector<Time>(m_, 0)};
  // Of least WCETs: valid whatever the candidate's assignment.
  const std::vector<Time> least = least_wcet(problem);
  tail_ = around_.behind;
  for (std::size_t k = n_; k-- > 0;) {
    const std::size_t i = at(problem.topo[k]);
    for (int s : problem.succ[i]) tail_[i] = std::max(tail_[i], least[at(s)] + tail_[at(s)]);
  }
}

void OrderedEvaluator::reset(const std::vector<int>& xpu, const std::vector<int>& sequence) {
  edited_ = false;
  xpu_ = xpu;
  std::vector<int> wish(n_, 0), missing(n_, 0);
  for (std::size_t k = 0; k < n_; ++k) wish[at(sequence[k])] = static_cast<int>(k);
  std::priority_queue<std::pair<int, int>, std::vector<std::pair<int, int>>, std::greater<>> open;
  for (std::size_t i = 0; i < n_; ++i) {
    missing[i] = static_cast<int>(problem_.pred[i].size());
    if (missing[i] == 0) open.emplace(wish[i], static_cast<int>(i));
  }
  sequence_.clear();
  while (!open.empty()) {
    const int i = open.top().second;
    open.pop();
    position_[at(i)] = static_cast<int>(sequence_.size());
    sequence_.push_back(i);
    for (int s : problem_.succ[at(i)])
      if (--missing[at(s)] == 0) open.emplace(wish[at(s)], s);
  }
  begin_edit();
  first_ = 0;
  commit();
}

void OrderedEvaluator::begin_edit() {
  if (edited_) return;
  edited_ = true;
  old_sequence_ = sequence_;
  old_xpu_ = xpu_;
  first_ = static_cast<int>(n_);
}

void OrderedEvaluator::assign(int xnode, int xpu) {
  begin_edit();
  xpu_[at(xnode)] = xpu;
  first_ = std::min(first_, position_[at(xnode)]);
}

void OrderedEvaluator::reposition(int xnode, int position) {
  begin_edit();
  const int from = position_[at(xnode)];
  int to = position;
  if (to < from) {
    for (int p : problem_.pred[at(xnode)]) to = std::max(to, position_[at(p)] + 1);
    for (int k = from; k > to; --k) {
      sequence_[at(k)] = sequence_[at(k - 1)];
      position_[at(sequence_[at(k)])] = k;
    }
  } else {
    for (int s : problem_.succ[at(xnode)]) to = std::min(to, position_[at(s)] - 1);
    for (int k = from; k < to; ++k) {
      sequence_[at(k)] = sequence_[at(k + 1)];
      position_[at(sequence_[at(k)])] = k;
    }
  }
  sequence_[at(to)] = xnode;
  position_[at(xnode)] = to;
  first_ = std::min(first_, std::min(from, to));
}

Time OrderedEvaluator::evaluate(Time limit) {
  ++evaluations_;
  const auto first = at(first_);
  const bool plain = problem_.goal.plain();
  Time makespan = -kNever, charged = 0;
  free_at_ = around_.free_at;
  for (std::size_t k = 0; k < first; ++k) {
    const std::size_t i = at(sequence_[k]);
    free_at_[at(xpu_[i])] = try_finish_[i] = finish_[i];
    makespan = std::max(makespan, finish_[i] + around_.behind[i]);
    if (!plain) charged += problem_.goal.charge(i, finish_[i]);
  }
  for (std::size_t k = first; k < n_; ++k) {
    const int xnode = sequence_[k];
    const std::size_t i = at(xnode);
    Time begin = std::max(free_at_[at(xpu_[i])], around_.released[i]);
    for (int p : problem_.pred[i]) begin = std::max(begin, try_finish_[at(p)]);
    const Time end = begin + problem_.wcet_on(xnode, xpu_[i]);
    if (end + tail_[i] >= limit) return kNever;
    try_finish_[i] = free_at_[at(xpu_[i])] = end;
    makespan = std::max(makespan, end + around_.behind[i]);
    if (!plain) charged += problem_.goal.charge(i, end);
  }
  for (std::size_t x = 0; x < m_; ++x)
    makespan = std::max(makespan, free_at_[x] + around_.after[x]);
  const Time cost = makespan + charged;
  return cost < limit ? cost : kNever;
}

void OrderedEvaluator::commit() {
  edited_ = false;
  free_at_ = around_.free_at;
  makespan_ = -kNever;
  for (int xnode : sequence_) {
    const std::size_t i = at(xnode);
    Time begin = std::max(free_at_[at(xpu_[i])], around_.released[i]);
    for (int p : problem_.pred[i]) begin = std::max(begin, finish_[at(p)]);
    start_[i] = begin;
    finish_[i] = free_at_[at(xpu_[i])] = begin + problem_.wcet_on(xnode, xpu_[i]);
    makespan_ = std::max(makespan_, finish_[i] + around_.behind[i]);
  }
  for (std::size_t x = 0; x < m_; ++x)
    makespan_ = std::max(makespan_, free_at_[x] + around_.after[x]);
  const Goal& goal = problem_.goal;
  if (goal.plain()) return;
  for (std::size_t i = 0; i < n_; ++i) makespan_ += goal.charge(i, finish_[i]);
}

void OrderedEvaluator::rollback() {
  if (!edited_) return;
  edited_ = false;
  xpu_ = old_xpu_;
  sequence_ = old_sequence_;
  for (std::size_t k = at(std::min(first_, static_cast<int>(n_))); k < n_; ++k)
    position_[at(sequence_[k])] = static_cast<int>(k);
}

void OrderedEvaluator::critical_chain(std::vector<int>& chain) const {
  chain.clear();
  std::vector<int> before(n_, -1), last(m_, -1);  // on the same XPU
  for (const int i : sequence_) before[at(i)] = std::exchange(last[at(xpu_[at(i)])], i);
  int current = -1;
  Time latest = 0;
  const auto ends = [&](int i, Time behind) {
    const Time end = finish_[at(i)] + behind;
    if (current >= 0 && end <= latest) return;
    current = i;
    latest = end;
  };
  for (std::size_t i = 0; i < n_; ++i) ends(static_cast<int>(i), around_.behind[i]);
  for (std::size_t x = 0; x < m_; ++x)
    if (last[x] >= 0) ends(last[x], around_.after[x]);
  while (current >= 0) {
    chain.push_back(current);
    const std::size_t i = at(current);
    int next = -1;
    if (before[i] >= 0 && finish_[at(before[i])] == start_[i]) next = before[i];
    for (int p : problem_.pred[i])
      if (finish_[at(p)] == start_[i]) next = p;
    current = next;
  }
}

}  // namespace xauto::solver
