// SPDX-License-Identifier: Apache-2.0
// The checker's own proofs that nothing is shorter than a target. Two arguments, both by exhaustion
// with pruning: over the choice of a type per XNode (weak at each leaf, few leaves), and over
// executions (exact, for small apps).
#include <algorithm>
#include <cstdint>
#include <limits>

#include "base/index.h"

#include "reference/verify_world.h"

namespace xauto::solver::verification {
namespace {

class ByTypes {
 public:
  ByTypes(const World& world, Us target, std::int64_t budget)
      : w_(world), target_(target), budget_(budget), cost_(at(world.n)), chosen_(at(world.n), -1) {
    for (int x = 0; x < w_.m; ++x) {
      const auto k = at(w_.kind[at(x)]);
      if (instances_.size() <= k) {
        instances_.resize(k + 1, 0);
        sample_.resize(k + 1, -1);
      }
      ++instances_[k];
      if (sample_[k] < 0) sample_[k] = x;
    }
    for (int i = 0; i < w_.n; ++i) {
      cost_[at(i)] = w_.least(i);
      branch_.push_back(i);
    }
    // Where the choice matters most comes first.
    std::stable_sort(branch_.begin(), branch_.end(),
                     [&](int a, int b) { return regret(a) > regret(b); });
  }

  Proof run() {
    if (!descend(0)) return Proof::kUnknown;
    return Proof::kHolds;
  }

 private:
  [[nodiscard]] Us regret(int i) const {
    Us greatest = 0;
    for (const auto& us : w_.wcet[at(i)])
      if (us) greatest = std::max(greatest, *us);
    return greatest - w_.least(i);
  }

  /// True if everything below is at least `target_`.
  bool descend(std::size_t depth) {
    if (--budget_ < 0) return false;
    if (excluded()) return true;
    if (depth == branch_.size()) return false;
    const int i = branch_[depth];
    for (std::size_t k = 0; k < instances_.size(); ++k) {
      const auto us = w_.wcet[at(i)][at(sample_[k])];
      if (!us) continue;
      chosen_[at(i)] = static_cast<int>(k);
      const Us old = cost_[at(i)];
      cost_[at(i)] = *us;
      const bool holds = descend(depth + 1);
      cost_[at(i)] = old;
      chosen_[at(i)] = -1;
      if (!holds) return false;
    }
    return true;
  }

  bool excluded() {
    const std::size_t n = at(w_.n);
    head_.assign(n, 0);
    tail_.assign(n, 0);
    for (const int i : w_.first_to_last)
      for (const int v : w_.after[at(i)])
        head_[at(v)] = std::max(head_[at(v)], head_[at(i)] + cost_[at(i)]);
    for (auto it = w_.first_to_last.rbegin(); it != w_.first_to_last.rend(); ++it) {
      for (const int v : w_.after[at(*it)])
        tail_[at(*it)] = std::max(tail_[at(*it)], tail_[at(v)] + cost_[at(v)]);
      if (head_[at(*it)] + cost_[at(*it)] + tail_[at(*it)] >= target_) return true;
    }
    for (std::size_t k = 0; k < instances_.size(); ++k) {
      members_.clear();
      for (int i = 0; i < w_.n; ++i)
        if (chosen_[at(i)] == static_cast<int>(k)) members_.push_back(i);
      // By descending head: for each least tail, the work grows as the least head falls.
      std::sort(members_.begin(), members_.end(),
                [&](int a, int b) { return head_[at(a)] > head_[at(b)]; });
      for (const int last : members_) {
        Us work = 0;
        for (const int i : members_) {
          if (tail_[at(i)] < tail_[at(last)]) continue;
          work += cost_[at(i)];
          const Us time = (work + instances_[k] - 1) / instances_[k];
          if (head_[at(i)] + time + tail_[at(last)] >= target_) return true;
        }
      }
    }
    return false;
  }

  const World& w_;
  const Us target_;
  std::int64_t budget_;
  std::vector<Us> cost_;
  std::vector<int> chosen_, branch_, sample_, members_;
  std::vector<Us> instances_, head_, tail_;
};

/// Depth first over executions. What has not been needed yet is undecided: the XPU of an XNode that
/// has not become ready, the urgency of two XNodes that never met. `over[a][b]`: a is more urgent
/// than b; kept closed.
class ByExecution {
 public:
  ByExecution(const World& world, Us target, std::int64_t budget)
      : w_(world), target_(target), budget_(budget), tail_(at(world.n), 0) {
    for (auto it = w_.first_to_last.rbegin(); it != w_.first_to_last.rend(); ++it)
      for (const int v : w_.after[at(*it)])
        tail_[at(*it)] = std::max(tail_[at(*it)], tail_[at(v)] + w_.least(v));
  }

  Proof run() {
    Moment begin;
    begin.xpu.assign(at(w_.n), -1);
    begin.rest.assign(at(w_.n), 0);
    begin.done.assign(at(w_.n), 0);
    begin.over.assign(at(w_.n) * at(w_.n), 0);
    begin.runs.assign(at(w_.m), -1);
    begin.begun.assign(at(w_.n), 0);
    begin.touched.assign(at(w_.m), 0);
    visit(begin);
    return beaten_ ? Proof::kBeaten : budget_ < 0 ? Proof::kUnknown : Proof::kHolds;
  }

