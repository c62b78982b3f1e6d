// SPDX-License-Identifier: Apache-2.0
#include "attack/attack.h"

#include <algorithm>
#include <climits>
#include <map>
#include <numeric>
#include <queue>
#include <set>
#include <utility>
#include <vector>

namespace xauto::attack {
namespace {

// 1/(scale * 10^6) us: a drift of whole ppm is exact.
using Atoms = std::int64_t;
constexpr std::int64_t kMillion = 1'000'000;

std::size_t at(std::int64_t i) {
  return static_cast<std::size_t>(i);
}

class Dice {
 public:
  explicit Dice(std::uint64_t seed) : s_(seed * 0x9e3779b97f4a7c15u + 0x1234567) {}
  std::int64_t roll(std::int64_t n) {  // 0..n
    s_ ^= s_ << 13;
    s_ ^= s_ >> 7;
    s_ ^= s_ << 17;
    return static_cast<std::int64_t>((s_ >> 11) % static_cast<std::uint64_t>(n + 1));
  }
  bool coin() { return roll(1) == 1; }

 private:
  std::uint64_t s_;
};

/// All that chance, or an adversary, decides. Parts of 255.
struct Fate {
  std::vector<std::vector<std::uint8_t>> run;  ///< [xnode][activation] of the WCET
  std::vector<std::vector<std::uint8_t>>
      early;  ///< [xnode][activation] above 0: if it may, it starts early
  std::vector<std::vector<std::uint8_t>> jitter;  ///< [source][release] of the jitter
  std::vector<std::vector<std::uint8_t>> urgent;  ///< [source][release] above 0: if it may
  std::vector<Atoms> phase;                       ///< [clock]
  std::vector<std::int64_t> drift, later_drift;   ///< [clock] ppm, before and after `turn`
  std::vector<std::int64_t> turn;                 ///< [clock] 1/scale us
  bool ties_up = false;
};

struct Hop {
  int from, to;
};
struct Path {
  int chain, component;
  std::vector<Hop> hops;
};

class World {
 public:
  World(const AppSpec& app, const Platform& platform, const Policy& policy, const Options& options)
      : app_(app),
        platform_(platform),
        policy_(policy),
        early_(options.early),
        app_of_(options.app_of) {
    for (const SourceSpec& s : app.sources) scale_ = std::lcm(scale_, s.period.den);
    const std::size_t n = app.xnodes.size();
    group_.resize(n);
    std::iota(group_.begin(), group_.end(), 0);
    for (bool more = true; more;) {
      more = false;
      const auto join = [&](std::size_t u, std::size_t v) {
        const int low = std::min(group_[u], group_[v]);
        more = more || group_[u] != low || group_[v] != low;
        group_[u] = group_[v] = low;
      };
      for (const auto& [u, v] : app.edges) join(at(u), at(v));
      for (std::size_t u = 0; u < n; ++u)
        for (std::size_t v = u + 1; v < n; ++v)
          if (app.xnodes[u].module == app.xnodes[v].module) join(u, v);
    }
    base_.assign(n, INT64_MAX);
    period_.assign(n, 0);
    clock_.assign(n, 0);
    for (std::size_t i = 0; i < n; ++i)
      for (const int s : app.xnodes[i].sources) {
        const SourceSpec& source = app.sources[at(s)];
        const std::size_t g = at(group_[i]);
        base_[g] = std::min(base_[g], source.offset_us * scale_);
        period_[g] = source.period.num * (scale_ / source.period.den);
        clock_[g] = source.clock;
      }
    edges_in_.resize(n);
    edges_out_.resize(n);
    inner_.assign(n, 0);
    for (std::size_t e = 0; e < app.edges.size(); ++e) {
      const auto& [u, v] = app.edges[e];
      Atoms transfer = 0;
      for (const TransferSpec& t : app.transfers)
        if (at(t.edge) == e && t.from_type == type(u) && t.to_type == type(v))
          transfer = std::max(transfer, atoms(t.transfer_us));
      edges_out_[at(u)].push_back({v, transfer});
      ++edges_in_[at(v)];
      if (app.xnodes[at(u)].module == app.xnodes[at(v)].module) inner_[at(v)] = 1;
    }
    // Order: the message without a message.
    for (const auto& [u, v] : policy.order) {
      edges_out_[at(u)].push_back({v, 0});
      ++edges_in_[at(v)];
    }
    for (std::size_t i = 0; i < n; ++i) {
      std::vector<int> mates;
      for (std::size_t k = 0; k < n; ++k)
        if (app.xnodes[k].module == app.xnodes[i].module) mates.push_back(static_cast<int>(k));
      mates_.push_back(mates);
      std::int64_t states = 1;
      for (const ModuleSpec& m : app.modules)
        if (m.name == app.xnodes[i].module) states = m.max_in_flight;
      states_.push_back(states);
      const Placement& p = policy.placements[i];
      wcet_.push_back(std::max(takes(i, std::vector<char>(platform.xpus.size(), 0)),
                               atoms(p.wcet_us.value_or(0))));
    }
    for (const SourceSpec& s : app.sources) {
      std::vector<char> hears(n, 0);
      const std::string marks = s.urgent ? s.urgent->marked_by : "";
      for (std::size_t i = 0; i < n; ++i)
        for (const int heard : app.xnodes[i].sources)
          if (&app.sources[at(heard)] == &s && s.urgent && marks.empty()) hears[i] = 1;
      // What a module marks is urgent for whoever comes after it.
      for (const auto& [u, v] : app.edges)
        if (!marks.empty() && app.xnodes[at(u)].module == marks &&
            app.xnodes[at(v)].module != marks)
          hears[at(v)] = 1;
      for (bool more = true; more;) {
        more = false;
        for (const auto& [u, v] : app.edges)
          if (hears[at(u)] && !hears[at(v)]) hears[at(v)] = 1, more = true;
      }
      hurries_.push_back(std::move(hears));
    }
    for (std::size_t c = 0; c < app.chains.size(); ++c)
      for (std::size_t g = 0; g < n; ++g)
        if (period_[g] > 0 && group_[g] == static_cast<int>(g)) {
          std::vector<char> reach(n, 0);
          bool any = false;
          for (std::size_t i = 0; i < n; ++i)
            if (group_[i] == static_cast<int>(g) &&
                std::ranges::count(app.xnodes[i].sources, app.chains[c].from) > 0)
              reach[i] = 1, any = true;
          std::set<int> seen = {static_cast<int>(g)};
          std::vector<Hop> hops;
          if (any) find_paths(static_cast<int>(c), static_cast<int>(g), reach, seen, hops);
        }
  }

