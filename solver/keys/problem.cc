// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/problem.h"

#include <algorithm>
#include <map>
#include <numeric>
#include <optional>
#include <string_view>

#include "model/contention.h"

namespace xauto::solver::keys {
namespace {

/// a * b, or nothing where it is above `most`. Both > 0.
bool times(Tick a, Tick b, Tick most, Tick& product) {
  return !__builtin_mul_overflow(a, b, &product) && product <= most;
}

Status too_long(const std::string& what) {
  return fail(ErrorCode::kInvalid,
              what + " does not fit: all periods together need too fine a tick", "sources",
              "state rates with smaller denominators");
}

struct Builder {
  const AppSpec& app;
  Problem& p;
  std::vector<int> topological = {};  ///< by edges and order

  Status ticks(std::int64_t us, const std::string& what, Tick& out) const {
    if (us < 0) return fail(ErrorCode::kInvalid, what + " is below 0", "app");
    if (us > kMostTicks / p.scale) return too_long(what);
    out = us * p.scale;
    return {};
  }

  Status set_scale(const Beside& beside) const {
    for (const Demand& demand : beside.demands)
      if (!times(p.scale / std::gcd(p.scale, demand.ticks_per_us), demand.ticks_per_us,
                 Tick{1} << 30, p.scale))
        return too_long("a tick of the demands");
    for (const SourceSpec& s : app.sources) {
      const std::int64_t den = s.period.den;
      if (s.period.num <= 0 || den <= 0)
        return fail(ErrorCode::kInvalid, "a period that is not above 0", "source '" + s.name + "'");
      if (!times(p.scale / std::gcd(p.scale, den), den, Tick{1} << 30, p.scale))
        return too_long("the period of source '" + s.name + "'");
    }
    return {};
  }

  Status period(const SourceSpec& s, Tick& out) const {
    if (!times(s.period.num, p.scale / s.period.den, kMostTicks, out))
      return too_long("the period of source '" + s.name + "'");
    return {};
  }

  Status set_platform(const Platform& platform, const solver::Problem& base) const {
    p.num_xnodes = base.num_xnodes;
    p.num_xpus = base.num_xpus;
    p.num_types = base.num_types;
    p.type_name = base.type_name;
    p.xpu_type = base.xpu_type;
    p.type_xpus = base.type_xpus;
    p.preemptive = base.preemptive;
    p.groups = base.groups;
    p.group_of.assign(at(p.num_xnodes), -1);
    for (std::size_t g = 0; g < p.groups.size(); ++g)
      for (const int i : p.groups[g]) p.group_of[at(i)] = static_cast<int>(g);
    for (const XNodeSpec& x : app.xnodes) p.xnode_name.push_back(x.name);
    for (const Xpu& xpu : platform.xpus) {
      p.xpu_name.push_back(xpu.id);
      p.xpu_host.push_back(xpu.host);
      Tick cost = 0;
      XAUTO_TRY(ticks(xpu.preempt_us, "preempt_us of XPU '" + xpu.id + "'", cost));
      p.preempt.push_back(cost);
      p.levels.push_back(!xpu.preemptive ? 1 : xpu.levels == 0 ? kAnyLevels : xpu.levels);
    }
    return {};
  }

