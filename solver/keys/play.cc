// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/play.h"

#include <algorithm>
#include <deque>
#include <queue>

#include <fmt/format.h>

#include "model/early_start.h"
#include "solver/keys/check_world.h"
#include "solver/random.h"

namespace xauto::solver::keys {
namespace playing {

using checking::Component;
using checking::kMillion;
using checking::World;
// 1/(scale * 10^6) us, so that a drift of whole ppm is exact.
using Atoms = std::int64_t;

constexpr std::size_t kMaxPaths = 10'000;
constexpr std::int64_t kMaxUnfinished = 1'000'000;

/// Real time of a clock's grid. For the first half of the play its rate stays at least half of the ppm off,
/// as that of a real clock does, so that phases come round. Then come stretches in which it stays, is as far
/// off as it may be, bends, or changes every second.
class Clock {
 public:
  Clock(Atoms phase, std::int64_t ppm, bool fast, const PlayOptions& options, std::int64_t scale,
        std::uint64_t seed)
      : ppm_(ppm),
        stays_(static_cast<std::size_t>(options.seconds / 2)),
        longest_(std::max<std::int64_t>(1, std::min(options.seconds / 8, kLongestStretch))),
        second_(kMillion * scale),
        random_(seed),
        begins_{phase} {
    const std::int64_t off = random_.below(2) == 0 ? ppm : ppm - draw(ppm / 2);
    from_ = to_ = fast ? off : -off;
  }

  Atoms real(std::int64_t grid) {
    const auto s = static_cast<std::size_t>(grid / second_);
    while (rates_.size() <= s) {
      rates_.push_back(kMillion + next());
      begins_.push_back(begins_.back() + second_ * rates_.back());
    }
    return begins_[s] + grid % second_ * rates_[s];
  }

 private:
  static constexpr std::int64_t kLongestStretch = 10'000;  ///< seconds

  /// 0 to `most`.
  std::int64_t draw(std::int64_t most) {
    return static_cast<std::int64_t>(random_.below(static_cast<std::uint64_t>(most) + 1));
  }
  std::int64_t any() { return draw(2 * ppm_) - ppm_; }

  /// How many ppm it is off in the next second.
  std::int64_t next() {
    if (rates_.size() < stays_) return to_;
    if (at_ == length_) turn();
    ++at_;
    return restless_ ? any() : from_ + (to_ - from_) * at_ / length_;
  }

  void turn() {
    at_ = 0;
    length_ = 1 + draw(longest_ - 1);
    from_ = to_;
    const std::uint64_t kind = random_.below(4);
    restless_ = kind == 0;
    to_ = kind == 1 ? (draw(1) == 0 ? ppm_ : -ppm_) : any();
    if (kind != 3) from_ = to_;
  }

  std::int64_t ppm_;
  std::size_t stays_;     ///< seconds
  std::int64_t longest_;  ///< stretch, in seconds
  std::int64_t second_;
  Random random_;
  std::int64_t from_ = 0, to_ = 0, at_ = 0, length_ = 0;  ///< of the stretch
  bool restless_ = false;
  std::vector<Atoms> begins_;  ///< of each second
  std::vector<std::int64_t> rates_;
};

/// Reaction times of one chain. Of more than so many every second is left out, then every second of the rest.
class Seen {
 public:
  void add(double us) {
    if (count_++ % every_ != 0) return;
    us_.push_back(us);
    if (us_.size() < kMost) return;
    for (std::size_t k = 0; k < kMost / 2; ++k) us_[k] = us_[2 * k];
    us_.resize(kMost / 2);
    every_ *= 2;
  }
  /// 0: none was seen.
  [[nodiscard]] double quantile(double part) {
    if (us_.empty()) return 0;
    const auto k = static_cast<std::ptrdiff_t>(part * static_cast<double>(us_.size() - 1));
    std::nth_element(us_.begin(), us_.begin() + k, us_.end());
    return us_[static_cast<std::size_t>(k)];
  }

