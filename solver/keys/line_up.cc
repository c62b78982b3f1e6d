// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/line_up.h"

#include <algorithm>
#include <numeric>

namespace xauto::solver::keys {
namespace {

// Chosen, not tuned.
constexpr double kFullyLoaded = 0.95;    ///< of an XPU's time: nothing more is put there
constexpr std::int64_t kMostAgain = 64;  ///< later releases of a component that are planned with
/// What no chain waits for is put in before the plan has passed this part of its period.
constexpr int kPartOfPeriod = 2;

}  // namespace

LineUp::LineUp(const Problem& p)
    : p_(p),
      on_chain_(p.components.size()),
      rest_(p.components.size()),
      tail_(at(p.num_xnodes), 0) {
  const std::vector<Tick> least = least_wcets(p);
  for (const Domain& d : p.domains)
    for (auto i = d.xnodes.rbegin(); i != d.xnodes.rend(); ++i)
      for (const EdgeEnd& s : p.succ[at(*i)])
        tail_[at(*i)] = std::max(tail_[at(*i)], tail_[at(s.xnode)] + least[at(s.xnode)]);
  rate_.assign(at(p.num_xnodes) * at(p.num_xpus), 0);
  for (int i = 0; i < p.num_xnodes; ++i)
    for (const int m : p.may_run[at(i)])
      rate_[at(i) * at(p.num_xpus) + at(m)] =
          static_cast<double>(p.wcet(i, m)) / static_cast<double>(p.period_of(i));

  // The scarce types first; or those where preemption is free.
  std::vector<int> types(at(p.num_types));
  std::iota(types.begin(), types.end(), 0);
  std::stable_sort(types.begin(), types.end(), [&](int a, int b) {
    return p.type_xpus[at(a)].size() < p.type_xpus[at(b)].size();
  });
  for (auto* owns : {&owns_, &owns_free_}) {
    owns->assign(p.domains.size() * at(p.num_xpus), 0);
    std::vector<char> served(at(p.num_xnodes), 0);
    for (const int t : types) share_out(t, *owns, served);
    std::stable_partition(types.begin(), types.end(),
                          [&](int t) { return splits(p.type_xpus[at(t)].front()); });
  }

  std::vector<char> waited_for(at(p.num_xnodes), 0);
  std::vector<double> weight(p.components.size(), 0), work(p.components.size(), 0);
  for (const Chain& chain : p.chains) {
    std::vector<std::size_t> heeds;
    const auto add = [&](int to) {
      const std::size_t c = at(p.component_of[at(to)]);
      if (std::find(heeds.begin(), heeds.end(), c) == heeds.end()) heeds.push_back(c);
      for (const int i : p.components[c].xnodes)
        if (i == to || p.before(i, to)) waited_for[at(i)] = 1;
    };
    add(chain.to);
    for (const Path& path : chain.paths)
      for (const int s : path.samples) add(p.samples[at(s)].first);
    for (const std::size_t c : heeds)
      weight[c] += static_cast<double>(chain.weight) / static_cast<double>(chain.by);
  }
  for (std::size_t c = 0; c < p.components.size(); ++c) {
    for (const int i : p.components[c].xnodes) {
      (waited_for[at(i)] != 0 ? on_chain_ : rest_)[c].push_back(i);
      if (waited_for[at(i)] != 0) work[c] += static_cast<double>(least[at(i)]);
    }
    for (auto* xnodes : {&on_chain_[c], &rest_[c]})
      std::stable_sort(xnodes->begin(), xnodes->end(), [&](int a, int b) {
        return tail_[at(a)] + least[at(a)] > tail_[at(b)] + least[at(b)];
      });
    horizon_ = std::max(horizon_, p.components[c].phase + p.components[c].period);
  }
  const auto period = [&](int c) { return p.components[at(c)].period; };
  by_weight_.resize(p.components.size());
  std::iota(by_weight_.begin(), by_weight_.end(), 0);
  std::stable_sort(by_weight_.begin(), by_weight_.end(),
                   [&](int a, int b) { return period(a) < period(b); });
  std::vector<double> first(p.components.size(), 0);
  for (std::size_t c = 0; c < first.size(); ++c)
    if (work[c] > 0) first[c] = weight[c] / work[c];
  std::stable_sort(by_weight_.begin(), by_weight_.end(),
                   [&](int a, int b) { return first[at(a)] > first[at(b)]; });
  by_period_ = by_weight_;
  std::stable_sort(by_period_.begin(), by_period_.end(),
                   [&](int a, int b) { return period(a) < period(b); });
}

/// Gives the XPUs of a type to the domains: one to each that cannot do without, then to those that have most work for
/// each. What is served there asks for no other type.
void LineUp::share_out(int type, std::vector<char>& owns, std::vector<char>& served) const {
  const std::vector<int>& xpus = p_.type_xpus[at(type)];
  const std::size_t domains = p_.domains.size(), all = at(p_.num_xpus);
  std::vector<double> asked(domains, 0);
  std::vector<char> needs(domains, 0);
  const auto rate_there = [&](int i) {
    for (const int m : p_.may_run[at(i)])
      if (p_.xpu_type[at(m)] == type) return rate_[at(i) * all + at(m)];
    return -1.0;
  };
  for (int i = 0; i < p_.num_xnodes; ++i) {
    if (served[at(i)] != 0 || rate_there(i) < 0) continue;
    const std::size_t d = at(p_.domain_of(i));
    asked[d] += rate_there(i);
    const auto& may = p_.may_run[at(i)];
    if (std::all_of(may.begin(), may.end(), [&](int m) { return p_.xpu_type[at(m)] == type; }))
      needs[d] = 1;
  }
  std::vector<int> given(domains, 0);
  const auto first = [&](std::size_t d) {
    return needs[d] != 0 && given[d] == 0 ? asked[d] + static_cast<double>(xpus.size()) + 1
                                          : asked[d] / (given[d] + 1);
  };
  for (const int m : xpus) {
    std::size_t best = 0;
    for (std::size_t d = 1; d < domains; ++d)
      if (first(d) > first(best)) best = d;
    ++given[best];
    owns[best * all + at(m)] = 1;
  }
  // Who cannot do without, and has none, shares them.
  for (std::size_t d = 0; d < domains; ++d)
    for (const int m : xpus)
      if (needs[d] != 0 && given[d] == 0) owns[d * all + at(m)] = 1;
  std::vector<double> load(domains, 0);
  for (int i = 0; i < p_.num_xnodes; ++i) {
    const std::size_t d = at(p_.domain_of(i));
    const double rate = rate_there(i);
    if (served[at(i)] != 0 || rate < 0 || load[d] + rate > kFullyLoaded * given[d]) continue;
    const bool fastest = std::all_of(p_.may_run[at(i)].begin(), p_.may_run[at(i)].end(),
                                     [&](int m) { return rate_[at(i) * all + at(m)] >= rate; });
    if (!fastest) continue;
    load[d] += rate;
    served[at(i)] = 1;
  }
}

/// Whether work may go on there after others: at no cost.
bool LineUp::splits(int m) const {
  return p_.preemptive[at(m)] != 0 && p_.preempt[at(m)] == 0 && p_.levels[at(m)] == kAnyLevels;
}

Tick LineUp::end_of(int m, Tick from, Tick work) const {
  const std::vector<Busy>& busy = busy_[at(m)];
  const bool any_gap = splits(m);
  auto next = std::upper_bound(busy.begin(), busy.end(), from,
                               [](Tick t, const Busy& b) { return t < b.end; });
  for (; next != busy.end(); ++next) {
    const Tick gap = std::max(Tick{0}, next->begin - from);
    if (gap >= work) break;
    if (any_gap) work -= gap;
    from = next->end;
  }
  return from + work;
}

void LineUp::take(int m, Tick from, Tick work) {
  std::vector<Busy>& busy = busy_[at(m)];
  const bool any_gap = splits(m);
  auto next = std::upper_bound(busy.begin(), busy.end(), from,
                               [](Tick t, const Busy& b) { return t < b.end; });
  while (next != busy.end()) {
    const Tick gap = std::max(Tick{0}, next->begin - from);
    if (gap >= work) break;
    if (any_gap && gap > 0) {
      // All of the gap: it, and what is on both sides, is one.
      work -= gap;
      next->begin = from;
      if (next != busy.begin() && std::prev(next)->end == from) {
        std::prev(next)->end = next->end;
        next = std::prev(busy.erase(next));
      }
    }
    from = next->end;
    ++next;
  }
  const Tick end = from + work;
  const bool joins_next = next != busy.end() && next->begin == end;
  if (next != busy.begin() && std::prev(next)->end == from) {
    std::prev(next)->end = joins_next ? next->end : end;
    if (joins_next) busy.erase(next);
  } else if (joins_next) {
    next->begin = from;
  } else {
    busy.insert(next, {from, end});
  }
}

void LineUp::place(int i) {
  if (xpu_[at(i)] >= 0) return;
  const Component& c = p_.components[at(p_.component_of[at(i)])];
  const auto ready_on = [&](int m) {
    Tick ready =
        c.phase + std::max((*hold_)[at(i)], p_.root[at(i)] != 0 ? p_.root_ready[at(i)] : Tick{0});
    for (const EdgeEnd& link : p_.pred[at(i)])
      if (xpu_[at(link.xnode)] >= 0)
        ready = std::max(ready, end_[at(link.xnode)] + p_.transfer(link, xpu_[at(link.xnode)], m));
    return ready;
  };
  const auto load_with = [&](int m) {
    return load_[at(m)] + rate_[at(i) * at(p_.num_xpus) + at(m)];
  };
  int best = -1;
  Tick best_end = 0;
  bool best_full = false;
  const int group = p_.group_of[at(i)];
  const std::vector<int>& may = p_.may_run[at(i)];
  Where where = where_;
  const std::vector<char>& owns = where.free ? owns_free_ : owns_;
  const auto allowed = [&](int m) {
    return (!where.apart || owns[at(c.domain) * at(p_.num_xpus) + at(m)] != 0) &&
           (!where.free || splits(m));
  };
  if (std::none_of(may.begin(), may.end(), allowed)) where.free = false;
  if (std::none_of(may.begin(), may.end(), allowed)) where.apart = false;
  const auto suits = [&](int m) {  // its group
    return group < 0 || std::ranges::all_of(p_.groups[at(group)], [&](int j) {
             return p_.wcet(j, m) != kNoTick && (xpu_[at(j)] < 0 || xpu_[at(j)] == m);
           });
  };
  for (const int m : may) {
    if (!allowed(m) || !suits(m)) continue;
    const bool full = load_with(m) > kFullyLoaded;
    const Tick end = end_of(m, ready_on(m), p_.wcet(i, m));
    if (best >= 0) {
      if (full != best_full) {
        if (full) continue;
      } else if (full ? load_with(m) >= load_with(best)
                      : (end != best_end ? end > best_end : load_with(m) >= load_with(best))) {
        continue;
      }
    }
    best = m;
    best_end = end;
    best_full = full;
  }
  if (best < 0) {  // a group goes before XPUs of its clock's own
    const auto any = std::ranges::find_if(may, suits);
    best = any == may.end() ? may.front() : *any;
  }
  const Tick work = p_.wcet(i, best), ready = ready_on(best);
  end_[at(i)] = end_of(best, ready, work);
  xpu_[at(i)] = best;
  load_[at(best)] = load_with(best);
  for (std::int64_t n = 0; n < kMostAgain && (n == 0 || n * c.period < horizon_); ++n)
    take(best, ready + n * c.period, work);
}

void LineUp::place_all(const std::vector<int>& xnodes) {
  for (const int i : xnodes) place(i);
}

LineUp::Value LineUp::plan(const std::vector<int>& order, const std::vector<Tick>& hold,
                           const Where& where) {
  hold_ = &hold;
  where_ = where;
  busy_.assign(at(p_.num_xpus), {});
  load_.assign(at(p_.num_xpus), 0);
  xpu_.assign(at(p_.num_xnodes), -1);
  end_.assign(at(p_.num_xnodes), 0);
  key_.assign(at(p_.num_xnodes), 0);
  // What no chain waits for still has to be done by its period.
  auto next = by_period_.begin();
  const auto place_next = [&] {
    place_all(on_chain_[at(*next)]);
    place_all(rest_[at(*next)]);
    ++next;
  };
  Tick latest = 0;
  for (const int c : order) {
    const auto is_time = [&] {
      const Component& waits = p_.components[at(*next)];
      return latest >= waits.phase + waits.period / kPartOfPeriod;
    };
    while (next != by_period_.end() && is_time()) place_next();
    place_all(on_chain_[at(c)]);
    for (const int i : on_chain_[at(c)]) latest = std::max(latest, end_[at(i)]);
  }
  while (next != by_period_.end()) place_next();
  for (std::size_t c = 0; c < p_.components.size(); ++c) {
    const Component& component = p_.components[c];
    for (const int i : on_chain_[c]) key_[at(i)] = end_[at(i)] - component.phase;
    for (const int i : rest_[c])
      key_[at(i)] = std::max(end_[at(i)] - component.phase, component.period - tail_[at(i)]);
  }
  Value value;
  for (const Chain& chain : p_.chains) {
    const double part =
        static_cast<double>(end_[at(chain.to)] - chain.offset) / static_cast<double>(chain.by);
    value.sum += static_cast<double>(chain.weight) * part;
    if ((p_.deadlines && chain.deadline == kNoTick) || part <= value.largest) continue;
    value.largest = part;
    value.last = p_.component_of[at(chain.to)];
  }
  return value;
}

}  // namespace xauto::solver::keys
