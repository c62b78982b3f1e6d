// SPDX-License-Identifier: Apache-2.0
// One XPU whose jobs are of one domain: earliest deadline first over its pattern, from an idle XPU until what is left at
// the end of a hyperperiod repeats. Jobs of the first activations that the real start lacks only make it harder.
#pragma once

#include <map>
#include <set>
#include <utility>
#include <vector>

#include "solver/keys/problem.h"

namespace xauto::solver::keys {

struct LaidJob {
  Tick arrival = 0;  ///< in [0, hyperperiod)
  Tick due = 0;
  Tick work = 0;
  Tick slack = 0;  ///< it has to be done by so much before `due`
  int xnode = -1;
};

/// Why jobs do not fit.
struct Misfit {
  enum class Kind { kOverload, kLate, kPilesUp } kind = Kind::kPilesUp;
  int xnode = -1;  ///< the one that is late
};

/// Half open, the beginnings in [0, hyperperiod): in between the XPU is idle, for no time at least.
using BusyIntervals = std::map<Tick, Tick>;

/// Whether each of the jobs, which get sorted, is done in time. `busy`: of hyperperiods that repeat; empty where they
/// have no idle instant.
[[nodiscard]] bool fits_alone(std::vector<LaidJob>& jobs, Tick hyper, Misfit* misfit = nullptr,
                              BusyIntervals* busy = nullptr);

/// A pattern that fits, of which jobs change. Where the XPU is idle both before a change and after it, all that follows
/// is as before: so only the busy intervals are looked at that a changed job is in.
class FittingAlone {
 public:
  using Jobs = std::vector<std::pair<int, LaidJob>>;  ///< each with its number

  /// `jobs` fit, and are numbered from 0.
  FittingAlone(Tick hyper, const Jobs& jobs);
  /// Whether all is in time if these become so. If so they have.
  [[nodiscard]] bool change(const Jobs& jobs);
  /// Takes the last change back, which was made.
  void undo();

 private:
  struct Span {
    Tick from, to;  ///< idle at both; of [0, hyper), but `from` may be below and `to` above
    std::vector<std::pair<Tick, Tick>> busy;
  };

  void put(const Jobs& jobs);
  [[nodiscard]] bool whole(BusyIntervals& busy) const;
  [[nodiscard]] bool around(Tick instant, Span& span) const;
  [[nodiscard]] Tick begin_of_busy(Tick instant) const;
  [[nodiscard]] Tick end_of_busy(Tick instant) const;
  void replace(const std::vector<Span>& spans);

  Tick hyper_;
  std::vector<LaidJob> jobs_;             ///< by number
  std::set<std::pair<Tick, int>> order_;  ///< by arrival
  BusyIntervals busy_;
  // The last change.
  Jobs were_;
  BusyIntervals gone_, come_;
};

}  // namespace xauto::solver::keys
