// SPDX-License-Identifier: Apache-2.0
// A change of tables where clocks share XPUs. The words are those of docs/steady-state.md, theorem 10:
// how much later than their keys the jobs of each clock may end is a function of time that rises at
// keys; those of a cluster's clocks add up. For the jobs on an XPU only that XPU counts, and those that
// feed it: a *set*, R(m). Each set has functions of its own, from the same jobs.
//
// Where the text leaves something open, or says too little, this is what is done:
//
// - M is no less than what the α of a job of q is after S, if that is later than its `a`.
// - Between which keys of one clock the key of another falls is open. So λ also rises just after t_lo,
//   by what the jobs with keys up to then have in excess, and on a shared XPU an x may be just before
//   S + M. Where all that is counted is of q, q's certificate bounds it, if shares are not of p
//   alone. So it is with the third kind, too: such jobs have windows that begin at S or later.
// - A job of q *waits* if what it waits for of p, directly or through others, may be later than its
//   `a`, whatever the clock does: also where its α is no more than `a`, taken late.
// - An x counts for a y only if it is an α of the same XPU, and its job's key is not after y: such
//   are the x' of the proof.
// - What has its key at t_lo has ended in time, as t is after t_lo.
// - What is in the way on an XPU that does not preempt: see check_handover_blocking.h.
// - When all is over: see `settle` and `find_slope`. M and τ are the whole cluster's, for each set.
// - Edges are between activations of one release, so of one table: of p and q together are modules, and
//   an XNode that moves.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "base/index.h"
#include "solver/steady/check_handover_walk.h"
#include "solver/steady/check_world.h"

namespace xauto::solver::steady::checking::shared {

using tables::Both;
using tables::Drift;

/// λ of a clock and a set.
struct Lambda {
  std::vector<std::pair<Ticks, Ticks>> rises;  ///< from then on so much; both rise
  [[nodiscard]] Ticks at(Ticks instant) const;
  [[nodiscard]] Ticks largest() const { return rises.empty() ? 0 : rises.back().second; }
};

/// Of a clock around one S.
struct Lateness {
  Ticks change = 0;  ///< S
  Ticks before = 0;  ///< the release that precedes it
  Ticks low = 0;     ///< t_lo
  /// [XNode, n] δ of those jobs of q for which it is after the key.
  std::map<std::pair<int, std::int64_t>, Ticks> dues;
  std::vector<Lambda> lambdas;  ///< [set]
};

struct OfClock {
  int clock = -1;
  Ticks hyperperiod = 0;  ///< of both tables; 0: it does not fit
  std::vector<Lateness> changes;
  std::vector<Ticks> largest;  ///< [set] Λ, in real time
};

struct Cluster {
  std::vector<OfClock> clocks;
  std::vector<std::vector<int>> sets;  ///< all R(m), each once: their XPUs
  std::vector<std::size_t> set_of;     ///< [xpu]; of those that the cluster uses
  Ticks settles = 0;                   ///< in real time
  std::string why;                     ///< nothing follows
  [[nodiscard]] Ticks largest_of_others(std::size_t k, std::size_t set) const;
};

/// What is asked of both tables, beside `both`.
struct Question {
  const Both& both;
  /// Windows of p or q were rounded to coarser ticks, `a` to the earlier one.
  bool coarse = false;
  Ticks notice = 0;  ///< in real time
};

/// Clocks that share XPUs, in p or in q, directly or through others; only those of two or more.
[[nodiscard]] std::vector<std::vector<int>> clusters(const Both& both);

/// σ in percent that both tables leave on all XPUs, preemptions of all jobs paid; 0: none.
[[nodiscard]] int slack_percent(const Question& ask);

/// The sets, and λ and Λ of each clock of `of`, whose clocks and hyperperiods are given. `pairs` (x, y)
/// may be looked at: it is counted down.
void bound_cluster(const Question& ask, int percent, std::int64_t& pairs, Cluster& of);

/// One clock around one S as a tables::Walk: who has ended by when.
class Around {
 public:
  Around(const Both& both, const Cluster& cluster, std::size_t k, const Lateness& lateness);
  [[nodiscard]] const Drift& drift() const { return drift_; }
  [[nodiscard]] Ticks release(int xnode, std::int64_t n) const {
    const Component& c = both_.p.home(xnode);
    return c.phi + n * c.period;
  }
  [[nodiscard]] bool of_q(int xnode, std::int64_t n) const {
    return release(xnode, n) >= lateness_.change;
  }
  [[nodiscard]] const Window& window(int xnode, std::int64_t n) const {
    return both_.of(of_q(xnode, n)).window(xnode, n);
  }
  [[nodiscard]] bool in_u(int xnode, std::int64_t n) const {
    return of_q(xnode, n) || key(xnode, n) > lateness_.low;
  }
  /// What is released later has been looked at one hyperperiod before.
  [[nodiscard]] Ticks last() const { return last_; }
  [[nodiscard]] bool ends_by_key(int xnode, std::int64_t n) const {
    return !lateness_.dues.contains({xnode, n}) && late(xnode, n, key(xnode, n)) == 0;
  }
  [[nodiscard]] Ticks end(int xnode, std::int64_t n) const {
    if (const auto due = lateness_.dues.find({xnode, n}); due != lateness_.dues.end())
      return due->second + drift_.longest(late(xnode, n, due->second));
    return release(xnode, n) + drift_.late(window(xnode, n).d + late(xnode, n, key(xnode, n)));
  }
  [[nodiscard]] Ticks starts(int xnode, std::int64_t n) const {
    return release(xnode, n) + drift_.soon(window(xnode, n).e);
  }

 private:
  [[nodiscard]] Ticks key(int xnode, std::int64_t n) const {
    return release(xnode, n) + drift_.late(window(xnode, n).d);
  }
  /// By how much after `due`, its δ; in real time.
  [[nodiscard]] Ticks late(int xnode, std::int64_t n, Ticks due) const {
    if (!in_u(xnode, n)) return 0;
    const int xpu = both_.of(of_q(xnode, n)).policy.placements[at(xnode)].xpu;
    const std::size_t set = set_of_[at(xpu)];
    return lateness_.lambdas[set].at(due) + others_[set];
  }

  const Both& both_;
  const std::vector<std::size_t>& set_of_;
  const Lateness& lateness_;
  Drift drift_;
  std::vector<Ticks> others_;  ///< [set] Λ of the other clocks
  Ticks last_ = 0;
};

}  // namespace xauto::solver::steady::checking::shared