 private:
  static constexpr std::size_t kMost = 1 << 18;
  std::int64_t count_ = 0, every_ = 1;
  std::vector<double> us_;
};

/// One way from a chain's source to its XNode.
struct Path {
  std::size_t chain = 0;
  int first = -1;  ///< component that it begins in
  std::vector<std::pair<int, int>> samples;
  /// [sample] what the reader of activation first + k knows: an activation of the first component.
  struct Known {
    std::deque<std::int64_t> activations;
    std::int64_t first = 0;
  };
  std::vector<Known> known;
  std::int64_t last = -1;  ///< newest release that has come through
};

class Play {
 public:
  Play(const World& w, const PlayOptions& options)
      : w_(w), options_(options), random_(options.seed) {
    const std::size_t n = w.wcet.size();
    for (std::size_t c = 0; c < w.app.clocks.size(); ++c) {
      const double phase = options.phases && c > 0 ? random_.unit() : 0;
      clocks_.emplace_back(
          static_cast<Atoms>(phase * static_cast<double>(pattern_of(static_cast<int>(c)))) *
              kMillion,
          options.phases ? w.app.clocks[c].ppm : 0, c % 2 == 1, options, w.scale, random_.next());
    }
    urgent_.resize(w.components.size());
    jobs_.resize(n);
    done_.assign(n, 0);
    left_.resize(w.module_xnodes.size(), 0);
    devices_.resize(w.platform.xpus.size());
    report_.xnodes.resize(n);
    for (PlayedXNode& x : report_.xnodes) x.closest_us = -1e300;
    starts_of_.resize(n);
    ends_of_.resize(n);
    planned_us_ = planned_starts_us(w.app, w.platform, w.policy);
    sampled_.resize(n);
    apart_ = kept_apart(w.app, w.platform, w.policy);
    far_.resize(n);
    for (const auto& [u, v] : w.app.samples) {
      sampled_[at(v)].push_back(u);
      if (const Ticks passes = w.passes(u, v); passes > 0) far_[at(u)].push_back({v, passes, 0});
    }
    released_.assign(w.components.size(), {-1, 0});
    for (std::size_t i = 0; i < n; ++i)
      devices_[at(w.policy.placements[i].xpu)].xnodes.push_back(static_cast<int>(i));
  }

  Status find_paths() {
    for (std::size_t k = 0; k < w_.app.chains.size(); ++k) {
      const ChainSpec& chain = w_.app.chains[k];
      PlayedChain& played = report_.chains.emplace_back();
      played.name = chain.name;
      if (w_.policy.certified) {
        played.claimed_us = w_.policy.chains[k].worst_case_us;
        played.claimed_urgent_us = w_.policy.chains[k].urgent_worst_case_us;
      }
      seen_.emplace_back();
      for (std::size_t c = 0; c < w_.components.size(); ++c) {
        std::vector<int> enters;
        for (const int x : w_.components[c].xnodes)
          if (std::ranges::count(w_.app.xnodes[at(x)].sources, chain.from) > 0) enters.push_back(x);
        std::vector<char> visited(w_.components.size(), 0);
        Path path;
        path.chain = k;
        path.first = static_cast<int>(c);
        if (!enters.empty()) XAUTO_TRY(extend(static_cast<int>(c), enters, visited, path));
      }
    }
    for (std::size_t p = 0; p < paths_.size(); ++p) {
      Path& path = paths_[p];
      path.known.resize(path.samples.size());
      for (std::size_t h = 0; h < path.samples.size(); ++h)
        starts_of_[at(path.samples[h].second)].emplace_back(p, h);
      ends_of_[at(w_.app.chains[path.chain].to)].push_back(p);
    }
    return {};
  }

  PlayReport go() {
    const Atoms end = options_.seconds * kMillion * kMillion * w_.scale;
    for (std::size_t c = 0; c < w_.components.size(); ++c) release(static_cast<int>(c), 0);
    if (w_.app.one_at_a_time) began_.push_back(0);
    while (!events_.empty() && events_.top().when <= end && !report_.backlog) {
      now_ = events_.top().when;
      while (!events_.empty() && events_.top().when == now_) {
        const Event e = events_.top();
        events_.pop();
        if (e.kind == Kind::kEnds)
          ends(e);
        else if (e.kind == Kind::kHeard)
          ++far_[at(e.index)][at(static_cast<int>(e.activation))].there;
        else if (e.kind == Kind::kArrives)
          arrives(e.index, e.activation);
        else if (e.kind == Kind::kPlanned)
          look_at(e.index, e.activation);
        else
          begin(e.index, e.activation);
      }
      if (w_.app.one_at_a_time && unfinished_ == 0) {
        for (std::size_t c = 0; c < w_.components.size(); ++c)
          release(static_cast<int>(c), static_cast<std::int64_t>(began_.size()));
        began_.push_back(now_);
        continue;
      }
      look_early();
      for (std::size_t m = 0; m < devices_.size(); ++m)
        if (devices_[m].look) decide(m);
    }
    for (Device& d : devices_) {
      if (d.busy) d.used += std::max<Atoms>(0, std::min(end, now_) - d.since);
      report_.busy.push_back(now_ > 0 ? static_cast<double>(d.used) / static_cast<double>(now_)
                                      : 0);
    }
    for (std::size_t k = 0; k < seen_.size(); ++k) {
      report_.chains[k].median_us = seen_[k].quantile(0.5);
      report_.chains[k].p99_us = seen_[k].quantile(0.99);
    }
    report_.unfinished = unfinished_;
    return std::move(report_);
  }

