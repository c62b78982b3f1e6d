// SPDX-License-Identifier: Apache-2.0
// The words are those of docs/steady-state.md, theorem 8. A clock's releases before S have the table
// p, the others q. For each S of a hyperperiod, and each interval [t', t''] that t may be in, the
// jobs that have not ended by t are walked by their keys: A, by when each is ready, and F, by when it
// has ended. The walk ends when nothing can be late any more. Then chains are followed on these F.
#include "solver/steady/check_handover.h"

#include <algorithm>
#include <functional>
#include <limits>
#include <queue>
#include <set>
#include <utility>

#include <fmt/format.h>

#include "base/index.h"
#include "solver/steady/check_chains.h"
#include "solver/steady/check_world.h"

namespace xauto::solver::steady {
namespace checking::tables {

constexpr Ticks kUnknown = std::numeric_limits<Ticks>::max() / 2;
/// A walk of so many jobs is quadratic at worst: seconds. The solver claims nothing beyond 42 000.
constexpr std::size_t kMaxJobsOfAWalk = 60'000;
constexpr Ticks kMostHyperperiods = 50;    ///< after S; what has not settled then piles up
constexpr std::size_t kMaxWays = 100'000;  ///< of all chains

/// Of U.
struct Job {
  int xnode = -1;
  int xpu = -1;
  std::int64_t n = 0;
  bool of_q = false;
  Ticks release = 0, key = 0, starts = 0;    ///< starts: not before that
  Ticks work = 0;                            ///< what preempting costs included, once that is known
  Ticks ready = kUnknown, ended = kUnknown;  ///< A and F
  int waits = 0;                             ///< for so many of U that the walk has not come to
};

/// Jobs of U on one XPU.
struct Line {
  bool preemptive = true;
  Ticks cost = 0;                          ///< of preempting
  std::vector<std::pair<Ticks, int>> all;  ///< key, job; sorted
  std::size_t low = 0;                     ///< all before it have been walked
  std::vector<int> known;                  ///< those whose A is known, by A
  std::vector<Ticks> latest;               ///< [of known] the largest F up to here
  /// Key and WCET of p's jobs from t'' on, had there been no change; those with keys up to S + H.
  std::vector<std::pair<Ticks, Ticks>> without_change;
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
      : both_(both), hyperperiod_(hyperperiod), lags_(both.p.wcet.size()) {
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
      // What is released before a key may have a smaller one.
      if (heap_.empty() || heap_.top().first >= generated_) {
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
      for (const int x : batch) {
        const Ticks ready = by_when_ready(jobs_[at(x)]);
        if (!generate(ready)) return false;  // who may have started before
        jobs_[at(x)].ready = ready;
        charge(jobs_[at(x)]);
        insert(x);
      }
      for (const int x : batch) {
        Job& job = jobs_[at(x)];
        job.ended = by_when_ended(job);
        note_end(x);
        if (!job.of_q || job.ended > job.key ||
            job.ready > job.release + both_.q.window(job.xnode, job.n).a)
          last_ = std::max({last_, job.key, job.ready, job.ended});
      }
      for (const int x : batch) release_waiting(jobs_[at(x)]);
    }
  }

  [[nodiscard]] std::size_t jobs() const { return jobs_.size(); }
  /// L + 2D + H. No later job is late.
  [[nodiscard]] Ticks span_end() const { return last() + 2 * deepest_of_q_ + hyperperiod_; }
  /// L. What is released later is of q, and in time.
  [[nodiscard]] Ticks last() const { return std::max(last_, change_); }
  [[nodiscard]] bool of_q(int xnode, std::int64_t n) const {
    return n >= first_of_q_[at(both_.p.component_of[at(xnode)])];
  }
  [[nodiscard]] Ticks release(int xnode, std::int64_t n) const {
    const Component& c = both_.p.home(xnode);
    return c.phi + n * c.period;
  }
  /// By then that job has ended, of U or not.
  [[nodiscard]] Ticks end(int xnode, std::int64_t n) const {
    const Job* job = find(xnode, n);
    if (job != nullptr && job->ended < kUnknown) return job->ended;
    return release(xnode, n) + both_.of(of_q(xnode, n)).window(xnode, n).d;
  }
  [[nodiscard]] Ticks starts(int xnode, std::int64_t n) const {
    return release(xnode, n) + both_.of(of_q(xnode, n)).window(xnode, n).e;
  }

