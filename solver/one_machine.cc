// SPDX-License-Identifier: Apache-2.0
// See one_machine.h.
#include "solver/one_machine.h"

#include <algorithm>
#include <bit>

#include "base/index.h"
#include "solver/evaluate.h"

namespace xauto::solver {

OneMachine::Answer OneMachine::narrow(Windows& windows) {
  bool narrowed = false;
  for (int type = 0; type < problem_.num_types; ++type) {
    const auto instances = static_cast<int>(problem_.type_xpus[at(type)].size());
    for (int place = 0; place < instances; ++place) {
      if (!load(windows, type, instances == 1 ? -1 : place)) return Answer::kImpossible;
      for (const Item& c : by_r_) {
        const Time end = earliest_end(c), start = latest_start(c);
        if (end > c.d || start < c.r) return Answer::kImpossible;
        for (const int s : problem_.succ[at(c.xnode)]) {
          if (windows.r[at(s)] >= end) continue;
          windows.r[at(s)] = end;
          narrowed = true;
        }
        for (const int p : problem_.pred[at(c.xnode)]) {
          if (windows.d[at(p)] <= start) continue;
          windows.d[at(p)] = start;
          narrowed = true;
        }
      }
      if (instances > 1 || by_r_.empty()) continue;
      for (int i = 0; i < problem_.num_xnodes; ++i) {
        TypeSet& types = windows.types[at(i)];
        if ((types >> type & 1u) == 0 || std::has_single_bit(types)) continue;
        if (fits_beside({i, windows.r[at(i)], windows.d[at(i)], work(windows, i, type)})) continue;
        types &= ~(TypeSet{1} << type);
        narrowed = true;
      }
    }
  }
  return narrowed ? Answer::kNarrowed : Answer::kSame;
}

Time OneMachine::work(const Windows& windows, int xnode, int type) const {
  return problem_.wcet(xnode, type) + windows.paid[at(xnode)];
}

bool OneMachine::load(const Windows& windows, int type, int place) {
  by_r_.clear();
  for (int i = 0; i < problem_.num_xnodes; ++i)
    if (windows.types[at(i)] == TypeSet{1} << type && (place < 0 || windows.place[at(i)] == place))
      by_r_.push_back({i, windows.r[at(i)], windows.d[at(i)], work(windows, i, type)});
  by_d_ = by_r_;
  std::sort(by_r_.begin(), by_r_.end(), [](const Item& i, const Item& j) { return i.r < j.r; });
  std::sort(by_d_.begin(), by_d_.end(), [](const Item& i, const Item& j) { return i.d < j.d; });
  const std::size_t count = by_r_.size();
  for (auto* table : {&inside_, &done_, &due_}) table->resize(count * count);
  for (std::size_t a = 0; a < count; ++a) {
    Time sum = 0;
    for (std::size_t b = 0; b < count; ++b) {
      // Of several with the same d, the last one has the sum of all of them; less is true too.
      if (by_d_[b].r >= by_r_[a].r) sum += by_d_[b].work;
      if (sum > 0 && by_r_[a].r + sum > by_d_[b].d) return false;
      const std::size_t cell = a * count + b;
      inside_[cell] = sum;
      done_[cell] = std::max(a > 0 ? done_[cell - count] : 0, sum > 0 ? by_r_[a].r + sum : 0);
    }
    for (std::size_t b = count; b-- > 0;) {
      const std::size_t cell = a * count + b;
      due_[cell] = std::min(b + 1 < count ? due_[cell + 1] : kNever,
                            inside_[cell] > 0 ? by_d_[b].d - inside_[cell] : kNever);
    }
  }
  return true;
}

std::size_t OneMachine::first_by_r(Time time) const {
  const auto found = std::partition_point(by_r_.begin(), by_r_.end(),
                                          [&](const Item& item) { return item.r < time; });
  return static_cast<std::size_t>(found - by_r_.begin());
}

std::size_t OneMachine::first_by_d(Time time) const {
  const auto found = std::partition_point(by_d_.begin(), by_d_.end(),
                                          [&](const Item& item) { return item.d < time; });
  return static_cast<std::size_t>(found - by_d_.begin());
}

Time OneMachine::earliest_end(const Item& c) const {
  const std::size_t count = by_r_.size(), later = first_by_r(c.r + 1);  // c itself is before it
  for (std::size_t b = first_by_d(c.d); b-- > 0;) {
    const Time done = done_[(later - 1) * count + b];
    if (done > 0 && done + c.work > by_d_[b].d) return std::max(done, c.r) + c.work;
  }
  return c.r + c.work;
}

Time OneMachine::latest_start(const Item& c) const {
  const std::size_t count = by_r_.size(), b = first_by_d(c.d);
  for (std::size_t a = first_by_r(c.r + 1); a < count; ++a) {
    const Time due = due_[a * count + b];
    if (due < kNever && due - c.work < by_r_[a].r) return std::min(due, c.d) - c.work;
  }
  return c.d - c.work;
}

bool OneMachine::fits_beside(const Item& c) const {
  const std::size_t count = by_r_.size();
  const std::size_t own = first_by_r(c.r), later = first_by_r(c.r + 1);
  const std::size_t covered = first_by_d(c.d + 1);
  // To each d that is not before c's, and to c's own, which covers those up to it.
  for (std::size_t b = first_by_d(c.d); b < count + (covered > 0 ? 1 : 0); ++b) {
    const std::size_t to = b < count ? b : covered - 1;
    const Time end = b < count ? by_d_[b].d : c.d;
    if (own < count && c.r + inside_[own * count + to] + c.work > end) return false;
    if (later > 0 && done_[(later - 1) * count + to] + c.work > end) return false;
  }
  return true;
}

}  // namespace xauto::solver
