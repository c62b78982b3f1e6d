// SPDX-License-Identifier: Apache-2.0
// Life of a job, step 11: each release is accounted for once, as a latency or as lost; and what a
// run has to tell of it.
#pragma once

#include <atomic>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include "account/routes.h"
#include "base/pi_mutex.h"
#include "grid/context.h"
#include "processes/role.h"
#include "session/limits.h"
#include "session/run_report.h"

namespace xauto::runtime {

/// Threads: any, apart from what says otherwise.
class Ledger {
 public:
  Ledger(const Context& context, Routes routes, Role& role);

  /// A release of the sensors is about to be published. The releasing thread.
  void open(std::uint64_t sequence, std::int64_t origin_ns);
  /// ... of `source`, which has that number and that nominal instant. The releasing thread.
  void released(std::size_t source, std::uint64_t sequence, std::int64_t origin_ns);
  /// Activation `sequence` of `module`, hosted here, has ended. `origins`, `urgent`: see Envelope.
  void done(int module, std::int64_t origin_ns, std::uint64_t sequence,
            const detail::Origins* origins, bool urgent);
  /// `node` of the graph has ended its job, and a chain with it.
  void passed(int node, std::int64_t origin_ns, std::uint64_t sequence,
              const detail::Origins* origins, bool urgent);
  /// ... or was lost for `reason` (XAUTO_DROP_*).
  void dropped(int module, std::uint64_t sequence, std::uint32_t reason);
  /// A sink of its table, or a module where a chain ends, is through with release `sequence`; known here, or
  /// told by its process.
  /// `origin_ns` of what is lost: detail::kOffNs where it is no loss, since the module is off, or skips as it was
  /// told.
  void through(int module, std::uint64_t sequence, std::int64_t origin_ns,
               const detail::Origins* origins, std::int64_t now_ns, bool lost, bool urgent);
  /// Whether a chain ends at `node` of the graph.
  [[nodiscard]] bool ends_chain(int node) const { return routes_.end_at(node); }
  /// The process of `module` died; what it counted and did not tell is lost.
  void forget(int module);

  /// One rate: until every release is accounted for, and `idle` says that no message is on its way.
  /// Several: there is nothing to count by, so until no module has an activation in flight or has
  /// ended one for 100 ms. False: nothing has moved for 10 s. The releasing thread, or `run`'s.
  [[nodiscard]] bool wait_drained(const std::function<bool()>& idle);
  /// Of the releases of an app of one rate.
  [[nodiscard]] bool all_ended() const { return in_flight_.load() == 0; }
  /// `wait_drained` has waited in vain, and no job is ended any more: what has no result is counted as such.
  /// `waiting`: [module] messages that wait for those that are hosted here. The thread of `run`.
  void give_up(const std::vector<std::size_t>& waiting);
  /// After that: of which modules how many, for people.
  [[nodiscard]] std::string what_did_not_end() const;

  /// By tables: what is nominally released at `from_ns` or later has that of `scenario`. `across_us`: [chain] as
  /// Handover::worst_case_us, what that may cost whoever meets it, until `settled_ns`. Where it claims nothing of a
  /// chain (null: of any), nothing is claimed of that one any more. `met`: which change of the run it is. The
  /// releasing thread.
  void claim_change(std::int64_t from_ns, std::int64_t settled_ns, std::size_t scenario,
                    const std::vector<std::optional<std::int64_t>>* across_us,
                    const MetChange& met);
  /// What has ended is held against what is claimed by now. The releasing thread; at the end that of the report.
  void judge_claims() { routes_.judge(); }

  /// What met changes of the scenario; see Routes.
  [[nodiscard]] std::vector<Routes::Met> met() const { return routes_.met(); }

  /// Adds counts, latencies, chains and what is claimed of them.
  void report(const std::vector<std::vector<Limits>>& limits, RunReport& into);

 private:
  /// A release that some sinks are not yet through with.
  struct Open {
    std::int64_t origin_ns = 0, last_ns = 0;
    int sinks_left = 0;
    bool lost = false;
    bool ended = false;  ///< some sink had a result
  };
  /// Latencies of a sink; the counts are on the board.
  struct Latencies {
    std::atomic<std::uint64_t> told{0};  ///< results that were heard of here; one writer at a time
    PiMutex mutex;
    Distribution us XAUTO_GUARDED_BY(mutex);
  };

  /// Of a source: what was released so far. Of the releasing thread, then of `run`'s.
  struct Released {
    std::uint64_t next = 0;  ///< number of the next one
    std::int64_t newest_ns = 0;
  };

  void show_claims();
  [[nodiscard]] std::uint64_t released_for(std::size_t module) const;
  void tell_claims(Account& into) const;
  [[nodiscard]] Claimed claimed() const;
  [[nodiscard]] std::int64_t more_pct() const;
  [[nodiscard]] std::vector<std::int64_t> claimed_by(std::size_t scenario) const;
  void tell_chains(std::int64_t from_ns, std::size_t scenario);
  void account(int module, std::uint64_t sequence, std::int64_t now_ns, bool lost, bool off);
  /// Whether its results are told to who keeps the accounts.
  [[nodiscard]] bool asked_for(int module) const {
    return asked_for_[static_cast<std::size_t>(module)] != 0;
  }
  void missed(int module, std::uint64_t sequence, std::int64_t latency_us);
  [[nodiscard]] bool is_sink(std::size_t module) const { return sinks_[module] != 0; }
  [[nodiscard]] bool settled() const;
  [[nodiscard]] bool wait_quiet();

  const Context& context_;
  Routes routes_;
  Role& role_;
  std::vector<std::unique_ptr<Latencies>> latencies_;  ///< [module]
  std::vector<char> asked_for_;                        ///< [module]
  std::vector<char> ends_releases_;                    ///< [module] a sink of some table
  const std::vector<char> sinks_;                      ///< [module]
  std::vector<char> unproven_;  ///< [chain] by tables: a change was not certified
  int num_sinks_ = 0;
  std::uint64_t num_released_ = 0;           ///< one rate; of the releasing thread, then of `run`'s
  std::atomic<std::uint32_t> in_flight_{0};  ///< one rate: releases not accounted for; a futex
  std::vector<Released> released_;           ///< [source]
  std::int64_t gave_up_ns_ = 0;              ///< 0: it did not
  std::vector<std::uint64_t> unended_, released_for_;  ///< [module] then; released: 0: not known

  /// Written once per release and sink, not per job.
  mutable PiMutex mutex_;
  std::deque<ReleaseRecord> releases_ XAUTO_GUARDED_BY(mutex_);  ///< the last kKeptReleases
  std::uint64_t num_releases_ XAUTO_GUARDED_BY(mutex_) = 0, lost_releases_
                                                            XAUTO_GUARDED_BY(mutex_) = 0;
  Distribution latencies_us_ XAUTO_GUARDED_BY(mutex_);
  std::deque<Open> open_
      XAUTO_GUARDED_BY(mutex_);  ///< from open_base_ on; those before are accounted for
  std::uint64_t open_base_ XAUTO_GUARDED_BY(mutex_) = 0;  ///< a sequence
  std::vector<std::uint64_t> sink_next_
      XAUTO_GUARDED_BY(mutex_);  ///< [module] one rate: the next release to account for
};

}  // namespace xauto::runtime