  /// Demands that are valid, and of this platform.
  Status set_others(const Platform& platform, const Beside& beside) const {
    p.others.resize(at(p.num_xpus));
    p.others_longest.assign(at(p.num_xpus), 0);
    p.others_load.assign(at(p.num_xpus), 0);
    p.reserve_pct = beside.reserve_pct;
    for (std::size_t k = 0; k < beside.demands.size(); ++k) {
      const Tick factor = p.scale / beside.demands[k].ticks_per_us;
      for (const DemandOnXpu& on : beside.demands[k].xpus)
        for (DemandSequence s : on.sequences) {
          const auto m = at(platform.find(on.xpu.id));
          bool fits = times(s.period, factor, 2 * kMostKey, s.period);
          s.slip *= factor;
          for (DemandJob& j : s.jobs) {
            fits = fits && j.key <= kMostKey / factor && j.work <= kMostKey / factor;
            if (!fits) return too_long("a time of the demands");
            for (Tick* t : {&j.release, &j.ready, &j.start, &j.key, &j.work}) *t *= factor;
            if (!s.once)
              p.others_load[m] +=
                  static_cast<double>(p.with_reserve(j.work)) / static_cast<double>(s.period);
          }
          p.others[m].push_back({static_cast<int>(k), std::move(s)});
        }
    }
    for (std::size_t m = 0; m < p.others.size(); ++m) {
      std::map<int, Tick> longest;  // [demand]
      for (const OtherSequence& s : p.others[m])
        for (const DemandJob& j : s.of.jobs)
          longest[s.demand] = std::max(longest[s.demand], j.key - j.start);
      for (const auto& [demand, length] : longest) {
        p.others_longest[m] = std::max(p.others_longest[m], length);
        for (OtherSequence& s : p.others[m])
          if (s.demand != demand) s.beside = std::max(s.beside, length);
      }
    }
    return {};
  }

  Status set_components(const std::vector<std::pair<int, int>>& order) {
    const int n = p.num_xnodes;
    p.component_of.assign(at(n), -1);
    if (static_cast<int>(app.topological_order().size()) != n)
      return fail(ErrorCode::kInvalid, "the edges have a cycle", "edges");
    for (const auto& [u, v] : order)
      if (u < 0 || v < 0 || u >= n || v >= n)
        return fail(ErrorCode::kInvalid, "an XNode that is not there", "order");
    topological = app.topological_order(order);
    if (static_cast<int>(topological.size()) != n)
      return fail(ErrorCode::kInvalid, "the order and the edges have a cycle", "order");
    std::vector<int> parent(at(n));
    std::iota(parent.begin(), parent.end(), 0);
    const auto find = [&](int i) {
      while (parent[at(i)] != i) i = parent[at(i)] = parent[at(parent[at(i)])];
      return i;
    };
    for (const auto& [u, v] : app.edges) parent[at(find(u))] = find(v);
    // All XNodes of a module are in one component.
    std::map<std::string, int> first;
    for (int i = 0; i < n; ++i) {
      const auto [it, fresh] = first.emplace(app.xnodes[at(i)].module, i);
      if (!fresh && find(it->second) != find(i))
        return fail(ErrorCode::kInvalid,
                    "XNodes '" + app.xnodes[at(it->second)].name + "' and '" +
                        app.xnodes[at(i)].name + "' are not joined by edges",
                    "module '" + app.xnodes[at(i)].module + "'", "make two modules of it");
    }
    std::map<int, int> number;
    for (const int i : topological) {
      const auto [it, fresh] = number.emplace(find(i), static_cast<int>(p.components.size()));
      if (fresh) p.components.emplace_back();
      p.component_of[at(i)] = it->second;
      p.components[at(it->second)].xnodes.push_back(i);
    }
    return {};
  }