 private:
  using Ticks = checking::Ticks;
  enum class Kind : std::uint8_t { kEnds, kHeard, kReleases, kArrives, kPlanned };
  struct Event {
    Atoms when;
    Kind kind;
    int index;                ///< XNode, or component
    std::int64_t activation;  ///< kHeard: which of far_[index]
    std::uint32_t stamp;
    bool operator>(const Event& o) const { return when != o.when ? when > o.when : kind > o.kind; }
  };
  struct Job {
    Atoms key = 0, left = 0;
    Atoms planned = 0;  ///< E: before it, it starts only where the reason for its hold has gone
    int waits = 0;
    bool queued = false, started = false;
  };
  struct Ready {
    Atoms key = 0;  ///< or rank
    int xnode = -1;
    std::int64_t activation = 0;
    Atoms since = 0;     ///< with ranks: when it became ready
    bool above = false;  ///< it has started on a level: nobody of its key is started above it
    bool operator>(const Ready& o) const {
      return key != o.key       ? key > o.key
             : above != o.above ? o.above
             : since != o.since ? since > o.since
             : xnode != o.xnode ? xnode > o.xnode
                                : activation > o.activation;
    }
  };
  struct Device {
    std::priority_queue<Ready, std::vector<Ready>, std::greater<>> ready;
    Ready running;
    bool busy = false, look = false;
    int begun = 0;                                    ///< jobs that have started and not ended
    std::vector<int> xnodes;                          ///< that are on it
    std::vector<std::pair<int, std::int64_t>> early;  ///< jobs that wait for nothing but E
    Atoms since = 0, used = 0;
    std::uint32_t stamp = 0;
  };

  /// After which the clock's releases repeat, or a quarter of the play; at least the longest period of all.
  [[nodiscard]] Ticks pattern_of(int clock) const {
    const Ticks quarter = options_.seconds * (kMillion / 4) * w_.scale;
    Ticks longest = 1, all = 1;
    for (const Component& c : w_.components) {
      longest = std::max(longest, c.period);
      if (c.clock == clock && all > 0) all = checking::lcm(all, c.period);
    }
    return std::max(longest, all == 0 ? quarter : std::min(all, quarter));
  }

  Status extend(int c, const std::vector<int>& enters, std::vector<char>& visited, Path& path) {
    visited[at(c)] = 1;
    std::vector<char> reached(w_.wcet.size(), 0);
    for (const int x : enters) reached[at(x)] = 1;
    for (const int x : w_.order)
      if (reached[at(x)])
        for (const int v : w_.hearers[at(x)]) reached[at(v)] = 1;
    if (reached[at(w_.app.chains[path.chain].to)]) paths_.push_back(path);
    if (paths_.size() > kMaxPaths)
      return fail(ErrorCode::kInvalid, fmt::format("more than {} paths", kMaxPaths),
                  "chain '" + w_.app.chains[path.chain].name + "'",
                  "take out samples that it does not need");
    for (const auto& sample : w_.app.samples) {
      const int next = w_.component_of[at(sample.second)];
      if (!reached[at(sample.first)] || visited[at(next)]) continue;
      path.samples.push_back(sample);
      XAUTO_TRY(extend(next, {sample.second}, visited, path));
      path.samples.pop_back();
    }
    visited[at(c)] = 0;
    return {};
  }

  [[nodiscard]] Atoms atoms(std::int64_t us) const { return us * w_.scale * kMillion; }
  [[nodiscard]] double us(Atoms a) const { return w_.us(a) / static_cast<double>(kMillion); }

