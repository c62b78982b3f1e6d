// SPDX-License-Identifier: Apache-2.0
// Changes of tables, derived again: the walks of check_handover_walk.h for each S and t, and chains
// followed on what they find. Nothing follows for a clock that shares an XPU with another one.
#include "solver/keys/check_handover.h"

#include <algorithm>
#include <map>
#include <optional>
#include <set>
#include <tuple>
#include <utility>

#include <fmt/format.h>

#include "base/index.h"
#include "solver/keys/check_chains.h"
#include "solver/keys/check_handover_walk.h"
#include "solver/keys/check_world.h"

namespace xauto::solver::keys {
namespace checking::tables {

constexpr std::size_t kMaxWays = 100'000;  ///< of all chains

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
      reached.insert(w_.hearers[at(x)].begin(), w_.hearers[at(x)].end());
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

/// Of a way, on one clock: from a release of the source, or from what a reader has just missed.
struct Part {
  int clock = -1;
  int source = -1;  ///< that the way begins at, or
  int reader = -1;  ///< the XNode through which it enters that clock
  Way samples;
  int last = -1;    ///< XNode
  Ticks alone = 0;  ///< no longer under p
  Ticks worst = 0;  ///< of all that was looked at; both are in the clock's own time
};

struct Chain {
  std::size_t index = 0;
  std::vector<Part> parts;
  std::vector<std::vector<std::size_t>> ways;  ///< of parts
  Ticks worst = 0;                             ///< under one table, in real time
};

/// Each way cut where it enters another clock.
Chain cut(const World& w, std::size_t index, const Ways& ways) {
  const ChainSpec& spec = w.app.chains[index];
  Chain chain{index, {}, {}, 0};
  std::map<std::tuple<int, Way, int>, std::size_t> known;
  for (const Way& way : ways.all()) {
    std::vector<std::size_t>& parts = chain.ways.emplace_back();
    Part part;
    part.source = spec.from;
    part.clock = w.app.sources[at(spec.from)].clock;
    const auto end_with = [&](int last) {
      part.last = last;
      const auto [found, is_new] =
          known.try_emplace({part.reader, part.samples, last}, chain.parts.size());
      if (is_new) chain.parts.push_back(part);
      parts.push_back(found->second);
    };
    for (const auto& [u, v] : way) {
      if (const int clock = w.home(v).clock; clock != part.clock) {
        end_with(u);
        part = {};
        part.clock = clock;
        part.reader = v;
      } else {
        part.samples.emplace_back(u, v);
      }
    }
    end_with(spec.to);
  }
  return chain;
}

/// One table alone, as a Walk in which nothing happens.
struct Alone {
  const World& w;
  Drift clock;
  [[nodiscard]] const Drift& drift() const { return clock; }
  [[nodiscard]] static bool ends_by_key(int /*xnode*/, std::int64_t /*n*/) { return true; }
  [[nodiscard]] const Window& window(int xnode, std::int64_t n) const { return w.window(xnode, n); }
  [[nodiscard]] Ticks instant(int xnode, std::int64_t n, Ticks after) const {
    const Component& c = w.home(xnode);
    return c.phi + n * c.period + after;
  }
  [[nodiscard]] Ticks end(int xnode, std::int64_t n) const {
    return instant(xnode, n, clock.late(w.window(xnode, n).d));
  }
  [[nodiscard]] Ticks starts(int xnode, std::int64_t n) const {
    return instant(xnode, n, clock.soon(w.window(xnode, n).e));
  }
};

/// The activation of the part's last XNode that certainly knows what activation n of its first does.
template <typename On>
std::int64_t arrives(const Both& both, const On& on, const Part& part, std::int64_t n) {
  for (const auto& sample : part.samples) {
    const int u = sample.first, v = sample.second;
    const Ticks end = on.end(u, n);
    const Component &to = both.p.home(v), &from = both.p.home(u);
    const Ticks released = from.phi + n * from.period;
    // What ends by its key does so a real time after its release, as its reader starts after its own.
    const bool by_key = on.drift().ppm > 0 && on.ends_by_key(u, n);
    const Ticks due = by_key ? on.window(u, n).d : 0;
    const auto knows = [&](std::int64_t m) {
      return on.starts(v, m) >= end ||
             (by_key &&
              least(to.phi + m * to.period - released, on.drift().ppm) + on.window(v, m).e >= due);
    };
    const Ticks from_on = by_key ? std::min(end, released + due) : end;
    n = floor_div(from_on - both.latest_start[at(v)] - to.phi, to.period);
    while (!knows(n)) ++n;
  }
  return n;
}

/// When the part begins for activation n: n reads what ends by then, or later than n - 1 can have read.
template <typename On>
Ticks begins(const Both& both, const On& on, const Part& part, std::int64_t n) {
  if (part.reader >= 0) return on.starts(part.reader, n - 1);
  const SourceSpec& source = both.p.app.sources[at(part.source)];
  return source.offset_us * both.p.scale +
         n * source.period.num * (both.p.scale / source.period.den);
}

/// The longest under p and under q alone, of a part that no claim is known of. False: too many jobs.
bool follow_alone(const Both& both, Ticks hyperperiod, std::int64_t& budget, Part& part) {
  const int first = part.reader >= 0       ? part.reader
                    : part.samples.empty() ? part.last
                                           : part.samples[0].first;
  const Drift drift{both.p.app.clocks[at(part.clock)].ppm};
  for (const World* w : {&both.p, &both.q}) {
    const Alone alone{*w, drift};
    for (std::int64_t n = 0; n < hyperperiod / w->home(first).period; ++n) {
      if (--budget < 0) return false;
      part.worst = std::max(part.worst, alone.end(part.last, arrives(both, alone, part, n)) -
                                            begins(both, alone, part, n));
    }
    if (w == &both.p) part.alone = part.worst;
  }
  return true;
}

/// From S and [t', t''] on: the longest that meets a job that was walked.
template <typename On>
void follow(const Both& both, const On& walk, Ticks high, Part& part) {
  // What p alone brings through before t'' meets none; what is released after L is q's alone.
  const Ticks from = high - part.alone - 2 * (walk.drift().late(0));
  std::int64_t n = 0;
  if (part.reader < 0) {
    const Ticks period = begins(both, walk, part, 1) - begins(both, walk, part, 0);
    n = floor_div(from - begins(both, walk, part, 0), period);
  } else {
    const Component& home = both.p.home(part.reader);
    n = floor_div(from - both.latest_start[at(part.reader)] - home.phi, home.period);
  }
  for (;; ++n) {
    if (part.reader < 0
            ? begins(both, walk, part, n) > walk.last()
            : walk.release(part.reader, n) > walk.last() && walk.of_q(part.reader, n - 1))
      return;
    const std::int64_t last = arrives(both, walk, part, n);
    if (walk.in_u(part.last, last))
      part.worst = std::max(part.worst, walk.end(part.last, last) - begins(both, walk, part, n));
  }
}

// --------------------------------------------------------------------------------------- clocks

struct Budget {
  std::int64_t jobs = 0;
};

/// All S of a hyperperiod, and all t. False: too many jobs.
bool walk_clock(const Both& both, int clock, Ticks hyperperiod, Ticks notice, Budget& budget,
                const std::vector<Part*>& parts, Ticks& settles) {
  const World& p = both.p;
  const Drift drift{p.app.clocks[at(clock)].ppm};
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
    const Ticks low = before - drift.longest(notice);
    std::set<Ticks> cuts = {low, change};
    for (const Component& c : p.components) {
      if (c.clock != clock) continue;
      for (const int i : c.xnodes)
        for (std::int64_t n = ceil_div(change - c.phi, c.period) - 1;; --n) {
          const Ticks key = c.phi + n * c.period + drift.late(p.window(i, n).d);
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
      for (Part* part : parts) follow(both, walk, high, *part);
    }
    before = change;
  }
  return true;
}

/// The first XPU that a clock shares with another one, by both placements alone.
std::string who_shares(const Both& both, const AppSpec& app, int clock) {
  const ClockSpec& spec = app.clocks[at(clock)];
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

/// Of both tables; 0: it does not fit, nullopt: nothing has that clock.
std::optional<Ticks> hyperperiod_of(const Both& both, int clock) {
  std::optional<Ticks> all;
  for (const World* w : {&both.p, &both.q})
    for (const Component& c : w->components)
      if (c.clock == clock && all.value_or(1) > 0) all = lcm(all.value_or(1), c.pattern());
  return all;
}

/// In ticks of 1/scale us, where its own are finer. `a` and `e` are taken short: q's certificate may
/// be of the finer ones.
void coarsen(World& w, std::int64_t scale) {
  const std::int64_t by = w.scale / scale;
  if (by == 1) return;
  w.scale = scale;
  for (Component& c : w.components) {
    c.period /= by;
    c.phi /= by;
  }
  for (Ticks& c : w.wcet) c /= by;
  for (auto& before : w.before)
    for (auto& [u, transfer] : before) transfer /= by;
  for (auto& windows : w.windows)
    for (Window& window : windows)
      window = {floor_div(window.a, by), window.d / by, floor_div(window.e, by)};
}

/// The same keys for an app that differs in times.
Policy meant_for(Policy policy, const AppSpec& app) {
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
      x.typical_us.clear();
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

/// The larger WCETs, and until when each job of either table has started.
Result<Both> both_of(const World& p, const World& q, const World& larger) {
  for (std::size_t i = 0; i < p.wcet.size(); ++i)
    if (larger.wcet[i] < p.wcet[i])
      return fail(ErrorCode::kInvalid, "its larger WCET is less than that of one table",
                  "XNode '" + p.name(static_cast<int>(i)) + "'");
  Both both{p, q, larger.wcet, {}};
  for (std::size_t i = 0; i < p.wcet.size(); ++i) {
    both.latest_start.push_back(0);
    for (const World* w : {&p, &q})
      for (const Window& window : w->windows[i])
        both.latest_start[i] = std::max(both.latest_start[i], window.e);
  }
  return both;
}

/// What is claimed of a chain where nothing changes.
struct Settled {
  std::int64_t of_both_us = 0;   ///< the longer of both tables' own
  std::int64_t of_first_us = 0;  ///< the first one's
};
Result<std::vector<Settled>> settled_of(const World& p, const World& q, std::size_t chains) {
  std::vector<Settled> settled(chains);
  for (std::size_t k = 0; k < chains; ++k) {
    XAUTO_ASSIGN(const ChainProof under_p, derive_chain(p, k, false));
    XAUTO_ASSIGN(const ChainProof under_q, derive_chain(q, k, false));
    settled[k] = {std::max(under_p.derived_us, under_q.derived_us), under_p.derived_us};
  }
  return settled;
}

/// A chain, and where it leads.
struct Followed {
  Chain chain;
  std::set<int> clocks;
  bool too_many = false;  ///< ways
  Ticks settled_first = 0;
};
std::vector<Followed> chains_of(const World& p, const AppSpec& app,
                                const std::vector<Settled>& settled) {
  std::vector<Followed> found;
  for (std::size_t k = 0; k < app.chains.size(); ++k) {
    const Ways ways(p, app.chains[k]);
    found.push_back({ways.too_many() ? Chain{k, {}, {}, 0} : cut(p, k, ways), ways.clocks(),
                     ways.too_many(), settled[k].of_first_us * p.scale});
    found.back().chain.worst = settled[k].of_both_us * p.scale;
  }
  return found;
}

/// What a change does to what is on one clock.
struct OnClock {
  std::string why_not;  ///< empty: it is known
  std::int64_t settles_us = 0;
};
OnClock change_on(const Both& both, const AppSpec& app, int number, Ticks notice, Budget& budget,
                  std::vector<Followed>& chains) {
  const ClockSpec& clock = app.clocks[at(number)];
  const auto hyperperiod = hyperperiod_of(both, number);
  if (!hyperperiod) return {};
  if (std::string shares = who_shares(both, app, number); !shares.empty())
    return {std::move(shares)};
  if (*hyperperiod == 0)
    return {fmt::format("the hyperperiod of clock '{}' does not fit", clock.name)};
  const Drift drift{clock.ppm};
  std::vector<Part*> parts;
  bool done = true;
  for (Followed& of : chains)
    for (Part& part : of.chain.parts) {
      if (part.clock != number) continue;
      parts.push_back(&part);
      // A way on one clock is in the chain's own worst cases.
      if (part.source >= 0 && part.last == app.chains[of.chain.index].to)
        part.alone = drift.longest(of.settled_first);
      else
        done = done && follow_alone(both, *hyperperiod, budget.jobs, part);
    }
  Ticks settles = 0;
  if (!done || !walk_clock(both, number, *hyperperiod, notice, budget, parts, settles))
    return {fmt::format("clock '{}' takes more jobs than are looked at, or does not settle",
                        clock.name)};
  return {{}, both.p.us_up(most(settles, clock.ppm))};
}

/// Its ways, with the longest that each part of them takes.
Ticks worst_of(const Chain& chain, const AppSpec& app) {
  Ticks worst = chain.worst;
  for (const auto& way : chain.ways) {
    Ticks sum = 0;
    for (const std::size_t part : way)
      sum += most(chain.parts[part].worst, app.clocks[at(chain.parts[part].clock)].ppm);
    worst = std::max(worst, sum);
  }
  return worst;
}

void prove(const Followed& of, const AppSpec& app, const std::vector<OnClock>& clocks,
           const World& p, HandoverProof& proof) {
  const std::size_t k = of.chain.index;
  std::string why = of.too_many ? "it has too many ways" : "";
  for (const int clock : of.clocks) {
    proof.chain_settles_us[k] = std::max(proof.chain_settles_us[k], clocks[at(clock)].settles_us);
    if (why.empty()) why = clocks[at(clock)].why_not;
  }
  if (why.empty())
    proof.worst_case_us[k] = p.us_up(worst_of(of.chain, app));
  else
    proof.why_not.push_back(fmt::format("chain '{}': {}", app.chains[k].name, why));
}

}  // namespace checking::tables

Result<HandoverProof> derive_handover(const TwoTables& tables, std::int64_t most_jobs) {
  namespace own = checking::tables;
  XAUTO_TRY(own::check_input(tables, most_jobs));
  const AppSpec& app = tables.app_from;
  const Policy from_both = own::meant_for(tables.from, tables.app_both);
  XAUTO_ASSIGN(checking::World p, checking::derive(app, tables.platform, tables.from));
  XAUTO_ASSIGN(checking::World q, checking::derive(tables.app_to, tables.platform, tables.to));
  XAUTO_ASSIGN(checking::World larger,
               checking::structure(tables.app_both, tables.platform, from_both, true));
  HandoverProof proof;
  proof.worst_case_us.resize(app.chains.size());
  proof.chain_settles_us.resize(app.chains.size());
  const bool urgent =
      std::ranges::any_of(app.sources, [](const SourceSpec& s) { return s.urgent.has_value(); });
  std::vector<own::Settled> settled;
  if (!urgent) {
    XAUTO_ASSIGN(settled, own::settled_of(p, q, app.chains.size()));
  }
  const std::int64_t scale = std::min({p.scale, q.scale, larger.scale});
  for (checking::World* w : {&p, &q, &larger}) own::coarsen(*w, scale);
  XAUTO_ASSIGN(const own::Both both, own::both_of(p, q, larger));
  if (urgent) {
    for (const ChainSpec& chain : app.chains)
      proof.why_not.push_back(fmt::format("chain '{}': the app has urgent releases", chain.name));
    return proof;
  }
  std::vector<own::Followed> chains = own::chains_of(p, app, settled);
  own::Budget budget{most_jobs};
  std::vector<own::OnClock> clocks;
  for (std::size_t clock = 0; clock < app.clocks.size(); ++clock) {
    clocks.push_back(own::change_on(both, app, static_cast<int>(clock), tables.notice_us * p.scale,
                                    budget, chains));
    proof.settles_us = std::max(proof.settles_us, clocks.back().settles_us);
  }
  for (const own::Followed& of : chains) own::prove(of, app, clocks, p, proof);
  return proof;
}

}  // namespace xauto::solver::keys
