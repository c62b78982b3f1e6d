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
  Walk(const Both& both, int clock, Ticks hyperperiod)
      : both_(both),
        hyperperiod_(hyperperiod),
        drift_{both.p.app.clocks[at(clock)].ppm},
        asks_q_(drift_.ppm > 0 || std::ranges::any_of(both.p.platform.xpus,
                                                      [](const Xpu& x) { return x.levels > 0; })),
        lags_(both.p.wcet.size()) {
    for (std::size_t c = 0; c < both.p.components.size(); ++c) {
      if (both.p.components[c].clock != clock) continue;
      components_.push_back(static_cast<int>(c));
      step_ = std::max(step_, both.p.components[c].period);
      for (const int i : both.p.components[c].xnodes)
        for (const bool of_q : {false, true})
          for (const Window& window : both.of(of_q).windows[at(i)]) {
            deepest_ = std::max(deepest_, window.d);
            if (of_q) deepest_of_q_ = std::max(deepest_of_q_, window.d);
          }
    }
    blur_ = drift_.late(deepest_) - drift_.soon(deepest_);
    deepest_of_q_ += 2 * (drift_.late(deepest_of_q_) - deepest_of_q_);
    lines_.resize(both.p.platform.xpus.size());
    jobs_of_.resize(both.p.wcet.size());
    first_kept_.resize(both.p.wcet.size());
    first_of_q_.resize(both.p.components.size());
  }

  /// False: it would take more than `most` jobs, or does not settle.
  bool run(Ticks change, Ticks low, Ticks high, std::size_t most) {
    most_ = std::min(most, kMaxJobsOfAWalk);
    begin(change, low, high);
    std::vector<int> batch;
    while (true) {
      if (!know_fresh()) return false;
      // What is released before a key may have a smaller one.
      if (heap_.empty() || jobs_[at(heap_.top().second)].late >= generated_) {
        if (!generate(generated_ + 1)) return false;
        continue;
      }
      const Ticks key = heap_.top().first;
      if (key > span_end()) return true;
      if (key > change_ + kMostHyperperiods * hyperperiod_ + 4 * deepest_) return false;
      // Of equal keys: A of all of them first, so that nothing depends on their order.
      batch.clear();
      while (!heap_.empty() && heap_.top().first == key) {
        batch.push_back(heap_.top().second);
        heap_.pop();
      }
      for (const int x : batch)
        if (!asks_q_ && !know(x)) return false;
      for (const int x : batch)
        if (!generate(jobs_[at(x)].late + 1)) return false;
      if (!know_fresh()) return false;
      for (const int x : batch) {
        WalkedJob& job = jobs_[at(x)];
        find_end(job);
        note_end(x);
        const bool late = asks_q_
                              ? !job.clean
                              : !job.of_q || job.ended > job.key ||
                                    job.ready > job.release + both_.q.window(job.xnode, job.n).a;
        if (late) last_ = std::max({last_, job.key, job.ready, job.ended});
      }
      for (const int x : batch) release_waiting(jobs_[at(x)]);
    }
  }

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
  [[nodiscard]] Ticks end(int xnode, std::int64_t n) const {
    const WalkedJob* job = find(xnode, n);
    if (job != nullptr && job->ended < kUnknown) return job->ended;
    return release(xnode, n) + drift_.late(window(xnode, n).d);
  }
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

  void begin(Ticks change, Ticks low, Ticks high) {
    change_ = generated_ = change;
    low_ = low;
    high_ = high;
    last_ = -kUnknown;
    all_work_ = 0;
    jobs_.clear();
    fresh_.clear();
    heap_ = {};
    for (std::size_t m = 0; m < lines_.size(); ++m) {
      const Xpu& xpu = both_.p.platform.xpus[m];
      lines_[m] = {};
      lines_[m].blocks = !xpu.preemptive || xpu.levels > 0;
      lines_[m].cost = xpu.preemptive ? xpu.preempt_us * both_.p.scale : 0;
    }
    for (const int c : components_) {
      const Component& home = both_.p.components[at(c)];
      const std::int64_t first = ceil_div(change - home.phi, home.period);
      first_of_q_[at(c)] = first;
      for (const int i : home.xnodes) {
        jobs_of_[at(i)].clear();
        // Keys do not fall from one activation to the next.
        std::int64_t n = first;
        const auto key_late = [&](std::int64_t k) {
          return release(i, k) + drift_.late(both_.p.window(i, k).d);
        };
        while (key_late(n - 1) >= high) --n;
        first_kept_[at(i)] = n;
        for (; n < first; ++n) {
          add(i, n);
          last_ = std::max(last_, jobs_.back().key);
        }
        auto& without = lines_[at(both_.p.policy.placements[at(i)].xpu)].without_change;
        for (n = first_kept_[at(i)]; release(i, n) < change + hyperperiod_; ++n)
          if (const Ticks d = both_.p.window(i, n).d; release(i, n) + d <= change + hyperperiod_)
            without.emplace_back(release(i, n) + drift_.soon(d), key_late(n),
                                 drift_.shortest(both_.p.wcet[at(i)]));
      }
    }
    for (Line& line : lines_) std::sort(line.without_change.begin(), line.without_change.end());
    for (std::size_t k = 0; k < jobs_.size(); ++k) {
      Line& line = lines_[at(jobs_[k].xpu)];
      line.of_p.push_back(static_cast<int>(k));
      ++line.of_p_left;
    }
    ready_to_walk(0);
  }

  void add(int xnode, std::int64_t n) {
    const bool q = of_q(xnode, n);
    const World& w = both_.of(q);
    const Window& window = w.window(xnode, n);
    WalkedJob job;
    job.xnode = xnode;
    job.xpu = w.policy.placements[at(xnode)].xpu;
    job.n = n;
    job.of_q = q;
    job.release = release(xnode, n);
    job.key = job.release + window.d;
    job.soon = job.release + drift_.soon(window.d);
    job.late = job.release + drift_.late(window.d);
    job.starts = job.release + drift_.soon(window.e);
    // As long as A is not known it may preempt.
    job.work = work_of(job, lines_[at(job.xpu)].cost);
    all_work_ += job.work;
    jobs_of_[at(xnode)].push_back(static_cast<int>(jobs_.size()));
    jobs_.push_back(job);
  }

  [[nodiscard]] Ticks work_of(const WalkedJob& job, Ticks cost) const {
    const Ticks wcet = job.of_q ? both_.q.wcet[at(job.xnode)] : both_.larger[at(job.xnode)];
    return drift_.longest(wcet + cost);
  }

  /// All of q that is released before `until` is there; false: too many.
  bool generate(Ticks until) {
    if (until <= generated_) return true;
    until = std::max(until, generated_ + step_);
    const std::size_t old = jobs_.size();
    for (const int c : components_) {
      const Component& home = both_.p.components[at(c)];
      for (std::int64_t n = ceil_div(generated_ - home.phi, home.period);
           home.phi + n * home.period < until; ++n) {
        if (jobs_.size() > most_ || all_work_ > kMaxWork) return false;
        for (const int i : home.xnodes) add(i, n);
      }
    }
    generated_ = until;
    ready_to_walk(old);
    return true;
  }

  /// Those from `old` on: sorted into their XPU's, and walked next if they wait for nobody.
  void ready_to_walk(std::size_t old) {
    std::vector<std::size_t> sizes;
    for (const Line& line : lines_) sizes.push_back(line.all.size());
    for (std::size_t k = old; k < jobs_.size(); ++k) {
      WalkedJob& job = jobs_[k];
      lines_[at(job.xpu)].all.emplace_back(job.soon, static_cast<int>(k));
      for_each_before(job, [&](const WalkedJob& before) { job.waits += before.ended == kUnknown; });
      if (job.waits == 0) walk_next(static_cast<int>(k));
    }
    for (std::size_t m = 0; m < lines_.size(); ++m) {
      auto& all = lines_[m].all;
      const auto middle = all.begin() + static_cast<std::ptrdiff_t>(sizes[m]);
      std::sort(middle, all.end());
      std::inplace_merge(all.begin(), middle, all.end());
    }
  }

  /// It waits for nobody any more.
  void walk_next(int x) {
    heap_.emplace(jobs_[at(x)].key, x);
    if (asks_q_) fresh_.push_back(x);
  }
  bool know_fresh() {
    while (!fresh_.empty()) {
      const int x = fresh_.back();
      fresh_.pop_back();
      if (!know(x)) return false;
    }
    return true;
  }
  /// A, and what follows from it. False: too many jobs.
  bool know(int x) {
    const Ticks ready = by_when_ready(jobs_[at(x)]);
    if (!generate(ready)) return false;  // who may have started before
    WalkedJob& job = jobs_[at(x)];
    job.ready = ready;
    job.on_time = asks_q_ && is_on_time(job);
    charge(job);
    insert(x);
    return true;
  }

  [[nodiscard]] const WalkedJob* find(int xnode, std::int64_t n) const {
    const auto& own = jobs_of_[at(xnode)];
    const std::int64_t k = n - first_kept_[at(xnode)];
    if (k < 0 || k >= static_cast<std::int64_t>(own.size())) return nullptr;
    return &jobs_[at(own[static_cast<std::size_t>(k)])];
  }

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
  void release_waiting(const WalkedJob& job) {
    const World& w = both_.p;
    const auto one = [&](int i, std::int64_t n) {
      const WalkedJob* after = find(i, n);
      if (after == nullptr) return;  // not generated yet
      const auto k = static_cast<std::size_t>(after - jobs_.data());
      if (--jobs_[k].waits == 0) walk_next(static_cast<int>(k));
    };
    for (const int v : w.after[at(job.xnode)]) one(v, job.n);
    one(job.xnode, job.n + 1);
    const int m = w.module_of[at(job.xnode)];
    for (const int i : w.module_xnodes[at(m)])
      if (w.entry[at(i)]) one(i, job.n + w.in_flight[at(m)]);
  }

  /// Through any number of others.
  bool waits_for(const WalkedJob& job, const WalkedJob& other) {
    if (both_.p.component_of[at(job.xnode)] != both_.p.component_of[at(other.xnode)]) return false;
    auto& lags = lags_[at(other.xnode)];
    if (lags.empty()) lags = both_.p.lags_after(other.xnode);
    return job.n - other.n >= lags[at(job.xnode)];
  }

  // ------------------------------------------------------------------------------------ A and F

  /// A(x).
  [[nodiscard]] Ticks by_when_ready(const WalkedJob& x) const {
    const World& w = both_.of(x.of_q);
    const Component& home = w.home(x.xnode);
    Ticks ready = x.release;
    for (const int s : w.app.xnodes[at(x.xnode)].sources) {
      const SourceSpec& source = w.app.sources[at(s)];
      ready = std::max(ready, x.release - home.phi + source.offset_us * w.scale +
                                  drift_.longest(source.jitter_us * w.scale));
    }
    const auto& holds = w.policy.placements[at(x.xnode)].hold_us;
    if (!holds.empty()) {
      const auto size = static_cast<std::int64_t>(holds.size());
      const auto j = static_cast<std::size_t>((x.n % size + size) % size);
      ready = std::max(ready, x.release + drift_.longest(holds[j] * w.scale));
    }
    for (const auto& [u, transfer] : w.before[at(x.xnode)])
      ready = std::max(ready, end(u, x.n) + drift_.longest(transfer));
    const int m = w.module_of[at(x.xnode)];
    if (w.entry[at(x.xnode)])
      for (const int i : w.module_xnodes[at(m)])
        ready = std::max(ready, end(i, x.n - w.in_flight[at(m)]));
    const WalkedJob* previous = find(x.xnode, x.n - 1);
    if (previous == nullptr) {  // it has ended by its key, which is at most t'
      const World& before = both_.of(of_q(x.xnode, x.n - 1));
      return std::max(
          ready, release(x.xnode, x.n - 1) + drift_.longest(before.window(x.xnode, x.n - 1).a));
    }
    return std::max(ready, leaves_it(x, *previous));
  }

  /// By then the activation before x does not keep it any more, but for its work.
  [[nodiscard]] static Ticks leaves_it(const WalkedJob& x, const WalkedJob& previous) {
    const bool larger_key = previous.of_q != x.of_q && previous.late > x.soon;
    return previous.xpu != x.xpu || larger_key ? std::max(previous.ready, previous.ended)
                                               : previous.ready;
  }

  /// What x of q waits for leaves it no later than `a`.
  [[nodiscard]] bool is_on_time(const WalkedJob& x) const {
    if (!x.of_q) return false;
    const World& w = both_.q;
    const Ticks by = opens(x);
    const auto fits = [&](int i, std::int64_t n, Ticks transfer) {
      const WalkedJob* before = find(i, n);
      return (before != nullptr && before->clean) || end(i, n) + drift_.longest(transfer) <= by;
    };
    for (const auto& [u, transfer] : w.before[at(x.xnode)])
      if (!fits(u, x.n, transfer)) return false;
    const int m = w.module_of[at(x.xnode)];
    if (w.entry[at(x.xnode)])
      for (const int i : w.module_xnodes[at(m)])
        if (!fits(i, x.n - w.in_flight[at(m)], 0)) return false;
    const WalkedJob* previous = find(x.xnode, x.n - 1);
    return previous == nullptr || previous->on_time || leaves_it(x, *previous) <= by;
  }
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
  void charge(WalkedJob& x) {
    const Ticks cost = lines_[at(x.xpu)].cost;
    if (cost == 0) return;
    bool pays = false;
    for_each_started(x, x.ready, [&](const WalkedJob& other) {
      pays = other.xnode != x.xnode && !(asks_q_ && waits_for(x, other));
      return !pays;
    });
    if (!pays) x.work = work_of(x, 0);
  }

  void insert(int x) {
    Line& line = lines_[at(jobs_[at(x)].xpu)];
    const auto place = std::ranges::upper_bound(line.known, jobs_[at(x)].ready, {},
                                                [&](int y) { return jobs_[at(y)].ready; });
    const auto k = static_cast<std::size_t>(place - line.known.begin());
    line.known.insert(place, x);
    line.pending.push_back(x);
    set_latest(line, k);
  }
  void note_end(int x) {
    Line& line = lines_[at(jobs_[at(x)].xpu)];
    const auto found = std::find(line.known.rbegin(), line.known.rend(), x);
    set_latest(line, static_cast<std::size_t>(line.known.rend() - found) - 1);
    std::erase(line.pending, x);
    if (const WalkedJob& job = jobs_[at(x)]; !job.of_q) {
      --line.of_p_left;
      line.of_p_ended = std::max(line.of_p_ended, job.ended);
    }
    while (line.low < line.all.size() && jobs_[at(line.all[line.low].second)].ended < kUnknown)
      ++line.low;
  }
  void set_latest(Line& line, std::size_t from) {
    line.latest.resize(line.known.size());
    for (std::size_t k = from; k < line.known.size(); ++k) {
      const Ticks ended = jobs_[at(line.known[k])].ended;
      line.latest[k] =
          std::max(k > 0 ? line.latest[k - 1] : -kUnknown, ended < kUnknown ? ended : -kUnknown);
    }
  }

  /// Whom x may find on an XPU where not any number may have started.
  struct Blocker {
    const WalkedJob* job;
    Ticks left;  ///< less what it waits for, of those in V(s); 0 if it is one
  };
  void find_blockers(const WalkedJob& x) {
    blockers_.clear();
    if (!lines_[at(x.xpu)].blocks) return;
    for_each_started(x, std::max(x.ready, high_), [&](const WalkedJob& other) {
      // What x waits for has a smaller key, or A(x) is at least its F, which counts V(s) too.
      if (!asks_q_ || !waits_for(x, other)) blockers_.push_back({&other, other.work});
      return true;
    });
  }
  void count(const WalkedJob& of_v) {
    for (Blocker& b : blockers_) {
      if (waits_for(*b.job, of_v)) b.left -= of_v.work;
      if (b.job == &of_v) b.left = 0;
    }
  }
  /// B(s), what is counted being V(s).
  [[nodiscard]] Ticks blocked(Ticks s) const {
    Ticks longest = 0;
    for (const Blocker& b : blockers_)
      if (b.job->starts < s) longest = std::max(longest, b.left);
    return longest;
  }
  /// The same for t, where all of V is counted.
  [[nodiscard]] Ticks blocked_at_high(const WalkedJob& x) const {
    Ticks longest = 0;
    for (const Blocker& b : blockers_)
      if (b.job->starts < high_ && b.job->soon > x.late) longest = std::max(longest, b.left);
    return longest;
  }

  /// Whether a job of p may be there at s that q's certificate does not know: it blocks x, or is
  /// preempted by one of V(s), whose keys are at least `least_key`.
  [[nodiscard]] bool meets_p(const WalkedJob& x, Ticks s, Ticks least_key) const {
    const Line& line = lines_[at(x.xpu)];
    if (!line.blocks && line.cost == 0) return false;
    if (line.of_p_left == 0 && line.of_p_ended <= s) return false;
    return std::ranges::any_of(line.of_p, [&](int k) {
      const WalkedJob& job = jobs_[at(k)];
      return job.ended > s && ((line.blocks && job.late > x.soon && job.starts < s) ||
                               (line.cost > 0 && job.late > least_key));
    });
  }

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
  void find_end(WalkedJob& x) {
    const Line& line = lines_[at(x.xpu)];
    find_blockers(x);
    Ticks sum = 0, worst = 0;
    bool clean = x.on_time, certain = true;  // certain: all of V(s) are known, of q, and on time
    for (std::size_t k = line.low; k < line.all.size() && line.all[k].first <= x.late; ++k) {
      const WalkedJob& y = jobs_[at(line.all[k].second)];
      if (y.ready < kUnknown) continue;
      sum += y.work;
      count(y);
      certain = false;
    }
    const auto is_before = [&](int y) { return jobs_[at(y)].soon <= x.late; };
    auto pending = std::ranges::count_if(line.pending, is_before);  // of V, not in V(s)
    Ticks least_key = kUnknown, open = kUnknown;                    // of V(s)
    bool first = true;
    const auto end = [&](Ticks by) {
      x.clean = clean;
      x.ended = clean ? std::min(by, x.late) : by;
    };
    std::size_t k = line.known.size();
    for (; k > 0; --k) {
      const WalkedJob& y = jobs_[at(line.known[k - 1])];
      if (y.ready <= low_) break;
      if (y.soon > x.late) continue;
      const Ticks s = y.ready;
      sum += y.work;
      count(y);
      pending -= y.ended == kUnknown;
      if (clean) {
        certain &= y.on_time;
        least_key = std::min(least_key, y.soon);
        if (y.of_q) open = std::min(open, opens(y));
      }
      if (s > x.ready) continue;
      // Of several with this A, the last one has counted all.
      const Ticks by = s + sum + blocked(s);
      worst = first ? by : std::max(worst, by);
      first = false;
      clean = clean && (by <= x.soon || (certain && !meets_p(x, s, least_key)));
      if (s < high_ || pending > 0) continue;
      const Ticks ended = k == 1 ? -kUnknown : line.latest[k - 2];
      if (ended <= s && (!clean || by <= x.soon || ended <= open)) return end(worst);
    }
    for (; k > 0; --k) {
      const WalkedJob& y = jobs_[at(line.known[k - 1])];
      if (!is_before(line.known[k - 1])) continue;
      sum += y.work;
      count(y);
    }
    Ticks begun = high_, work = 0, ended = -kUnknown;
    for (const auto& [soon, late, wcet] : line.without_change) {
      if (soon > x.late) break;  // it is not in V
      work += wcet;
      ended = std::max(ended, late);
      begun = std::min(begun, ended - work);
    }
    const Ticks by = begun + sum + blocked_at_high(x);
    clean = clean && by <= x.soon;
    end(first ? by : std::max(worst, by));
  }

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