  /// `most`, or less where times are random.
  Atoms some(Atoms most, bool random) {
    if (!random || most <= 1) return most;
    return std::max<Atoms>(1, static_cast<Atoms>(static_cast<double>(most) * random_.unit()));
  }

  /// How long activation n of the XNode takes.
  Atoms time_of(int xnode, std::int64_t n) {
    const Atoms most = w_.wcet[at(xnode)] * kMillion;
    if (options_.times_us.empty() || options_.times_us[at(xnode)].empty())
      return some(most, options_.random_times);
    const auto& times = options_.times_us[at(xnode)];
    return std::min(most, atoms(times[static_cast<std::size_t>(n) % times.size()]));
  }

  void release(int component, std::int64_t n) {
    const Component& c = w_.components[at(component)];
    const Atoms when =
        w_.app.one_at_a_time ? now_ : clocks_[at(c.clock)].real(c.phi + n * c.period);
    events_.push({when, Kind::kReleases, component, n, 0});
  }

  /// The nominal release of activation n: its jobs wait for messages, holds and each other.
  void begin(int component, std::int64_t n) {
    const Component& c = w_.components[at(component)];
    std::vector<std::int64_t>& marked = urgent_[at(component)];
    const bool urgent = options_.urgent && c.urgent_source >= 0 &&
                        (marked.empty() || n - marked.back() >= c.urgent_apart) &&
                        random_.unit() < 0.5;
    if (urgent) marked.push_back(n);
    released_[at(component)] = {n, now_};
    for (const int i : c.xnodes) {
      const Atoms sooner = urgent && w_.hears_urgent[at(i)] ? c.urgent_by * kMillion : 0;
      const Placement& p = w_.policy.placements[at(i)];
      const std::size_t j = static_cast<std::size_t>(n) % p.key_us.size();
      Job job;
      job.key = now_ + atoms(p.key_us[j]) - sooner;
      job.left = time_of(i, n);
      // One more, so that nothing is ready before all of it is said.
      job.waits = 1 + static_cast<int>(w_.before[at(i)].size());
      for (const int s : w_.app.xnodes[at(i)].sources) {
        const SourceSpec& source = w_.app.sources[at(s)];
        const Atoms jitter =
            options_.jitter && source.jitter_us > 0 ? some(atoms(source.jitter_us), true) : 0;
        ++job.waits;
        const Atoms due =
            w_.app.one_at_a_time
                ? now_
                : clocks_[at(c.clock)].real(source.offset_us * w_.scale + n * c.period);
        events_.push({due + jitter, Kind::kArrives, i, n, 0});
      }
      if (const auto& planned = (urgent ? planned_us_.urgent : planned_us_.ordinary)[at(i)];
          !planned.empty()) {
        job.planned = now_ + atoms(planned[static_cast<std::size_t>(n) % planned.size()]);
        events_.push({job.planned, Kind::kPlanned, i, n, 0});
      }
      jobs_[at(i)].push_back(job);
      events_.push({now_, Kind::kArrives, i, n, 0});
    }
    unfinished_ += static_cast<std::int64_t>(c.xnodes.size());
    report_.backlog = unfinished_ > kMaxUnfinished;
    if (!w_.app.one_at_a_time) release(component, n + 1);
  }

  Job& job(int xnode, std::int64_t n) {
    return jobs_[at(xnode)][static_cast<std::size_t>(n - done_[at(xnode)])];
  }

  void arrives(int xnode, std::int64_t n) {
    --job(xnode, n).waits;
    look_at(xnode, n);
  }

  /// Queues activation n of the XNode if nothing is in its way any more.
  void look_at(int xnode, std::int64_t n) {
    if (done_[at(xnode)] != n || jobs_[at(xnode)].empty()) return;
    Job& j = job(xnode, n);
    const int m = w_.module_of[at(xnode)];
    if (j.waits > 0 || j.queued || (w_.entry[at(xnode)] && left_[at(m)] + w_.in_flight[at(m)] <= n))
      return;
    if (now_ < j.planned && !may_start_early(xnode, j)) {
      auto& early = devices_[at(w_.policy.placements[at(xnode)].xpu)].early;
      if (std::ranges::find(early, std::pair(xnode, n)) == early.end())
        early.emplace_back(xnode, n);
      return;
    }
    j.queued = true;
    Device& d = devices_[at(w_.policy.placements[at(xnode)].xpu)];
    if (options_.rank.empty())
      d.ready.push({j.key, xnode, n, 0});
    else
      d.ready.push({options_.rank[at(xnode)], xnode, n, now_});
    d.look = true;
  }

