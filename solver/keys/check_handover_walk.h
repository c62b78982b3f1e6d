// SPDX-License-Identifier: Apache-2.0
// The jobs of one clock around one change. The words are those of docs/keys.md, theorem 8. A
// clock's releases before S have the table p, the others q. For each S of a hyperperiod, and each
// interval [t', t''] that t may be in, the jobs that have not ended by t are walked by their keys: A,
// by when each is ready, and F, by when it has ended. The walk ends when nothing can be late any more.
// Then chains are followed on these F.
//
// Time is the clock's own. Where the clock has a tolerance, instants that are counted in real time
// are known from `soon` to `late`. All is then as in "A clock with a tolerance", but:
//
// - A is found as soon as nothing is waited for, not by batches: it does not depend on others, and
//   the more A are known the smaller is each V(s).
// - What a key or hold is counted from is its release, so nothing is before that.
// - In B(s), what is in V(s) does not count: it is in the sum.
// - q's certificate knows only preempting and blocking of q's jobs. So a sum for s is excused only if
//   no job of p may be there at s that blocks, or costs its preemption.
#pragma once

#include <algorithm>
#include <functional>
#include <limits>
#include <queue>
#include <utility>
#include <vector>

#include "base/index.h"
#include "solver/keys/check_world.h"

namespace xauto::solver::keys::checking::tables {

inline constexpr Ticks kUnknown = std::numeric_limits<Ticks>::max() / 2;
/// A walk of so many jobs is quadratic at worst: seconds. The solver claims nothing beyond 42 000.
inline constexpr std::size_t kMaxJobsOfAWalk = 60'000;
inline constexpr Ticks kMostHyperperiods = 50;     ///< after S; what has not settled then piles up
inline constexpr Ticks kMaxWork = Ticks{1} << 60;  ///< of all jobs of a walk, so that sums fit

/// Of the clock's own time: how much a real length is, from the least to the most.
struct Drift {
  std::int64_t ppm = 0;
  /// w(l)
  [[nodiscard]] Ticks longest(Ticks l) const {
    return ppm == 0 ? l : ceil_div(static_cast<__int128>(l) * kMillion, kMillion - ppm);
  }
  /// l + b(l) and l - b(l), counted from a release
  [[nodiscard]] Ticks late(Ticks l) const { return ppm == 0 ? l : longest(l) + 1; }
  [[nodiscard]] Ticks soon(Ticks l) const { return std::max<Ticks>(0, 2 * l - late(l)); }
  [[nodiscard]] Ticks shortest(Ticks l) const {
    return floor_div(static_cast<__int128>(l) * kMillion, kMillion + ppm);
  }
};

/// Of U.
struct WalkedJob {
  int xnode = -1;
  int xpu = -1;
  std::int64_t n = 0;
  bool of_q = false;
  Ticks release = 0, key = 0, starts = 0;    ///< starts: not before that
  Ticks soon = 0, late = 0;                  ///< the real key is in between
  Ticks work = 0;                            ///< what preempting costs included, once that is known
  Ticks ready = kUnknown, ended = kUnknown;  ///< A and F
  int waits = 0;                             ///< for so many of U that the walk has not come to
  bool on_time = false, clean = false;       ///< of q, where its certificate is asked
};

/// Jobs of U on one XPU.
struct Line {
  bool blocks = false;  ///< not any number may have started: whoever has may be the last
  Ticks cost = 0;       ///< of preempting
  std::vector<std::pair<Ticks, int>> all;  ///< soon, job; sorted
  std::size_t low = 0;                     ///< all before it have been walked
  std::vector<int> known;                  ///< those whose A is known, by A
  std::vector<int> pending;                ///< those of them whose F is not
  std::vector<Ticks> latest;               ///< [of known] the largest F up to here
  std::vector<int> of_p;
  int of_p_left = 0;     ///< whose F is not known
  Ticks of_p_ended = 0;  ///< the largest F of the others
  /// Of p's jobs from t'' on, had there been no change, those with keys up to S + H: the key, from the
  /// earliest to the latest that it can be, and the WCET.
  std::vector<std::tuple<Ticks, Ticks, Ticks>> without_change;
};

/// Both tables, and the WCETs of p's jobs that have not ended at t.
struct Both {
  const World& p;
  const World& q;
  const std::vector<Ticks>& larger;
  std::vector<Ticks> latest_start;  ///< [xnode] the largest e
  [[nodiscard]] const World& of(bool of_q) const { return of_q ? q : p; }
};

/// The jobs of one clock, for one S and one [t', t''].
class Walk {
 public:
  Walk(const Both& both, int clock, Ticks hyperperiod);