  [[nodiscard]] Atoms atoms(std::int64_t us) const { return us * scale_ * kMillion; }
  [[nodiscard]] double us(Atoms a) const {
    return static_cast<double>(a) / static_cast<double>(scale_) / 1e6;
  }
  [[nodiscard]] const std::string& type(int i) const {
    return platform_.xpus[at(policy_.placements[at(i)].xpu)].type;
  }
  /// The planned start: no sooner by the proof. Of what its XNode waits for, with transfers; holds of whoever hears an
  /// urgent release are sooner.
  [[nodiscard]] Atoms planned(std::size_t i, std::int64_t k, bool urgent) const {
    const Placement& p = policy_.placements[i];
    Atoms start = 0, sooner = 0;
    for (const int s : app_.xnodes[i].sources)
      start = std::max(start,
                       (app_.sources[at(s)].offset_us * scale_ - base_[at(group_[i])]) * kMillion);
    for (std::size_t s = 0; s < hurries_.size() && urgent; ++s)
      if (hurries_[s][i]) sooner = atoms(app_.sources[s].urgent->by_us);
    if (!p.hold_us.empty())
      start = std::max(start, atoms(p.hold_us[at(k) % p.hold_us.size()]) - sooner);
    for (std::size_t u = 0; u < edges_out_.size(); ++u)
      for (const auto& [v, transfer] : edges_out_[u])
        if (at(v) == i && early_ != Early::kFromItsHold)
          start = std::max(start, planned(u, k, urgent) + transfer);
    return start;
  }
  /// Beside the XPUs that it has met: the least of what is stated beside at least these.
  [[nodiscard]] Atoms takes(std::size_t i, const std::vector<char>& met) const {
    const XNodeSpec& x = app_.xnodes[i];
    const std::string& own = type(static_cast<int>(i));
    std::map<std::string, std::int64_t> many;
    for (std::size_t m = 0; m < met.size(); ++m)
      if (met[m]) ++many[platform_.xpus[m].type];
    // Loads of types that it does not state change nothing.
    std::erase_if(many, [&](const auto& load) {
      return std::ranges::none_of(x.beside, [&](const BesideSpec& b) {
        return b.on == own && b.load.contains(load.first);
      });
    });
    std::int64_t least = many.empty() ? x.wcet_us.find(own)->second : INT64_MAX;
    for (const BesideSpec& b : x.beside) {
      bool fits = b.on == own;
      for (const auto& [type, count] : many)
        fits = fits && b.load.contains(type) && b.load.find(type)->second >= count;
      if (fits) least = std::min(least, b.wcet_us);
    }
    return atoms(least);
  }
  /// The other XPUs matter to it, or it to them.
  [[nodiscard]] bool keeps_apart(std::size_t i, std::size_t u) const {
    const auto minds = [&](std::size_t x, std::size_t y) {
      return std::ranges::any_of(app_.xnodes[x].beside, [&](const BesideSpec& b) {
        return b.on == type(static_cast<int>(x)) && b.load.contains(type(static_cast<int>(y)));
      });
    };
    return policy_.placements[i].xpu != policy_.placements[u].xpu && clock(i) == clock(u) &&
           (minds(i, u) || minds(u, i));
  }
  [[nodiscard]] std::int64_t period(std::size_t i) const { return period_[at(group_[i])]; }
  [[nodiscard]] int clock(std::size_t i) const { return clock_[at(group_[i])]; }
  [[nodiscard]] Atoms real(int clock, std::int64_t grid, const Fate& f) const {
    const std::size_t c = at(clock);
    if (grid <= f.turn[c]) return f.phase[c] + grid * (kMillion + f.drift[c]);
    return f.phase[c] + f.turn[c] * (kMillion + f.drift[c]) +
           (grid - f.turn[c]) * (kMillion + f.later_drift[c]);
  }
  [[nodiscard]] Atoms nominal(std::size_t i, std::int64_t n, const Fate& f) const {
    return real(clock(i), base_[at(group_[i])] + n * period(i), f);
  }

