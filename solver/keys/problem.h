// SPDX-License-Identifier: Apache-2.0
// Problem: an app on a platform, as dense arrays. Everything in solver/keys reads it.
// Words and theory: docs/keys.md.
//
// Time is in ticks: a tick is 1 / `scale` us, so that every period is whole. Keys and holds are
// whole microseconds all the same, since files say them so.
//
// A job is (XNode i, activation n). The figures of an XNode repeat after `jobs[i]` activations, and
// are kept at slot[i] + n mod jobs[i], relative to the nominal release of the activation.
#pragma once

#include <cstdint>
#include <limits>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "base/index.h"
#include "model/app.h"
#include "model/demand.h"
#include "model/platform.h"
#include "solver/objectives.h"

namespace xauto::solver::keys {

using Tick = std::int64_t;
inline constexpr Tick kNoTick = -1;
/// No single time of an app is longer, so that sums along 2^13 XNodes fit 64 bits.
inline constexpr Tick kMostTicks = Tick{1} << 47;
/// No key after its release is longer, and no interval that is looked at.
inline constexpr Tick kMostKey = kMostTicks * 64, kForever = kMostTicks * 1024;
/// Above this many jobs a hyperperiod, the components of a clock are planned in groups, as if the
/// groups' clocks were different: safe, and weaker.
inline constexpr std::int64_t kMostJobs = 100'000;
inline constexpr std::int64_t kMostJobsOfGroup = 2'000;
/// Ways from a source to an XNode through samples, all chains together.
inline constexpr std::size_t kMostPaths = 4096;
/// Steps that the search for one chain's ways may take.
inline constexpr int kMostPathSteps = 1'000'000;

inline constexpr std::int64_t kMillion = 1'000'000;
/// Levels of an XPU that preempts without limit.
inline constexpr int kAnyLevels = std::numeric_limits<int>::max();

[[nodiscard]] constexpr Tick floor_div(Tick a, Tick b) {
  return a >= 0 ? a / b : -((-a + b - 1) / b);
}

/// XNodes joined by edges; it fires once per period.
struct Component {
  int domain = -1;
  Tick period = 0;
  Tick phase = 0;           ///< nominal release n is at phase + n * period
  int jobs = 1;             ///< hyperperiod / period
  int urgent_source = -1;   ///< whose releases may be urgent; -1: none
  Tick urgent_by = 0;       ///< then keys and holds move forward by so much
  Tick urgent_every = 0;    ///< least distance of two such releases, a multiple of the period
  std::vector<int> xnodes;  ///< in topological order
};

/// Components that keep their phases to each other.
struct Domain {
  int clock = 0;
  Tick hyper = 0;
  std::int64_t ppm = 0;
  std::int64_t jobs = 0;  ///< all XNodes together, per hyperperiod
  bool part = false;      ///< of a clock: `check` knows no phases where it shares an XPU
  std::vector<int> components;
  std::vector<int> xnodes;  ///< in topological order, by edges and order
};

struct Module {
  int component = -1;
  std::int64_t in_flight = 1;
  std::vector<int> xnodes, entries;
};

/// An edge, from the other end's view.
struct EdgeEnd {
  int xnode = -1;
  int transfer = -1;  ///< index into Problem::transfers, -1: none
};

/// One way of a chain: along edges, and through samples in this order.
struct Path {
  std::vector<int> samples;
  bool operator==(const Path&) const = default;
};

struct Chain {
  std::string name;
  int source = -1, to = -1;
  Tick deadline = kNoTick;
  std::int64_t weight = 1;
  /// What its worst case is measured in: its deadline; where only others have one, the largest of theirs; 1 where
  /// no chain has one.
  Tick by = 1;
  std::vector<Path> paths;
  Tick offset = 0;  ///< of the source
};

/// Jobs of another app, on one XPU (docs/keys.md, "Apps compose").
struct OtherSequence {
  int demand = 0;  ///< index into Beside::demands: who pays for whom in it has been charged
  DemandSequence of;
  Tick beside = 0;  ///< largest key - start in the other demands
};

/// What an XNode takes while jobs run on so many other XPUs of each type.
struct LoadedWcet {
  std::vector<int> load;  ///< [type]
  Tick wcet = 0;
};

struct Problem {
  int num_xnodes = 0, num_xpus = 0, num_types = 0;
  Tick scale = 1;  ///< ticks per microsecond
  std::vector<std::string> xnode_name, xpu_name, type_name, clock_name;
  std::vector<int> xpu_type;                ///< [xpu]
  std::vector<int> xpu_host;                ///< [xpu] whose clock its keys are read on
  std::vector<std::vector<int>> type_xpus;  ///< [type]
  std::vector<char> preemptive;             ///< [xpu]
  std::vector<int> levels;    ///< [xpu] so many jobs may have started at once; not preemptive: 1
  std::vector<Tick> preempt;  ///< [xpu] cost of starting by preempting
  /// XPUs of one type on which each XNode may be alike, whatever pins and forbids say of single ones.
  std::vector<std::vector<int>> place_xpus;  ///< [place]
  std::vector<int> xpu_place;                ///< [xpu]
  std::vector<Tick> wcet_flat;               ///< [xnode * num_xpus + xpu], kNoTick: not there
  std::vector<std::vector<int>> may_run;     ///< [xnode] XPUs, ascending
  bool contended = false;  ///< WCETs depend on who runs beside; wcet() is what it takes alone
  /// [xnode * num_types + type] The first is alone; some entry has as much as any load. Empty: it states none.
  std::vector<std::vector<LoadedWcet>> loaded;
  std::vector<std::vector<int>> groups;  ///< XNodes that share one XPU
  std::vector<int> group_of;             ///< [xnode], -1: none