  /// Clocks, periods and phases of the components, from the sources that their roots hear.
  Status set_clocks(std::vector<int>& clock_of) const {
    clock_of.assign(p.components.size(), -1);
    p.root_ready.assign(at(p.num_xnodes), 0);
    p.root.assign(at(p.num_xnodes), 0);
    for (int i = 0; i < p.num_xnodes; ++i) {
      p.root[at(i)] = p.pred[at(i)].empty() ? 1 : 0;
      const XNodeSpec& x = app.xnodes[at(i)];
      if (p.root[at(i)] != 0 && x.sources.empty())
        return fail(ErrorCode::kInvalid, "it has neither predecessors nor a source",
                    "XNode '" + x.name + "'", "name the source that starts it");
      const int c = p.component_of[at(i)];
      Component& component = p.components[at(c)];
      for (const int s : x.sources) {
        if (s < 0 || at(s) >= app.sources.size())
          return fail(ErrorCode::kInvalid, "a source that is not there", "XNode '" + x.name + "'");
        const SourceSpec& source = app.sources[at(s)];
        if (source.clock < 0 || at(source.clock) >= app.clocks.size())
          return fail(ErrorCode::kInvalid, "a source names a clock that is not there", "sources");
        Tick offset = 0, period_ticks = 0;
        XAUTO_TRY(ticks(source.offset_us, "offset_us of source '" + source.name + "'", offset));
        XAUTO_TRY(period(source, period_ticks));
        if (component.period == 0) {
          component.period = period_ticks;
          component.phase = offset;
          clock_of[at(c)] = source.clock;
        }
        if (component.period != period_ticks || clock_of[at(c)] != source.clock)
          return fail(ErrorCode::kInvalid,
                      "it is joined by edges with XNodes of another period or clock",
                      "XNode '" + x.name + "'", "sample one of them");
        component.phase = std::min(component.phase, offset);
      }
    }
    for (int i = 0; i < p.num_xnodes; ++i)
      for (const int s : app.xnodes[at(i)].sources) {
        const SourceSpec& source = app.sources[at(s)];
        Tick jitter = 0;
        XAUTO_TRY(ticks(source.jitter_us, "jitter_us of source '" + source.name + "'", jitter));
        // Of a clock that may be slow the offset lasts longer.
        const Tick offset =
            source.offset_us * p.scale - p.components[at(p.component_of[at(i)])].phase;
        p.root_ready[at(i)] = std::max(
            p.root_ready[at(i)], jitter + in_slow_time(offset, app.clocks[at(source.clock)].ppm));
      }
    return {};
  }

  /// Components whose releases come round soon, those of one period above all, stay together.
  void split(const Domain& whole) const {
    const std::size_t first = p.domains.size();
    for (const int c : whole.components) {
      const Tick period = p.components[at(c)].period;
      const auto size = static_cast<std::int64_t>(p.components[at(c)].xnodes.size());
      bool placed = false;
      for (std::size_t d = first; d < p.domains.size() && !placed; ++d) {
        Domain& group = p.domains[d];
        Tick hyper = 0;
        if (!times(group.hyper / std::gcd(group.hyper, period), period, Tick{1} << 54, hyper))
          continue;
        const Tick longer = hyper / group.hyper, often = hyper / period;
        if (longer > kMostJobsOfGroup || often > kMostJobsOfGroup ||
            group.jobs * longer + size * often > kMostJobsOfGroup)
          continue;
        group.jobs = group.jobs * longer + size * often;
        group.hyper = hyper;
        group.components.push_back(c);
        placed = true;
      }
      if (placed) continue;
      Domain alone;
      alone.clock = whole.clock;
      alone.ppm = whole.ppm;
      alone.hyper = period;
      alone.jobs = size;
      alone.components = {c};
      alone.part = true;
      p.domains.push_back(std::move(alone));
    }
  }