  /// The earliest at which the first activation of `x` that has not ended is released, and its key.
  [[nodiscard]] std::pair<Atoms, Atoms> first_open(int x) const {
    const std::int64_t n = done_[at(x)];
    const auto& [last, when] = released_[at(w_.component_of[at(x)])];
    const Component& c = w_.home(x);
    const Placement& p = w_.policy.placements[at(x)];
    if (n <= last) return {0, jobs_[at(x)].front().key};
    // Not released: its clock may be fast.
    const Atoms release =
        when + (n - last) * c.period * (kMillion - w_.app.clocks[at(c.clock)].ppm);
    const Atoms sooner = w_.hears_urgent[at(x)] ? c.urgent_by * kMillion : 0;
    return {release,
            release + atoms(p.key_us[static_cast<std::size_t>(n) % p.key_us.size()]) - sooner};
  }

  /// A run knows nothing of the keys to come of another one.
  [[nodiscard]] bool of_another_app(int x, int xnode) const {
    return !options_.app_of.empty() && options_.app_of[at(x)] != options_.app_of[at(xnode)];
  }

  /// docs/keys.md, "Early start".
  [[nodiscard]] bool may_start_early(int xnode, const Job& j) const {
    if (w_.app.one_at_a_time)
      return false;  // as in a run: when the next release comes nobody knows
    const auto m = at(w_.policy.placements[at(xnode)].xpu);
    const Xpu& xpu = w_.platform.xpus[m];
    if (!xpu.preemptive || xpu.preempt_us > 0 || xpu.levels > 0)
      for (const int x : devices_[m].xnodes)
        if (x != xnode &&
            (of_another_app(x, xnode) ? xpu.preemptive : first_open(x).second <= j.key))
          return false;
    for (const int x : apart_[at(xnode)])
      if (first_open(x).second <= j.planned) return false;
    for (const int u : sampled_[at(xnode)]) {
      if (w_.passes(u, xnode) > 0) return false;  // nobody tells whether it is there
      const auto [release, key] = first_open(u);
      const bool all =
          w_.policy.placements[at(xnode)].reads_all && w_.home(u).clock != w_.home(xnode).clock;
      if (key <= j.planned || (all && release < j.planned)) return false;
    }
    return true;
  }

  /// Something has ended, so that others may be the first on their XPUs, or read all that their plan reads.
  void look_early() {
    if (!ended_) return;
    ended_ = false;
    for (Device& d : devices_) {
      const auto waiting = std::exchange(d.early, {});
      for (const auto& [xnode, n] : waiting) look_at(xnode, n);
    }
  }

  void ends(const Event& e) {
    Device& d = devices_[at(w_.policy.placements[at(e.index)].xpu)];
    if (!d.busy || d.stamp != e.stamp) return;
    ended_ = true;
    d.busy = false;
    --d.begun;
    d.look = true;
    d.used += now_ - d.since;
    const Job j = job(e.index, e.activation);
    count(e, j);
    jobs_[at(e.index)].pop_front();
    ++done_[at(e.index)];
    --unfinished_;
    for (const int v : w_.after[at(e.index)])
      for (const auto& [u, transfer] : w_.before[at(v)])
        if (u == e.index)
          events_.push({now_ + transfer * kMillion, Kind::kArrives, v, e.activation, 0});
    for (std::size_t s = 0; s < far_[at(e.index)].size(); ++s)
      events_.push({now_ + far_[at(e.index)][s].passes * kMillion, Kind::kHeard, e.index,
                    static_cast<std::int64_t>(s), 0});
    look_at(e.index, e.activation + 1);
    const int m = w_.module_of[at(e.index)];
    std::int64_t left = done_[at(e.index)];
    for (const int x : w_.module_xnodes[at(m)]) left = std::min(left, done_[at(x)]);
    if (left == left_[at(m)]) return;
    left_[at(m)] = left;
    for (const int x : w_.module_xnodes[at(m)])
      if (w_.entry[at(x)]) look_at(x, done_[at(x)]);
  }