  void find_paths(int chain, int component, std::vector<char> reach, const std::set<int>& seen,
                  std::vector<Hop>& hops) {
    if (paths_.size() > 200) return;
    for (bool more = true; more;) {
      more = false;
      for (const auto& [u, v] : app_.edges)
        if (reach[at(u)] && !reach[at(v)]) reach[at(v)] = 1, more = true;
    }
    if (reach[at(app_.chains[at(chain)].to)]) paths_.push_back({chain, component, hops});
    for (const auto& [u, v] : app_.samples) {
      if (!reach[at(u)] || seen.contains(group_[at(v)])) continue;
      std::vector<char> next(reach.size(), 0);
      next[at(v)] = 1;
      std::set<int> more = seen;
      more.insert(group_[at(v)]);
      hops.push_back({u, v});
      find_paths(chain, component, next, more, hops);
      hops.pop_back();
    }
  }

  const AppSpec& app_;
  const Platform& platform_;
  const Policy& policy_;
  Early early_;
  std::vector<int> app_of_;  ///< Options::app_of
  std::int64_t scale_ = 1;
  std::vector<int> group_;                   ///< [xnode] least XNode of its component
  std::vector<std::int64_t> base_, period_;  ///< [that] 1/scale us
  std::vector<int> clock_;
  std::vector<int> edges_in_;
  std::vector<std::vector<std::pair<int, Atoms>>> edges_out_;
  std::vector<char> inner_;  ///< has a predecessor in its module
  std::vector<std::vector<int>> mates_;
  std::vector<std::int64_t> states_;
  std::vector<Atoms> wcet_;
  std::vector<Path> paths_;
  std::vector<std::vector<char>> hurries_;  ///< [source][xnode] an urgent release of it
};

struct Outcome {
  Atoms late = INT64_MIN;  ///< end - key of the latest job
  int xnode = -1;
  std::int64_t activation = -1;
  std::vector<Atoms> late_of;  ///< [xnode]
  std::vector<std::int64_t> late_at;
  std::vector<Atoms> over;       ///< [chain] latency - claim
  std::vector<Atoms> over_when;  ///< [chain] when it ended
};

class Run {
 public:
  Run(const World& w, const Fate& f) : w_(w), f_(f) {}

  Outcome go() {
    const std::size_t n = w_.wcet_.size();
    jobs_.resize(n);
    gone_.resize(n);
    mark();
    for (std::size_t i = 0; i < n; ++i) {
      const auto count = static_cast<std::int64_t>(f_.run[i].size());
      jobs_[i].resize(at(count));
      gone_[i].assign(at(count), static_cast<int>(w_.mates_[i].size()));
      const Placement& p = w_.policy_.placements[i];
      for (std::int64_t k = 0; k < count; ++k) {
        Job& job = jobs_[i][at(k)];
        const Atoms release = w_.nominal(i, k, f_);
        const std::size_t j = at(k) % p.key_us.size();
        const Atoms sooner = hurry(i, k);
        job.key = release + w_.atoms(p.key_us[j]) - sooner;
        job.release = release;
        job.planned = release + w_.planned(i, k, sooner > 0);
        job.met.assign(w_.platform_.xpus.size(), 0);
        job.most = w_.wcet_[i];
        job.left = part_of(job.most, i, k);
        job.waits = w_.edges_in_[i] + static_cast<int>(w_.app_.xnodes[i].sources.size()) +
                    (k > 0 ? 1 : 0) + (!w_.inner_[i] && k >= w_.states_[i] ? 1 : 0);
        push(job.planned, kPlanned, i, k);
        for (const int s : w_.app_.xnodes[i].sources) {
          const SourceSpec& source = w_.app_.sources[at(s)];
          const auto& jitter = f_.jitter[at(s)];
          push(w_.real(source.clock, source.offset_us * w_.scale_ + k * w_.period(i), f_) +
                   w_.atoms(source.jitter_us) / 255 * jitter[at(k) % jitter.size()],
               kArrives, i, k);
        }
      }
    }
    xpus_.resize(w_.platform_.xpus.size());
    while (!events_.empty()) {
      now_ = events_.top().when;
      while (!events_.empty() && events_.top().when == now_) {
        const Event e = events_.top();
        events_.pop();
        if (e.kind == kEnds)
          ends(e);
        else if (e.kind == kPlanned)
          look(e.xnode, e.activation);
        else
          arrives(e.xnode, e.activation);
      }
      // Whoever waits for nothing but its planned start.
      for (auto waiting = std::exchange(early_, {}); const auto& [i, k] : waiting) look(i, k);
      for (std::size_t m = 0; m < xpus_.size(); ++m)
        if (xpus_[m].look) decide(m);
    }
    return judge();
  }