  /// One domain per clock; where that has too many jobs, several.
  Status set_domains(const std::vector<int>& clock_of) const {
    for (std::size_t k = 0; k < app.clocks.size(); ++k) {
      p.clock_name.push_back(app.clocks[k].name);
      const std::int64_t ppm = app.clocks[k].ppm;
      if (ppm < 0 || ppm > kMaxPpm)
        return fail(ErrorCode::kInvalid, "ppm has to be in [0, 100000]",
                    "clock '" + app.clocks[k].name + "'");
      Domain whole;
      whole.clock = static_cast<int>(k);
      whole.ppm = ppm;
      whole.hyper = 1;
      bool fits = true;
      for (std::size_t c = 0; c < p.components.size(); ++c) {
        if (clock_of[c] != static_cast<int>(k)) continue;
        whole.components.push_back(static_cast<int>(c));
        const Tick period = p.components[c].period;
        fits = fits && times(whole.hyper / std::gcd(whole.hyper, period), period, Tick{1} << 54,
                             whole.hyper);
      }
      if (whole.components.empty()) continue;
      for (std::size_t i = 0; fits && i < whole.components.size(); ++i) {
        const Component& c = p.components[at(whole.components[i])];
        const Tick times_a_hyper = whole.hyper / c.period;
        fits = times_a_hyper <= kMostJobs;
        if (fits) whole.jobs += times_a_hyper * static_cast<Tick>(c.xnodes.size());
      }
      if (fits && whole.jobs <= kMostJobs) {
        p.domains.push_back(std::move(whole));
        continue;
      }
      split(whole);
    }
    p.slot.assign(at(p.num_xnodes), 0);
    p.jobs.assign(at(p.num_xnodes), 1);
    for (std::size_t d = 0; d < p.domains.size(); ++d)
      for (const int c : p.domains[d].components) {
        Component& component = p.components[at(c)];
        component.domain = static_cast<int>(d);
        component.jobs = static_cast<int>(p.domains[d].hyper / component.period);
      }
    for (const int i : topological) p.domains[at(p.domain_of(i))].xnodes.push_back(i);
    for (const Domain& domain : p.domains)
      for (const int i : domain.xnodes) {
        p.slot[at(i)] = p.num_slots;
        p.jobs[at(i)] = p.components[at(p.component_of[at(i)])].jobs;
        p.num_slots += p.jobs[at(i)];
        p.slot_xnode.insert(p.slot_xnode.end(), at(p.jobs[at(i)]), i);
      }
    return {};
  }

  /// XPUs that an XNode may be on: those on which one activation takes no longer than a period.
  Status set_wcets(const solver::Problem& base) const {
    p.may_run.resize(at(p.num_xnodes));
    for (int i = 0; i < p.num_xnodes; ++i)
      for (int m = 0; m < p.num_xpus; ++m) {
        const Time us = base.wcet_on(i, m);
        // A longer one than any tick is far above every period.
        const Tick work = us == kCannotRun            ? kNoTick
                          : us > kMostTicks / p.scale ? kMostTicks
                                                      : us * p.scale;
        p.wcet_flat.push_back(work);
        if (work != kNoTick && work <= p.period_of(i)) p.may_run[at(i)].push_back(m);
      }
    set_places();
    return {};
  }

  /// `wcet_flat` is set. Types that the platform lacks load nothing.
  void set_loaded(const Platform& platform) const {
    p.loaded.resize(at(p.num_xnodes) * at(p.num_types));
    std::vector<std::int64_t> xpus;  // of each type
    for (int t = 0; t < p.num_types; ++t)
      xpus.push_back(static_cast<std::int64_t>(platform.instances_of(p.type_name[at(t)]).size()));
    for (int i = 0; i < p.num_xnodes; ++i)
      for (const BesideSpec& beside : app.xnodes[at(i)].beside) {
        const auto on = std::find(p.type_name.begin(), p.type_name.end(), beside.on);
        if (on == p.type_name.end()) continue;
        const std::size_t type = static_cast<std::size_t>(on - p.type_name.begin());
        auto& all = p.loaded[at(i) * at(p.num_types) + type];
        if (all.empty())
          all.push_back(
              {std::vector<int>(at(p.num_types), 0), p.wcet(i, p.type_xpus[type].front())});
        LoadedWcet one{std::vector<int>(at(p.num_types), 0),
                       std::min(beside.wcet_us, kMostTicks / p.scale) * p.scale};
        for (std::size_t t = 0; t < xpus.size(); ++t)
          if (const auto of = beside.load.find(p.type_name[t]); of != beside.load.end())
            one.load[t] = static_cast<int>(std::min(of->second, xpus[t]));
        all.push_back(std::move(one));
        p.contended = true;
      }
  }

