// SPDX-License-Identifier: Apache-2.0
// A change of tables on XPUs that do not preempt, where clocks share XPUs (docs/steady-state.md, theorem
// 10): who may be in the way, and what both tables leave beside that. Used by check_handover_shared.cc.
//
// Where the text leaves something open:
//
// - Demand in real time is counted job by job: from the begin of a window on, each other one ends as
//   soon as the clock allows for it alone.
// - G is of lengths at which B is above 0. At others both certificates say that it is 0.
// - g is added where D is above 0, as the proof needs.
// - Just after t_lo κ is t_lo. Of several κ of one instant the least one leaves the most in the way.
#pragma once

#include <algorithm>
#include <cstdint>
#include <functional>
#include <utility>
#include <vector>

#include "solver/steady/check_handover_walk.h"
#include "solver/steady/check_world.h"

namespace xauto::solver::steady::checking::shared {

/// A job that may be in the way of others, in its clock's own time.
struct InTheWay {
  Ticks opens = 0;              ///< it does not start before
  Ticks alpha = 0;              ///< late
  Ticks key = 0, key_late = 0;  /// early and late
  Ticks work = 0;
};

/// Lengths, and a value from each on; both rise.
using Stairs = std::vector<std::pair<Ticks, Ticks>>;

inline Ticks stairs_at(const Stairs& stairs, Ticks length) {
  const auto after = std::ranges::upper_bound(stairs, length, {}, &std::pair<Ticks, Ticks>::first);
  return after == stairs.begin() ? 0 : std::prev(after)->second;
}

/// Values at their lengths, in any order: at each length the largest so far. Only steps that rise.
inline Stairs rising(Stairs steps) {
  std::ranges::sort(steps);
  std::size_t kept = 0;
  for (const auto& [length, work] : steps) {
    if (work <= (kept > 0 ? steps[kept - 1].second : 0)) continue;
    if (kept > 0 && steps[kept - 1].first == length) --kept;
    steps[kept++] = {length, work};
  }
  steps.resize(kept);
  return steps;
}

inline Stairs sum_of(const Stairs& a, const Stairs& b) {
  Stairs sum;
  for (std::size_t i = 0, j = 0; i < a.size() || j < b.size();) {
    const Ticks at_a = i < a.size() ? a[i].first : kNever;
    const Ticks at_b = j < b.size() ? b[j].first : kNever;
    i += at_a <= at_b;
    j += at_b <= at_a;
    sum.emplace_back(std::min(at_a, at_b),
                     (i > 0 ? a[i - 1].second : 0) + (j > 0 ? b[j - 1].second : 0));
  }
  return sum;
}

/// B of real lengths, or B_q.
class LongestInTheWay {
 public:
  /// `reach`: d - e. All are added before `sort`.
  void add(Ticks reach, Ticks work) { longest_.emplace_back(-reach, work); }
  /// `lag`: L + β.
  void sort(Ticks lag) {
    lag_ = lag;
    longest_ = rising(std::move(longest_));
  }
  [[nodiscard]] Ticks at(Ticks length) const { return stairs_at(longest_, lag_ - length - 1); }
  /// From there on it is 0.
  [[nodiscard]] Ticks end() const {
    return longest_.empty() ? -kNever : lag_ - longest_.front().first;
  }

 private:
  Stairs longest_;  ///< by -reach: those of at least a reach
  Ticks lag_ = 0;
};

/// What a window takes and leaves.
struct RealWindow {
  Ticks release = 0;  ///< in its clock's own time
  Ticks a = 0, d = 0;
  Ticks work = 0;
};

/// Theorem 4's dbf of one clock in real time, up to `limit`. `all`: one hyperperiod's windows. False: too
/// many pairs.
inline bool real_demand(const std::vector<RealWindow>& all, Ticks hyperperiod, std::int64_t ppm,
                        Ticks limit, std::int64_t& pairs, Stairs& demand) {
  const tables::Drift drift{ppm};
  Ticks deepest = 0;
  for (const RealWindow& w : all) deepest = std::max({deepest, w.d, w.a});
  Stairs steps, best;
  for (const RealWindow& first : all) {
    steps.clear();
    const Ticks from = first.release - drift.longest(deepest) - 1;
    const Ticks until = first.release + drift.longest(limit + deepest) + 1;
    for (const RealWindow& w : all) {
      Ticks release = w.release + ceil_div(from - w.release, hyperperiod) * hyperperiod;
      for (; release <= until; release += hyperperiod) {
        if (--pairs < 0) return false;
        const Ticks shift = release - first.release, later = w.a - first.a;
        if (most(shift, ppm) + later < 0) continue;
        const Ticks length = w.d - w.a + std::max<Ticks>(0, least(shift, ppm) + later);
        if (length <= limit) steps.emplace_back(length, w.work);
      }
    }
    std::ranges::sort(steps);
    Ticks sum = 0;
    for (auto& [length, work] : steps) work = sum += work;
    best.insert(best.end(), steps.begin(), steps.end());
    if (best.size() > 4096 && best.size() > 4 * demand.size()) {
      demand.insert(demand.end(), best.begin(), best.end());
      demand = rising(std::move(demand));
      best.clear();
    }
  }
  demand.insert(demand.end(), best.begin(), best.end());
  demand = rising(std::move(demand));
  return true;
}

/// A percentage of each length is left beside demand, and what is in the way.
inline bool leaves_beside(const Stairs& demand, const LongestInTheWay& of_q, int percent) {
  return std::ranges::all_of(demand, [&](const auto& step) {
    const Ticks longest = of_q.at(step.first);
    return longest == 0 || static_cast<__int128>(step.second + longest) * 100 <=
                               static_cast<__int128>(step.first) * (100 - percent);
  });
}

/// G: by how much demand, and what is in the way, may be more than a length, or than a longer one.
class Overrun {
 public:
  Overrun() = default;
  Overrun(Stairs demand, LongestInTheWay longest, int percent)
      : demand_(std::move(demand)),
        longest_(std::move(longest)),
        percent_(percent),
        largest_(kNever) {
    later_.assign(demand_.size() + 1, 0);
    for (std::size_t k = demand_.size(); k-- > 0;)
      later_[k] = std::max(later_[k + 1], of(demand_[k].second, demand_[k].first));
    largest_ = at(0);  // it falls
  }
  [[nodiscard]] Ticks at(Ticks length) const {
    if (largest_ == 0) return 0;
    const auto after =
        std::ranges::upper_bound(demand_, length, {}, &std::pair<Ticks, Ticks>::first);
    const Ticks work = after == demand_.begin() ? 0 : std::prev(after)->second;
    return std::max(of(work, length), later_[static_cast<std::size_t>(after - demand_.begin())]);
  }
  [[nodiscard]] Ticks largest() const { return largest_; }

