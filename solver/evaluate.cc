// SPDX-License-Identifier: Apache-2.0
// See evaluate.h.
#include "solver/evaluate.h"

#include <algorithm>
#include <bit>

#include "base/index.h"

namespace xauto::solver {

Evaluator::Evaluator(const Problem& problem)
    : problem_(problem), n_(at(problem.num_xnodes)), m_(at(problem.num_xpus)) {
  links_.succ_begin.assign(n_ + 1, 0);
  links_.pred_begin.assign(n_ + 1, 0);
  in_degree_.resize(n_);
  links_.topo_rank.resize(n_);
  for (std::size_t i = 0; i < n_; ++i) {
    for (int s : problem.succ[i]) links_.succ_list.push_back(s);
    for (int p : problem.pred[i]) links_.pred_list.push_back(p);
    links_.succ_begin[i + 1] = static_cast<int>(links_.succ_list.size());
    links_.pred_begin[i + 1] = static_cast<int>(links_.pred_list.size());
    in_degree_[i] = static_cast<std::uint16_t>(problem.pred[i].size());
    if (problem.pred[i].empty()) links_.sources.push_back(static_cast<int>(i));
  }
  for (std::size_t k = 0; k < problem.topo.size(); ++k)
    links_.topo_rank[at(problem.topo[k])] = static_cast<int>(k);
  solution_.xpu.assign(n_, -1);
  solution_.sequence.assign(n_, -1);
  solution_.position.assign(n_, -1);
  solution_.work.assign(n_, 0);
  solution_.tail.assign(n_, 0);
  solution_.load.assign(m_, 0);
  state_.status.assign(n_, kWaiting);
  state_.missing.assign(n_, 0);
  state_.remaining.assign(n_, 0);
  state_.end.assign(m_, kNever);
  state_.running.assign(m_, -1);
  words_ = (n_ + 63) / 64;
  ready_.assign(m_ * words_, 0);
  ready_count_.assign(m_, 0);
  touched_.assign(m_, 0);
  solution_.waits_for.assign(n_, -1);
  solution_.first_waiting.assign(n_, -1);
  solution_.next_waiting.assign(n_, -1);
  committed_.released_at.assign(n_, 0);
  committed_.ready_at.assign(n_, 0);
  committed_.started_at.assign(n_, 0);
  committed_.finished_at.assign(n_, 0);
  in_queue_.assign(n_, 0);
  // Few snapshots where they are large: beyond that, copying state costs more than it saves.
  kept_.stride = std::max<std::size_t>(1, n_ / (n_ > 200 ? 32 : 64));
}

void Evaluator::reset(const std::vector<int>& xpu, const std::vector<int>& sequence,
                      const std::vector<int>& waits_for) {
  edits_.clear();
  for (std::size_t i = 0; i < n_; ++i)
    link(static_cast<int>(i), waits_for.empty() ? -1 : waits_for[i]);
  solution_.xpu = xpu;
  solution_.sequence = sequence;
  std::fill(solution_.load.begin(), solution_.load.end(), 0);
  for (std::size_t k = 0; k < n_; ++k)
    solution_.position[at(solution_.sequence[k])] = static_cast<int>(k);
  for (std::size_t i = 0; i < n_; ++i) {
    solution_.work[i] = problem_.wcet_on(static_cast<int>(i), solution_.xpu[i]);
    solution_.load[at(solution_.xpu[i])] += solution_.work[i];
  }
  for (std::size_t k = n_; k-- > 0;) {
    const std::size_t i = at(problem_.topo[k]);
    Time tail = 0;
    for (int e = links_.succ_begin[i]; e < links_.succ_begin[i + 1]; ++e) {
      const std::size_t s = at(links_.succ_list[at(e)]);
      tail = std::max(tail, solution_.work[s] + solution_.tail[s]);
    }
    solution_.tail[i] = tail;
  }
  dirty_from_ = kNever;
  start_from_scratch();
  kept_.used = 0;
  makespan_ = run<true>(kNever);
}

void Evaluator::update_tails(int xnode) {
  // Ancestors of `xnode`, nearest first in topological order, only where something changes.
  std::vector<int>& queue = touched_list_;  // free outside run()
  queue.clear();
  auto push = [&](std::size_t i) {
    for (int e = links_.pred_begin[i]; e < links_.pred_begin[i + 1]; ++e) {
      const int p = links_.pred_list[at(e)];
      if (in_queue_[at(p)]) continue;
      in_queue_[at(p)] = 1;
      queue.push_back(p);
      std::push_heap(queue.begin(), queue.end(), [&](int a, int b) {
        return links_.topo_rank[at(a)] < links_.topo_rank[at(b)];
      });
    }
  };
  push(at(xnode));
  while (!queue.empty()) {
    std::pop_heap(queue.begin(), queue.end(),
                  [&](int a, int b) { return links_.topo_rank[at(a)] < links_.topo_rank[at(b)]; });
    const std::size_t i = at(queue.back());
    queue.pop_back();
    in_queue_[i] = 0;
    Time tail = 0;
    for (int e = links_.succ_begin[i]; e < links_.succ_begin[i + 1]; ++e) {
      const std::size_t s = at(links_.succ_list[at(e)]);
      tail = std::max(tail, solution_.work[s] + solution_.tail[s]);
    }
    if (tail == solution_.tail[i]) continue;
    solution_.tail[i] = tail;
    push(i);
  }
}

void Evaluator::assign(int xnode, int xpu) {
  const std::size_t i = at(xnode);
  if (solution_.xpu[i] == xpu) return;
  edits_.push_back({xnode, solution_.xpu[i], solution_.position[i], solution_.waits_for[i]});
  dirty_from_ = std::min(dirty_from_, committed_.released_at[i]);
  for (int w = solution_.first_waiting[i]; w >= 0; w = solution_.next_waiting[at(w)])
    dirty_from_ = std::min(dirty_from_, committed_.released_at[at(w)]);
  solution_.load[at(solution_.xpu[i])] -= solution_.work[i];
  const Time before = solution_.work[i];
  solution_.xpu[i] = xpu;
  solution_.work[i] = problem_.wcet_on(xnode, xpu);
  solution_.load[at(xpu)] += solution_.work[i];
  if (solution_.work[i] != before) update_tails(xnode);
}

void Evaluator::move_position(int xnode, int position) {
  const int from = solution_.position[at(xnode)];
  if (from < position) {
    for (int k = from; k < position; ++k) {
      solution_.sequence[at(k)] = solution_.sequence[at(k + 1)];
      solution_.position[at(solution_.sequence[at(k)])] = k;
    }
  } else {
    for (int k = from; k > position; --k) {
      solution_.sequence[at(k)] = solution_.sequence[at(k - 1)];
      solution_.position[at(solution_.sequence[at(k)])] = k;
    }
  }
  solution_.sequence[at(position)] = xnode;
  solution_.position[at(xnode)] = position;
}

void Evaluator::reposition(int xnode, int position) {
  const std::size_t i = at(xnode);
  if (solution_.position[i] == position) return;
  edits_.push_back({xnode, solution_.xpu[i], solution_.position[i], solution_.waits_for[i]});
  dirty_from_ = std::min(dirty_from_, committed_.ready_at[i]);
  move_position(xnode, position);
}

void Evaluator::link(int xnode, int other) {
  const std::size_t i = at(xnode);
  if (solution_.waits_for[i] == other) return;
  if (solution_.waits_for[i] >= 0) {
    --solution_.waiting;
    int* place = &solution_.first_waiting[at(solution_.waits_for[i])];
    while (*place != xnode) place = &solution_.next_waiting[at(*place)];
    *place = solution_.next_waiting[i];
  }
  solution_.waits_for[i] = other;
  if (other < 0) return;
  ++solution_.waiting;
  solution_.next_waiting[i] = solution_.first_waiting[at(other)];
  solution_.first_waiting[at(other)] = xnode;
}

void Evaluator::wait_for(int xnode, int other) {
  const std::size_t i = at(xnode);
  if (solution_.waits_for[i] == other) return;
  edits_.push_back({xnode, solution_.xpu[i], solution_.position[i], solution_.waits_for[i]});
  dirty_from_ = std::min(dirty_from_, committed_.released_at[i]);
  link(xnode, other);
}

bool Evaluator::hangs() const {
  return solution_.waiting > 0 && std::any_of(state_.status.begin(), state_.status.end(),
                                              [](std::uint8_t status) { return status != kDone; });
}

void Evaluator::rollback() {
  while (!edits_.empty()) {
    const Edit edit = edits_.back();
    edits_.pop_back();
    const std::size_t i = at(edit.xnode);
    if (solution_.xpu[i] != edit.old_xpu) {
      solution_.load[at(solution_.xpu[i])] -= solution_.work[i];
      const Time before = solution_.work[i];
      solution_.xpu[i] = edit.old_xpu;
      solution_.work[i] = problem_.wcet_on(edit.xnode, edit.old_xpu);
      solution_.load[at(edit.old_xpu)] += solution_.work[i];
      if (solution_.work[i] != before) update_tails(edit.xnode);
    }
    if (solution_.position[i] != edit.old_position) move_position(edit.xnode, edit.old_position);
    link(edit.xnode, edit.old_waits_for);
  }
  dirty_from_ = kNever;
}

void Evaluator::push_ready(int xnode) {
  const std::size_t x = at(solution_.xpu[at(xnode)]), place = at(solution_.position[at(xnode)]);
  ready_[x * words_ + place / 64] |= std::uint64_t{1} << (place % 64);
  ++ready_count_[x];
}

void Evaluator::start_from_scratch() {
  std::fill(state_.status.begin(), state_.status.end(), static_cast<std::uint8_t>(kWaiting));
  state_.missing = in_degree_;
  std::fill(state_.end.begin(), state_.end.end(), kNever);
  std::fill(state_.running.begin(), state_.running.end(), -1);
  std::fill(ready_count_.begin(), ready_count_.end(), 0);
  std::fill(ready_.begin(), ready_.end(), 0);
  state_.now = 0;
  state_.latest = state_.charged = 0;
  for (std::size_t i = 0; i < n_; ++i) state_.remaining[i] = -1;
  for (int s : links_.sources) {
    committed_.released_at[at(s)] = committed_.ready_at[at(s)] = 0;
    if (held(at(s))) continue;
    state_.status[at(s)] = kReady;
    push_ready(s);
  }
  for (std::size_t x = 0; x < m_; ++x) decide<true>(static_cast<int>(x), 0);
}

Time Evaluator::cost() const {
  return state_.latest + state_.charged;
}

void Evaluator::save(State& snapshot, Time now, Time latest) const {
  snapshot = state_;
  snapshot.now = now;
  snapshot.latest = latest;
}

void Evaluator::restore(const State& snapshot) {
  state_ = snapshot;
  std::fill(ready_count_.begin(), ready_count_.end(), 0);
  std::fill(ready_.begin(), ready_.end(), 0);
  for (std::size_t i = 0; i < n_; ++i)
    if (state_.status[i] == kReady) push_ready(static_cast<int>(i));
}

int Evaluator::suspended(std::size_t xpu) const {
  int count = 0;
  for (std::size_t k = 0; k < words_; ++k)
    for (std::uint64_t bits = ready_[xpu * words_ + k]; bits != 0; bits &= bits - 1)
      count += state_.remaining[at(solution_.sequence[k * 64 + at(std::countr_zero(bits))])] >= 0;
  return count;
}

template <bool kRecord>
void Evaluator::decide(int xpu, Time now) {
  const std::size_t x = at(xpu);
  if (ready_count_[x] == 0) return;
  const int running = state_.running[x];
  if (running >= 0 && !problem_.preemptive[x]) return;
  std::uint64_t* word = ready_.data() + x * words_;
  std::size_t k = 0;
  while (word[k] == 0) ++k;
  const int best = static_cast<int>(k * 64) + std::countr_zero(word[k]);
  Time cost = 0;
  if (running >= 0) {
    const int place = solution_.position[at(running)];
    if (best > place) return;
    if (problem_.levels[x] > 0 && 1 + suspended(x) >= problem_.levels[x]) return;
    state_.remaining[at(running)] = state_.end[x] - now;
    state_.status[at(running)] = kReady;
    word[at(place) / 64] |= std::uint64_t{1} << (place % 64);
    cost = problem_.preempt[x];
  } else {
    --ready_count_[x];
  }
  word[k] &= word[k] - 1;
  const std::size_t i = at(solution_.sequence[at(best)]);
  if (state_.remaining[i] < 0) {
    if (problem_.levels[x] > 0 && suspended(x) > 0) cost = problem_.preempt[x];
    if constexpr (kRecord) committed_.started_at[i] = now;
    state_.remaining[i] = solution_.work[i];
  }
  state_.status[i] = kRunning;
  state_.running[x] = static_cast<int>(i);
  state_.end[x] = now + state_.remaining[i] + cost;
}

template <bool kRecord>
Time Evaluator::run(Time limit) {
  std::size_t since_snapshot = 0;
  touched_list_.clear();
  while (true) {
    if constexpr (kRecord) {
      if (since_snapshot == 0) {
        if (kept_.used == kept_.all.size()) kept_.all.emplace_back();
        save(kept_.all[kept_.used++], state_.now, state_.latest);
        since_snapshot = kept_.stride;
      }
      --since_snapshot;
    }
    Time now = kNever;
    for (std::size_t x = 0; x < m_; ++x) now = std::min(now, state_.end[x]);
    if (now == kNever) return hangs() ? kNever : cost();
    state_.now = now;
    state_.latest = now;
    for (std::size_t x = 0; x < m_; ++x) {
      if (state_.end[x] != now) continue;
      const std::size_t i = at(state_.running[x]);
      state_.running[x] = -1;
      state_.end[x] = kNever;
      state_.status[i] = kDone;
      if (!problem_.goal.plain()) state_.charged += problem_.goal.charge(i, now);
      if constexpr (kRecord) committed_.finished_at[i] = now;
      if (!touched_[x]) {
        touched_[x] = 1;
        touched_list_.push_back(static_cast<int>(x));
      }
      // False: too late for the limit.
      const auto make_ready = [&](std::size_t s) {
        if constexpr (!kRecord) {
          if (now + solution_.work[s] + solution_.tail[s] >= limit) return false;
        } else {
          committed_.ready_at[s] = now;
        }
        state_.status[s] = kReady;
        push_ready(static_cast<int>(s));
        const std::size_t sx = at(solution_.xpu[s]);
        if (!touched_[sx]) {
          touched_[sx] = 1;
          touched_list_.push_back(static_cast<int>(sx));
        }
        return true;
      };
      bool in_time = true;
      for (int e = links_.succ_begin[i]; e < links_.succ_begin[i + 1] && in_time; ++e) {
        const std::size_t s = at(links_.succ_list[at(e)]);
        if (--state_.missing[s] != 0) continue;
        if constexpr (kRecord) committed_.released_at[s] = now;
        if (!held(s)) in_time = make_ready(s);
      }
      for (int w = solution_.first_waiting[i]; w >= 0 && in_time; w = solution_.next_waiting[at(w)])
        if (state_.status[at(w)] == kWaiting && state_.missing[at(w)] == 0 &&
            solution_.xpu[at(w)] == solution_.xpu[i])
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
  for (std::size_t x = 0; x < m_; ++x)
    if (solution_.load[x] >= limit) return kNever;
  for (int s : links_.sources)
    if (solution_.work[at(s)] + solution_.tail[at(s)] >= limit) return kNever;
  // The last snapshot strictly before the first difference; its own decisions are then still valid.
  std::size_t k = kept_.used;
  while (k > 0 && kept_.all[k - 1].now >= dirty_from_) --k;
  if (k == 0) {
    std::fill(state_.status.begin(), state_.status.end(), static_cast<std::uint8_t>(kWaiting));
    state_.missing = in_degree_;
    std::fill(state_.end.begin(), state_.end.end(), kNever);
    std::fill(state_.running.begin(), state_.running.end(), -1);
    std::fill(ready_count_.begin(), ready_count_.end(), 0);
    std::fill(ready_.begin(), ready_.end(), 0);
    std::fill(state_.remaining.begin(), state_.remaining.end(), -1);
    state_.now = state_.latest = state_.charged = 0;
    for (int s : links_.sources) {
      if (held(at(s))) continue;
      state_.status[at(s)] = kReady;
      push_ready(s);
    }
    for (std::size_t x = 0; x < m_; ++x) decide<false>(static_cast<int>(x), 0);
  } else {
    restore(kept_.all[k - 1]);
  }
  const Time makespan = run<false>(limit);
  return makespan < limit ? makespan : kNever;
}

void Evaluator::commit() {
  edits_.clear();
  if (dirty_from_ == kNever) return;
  std::size_t k = kept_.used;
  while (k > 0 && kept_.all[k - 1].now >= dirty_from_) --k;
  dirty_from_ = kNever;
  if (k == 0) {
    kept_.used = 0;
    start_from_scratch();
  } else {
    kept_.used = k - 1;  // run() saves it again, with the same content
    restore(kept_.all[k - 1]);
  }
  makespan_ = run<true>(kNever);
}

void Evaluator::critical_chain(std::vector<int>& chain) const {
  chain.clear();
  int current = -1;
  // The XNodes of each XPU, one XPU after the other.
  xpu_begin_.assign(m_ + 1, 0);
  on_xpu_.resize(n_);
  for (std::size_t i = 0; i < n_; ++i) ++xpu_begin_[at(solution_.xpu[i]) + 1];
  for (std::size_t x = 0; x < m_; ++x) xpu_begin_[x + 1] += xpu_begin_[x];
  for (std::size_t i = n_; i-- > 0;) {
    std::size_t& filled = xpu_begin_[at(solution_.xpu[i]) + 1];
    on_xpu_[--filled] = static_cast<int>(i);
  }
  // Filling from behind has moved each end to its beginning.
  xpu_begin_.erase(xpu_begin_.begin());
  xpu_begin_.push_back(n_);
  // By finish: two XNodes of one XPU never end at the same time.
  const auto ends_first = [&](int a, int b) {
    return committed_.finished_at[at(a)] < committed_.finished_at[at(b)];
  };
  for (std::size_t x = 0; x < m_; ++x)
    std::sort(on_xpu_.begin() + static_cast<std::ptrdiff_t>(xpu_begin_[x]),
              on_xpu_.begin() + static_cast<std::ptrdiff_t>(xpu_begin_[x + 1]), ends_first);
  for (std::size_t i = 0; i < n_; ++i)
    if (current < 0 || committed_.finished_at[i] > committed_.finished_at[at(current)])
      current = static_cast<int>(i);
  while (current >= 0 && chain.size() <= n_) {
    chain.push_back(current);
    const std::size_t i = at(current);
    const Time begin = committed_.started_at[i];
    int next = -1;
    // Delayed on its XPU: whoever finished there at its start, or ran while it was suspended;
    // otherwise the predecessor that released it.
    if (committed_.finished_at[i] - begin > solution_.work[i] || begin > committed_.ready_at[i]) {
      const auto first =
          on_xpu_.begin() + static_cast<std::ptrdiff_t>(xpu_begin_[at(solution_.xpu[i])]);
      const auto last =
          on_xpu_.begin() + static_cast<std::ptrdiff_t>(xpu_begin_[at(solution_.xpu[i]) + 1]);
      const auto own = std::lower_bound(first, last, current, ends_first);
      if (own != first && committed_.finished_at[at(*(own - 1))] > committed_.ready_at[i])
        next = *(own - 1);
    }
    if (next < 0) {
      for (int e = links_.pred_begin[i]; e < links_.pred_begin[i + 1]; ++e) {
        const int p = links_.pred_list[at(e)];
        if (committed_.finished_at[at(p)] == committed_.ready_at[i]) next = p;
      }
      const int other = solution_.waits_for[i];
      if (next < 0 && other >= 0 && solution_.xpu[at(other)] == solution_.xpu[i]) next = other;
    }
    current = next;
  }
}

}  // namespace xauto::solver