  void set_places() const {
    std::map<std::pair<int, std::vector<Tick>>, int> known;  // type, and the WCETs there
    for (int m = 0; m < p.num_xpus; ++m) {
      std::vector<Tick> column;
      for (int i = 0; i < p.num_xnodes; ++i) column.push_back(p.wcet(i, m));
      const auto [place, fresh] = known.try_emplace({p.xpu_type[at(m)], std::move(column)},
                                                    static_cast<int>(p.place_xpus.size()));
      if (fresh) p.place_xpus.emplace_back();
      p.place_xpus[at(place->second)].push_back(m);
      p.xpu_place.push_back(place->second);
    }
  }

  Status set_edges() const {
    p.pred.resize(at(p.num_xnodes));
    p.succ.resize(at(p.num_xnodes));
    std::vector<int> transfer_of(app.edges.size(), -1);
    for (const TransferSpec& t : app.transfers) {
      if (t.edge < 0 || at(t.edge) >= app.edges.size())
        return fail(ErrorCode::kInvalid, "an edge that is not there", "transfers");
      int& index = transfer_of[at(t.edge)];
      if (index < 0) {
        index = static_cast<int>(p.transfers.size());
        p.transfers.emplace_back(at(p.num_types) * at(p.num_types), 0);
      }
      const auto type = [&](const std::string& name) {
        return std::find(p.type_name.begin(), p.type_name.end(), name) - p.type_name.begin();
      };
      const auto from = type(t.from_type), to = type(t.to_type);
      if (from >= p.num_types || to >= p.num_types) continue;  // no such XPU here
      Tick cost = 0;
      XAUTO_TRY(ticks(t.transfer_us, "transfer_us", cost));
      p.transfers[at(index)][static_cast<std::size_t>(from * p.num_types + to)] = cost;
    }
    for (std::size_t e = 0; e < app.edges.size(); ++e) {
      const auto [u, v] = app.edges[e];
      p.succ[at(u)].push_back({v, transfer_of[e]});
      p.pred[at(v)].push_back({u, transfer_of[e]});
    }
    return {};
  }

  /// Behind all that is by edges alone.
  Status add_order(const std::vector<std::pair<int, int>>& order) const {
    if (order.empty()) return {};
    for (const auto& [u, v] : order) {
      if (!p.released_together(p.component_of[at(u)], p.component_of[at(v)]))
        return fail(ErrorCode::kInvalid,
                    "XNodes '" + app.xnodes[at(u)].name + "' and '" + app.xnodes[at(v)].name +
                        "' are not released together",
                    "order");
      p.succ[at(u)].push_back({v, -1});
      p.pred[at(v)].push_back({u, -1});
    }
    set_reach(order);
    return {};
  }

  /// Components that `order` joins are one part.
  void set_reach(const std::vector<std::pair<int, int>>& order) const {
    std::vector<int> part(p.components.size());
    std::iota(part.begin(), part.end(), 0);
    const auto find = [&](int c) {
      while (part[at(c)] != c) c = part[at(c)] = part[at(part[at(c)])];
      return c;
    };
    for (const auto& [u, v] : order)
      part[at(find(p.component_of[at(u)]))] = find(p.component_of[at(v)]);
    p.part_of.resize(at(p.num_xnodes));
    p.place.resize(at(p.num_xnodes));
    p.reach.resize(at(p.num_xnodes));
    std::vector<std::vector<int>> parts(p.components.size());
    for (const int i : topological) {
      p.part_of[at(i)] = find(p.component_of[at(i)]);
      parts[at(p.part_of[at(i)])].push_back(i);
    }
    for (const std::vector<int>& xnodes : parts) {
      const std::size_t words = (xnodes.size() + 63) / 64;
      for (std::size_t k = 0; k < xnodes.size(); ++k) p.place[at(xnodes[k])] = static_cast<int>(k);
      for (auto i = xnodes.rbegin(); i != xnodes.rend(); ++i) {
        std::vector<std::uint64_t>& behind = p.reach[at(*i)];
        behind.assign(words, 0);
        for (const EdgeEnd& s : p.succ[at(*i)]) {
          const int k = p.place[at(s.xnode)];
          behind[at(k / 64)] |= std::uint64_t{1} << (k % 64);
          for (std::size_t w = 0; w < words; ++w) behind[w] |= p.reach[at(s.xnode)][w];
        }
      }
    }
  }