 private:
  enum Kind : std::uint8_t { kEnds, kArrives, kPlanned };
  struct Event {
    Atoms when;
    Kind kind;
    std::uint32_t stamp;
    int xnode;
    std::int64_t activation;
    bool operator>(const Event& o) const { return when != o.when ? when > o.when : kind > o.kind; }
  };
  struct Job {
    Atoms release = 0, key = 0, planned = 0, left = 0, start = -1, end = -1;
    Atoms most = 0;         ///< what it may take by now
    std::vector<char> met;  ///< [XPU] a job there has run while it did
    int waits = 0;
    bool queued = false;
  };
  struct Ready {
    Atoms key;
    int tie, xnode;
    std::int64_t activation;
    bool operator>(const Ready& o) const {
      return key != o.key ? key > o.key : tie != o.tie ? tie > o.tie : activation > o.activation;
    }
  };
  struct Device {
    std::priority_queue<Ready, std::vector<Ready>, std::greater<>> ready;
    bool busy = false, look = false;
    int open = 0;  ///< jobs that have started and not ended
    Ready running{};
    Atoms since = 0;
    std::uint32_t stamp = 0;
  };

  /// Which releases are urgent: those that fate wants, where they are not too soon.
  void mark() {
    for (std::size_t s = 0; s < w_.app_.sources.size(); ++s) {
      const SourceSpec& source = w_.app_.sources[s];
      urgent_.emplace_back();
      if (!source.urgent) continue;
      const std::int64_t period = source.period.num * (w_.scale_ / source.period.den);
      std::int64_t since = INT64_MAX / 2;
      for (const std::uint8_t wanted : f_.urgent[s]) {
        const bool is = wanted > 0 && since >= source.urgent->every_us * w_.scale_;
        urgent_.back().push_back(is);
        since = (is ? 0 : since) + period;
      }
    }
  }
  [[nodiscard]] Atoms hurry(std::size_t i, std::int64_t k) const {
    for (std::size_t s = 0; s < urgent_.size(); ++s)
      if (w_.hurries_[s][i] && at(k) < urgent_[s].size() && urgent_[s][at(k)])
        return w_.atoms(w_.app_.sources[s].urgent->by_us);
    return 0;
  }

  void push(Atoms when, Kind kind, std::size_t i, std::int64_t k, std::uint32_t stamp = 0) {
    events_.push({when, kind, stamp, static_cast<int>(i), k});
  }

  void arrives(int i, std::int64_t k) {
    --jobs_[at(i)][at(k)].waits;
    look(i, k);
  }

  /// All of `x` that `matters` have ended. Its releases and keys do not fall.
  template <typename Matters>
  bool ended(std::size_t x, const Matters& matters) const {
    for (const Job& job : jobs_[x]) {
      if (job.end >= 0) continue;
      return !matters(job);
    }
    return true;
  }

  [[nodiscard]] bool of_another_app(std::size_t x, std::size_t i) const {
    return !w_.app_of_.empty() && w_.app_of_[x] != w_.app_of_[i];
  }

  /// The rule of docs/keys.md, by whoever knows all that is to come: nobody may do more.
  bool may_start_early(std::size_t i, const Job& job) const {
    const std::size_t m = at(w_.policy_.placements[i].xpu);
    const Xpu& xpu = w_.platform_.xpus[m];
    for (std::size_t x = 0; x < jobs_.size(); ++x)
      if (x != i && at(w_.policy_.placements[x].xpu) == m &&
          (!xpu.preemptive || xpu.preempt_us > 0 || xpu.levels > 0) &&
          !(of_another_app(x, i) ? !xpu.preemptive || w_.early_ == Early::kOfItsApp
                                 : ended(x, [&](const Job& other) {
                                     const bool released = other.release <= now_;
                                     if (w_.early_ == Early::kByTheSequence)
                                       return released && other.planned < job.planned;
                                     return other.key <= job.key &&
                                            (released || w_.early_ != Early::kOfTheReleased);
                                   })))
        return false;
    for (std::size_t x = 0; x < jobs_.size(); ++x)
      if (w_.early_ != Early::kOfItsXpu && w_.keeps_apart(i, x) &&
          !ended(x, [&](const Job& other) { return other.key <= job.planned; }))
        return false;
    if (w_.early_ == Early::kWithoutSamples) return true;
    for (const auto& [u, v] : w_.app_.samples)
      if (at(v) == i && !ended(at(u), [&](const Job& other) {
            return other.key <= job.planned &&
                   (other.release <= now_ || w_.early_ != Early::kOfTheReleased);
          }))
        return false;
    return true;
  }

