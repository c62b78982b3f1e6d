// SPDX-License-Identifier: Apache-2.0
#include "model/drain.h"

#include <algorithm>
#include <set>
#include <vector>

#include "base/index.h"
#include "model/components.h"
#include "model/loss.h"
#include "model/scenario.h"

namespace xauto {
namespace {

/// At least t (1 + ppm / 10^6), and a microsecond for what is no whole one.
std::int64_t longer(std::int64_t t, std::int64_t ppm) {
  return t + t / 1'000'000 * ppm + t % 1'000'000 * ppm / 1'000'000 + 1;
}

std::int64_t least_period_us(const AppSpec& app) {
  std::int64_t least = kMaxPeriodUs;
  for (const SourceSpec& source : app.sources)
    least = std::min(least, longer(source.period.floor_us() + 1, app.clocks[at(source.clock)].ppm));
  return least;
}

}  // namespace

std::int64_t drain_us(const AppSpec& app, const Platform& platform, const Policy& keys,
                      std::int64_t notice_us) {
  const auto found = find_components(app);
  if (!found) return 0;                                    // no app that is valid
  std::vector<std::int64_t> passes(app.xnodes.size(), 0);  // messages to it
  const std::vector<std::int64_t> transfer = transfers_us(keys, app, platform);
  for (std::size_t e = 0; e < transfer.size(); ++e) passes[at(app.edges[e].second)] += transfer[e];
  const std::int64_t before_us = least_period_us(app) + notice_us;
  std::int64_t waits = 0;                                          // for sensors, and for holds
  std::vector<std::int64_t> on_xpu(platform.xpus.size(), 0);       // of all jobs that are left
  std::vector<std::int64_t> arrives(found->components.size(), 0);  // their messages
  std::vector<std::set<int>> uses(found->components.size());       // XPUs
  for (std::size_t i = 0; i < app.xnodes.size(); ++i) {
    const Placement& placed = keys.placements[i];
    const Xpu& xpu = platform.xpus[at(placed.xpu)];
    const std::size_t c = at(found->of[i]);
    const Component& component = found->components[c];
    for (const std::int64_t hold : placed.hold_us) waits = std::max(waits, hold);
    for (const int s : app.xnodes[i].sources) {
      const SourceSpec& source = app.sources[at(s)];
      waits = std::max(waits, source.offset_us - component.offset_us + source.jitter_us);
    }
    const std::int64_t length =
        longer(before_us + *std::max_element(placed.key_us.begin(), placed.key_us.end()),
               2 * app.clocks[at(component.clock)].ppm);
    // Of releases in an interval of that length, both ends included.
    const std::int64_t jobs = length / std::max<std::int64_t>(1, component.period.floor_us()) + 1;
    const std::int64_t work =
        app.xnodes[i].wcet_on(xpu.type).value_or(0) + (xpu.preemptive ? xpu.preempt_us : 0);
    if (jobs > kMaxTimeUs / std::max<std::int64_t>(1, work + passes[i])) return kMaxTimeUs;
    on_xpu[at(placed.xpu)] = std::min(kMaxTimeUs, on_xpu[at(placed.xpu)] + jobs * work);
    arrives[c] = std::min(kMaxTimeUs, arrives[c] + jobs * passes[i]);
    uses[c].insert(placed.xpu);
  }
  std::int64_t longest = 0;
  for (std::size_t c = 0; c < uses.size(); ++c) {
    std::int64_t sum = arrives[c];
    for (const int m : uses[c]) sum += on_xpu[at(m)];
    longest = std::max(longest, sum);
  }
  return std::min(kMaxTimeUs, waits + longest);
}

std::int64_t drain_us(const Tables& tables, int from, int to, const AppSpec& app,
                      const Platform& platform) {
  if (app.one_at_a_time) return 0;  // nothing is under way when a release has its table
  const Handover* change = handover_of(tables, from, to);
  const Scenario p = envelope(tables, at(from), app), q = envelope(tables, at(to), app);
  const Table& table = tables.tables[at(from)];
  if ((change != nullptr && change->claims_all()) || needs_lost(table, platform, q)) return 0;
  const Platform all = platform_of_all(tables, platform);
  Policy keys = table.keys;
  const std::vector<int> xpu = xpus_on(all, table, app);
  for (std::size_t i = 0; i < xpu.size(); ++i) keys.placements[i].xpu = xpu[i];
  return drain_us(app_of_all_chains(app_under(app, across(app, p, q)), table.loss), all, keys,
                  tables.notice_us);
}

}  // namespace xauto