 private:
  // --------------------------------------------------------------------------------------- jobs

  void begin(Ticks change, Ticks low, Ticks high) {
    change_ = generated_ = change;
    low_ = low;
    high_ = high;
    last_ = -kUnknown;
    jobs_.clear();
    heap_ = {};
    for (std::size_t m = 0; m < lines_.size(); ++m) {
      const Xpu& xpu = both_.p.platform.xpus[m];
      lines_[m] = {};
      lines_[m].preemptive = xpu.preemptive;
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
        while (release(i, n - 1) + both_.p.window(i, n - 1).d >= high) --n;
        first_kept_[at(i)] = n;
        for (; n < first; ++n) {
          add(i, n);
          last_ = std::max(last_, jobs_.back().key);
        }
        auto& without = lines_[at(both_.p.policy.placements[at(i)].xpu)].without_change;
        for (n = first_kept_[at(i)]; release(i, n) < change + hyperperiod_; ++n)
          if (const Ticks key = release(i, n) + both_.p.window(i, n).d;
              key <= change + hyperperiod_)
            without.emplace_back(key, both_.p.wcet[at(i)]);
      }
    }
    for (Line& line : lines_) std::sort(line.without_change.begin(), line.without_change.end());
    ready_to_walk(0);
  }

  void add(int xnode, std::int64_t n) {
    const bool q = of_q(xnode, n);
    const World& w = both_.of(q);
    const Window& window = w.window(xnode, n);
    Job job;
    job.xnode = xnode;
    job.xpu = w.policy.placements[at(xnode)].xpu;
    job.n = n;
    job.of_q = q;
    job.release = release(xnode, n);
    job.key = job.release + window.d;
    job.starts = job.release + window.e;
    // As long as A is not known it may preempt.
    job.work = (q ? w.wcet[at(xnode)] : both_.larger[at(xnode)]) + lines_[at(job.xpu)].cost;
    jobs_of_[at(xnode)].push_back(static_cast<int>(jobs_.size()));
    jobs_.push_back(job);
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
        if (jobs_.size() > most_) return false;
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
      Job& job = jobs_[k];
      lines_[at(job.xpu)].all.emplace_back(job.key, static_cast<int>(k));
      for_each_before(job, [&](const Job& before) { job.waits += before.ended == kUnknown; });
      if (job.waits == 0) heap_.emplace(job.key, static_cast<int>(k));
    }
    for (std::size_t m = 0; m < lines_.size(); ++m) {
      auto& all = lines_[m].all;
      const auto middle = all.begin() + static_cast<std::ptrdiff_t>(sizes[m]);
      std::sort(middle, all.end());
      std::inplace_merge(all.begin(), middle, all.end());
    }
  }

  [[nodiscard]] const Job* find(int xnode, std::int64_t n) const {
    const auto& own = jobs_of_[at(xnode)];
    const std::int64_t k = n - first_kept_[at(xnode)];
    if (k < 0 || k >= static_cast<std::int64_t>(own.size())) return nullptr;
    return &jobs_[at(own[static_cast<std::size_t>(k)])];
  }

  // --------------------------------------------------------------------------- who waits for whom