  /// False: it would take more than `most` jobs, or does not settle.
  bool run(Ticks change, Ticks low, Ticks high, std::size_t most);

  [[nodiscard]] std::size_t jobs() const { return jobs_.size(); }
  /// L + 2D + H. No later job is late.
  [[nodiscard]] Ticks span_end() const { return last() + 2 * deepest_of_q_ + hyperperiod_; }
  /// L. What is released later is of q, and in time.
  [[nodiscard]] Ticks last() const { return std::max(last_, change_); }
  [[nodiscard]] const Drift& drift() const { return drift_; }
  /// Whether a change may make that job another than under p alone.
  [[nodiscard]] bool in_u(int xnode, std::int64_t n) const { return n >= first_kept_[at(xnode)]; }
  [[nodiscard]] bool of_q(int xnode, std::int64_t n) const {
    return n >= first_of_q_[at(both_.p.component_of[at(xnode)])];
  }
  [[nodiscard]] Ticks release(int xnode, std::int64_t n) const {
    const Component& c = both_.p.home(xnode);
    return c.phi + n * c.period;
  }
  /// By then that job has ended, of U or not.
  [[nodiscard]] Ticks end(int xnode, std::int64_t n) const;
  /// In real time; where the clock drifts.
  [[nodiscard]] bool ends_by_key(int xnode, std::int64_t n) const {
    const WalkedJob* job = find(xnode, n);
    return job == nullptr || job->ended == kUnknown || job->clean;
  }
  [[nodiscard]] const Window& window(int xnode, std::int64_t n) const {
    return both_.of(of_q(xnode, n)).window(xnode, n);
  }
  [[nodiscard]] Ticks starts(int xnode, std::int64_t n) const {
    return release(xnode, n) + drift_.soon(window(xnode, n).e);
  }

 private:
  // --------------------------------------------------------------------------------------- jobs

  void begin(Ticks change, Ticks low, Ticks high);

  void add(int xnode, std::int64_t n);

  [[nodiscard]] Ticks work_of(const WalkedJob& job, Ticks cost) const {
    const Ticks wcet = job.of_q ? both_.q.wcet[at(job.xnode)] : both_.larger[at(job.xnode)];
    return drift_.longest(wcet + cost);
  }

  /// All of q that is released before `until` is there; false: too many.
  bool generate(Ticks until);

  /// Those from `old` on: sorted into their XPU's, and walked next if they wait for nobody.
  void ready_to_walk(std::size_t old);

  /// It waits for nobody any more.
  void walk_next(int x) {
    heap_.emplace(jobs_[at(x)].key, x);
    if (asks_q_) fresh_.push_back(x);
  }
  bool know_fresh();
  /// A, and what follows from it. False: too many jobs.
  bool know(int x);

  [[nodiscard]] const WalkedJob* find(int xnode, std::int64_t n) const;

  // --------------------------------------------------------------------------- who waits for whom

  /// Jobs of U that this one waits for, once for each reason.
  template <typename Visit>
  void for_each_before(const WalkedJob& job, const Visit& visit) const {
    const World& w = both_.p;  // edges and modules are the app's
    const auto one = [&](int i, std::int64_t n) {
      if (const WalkedJob* before = find(i, n)) visit(*before);
    };
    for (const auto& [u, transfer] : w.before[at(job.xnode)]) one(u, job.n);
    one(job.xnode, job.n - 1);
    const int m = w.module_of[at(job.xnode)];
    if (w.entry[at(job.xnode)])
      for (const int i : w.module_xnodes[at(m)]) one(i, job.n - w.in_flight[at(m)]);
  }

  /// The converse of for_each_before: what has this one as its last wait may be walked.
  void release_waiting(const WalkedJob& job);

  /// Through any number of others.
  bool waits_for(const WalkedJob& job, const WalkedJob& other);

  // ------------------------------------------------------------------------------------ A and F

  /// A(x).
  [[nodiscard]] Ticks by_when_ready(const WalkedJob& x) const;

  /// By then the activation before x does not keep it any more, but for its work.
  [[nodiscard]] static Ticks leaves_it(const WalkedJob& x, const WalkedJob& previous);

  /// What x of q waits for leaves it no later than `a`.
  [[nodiscard]] bool is_on_time(const WalkedJob& x) const;
  /// The least that `a` may be, of a job of q.
  [[nodiscard]] Ticks opens(const WalkedJob& x) const {
    return x.release + drift_.soon(both_.q.window(x.xnode, x.n).a);
  }

