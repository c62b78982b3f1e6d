// SPDX-License-Identifier: Apache-2.0
// Life of a job, between steps 3 and 4: its policy has it start at its planned start, at the latest, and it may start
// sooner where the reason for that has gone. docs/keys.md, "Early start", has the rule and its proof.
//
// The execution thread of a job that waits sleeps here, before START: coordinators know nothing of it. Who ends a job
// that others look at counts it, and looks whether anybody waits. If so, it asks the rule in his place, and wakes him
// if he may go; the woken one asks again. What was allowed once stays allowed: the first open activation of an XNode
// only moves on.
//
// The modules are in one process, and releases have the numbers of a grid. Where that is not so there is no early start
// in the run at all (`may_be`), and holds are waited for to their end. So they are on an XPU that other runs may use as
// well and where preempting costs: nobody here knows their keys to come. What we release ourselves comes when it is due.
// Of a sensor that publishes by itself the next releases are no sooner than its clock's tolerance allows, counted from
// the last one.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <vector>

#include <xauto/result.h>

#include "grid/context.h"
#include "grid/grid.h"
#include "model/app.h"
#include "model/early_start.h"
#include "model/platform.h"
#include "model/policy.h"
#include "runtime/urgency.h"

namespace xauto::runtime {

/// Whom the jobs of an XNode look at.
struct EarlyRule {
  /// The others on its XPU; none where taking it from another costs nothing.
  std::vector<int> mates;
  /// What it reads, and those on other XPUs that the plan keeps it apart from.
  std::vector<int> others;
  std::vector<int> all_of;  ///< of other clocks; Placement::reads_all
  bool never = false;       ///< it waits to the end
};

/// Of the first activation of an XNode that has not ended, at the earliest.
struct FirstOpen {
  std::int64_t release_ns = 0;  ///< nominal
  coord::Key key = 0;
};

/// A job that waits.
struct PlannedJob {
  coord::Key key = 0;
  std::int64_t start_ns = 0;
};

/// Whether it may start before its planned start. Pure; `first_open(xnode)` is a FirstOpen.
template <class Of>
[[nodiscard]] bool may_start_early(const EarlyRule& rule, const PlannedJob& job, Of first_open) {
  if (rule.never) return false;
  for (const int x : rule.mates)
    if (first_open(x).key <= job.key) return false;
  for (const int x : rule.others)
    if (first_open(x).key <= job.start_ns) return false;
  for (const int x : rule.all_of)
    if (first_open(x).release_ns < job.start_ns) return false;
  return true;
}

/// Threads: `due` and `released` one; the others any. No lock is taken, and no memory, after it was made.
class EarlyStart {
 public:
  /// Out of the session alone.
  [[nodiscard]] static bool may_be(const Context& context);
  /// Of a policy that validate() takes. `shared`: [XPU] other runs may use it, too.
  [[nodiscard]] static Result<std::unique_ptr<EarlyStart>> make(const AppSpec& app,
                                                                const Platform& platform,
                                                                const Policy& policy,
                                                                const std::vector<bool>& shared);

  /// What stands in the place of holds.
  [[nodiscard]] const PlannedStarts& planned_us() const { return planned_us_; }
  // `source`: of app.json. Until one of these is said nobody starts early who looks at its component.
  /// All its releases will be when they are due, the grid's begin being at `start_ns`.
  void due(std::size_t source, std::int64_t start_ns);
  /// Its release `n` counts as released at `nominal_ns`; its clock is not ours.
  void released(std::size_t source, std::uint64_t n, std::int64_t nominal_ns);
  /// Activations of the XNode up to `n` have ended, with what they publish, or will not come.
  void ended(std::size_t xnode, std::uint64_t n) {
    if (!lookers_[xnode].empty()) count(xnode, n + 1);
  }
  /// Returns at the planned start, or when the job of that XNode may start early. False: at once. One job of an XNode
  /// at a time: they go in order.
  bool wait(std::size_t xnode, const PlannedJob& job);
  [[nodiscard]] bool may_start(std::size_t xnode, const PlannedJob& job) const;

  /// Jobs that started early, and by how much in sum.
  struct Count {
    std::uint64_t jobs = 0;
    std::int64_t sum_ns = 0;
  };
  [[nodiscard]] Count count() const { return {early_.load(), early_ns_.load()}; }

 private:
  struct alignas(64) Releases {
    Grid::Source grid;
    std::int64_t shift_ns = 0;  ///< so much later than its component's activation
    std::int64_t ppm = 0;       ///< of its clock
    std::size_t clock = 0;
    // The last release that is known:
    std::atomic<std::uint32_t> writes{0};  ///< odd: one is being written; 0: none is known
    std::atomic<std::uint64_t> n{0};
    std::atomic<std::int64_t> nominal_ns{0};
    std::atomic<bool> exact{false};  ///< its clock is ours
  };
  struct alignas(64) Line {
    std::atomic<std::uint64_t> ended{0};  ///< activations
    std::atomic<std::uint32_t> waits{0};  ///< 1: a job does; a futex
    /// Of that job. Who wakes may see one of each of two jobs: the woken one knows better.
    std::atomic<coord::Key> key{0};
    std::atomic<std::int64_t> start_ns{0};
  };
  EarlyStart(std::size_t xnodes, std::size_t sources)
      : lines_(std::make_unique<Line[]>(xnodes)),
        releases_(std::make_unique<Releases[]>(sources)),
        num_sources_(sources) {}
  void write(Releases& of, std::uint64_t n, std::int64_t nominal_ns, bool exact);
  [[nodiscard]] std::int64_t drift_ns(const Releases& of, std::int64_t span_ns) const;
  [[nodiscard]] std::int64_t earliest_ns(const Releases& of, std::uint64_t n) const;
  [[nodiscard]] FirstOpen first_open(std::size_t xnode) const;
  void count(std::size_t xnode, std::uint64_t activations);

  PlannedStarts planned_us_;
  // By XNode:
  std::vector<std::vector<std::size_t>> sources_;  ///< of its component
  std::vector<Urgency> keys_;
  std::vector<EarlyRule> rules_;
  std::vector<std::vector<std::size_t>> lookers_;  ///< of which XNodes that wait it is in the rule
  std::unique_ptr<Line[]> lines_;
  std::unique_ptr<Releases[]> releases_;  ///< [source]
  std::size_t num_sources_;
  alignas(64) std::atomic<std::uint32_t> waiting_{0};  ///< jobs
  std::atomic<std::uint64_t> early_{0};
  std::atomic<std::int64_t> early_ns_{0};
};

}  // namespace xauto::runtime