  /// Jobs of U that this one waits for, once for each reason.
  template <typename Visit>
  void for_each_before(const Job& job, const Visit& visit) const {
    const World& w = both_.p;  // edges and modules are the app's
    const auto one = [&](int i, std::int64_t n) {
      if (const Job* before = find(i, n)) visit(*before);
    };
    for (const auto& [u, transfer] : w.before[at(job.xnode)]) one(u, job.n);
    one(job.xnode, job.n - 1);
    const int m = w.module_of[at(job.xnode)];
    if (w.entry[at(job.xnode)])
      for (const int i : w.module_xnodes[at(m)]) one(i, job.n - w.in_flight[at(m)]);
  }

  /// The converse of for_each_before: what has this one as its last wait may be walked.
  void release_waiting(const Job& job) {
    const World& w = both_.p;
    const auto one = [&](int i, std::int64_t n) {
      const Job* after = find(i, n);
      if (after == nullptr) return;  // not generated yet
      const auto k = static_cast<std::size_t>(after - jobs_.data());
      if (--jobs_[k].waits == 0) heap_.emplace(jobs_[k].key, static_cast<int>(k));
    };
    for (const int v : w.after[at(job.xnode)]) one(v, job.n);
    one(job.xnode, job.n + 1);
    const int m = w.module_of[at(job.xnode)];
    for (const int i : w.module_xnodes[at(m)])
      if (w.entry[at(i)]) one(i, job.n + w.in_flight[at(m)]);
  }

  /// Through any number of others.
  bool waits_for(const Job& job, const Job& other) {
    if (both_.p.component_of[at(job.xnode)] != both_.p.component_of[at(other.xnode)]) return false;
    auto& lags = lags_[at(other.xnode)];
    if (lags.empty()) lags = both_.p.lags_after(other.xnode);
    return job.n - other.n >= lags[at(job.xnode)];
  }

  // ------------------------------------------------------------------------------------ A and F

  /// A(x).
  [[nodiscard]] Ticks by_when_ready(const Job& x) const {
    const World& w = both_.of(x.of_q);
    const Component& home = w.home(x.xnode);
    Ticks ready = x.release;
    for (const int s : w.app.xnodes[at(x.xnode)].sources) {
      const SourceSpec& source = w.app.sources[at(s)];
      ready =
          std::max(ready, x.release - home.phi + (source.offset_us + source.jitter_us) * w.scale);
    }
    const auto& holds = w.policy.placements[at(x.xnode)].hold_us;
    if (!holds.empty()) {
      const auto size = static_cast<std::int64_t>(holds.size());
      const auto j = static_cast<std::size_t>((x.n % size + size) % size);
      ready = std::max(ready, x.release + holds[j] * w.scale);
    }
    for (const auto& [u, transfer] : w.before[at(x.xnode)])
      ready = std::max(ready, end(u, x.n) + transfer);
    const int m = w.module_of[at(x.xnode)];
    if (w.entry[at(x.xnode)])
      for (const int i : w.module_xnodes[at(m)])
        ready = std::max(ready, end(i, x.n - w.in_flight[at(m)]));
    const Job* previous = find(x.xnode, x.n - 1);
    if (previous == nullptr) {  // it has ended by its key, which is at most t'
      const World& before = both_.of(of_q(x.xnode, x.n - 1));
      return std::max(ready, release(x.xnode, x.n - 1) + before.window(x.xnode, x.n - 1).a);
    }
    ready = std::max(ready, previous->ready);
    if (previous->xpu != x.xpu || previous->key > x.key) ready = std::max(ready, previous->ended);
    return ready;
  }

  /// Jobs of larger keys on x's XPU that may have started before `instant`, and do not wait for x.
  template <typename Visit>
  void for_each_started(const Job& x, Ticks instant, const Visit& visit) {
    const auto& all = lines_[at(x.xpu)].all;
    auto k =
        std::upper_bound(all.begin(), all.end(), std::pair(x.key, std::numeric_limits<int>::max()));
    // Later ones are released at `instant` or after it.
    for (; k != all.end() && k->first < instant + deepest_; ++k) {
      const Job& other = jobs_[at(k->second)];
      if (other.starts < instant && !waits_for(other, x) && !visit(other)) return;
    }
  }

