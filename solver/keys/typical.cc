// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/typical.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <utility>

#include "solver/random.h"

namespace xauto::solver::keys {
namespace {

// Chosen, not tuned.
/// Jobs take such parts of their WCET, where no typical time is known.
constexpr double kLeastPart = 0.6;
/// Phases of the clocks, evenly over the longest period, and of one clock draws of times.
constexpr int kScenesOfClocks = 12, kScenesOfOne = 3;
/// Of all scenes together; but each lasts so many of the longest periods, the first and last of which are not counted.
constexpr double kTypicalJobs = 1'500;
constexpr Tick kLeastPeriods = 4;
/// ... where that is more, there are fewer scenes; and where one scene is more, it is not asked.
constexpr double kMostTypicalJobs = 50'000;

enum Kind : int { kEnds, kReleases, kArrives, kPlanned };

std::size_t number_of(std::int64_t i) {
  return static_cast<std::size_t>(i);
}

}  // namespace

TypicalPlay::TypicalPlay(const AppSpec& app, const Problem& problem, std::uint64_t seed)
    : p_(problem),
      reads_(at(p_.num_xnodes)),
      ends_of_(at(p_.num_xnodes)),
      sampled_(at(p_.num_xnodes)),
      offset_(at(p_.num_xnodes), 0) {
  Tick longest = 0;
  double rate = 0;
  for (const Domain& d : p_.domains)
    rate += static_cast<double>(d.jobs) / static_cast<double>(d.hyper);
  for (const Component& c : p_.components) longest = std::max({longest, c.period, c.phase});
  const bool clocks = std::ranges::any_of(
      p_.domains, [&](const Domain& d) { return d.clock != p_.domains.front().clock; });
  num_scenes_ = clocks ? kScenesOfClocks : kScenesOfOne;
  const double least = static_cast<double>(kLeastPeriods * longest) * rate;
  num_scenes_ = std::clamp(static_cast<int>(kMostTypicalJobs / least), 0, num_scenes_);
  if (num_scenes_ == 0) return;
  horizon_ =
      std::max(kLeastPeriods * longest, static_cast<Tick>(kTypicalJobs / num_scenes_ / rate));
  warm_ = longest;
  typical_.assign(at(p_.num_xnodes), std::vector<double>(at(p_.num_xpus), 0));
  for (int i = 0; i < p_.num_xnodes; ++i)
    for (int m = 0; m < p_.num_xpus; ++m) {
      const auto& known = app.xnodes[at(i)].typical_us;
      const auto typical = known.find(p_.type_name[at(p_.xpu_type[at(m)])]);
      if (typical != known.end())
        typical_[at(i)][at(m)] = static_cast<double>(typical->second * p_.scale);
    }
  for (const auto& [u, v] : p_.samples) sampled_[at(v)].push_back(u);
  add_ways();
  draw(app, seed);
}

void TypicalPlay::add_ways() {
  for (std::size_t c = 0; c < p_.chains.size(); ++c)
    for (const Path& path : p_.chains[c].paths) {
      Way way;
      way.chain = static_cast<int>(c);
      for (const int s : path.samples) way.samples.push_back(p_.samples[at(s)]);
      const int leaves = way.samples.empty() ? p_.chains[c].to : way.samples.front().first;
      way.first = p_.component_of[at(leaves)];
      way.knows.resize(way.samples.size());
      for (std::size_t h = 0; h < way.samples.size(); ++h)
        reads_[at(way.samples[h].second)].emplace_back(ways_.size(), h);
      ends_of_[at(p_.chains[c].to)].push_back(ways_.size());
      ways_.push_back(std::move(way));
    }
}

/// The same whatever the candidate: what differs then is the candidate.
void TypicalPlay::draw(const AppSpec& app, std::uint64_t seed) {
  Random random(seed);
  const auto activations = [&](int component) {
    const Component& c = p_.components[at(component)];
    return number_of(horizon_ / c.period + 2);
  };
  for (int k = 0; k < num_scenes_; ++k) {
    Scene& scene = scenes_.emplace_back();
    std::vector<double> phase;
    for (std::size_t c = 0; c < p_.clock_name.size() + 1; ++c)
      phase.push_back(
          c == 0 ? 0
                 : (static_cast<double>((k + static_cast<int>(c)) % num_scenes_) + random.unit()) /
                       num_scenes_);
    for (const Domain& d : p_.domains)
      scene.offset.push_back(static_cast<Tick>(phase[at(d.clock)] * static_cast<double>(warm_)));
    std::vector<std::vector<double>> late(app.sources.size());  // of its jitter
    scene.part.resize(at(p_.num_xnodes));
    scene.arrives.resize(at(p_.num_xnodes));
    for (int i = 0; i < p_.num_xnodes; ++i) {
      const std::size_t count = activations(p_.component_of[at(i)]);
      for (std::size_t n = 0; n < count; ++n)
        scene.part[at(i)].push_back(kLeastPart + (1 - kLeastPart) * random.unit());
      if (p_.root[at(i)] == 0) continue;
      const Tick phase_of = p_.components[at(p_.component_of[at(i)])].phase;
      scene.arrives[at(i)].assign(count, 0);
      for (const int s : app.xnodes[at(i)].sources) {
        const SourceSpec& source = app.sources[at(s)];
        offset_[at(i)] = std::max(offset_[at(i)], source.offset_us * p_.scale - phase_of);
        while (late[at(s)].size() < count) late[at(s)].push_back(random.unit());
        for (std::size_t n = 0; n < count; ++n) {
          Tick& arrives = scene.arrives[at(i)][n];
          const auto jitter =
              static_cast<Tick>(late[at(s)][n] * static_cast<double>(source.jitter_us * p_.scale));
          arrives = std::max(arrives, source.offset_us * p_.scale + jitter - phase_of);
        }
      }
    }
  }
}

bool of_two_clocks(const Problem& p, int u, int v) {
  return p.domains[at(p.domain_of(u))].clock != p.domains[at(p.domain_of(v))].clock;
}

double TypicalPlay::latency(const std::vector<int>& xpu, const Windows& w) {
  xpu_ = &xpu;
  w_ = &w;
  plan_starts(xpu, w);
  squares_.assign(p_.chains.size(), 0);
  seen_.assign(p_.chains.size(), 0);
  for (const Scene& scene : scenes_) play(scene, xpu);
  double sum = 0;
  for (std::size_t c = 0; c < p_.chains.size(); ++c)
    if (seen_[c] > 0)
      sum += static_cast<double>(p_.chains[c].weight) *
             std::sqrt(squares_[c] / static_cast<double>(seen_[c])) /
             static_cast<double>(p_.chains[c].by);
  return sum;
}

/// E of docs/keys.md, "Early start"; 0 where no hold is in it.
void TypicalPlay::plan_starts(const std::vector<int>& xpu, const Windows& w) {
  planned_.assign(at(p_.num_slots), 0);
  std::vector<Tick> free(at(p_.num_slots), 0);
  for (const Domain& d : p_.domains)
    for (const int i : d.xnodes)
      for (int n = 0; n < p_.jobs[at(i)]; ++n) {
        const std::size_t s = at(p_.slot[at(i)] + n);
        free[s] = offset_[at(i)];
        planned_[s] = std::max(free[s], w.hold[s]);
        for (const EdgeEnd& link : p_.pred[at(i)]) {
          const std::size_t from = p_.slot_of(link.xnode, n);
          const Tick passes = p_.transfer(link, xpu[at(link.xnode)], xpu[at(i)]);
          planned_[s] = std::max(planned_[s], planned_[from] + passes);
          free[s] = std::max(free[s], free[from] + passes);
        }
      }
  for (std::size_t s = 0; s < planned_.size(); ++s)
    if (planned_[s] <= free[s]) planned_[s] = 0;
}

void TypicalPlay::push(const Event& event) {
  events_.push_back(event);
  std::push_heap(events_.begin(), events_.end(), std::greater<>());
}

Tick TypicalPlay::released(int xnode, std::int64_t n) const {
  const Component& c = p_.components[at(p_.component_of[at(xnode)])];
  return scene_->offset[at(c.domain)] + c.phase + n * c.period;
}

void TypicalPlay::play(const Scene& scene, const std::vector<int>& xpu) {
  scene_ = &scene;
  jobs_.resize(at(p_.num_xnodes));
  for (auto& jobs : jobs_) jobs.clear();
  done_.assign(at(p_.num_xnodes), 0);
  left_.assign(p_.modules.size(), 0);
  released_.assign(p_.components.size(), -1);
  devices_.resize(at(p_.num_xpus));
  for (Device& d : devices_) {
    d.ready.clear();
    d.early.clear();
    d.xnodes.clear();
    d.running.xnode = -1;
    d.begun = 0;
    d.look = false;
  }
  for (int i = 0; i < p_.num_xnodes; ++i) devices_[at(xpu[at(i)])].xnodes.push_back(i);
  for (Way& way : ways_) {
    for (auto& knows : way.knows) knows.clear();
    way.last = -1;
  }
  events_.clear();
  ended_ = false;
  for (int c = 0; c < static_cast<int>(p_.components.size()); ++c) {
    const Component& of = p_.components[at(c)];
    push({scene.offset[at(of.domain)] + of.phase, kReleases, c, 0});
  }
  while (!events_.empty() && events_.front().time <= horizon_) {
    now_ = events_.front().time;
    while (!events_.empty() && events_.front().time == now_) {
      std::pop_heap(events_.begin(), events_.end(), std::greater<>());
      const Event e = events_.back();
      events_.pop_back();
      if (e.kind == kEnds) {
        Device& d = devices_[at(e.index)];
        if (d.running.xnode >= 0 && d.stamp == e.number) ends(e.index);
      } else if (e.kind == kReleases) {
        release(e.index, e.number);
      } else if (e.kind == kArrives) {
        --jobs_[at(e.index)][number_of(e.number)].waits;
        look_at(e.index, e.number);
      } else {
        look_at(e.index, e.number);
      }
    }
    look_early();
    for (int m = 0; m < p_.num_xpus; ++m)
      if (devices_[at(m)].look) decide(m);
  }
  // What has not come through has waited as long at least.
  for (Way& way : ways_)
    for (std::int64_t k = way.last + 1; k <= released_[at(way.first)]; ++k) add(way, k, horizon_);
}

void TypicalPlay::release(int component, std::int64_t n) {
  const Component& c = p_.components[at(component)];
  released_[at(component)] = n;
  for (const int i : c.xnodes) {
    const std::size_t s = p_.slot_of(i, n);
    const int m = (*xpu_)[at(i)];
    Job& job = jobs_[at(i)].emplace_back();
    job.key = now_ + w_->d[s];
    const double typical = typical_[at(i)][at(m)];
    const double takes =
        typical > 0 ? typical
                    : scene_->part[at(i)][number_of(n)] * static_cast<double>(p_.wcet(i, m));
    job.left = std::max(Tick{1}, static_cast<Tick>(takes));
    job.waits = 1 + static_cast<int>(p_.pred[at(i)].size());
    if (p_.root[at(i)] != 0) {
      ++job.waits;
      push({now_ + scene_->arrives[at(i)][number_of(n)], kArrives, i, n});
    }
    if (planned_[s] > 0) {
      job.planned = now_ + planned_[s];
      push({job.planned, kPlanned, i, n});
    }
    push({now_, kArrives, i, n});
  }
  push({now_ + c.period, kReleases, component, n + 1});
}

void TypicalPlay::look_at(int xnode, std::int64_t n) {
  if (done_[at(xnode)] != n || number_of(n) >= jobs_[at(xnode)].size()) return;
  Job& job = jobs_[at(xnode)][number_of(n)];
  if (job.waits > 0 || job.queued) return;
  const int module = p_.module_of[at(xnode)];
  if (p_.entry[at(xnode)] != 0 && module >= 0 &&
      left_[at(module)] + std::min(p_.modules[at(module)].in_flight, kMostTicks) <= n)
    return;
  Device& d = devices_[at((*xpu_)[at(xnode)])];
  if (now_ < job.planned && !may_start_early(xnode, job)) {
    if (std::ranges::none_of(d.early,
                             [&](const Ready& r) { return r.xnode == xnode && r.number == n; }))
      d.early.push_back({job.key, xnode, n});
    return;
  }
  job.queued = true;
  d.ready.push_back({job.key, xnode, n});
  std::push_heap(d.ready.begin(), d.ready.end(), std::greater<>());
  d.look = true;
}

void TypicalPlay::look_early() {
  if (!std::exchange(ended_, false)) return;
  for (Device& d : devices_)
    for (const Ready& held : std::exchange(d.early, {})) look_at(held.xnode, held.number);
}

/// When the first activation that has not ended is released, and its key.
std::pair<Tick, Tick> TypicalPlay::first_open(int x) const {
  const std::int64_t n = done_[at(x)];
  const Tick release = released(x, n);
  return {release, release + w_->d[p_.slot_of(x, n)]};
}

bool TypicalPlay::may_start_early(int xnode, const Job& job) const {
  const std::size_t m = at((*xpu_)[at(xnode)]);
  if (p_.levels[m] != kAnyLevels || p_.preempt[m] > 0)
    for (const int x : devices_[m].xnodes)
      if (x != xnode && first_open(x).second <= job.key) return false;
  for (const int u : sampled_[at(xnode)]) {
    const auto [release, key] = first_open(u);
    const bool all = !reads_all_.empty() && reads_all_[at(xnode)] != 0;
    if (key <= job.planned || (all && release < job.planned && of_two_clocks(p_, u, xnode)))
      return false;
  }
  return true;
}

void TypicalPlay::ends(int xpu) {
  Device& d = devices_[at(xpu)];
  const int i = d.running.xnode;
  const std::int64_t n = d.running.number;
  ended_ = true;
  d.running.xnode = -1;
  --d.begun;
  d.look = true;
  count(i, n);
  ++done_[at(i)];
  for (const EdgeEnd& link : p_.succ[at(i)])
    push({now_ + p_.transfer(link, xpu, (*xpu_)[at(link.xnode)]), kArrives, link.xnode, n});
  look_at(i, n + 1);
  const int module = p_.module_of[at(i)];
  if (module < 0) return;
  std::int64_t left = done_[at(i)];
  for (const int x : p_.modules[at(module)].xnodes) left = std::min(left, done_[at(x)]);
  if (left == left_[at(module)]) return;
  left_[at(module)] = left;
  for (const int x : p_.modules[at(module)].entries) look_at(x, done_[at(x)]);
}

void TypicalPlay::read(int xnode, std::int64_t n) {
  for (const auto& [k, h] : reads_[at(xnode)]) {
    Way& way = ways_[k];
    std::int64_t knows = done_[at(way.samples[h].first)] - 1;
    if (h > 0 && knows >= 0) knows = way.knows[h - 1][number_of(knows)];
    way.knows[h].resize(number_of(n), -1);
    way.knows[h].push_back(knows);
  }
}

void TypicalPlay::count(int xnode, std::int64_t n) {
  for (const std::size_t k : ends_of_[at(xnode)]) {
    Way& way = ways_[k];
    const std::int64_t knows = way.knows.empty() ? n : way.knows.back()[number_of(n)];
    for (; way.last < knows; ++way.last) add(way, way.last + 1, now_);
  }
}

void TypicalPlay::add(const Way& way, std::int64_t k, Tick now) {
  const Component& c = p_.components[at(way.first)];
  const Tick since = scene_->offset[at(c.domain)] + p_.chains[at(way.chain)].offset + k * c.period;
  if (since < warm_ || since >= horizon_ - warm_) return;
  const auto took = static_cast<double>(now - since);
  squares_[at(way.chain)] += took * took;
  ++seen_[at(way.chain)];
}

void TypicalPlay::decide(int xpu) {
  Device& d = devices_[at(xpu)];
  d.look = false;
  if (d.ready.empty()) return;
  const bool busy = d.running.xnode >= 0, limited = p_.levels[at(xpu)] != kAnyLevels;
  if (busy && (d.ready.front().key >= d.running.key || (limited && d.begun >= p_.levels[at(xpu)])))
    return;
  const bool preempts = busy || (limited && d.begun > 0);
  std::pop_heap(d.ready.begin(), d.ready.end(), std::greater<>());
  const Ready next = d.ready.back();
  d.ready.pop_back();
  if (busy) {
    jobs_[at(d.running.xnode)][number_of(d.running.number)].left -= now_ - d.since;
    d.ready.push_back(d.running);
    std::push_heap(d.ready.begin(), d.ready.end(), std::greater<>());
  }
  Job& job = jobs_[at(next.xnode)][number_of(next.number)];
  if (!job.started) {
    if (preempts) job.left += p_.preempt[at(xpu)];
    ++d.begun;
    read(next.xnode, next.number);
  }
  job.started = true;
  d.running = next;
  d.since = now_;
  push({now_ + job.left, kEnds, xpu, ++d.stamp});
}

}  // namespace xauto::solver::keys