  /// Jobs of larger keys on x's XPU that may have started before `instant`, and do not wait for x.
  template <typename Visit>
  void for_each_started(const WalkedJob& x, Ticks instant, const Visit& visit) {
    const auto& all = lines_[at(x.xpu)].all;
    auto k = std::upper_bound(all.begin(), all.end(),
                              std::pair(x.soon - blur_, std::numeric_limits<int>::max()));
    // Later ones are released at `instant` or after it.
    for (; k != all.end() && k->first < instant + deepest_; ++k) {
      const WalkedJob& other = jobs_[at(k->second)];
      if (other.late > x.soon && other.starts < instant && &other != &x && !waits_for(other, x) &&
          !visit(other))
        return;
    }
  }

  /// A is known, so who may be preempted is.
  void charge(WalkedJob& x);

  void insert(int x);
  void note_end(int x);
  void set_latest(Line& line, std::size_t from);

  /// Whom x may find on an XPU where not any number may have started.
  struct Blocker {
    const WalkedJob* job;
    Ticks left;  ///< less what it waits for, of those in V(s); 0 if it is one
  };
  void find_blockers(const WalkedJob& x);
  void count(const WalkedJob& of_v);
  /// B(s), what is counted being V(s).
  [[nodiscard]] Ticks blocked(Ticks s) const;
  /// The same for t, where all of V is counted.
  [[nodiscard]] Ticks blocked_at_high(const WalkedJob& x) const;

  /// Whether a job of p may be there at s that q's certificate does not know: it blocks x, or is
  /// preempted by one of V(s), whose keys are at least `least_key`.
  [[nodiscard]] bool meets_p(const WalkedJob& x, Ticks s, Ticks least_key) const;

  /// F(x). V is gone through by A, the largest first.
  ///
  /// Once all of V with A < s has F <= s, s >= t'', smaller s and the term of t are not needed: if m is
  /// busy with V since s' < s or since t, then from s on with V(s) alone, or with what blocked s' or t
  /// and may block s. So x has ended by the sum for s.
  ///
  /// They give no more, either, where the clock does not drift. Let G be those with A < s, if any, and
  /// z the one of G with the largest key, of these the last walked. Then G is in z's V. Where s' <=
  /// A(z), F(z) >= s' + C(G) or, where a job of G was not known then, even from a later s' on: such a
  /// job is in all of z's V(s). So s' + C(V(s')) = s' + C(G) + C(V(s)) <= s + C(V(s)), with G here
  /// those of it in V(s'). What may block at s' or t'' may do so at s, and what is taken off for V(s)
  /// is no more. In the same way F(z) >= I(z) + C(G), and I(x) <= I(z), since z's key is not the
  /// larger one. Where G is empty, I(x) <= t'' <= s.
  ///
  /// Where x is clean so far it stays so, too, if the sum for s is in time, or if G has ended before any
  /// of V(s) has to be ready: then q's certificate bounds V(s) from there on.
  void find_end(WalkedJob& x);

  const Both& both_;
  Ticks hyperperiod_;
  Drift drift_;
  /// The walk alone does not show that jobs are in time: where the clock drifts, or an XPU has levels. Then
  /// q's certificate is asked.
  bool asks_q_;
  std::vector<std::vector<std::int64_t>> lags_;  ///< [xnode], as asked for
  std::vector<int> components_;
  Ticks step_ = 1, deepest_ = 0, deepest_of_q_ = 0;  ///< the largest keys; of q: D
  Ticks blur_ = 0;                                   ///< no key is known less
  Ticks change_ = 0, low_ = 0, high_ = 0;            ///< S, t', t''
  Ticks generated_ = 0;                              ///< all that is released before it is there
  Ticks last_ = 0;                                   ///< L, but for S
  std::size_t most_ = 0;
  Ticks all_work_ = 0;
  std::vector<WalkedJob> jobs_;
  std::vector<int> fresh_;                 ///< whose A may be found
  std::vector<Line> lines_;                ///< [xpu]
  std::vector<std::vector<int>> jobs_of_;  ///< [xnode] from first_kept_ on
  std::vector<std::int64_t> first_kept_;   ///< [xnode]
  std::vector<std::int64_t> first_of_q_;   ///< [component]
  std::vector<Blocker> blockers_;
  std::priority_queue<std::pair<Ticks, int>, std::vector<std::pair<Ticks, int>>, std::greater<>>
      heap_;  ///< what waits for nobody
};

}  // namespace xauto::solver::keys::checking::tables