  /// A is known, so who may be preempted is.
  void charge(Job& x) {
    const Ticks cost = lines_[at(x.xpu)].cost;
    if (cost == 0) return;
    bool pays = false;
    for_each_started(x, x.ready, [&](const Job& other) {
      pays = other.xnode != x.xnode;
      return !pays;
    });
    if (!pays) x.work -= cost;
  }

  void insert(int x) {
    Line& line = lines_[at(jobs_[at(x)].xpu)];
    const auto place = std::ranges::upper_bound(line.known, jobs_[at(x)].ready, {},
                                                [&](int y) { return jobs_[at(y)].ready; });
    const auto k = static_cast<std::size_t>(place - line.known.begin());
    line.known.insert(place, x);
    set_latest(line, k);
  }
  void note_end(int x) {
    Line& line = lines_[at(jobs_[at(x)].xpu)];
    const auto found = std::find(line.known.rbegin(), line.known.rend(), x);
    set_latest(line, static_cast<std::size_t>(line.known.rend() - found) - 1);
    while (line.low < line.all.size() && jobs_[at(line.all[line.low].second)].ended < kUnknown)
      ++line.low;
  }
  void set_latest(Line& line, std::size_t from) {
    line.latest.resize(line.known.size());
    for (std::size_t k = from; k < line.known.size(); ++k)
      line.latest[k] =
          std::max(k > 0 ? line.latest[k - 1] : -kUnknown, jobs_[at(line.known[k])].ended);
  }

  /// Whom x may find on an XPU that does not preempt.
  struct Blocker {
    const Job* job;
    Ticks left;  ///< less what it waits for, of those in V(s)
  };
  void find_blockers(const Job& x) {
    blockers_.clear();
    if (lines_[at(x.xpu)].preemptive) return;
    for_each_started(x, std::max(x.ready, high_), [&](const Job& other) {
      blockers_.push_back({&other, other.work});
      return true;
    });
  }
  void count(const Job& of_v) {
    for (Blocker& b : blockers_)
      if (waits_for(*b.job, of_v)) b.left -= of_v.work;
  }
  /// B(s), what is counted being V(s).
  [[nodiscard]] Ticks blocked(Ticks s) const {
    Ticks longest = 0;
    for (const Blocker& b : blockers_)
      if (b.job->starts < s) longest = std::max(longest, b.left);
    return longest;
  }

  /// F(x). V is gone through by A, the largest first.
  ///
  /// Once all of V with A < s has F <= s, s >= t'', smaller s and the term of t give no more. Let G be
  /// those, if any, and z the one of G with the largest key, of these the last walked. Then G is in z's
  /// V. Where s' <= A(z), F(z) >= s' + C(G) or, where a job of G was not known then, even from a later
  /// s' on: such a job is in all of z's V(s). So s' + C(V(s')) = s' + C(G) + C(V(s)) <= s + C(V(s)),
  /// with G here those of it in V(s'). What may block at s' or t'' may do so at s, and what is taken
  /// off for V(s) is no more. In the same way F(z) >= I(z) + C(G), and I(x) <= I(z), since z's key is
  /// not the larger one. Where G is empty, I(x) <= t'' <= s.
  Ticks by_when_ended(const Job& x) {
    const Line& line = lines_[at(x.xpu)];
    find_blockers(x);
    Ticks sum = 0, worst = 0;
    for (std::size_t k = line.low; k < line.all.size() && line.all[k].first <= x.key; ++k) {
      const Job& y = jobs_[at(line.all[k].second)];
      if (y.ready < kUnknown) continue;
      sum += y.work;
      count(y);
    }
    bool first = true, below = false;
    Ticks blocked_at_high = 0;
    std::size_t k = line.known.size();
    for (; k > 0; --k) {
      const Job& y = jobs_[at(line.known[k - 1])];
      if (y.ready <= low_) break;
      if (y.key > x.key) continue;
      const Ticks s = y.ready;
      if (s < high_ && !below) {
        below = true;
        blocked_at_high = blocked(high_);
      }
      sum += y.work;
      count(y);
      if (s > x.ready) continue;
      // Of several with this A, the last one has counted all.
      worst = first ? s + sum + blocked(s) : std::max(worst, s + sum + blocked(s));
      first = false;
      if (s >= high_ && (k == 1 || line.latest[k - 2] <= s)) return worst;
    }
    if (!below) blocked_at_high = blocked(high_);
    for (; k > 0; --k)
      if (jobs_[at(line.known[k - 1])].key <= x.key) sum += jobs_[at(line.known[k - 1])].work;
    Ticks begun = high_, work = 0;
    for (const auto& [key, wcet] : line.without_change) {
      if (key > x.key) break;
      work += wcet;
      begun = std::min(begun, key - work);
    }
    const Ticks second = begun + sum + blocked_at_high;
    return first ? second : std::max(worst, second);
  }

