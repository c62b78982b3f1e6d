// SPDX-License-Identifier: Apache-2.0
// The ordinary day: how long chains take when no job takes its WCET. It is the last criterion, among candidates of
// which none claims more of any chain (search_typical.cc).
//
// Keys, holds and early starts are played as a run has them (play.h), a few hundred releases: each with the times that
// are its own, the same whatever the candidate. A chain counts by the quadratic mean of its reaction times: by what is
// usual, and by what is late now and then. A median jumps where a result comes just before a tick or just after.
#pragma once

#include <cstdint>
#include <vector>

#include "model/app.h"
#include "solver/keys/problem.h"
#include "solver/keys/search.h"
#include "solver/keys/windows.h"

namespace xauto::solver::keys {

class TypicalPlay {
 public:
  /// Of `problem`, whose app this is, with rates.
  TypicalPlay(const AppSpec& app, const Problem& problem, std::uint64_t seed);

  /// False: the app has too many jobs for it.
  [[nodiscard]] bool is_short() const { return num_scenes_ > 0; }
  /// [xnode] Placement::reads_all; empty: of none. From the next play on.
  void set_reads_all(std::vector<char> of) { reads_all_ = std::move(of); }
  /// The weighted sum of each chain's quadratic mean / Chain::by. `w`: keys and holds.
  [[nodiscard]] double latency(const std::vector<int>& xpu, const Windows& w);

 private:
  struct Event {
    Tick time;
    int kind;   ///< of events at one time the least is first
    int index;  ///< XPU, component or XNode
    std::int64_t number;
    bool operator>(const Event& o) const { return time != o.time ? time > o.time : kind > o.kind; }
  };
  struct Job {
    Tick left = 0, key = 0, planned = 0;
    int waits = 0;
    bool queued = false, started = false;
  };
  struct Ready {
    Tick key;
    int xnode;
    std::int64_t number;
    bool operator>(const Ready& o) const { return key > o.key; }
  };
  struct Device {
    std::vector<Ready> ready;  ///< a heap, smallest key on top
    std::vector<Ready> early;  ///< ready, and held
    std::vector<int> xnodes;
    Ready running = {0, -1, 0};
    Tick since = 0;
    std::int64_t stamp = 0;
    int begun = 0;
    bool look = false;
  };
  /// A way of a chain.
  struct Way {
    int chain = 0, first = -1;  ///< first: the component that it begins in
    std::vector<std::pair<int, int>> samples;
    std::vector<std::vector<std::int64_t>>
        knows;               ///< [sample][activation of the reader] of `first`; -1: nothing
    std::int64_t last = -1;  ///< release that has come through
  };
  /// One phase of the clocks, and all times.
  struct Scene {
    std::vector<Tick> offset;                ///< [domain]
    std::vector<std::vector<double>> part;   ///< [xnode][activation] of the WCET
    std::vector<std::vector<Tick>> arrives;  ///< [xnode][activation] after the release; roots
  };

  void add_ways();
  void draw(const AppSpec& app, std::uint64_t seed);
  void plan_starts(const std::vector<int>& xpu, const Windows& w);
  void play(const Scene& scene, const std::vector<int>& xpu);
  void push(const Event& event);
  void release(int component, std::int64_t n);
  void look_at(int xnode, std::int64_t n);
  void look_early();
  [[nodiscard]] bool may_start_early(int xnode, const Job& job) const;
  [[nodiscard]] std::pair<Tick, Tick> first_open(int xnode) const;
  void ends(int xpu);
  void read(int xnode, std::int64_t n);
  void count(int xnode, std::int64_t n);
  void add(const Way& way, std::int64_t k, Tick now);
  void decide(int xpu);
  [[nodiscard]] Tick released(int xnode, std::int64_t n) const;

  const Problem& p_;
  std::vector<char> reads_all_;
  int num_scenes_ = 1;
  Tick warm_ = 0,
       horizon_ = 0;  ///< releases from warm_ on are counted, and to warm_ before the end
  std::vector<std::vector<double>> typical_;  ///< [xnode][xpu] in ticks; 0: not known
  std::vector<Scene> scenes_;
  std::vector<Way> ways_;
  std::vector<std::vector<std::pair<std::size_t, std::size_t>>> reads_;  ///< [xnode] way, sample
  std::vector<std::vector<std::size_t>> ends_of_;                        ///< [xnode] ways
  std::vector<std::vector<int>> sampled_;                                ///< [xnode] by it
  std::vector<Tick> offset_;                                             ///< [xnode] of its sources
  // Of the candidate and the scene.
  const Scene* scene_ = nullptr;
  const std::vector<int>* xpu_ = nullptr;
  const Windows* w_ = nullptr;
  std::vector<Tick> planned_;  ///< [slot] kNoTick: no hold delays it
  std::vector<std::vector<Job>> jobs_;
  std::vector<std::int64_t> done_, left_, released_;  ///< [xnode], [module], [component]
  std::vector<Device> devices_;
  std::vector<Event> events_;
  Tick now_ = 0;
  bool ended_ = false;
  std::vector<double> squares_;  ///< [chain] of reaction times
  std::vector<std::int64_t> seen_;
};

/// Whether the sample (u, v) goes from one clock to another.
[[nodiscard]] bool of_two_clocks(const Problem& problem, int u, int v);

/// [xnode] Placement::reads_all of `of`: of who samples another clock, where the typical latency is less for it.
[[nodiscard]] std::vector<char> readers_of_all(const AppSpec& app, const Problem& problem,
                                               std::uint64_t seed, const Until& until,
                                               const Candidate& of);

/// Of candidates beside `best`, which is certified, that claim no more of any chain and are certified: that with the
/// least typical latency, without the holds that are not needed. Deterministic for a seed where `max_evaluations` ends
/// it.
void least_typical(const AppSpec& app, const Problem& problem, std::uint64_t seed, Keep keep,
                   const SearchLimits& limits, Candidate& best);

}  // namespace xauto::solver::keys
