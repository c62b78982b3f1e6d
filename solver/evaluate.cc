// SPDX-License-Identifier: Apache-2.0
// See evaluate.h.
#include "solver/evaluate.h"

#include <algorithm>
#include <bit>

#include "base/index.h"

namespace xauto::solver {
Evaluator::Evaluator(const Problem& problem)
    : problem_(problem), n_(at(problem.num_xnodes)), m_(at(problem.num_xpus)) {
  succ_begin_.assign(n_ + 1, 0);
  pred_begin_.assign(n_ + 1, 0);
  in_degree_.resize(n_);
  topo_rank_.resize(n_);
  for (std::size_t i = 0; i < n_; ++i) {
    for (int s : problem.succ[i]) succ_list_.push_back(s);
    for (int p : problem.pred[i]) pred_list_.push_back(p);
    succ_begin_[i + 1] = static_cast<int>(succ_list_.size());
    pred_begin_[i + 1] = static_cast<int>(pred_list_.size());
    in_degree_[i] = static_cast<std::uint16_t>(problem.pred[i].size());
    if (problem.pred[i].empty()) sources_.push_back(static_cast<int>(i));
  }
  for (std::size_t k = 0; k < problem.topo.size(); ++k)
    topo_rank_[at(problem.topo[k])] = static_cast<int>(k);
  xpu_.assign(n_, -1);
  sequence_.assign(n_, -1);
  position_.assign(n_, -1);
  work_.assign(n_, 0);
  tail_.assign(n_, 0);
  load_.assign(m_, 0);
  status_.assign(n_, kWaiting);
  missing_.assign(n_, 0);
  remaining_.assign(n_, 0);
  end_.assign(m_, kNever);
  running_.assign(m_, -1);
  words_ = (n_ + 63) / 64;
  ready_.assign(m_ * words_, 0);
  ready_count_.assign(m_, 0);
  touched_.assign(m_, 0);
  waits_for_.assign(n_, -1);
  first_waiting_.assign(n_, -1);
  next_waiting_.assign(n_, -1);
  released_at_.assign(n_, 0);
  ready_at_.assign(n_, 0);
  started_at_.assign(n_, 0);
  finished_at_.assign(n_, 0);
  in_queue_.assign(n_, 0);
  // Few snapshots where they are large: beyond that, copying state costs more than it saves.
  stride_ = std::max<std::size_t>(1, n_ / (n_ > 200 ? 32 : 64));
}

void Evaluator::reset(const std::vector<int>& xpu, const std::vector<int>& sequence,
                      const std::vector<int>& waits_for) {
  edits_.clear();
  for (std::size_t i = 0; i < n_; ++i)
    link(static_cast<int>(i), waits_for.empty() ? -1 : waits_for[i]);
  xpu_ = xpu;
  sequence_ = sequence;
  std::fill(load_.begin(), load_.end(), 0);
  for (std::size_t k = 0; k < n_; ++k) position_[at(sequence_[k])] = static_cast<int>(k);
  for (std::size_t i = 0; i < n_; ++i) {
    work_[i] = problem_.wcet_on(static_cast<int>(i), xpu_[i]);
    load_[at(xpu_[i])] += work_[i];
  }
  for (std::size_t k = n_; k-- > 0;) {
    const std::size_t i = at(problem_.topo[k]);
    Time tail = 0;
    for (int e = succ_begin_[i]; e < succ_begin_[i + 1]; ++e) {
      const std::size_t s = at(succ_list_[at(e)]);
      tail = std::max(tail, work_[s] + tail_[s]);
    }
    tail_[i] = tail;
  }
  dirty_from_ = kNever;
  start_from_scratch();
  snapshots_used_ = 0;
  makespan_ = run<true>(kNever);
}

void Evaluator::update_tails(int xnode) {
  // Ancestors of `xnode`, nearest first in topological order, only where something changes.
  std::vector<int>& queue = touched_list_;  // free outside run()
  queue.clear();
  auto push = [&](std::size_t i) {
    for (int e = pred_begin_[i]; e < pred_begin_[i + 1]; ++e) {
      const int p = pred_list_[at(e)];
      if (in_queue_[at(p)]) continue;
      in_queue_[at(p)] = 1;
      queue.push_back(p);
      std::push_heap(queue.begin(), queue.end(),
                     [&](int a, int b) { return topo_rank_[at(a)] < topo_rank_[at(b)]; });
    }
  };
  push(at(xnode));
  while (!queue.empty()) {
    std::pop_heap(queue.begin(), queue.end(),
                  [&](int a, int b) { return topo_rank_[at(a)] < topo_rank_[at(b)]; });
    const std::size_t i = at(queue.back());
    queue.pop_back();
    in_queue_[i] = 0;
    Time tail = 0;
    for (int e = succ_begin_[i]; e < succ_begin_[i + 1]; ++e) {
      const std::size_t s = at(succ_list_[at(e)]);
      tail = std::max(tail, work_[s] + tail_[s]);
    }
    if (tail == tail_[i]) continue;
    tail_[i] = tail;
    push(i);
  }
}

void Evaluator::assign(int xnode, int xpu) {
  const std::size_t i = at(xnode);
  if (xpu_[i] == xpu) return;
  edits_.push_back({xnode, xpu_[i], position_[i], waits_for_[i]});
  dirty_from_ = std::min(dirty_from_, released_at_[i]);
  for (int w = first_waiting_[i]; w >= 0; w = next_waiting_[at(w)])
    dirty_from_ = std::min(dirty_from_, released_at_[at(w)]);
  load_[at(xpu_[i])] -= work_[i];
  const Time before = work_[i];
  xpu_[i] = xpu;
  work_[i] = problem_.wcet_on(xnode, xpu);
  load_[at(xpu)] += work_[i];
  if (work_[i] != before) update_tails(xnode);
}

void Evaluator::move_position(int xnode, int position) {
  const int from = position_[at(xnode)];
  if (from < position) {
    for (int k = from; k < position; ++k) {
      sequence_[at(k)] = sequence_[at(k + 1)];
      position_[at(sequence_[at(k)])] = k;
    }
  } else {
    for (int k = from; k > position; --k) {
      sequence_[at(k)] = sequence_[at(k - 1)];
      position_[at(sequence_[at(k)])] = k;
    }
  }
  sequence_[at(position)] = xnode;
  position_[at(xnode)] = position;
}

void Evaluator::reposition(int xnode, int position) {
  const std::size_t i = at(xnode);
  if (position_[i] == position) return;
  edits_.push_back({xnode, xpu_[i], position_[i], waits_for_[i]});
  dirty_from_ = std::min(dirty_from_, ready_at_[i]);
  move_position(xnode, position);
}

void Evaluator::link(int xnode, int other) {
  const std::size_t i = at(xnode);
  if (waits_for_[i] == other) return;
  if (waits_for_[i] >= 0) {
    --waiting_;
    int* place = &first_waiting_[at(waits_for_[i])];
    while (*place != xnode) place = &next_waiting_[at(*place)];
    *place = next_waiting_[i];
  }
  waits_for_[i] = other;
  if (other < 0) return;
  ++waiting_;
  next_waiting_[i] = first_waiting_[at(other)];
  first_waiting_[at(other)] = xnode;
}

void Evaluator::wait_for(int xnode, int other) {
  const std::size_t i = at(xnode);
  if (waits_for_[i] == other) return;
  edits_.push_back({xnode, xpu_[i], position_[i], waits_for_[i]});
  dirty_from_ = std::min(dirty_from_, released_at_[i]);
  link(xnode, other);
}

bool Evaluator::hangs() const {
  return waiting_ > 0 && std::any_of(status_.begin(), status_.end(),
                                     [](std::uint8_t status) { return status != kDone; });
}

void Evaluator::rollback() {
  while (!edits_.empty()) {
    const Edit edit = edits_.back();
    edits_.pop_back();
    const std::size_t i = at(edit.xnode);
    if (xpu_[i] != edit.old_xpu) {
      load_[at(xpu_[i])] -= work_[i];
      const Time before = work_[i];
      xpu_[i] = edit.old_xpu;
      work_[i] = problem_.wcet_on(edit.xnode, edit.old_xpu);
      load_[at(edit.old_xpu)] += work_[i];
      if (work_[i] != before) update_tails(edit.xnode);
    }
    if (position_[i] != edit.old_position) move_position(edit.xnode, edit.old_position);
    link(edit.xnode, edit.old_waits_for);
  }
  dirty_from_ = kNever;
}

void Evaluator::push_ready(int xnode) {
  const std::size_t x = at(xpu_[at(xnode)]), place = at(position_[at(xnode)]);
  ready_[x * words_ + place / 64] |= std::uint64_t{1} << (place % 64);
  ++ready_count_[x];
}

void Evaluator::start_from_scratch() {
  std::fill(status_.begin(), status_.end(), static_cast<std::uint8_t>(kWaiting));
  missing_ = in_degree_;
  std::fill(end_.begin(), end_.end(), kNever);
  std::fill(running_.begin(), running_.end(), -1);
  std::fill(ready_count_.begin(), ready_count_.end(), 0);
  std::fill(ready_.begin(), ready_.end(), 0);
  now_ = 0;
  latest_ = charged_ = 0;
  for (std::size_t i = 0; i < n_; ++i) remaining_[i] = -1;
  for (int s : sources_) {
    released_at_[at(s)] = ready_at_[at(s)] = 0;
    if (held(at(s))) continue;
    status_[at(s)] = kReady;
    push_ready(s);
  }
  for (std::size_t x = 0; x < m_; ++x) decide<true>(static_cast<int>(x), 0);
}

Time Evaluator::cost() const {
  return (problem_.goal.weighted ? 0 : latest_) + charged_;
}

void Evaluator::save(Snapshot& snapshot, Time now, Time latest) const {
  snapshot.now = now;
  snapshot.latest = latest;
  snapshot.charged = charged_;
  snapshot.status = status_;
  snapshot.missing = missing_;
  snapshot.remaining = remaining_;
  snapshot.running = running_;
  snapshot.end = end_;
}

void Evaluator::restore(const Snapshot& snapshot) {
  now_ = snapshot.now;
  latest_ = snapshot.latest;
  charged_ = snapshot.charged;
  status_ = snapshot.status;
  missing_ = snapshot.missing;
  remaining_ = snapshot.remaining;
  running_ = snapshot.running;
  end_ = snapshot.end;
  std::fill(ready_count_.begin(), ready_count_.end(), 0);
  std::fill(ready_.begin(), ready_.end(), 0);
  for (std::size_t i = 0; i < n_; ++i)
    if (status_[i] == kReady) push_ready(static_cast<int>(i));
}

int Evaluator::suspended(std::size_t xpu) const {
  int count = 0;
  for (std::size_t k = 0; k < words_; ++k)
    for (std::uint64_t bits = ready_[xpu * words_ + k]; bits != 0; bits &= bits - 1)
      count += remaining_[at(sequence_[k * 64 + at(std::countr_zero(bits))])] >= 0;
  return count;
}

template <bool kRecord>
void Evaluator::decide(int xpu, Time now) {
  const std::size_t x = at(xpu);
  if (ready_count_[x] == 0) return;
  const int running = running_[x];
  if (running >= 0 && !problem_.preemptive[x]) return;
  std::uint64_t* word = ready_.data() + x * words_;
  std::size_t k = 0;
  while (word[k] == 0) ++k;
  const int best = static_cast<int>(k * 64) + std::countr_zero(word[k]);
  Time cost = 0;
  if (running >= 0) {
    const int place = position_[at(running)];
    if (best > place) return;
    if (problem_.levels[x] > 0 && 1 + suspended(x) >= problem_.levels[x]) return;
    remaining_[at(running)] = end_[x] - now;
    status_[at(running)] = kReady;
    word[at(place) / 64] |= std::uint64_t{1} << (place % 64);
    cost = problem_.preempt[x];
  } else {
    --ready_count_[x];
  }
  word[k] &= word[k] - 1;
  const std::size_t i = at(sequence_[at(best)]);
  if (remaining_[i] < 0) {
    if (problem_.levels[x] > 0 && suspended(x) > 0) cost = problem_.preempt[x];
    if constexpr (kRecord) started_at_[i] = now;
    remaining_[i] = work_[i];
  }
  status_[i] = kRunning;
  running_[x] = static_cast<int>(i);
  end_[x] = now + remaining_[i] + cost;
}

template <bool kRecord>
Time Evaluator::run(Time limit) {
  std::size_t since_snapshot = 0;
  touched_list_.clear();
  while (true) {
    if constexpr (kRecord) {
      if (since_snapshot == 0) {
        if (snapshots_used_ == snapshots_.size()) snapshots_.emplace_back();
        save(snapshots_[snapshots_used_++], now_, latest_);
        since_snapshot = stride_;
      }
      --since_snapshot;
    }
    Time now = kNever;
    for (std::size_t x = 0; x < m_; ++x) now = std::min(now, end_[x]);
    if (now == kNever) return hangs() ? kNever : cost();
    now_ = now;
    latest_ = now;
    for (std::size_t x = 0; x < m_; ++x) {
      if (end_[x] != now) continue;
      const std::size_t i = at(running_[x]);
      running_[x] = -1;
      end_[x] = kNever;
      status_[i] = kDone;
      if (!problem_.goal.plain()) charged_ += problem_.goal.charge(i, now);
      if constexpr (kRecord) finished_at_[i] = now;
      if (!touched_[x]) {
        touched_[x] = 1;
        touched_list_.push_back(static_cast<int>(x));
      }
      // False: too late for the limit.
      const auto make_ready = [&](std::size_t s) {
        if constexpr (!kRecord) {
          if (now + work_[s] + tail_[s] >= limit && !problem_.goal.weighted) return false;
        } else {
          ready_at_[s] = now;
        }
        status_[s] = kReady;
        push_ready(static_cast<int>(s));
        const std::size_t sx = at(xpu_[s]);
        if (!touched_[sx]) {
          touched_[sx] = 1;
          touched_list_.push_back(static_cast<int>(sx));
        }
        return true;
      };
      bool in_time = true;
      for (int e = succ_begin_[i]; e < succ_begin_[i + 1] && in_time; ++e) {
        const std::size_t s = at(succ_list_[at(e)]);
        if (--missing_[s] != 0) continue;
        if constexpr (kRecord) released_at_[s] = now;
        if (!held(s)) in_time = make_ready(s);
      }
      for (int w = first_waiting_[i]; w >= 0 && in_time; w = next_waiting_[at(w)])
        if (status_[at(w)] == kWaiting && missing_[at(w)] == 0 && xpu_[at(w)] == xpu_[i])
          in_time = make_ready(at(w));
      if (!in_time) {
        for (int t : touched_list_) touched_[at(t)] = 0;
        return kNever;
      }
    }
    for (int t : touched_list_) {
      touched_[at(t)] = 0;
      decide<kRecord>(t, now);
    }
    touched_list_.clear();
  }
}

Time Evaluator::evaluate(Time limit) {
  ++evaluations_;
  if (dirty_from_ == kNever) return makespan_ < limit ? makespan_ : kNever;
  if (!problem_.goal.weighted) {
    for (std::size_t x = 0; x < m_; ++x)
      if (load_[x] >= limit) return kNever;
    for (int s : sources_)
      if (work_[at(s)] + tail_[at(s)] >= limit) return kNever;
  }
  // The last snapshot strictly before the first difference; its own decisions are then still valid.
  std::size_t k = snapshots_used_;
  while (k > 0 && snapshots_[k - 1].now >= dirty_from_) --k;
  if (k == 0) {
    std::fill(status_.begin(), status_.end(), static_cast<std::uint8_t>(kWaiting));
    missing_ = in_degree_;
    std::fill(end_.begin(), end_.end(), kNever);
    std::fill(running_.begin(), running_.end(), -1);
    std::fill(ready_count_.begin(), ready_count_.end(), 0);
    std::fill(ready_.begin(), ready_.end(), 0);
    std::fill(remaining_.begin(), remaining_.end(), -1);
    now_ = latest_ = charged_ = 0;
    for (int s : sources_) {
      if (held(at(s))) continue;
      status_[at(s)] = kReady;
      push_ready(s);
    }
    for (std::size_t x = 0; x < m_; ++x) decide<false>(static_cast<int>(x), 0);
  } else {
    restore(snapshots_[k - 1]);
  }
  const Time makespan = run<false>(limit);
  return makespan < limit ? makespan : kNever;
}

void Evaluator::commit() {
  edits_.clear();
  if (dirty_from_ == kNever) return;
  std::size_t k = snapshots_used_;
  while (k > 0 && snapshots_[k - 1].now >= dirty_from_) --k;
  dirty_from_ = kNever;
  if (k == 0) {
    snapshots_used_ = 0;
    start_from_scratch();
  } else {
    snapshots_used_ = k - 1;  // run() saves it again, with the same content
    restore(snapshots_[k - 1]);
  }
  makespan_ = run<true>(kNever);
}

void Evaluator::critical_chain(std::vector<int>& chain) const {
  chain.clear();
  int current = -1;
  // The XNodes of each XPU, one XPU after the other.
  xpu_begin_.assign(m_ + 1, 0);
  on_xpu_.resize(n_);
  for (std::size_t i = 0; i < n_; ++i) ++xpu_begin_[at(xpu_[i]) + 1];
  for (std::size_t x = 0; x < m_; ++x) xpu_begin_[x + 1] += xpu_begin_[x];
  for (std::size_t i = n_; i-- > 0;) {
    std::size_t& filled = xpu_begin_[at(xpu_[i]) + 1];
    on_xpu_[--filled] = static_cast<int>(i);
  }
  // Filling from behind has moved each end to its beginning.
  xpu_begin_.erase(xpu_begin_.begin());
  xpu_begin_.push_back(n_);
  // By finish: two XNodes of one XPU never end at the same time.
  const auto ends_first = [&](int a, int b) { return finished_at_[at(a)] < finished_at_[at(b)]; };
  for (std::size_t x = 0; x < m_; ++x)
    std::sort(on_xpu_.begin() + static_cast<std::ptrdiff_t>(xpu_begin_[x]),
              on_xpu_.begin() + static_cast<std::ptrdiff_t>(xpu_begin_[x + 1]), ends_first);
  for (std::size_t i = 0; i < n_; ++i)
    if (current < 0 || finished_at_[i] > finished_at_[at(current)]) current = static_cast<int>(i);
  while (current >= 0 && chain.size() <= n_) {
    chain.push_back(current);
    const std::size_t i = at(current);
    const Time begin = started_at_[i];
    int next = -1;
    // Delayed on its XPU: whoever finished there at its start, or ran while it was suspended;
    // otherwise the predecessor that released it.
    if (finished_at_[i] - begin > work_[i] || begin > ready_at_[i]) {
      const auto first = on_xpu_.begin() + static_cast<std::ptrdiff_t>(xpu_begin_[at(xpu_[i])]);
      const auto last = on_xpu_.begin() + static_cast<std::ptrdiff_t>(xpu_begin_[at(xpu_[i]) + 1]);
      const auto own = std::lower_bound(first, last, current, ends_first);
      if (own != first && finished_at_[at(*(own - 1))] > ready_at_[i]) next = *(own - 1);
    }
    if (next < 0) {
      for (int e = pred_begin_[i]; e < pred_begin_[i + 1]; ++e) {
        const int p = pred_list_[at(e)];
        if (finished_at_[at(p)] == ready_at_[i]) next = p;
      }
      const int other = waits_for_[i];
      if (next < 0 && other >= 0 && xpu_[at(other)] == xpu_[i]) next = other;
    }
    current = next;
  }
}

}  // namespace xauto::solver