  const Both& both_;
  Ticks hyperperiod_;
  std::vector<std::vector<std::int64_t>> lags_;  ///< [xnode], as asked for
  std::vector<int> components_;
  Ticks step_ = 1, deepest_ = 0, deepest_of_q_ = 0;  ///< D
  Ticks change_ = 0, low_ = 0, high_ = 0;            ///< S, t', t''
  Ticks generated_ = 0;                              ///< all that is released before it is there
  Ticks last_ = 0;                                   ///< L, but for S
  std::size_t most_ = 0;
  std::vector<Job> jobs_;
  std::vector<Line> lines_;                ///< [xpu]
  std::vector<std::vector<int>> jobs_of_;  ///< [xnode] from first_kept_ on
  std::vector<std::int64_t> first_kept_;   ///< [xnode]
  std::vector<std::int64_t> first_of_q_;   ///< [component]
  std::vector<Blocker> blockers_;
  std::priority_queue<std::pair<Ticks, int>, std::vector<std::pair<Ticks, int>>, std::greater<>>
      heap_;  ///< what waits for nobody
};

// --------------------------------------------------------------------------------------- chains

/// The samples that a way passes through: who reads whom.
using Way = std::vector<std::pair<int, int>>;

/// All ways of a chain, through edges and samples, no component twice.
class Ways {
 public:
  Ways(const World& w, const ChainSpec& chain) : w_(w), chain_(chain) {
    visited_.assign(w.components.size(), 0);
    reads_.resize(w.wcet.size());
    const std::set<std::pair<int, int>> samples(w.app.samples.begin(), w.app.samples.end());
    for (const auto& [u, v] : samples) reads_[at(u)].push_back(v);
    for (std::size_t c = 0; c < w.components.size(); ++c) {
      std::vector<int> enters;
      for (const int i : w.components[c].xnodes)
        if (std::ranges::count(w.app.xnodes[at(i)].sources, chain.from) > 0) enters.push_back(i);
      if (!enters.empty()) visit(static_cast<int>(c), enters);
    }
  }
  [[nodiscard]] bool too_many() const { return visits_ > kMaxWays; }
  [[nodiscard]] const std::vector<Way>& all() const { return all_; }
  [[nodiscard]] const std::set<int>& clocks() const { return clocks_; }

 private:
  void visit(int c, const std::vector<int>& enters) {
    if (++visits_ > kMaxWays) return;
    visited_[at(c)] = 1;
    std::set<int> reached(enters.begin(), enters.end());
    for (const int x : w_.order) {
      if (!reached.contains(x)) continue;
      reached.insert(w_.after[at(x)].begin(), w_.after[at(x)].end());
      if (x == chain_.to) {
        all_.push_back(way_);
        clocks_.insert(w_.components[at(c)].clock);
        for (const auto& [u, v] : way_) clocks_.insert(w_.home(u).clock);
      }
      for (const int v : reads_[at(x)]) {
        if (visited_[at(w_.component_of[at(v)])]) continue;
        way_.emplace_back(x, v);
        visit(w_.component_of[at(v)], {v});
        way_.pop_back();
      }
    }
    visited_[at(c)] = 0;
  }