  Status set_modules() const {
    std::map<std::string, int> number;
    std::map<std::string_view, std::int64_t> in_flight;
    for (const ModuleSpec& m : app.modules) in_flight[m.name] = m.max_in_flight;
    p.module_of.assign(at(p.num_xnodes), -1);
    p.entry.assign(at(p.num_xnodes), 0);
    for (int i = 0; i < p.num_xnodes; ++i) {
      const std::string& name = app.xnodes[at(i)].module;
      const auto [it, fresh] = number.emplace(name, static_cast<int>(p.modules.size()));
      if (fresh) {
        Module module;
        module.component = p.component_of[at(i)];
        if (const auto limit = in_flight.find(name); limit != in_flight.end())
          module.in_flight = limit->second;
        if (module.in_flight < 1)
          return fail(ErrorCode::kInvalid, "max_in_flight has to be at least 1",
                      "module '" + name + "'");
        p.modules.push_back(std::move(module));
      }
      p.module_of[at(i)] = it->second;
      p.modules[at(it->second)].xnodes.push_back(i);
    }
    for (Module& module : p.modules)
      for (const int i : module.xnodes)
        if (std::none_of(p.pred[at(i)].begin(), p.pred[at(i)].end(), [&](const EdgeEnd& l) {
              return p.module_of[at(l.xnode)] == p.module_of[at(i)];
            })) {
          module.entries.push_back(i);
          p.entry[at(i)] = 1;
        }
    return {};
  }

  /// Behind `reach`.
  Status set_urgent() const {
    p.urgent.assign(at(p.num_xnodes), 0);
    for (int i = 0; i < p.num_xnodes; ++i)
      for (const int s : app.xnodes[at(i)].sources) {
        const SourceSpec& source = app.sources[at(s)];
        if (!source.urgent) continue;
        Component& c = p.components[at(p.component_of[at(i)])];
        if (c.urgent_source >= 0 && c.urgent_source != s)
          return fail(ErrorCode::kInvalid, "two sources of one component may be urgent", "sources");
        c.urgent_source = s;
        Tick every = 0;
        XAUTO_TRY(
            ticks(source.urgent->by_us, "by_us of source '" + source.name + "'", c.urgent_by));
        XAUTO_TRY(
            ticks(source.urgent->every_us, "every_us of source '" + source.name + "'", every));
        // Releases are on the grid: so are the distances of those that are urgent.
        c.urgent_every = (every + c.period - 1) / c.period * c.period;
        if (c.urgent_every > kMostTicks)
          return too_long("every_us of source '" + source.name + "'");
        p.any_urgent = true;
        const std::string& marks = source.urgent->marked_by;
        for (const int first : marks.empty() ? std::vector<int>{i} : readers_of(marks))
          for (const int j : c.xnodes)
            if (j == first || p.before(first, j)) p.urgent[at(j)] = 1;
      }
    return {};
  }
  /// XNodes that take what this module publishes.
  [[nodiscard]] std::vector<int> readers_of(const std::string& module) const {
    std::vector<int> readers;
    for (const auto& [u, v] : app.edges)
      if (app.xnodes[at(u)].module == module && app.xnodes[at(v)].module != module)
        readers.push_back(v);
    return readers;
  }

  [[nodiscard]] bool along_edges(int u, int v) const { return u == v || p.before(u, v); }

