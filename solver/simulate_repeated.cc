// SPDX-License-Identifier: Apache-2.0
// The rule of problem.h for many runs of one Problem: the worst-case attack and the searches live
// here.
#include <algorithm>
#include <bit>
#include <limits>
#include <numeric>

#include "base/index.h"
#include "solver/simulate.h"

namespace xauto::solver {
namespace {

constexpr Time kIdle = std::numeric_limits<Time>::max();

}  // namespace

Simulator::Simulator(const Problem& problem) : problem_(problem) {
  const std::size_t n = at(problem.num_xnodes), m = at(problem.num_xpus);
  for (std::vector<int>* v : {&slot_of_, &xnode_of_, &xpu_of_, &waits_for_, &waits_left_})
    v->resize(n);
  for (std::vector<Time>* v : {&work_, &left_, &finish_}) v->resize(n);
  succ_begin_.resize(n + 1);
  first_slot_.resize(m + 1);
  first_word_.resize(m + 1);
  started_.resize(n);
  open_.resize(m);
  running_.resize(m);
  end_.resize(m);
  touched_.assign(m, 0);
  touched_list_.reserve(m);
  sort_.reserve(n);
}

void Simulator::set(const Decision& decision) {
  const int n = problem_.num_xnodes;
  std::fill(first_slot_.begin(), first_slot_.end(), 0);
  for (const int xpu : decision.xpu) ++first_slot_[at(xpu) + 1];
  std::partial_sum(first_slot_.begin(), first_slot_.end(), first_slot_.begin());
  sort_.clear();
  for (int i = 0; i < n; ++i) sort_.emplace_back(-decision.priority[at(i)], i);
  std::sort(sort_.begin(), sort_.end());
  std::vector<int>& next = touched_list_;  // borrowed: empty between runs
  next.assign(first_slot_.begin(), first_slot_.end() - 1);
  for (const auto& [urgency, i] : sort_) {
    const int slot = next[at(decision.xpu[at(i)])]++;
    slot_of_[at(i)] = slot;
    xnode_of_[at(slot)] = i;
    xpu_of_[at(slot)] = decision.xpu[at(i)];
    work_[at(slot)] = problem_.wcet_on(i, decision.xpu[at(i)]);
  }
  next.clear();
  first_word_[0] = 0;
  for (std::size_t m = 0; m + 1 < first_word_.size(); ++m)
    first_word_[m + 1] = first_word_[m] + (first_slot_[m + 1] - first_slot_[m] + 63) / 64;
  ready_.assign(at(first_word_.back()), 0);

  std::fill(waits_for_.begin(), waits_for_.end(), 0);
  std::fill(succ_begin_.begin(), succ_begin_.end(), 0);
  const auto each_pair = [&](const auto& visit) {
    for (int i = 0; i < n; ++i)
      for (const int s : problem_.succ[at(i)]) visit(slot_of_[at(i)], slot_of_[at(s)]);
    for (const auto& [u, v] : decision.order) visit(slot_of_[at(u)], slot_of_[at(v)]);
  };
  each_pair([&](int u, int) { ++succ_begin_[at(u) + 1]; });
  std::partial_sum(succ_begin_.begin(), succ_begin_.end(), succ_begin_.begin());
  succ_.resize(at(succ_begin_.back()));
  std::copy(succ_begin_.begin(), succ_begin_.end() - 1, waits_left_.begin());  // as a cursor
  each_pair([&](int u, int v) {
    succ_[at(waits_left_[at(u)]++)] = v;
    ++waits_for_[at(v)];
  });
}

void Simulator::make_ready(int slot) {
  const int m = xpu_of_[at(slot)], k = slot - first_slot_[at(m)];
  ready_[at(first_word_[at(m)] + k / 64)] |= std::uint64_t{1} << (k % 64);
  if (!touched_[at(m)]) {
    touched_[at(m)] = 1;
    touched_list_.push_back(m);
  }
}

Time Simulator::run(std::span<const Time> actual) {
  waits_left_ = waits_for_;
  if (actual.empty()) {
    left_ = work_;
  } else {
    for (std::size_t s = 0; s < left_.size(); ++s) left_[s] = actual[at(xnode_of_[s])];
  }
  std::fill(running_.begin(), running_.end(), -1);
  std::fill(end_.begin(), end_.end(), kIdle);
  std::fill(open_.begin(), open_.end(), 0);
  std::fill(started_.begin(), started_.end(), 0);
  for (int s = 0; s < problem_.num_xnodes; ++s)
    if (waits_for_[at(s)] == 0) make_ready(s);

  for (Time now = 0;;) {
    for (const int m : touched_list_) {
      touched_[at(m)] = 0;
      const int running = running_[at(m)];
      if (running >= 0 && !problem_.preemptive[at(m)]) continue;
      int word = first_word_[at(m)];
      const int last = first_word_[at(m) + 1];
      while (word < last && ready_[at(word)] == 0) ++word;
      if (word == last) continue;
      const int slot = first_slot_[at(m)] + (word - first_word_[at(m)]) * 64 +
                       std::countr_zero(ready_[at(word)]);
      if (running >= 0) {
        if (slot > running) continue;
        if (problem_.levels[at(m)] > 0 && open_[at(m)] >= problem_.levels[at(m)]) continue;
        left_[at(running)] = end_[at(m)] - now;
        const int k = running - first_slot_[at(m)];
        ready_[at(first_word_[at(m)] + k / 64)] |= std::uint64_t{1} << (k % 64);
      }
      if (running >= 0 || (problem_.levels[at(m)] > 0 && open_[at(m)] > 0 && !started_[at(slot)]))
        left_[at(slot)] += problem_.preempt[at(m)];
      ready_[at(word)] &= ready_[at(word)] - 1;
      open_[at(m)] += started_[at(slot)] == 0;
      started_[at(slot)] = 1;
      running_[at(m)] = slot;
      end_[at(m)] = now + left_[at(slot)];
    }
    touched_list_.clear();

    Time next = kIdle;
    for (const Time end : end_) next = std::min(next, end);
    if (next == kIdle) return now;
    now = next;
    for (std::size_t m = 0; m < end_.size(); ++m) {
      if (end_[m] != now) continue;
      const int slot = running_[m];
      running_[m] = -1;
      end_[m] = kIdle;
      finish_[at(slot)] = now;
      --open_[m];
      if (!touched_[m]) {
        touched_[m] = 1;
        touched_list_.push_back(static_cast<int>(m));
      }
      for (int k = succ_begin_[at(slot)]; k < succ_begin_[at(slot) + 1]; ++k)
        if (--waits_left_[at(succ_[at(k)])] == 0) make_ready(succ_[at(k)]);
    }
  }
}

}  // namespace xauto::solver