  const World& w_;
  const ChainSpec& chain_;
  std::vector<std::vector<int>> reads_;
  std::vector<char> visited_;
  Way way_;
  std::vector<Way> all_;
  std::set<int> clocks_;
  std::size_t visits_ = 0;
};

struct Chain {
  std::size_t index = 0;
  std::vector<Way> ways;
  Ticks alone = 0;  ///< the worst case under p
  Ticks worst = 0;  ///< of all walks
};

/// From S and [t', t''] on: the longest from a release whose way meets a job that was walked.
void follow(const Both& both, const Walk& walk, Ticks high, Chain& chain) {
  const ChainSpec& spec = both.p.app.chains[chain.index];
  const SourceSpec& source = both.p.app.sources[at(spec.from)];
  const Ticks offset = source.offset_us * both.p.scale;
  const Ticks period = source.period.num * (both.p.scale / source.period.den);
  // A release that p alone brings through before t'' meets none; those after L are q's alone.
  for (std::int64_t k = floor_div(high - chain.alone - offset, period);
       offset + k * period <= walk.last(); ++k)
    for (const Way& way : chain.ways) {
      std::int64_t n = k;
      for (const auto& [u, v] : way) {
        const Ticks end = walk.end(u, n);
        const Component& to = both.p.home(v);
        n = floor_div(end - both.latest_start[at(v)] - to.phi, to.period);
        while (walk.starts(v, n) < end) ++n;
      }
      chain.worst = std::max(chain.worst, walk.end(spec.to, n) - (offset + k * period));
    }
}

// --------------------------------------------------------------------------------------- clocks

struct Budget {
  std::int64_t jobs = 0;
};

/// All S of a hyperperiod, and all t. False: too many jobs.
bool walk_clock(const Both& both, int clock, Ticks hyperperiod, Ticks notice, Budget& budget,
                std::vector<Chain>& chains, Ticks& settles) {
  const World& p = both.p;
  std::set<Ticks> releases;  // of a hyperperiod
  for (const Component& c : p.components)
    if (c.clock == clock)
      for (std::int64_t n = 0; n < hyperperiod / c.period; ++n) {
        if (static_cast<std::int64_t>(releases.size()) > budget.jobs) return false;
        const Ticks at_phi = c.phi + n * c.period;
        releases.insert(at_phi - floor_div(at_phi, hyperperiod) * hyperperiod);
      }
  Walk walk(both, clock, hyperperiod);
  Ticks before = *releases.rbegin() - hyperperiod;
  for (const Ticks change : releases) {
    // t is in [low, change]; keys of p in between.
    const Ticks low = before - notice;
    std::set<Ticks> cuts = {low, change};
    for (const Component& c : p.components) {
      if (c.clock != clock) continue;
      for (const int i : c.xnodes)
        for (std::int64_t n = ceil_div(change - c.phi, c.period) - 1;; --n) {
          const Ticks key = c.phi + n * c.period + p.window(i, n).d;
          if (key <= low) break;
          if (--budget.jobs < 0) return false;
          if (key < change) cuts.insert(key);
        }
    }
    for (auto cut = cuts.begin(); std::next(cut) != cuts.end(); ++cut) {
      const Ticks high = *std::next(cut);
      const bool done =
          walk.run(change, *cut, high, static_cast<std::size_t>(std::max<Ticks>(0, budget.jobs)));
      budget.jobs -= static_cast<std::int64_t>(walk.jobs());
      if (!done || budget.jobs < 0) return false;
      settles = std::max(settles, walk.span_end() - change);
      for (Chain& chain : chains) follow(both, walk, high, chain);
    }
    before = change;
  }
  return true;
}