 private:
  struct Moment {
    Us now = 0;
    int finished = 0;
    std::vector<int> xpu;
    std::vector<Us> rest;
    std::vector<char> done, over, begun;
    std::vector<int> runs;
    std::vector<char> touched;
  };

  [[nodiscard]] bool is_ready(const Moment& s, int i) const {
    return !s.done[at(i)] && std::all_of(w_.before[at(i)].begin(), w_.before[at(i)].end(),
                                         [&](int u) { return s.done[at(u)] != 0; });
  }

  /// How many XNodes have begun on x and not ended.
  [[nodiscard]] int open_on(const Moment& s, int x) const {
    int open = 0;
    for (int i = 0; i < w_.n; ++i)
      open += s.xpu[at(i)] == x && s.begun[at(i)] != 0 && s.done[at(i)] == 0;
    return open;
  }
  [[nodiscard]] bool full(const Moment& s, int x) const {
    return w_.levels[at(x)] != 0 && open_on(s, x) >= w_.levels[at(x)];
  }

  void visit(Moment s) {
    while (!beaten_ && --budget_ >= 0) {
      if (s.finished == w_.n) {
        beaten_ = s.now < target_;
        return;
      }
      std::vector<int> ready;
      for (int i = 0; i < w_.n; ++i)
        if (is_ready(s, i)) ready.push_back(i);
      Us open = 0;
      for (const int i : ready) {
        const Us least = s.xpu[at(i)] >= 0 ? s.rest[at(i)] : w_.least(i);
        if (s.now + least + tail_[at(i)] >= target_) return;
      }
      for (int i = 0; i < w_.n; ++i)
        if (!s.done[at(i)]) open += s.xpu[at(i)] >= 0 ? s.rest[at(i)] : w_.least(i);
      if (s.now + (open + w_.m - 1) / w_.m >= target_) return;

      for (const int i : ready)
        if (s.xpu[at(i)] < 0) return place(s, i);
      for (int x = 0; x < w_.m; ++x) {
        if (s.runs[at(x)] >= 0 && (!w_.preemptive[at(x)] || full(s, x))) continue;
        std::vector<int> rivals;
        for (const int i : ready)
          if (s.xpu[at(i)] == x) rivals.push_back(i);
        if (rivals.empty()) continue;
        std::vector<int> could_be_first;
        for (const int i : rivals)
          if (std::none_of(rivals.begin(), rivals.end(),
                           [&](int j) { return s.over[cell(j, i)] != 0; }))
            could_be_first.push_back(i);
        const int first = could_be_first.front();
        const bool settled = std::all_of(rivals.begin(), rivals.end(), [&](int j) {
          return j == first || s.over[cell(first, j)] != 0;
        });
        if (!settled) {
          for (const int i : could_be_first) {
            Moment next = s;
            for (const int j : rivals)
              if (j != i) put_over(next, i, j);
            visit(std::move(next));
          }
          return;
        }
        if (s.runs[at(x)] == first) continue;
        if (s.runs[at(x)] >= 0 ||
            (w_.levels[at(x)] != 0 && s.begun[at(first)] == 0 && open_on(s, x) > 0))
          s.rest[at(first)] += w_.preempt_us[at(x)];
        s.runs[at(x)] = first;
        s.begun[at(first)] = 1;
      }
      Us step = std::numeric_limits<Us>::max();
      for (const int i : s.runs)
        if (i >= 0) step = std::min(step, s.rest[at(i)]);
      s.now += step;
      for (int& i : s.runs) {
        if (i < 0) continue;
        s.rest[at(i)] -= step;
        if (s.rest[at(i)] > 0) continue;
        s.done[at(i)] = 1;
        ++s.finished;
        i = -1;
      }
    }
  }

  void place(const Moment& s, int i) {
    std::vector<char> tried;  // [kind]: an instance that nothing has run on stands for all like it
    for (int x = 0; x < w_.m; ++x) {
      const auto us = w_.wcet[at(i)][at(x)];
      if (!us) continue;
      const auto kind = at(w_.kind[at(x)]);
      if (tried.size() <= kind) tried.resize(kind + 1, 0);
      if (!s.touched[at(x)]) {
        if (tried[kind]) continue;
        tried[kind] = 1;
      }
      Moment next = s;
      next.xpu[at(i)] = x;
      next.rest[at(i)] = *us;
      next.touched[at(x)] = 1;
      visit(std::move(next));
    }
  }

  [[nodiscard]] std::size_t cell(int a, int b) const { return at(a) * at(w_.n) + at(b); }

  void put_over(Moment& s, int a, int b) const {
    for (int i = 0; i < w_.n; ++i) {
      if (i != a && !s.over[cell(i, a)]) continue;
      for (int j = 0; j < w_.n; ++j)
        if (j == b || s.over[cell(b, j)]) s.over[cell(i, j)] = 1;
    }
  }

  const World& w_;
  const Us target_;
  std::int64_t budget_;
  std::vector<Us> tail_;
  bool beaten_ = false;
};

}  // namespace

Proof prove_by_types(const World& world, Us target, std::int64_t budget) {
  return ByTypes(world, target, budget).run();
}

Proof prove_by_execution(const World& world, Us target, std::int64_t budget) {
  return ByExecution(world, target, budget).run();
}

}  // namespace xauto::solver::verification
