// SPDX-License-Identifier: Apache-2.0
// Chains, end to end: from a sensor's topic to a module that reads it directly or through others.
//
//   origin k ──────────► publish k                       latency of k, counted against deadline_us
//   origin k ──────────────────────────► publish k+1     age of k when it is replaced, the oldest
//                                                        that the chain's result ever gets;
//                                                        counted against max_age_us
//
// "Publish" is the end of the module's chain of XNodes. With sensors of several periods a result
// has one origin per sensor (Envelope::origins), so every chain has latencies of its own.
#pragma once

#include <cstdint>
#include <deque>
#include <optional>
#include <vector>

#include <xauto/result.h>

#include "base/pi_mutex.h"
#include "graph/graph.h"
#include "grid/grid.h"
#include "model/deployment.h"
#include "session/account.h"

namespace xauto::runtime {

class Board;
struct FlowLine;

/// A change of the scenario of which something is claimed.
struct MetChange {
  std::uint64_t number = 0;  ///< in the order of the run's changes of the scenario
  std::uint32_t from = 0, to = 0;
};

// In a run a chain is app.json's, and its latency is the reduced reaction time that
// its worst case is about: from the nominal release k to the end of the first job that knows k or a
// newer one. Each release counts, also those that a result has skipped. Where a chain leads through
// samples, the first that comes is not counted, nor are those before it: a reader that starts for the
// first time may have been late for it, and no worst case is about that (docs/keys.md). Which
// releases there were is told here as they happen: no period is asked, since a sensor may not keep it.
//
// In lockstep the next release comes when the last one has drained. A result of the newest release took
// as long as it says. One that waited for another release waited for us, and measures nothing: it is
// counted, without a time.

/// Threads: any.
class Routes {
 public:
  /// In a run app.json's chains, at most kMaxChains of them; then the
  /// deployment's; without any, every sensor to every sink, with the app's deadline. Errors: a chain
  /// from a topic that is no sensor's, or to a module that cannot hear of it.
  [[nodiscard]] static Result<Routes> make(const Graph& graph, const Grid& grid,
                                           const Deployment& deployment, const AppSpec& app);

  [[nodiscard]] std::size_t size() const { return routes_.size(); }
  /// Counts on the board from here on, too: chain i is flow i + 1. `grid`: null where releases do
  /// not come by periods.
  void show_on(Board& board, const Grid* grid = nullptr);
  /// [module] Chains that end in others end on another host, which counts them. Before the run.
  void end_here(const std::vector<char>& modules);
  /// Whether it does.
  [[nodiscard]] bool ends_here(std::size_t chain) const { return routes_[chain].here; }
  /// Each release waits for the one before. Before the run.
  void in_lockstep() { lockstep_ = true; }
  /// `source` is about to release what has a message; one after the other.
  void released(std::size_t source, std::int64_t origin_ns);
  /// Whether a chain ends at `node` of the graph.
  [[nodiscard]] bool end_at(int node) const {
    return !ends_[static_cast<std::size_t>(node)].empty();
  }
  /// `node` has ended a job of what stems from `origin_ns`, or by source from `origins`. Returns the
  /// latency of a chain that so missed its deadline, or the age of a result that became too old.
  std::optional<std::int64_t> published(int node, std::int64_t origin_ns,
                                        const detail::Origins* origins, std::int64_t now_ns,
                                        bool urgent = false);
  /// What the policy claims of a chain, and what a result may take, with the emulator's own part; before the run.
  /// 0: nothing; `allowed_us` also where each release has a claim of its own.
  struct Claim {
    std::int64_t worst_case_us = 0, lower_bound_us = 0, allowed_us = 0;
    std::int64_t urgent_worst_case_us = 0, urgent_allowed_us = 0;
  };
  void show_claim(std::size_t chain, const Claim& claim);
  /// Releases of the chains' sources from `from_ns` on, until that of the next call, are said to take at
  /// most so long (us, by chain; 0: nothing is claimed), and may take `more_pct` more. At most kKeptClaims
  /// calls are remembered. `change`: these releases meet it.
  void claim(std::int64_t from_ns, std::vector<std::int64_t> claimed_us, std::int64_t more_pct = 0,
             std::optional<MetChange> change = {});
  /// From here on claims may change after a result has come, which is then judged late. Before the run.
  void claims_may_change() { may_change_ = true; }
  /// Holds what has ended since the last call against the claims that are there by now: a job that was too long may
  /// have been known to be only after its result. Without claims nothing waits.
  void judge();
  /// Of the results that met a change, the nearest to its claim.
  struct Met {
    std::uint64_t change = 0;
    std::size_t chain = 0;
    std::int64_t us = 0, claimed_us = 0;
  };
  /// By changes; of the last kKeptSwitches that something met.
  [[nodiscard]] std::vector<Met> met() const;
  /// Activations released at `from_ns` or later, until that of the next call, are of a table that has these
  /// chains (by chain). A release in whose table a chain is off, or whose result waited while it was off,
  /// counts for nothing there. At most kKeptClaims calls are remembered; none: all are always there.
  void have(std::int64_t from_ns, std::vector<char> chains);
  /// What a run that gave up has left without a result.
  struct Unended {
    std::int64_t at_ns = 0;                ///< when it did
    std::vector<std::uint64_t> of_module;  ///< activations
  };
  /// `lost`: [module] activations that failed or were dropped. `unended`: null: nothing was left. `newest_ns`: [source]
  /// its last release; 0: none.
  [[nodiscard]] std::vector<ChainAccount> report(
      const std::vector<std::uint64_t>& lost, const Unended* unended = nullptr,
      const std::vector<std::int64_t>& newest_ns = {}) const;