/// Why nothing follows for a clock, by both placements alone; empty: something may.
std::string why_unclaimed(const Both& both, const AppSpec& app, int clock) {
  const ClockSpec& spec = app.clocks[at(clock)];
  if (spec.ppm > 0) return fmt::format("clock '{}' has a tolerance of {} ppm", spec.name, spec.ppm);
  std::vector<char> used(both.p.platform.xpus.size(), 0);
  const auto each_use = [&](const auto& visit) {
    for (std::size_t i = 0; i < both.p.wcet.size(); ++i)
      for (const bool of_q : {false, true})
        visit(both.p.home(static_cast<int>(i)).clock, both.of(of_q).policy.placements[i].xpu);
  };
  each_use([&](int other, int xpu) { used[at(xpu)] |= other == clock; });
  std::string why;
  each_use([&](int other, int xpu) {
    if (other != clock && used[at(xpu)] && why.empty())
      why = fmt::format("clock '{}' shares {} with clock '{}'", spec.name,
                        both.p.platform.xpus[at(xpu)].id, app.clocks[at(other)].name);
  });
  return why;
}

/// Its drift left out: what drifts is not claimed, and would only make ticks smaller.
AppSpec without_drift(AppSpec app) {
  for (ClockSpec& clock : app.clocks) clock.ppm = 0;
  return app;
}

/// The same keys for an app that differs in times.
KeyPolicy meant_for(KeyPolicy policy, const AppSpec& app) {
  policy.app = app.name;
  policy.app_hash = app.hash();
  return policy;
}

/// But for WCETs, and times of messages between types that one of them does not have.
bool same(AppSpec a, AppSpec b) {
  const auto lacks = [](const AppSpec& app, const TransferSpec& t) {
    const auto& [u, v] = app.edges[at(t.edge)];
    return !app.xnodes[at(u)].wcet_on(t.from_type) || !app.xnodes[at(v)].wcet_on(t.to_type);
  };
  if (a.edges != b.edges || a.xnodes.size() != b.xnodes.size()) return false;
  for (AppSpec* app : {&a, &b})
    std::erase_if(app->transfers,
                  [&](const TransferSpec& t) { return lacks(a, t) || lacks(b, t); });
  for (AppSpec* app : {&a, &b})
    for (XNodeSpec& x : app->xnodes) {
      x.wcet_us.clear();
      x.real_on.clear();
      x.variants.clear();
    }
  return a == b;
}

Status check_input(const TwoTables& tables, std::int64_t most_jobs) {
  const auto invalid = [](std::string what, std::string where) {
    return fail(ErrorCode::kInvalid, std::move(what), std::move(where));
  };
  if (!same(tables.app_from, tables.app_to) || !same(tables.app_from, tables.app_both))
    return invalid("the apps of both tables differ in more than WCETs",
                   "app '" + tables.app_from.name + "'");
  if (tables.notice_us < 0 || tables.notice_us > kMaxTimeUs || most_jobs < 0)
    return invalid("notice or number of jobs out of range", "change of tables");
  for (const auto& [policy, app] :
       {std::pair(&tables.from, &tables.app_from), std::pair(&tables.to, &tables.app_to)})
    if (policy->app != app->name || policy->app_hash != app->hash())
      return invalid("it is for another app", "policy");
  return {};
}

}  // namespace checking::tables