  void look(int i, std::int64_t k) {
    Job& job = jobs_[at(i)][at(k)];
    if (job.waits > 0 || job.queued) return;
    const bool may = f_.early[at(i)][at(k)] > 0 && w_.early_ != Early::kNever;
    if (now_ < job.planned && (!may || !may_start_early(at(i), job))) {
      if (may) early_.emplace_back(i, k);
      return;
    }
    job.queued = true;
    Device& device = xpus_[at(w_.policy_.placements[at(i)].xpu)];
    device.ready.push({jobs_[at(i)][at(k)].key, f_.ties_up ? i : -i, i, k});
    device.look = true;
  }

  void ends(const Event& e) {
    Device& device = xpus_[at(w_.policy_.placements[at(e.xnode)].xpu)];
    if (!device.busy || device.stamp != e.stamp) return;
    device.busy = false;
    --device.open;
    device.look = true;
    jobs_[at(e.xnode)][at(e.activation)].end = now_;
    for (const auto& [v, transfer] : w_.edges_out_[at(e.xnode)])
      if (transfer == 0)
        arrives(v, e.activation);
      else
        push(now_ + transfer, kArrives, at(v), e.activation);
    if (at(e.activation) + 1 < jobs_[at(e.xnode)].size()) arrives(e.xnode, e.activation + 1);
    // Per module: counted with the first of its XNodes.
    const auto& mates = w_.mates_[at(e.xnode)];
    if (--gone_[at(mates[0])][at(e.activation)] > 0) return;
    const std::int64_t next = e.activation + w_.states_[at(e.xnode)];
    for (const int x : mates)
      if (!w_.inner_[at(x)] && at(next) < jobs_[at(x)].size()) arrives(x, next);
  }

  /// As much of it as fate lets the job have.
  [[nodiscard]] Atoms part_of(Atoms most, std::size_t i, std::int64_t k) const {
    return std::max<Atoms>(
        1, most / 255 * f_.run[i][at(k)] + (f_.run[i][at(k)] == 255 ? most % 255 : 0));
  }

  /// The job that runs on `m` meets one on XPU `other`. True: it takes longer by that.
  bool meets(std::size_t m, std::size_t other) {
    const auto [key, tie, i, k] = xpus_[m].running;
    Job& job = jobs_[at(i)][at(k)];
    if (w_.app_.xnodes[at(i)].beside.empty() || job.met[other] != 0) return false;
    job.met[other] = 1;
    const Atoms before = job.most;
    job.most = std::max(before, w_.takes(at(i), job.met));
    job.left += part_of(job.most, at(i), k) - part_of(before, at(i), k);
    return job.most > before;
  }

  void decide(std::size_t m) {
    Device& device = xpus_[m];
    device.look = false;
    if (device.ready.empty()) return;
    const Ready next = device.ready.top();
    Job& job = jobs_[at(next.xnode)][at(next.activation)];
    const Xpu& xpu = w_.platform_.xpus[m];
    const bool levels = xpu.levels > 0;
    const bool above = levels ? device.open > 0 : device.busy;
    if (device.busy) {
      if (!xpu.preemptive || next.key >= device.running.key) return;
      if (levels && device.open == xpu.levels) return;
      Job& victim = jobs_[at(device.running.xnode)][at(device.running.activation)];
      victim.left -= now_ - device.since;
      device.ready.pop();
      device.ready.push(device.running);
    } else {
      device.ready.pop();
    }
    if (job.start < 0) {
      if (above) job.left += w_.atoms(xpu.preempt_us);
      job.start = now_;
      ++device.open;
    }
    device.busy = true;
    device.running = next;
    // Who has a level goes before who comes later with the same key.
    if (levels) device.running.tie = INT_MIN;
    device.since = now_;
    for (std::size_t other = 0; other < xpus_.size(); ++other) {
      if (other == m || !xpus_[other].busy) continue;
      (void)meets(m, other);
      if (!meets(other, m)) continue;
      Device& beside = xpus_[other];
      Job& longer = jobs_[at(beside.running.xnode)][at(beside.running.activation)];
      longer.left -= now_ - beside.since;
      beside.since = now_;
      push(now_ + longer.left, kEnds, at(beside.running.xnode), beside.running.activation,
           ++beside.stamp);
    }
    push(now_ + job.left, kEnds, at(next.xnode), next.activation, ++device.stamp);
  }