  void count(const Event& e, const Job& j) {
    PlayedXNode& x = report_.xnodes[at(e.index)];
    ++x.jobs;
    ++report_.jobs;
    x.closest_us = std::max(x.closest_us, us(now_ - j.key));
    if (now_ > j.key) {
      ++x.late;
      ++report_.late;
      if (report_.first_late.empty())
        report_.first_late =
            fmt::format("XNode '{}', activation {}, ends {:.3f} us after its key, at {:.3f} us",
                        w_.name(e.index), e.activation, us(now_ - j.key), us(now_));
    }
    for (const std::size_t p : ends_of_[at(e.index)]) {
      Path& path = paths_[p];
      std::int64_t knows = e.activation;
      if (!path.known.empty()) knows = known(path.known.back(), e.activation);
      if (knows < 0) continue;
      // The oldest of those that come through now has waited longest.
      if ((path.last >= 0 || w_.app.one_at_a_time) && knows > path.last) {
        const SourceSpec& source = w_.app.sources[at(w_.app.chains[path.chain].from)];
        const Ticks period = source.period.num * (w_.scale / source.period.den);
        PlayedChain& chain = report_.chains[path.chain];
        const auto since = [&](std::int64_t k) {
          if (w_.app.one_at_a_time) return us(now_ - began_[static_cast<std::size_t>(k)]);
          return us(now_ -
                    clocks_[at(source.clock)].real(source.offset_us * w_.scale + k * period));
        };
        chain.releases += knows - path.last;
        chain.longest_us = std::max(chain.longest_us, since(path.last + 1));
        for (std::int64_t k = path.last + 1; k <= knows; ++k) seen_[path.chain].add(since(k));
        if (source.urgent) {
          const std::vector<std::int64_t>& marked = urgent_[at(path.first)];
          auto k = std::ranges::upper_bound(marked, path.last);
          if (k != marked.end() && *k <= knows)
            chain.longest_urgent_us = std::max(chain.longest_urgent_us, since(*k));
          for (; k != marked.end() && *k <= knows; ++k) ++chain.urgent;
        }
      }
      path.last = std::max(path.last, knows);
    }
  }

  /// What `activation` of a reader knows; what is older is forgotten. -1: nothing.
  static std::int64_t known(Path::Known& all, std::int64_t activation) {
    while (all.first < activation) {
      all.activations.pop_front();
      ++all.first;
    }
    return all.activations.front();
  }

  /// So many results of the first of `sample` are where the second reads them.
  [[nodiscard]] std::int64_t there(const std::pair<int, int>& sample) const {
    for (const Far& far : far_[at(sample.first)])
      if (far.reader == sample.second) return far.there;
    return done_[at(sample.first)];
  }

  /// The reader reads: the newest result that is there, along each path.
  void read(int xnode) {
    for (const auto& [p, h] : starts_of_[at(xnode)]) {
      Path& path = paths_[p];
      const std::int64_t newest = there(path.samples[h]) - 1;
      std::int64_t knows = newest;
      if (h > 0 && newest >= 0) knows = known(path.known[h - 1], newest);
      path.known[h].activations.push_back(knows);
    }
  }

  void decide(std::size_t m) {
    Device& d = devices_[m];
    d.look = false;
    if (d.ready.empty()) return;
    const Ready next = d.ready.top();
    Job& j = job(next.xnode, next.activation);
    const Xpu& xpu = w_.platform.xpus[m];
    // The hardware has gone back to the job below by the time that the next one comes.
    const bool above = xpu.levels > 0 && d.begun > 0;
    const bool preempts = d.busy || above;
    if (d.busy) {
      if (!xpu.preemptive || next.key >= d.running.key) return;
      if (xpu.levels > 0 && d.begun >= xpu.levels) return;
      job(d.running.xnode, d.running.activation).left -= now_ - d.since;
      d.used += now_ - d.since;
      ++report_.suspended;
      ++report_.xnodes[at(d.running.xnode)].suspended;
      d.ready.pop();
      d.ready.push(d.running);
    } else {
      d.ready.pop();
    }
    if (!j.started) {
      if (preempts) j.left += atoms(xpu.preempt_us);
      ++d.begun;
      read(next.xnode);
    }
    j.started = true;
    d.busy = true;
    d.running = next;
    d.running.above = xpu.levels > 0;
    d.since = now_;
    events_.push({now_ + j.left, Kind::kEnds, next.xnode, next.activation, ++d.stamp});
  }