Result<HandoverProof> derive_handover(const TwoTables& tables, std::int64_t most_jobs) {
  namespace own = checking::tables;
  XAUTO_TRY(own::check_input(tables, most_jobs));
  const AppSpec app_from = own::without_drift(tables.app_from),
                app_to = own::without_drift(tables.app_to),
                app_both = own::without_drift(tables.app_both);
  const KeyPolicy from = own::meant_for(tables.from, app_from),
                  to = own::meant_for(tables.to, app_to),
                  from_both = own::meant_for(tables.from, app_both);
  XAUTO_ASSIGN(const checking::World p, checking::derive(app_from, tables.platform, from));
  XAUTO_ASSIGN(const checking::World q, checking::derive(app_to, tables.platform, to));
  XAUTO_ASSIGN(const checking::World larger,
               checking::structure(app_both, tables.platform, from_both, false));
  for (std::size_t i = 0; i < p.wcet.size(); ++i)
    if (larger.wcet[i] < p.wcet[i])
      return fail(ErrorCode::kInvalid, "its larger WCET is less than that of one table",
                  "XNode '" + p.name(static_cast<int>(i)) + "'");
  own::Both both{p, q, larger.wcet, {}};
  for (std::size_t i = 0; i < p.wcet.size(); ++i) {
    both.latest_start.push_back(0);
    for (const checking::World* w : {&p, &q})
      for (const checking::Window& window : w->windows[i])
        both.latest_start[i] = std::max(both.latest_start[i], window.e);
  }

  HandoverProof proof;
  proof.worst_case_us.resize(app_from.chains.size());
  const auto nothing = [&](std::size_t chain, const std::string& why) {
    proof.worst_case_us[chain].reset();
    proof.why_not.push_back(fmt::format("chain '{}': {}", tables.app_from.chains[chain].name, why));
  };
  if (std::ranges::any_of(app_from.sources,
                          [](const SourceSpec& s) { return s.urgent.has_value(); })) {
    for (std::size_t k = 0; k < app_from.chains.size(); ++k)
      nothing(k, "the app has urgent releases");
    return proof;
  }
  // Chains by clock; those that follow have one.
  std::vector<std::vector<own::Chain>> chains(app_from.clocks.size());
  for (std::size_t k = 0; k < app_from.chains.size(); ++k) {
    XAUTO_ASSIGN(const ChainProof under_p, checking::derive_chain(p, k, false));
    XAUTO_ASSIGN(const ChainProof under_q, checking::derive_chain(q, k, false));
    const own::Ways ways(p, app_from.chains[k]);
    if (ways.too_many()) {
      nothing(k, "it has too many ways");
    } else if (ways.clocks().size() != 1) {
      nothing(k, "it passes through several clocks");
    } else {
      own::Chain chain{k, ways.all(), under_p.derived_us * p.scale, 0};
      chain.worst = std::max(under_p.derived_us, under_q.derived_us) * p.scale;
      chains[at(*ways.clocks().begin())].push_back(std::move(chain));
    }
  }
  own::Budget budget{most_jobs};
  for (std::size_t clock = 0; clock < app_from.clocks.size(); ++clock) {
    checking::Ticks hyperperiod = 1, settles = 0;  // 0: does not fit
    bool used = false;
    for (const checking::World* w : {&p, &q})
      for (const checking::Component& c : w->components) {
        if (c.clock != static_cast<int>(clock)) continue;
        used = true;
        if (hyperperiod > 0) hyperperiod = checking::lcm(hyperperiod, c.pattern());
      }
    if (!used) continue;
    std::string why = own::why_unclaimed(both, tables.app_from, static_cast<int>(clock));
    if (why.empty() && hyperperiod == 0)
      why = fmt::format("the hyperperiod of clock '{}' does not fit", app_from.clocks[clock].name);
    if (why.empty() && !own::walk_clock(both, static_cast<int>(clock), hyperperiod,
                                        tables.notice_us * p.scale, budget, chains[clock], settles))
      why = fmt::format("clock '{}' takes more jobs than are looked at, or does not settle",
                        app_from.clocks[clock].name);
    if (why.empty()) proof.settles_us = std::max(proof.settles_us, p.us_up(settles));
    for (const own::Chain& chain : chains[clock]) {
      if (why.empty())
        proof.worst_case_us[chain.index] = p.us_up(chain.worst);
      else
        nothing(chain.index, why);
    }
  }
  return proof;
}

}  // namespace xauto::solver::steady