  std::vector<Component> components;
  std::vector<Domain> domains;
  std::vector<Module> modules;
  std::vector<int> component_of, module_of;  ///< [xnode]; module_of -1: no limit applies
  /// [xnode] edges, and order pairs as edges without a transfer. Who hears of a source, and a chain's ways,
  /// are by edges alone.
  std::vector<std::vector<EdgeEnd>> pred, succ;
  std::vector<char> entry, root;             ///< [xnode]
  std::vector<Tick> root_ready;              ///< [root] largest of J + offset - phase
  std::vector<std::vector<Tick>> transfers;  ///< [from type * num_types + to type]
  std::vector<std::pair<int, int>> samples;  ///< (u, v)
  std::vector<Tick> sample_passes;           ///< [sample] for how long its result is on its way
  std::vector<char> reads;                   ///< [xnode] the second of some sample
  std::vector<char> urgent;                  ///< [xnode] hears of its component's urgent source
  bool any_urgent = false;
  std::vector<Chain> chains;
  bool deadlines = false;    ///< some chain has one
  std::vector<int> part_of;  ///< [xnode] components that order joins are one part
  std::vector<int> place;    ///< [xnode] among the XNodes of its part
  std::vector<std::vector<std::uint64_t>>
      reach;  ///< [xnode] bitset of places: who is behind it by `succ`

  std::vector<std::vector<OtherSequence>> others;  ///< [xpu]
  std::vector<Tick> others_longest;                ///< [xpu] largest key - start of a job
  std::vector<double> others_load;                 ///< [xpu] of its time, with the reserve
  int reserve_pct = 0;                             ///< of each XPU, for more others

  std::vector<int> slot;        ///< [xnode] the first of its jobs
  std::vector<int> jobs;        ///< [xnode] how many
  std::vector<int> slot_xnode;  ///< [slot]
  int num_slots = 0;

