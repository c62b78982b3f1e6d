// SPDX-License-Identifier: Apache-2.0
// A change of tables on XPUs that do not preempt, where clocks share XPUs (docs/steady-state.md,
// theorem 10): who may be in the way, and what both tables leave beside that. Used by
// check_handover_shared.cc.
//
// Where the text leaves something open:
//
// - Demand in real time is counted job by job: from the begin of a window on, each other one ends
//   as soon as the clock allows for it alone.
// - G is of lengths at which B is above 0. At others both certificates say that it is 0.
// - g is added where D is above 0, as the proof needs.
// - Just after t_lo is the key of who may have it later than t_lo. One at t_lo has ended.
// - Who waits for whom is what follows through any number of others.
// - What is asked for of an XPU that clocks share is so for each activation by itself. What has its
//   window in the interval of who is not in time is above 0, and no longer than the interval.
// - What is asked for of an XPU of one clock: y is the key of a job that D(x, y) counts.
// - On an XPU of one clock one has to look w(L) further. With y earlier by H, what is in the way of
//   one activation may wait for the other one. From there on nothing that begins in time is left.
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
  int xnode = -1;
  Ticks release = 0;
  Ticks opens = 0;              ///< it does not start before
  Ticks alpha = 0;              ///< late
  Ticks key = 0, key_late = 0;  ///< early and late
  Ticks work = 0;
};

/// A job that others may be in the way of.
struct Hindered {
  int xnode = -1;
  Ticks release = 0;
  Ticks key = 0, key_late = 0;
  Ticks due = 0;  ///< the key, or later
};

/// Who waits for whom, under both tables and from one to the other.
class WhoWaits {
 public:
  explicit WhoWaits(const World& w) : w_(w), lags_(w.wcet.size()) {}
  /// `z`, of the same clock, does not start before `v` has ended.
  bool operator()(int z, Ticks release_of_z, int v, Ticks release_of_v) {
    if (w_.component_of[at(z)] != w_.component_of[at(v)]) return false;
    auto& lags = lags_[at(v)];
    if (lags.empty()) lags = w_.lags_after(v);
    const std::int64_t lag = lags[at(z)];
    return lag < kNever && (release_of_z - release_of_v) / w_.home(z).period >= lag;
  }

