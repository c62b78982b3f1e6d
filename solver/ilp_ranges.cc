// SPDX-License-Identifier: Apache-2.0
// See ilp_ranges.h.
#include "solver/ilp_ranges.h"

#include <algorithm>
#include <bit>

#include "base/index.h"

namespace xauto::solver {
namespace {

std::uint64_t bit(int i) {
  return std::uint64_t{1} << i;
}

void raise(Time& value, Time to, bool& changed) {
  if (to <= value) return;
  value = to;
  changed = true;
}
void lower(Time& value, Time to, bool& changed) {
  if (to >= value) return;
  value = to;
  changed = true;
}

}  // namespace

IlpRanges::IlpRanges(const Problem& problem) : p_(problem), behind_(at(problem.num_xnodes), 0) {
  for (auto it = p_.topo.rbegin(); it != p_.topo.rend(); ++it)
    for (const int s : p_.succ[at(*it)]) behind_[at(*it)] |= bit(s) | behind_[at(s)];
  const auto alike = [this](int x, int y) {
    if (p_.xpu_type[at(x)] != p_.xpu_type[at(y)]) return false;
    for (int i = 0; i < p_.num_xnodes; ++i)
      if (p_.wcet_on(i, x) != p_.wcet_on(i, y)) return false;
    return true;
  };
  for (int x = 0; x < p_.num_xpus; ++x) {
    const auto same = std::find_if(classes_.begin(), classes_.end(),
                                   [&](const auto& c) { return alike(c.front(), x); });
    if (same == classes_.end())
      classes_.push_back({x});
    else
      same->push_back(x);
  }
}

Time IlpRanges::wcet(int xnode, int of_class) const {
  return p_.wcet_on(xnode, classes_[at(of_class)].front());
}

bool IlpRanges::before(int i, int j) const {
  return (behind_[at(i)] & bit(j)) != 0;
}

int IlpRanges::class_of(const IlpNode& node, int i) const {
  const std::uint64_t left = node.classes[at(i)];
  return std::has_single_bit(left) ? std::countr_zero(left) : -1;
}

bool IlpRanges::meet(const IlpNode& node, int i, int j) {
  return node.r[at(i)] < node.d[at(j)] && node.r[at(j)] < node.d[at(i)];
}

Time IlpRanges::energy(const IlpNode& node, int i, int of_class, Time a, Time b) const {
  const Time early = std::max<Time>(0, a - node.r[at(i)]),
             late = std::max<Time>(0, node.d[at(i)] - b);
  return std::clamp<Time>(wcet(i, of_class) - early - late, 0, b - a);
}

IlpNode IlpRanges::root(Time horizon) const {
  const std::size_t n = at(p_.num_xnodes);
  IlpNode node;
  node.r.assign(n, 0);
  node.e = node.r;
  node.l.assign(n, horizon);
  node.d = node.l;
  node.classes.assign(n, 0);
  node.place.assign(n, -1);
  node.no_later.assign(n, 0);
  for (int i = 0; i < p_.num_xnodes; ++i)
    for (std::size_t c = 0; c < classes_.size(); ++c)
      if (wcet(i, static_cast<int>(c)) != kCannotRun) node.classes[at(i)] |= std::uint64_t{1} << c;
  return node;
}

bool IlpRanges::follow_edges(IlpNode& node) const {
  const auto least = [&](int i) {
    Time shortest = -1;
    for (std::uint64_t left = node.classes[at(i)]; left != 0; left &= left - 1) {
      const Time w = wcet(i, std::countr_zero(left));
      if (shortest < 0 || w < shortest) shortest = w;
    }
    return shortest;
  };
  for (const int i : p_.topo) {
    for (const int j : p_.pred[at(i)]) node.r[at(i)] = std::max(node.r[at(i)], node.e[at(j)]);
    node.e[at(i)] = std::max(node.e[at(i)], node.r[at(i)] + least(i));
  }
  for (auto it = p_.topo.rbegin(); it != p_.topo.rend(); ++it) {
    const std::size_t i = at(*it);
    for (const int j : p_.succ[i]) node.d[i] = std::min(node.d[i], node.l[at(j)]);
    node.l[i] = std::min(node.l[i], node.d[i] - least(*it));
    if (node.r[i] > node.l[i] || node.e[i] > node.d[i]) return false;
  }
  return true;
}

/// What is certain to be within [a, b] fits, and of who does not fit beside it the range shrinks.
bool IlpRanges::narrow_window(IlpNode& node, const std::vector<int>& on, int of_class, Time a,
                              Time b, bool& changed) const {
  Time energies = 0, whole = 0;
  for (const int k : on) {
    energies += energy(node, k, of_class, a, b);
    if (node.r[at(k)] >= a && node.d[at(k)] <= b) whole += wcet(k, of_class);
  }
  if (energies > b - a) return false;
  for (const int k : on) {
    const bool after = node.r[at(k)] >= a, ahead = node.d[at(k)] <= b;
    if (after == ahead || whole + wcet(k, of_class) <= b - a) continue;
    if (after)
      raise(node.e[at(k)], a + whole + wcet(k, of_class), changed);
    else
      lower(node.l[at(k)], b - whole - wcet(k, of_class), changed);
  }
  return true;
}

/// b of pairs: what the ranges decide, what follows from two others, and what it says of finishes.
bool IlpRanges::narrow_pairs(IlpNode& node, const std::vector<int>& on, int of_class,
                             bool& changed) const {
  for (const int i : on)
    for (const int k : on) {
      if (i == k || (node.no_later[at(k)] & bit(i)) != 0 || (node.no_later[at(i)] & bit(k)) != 0)
        continue;
      // k before i: then i ends when both are done.
      const Time both =
          std::min(node.r[at(i)], node.r[at(k)]) + wcet(i, of_class) + wcet(k, of_class);
      const bool not_later = before(i, k) || node.e[at(k)] >= node.d[at(i)] ||
                             std::max(both, node.e[at(k)]) > node.d[at(i)];
      if (!not_later) continue;
      node.no_later[at(k)] |= bit(i);
      changed = true;
    }
  for (const int m : on)
    for (const int k : on)
      if ((node.no_later[at(k)] & bit(m)) != 0 &&
          (node.no_later[at(m)] & ~node.no_later[at(k)]) != 0) {
        node.no_later[at(k)] |= node.no_later[at(m)];
        changed = true;
      }
  for (const int k : on) {
    const std::uint64_t all = node.no_later[at(k)] | bit(k);
    if ((node.no_later[at(k)] & bit(k)) != 0) return false;  // each finishes after the other
    for (const int i : on) {
      if ((all & bit(i)) == 0) continue;
      const Time a = node.r[at(i)];
      Time end = a;
      for (const int j : on)
        if ((all & bit(j)) != 0 && node.r[at(j)] >= a) end += wcet(j, of_class);
      raise(node.e[at(k)], end, changed);
      if (i == k) continue;
      raise(node.e[at(k)], node.e[at(i)], changed);
      lower(node.d[at(i)], node.d[at(k)], changed);
    }
    if (node.e[at(k)] > node.d[at(k)]) return false;
  }
  return true;
}

bool IlpRanges::narrow_instance(IlpNode& node, const std::vector<int>& on, int of_class,
                                bool& changed) const {
  for (const int i : on)
    for (const int j : on) {
      const Time a = node.r[at(i)], b = node.d[at(j)];
      if (a < b && !narrow_window(node, on, of_class, a, b, changed)) return false;
    }
  return narrow_pairs(node, on, of_class, changed);
}

bool IlpRanges::class_fits(const IlpNode& node, int of_class) const {
  std::vector<int> on;
  for (int i = 0; i < p_.num_xnodes; ++i)
    if (class_of(node, i) == of_class) on.push_back(i);
  const Time instances = static_cast<Time>(classes_[at(of_class)].size());
  for (const int i : on)
    for (const int j : on) {
      const Time a = node.r[at(i)], b = node.d[at(j)];
      if (a >= b) continue;
      Time energies = 0;
      for (const int k : on) energies += energy(node, k, of_class, a, b);
      if (energies > (b - a) * instances) return false;
    }
  return true;
}

bool IlpRanges::tighten(IlpNode& node, Time horizon) {
  for (Time& d : node.d) d = std::min(d, horizon);
  std::vector<int> on;
  for (bool changed = true; changed;) {
    changed = false;
    if (!follow_edges(node)) return false;
    for (int i = 0; i < p_.num_xnodes; ++i) {
      for (std::uint64_t left = node.classes[at(i)]; left != 0; left &= left - 1) {
        const int c = std::countr_zero(left);
        if (node.r[at(i)] + wcet(i, c) <= node.d[at(i)]) continue;
        node.classes[at(i)] &= ~(std::uint64_t{1} << c);
        changed = true;
      }
      if (node.classes[at(i)] == 0) return false;
      const int c = class_of(node, i);
      if (c >= 0 && node.place[at(i)] < 0 && classes_[at(c)].size() == 1)
        node.place[at(i)] = classes_[at(c)].front();
    }
    for (std::size_t c = 0; c < classes_.size(); ++c) {
      for (const int x : classes_[c]) {
        on.clear();
        for (int i = 0; i < p_.num_xnodes; ++i)
          if (node.place[at(i)] == x) on.push_back(i);
        if (!narrow_instance(node, on, static_cast<int>(c), changed)) return false;
      }
      if (classes_[c].size() > 1 && !class_fits(node, static_cast<int>(c))) return false;
    }
  }
  return true;
}

}  // namespace xauto::solver