 private:
  [[nodiscard]] Ticks of(Ticks work, Ticks length) const {
    const Ticks longest = longest_.at(length);
    if (longest == 0) return 0;
    return std::max<Ticks>(
        0, ceil_div(static_cast<__int128>(work + longest) * 100, 100 - percent_) - length);
  }

  Stairs demand_;
  LongestInTheWay longest_;
  int percent_ = 0;
  std::vector<Ticks> later_;  ///< the largest of all steps from that on
  Ticks largest_ = 0;
};

/// B(x, y) on an XPU of one clock, for one y and for x that fall from call to call.
class BlocksOne {
 public:
  /// `all` by `opens`; `lag`: w(L).
  BlocksOne(const std::vector<InTheWay>& all, Ticks lag, Ticks y, Ticks kappa) : lag_(lag) {
    for (const InTheWay& z : all)
      if (z.key > y)
        add(behind_, z.opens, z.work);
      else if (z.key_late > kappa)
        passed_.emplace_back(z.alpha, z.work);
    passed_ = rising(std::move(passed_));
  }
  /// Those with a key after y are in no D(x, y), others are from their α on.
  Ticks at(Ticks x) {
    while (!behind_.empty() && behind_.back().first > x + lag_) behind_.pop_back();
    while (!passed_.empty() && passed_.back().first >= x) passed_.pop_back();
    return std::max(behind_.empty() ? 0 : behind_.back().second,
                    passed_.empty() ? 0 : passed_.back().second);
  }

 private:
  static void add(Stairs& stairs, Ticks from, Ticks work) {
    if (stairs.empty() || work > stairs.back().second) stairs.emplace_back(from, work);
  }
  Ticks lag_;
  Stairs behind_, passed_;
};

/// Whether jobs of one clock under one table leave so much beside what is in the way. `all`: of one
/// hyperperiod. `lag`: w(L); `depth`: D + 2b.
inline bool one_leaves(const std::vector<InTheWay>& all, Ticks hyperperiod, std::int64_t ppm,
                       Ticks lag, Ticks depth, int percent, std::int64_t& pairs) {
  const auto fits = [&](__int128 work, Ticks length) {
    return work * 100 <= static_cast<__int128>(least(length, ppm)) * (100 - percent);
  };
  __int128 turn = 0;
  for (const InTheWay& z : all) turn += z.work;
  if (!fits(turn, hyperperiod)) return false;
  Stairs counted, threshold;
  for (const InTheWay& first : all) {
    const Ticks x = first.alpha, last = x + depth + 2 * hyperperiod;
    counted.clear();
    threshold.clear();
    for (const InTheWay& z : all) {
      // What opens long before x has its key before it.
      Ticks base = floor_div(x - depth - z.opens, hyperperiod) * hyperperiod;
      for (; z.opens + base <= std::max(last, x + lag); base += hyperperiod) {
        if (--pairs < 0) return false;
        const bool later = z.alpha + base >= x;
        if (later && z.key + base <= last) counted.emplace_back(z.key + base, z.work);
        if (z.opens + base <= x + lag)
          threshold.emplace_back((later ? z.key : z.key_late) + base, z.work);
      }
    }
    std::ranges::sort(counted);
    // By thresholds from the last one on: the longest that is still in the way.
    std::ranges::sort(threshold, std::greater<>());
    Ticks longest = 0;
    for (auto& step : threshold) step.second = longest = std::max(longest, step.second);
    __int128 sum = 0;
    for (std::size_t k = 0; k < counted.size(); ++k) {
      sum += counted[k].second;
      const Ticks y = counted[k].first;
      if (k + 1 < counted.size() && counted[k + 1].first == y) continue;
      while (!threshold.empty() && threshold.back().first <= y) threshold.pop_back();
      const Ticks longest_left = threshold.empty() ? 0 : threshold.back().second;
      if (!fits(sum + longest_left, y - x)) return false;
    }
  }
  return true;
}

}  // namespace xauto::solver::steady::checking::shared