  /// All ways on from `v`, of a component not seen before.
  Status follow(int v, std::vector<int>& way, std::vector<char>& seen, Chain& chain,
                std::size_t& left, std::int64_t& steps) const {
    const auto add = [&]() -> Status {
      // Roots of one component give the same way more than once; the direct one is what most have.
      if (way.empty() && std::any_of(chain.paths.begin(), chain.paths.end(),
                                     [](const Path& one) { return one.samples.empty(); }))
        return {};
      if (left-- == 0)
        return fail(ErrorCode::kInvalid,
                    "more than " + std::to_string(kMostPaths) + " ways through samples",
                    "chain '" + chain.name + "'", "state the chains that matter in \"chains\"");
      chain.paths.push_back({way});
      return {};
    };
    if (along_edges(v, chain.to)) XAUTO_TRY(add());
    for (std::size_t s = 0; s < p.samples.size(); ++s) {
      const auto [from, to] = p.samples[s];
      const int next = p.component_of[at(to)];
      if (seen[at(next)] != 0 || !along_edges(v, from)) continue;
      if (++steps > kMostPathSteps)
        return fail(ErrorCode::kInvalid, "too many ways through samples",
                    "chain '" + chain.name + "'", "state the chains that matter in \"chains\"");
      seen[at(next)] = 1;
      way.push_back(static_cast<int>(s));
      XAUTO_TRY(follow(to, way, seen, chain, left, steps));
      way.pop_back();
      seen[at(next)] = 0;
    }
    return {};
  }