  Outcome judge() {
    Outcome o;
    o.late_of.assign(jobs_.size(), INT64_MIN);
    o.late_at.assign(jobs_.size(), 0);
    for (std::size_t i = 0; i < jobs_.size(); ++i)
      for (std::size_t k = 0; k < jobs_[i].size(); ++k) {
        const Job& job = jobs_[i][k];
        if (job.end < 0) continue;
        if (job.end - job.key > o.late_of[i]) {
          o.late_of[i] = job.end - job.key;
          o.late_at[i] = static_cast<std::int64_t>(k);
        }
        if (job.end - job.key > o.late) {
          o.late = job.end - job.key;
          o.xnode = static_cast<int>(i);
          o.activation = static_cast<std::int64_t>(k);
        }
      }
    o.over.assign(w_.app_.chains.size(), INT64_MIN);
    o.over_when.assign(w_.app_.chains.size(), 0);
    for (const Path& path : w_.paths_) follow(path, o);
    return o;
  }

  void follow(const Path& path, Outcome& o) const {
    const ChainSpec& chain = w_.app_.chains[at(path.chain)];
    const SourceSpec& source = w_.app_.sources[at(chain.from)];
    const std::int64_t period = source.period.num * (w_.scale_ / source.period.den);
    const std::size_t count = jobs_[at(path.hops.empty() ? chain.to : path.hops[0].from)].size();
    std::vector<std::size_t> from(path.hops.size(), 0);
    for (std::size_t k = 0; k < count; ++k) {
      std::size_t n = k;
      bool known = true;
      for (std::size_t h = 0; h < path.hops.size() && known; ++h) {
        const auto& writer = jobs_[at(path.hops[h].from)];
        const auto& reader = jobs_[at(path.hops[h].to)];
        known = n < writer.size() && writer[n].end >= 0;
        std::size_t& m = from[h];
        while (known && m < reader.size() &&
               (reader[m].start < 0 || reader[m].start < writer[n].end))
          ++m;
        known = known && m < reader.size() && m > 0;  // it has started before
        n = m;
      }
      const auto& last = jobs_[at(chain.to)];
      if (!known || n >= last.size() || last[n].end < 0) continue;
      const Atoms release = w_.real(
          source.clock, source.offset_us * w_.scale_ + static_cast<std::int64_t>(k) * period, f_);
      const auto& urgent = urgent_[at(chain.from)];
      const ChainClaim& claim = w_.policy_.chains[at(path.chain)];
      const std::int64_t least =
          k < urgent.size() && urgent[k]
              ? std::min(claim.worst_case_us,
                         claim.urgent_worst_case_us.value_or(claim.worst_case_us))
              : claim.worst_case_us;
      const Atoms over = last[n].end - release - w_.atoms(least);
      if (over > o.over[at(path.chain)]) {
        o.over[at(path.chain)] = over;
        o.over_when[at(path.chain)] = last[n].end;
      }
    }
  }

  const World& w_;
  const Fate& f_;
  Atoms now_ = 0;
  std::vector<std::vector<Job>> jobs_;
  std::vector<std::vector<int>> gone_;  ///< [first XNode of a module][activation] still to end
  std::vector<Device> xpus_;
  std::vector<std::pair<int, std::int64_t>> early_;  ///< what waits for its planned start alone
  std::vector<std::vector<char>> urgent_;            ///< [source][release]
  std::priority_queue<Event, std::vector<Event>, std::greater<>> events_;
};

class Climb {
 public:
  Climb(const World& w, const Options& options) : w_(w), options_(options), dice_(options.seed) {}