 private:
  const World& w_;
  std::vector<std::vector<std::int64_t>> lags_;  ///< [xnode], as asked for
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

/// B of real lengths.
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

/// Theorem 4's dbf of one clock in real time, up to `limit`. `all`: one hyperperiod's windows. False:
/// too many pairs.
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

/// A job of q that is in the way on an XPU that clocks share.
struct InTheWayOfQ {
  std::size_t clock = 0;
  Ticks reach = 0;                                       ///< d - e
  Ticks work = 0;                                        ///< its own
  Ticks of_its_own = 0;                                  ///< W: of its own clock, while it is
  auto operator<=>(const InTheWayOfQ&) const = default;  // NOLINT(modernize-use-nullptr)
};

/// A percentage of each length is left beside demand, and what is in the way. `demand`: of each
/// clock; `lag`: L.
inline bool leaves_beside(const std::vector<Stairs>& demand, const Stairs& of_all,
                          const std::vector<InTheWayOfQ>& in_the_way, Ticks lag, int percent,
                          std::int64_t& pairs) {
  return std::ranges::all_of(in_the_way, [&](const InTheWayOfQ& z) {
    for (const auto& [length, work] : of_all) {
      if (length >= z.reach + lag) break;
      if (--pairs < 0) return false;
      const Ticks own = stairs_at(demand[z.clock], length);
      const Ticks sum = work - own + std::min(own, z.of_its_own);
      if (sum > 0 && static_cast<__int128>(sum + z.work) * 100 >
                         static_cast<__int128>(length) * (100 - percent))
        return false;
    }
    return true;
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
  /// `all` by `opens`; `whom`: who may have its key at y, or its due; `lag`: w(L).
  BlocksOne(const std::vector<InTheWay>& all, const std::vector<const Hindered*>& whom,
            WhoWaits& waits, Ticks lag, Ticks y)
      : lag_(lag) {
    for (const InTheWay& z : all) {
      const bool hinders = std::ranges::any_of(whom, [&](const Hindered* v) {
        if (z.key_late <= (v->due > v->key ? v->key : y)) return false;
        return (z.xnode != v->xnode || z.release != v->release) &&
               !waits(z.xnode, z.release, v->xnode, v->release);
      });
      if (!hinders) continue;
      if (z.key > y)
        add(behind_, z.opens, z.work);
      else
        passed_.emplace_back(z.alpha, z.work);
    }
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

/// Whether jobs of one clock under one table leave a percentage beside what is in the way.
class OneLeaves {
 public:
  /// `all`: of one hyperperiod. `lag`: w(L); `depth`: D + 2b.
  OneLeaves(const std::vector<InTheWay>& all, WhoWaits& waits, Ticks hyperperiod, std::int64_t ppm,
            Ticks lag, Ticks depth)
      : all_(all), waits_(waits), hyperperiod_(hyperperiod), ppm_(ppm), lag_(lag), depth_(depth) {}

  bool operator()(int percent, std::int64_t& pairs) {
    __int128 turn = 0;
    for (const InTheWay& z : all_) turn += z.work;
    if (!fits(turn, hyperperiod_, percent)) return false;
    for (const InTheWay& first : all_) {
      const Ticks x = first.alpha;
      if (!collect(x, pairs)) return false;
      __int128 sum = 0;
      for (std::size_t k = 0; k < counted_.size(); ++k) {
        sum += counted_[k].work;
        const Ticks y = counted_[k].key;
        if (k + 1 < counted_.size() && counted_[k + 1].key == y) continue;
        if (!fits(sum + longest_at(k, pairs), y - x, percent)) return false;
      }
    }
    return true;
  }

 private:
  struct Candidate {
    InTheWay job;
    Ticks until = 0;  ///< in the way for an earlier y
  };

  [[nodiscard]] bool fits(__int128 work, Ticks length, int percent) const {
    return work * 100 <= static_cast<__int128>(least(length, ppm_)) * (100 - percent);
  }

  /// What D(x, y) counts for some y, and what may be in the way. False: too many.
  bool collect(Ticks x, std::int64_t& pairs) {
    const Ticks last = x + depth_ + 2 * hyperperiod_ + lag_;
    counted_.clear();
    candidates_.clear();
    for (const InTheWay& z : all_) {
      // What opens long before x has its key before it.
      Ticks base = floor_div(x - depth_ - z.opens, hyperperiod_) * hyperperiod_;
      for (; z.opens + base <= last; base += hyperperiod_) {
        if (--pairs < 0) return false;
        InTheWay job = z;
        for (Ticks* t : {&job.release, &job.opens, &job.alpha, &job.key, &job.key_late}) *t += base;
        const bool later = job.alpha >= x;
        if (later && job.key <= last) counted_.push_back(job);
        if (job.opens <= x + lag_) candidates_.push_back({job, later ? job.key : job.key_late});
      }
    }
    std::ranges::sort(counted_, {}, &InTheWay::key);
    std::ranges::sort(candidates_, std::greater<>(), [](const Candidate& z) { return z.job.work; });
    return true;
  }

  /// Of those that are in the way of a job that may have the key of counted_[k]. k only rises.
  Ticks longest_at(std::size_t k, std::int64_t& pairs) {
    const Ticks y = counted_[k].key;
    std::erase_if(candidates_, [&](const Candidate& z) { return z.until <= y; });
    for (const Candidate& z : candidates_)
      for (std::size_t v = k + 1; v-- > 0 && counted_[v].key + depth_ >= y;) {
        --pairs;
        if (counted_[v].key_late >= y &&
            !waits_(z.job.xnode, z.job.release, counted_[v].xnode, counted_[v].release))
          return z.job.work;
      }
    return 0;
  }

  const std::vector<InTheWay>& all_;
  WhoWaits& waits_;
  Ticks hyperperiod_;
  std::int64_t ppm_;
  Ticks lag_, depth_;
  std::vector<InTheWay> counted_;  ///< by key
  std::vector<Candidate> candidates_;
};

}  // namespace xauto::solver::steady::checking::shared