  Status set_chains() const {
    p.samples = app.samples;
    p.sample_passes.assign(p.samples.size(), 0);
    for (std::size_t s = 0; s < app.sample_us.size(); ++s)
      XAUTO_TRY(ticks(app.sample_us[s], "sample_us", p.sample_passes[s]));
    p.reads.assign(at(p.num_xnodes), 0);
    for (const auto& [u, v] : p.samples) {
      if (u < 0 || v < 0 || u >= p.num_xnodes || v >= p.num_xnodes)
        return fail(ErrorCode::kInvalid, "an XNode that is not there", "samples");
      p.reads[at(v)] = 1;
    }
    std::vector<std::vector<int>> heard_by(app.sources.size());  // per source: its XNodes
    for (int i = 0; i < p.num_xnodes; ++i)
      for (const int source : app.xnodes[at(i)].sources) heard_by[at(source)].push_back(i);
    std::size_t left = kMostPaths + app.chains.size();  // each has one that is direct
    for (const ChainSpec& spec : app.chains) {
      Chain chain;
      chain.name = spec.name;
      chain.source = spec.from;
      chain.to = spec.to;
      chain.weight = spec.weight;
      if (spec.from < 0 || at(spec.from) >= app.sources.size() || spec.to < 0 ||
          spec.to >= p.num_xnodes || spec.weight < 0 || spec.weight > kMaxTimeUs)
        return fail(ErrorCode::kInvalid, "its source, XNode or weight is out of range",
                    "chain '" + spec.name + "'");
      chain.offset = app.sources[at(spec.from)].offset_us * p.scale;
      if (spec.deadline_us)
        XAUTO_TRY(ticks(*spec.deadline_us, "deadline_us of '" + spec.name + "'", chain.deadline));
      std::int64_t steps = 0;
      for (const int i : heard_by[at(spec.from)]) {
        std::vector<int> way;
        std::vector<char> seen(p.components.size(), 0);
        seen[at(p.component_of[at(i)])] = 1;
        XAUTO_TRY(follow(i, way, seen, chain, left, steps));
      }
      // Roots of one component give the same way more than once.
      std::sort(chain.paths.begin(), chain.paths.end(),
                [](const Path& a, const Path& b) { return a.samples < b.samples; });
      chain.paths.erase(std::unique(chain.paths.begin(), chain.paths.end()), chain.paths.end());
      if (chain.paths.empty())
        return fail(ErrorCode::kInvalid,
                    "XNode '" + app.xnodes[at(spec.to)].name + "' hears nothing of source '" +
                        app.sources[at(spec.from)].name + "'",
                    "chain '" + spec.name + "'");
      p.deadlines = p.deadlines || chain.deadline != kNoTick;
      p.chains.push_back(std::move(chain));
    }
    Tick longest = 1;
    for (const Chain& chain : p.chains)
      if (chain.deadline != kNoTick) longest = std::max(longest, chain.deadline);
    for (Chain& chain : p.chains)
      chain.by = chain.deadline != kNoTick ? std::max(Tick{1}, chain.deadline) : longest;
    return {};
  }
};

}  // namespace

Result<Problem> Problem::create(const AppSpec& stated, const Platform& platform,
                                const Objectives& wishes,
                                const std::vector<std::pair<int, int>>& order,
                                const Beside& beside) {
  XAUTO_TRY(validate(stated));
  // Other apps may be on every XPU at any time.
  std::optional<AppSpec> longest;
  const AppSpec& app = beside.nobody() ? stated : longest.emplace(at_longest(stated));
  if (!beside.nobody()) XAUTO_TRY(has_demand(app));
  for (const Demand& demand : beside.demands) {
    XAUTO_TRY(validate(demand));
    XAUTO_TRY(validate_on(demand, platform));
  }
  XAUTO_ASSIGN(solver::Problem base, solver::Problem::create(app, platform));
  Objectives placing;
  placing.pins = wishes.pins;
  placing.forbids = wishes.forbids;
  placing.groups = wishes.groups;
  XAUTO_TRY(resolve(placing, app, platform, base));
  Problem p;
  Builder build{app, p};
  XAUTO_TRY(build.set_scale(beside));
  XAUTO_TRY(build.set_platform(platform, base));
  XAUTO_TRY(build.set_others(platform, beside));
  XAUTO_TRY(build.set_edges());
  XAUTO_TRY(build.set_components(order));
  std::vector<int> clock_of;
  XAUTO_TRY(build.set_clocks(clock_of));
  XAUTO_TRY(build.set_domains(clock_of));
  XAUTO_TRY(build.set_wcets(base));
  build.set_loaded(platform);
  build.set_reach({});
  XAUTO_TRY(build.set_urgent());
  XAUTO_TRY(build.set_modules());
  XAUTO_TRY(build.set_chains());
  XAUTO_TRY(build.add_order(order));
  return p;
}

std::vector<Tick> least_wcets(const Problem& p) {
  std::vector<Tick> least(at(p.num_xnodes), 0);
  for (int i = 0; i < p.num_xnodes; ++i)
    for (const int m : p.may_run[at(i)])
      if (least[at(i)] == 0 || p.wcet(i, m) < least[at(i)]) least[at(i)] = p.wcet(i, m);
  return least;
}

Tick in_fast_time(Tick t, std::int64_t ppm) {
  if (ppm == 0) return t;
  return static_cast<Tick>((static_cast<__int128>(t) * kMillion + (kMillion - ppm) - 1) /
                           (kMillion - ppm));
}

Tick in_slow_time(Tick t, std::int64_t ppm) {
  if (ppm == 0) return t;
  return static_cast<Tick>((static_cast<__int128>(t) * (kMillion + ppm) + kMillion - 1) / kMillion);
}

std::string Problem::place_name(std::size_t at_place) const {
  const std::vector<int>& xpus = place_xpus[at_place];
  const int type = xpu_type[at(xpus.front())];
  if (xpus.size() == type_xpus[at(type)].size()) return type_name[at(type)];
  std::string names;
  for (const int m : xpus) names += (names.empty() ? "" : ", ") + xpu_name[at(m)];
  return names;
}

}  // namespace xauto::solver::keys
