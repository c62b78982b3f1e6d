// SPDX-License-Identifier: Apache-2.0
// See rules.h.
#include "solver/rules.h"

#include <algorithm>
#include <bit>

#include "base/index.h"
#include "solver/evaluate.h"

namespace xauto::solver {
namespace {

bool raise(Time& value, Time to) {
  if (to <= value) return false;
  value = to;
  return true;
}

bool lower(Time& value, Time to) {
  if (to >= value) return false;
  value = to;
  return true;
}

}  // namespace

Rules::Rules(const Problem& problem)
    : problem_(problem), n_(problem.num_xnodes), settled_(at(n_) * at(n_), 0) {
  for (const auto& xpus : problem.type_xpus) {
    all_pay_.push_back(std::ranges::all_of(
        xpus, [&](int x) { return !problem.preemptive[at(x)] || problem.levels[at(x)] > 0; }));
    for (const int x : xpus)
      uniform_ = uniform_ && (problem.levels[at(x)] == 0 || problem.levels[at(x)] > n_) &&
                 problem.levels[at(x)] == problem.levels[at(xpus.front())] &&
                 problem.preemptive[at(x)] == problem.preemptive[at(xpus.front())] &&
                 problem.preempt[at(x)] == problem.preempt[at(xpus.front())];
  }
  uniform_ =
      uniform_ && problem.groups.empty() &&
      std::find(problem.wcet_flat.begin(), problem.wcet_flat.end(), 0) == problem.wcet_flat.end() &&
      std::find_if(problem.forbidden.begin(), problem.forbidden.end(),
                   [](char forbidden) { return forbidden != 0; }) == problem.forbidden.end();
}

bool Rules::tighten(Windows& w) const {
  bool again = true;
  while (again) {
    again = false;
    for (int i : problem_.topo) {
      Time& r = w.r[at(i)];
      for (int p : problem_.pred[at(i)]) r = std::max(r, w.r[at(p)] + least(w, p));
    }
    for (std::size_t k = problem_.topo.size(); k-- > 0;) {
      const int i = problem_.topo[k];
      Time& d = w.d[at(i)];
      for (int s : problem_.succ[at(i)]) d = std::min(d, w.d[at(s)] - least(w, s));
    }
    for (const auto& [i, j] : w.arcs) {
      again |= raise(w.r[at(j)], w.r[at(i)] + least(w, i));
      again |= lower(w.d[at(i)], w.d[at(j)] - least(w, j));
    }
    for (const auto& [i, j] : w.nested) {
      again |= raise(w.r[at(j)], w.r[at(i)] + 1);
      again |= lower(w.d[at(j)], w.d[at(i)] - 1);
    }
    for (int i = 0; i < n_; ++i) {
      TypeSet& types = w.types[at(i)];
      for (int t = 0; t < problem_.num_types; ++t) {
        if ((types >> t & 1u) == 0 ||
            w.r[at(i)] + problem_.wcet(i, t) + w.extra[at(i)] <= w.d[at(i)])
          continue;
        types &= ~(TypeSet{1} << t);
        again = true;
      }
      if (types == 0) return false;
    }
  }
  return true;
}

Time Rules::least(const Windows& w, int i) const {
  Time least = kNever;
  for (TypeSet types = w.types[at(i)]; types != 0; types &= types - 1)
    least = std::min(least, problem_.wcet(i, std::countr_zero(types)));
  return least + w.extra[at(i)];
}

bool Rules::share(const Windows& w, int i, int j) const {
  if (!std::has_single_bit(w.types[at(i)]) || w.types[at(i)] != w.types[at(j)]) return false;
  if (problem_.type_xpus[at(std::countr_zero(w.types[at(i)]))].size() == 1) return true;
  return w.place[at(i)] >= 0 && w.place[at(i)] == w.place[at(j)];
}

Time Rules::suspension(int type) const {
  Time least = -1;
  for (const int x : problem_.type_xpus[at(type)])
    if (problem_.preemptive[at(x)] && (least < 0 || problem_.preempt[at(x)] < least))
      least = problem_.preempt[at(x)];
  return least;
}

unsigned Rules::relations(const Windows& w, int i, int j, int type) const {
  const Time wi = problem_.wcet(i, type), wj = problem_.wcet(j, type);
  const Time di = wi + w.extra[at(i)], dj = wj + w.extra[at(j)];
  unsigned possible = 0;
  if (w.r[at(i)] + di + dj <= w.d[at(j)]) possible |= kFirst;
  if (w.r[at(j)] + di + dj <= w.d[at(i)]) possible |= kSecond;
  const Time cost = suspension(type);
  if (cost < 0) return possible;
  if (may_come_late(w, i, j, type) && w.r[at(i)] + di + wj + cost - w.cut[at(i)] <= w.d[at(i)] &&
      std::max(w.r[at(i)] + 1, w.r[at(j)]) + dj < w.d[at(i)] && w.r[at(i)] + 1 + dj <= w.d[at(j)])
    possible |= kInFirst;
  if (may_come_late(w, j, i, type) && w.r[at(j)] + dj + wi + cost - w.cut[at(j)] <= w.d[at(j)] &&
      std::max(w.r[at(j)] + 1, w.r[at(i)]) + di < w.d[at(j)] && w.r[at(j)] + 1 + di <= w.d[at(i)])
    possible |= kInSecond;
  return possible;
}

bool Rules::may_come_late(const Windows& w, int outer, int inner, int type) const {
  if (latest_ready(w, inner) > w.r[at(outer)]) return true;
  const Time work = problem_.wcet(inner, type);
  const Time room = w.d[at(outer)] - w.r[at(outer)] - problem_.wcet(outer, type) - work;
  for (int k = 0; k < n_; ++k) {
    if (k == outer || k == inner || (w.types[at(k)] >> type & 1u) == 0) continue;
    const Time first = problem_.wcet(k, type);
    if (latest_ready(w, k) > w.r[at(outer)] && first <= room &&
        std::max(w.r[at(outer)] + 1, w.r[at(k)]) + first + work + w.extra[at(inner)] <=
            w.d[at(inner)])
      return true;
  }
  return false;
}

Time Rules::latest_ready(const Windows& w, int i) const {
  Time latest = 0;
  for (int p : problem_.pred[at(i)]) latest = std::max(latest, w.d[at(p)]);
  return latest;
}

void Rules::relate(Windows& w, int i, int j, int type, Relation relation) const {
  const Time cost = suspension(type);
  switch (relation) {
    case kFirst:
      w.arcs.emplace_back(i, j);
      break;
    case kSecond:
      w.arcs.emplace_back(j, i);
      break;
    case kInFirst:
      nest(w, i, j, type, cost);
      break;
    case kInSecond:
      nest(w, j, i, type, cost);
      break;
  }
}

void Rules::nest(Windows& w, int outer, int inner, int type, Time cost) const {
  w.nested.emplace_back(outer, inner);
  w.extra[at(outer)] += problem_.wcet(inner, type) + cost - w.cut[at(outer)];
  if (all_pay_[at(type)] == 0) {
    w.paid[at(outer)] += cost - w.cut[at(outer)];
    w.cut[at(outer)] = cost;
  } else if (w.starter[at(inner)] == 0) {
    w.starter[at(inner)] = 1;
    w.extra[at(inner)] += cost;
    w.paid[at(inner)] += cost;
  }
}

bool Rules::may_share(const Windows& w, int i, int j) const {
  if ((w.types[at(i)] & w.types[at(j)]) == 0) return false;
  if (w.place[at(i)] >= 0 && w.place[at(j)] >= 0 && w.place[at(i)] != w.place[at(j)]) return false;
  return w.r[at(i)] < w.d[at(j)] && w.r[at(j)] < w.d[at(i)];
}

bool Rules::charge_starters(Windows& w) const {
  if (w.nested.empty()) return false;
  mark_settled(w, 1);
  const bool changed = charge_marked(w);
  mark_settled(w, 0);
  return changed;
}

bool Rules::charge_marked(Windows& w) const {
  bool changed = false;
  for (int outer = 0; outer < n_; ++outer) {
    if (w.cut[at(outer)] == 0) continue;
    const int type = std::countr_zero(w.types[at(outer)]);
    bool open = false;
    for (int i = 0; i < n_ && !open; ++i)
      open = i != outer && may_share(w, outer, i) && !settled(i, outer) &&
             (relations(w, outer, i, type) & kInFirst) != 0;
    if (open) continue;
    const Time cost = w.cut[at(outer)];
    Time within = 0;
    bool first_known = false;
    for (const auto& [o, i] : w.nested) {
      if (o != outer) continue;
      within += problem_.wcet(i, type);
      bool first = true, pays = true;
      for (const auto& [o2, k] : w.nested) {
        if (o2 != outer || k == i || starts_before(w, i, k)) continue;
        first = false;  // k starts earlier, or may
        pays = pays && w.d[at(k)] < w.r[at(i)];
      }
      if (pays && w.starter[at(i)] == 0) {
        w.starter[at(i)] = 1;
        w.extra[at(i)] += cost;
        w.paid[at(i)] += cost;
        changed = true;
      }
      first_known = first_known || first;
      if (w.starter[at(i)] == 0) continue;
      within += cost;
      // It has started the moment it was ready, and only what is nested in it delays its end.
      Time end = latest_ready(w, i) + problem_.wcet(i, type) + cost;
      for (const auto& [o2, k] : w.nested)
        if (o2 == i) end += problem_.wcet(k, type) + cost;
      changed |= lower(w.d[at(i)], end);
    }
    if (!first_known) continue;
    // The XPU's loss now counts with those that suspend.
    w.paid[at(outer)] = w.starter[at(outer)] != 0 ? cost : 0;
    changed |= raise(w.extra[at(outer)], within + (w.starter[at(outer)] != 0 ? cost : 0));
  }
  return changed;
}

bool Rules::end_as_ready(Windows& w) const {
  if (!uniform_) return false;
  end_.assign(at(n_), -1);
  pays_.assign(at(n_), 0);
  mark_settled(w, 1);
  bool any = false;
  for (int i = 0; i < n_; ++i) {
    if (!std::has_single_bit(w.types[at(i)])) continue;
    bool known =
        w.place[at(i)] >= 0 || problem_.type_xpus[at(std::countr_zero(w.types[at(i)]))].size() == 1;
    for (int k = 0; k < n_ && known; ++k)
      if (k != i && may_share(w, i, k) && !settled(i, k)) {
        const unsigned possible = relations(w, i, k, std::countr_zero(w.types[at(i)]));
        known = (possible & (kSecond | kInFirst)) == 0;
        pays_[at(i)] = pays_[at(i)] != 0 || (possible & kInSecond) != 0;
      }
    if (!known) continue;
    any = true;
    end_[at(i)] = std::max(w.r[at(i)], latest_ready(w, i));
  }
  mark_settled(w, 0);
  if (!any) return false;
  for (const auto& [i, j] : w.arcs)
    if (end_[at(j)] >= 0) end_[at(j)] = std::max(end_[at(j)], w.d[at(i)]);
  for (const auto& [outer, i] : w.nested) {
    const int type = std::countr_zero(w.types[at(i)]);
    const Time cost = suspension(type);
    pays_[at(i)] = 1;
    if (end_[at(outer)] >= 0) end_[at(outer)] += problem_.wcet(i, type) + cost;
  }
  bool changed = false;
  for (int i = 0; i < n_; ++i) {
    if (end_[at(i)] < 0) continue;
    const int type = std::countr_zero(w.types[at(i)]);
    // Once, however many it is nested in.
    const Time own = problem_.wcet(i, type) + (pays_[at(i)] != 0 ? suspension(type) : 0);
    changed |= lower(w.d[at(i)], end_[at(i)] + own);
  }
  return changed;
}

bool Rules::starts_before(const Windows& w, int k, int i) const {
  if (w.d[at(k)] <= w.r[at(i)]) return true;
  const auto has = [&](const std::vector<std::pair<int, int>>& list) {
    return std::find(list.begin(), list.end(), std::pair(k, i)) != list.end();
  };
  return has(w.arcs) || has(w.nested);
}

bool Rules::settle_pairs(Windows& w, int& open_i, int& open_j) const {
  mark_settled(w, 1);
  const bool possible = settle_marked(w, open_i, open_j);
  mark_settled(w, 0);
  return possible;
}

bool Rules::settle_marked(Windows& w, int& open_i, int& open_j) const {
  bool again = true;
  while (again) {
    again = false;
    open_i = open_j = -1;
    Time tightest = kNever;
    for (int i = 0; i < n_; ++i) {
      if (!std::has_single_bit(w.types[at(i)])) continue;
      const int type = std::countr_zero(w.types[at(i)]);
      for (int j = i + 1; j < n_; ++j) {
        if (!share(w, i, j)) continue;
        if (w.r[at(j)] >= w.d[at(i)] || w.r[at(i)] >= w.d[at(j)]) continue;
        if (settled_[at(i) * at(n_) + at(j)] != 0) continue;
        const unsigned possible = relations(w, i, j, type);
        if (possible == 0) return false;
        if (std::has_single_bit(possible)) {
          relate(w, i, j, type, static_cast<Relation>(possible));
          settled_[at(i) * at(n_) + at(j)] = 1;
          if (!tighten(w)) return false;
          again = true;
          continue;
        }
        const Time room = std::max(w.d[at(i)], w.d[at(j)]) - std::min(w.r[at(i)], w.r[at(j)]) -
                          problem_.wcet(i, type) - problem_.wcet(j, type);
        if (room < tightest) {
          tightest = room;
          open_i = i;
          open_j = j;
        }
      }
    }
  }
  return true;
}

void Rules::mark_settled(const Windows& w, char as) const {
  for (const auto* list : {&w.arcs, &w.nested})
    for (const auto& [i, j] : *list)
      settled_[at(std::min(i, j)) * at(n_) + at(std::max(i, j))] = as;
}

void Rules::ready_by(Windows& w, int i, Time t) const {
  for (int p : problem_.pred[at(i)]) w.d[at(p)] = std::min(w.d[at(p)], t);
}

void Rules::done_by_others(Windows& w, int i, Time t) const {
  for (int s : problem_.succ[at(i)]) w.r[at(s)] = std::max(w.r[at(s)], t);
}

}  // namespace xauto::solver
