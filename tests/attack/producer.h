// SPDX-License-Identifier: Apache-2.0
// Random apps of several rates, and policies of keys for them: any assignment, and keys that the check
// lets be no smaller. Not good ones, but there is no room in them for a fault of the check.
#pragma once

#include <algorithm>
#include <map>
#include <numeric>
#include <optional>
#include <queue>
#include <string>
#include <vector>

#include "base/index.h"
#include "model/components.h"
#include "model/policy.h"
#include "solver/keys/check.h"
#include "solver/random.h"

namespace xauto::attack {

using solver::Random;
using solver::keys::check;
using solver::keys::CheckReport;

struct Case {
  AppSpec app;
  Platform platform;
  Policy policy;
};

struct Wanted {
  int clocks = 1;
  std::int64_t ppm = 0;  ///< of all clocks but the first; with one clock, of that
  int components = 3;
  double load = 0.5;
  bool preemptive = true;
  std::int64_t preempt_us = 0;
  int levels = 0;  ///< of XPUs that preempt; 0: any number
  std::int64_t jitter_us = 0;
  bool thirds = false;  ///< periods that are no whole microseconds
  bool holds = false;
  int longest = 5;     ///< XNodes of a component
  bool order = false;  ///< one period and no offsets, so that much is released together; pairs
  bool beside =
      false;  ///< most XNodes take longer beside loads, and more than the sum beside several
};

inline Case random_app(std::uint64_t seed, const Wanted& wanted) {
  Random random(seed * 2654435761u + 17);
  const auto pick = [&](std::int64_t low, std::int64_t high) {
    return low +
           static_cast<std::int64_t>(random.below(static_cast<std::uint64_t>(high - low + 1)));
  };
  Case c;
  c.app.name = "random";
  c.platform = {"p",
                {{"cpu0", "cpu", wanted.preemptive, wanted.preempt_us, 0, -1, wanted.levels},
                 {"gpu0", "gpu", wanted.preemptive, wanted.preempt_us, 0, -1, wanted.levels},
                 {"dla0", "dla", false, 0, 0, -1}}};
  if (wanted.preemptive) c.platform.xpus.pop_back();
  c.app.clocks = {{"main", wanted.clocks == 1 ? wanted.ppm : 0}};
  for (int k = 1; k < wanted.clocks; ++k)
    c.app.clocks.push_back({"clock" + std::to_string(k), wanted.ppm});
  const Period whole[] = {{1000, 1}, {2000, 1}, {3000, 1}, {4000, 1}, {6000, 1}};
  const Period thirds[] = {{1000, 1}, {1000, 3}, {2000, 3}, {2000, 1}, {500, 1}};
  std::vector<std::int64_t> period_us;
  std::vector<int> firsts, lasts, outs;
  for (int k = 0; k < wanted.components; ++k) {
    SourceSpec s;
    s.name = "s" + std::to_string(k);
    s.clock = k % wanted.clocks;
    s.period = wanted.thirds ? thirds[pick(0, 4)] : whole[pick(0, 4)];
    s.offset_us = pick(0, 2) == 0 ? pick(0, 300) : 0;
    if (wanted.order) s.offset_us = 0;
    if (wanted.order && k >= wanted.clocks) s.period = c.app.sources[at(k % wanted.clocks)].period;
    s.jitter_us = wanted.jitter_us > 0 ? pick(0, wanted.jitter_us) : 0;
    c.app.sources.push_back(s);
    std::vector<int> heard = {k};
    if (pick(0, 3) == 0) {
      s.name += "b";
      s.offset_us += pick(0, 100);
      c.app.sources.push_back(s);
    }
    const auto first = static_cast<int>(c.app.xnodes.size());
    const auto count = static_cast<int>(pick(1, wanted.longest));
    int module = -1;
    for (int i = 0; i < count; ++i) {
      XNodeSpec x;
      x.name = "x" + std::to_string(first + i);
      if (module < 0 || pick(0, 1) == 0) {
        module = static_cast<int>(c.app.modules.size());
        c.app.modules.push_back({"m" + std::to_string(module), pick(1, 2), false});
      }
      x.module = c.app.modules[at(module)].name;
      period_us.push_back(s.period.num / s.period.den);
      for (const char* type : {"cpu", "gpu", "dla"}) x.wcet_us[type] = pick(1, 100);
      c.app.xnodes.push_back(x);
      if (i > 0)
        c.app.edges.emplace_back(first + static_cast<int>(pick(std::max(0, i - 2), i - 1)),
                                 first + i);
    }
    c.app.xnodes[at(first)].sources = {static_cast<int>(c.app.sources.size()) - 1};
    if (c.app.sources.back().name.back() == 'b') {
      c.app.sources[c.app.sources.size() - 2].name = c.app.sources.back().name + "2";
      c.app.xnodes[at(first)].sources.push_back(static_cast<int>(c.app.sources.size()) - 2);
    }
    firsts.push_back(first);
    lasts.push_back(first + count - 1);
    // A module is in one component, and only what is joined is in one.
    module = -1;
  }
  for (int k = 1; k < wanted.components; ++k)
    c.app.samples.emplace_back(lasts[at(k - 1)], pick(0, 1) == 0 ? firsts[at(k)] : lasts[at(k)]);
  if (wanted.components > 2 && pick(0, 1) == 0) c.app.samples.emplace_back(lasts[0], lasts.back());
  for (std::size_t e = 0; e < c.app.edges.size(); ++e)
    if (pick(0, 2) == 0)
      c.app.transfers.push_back({static_cast<int>(e), "cpu", "gpu", pick(1, 50)});
  for (int k = 0; k < wanted.components; ++k)
    c.app.chains.push_back(
        {"c" + std::to_string(k), c.app.xnodes[at(firsts[at(k)])].sources[0], lasts.back(), {}, 1});
  // WCETs by share of the load.
  const auto xpus = static_cast<int>(c.platform.xpus.size());
  std::vector<double> share(c.app.xnodes.size());
  std::vector<double> sum(at(xpus), 0);
  c.policy.placements.resize(c.app.xnodes.size());
  for (std::size_t i = 0; i < share.size(); ++i) {
    c.policy.placements[i].xpu = static_cast<int>(pick(0, xpus - 1));
    sum[at(c.policy.placements[i].xpu)] += share[i] = 0.1 + random.unit();
  }
  for (std::size_t i = 0; i < share.size(); ++i) {
    const int m = c.policy.placements[i].xpu;
    const double wcet = wanted.load * share[i] / sum[at(m)] * static_cast<double>(period_us[i]);
    c.app.xnodes[i].wcet_us[c.platform.xpus[at(m)].type] =
        std::max<std::int64_t>(1, static_cast<std::int64_t>(wcet));
  }
  for (std::size_t i = 0; i < share.size() && wanted.beside; ++i) {
    if (pick(0, 3) == 0) continue;
    XNodeSpec& x = c.app.xnodes[i];
    const std::string& on = c.platform.xpus[at(c.policy.placements[i].xpu)].type;
    const std::int64_t alone = x.wcet_us.at(on);
    std::int64_t all = alone;
    std::map<std::string, std::int64_t, std::less<>> load;
    for (const Xpu& other : c.platform.xpus) {
      if (other.type == on) continue;
      const std::int64_t more = alone * pick(0, 60) / 100 + 1;
      x.beside.push_back({on, {{other.type, 1}}, alone + more});
      load[other.type] = 1;
      all += more + alone * pick(0, 20) / 100;
    }
    if (load.size() > 1) x.beside.push_back({on, load, all});
  }
  c.policy.app = c.app.name;
  c.policy.app_hash = c.app.hash();
  c.policy.platform = c.platform.name;
  c.policy.method = "test";
  for (const ChainSpec& chain : c.app.chains)
    c.policy.chains.push_back({chain.name, 900'000'000'000, 0, false});
  return c;
}

/// The claims are exactly what follows; false: nothing is proven.
inline bool claim_what_follows(Case& c) {
  for (ChainClaim& claim : c.policy.chains) claim = {claim.name, 900'000'000'000, 0, false};
  const Result<CheckReport> report = check(c.app, c.platform, c.policy);
  if (!report) return false;
  for (std::size_t k = 0; k < c.policy.chains.size(); ++k) {
    c.policy.chains[k].worst_case_us = report->chains[k].derived_us;
    c.policy.chains[k].lower_bound_us =
        std::min(report->chains[k].own_bound_us, report->chains[k].derived_us);
  }
  return true;
}

/// Each XNode has `factor` times its WCET, and `extra`, after it is ready. Modules may have as many
/// activations in flight as that takes.
inline bool widen(Case& c, double factor, std::int64_t extra) {
  const std::size_t n = c.app.xnodes.size();
  std::vector<std::int64_t> key(n, 0), period(n, 0), phi(n, 0), ready(n, 0);
  for (std::size_t i = 0; i < n; ++i) {  // edges lead from smaller to larger indices
    for (const int s : c.app.xnodes[i].sources) {
      const SourceSpec& source = c.app.sources[at(s)];
      period[i] = source.period.floor_us();
      phi[i] =
          s == c.app.xnodes[i].sources[0] ? source.offset_us : std::min(phi[i], source.offset_us);
    }
    for (const int s : c.app.xnodes[i].sources)
      ready[i] = std::max(
          ready[i], c.app.sources[at(s)].offset_us + c.app.sources[at(s)].jitter_us - phi[i] + 1);
    for (std::size_t e = 0; e < c.app.edges.size(); ++e) {
      const auto& [u, v] = c.app.edges[e];
      if (at(v) != i) continue;
      period[i] = period[at(u)];
      std::int64_t transfer = 0;
      for (const TransferSpec& t : c.app.transfers)
        if (at(t.edge) == e) transfer = t.transfer_us;
      ready[i] = std::max(ready[i], key[at(u)] + transfer);
    }
    Placement& p = c.policy.placements[i];
    const std::int64_t wcet = *c.app.xnodes[i].wcet_on(c.platform.xpus[at(p.xpu)].type);
    key[i] = ready[i] + extra + static_cast<std::int64_t>(factor * static_cast<double>(wcet));
    p.key_us = {key[i]};
  }
  for (ModuleSpec& m : c.app.modules) {
    std::int64_t last = 0, t = 1;
    for (std::size_t i = 0; i < n; ++i)
      if (c.app.xnodes[i].module == m.name) last = std::max(last, key[i]), t = period[i];
    std::int64_t first = last;
    for (std::size_t i = 0; i < n; ++i)
      if (c.app.xnodes[i].module == m.name) first = std::min(first, ready[i]);
    m.max_in_flight = std::max<std::int64_t>(m.max_in_flight, (last - first) * 11 / 10 / t + 1);
  }
  c.policy.app_hash = c.app.hash();
  return claim_what_follows(c);
}

/// Pairs of those that are released together on one XPU, one after the other as long as it holds.
inline void add_order(Case& c, std::uint64_t seed) {
  Random random(seed + 11);
  const auto parts = find_components(c.app);
  if (!parts) return;
  const auto n = static_cast<int>(c.app.xnodes.size());
  for (int u = 0; u < n; ++u)
    for (int v = 0; v < n; ++v) {
      const Placement &a = c.policy.placements[at(u)], &b = c.policy.placements[at(v)];
      if (u == v || a.xpu != b.xpu || a.key_us[0] > b.key_us[0] || random.below(3) == 0 ||
          !released_together(*parts, parts->of[at(u)], parts->of[at(v)]))
        continue;
      const Case before = c;
      c.policy.order.emplace_back(u, v);
      // Room for v behind u, where there is none.
      const std::int64_t wcet = *c.app.xnodes[at(v)].wcet_on(c.platform.xpus[at(b.xpu)].type);
      Placement& late = c.policy.placements[at(v)];
      late.key_us[0] = std::max(late.key_us[0], a.key_us[0] + wcet);
      if (!claim_what_follows(c)) c = before;
    }
}

/// A case that holds, by keys ever wider; nothing: none was found.
inline std::optional<Case> valid(std::uint64_t seed, const Wanted& wanted) {
  Case c = random_app(seed, wanted);
  for (const double factor : {1.0, 1.3, 1.7, 2.0, 2.5, 3.0, 4.0, 6.0, 9.0, 14.0})
    for (const std::int64_t extra : {0, 30, 100, 300, 1000}) {
      Case wide = c;
      if (!widen(wide, factor, extra)) continue;
      if (wanted.holds) {
        Random random(seed + 5);
        for (std::size_t i = 0; i < wide.app.xnodes.size(); ++i) {
          Placement& p = wide.policy.placements[i];
          const std::int64_t wcet = *wide.app.xnodes[i].wcet_on(wide.platform.xpus[at(p.xpu)].type);
          const std::int64_t slack = p.key_us[0] - wcet;
          if (slack > 1 && random.below(2) == 0) {
            Placement before = p;
            p.hold_us = {static_cast<std::int64_t>(random.unit() * static_cast<double>(slack))};
            if (!claim_what_follows(wide)) p = before;
          }
        }
        if (!claim_what_follows(wide)) continue;
      }
      if (wanted.order) add_order(wide, seed);
      return wide;
    }
  return {};
}

/// Keys as small, and modules with as few activations in flight, as `judge` lets them be, one after
/// the other; `arrays`: with a key of its own for each activation of a hyperperiod.
template <typename Judge>
void tighten(Case& c, std::uint64_t seed, bool arrays, const Judge& judge) {
  Random random(seed);
  const auto accepted = [&](Case& next) {
    next.policy.app_hash = next.app.hash();
    for (ChainClaim& claim : next.policy.chains) claim = {claim.name, 900'000'000'000, 0, false};
    return judge(next);
  };
  const auto improve = [&](std::int64_t& value, std::int64_t least) {
    for (std::int64_t step = value - least; step > 0;) {
      const std::int64_t before = value;
      value -= step;
      if (value >= least && accepted(c)) continue;
      value = before;
      step /= 2;
    }
  };
  if (arrays)
    for (std::size_t i = 0; i < c.app.xnodes.size(); ++i) {
      Placement& p = c.policy.placements[i];
      for (const std::size_t size : {6u, 4u, 3u, 2u}) {
        const Placement before = p;
        p.key_us.assign(size, p.key_us[0]);
        if (!p.hold_us.empty()) p.hold_us.assign(size, p.hold_us[0]);
        if (accepted(c)) break;
        p = before;
      }
    }
  for (int round = 0; round < 2; ++round) {
    if (round == 1)
      for (ModuleSpec& m : c.app.modules) improve(m.max_in_flight, 1);
    for (std::size_t i = 0; i < c.app.xnodes.size(); ++i)
      for (std::int64_t& key : c.policy.placements[i].key_us)
        if (arrays || random.below(4) > 0) improve(key, 1);
  }
  accepted(c);
  claim_what_follows(c);
}

/// ... as the check lets them be.
inline void tighten(Case& c, std::uint64_t seed, bool arrays) {
  tighten(c, seed, arrays,
          [](const Case& next) { return check(next.app, next.platform, next.policy).has_value(); });
}

}  // namespace xauto::attack