  Found go() {
    // Long enough for every pattern of windows, every chain, and a few periods of each component.
    std::int64_t span = 0, jobs = 0;
    for (std::size_t i = 0; i < w_.wcet_.size(); ++i) {
      const Placement& p = w_.policy_.placements[i];
      span = std::max(span, w_.period(i) * (static_cast<std::int64_t>(p.key_us.size()) + 4));
      span = std::max(span, 3 * std::ranges::max(p.key_us) * w_.scale_);
    }
    for (const ChainClaim& c : w_.policy_.chains)
      if (c.worst_case_us < 100'000'000) span = std::max(span, 2 * c.worst_case_us * w_.scale_);
    for (std::size_t i = 0; i < w_.wcet_.size(); ++i) jobs += span / w_.period(i) + 2;
    if (jobs > 30'000)
      span = static_cast<std::int64_t>(static_cast<double>(span) * 30'000.0 /
                                       static_cast<double>(jobs));
    span_ = span;
    while (found_.jobs < options_.jobs && !found_.broken()) climb();
    return found_;
  }

 private:
  Fate fresh() {
    Fate f;
    const std::int64_t mood = dice_.roll(3);
    for (std::size_t i = 0; i < w_.wcet_.size(); ++i) {
      f.run.emplace_back(at(span_ / w_.period(i) + 2), std::uint8_t{255});
      f.early.emplace_back(f.run.back().size(), std::uint8_t{255});
      if (mood == 3)
        for (auto& e : f.early.back()) e = dice_.coin() ? 255 : 0;
      if (mood == 1)
        for (auto& r : f.run.back()) r = dice_.coin() ? 255 : 0;
      if (mood == 2 && dice_.roll(3) == 0)
        for (auto& r : f.run.back()) r = 0;
    }
    for (const SourceSpec& s : w_.app_.sources) {
      const std::int64_t period = s.period.num * (w_.scale_ / s.period.den);
      f.jitter.emplace_back(at(span_ / period + 2),
                            static_cast<std::uint8_t>(dice_.coin() ? 255 : 0));
      if (dice_.coin())
        for (auto& j : f.jitter.back()) j = dice_.coin() ? 255 : 0;
    }
    for (std::size_t s = 0; s < w_.app_.sources.size(); ++s) {
      f.urgent.emplace_back(f.jitter[s].size(), std::uint8_t{0});
      if (!w_.app_.sources[s].urgent) continue;
      if (dice_.coin())
        for (auto& u : f.urgent.back()) u = dice_.coin() ? 255 : 0;
    }
    for (const ClockSpec& c : w_.app_.clocks) {
      f.phase.push_back(0);
      f.drift.push_back(-c.ppm + 2 * dice_.roll(1) * c.ppm);
      f.later_drift.push_back(dice_.coin() ? f.drift.back() : -f.drift.back());
      f.turn.push_back(dice_.roll(span_));
    }
    for (std::size_t c = 1; c < f.phase.size(); ++c) shift(f, c);
    return f;
  }

  /// By when it is ready, if it waits for its source, hold and transfers alone.
  [[nodiscard]] Atoms ready(std::size_t i, std::int64_t n, const Fate& f) const {
    std::int64_t jitter_us = 0;
    for (const int s : w_.app_.xnodes[i].sources)
      jitter_us = std::max(jitter_us, w_.app_.sources[at(s)].jitter_us);
    return w_.nominal(i, n, f) + w_.planned(i, n, false) + w_.atoms(jitter_us);
  }

  /// Windows of two clocks on one XPU begin at one instant.
  void align(Fate& f, std::size_t clock) {
    const auto last = static_cast<std::int64_t>(w_.wcet_.size()) - 1;
    for (int tries = 0; tries < 20; ++tries) {
      const auto i = at(dice_.roll(last)), j = at(dice_.roll(last));
      if (w_.clock(i) == static_cast<int>(clock) || w_.clock(j) != static_cast<int>(clock) ||
          w_.policy_.placements[i].xpu != w_.policy_.placements[j].xpu)
        continue;
      const Atoms moved =
          f.phase[clock] + ready(i, 2 + dice_.roll(9), f) - ready(j, dice_.roll(3), f);
      if (moved < 0) continue;
      f.phase[clock] = moved;
      return;
    }
  }

  void shift(Fate& f, std::size_t clock) {
    if (!options_.app_of.empty() && dice_.roll(2) > 0) return align(f, clock);
    std::int64_t longest = 1;
    for (std::size_t i = 0; i < w_.wcet_.size(); ++i)
      if (w_.clock(i) == static_cast<int>(clock)) longest = std::max(longest, w_.period(i));
    switch (dice_.roll(3)) {
      case 0:
        f.phase[clock] = dice_.roll(longest * 2) * kMillion;
        break;
      case 1:
        f.phase[clock] += dice_.roll(2000) - 1000;
        break;
      case 2:
        f.phase[clock] += (dice_.roll(200) - 100) * kMillion * w_.scale_;
        break;
      default: {
        // Two releases, or a key and a release, at one instant.
        const auto i = at(dice_.roll(static_cast<std::int64_t>(w_.wcet_.size()) - 1));
        const Placement& p = w_.policy_.placements[i];
        f.phase[clock] = w_.nominal(i, dice_.roll(3), f) +
                         (dice_.coin() ? 0 : w_.atoms(p.key_us[0]) - w_.wcet_[i]);
        f.phase[clock] -= dice_.roll(4) * longest * kMillion;
      }
    }
    while (f.phase[clock] < 0) f.phase[clock] += longest * kMillion;
  }

  /// A few changes, most of them near what is worst so far.
  void mutate(Fate& f, std::int64_t near) {
    for (std::int64_t changes = 1 + dice_.roll(3); changes > 0; --changes) {
      if (hurried(f, near)) continue;
      const std::int64_t what = dice_.roll(9);
      if (what < 6) {
        const auto i = at(dice_.roll(static_cast<std::int64_t>(w_.wcet_.size()) - 1));
        auto& run = dice_.roll(4) == 0 ? f.early[i] : f.run[i];
        const auto value = static_cast<std::uint8_t>(dice_.roll(3) == 0 ? dice_.roll(255)
                                                     : dice_.coin()     ? 255
                                                                        : 0);
        change(run, near / kMillion / w_.period(i), value);
      } else if (what < 8) {
        const auto s = at(dice_.roll(static_cast<std::int64_t>(f.jitter.size()) - 1));
        const SourceSpec& source = w_.app_.sources[s];
        change(f.jitter[s], near / kMillion / (source.period.num * (w_.scale_ / source.period.den)),
               static_cast<std::uint8_t>(dice_.roll(2) == 0 ? dice_.roll(255)
                                         : dice_.coin()     ? 255
                                                            : 0));
      } else if (what == 8) {
        const auto c = at(dice_.roll(static_cast<std::int64_t>(f.phase.size()) - 1));
        if (c > 0) shift(f, c);
        const std::int64_t ppm = w_.app_.clocks[c].ppm;
        if (dice_.coin()) f.drift[c] = -ppm + dice_.roll(2) * ppm;
        if (dice_.coin()) f.later_drift[c] = -ppm + dice_.roll(2) * ppm;
        if (dice_.coin()) f.turn[c] = dice_.roll(span_);
      } else {
        f.ties_up = !f.ties_up;
      }
    }
  }

  /// Another pattern of urgent releases, now and then, where there may be some.
  bool hurried(Fate& f, std::int64_t near) {
    std::vector<std::size_t> may;
    for (std::size_t s = 0; s < w_.app_.sources.size(); ++s)
      if (w_.app_.sources[s].urgent) may.push_back(s);
    if (may.empty() || dice_.roll(3) > 0) return false;
    const std::size_t s = may[at(dice_.roll(static_cast<std::int64_t>(may.size()) - 1))];
    const SourceSpec& source = w_.app_.sources[s];
    change(f.urgent[s], near / kMillion / (source.period.num * (w_.scale_ / source.period.den)),
           dice_.coin() ? 255 : 0);
    return true;
  }

  void change(std::vector<std::uint8_t>& all, std::int64_t near, std::uint8_t value) {
    const auto size = static_cast<std::int64_t>(all.size());
    std::int64_t first = dice_.roll(3) == 0 ? dice_.roll(size - 1) : near - 4 + dice_.roll(6);
    std::int64_t count = dice_.roll(2) == 0 ? size : 1 + dice_.roll(2);
    if (dice_.roll(5) == 0) first = 0;
    for (; count > 0; --count, ++first)
      if (first >= 0 && first < size) all[at(first)] = value;
  }

  void climb() {
    const auto xnodes = static_cast<std::int64_t>(w_.wcet_.size());
    const auto chains = static_cast<std::int64_t>(w_.app_.chains.size());
    // What it climbs for: one XNode's lateness, any, or one chain.
    const std::int64_t goal = dice_.roll(xnodes + chains);
    const auto judge = [&](const Outcome& o) {
      if (goal < xnodes) return o.late_of[at(goal)];
      if (goal == xnodes) return o.late;
      return o.over[at(goal - xnodes - 1)];
    };
    const auto near = [&](const Outcome& o) {
      if (goal <= xnodes) {
        const std::size_t i = at(goal == xnodes ? o.xnode : static_cast<int>(goal));
        return o.late_at[i] * w_.period(i) * kMillion;
      }
      return o.over_when[at(goal - xnodes - 1)];
    };
    Fate best = fresh();
    Outcome top = play(best);
    std::int64_t stuck = 0;
    while (stuck < 150 && found_.jobs < options_.jobs && !found_.broken()) {
      Fate next = best;
      mutate(next, std::clamp<Atoms>(near(top), 0, span_ * kMillion));
      Outcome o = play(next);
      stuck = judge(o) > judge(top) ? 0 : stuck + 1;
      if (judge(o) < judge(top)) continue;
      best = std::move(next);
      top = std::move(o);
    }
  }

  Outcome play(const Fate& f) {
    Outcome o = Run(w_, f).go();
    for (const auto& run : f.run) found_.jobs += static_cast<std::int64_t>(run.size());
    ++found_.executions;
    found_.closest_us = std::max(found_.closest_us, w_.us(o.late));
    if (o.late > 0)
      found_.late = "XNode '" + w_.app_.xnodes[at(o.xnode)].name + "', activation " +
                    std::to_string(o.activation) + ", ends " + std::to_string(w_.us(o.late)) +
                    " us after its key";
    for (std::size_t c = 0; c < o.over.size(); ++c) {
      if (o.over[c] == INT64_MIN) continue;
      const auto claim = static_cast<double>(w_.policy_.chains[c].worst_case_us);
      found_.fullest = std::max(found_.fullest, 1 + w_.us(o.over[c]) / claim);
      if (o.over[c] > 0)
        found_.chain = "chain '" + w_.app_.chains[c].name + "' takes " +
                       std::to_string(w_.us(o.over[c])) + " us more than " +
                       std::to_string(w_.policy_.chains[c].worst_case_us);
    }
    return o;
  }

  const World& w_;
  const Options& options_;
  Dice dice_;
  Found found_;
  std::int64_t span_ = 0;
};

}  // namespace

Found attack(const AppSpec& app, const Platform& platform, const Policy& policy,
             const Options& options) {
  const World w(app, platform, policy, options);
  return Climb(w, options).go();
}

}  // namespace xauto::attack
