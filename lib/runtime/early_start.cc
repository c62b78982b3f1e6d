// SPDX-License-Identifier: Apache-2.0
#include "runtime/early_start.h"

#include <algorithm>
#include <cstdlib>

#include "base/clock.h"
#include "base/futex.h"
#include "base/index.h"
#include "grid/phase.h"
#include "model/components.h"

namespace xauto::runtime {

bool EarlyStart::may_be(const Context& context) {
  const Session& session = context.session;
  return context.scheduled() && session.keys && !session.tables && !session.releases.lockstep &&
         !session.app.one_at_a_time && session.releases.input.empty() &&
         context.plan.processes == 1 && !session.host.there();
}

Result<std::unique_ptr<EarlyStart>> EarlyStart::make(const AppSpec& app, const Platform& platform,
                                                     const Policy& policy,
                                                     const std::vector<bool>& shared) {
  const std::size_t n = app.xnodes.size();
  XAUTO_ASSIGN(const Components components, find_components(app));
  auto made = std::unique_ptr<EarlyStart>(new EarlyStart(n, app.sources.size()));
  EarlyStart& e = *made;
  e.planned_us_ = planned_starts_us(app, platform, policy);
  e.rules_.resize(n);
  e.lookers_.resize(n);
  const auto home = [&](std::size_t x) -> const Component& {
    return components.components[at(components.of[x])];
  };
  for (const Component& component : components.components)
    for (const int s : component.sources) {
      const SourceSpec& spec = app.sources[at(s)];
      Releases& of = e.releases_[at(s)];
      of.grid.period = spec.period;
      of.grid.offset_ns = spec.offset_us * 1000;
      of.grid.jitter_ns = spec.jitter_us * 1000;
      of.shift_ns = of.grid.offset_ns - component.offset_us * 1000;
      of.ppm = app.clocks[at(spec.clock)].ppm;
      of.clock = at(spec.clock);
    }
  const std::vector<std::vector<int>> apart = kept_apart(app, platform, policy);
  for (std::size_t x = 0; x < n; ++x) {
    auto& sources = e.sources_.emplace_back();
    std::int64_t by_us =
        0;  // one source of a component may state it; some XNodes do not hear of it
    for (const int s : home(x).sources) {
      sources.push_back(at(s));
      if (const auto& urgent = app.sources[at(s)].urgent) by_us = urgent->by_us;
    }
    e.keys_.push_back(Urgency::of_keys(policy.placements[x].key_us, {}, by_us));
    if (e.planned_us_.ordinary[x].empty()) continue;
    EarlyRule& rule = e.rules_[x];
    const int on = policy.placements[x].xpu;
    const Xpu& xpu = platform.xpus[at(on)];
    rule.never = shared[at(on)] && ((xpu.preemptive && xpu.preempt_us > 0) || xpu.levels > 0);
    if (rule.never) continue;
    if (!xpu.preemptive || xpu.preempt_us > 0 || xpu.levels > 0)
      for (std::size_t y = 0; y < n; ++y)
        if (y != x && policy.placements[y].xpu == on) rule.mates.push_back(static_cast<int>(y));
    rule.others = apart[x];
    for (const auto& [u, v] : app.samples) {
      if (at(v) != x) continue;
      rule.others.push_back(u);
      if (policy.placements[x].reads_all && home(at(u)).clock != home(x).clock)
        rule.all_of.push_back(u);
    }
    const auto looks_at = [&](int y) {
      auto& lookers = e.lookers_[at(y)];
      if (lookers.empty() || lookers.back() != x) lookers.push_back(x);
    };
    for (const int y : rule.mates) looks_at(y);
    for (const int y : rule.others) looks_at(y);
  }
  return made;
}

void EarlyStart::due(std::size_t source, std::int64_t start_ns) {
  write(releases_[source], 0, start_ns + releases_[source].grid.due_ns(0), true);
}

void EarlyStart::released(std::size_t source, std::uint64_t n, std::int64_t nominal_ns) {
  write(releases_[source], n, nominal_ns, false);
}

void EarlyStart::write(Releases& of, std::uint64_t n, std::int64_t nominal_ns, bool exact) {
  of.writes.fetch_add(1);
  of.n.store(n);
  of.nominal_ns.store(nominal_ns);
  of.exact.store(exact);
  of.writes.fetch_add(1);
}

/// By how much the grid of a clock may have moved against ours in that time (phase.h).
std::int64_t EarlyStart::drift_ns(const Releases& of, std::int64_t span_ns) const {
  std::int64_t messages = 0;
  for (std::size_t s = 0; s < num_sources_; ++s)
    if (const std::int64_t period_ns = releases_[s].grid.period_ns();
        releases_[s].clock == of.clock && period_ns > 0)
      messages += span_ns / period_ns + 2;
  return static_cast<std::int64_t>(static_cast<__int128>(span_ns + of.grid.jitter_ns) * of.ppm /
                                   1'000'000) +
         messages * kPhaseRoundingNs;
}

/// Release `n` of the source is nominally no sooner, less what it is later than its component. What is being written
/// just now is not waited for: its thread may be one that this one keeps from its core.
std::int64_t EarlyStart::earliest_ns(const Releases& of, std::uint64_t n) const {
  const std::uint32_t writes = of.writes.load();
  if (writes == 0 || writes % 2 != 0) return INT64_MIN;
  const std::uint64_t last = of.n.load();
  const std::int64_t nominal_ns = of.nominal_ns.load();
  const bool exact = of.exact.load();
  if (of.writes.load() != writes) return INT64_MIN;
  const std::int64_t later_ns = of.grid.due_ns(n) - of.grid.due_ns(last);
  return nominal_ns + later_ns - (exact ? 0 : drift_ns(of, std::abs(later_ns))) - of.shift_ns;
}

FirstOpen EarlyStart::first_open(std::size_t xnode) const {
  const std::uint64_t n = lines_[xnode].ended.load();
  std::int64_t release_ns = INT64_MAX;
  for (const std::size_t s : sources_[xnode])
    release_ns = std::min(release_ns, earliest_ns(releases_[s], n));
  if (release_ns == INT64_MIN || release_ns == INT64_MAX) return {INT64_MIN, INT64_MIN};
  return {release_ns, keys_[xnode].key(release_ns, n, true)};
}

bool EarlyStart::may_start(std::size_t xnode, const PlannedJob& job) const {
  return may_start_early(rules_[xnode], job, [this](int x) { return first_open(at(x)); });
}

/// Whoever waits has said so before it looked at this count, or sees it.
void EarlyStart::count(std::size_t xnode, std::uint64_t activations) {
  std::atomic<std::uint64_t>& ended = lines_[xnode].ended;
  std::uint64_t seen = ended.load();
  while (seen < activations && !ended.compare_exchange_weak(seen, activations)) {
  }
  if (waiting_.load() == 0) return;
  for (const std::size_t x : lookers_[xnode]) {
    Line& line = lines_[x];
    if (line.waits.load() == 0) continue;
    const PlannedJob job{line.key.load(std::memory_order_relaxed),
                         line.start_ns.load(std::memory_order_relaxed)};
    if (may_start(x, job) && line.waits.exchange(0) != 0) futex_wake_local(line.waits, 1);
  }
}

bool EarlyStart::wait(std::size_t xnode, const PlannedJob& job) {
  std::int64_t now = now_ns();
  if (now >= job.start_ns) return false;
  bool may = may_start(xnode, job);
  const bool at_once = may;
  if (!may) {
    Line& line = lines_[xnode];
    line.key.store(job.key, std::memory_order_relaxed);
    line.start_ns.store(job.start_ns, std::memory_order_relaxed);
    waiting_.fetch_add(1);
    for (; now < job.start_ns; now = now_ns()) {
      line.waits.store(1);
      if ((may = may_start(xnode, job))) break;
      futex_wait_until_local(line.waits, 1, job.start_ns);
    }
    line.waits.store(0);
    waiting_.fetch_sub(1);
  }
  if (may) {
    early_.fetch_add(1, std::memory_order_relaxed);
    early_ns_.fetch_add(job.start_ns - now, std::memory_order_relaxed);
  }
  return !at_once;
}

}  // namespace xauto::runtime