  const World& w_;
  const PlayOptions& options_;
  Random random_;
  std::vector<Clock> clocks_;
  std::vector<Path> paths_;
  std::vector<Seen> seen_;  ///< [chain]
  std::vector<std::vector<std::pair<std::size_t, std::size_t>>>
      starts_of_;                                  ///< [reader] path, sample
  std::vector<std::vector<std::size_t>> ends_of_;  ///< [XNode] paths
  std::vector<std::vector<std::int64_t>> urgent_;  ///< [component] its urgent releases
  std::vector<std::deque<Job>> jobs_;              ///< [xnode] released, not ended, in order
  std::vector<std::int64_t> done_;                 ///< [xnode] activations that have ended
  std::vector<std::int64_t> left_;                 ///< [module] activations that have left
  std::vector<Device> devices_;
  std::priority_queue<Event, std::vector<Event>, std::greater<>> events_;
  PlannedStarts planned_us_;
  std::vector<std::vector<int>> sampled_;  ///< [xnode] what it reads
  std::vector<std::vector<int>> apart_;    ///< [xnode] of kept_apart
  /// Who samples it on another host.
  struct Far {
    int reader;
    Ticks passes;
    std::int64_t there;  ///< results that have arrived
  };
  std::vector<std::vector<Far>> far_;  ///< [xnode]
  std::vector<std::pair<std::int64_t, Atoms>>
      released_;              ///< [component] the last release, and when
  std::vector<Atoms> began_;  ///< [release] when, of an app that releases one at a time
  bool ended_ = false;        ///< a job, since the last look_early()
  Atoms now_ = 0;
  std::int64_t unfinished_ = 0;
  PlayReport report_;
};

}  // namespace playing

namespace {

/// By its priorities. Its keys are those of nobody: no job is late.
Result<PlayReport> play_priorities(const AppSpec& app, const Platform& platform, Policy policy,
                                   PlayOptions options) {
  XAUTO_TRY(validate(policy, app, platform));
  options.rank.clear();
  for (Placement& placed : policy.placements) {
    options.rank.push_back(-*placed.priority);
    placed.priority.reset();
    placed.key_us = {kMaxPeriodUs};
  }
  return play(app, platform, policy, options);
}

}  // namespace

Result<PlayReport> play(const AppSpec& app, const Platform& platform, const Policy& policy,
                        const PlayOptions& options) {
  if (policy.by_priority()) return play_priorities(app, platform, policy, options);
  XAUTO_ASSIGN(const checking::World w, checking::structure(app, platform, policy, false));
  if (policy.certified && policy.chains.size() != app.chains.size())
    return fail(ErrorCode::kInvalid,
                fmt::format("{} chains, the app has {}", policy.chains.size(), app.chains.size()),
                "policy");
  if (!options.rank.empty() && options.rank.size() != app.xnodes.size())
    return fail(ErrorCode::kInvalid, fmt::format("{} ranks", options.rank.size()), "rank",
                fmt::format("one for each of {} XNodes", app.xnodes.size()));
  // What has its end after `seconds` is released before; a clock may be slow.
  std::int64_t longest = options.seconds * checking::kMillion;
  for (const SourceSpec& s : app.sources) longest = std::max({longest, s.offset_us, s.jitter_us});
  for (const Xpu& x : platform.xpus) longest = std::max(longest, x.preempt_us);
  for (const TransferSpec& t : app.transfers) longest = std::max(longest, t.transfer_us);
  for (const Crossing& c : policy.crossings) longest = std::max(longest, c.x_us);
  for (const checking::Ticks t : w.wcet) longest = std::max(longest, w.us_up(t));
  for (const Placement& p : policy.placements)
    for (const auto* times : {&p.key_us, &p.hold_us})
      for (const std::int64_t t : *times) longest = std::max(longest, t);
  if (options.seconds < 1 || longest > (std::int64_t{1} << 59) / checking::kMillion / w.scale)
    return fail(ErrorCode::kInvalid, fmt::format("{} s cannot be played", options.seconds),
                "seconds",
                fmt::format("1 to {}", (std::int64_t{1} << 59) / checking::kMillion /
                                           checking::kMillion / w.scale));
  playing::Play play(w, options);
  XAUTO_TRY(play.find_paths());
  return play.go();
}

}  // namespace xauto::solver::keys