  [[nodiscard]] Tick wcet(int xnode, int xpu) const {
    return wcet_flat[at(xnode) * at(num_xpus) + at(xpu)];
  }
  /// The type, where it is one place; else the names of its XPUs.
  [[nodiscard]] std::string place_name(std::size_t at_place) const;
  /// Components whose activations of one number have one nominal release.
  [[nodiscard]] bool released_together(int one, int other) const {
    const Component &a = components[at(one)], &b = components[at(other)];
    return a.domain == b.domain && a.period == b.period && a.phase == b.phase;
  }
  [[nodiscard]] int domain_of(int xnode) const {
    return components[at(component_of[at(xnode)])].domain;
  }
  [[nodiscard]] Tick period_of(int xnode) const {
    return components[at(component_of[at(xnode)])].period;
  }
  /// By how much the keys of `xnode` move forward in an urgent release.
  [[nodiscard]] Tick urgent_by(int xnode) const {
    return urgent[at(xnode)] != 0 ? components[at(component_of[at(xnode)])].urgent_by : 0;
  }
  /// Of any activation, one before the first too.
  [[nodiscard]] std::size_t slot_of(int xnode, std::int64_t activation) const {
    const std::int64_t n = activation % jobs[at(xnode)];
    return static_cast<std::size_t>(slot[at(xnode)] + (n < 0 ? n + jobs[at(xnode)] : n));
  }
  [[nodiscard]] bool before(int a, int b) const {  ///< b waits for a, by edges and order
    return part_of[at(a)] == part_of[at(b)] &&
           ((reach[at(a)][at(place[at(b)] / 64)] >> (place[at(b)] % 64)) & 1U) != 0;
  }
  /// Their keys are read on one clock.
  [[nodiscard]] bool one_clock(int xpu, int other) const {
    return xpu_host[at(xpu)] == xpu_host[at(other)];
  }
  /// What the message of `link` costs from `from_xpu` to `to_xpu`.
  [[nodiscard]] Tick transfer(const EdgeEnd& link, int from_xpu, int to_xpu) const {
    if (link.transfer < 0) return 0;
    return transfers[at(link.transfer)]
                    [at(xpu_type[at(from_xpu)]) * at(num_types) + at(xpu_type[at(to_xpu)])];
  }
  [[nodiscard]] Tick up_to_us(Tick t) const {  ///< t >= 0: the next whole microsecond
    return scale == 1 ? t : (t + scale - 1) / scale * scale;
  }

  /// Whether others may be on the XPU.
  [[nodiscard]] bool beside_others(int xpu) const {
    return reserve_pct > 0 || !others[at(xpu)].empty();
  }
  /// Work as it is tested: with a reserve as much longer as there is less of the XPU. Rounded up.
  [[nodiscard]] Tick with_reserve(Tick work) const {
    return reserve_pct == 0 ? work : (work * 100 + 99 - reserve_pct) / (100 - reserve_pct);
  }
  /// The same of a job, which may pay for a preemption. With a reserve each does.
  [[nodiscard]] Tick tested_work(int xnode, int xpu, bool pays) const {
    return with_reserve(wcet(xnode, xpu) + (preemptive[at(xpu)] != 0 && (pays || reserve_pct > 0)
                                                ? preempt[at(xpu)]
                                                : 0));
  }
  /// Part of the XPU's time.
  [[nodiscard]] double load_of(int xnode, int xpu, bool pays) const {
    return static_cast<double>(tested_work(xnode, xpu, pays)) /
           static_cast<double>(period_of(xnode));
  }

  /// kInvalid: what `validate` refuses, times too long for 64 bits, too many
  /// ways for a chain, an order that is a cycle or of XNodes that are not released together; kInfeasible: pins and forbids leave
  /// nothing for an XNode. `order`: Policy::order, which the policies of this problem have.
  [[nodiscard]] static Result<Problem> create(const AppSpec& app, const Platform& platform,
                                              const Objectives& wishes = {},
                                              const std::vector<std::pair<int, int>>& order = {},
                                              const Beside& beside = {});
};

/// [xnode] on the XPU that is fastest for it; 0: it can run nowhere.
[[nodiscard]] std::vector<Tick> least_wcets(const Problem& problem);

/// ceil(t * 10^6 / (10^6 - ppm)) for t >= 0: how much of a clock's time `t` may take where the
/// clock is fast. t < 2^60.
[[nodiscard]] Tick in_fast_time(Tick t, std::int64_t ppm);
/// ceil(t * (10^6 + ppm) / 10^6) for t >= 0: how long `t` of a clock may last where it is slow.
[[nodiscard]] Tick in_slow_time(Tick t, std::int64_t ppm);

}  // namespace xauto::solver::keys