 private:
  struct Route {
    ChainAccount counts;
    int module = -1;         ///< of the node where it ends
    std::size_t source = 0;  ///< index into Origins; beyond it: the oldest origin
    std::int64_t last_origin_ns = 0;
    bool through_samples = false;
    std::int64_t shift_ns = 0;   ///< of the source's releases against its component's
    std::int64_t period_ns = 0;  ///< of the source, where each of its releases counts; 0: results
    std::deque<std::int64_t> unknown = {};  ///< releases of the source that no result knows yet
    FlowLine* line = nullptr;               ///< null: nobody looks
    std::int64_t urgent_allowed_us = 0;
    bool here = true;      ///< it ends on this host
    bool hurries = false;  ///< an urgent activation of its end is of an urgent release
  };
  void add(const Graph& graph, const Grid& grid, ChainAccount counts, std::size_t source, int node);
  void take_chains(const Graph& graph, const Grid& grid, const AppSpec& app);
  [[nodiscard]] Status take_chain(const Graph& graph, const Grid& grid,
                                  const ChainDeployment& chain);
  void take_all(const Graph& graph, const Grid& grid, std::int64_t deadline_us);
  void count(Route& route, std::int64_t origin_ns, std::int64_t now_ns,
             std::optional<std::int64_t>& missed_us);
  struct Claims {
    std::int64_t from_ns = 0;
    std::vector<std::int64_t> claimed_us;  ///< [chain]
    std::int64_t more_pct = 0;
    std::optional<MetChange> change = {};
  };
  /// What waits for judge().
  struct Ended {
    std::size_t chain = 0;
    std::int64_t origin_ns = 0, us = 0;
  };
  void judge(const Ended& ended);
  void meet(const Claims& claims, std::size_t chain, std::int64_t us);
  [[nodiscard]] std::uint64_t unanswered(const Route& route, std::int64_t over_ns,
                                         std::int64_t limit_ns) const;
  static void lose(ChainAccount& counts);
  [[nodiscard]] bool waited_for(const Route& route, std::int64_t origin_ns,
                                std::int64_t now_ns) const;
  void lose_rest(const Route& route, const std::vector<std::uint64_t>& lost, const Unended* unended,
                 const std::vector<std::int64_t>& newest_ns, ChainAccount& into) const;
  [[nodiscard]] bool was_off(const Route& route, std::int64_t origin_ns, std::int64_t now_ns) const;
  struct Have {
    std::int64_t from_ns = 0;
    std::vector<char> chains;
  };
  /// Of releases that are known together: the newest ones count.
  static constexpr std::size_t kMostUnknown = 1000;
  [[nodiscard]] static std::size_t newly_known(const Route& route, std::int64_t origin_ns);
  void grow_old(Route& route, std::int64_t now_ns, std::optional<std::int64_t>& missed_us);
  static constexpr std::size_t kKeptClaims = 64, kMostEnded = 1000;
  std::vector<std::vector<std::size_t>> ends_;  ///< [node of the graph] -> routes
  bool single_rate_ = true;
  bool lockstep_ = false;
  bool may_change_ = false;  ///< claims may, after a result has come
  mutable std::unique_ptr<PiMutex> mutex_ = std::make_unique<PiMutex>();
  std::vector<Route> routes_;   ///< counts guarded by mutex_
  std::deque<Claims> claims_;   ///< likewise; by time
  std::deque<Have> haves_;      ///< likewise
  std::deque<Ended> ended_;     ///< likewise
  std::deque<Met> met_;         ///< likewise; by changes
  Board* board_ = nullptr;      ///< null: nobody looks
  std::int64_t newest_ns_ = 0;  ///< likewise; the last release of all
};

}  // namespace xauto::runtime
