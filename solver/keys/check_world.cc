// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/check_world.h"

#include <algorithm>
#include <map>
#include <numeric>
#include <queue>
#include <string_view>

#include <fmt/format.h>

#include "solver/keys/check_contention.h"

namespace xauto::solver::keys::checking {

Ticks floor_div(__int128 a, Ticks b) {
  const __int128 q = a / b;
  return static_cast<Ticks>(q * b > a ? q - 1 : q);
}

Ticks ceil_div(__int128 a, Ticks b) {
  const __int128 q = a / b;
  return static_cast<Ticks>(q * b < a ? q + 1 : q);
}

Ticks least(Ticks x, std::int64_t ppm) {
  return floor_div(static_cast<__int128>(x) * (kMillion - (x < 0 ? -ppm : ppm)), kMillion);
}

Ticks most(Ticks x, std::int64_t ppm) {
  return ceil_div(static_cast<__int128>(x) * (kMillion + (x < 0 ? -ppm : ppm)), kMillion);
}

Ticks lcm(Ticks a, Ticks b) {
  const __int128 l = static_cast<__int128>(a / std::gcd(a, b)) * b;
  return l > kMaxTicks ? 0 : static_cast<Ticks>(l);
}

std::int64_t World::us_up(Ticks t) const {
  return ceil_div(t, scale);
}

namespace world {

constexpr std::int64_t kMaxPpm = 500'000;
constexpr std::int64_t kMaxWindows = 8'000'000;
constexpr std::int64_t kMaxInFlight = 10'000;  ///< activations of one XNode

bool in(int index, std::size_t size) {
  return index >= 0 && at(index) < size;
}

tl::unexpected<Error> invalid(std::string what, std::string where, std::string hint = {}) {
  return fail(ErrorCode::kInvalid, std::move(what), std::move(where), std::move(hint));
}

std::string place(const World& w, int xnode, std::int64_t activation) {
  return fmt::format("XNode '{}', activation {}", w.name(xnode), activation);
}

/// Indices, so that nothing below reads beside an array. What the readers refuse is not repeated.
Status check_indices(const AppSpec& app, const Platform& platform, const Policy& policy) {
  if (app.sources.empty()) return invalid("no source", "app '" + app.name + "'");
  const std::size_t n = app.xnodes.size();
  if (n == 0) return invalid("no XNode", "app '" + app.name + "'");
  const auto pairs = [&](const auto& all, const char* what, bool with_itself) -> Status {
    for (const auto& [u, v] : all)
      if (!in(u, n) || !in(v, n) || (u == v && !with_itself))
        return invalid(fmt::format("[{}, {}] is no pair of XNodes", u, v), what);
    return {};
  };
  XAUTO_TRY(pairs(app.edges, "edges", false));
  XAUTO_TRY(pairs(app.samples, "samples", true));
  for (const SourceSpec& s : app.sources)
    if (!in(s.clock, app.clocks.size()) || s.period.num < 1 || s.period.den < 1 ||
        s.period.num / s.period.den > kMaxPeriodUs || s.period.den > kMaxPeriodDen ||
        s.offset_us < 0 || s.offset_us > kMaxTimeUs || s.jitter_us < 0 || s.jitter_us > kMaxTimeUs)
      return invalid("period, offset, jitter or clock out of range", "source '" + s.name + "'");
  for (const ClockSpec& c : app.clocks)
    if (c.ppm < 0 || c.ppm > kMaxPpm)
      return invalid(fmt::format("{} ppm is not in [0, {}]", c.ppm, kMaxPpm),
                     "clock '" + c.name + "'");
  for (const XNodeSpec& x : app.xnodes)
    for (const int s : x.sources)
      if (!in(s, app.sources.size()))
        return invalid("a source that is not there", "XNode '" + x.name + "'");
  for (const ChainSpec& c : app.chains)
    if (!in(c.from, app.sources.size()) || !in(c.to, n))
      return invalid("from or to is not there", "chain '" + c.name + "'");
  for (const TransferSpec& t : app.transfers)
    if (!in(t.edge, app.edges.size()) || t.transfer_us < 0 || t.transfer_us > kMaxTimeUs)
      return invalid("edge or time out of range", "transfers");
  for (const Crossing& c : policy.crossings)
    if (!in(c.from, n) || !in(c.host, platform.hosts.size()) || c.x_us < 0 || c.x_us > kMaxTimeUs)
      return invalid("XNode, host or time out of range", "crossings");
  if (policy.app != app.name || policy.app_hash != app.hash())
    return fail(ErrorCode::kInfeasible,
                fmt::format("it is for app '{}' with hash {}, not '{}' with hash {}", policy.app,
                            policy.app_hash, app.name, app.hash()),
                "policy", "solve this app again");
  if (policy.placements.size() != n)
    return invalid(fmt::format("{} XNodes, the app has {}", policy.placements.size(), n), "policy");
  for (std::size_t i = 0; i < n; ++i) {
    const Placement& p = policy.placements[i];
    const std::string where = "XNode '" + app.xnodes[i].name + "'";
    if (!in(p.xpu, platform.xpus.size())) return invalid("no XPU", where);
    const auto found = app.xnodes[i].wcet_us.find(platform.xpus[at(p.xpu)].type);
    if (found == app.xnodes[i].wcet_us.end())
      return invalid("no implementation for the type of " + platform.xpus[at(p.xpu)].id, where);
    if (found->second < 1 || found->second > kMaxTimeUs) return invalid("WCET out of range", where);
    const std::size_t size = p.key_us.size();
    if (size == 0 || (!p.hold_us.empty() && p.hold_us.size() != size) ||
        p.start_us.size() != p.finish_us.size() ||
        (!p.finish_us.empty() && p.finish_us.size() != size))
      return invalid("keys, holds, starts and finishes are not of one number", where);
    for (std::size_t j = 0; j < size; ++j) {
      if (p.key_us[j] < 1 || p.key_us[j] > kMaxTimeUs ||
          (!p.hold_us.empty() && (p.hold_us[j] < 0 || p.hold_us[j] > kMaxTimeUs)))
        return invalid(fmt::format("key {} or its hold is out of range", j), where);
      if (!p.finish_us.empty() && (p.start_us[j] > p.finish_us[j] || p.finish_us[j] > p.key_us[j]))
        return fail(
            ErrorCode::kInfeasible,
            fmt::format("start {}, finish {} and key {} us of activation {} contradict each other",
                        p.start_us[j], p.finish_us[j], p.key_us[j], j),
            where);
    }
  }
  return {};
}

/// scale, so that all periods are whole and no time exceeds kMaxTicks. `fine`: drift, too, is
/// whole, where that fits.
Status set_scale(World& w, bool fine) {
  Ticks longest = kMillion;
  for (const SourceSpec& s : w.app.sources) {
    w.scale = lcm(w.scale, s.period.den);
    if (w.scale == 0)
      return invalid("the periods' denominators have no common multiple that fits",
                     "source '" + s.name + "'", "state periods as ratios of smaller numbers");
    longest = std::max({longest, s.offset_us, s.jitter_us, s.period.num / s.period.den + 1});
  }
  for (std::size_t i = 0; i < w.policy.placements.size(); ++i) {
    const Placement& p = w.policy.placements[i];
    const Xpu& xpu = w.platform.xpus[at(p.xpu)];
    // Where several are stated, and the policy says nothing, it is the longest.
    const XNodeSpec& x = w.app.xnodes[i];
    const std::int64_t alone = x.wcet_us.find(xpu.type)->second;
    std::int64_t most_us = alone;
    for (const BesideSpec& beside : x.beside)
      if (beside.on == xpu.type) most_us = std::max(most_us, beside.wcet_us);
    const std::int64_t wcet = p.wcet_us.value_or(most_us);
    if (wcet < alone || wcet > most_us)
      return fail(
          ErrorCode::kInfeasible,
          fmt::format("{} us are counted; the app states {} to {} us", wcet, alone, most_us),
          "XNode '" + x.name + "'");
    longest = std::max({longest, wcet + xpu.preempt_us, std::ranges::max(p.key_us)});
    if (!p.hold_us.empty()) longest = std::max(longest, std::ranges::max(p.hold_us));
    w.wcet.push_back(wcet);
  }
  for (const TransferSpec& t : w.app.transfers) longest = std::max(longest, t.transfer_us);
  for (const Crossing& c : w.policy.crossings) longest = std::max(longest, c.x_us);
  if (longest > kMaxTicks / w.scale)
    return invalid(fmt::format("{} us in steps of 1/{} us do not fit", longest, w.scale), "times",
                   "state periods as ratios of smaller numbers");
  if (fine && std::ranges::any_of(w.app.clocks, [](const ClockSpec& c) { return c.ppm > 0; })) {
    Ticks all = longest * w.scale;
    std::vector<Ticks> hyper(w.app.clocks.size(), 1);
    for (const SourceSpec& s : w.app.sources)
      if (Ticks& h = hyper[at(s.clock)]; h > 0) h = lcm(h, s.period.num * (w.scale / s.period.den));
    for (const Ticks h : hyper) all = std::max(all, h);
    for (int thousand = 0; thousand < 2 && all <= kMaxTicks / 1000; ++thousand) {
      all *= 1000;
      w.scale *= 1000;
    }
  }
  for (Ticks& c : w.wcet) c *= w.scale;
  return {};
}

Status set_graph(World& w) {
  const std::size_t n = w.app.xnodes.size();
  w.before.resize(n);
  w.after.resize(n);
  std::vector<Ticks> transfer(w.app.edges.size(), 0);
  const auto type_of = [&](int x) {
    return w.platform.xpus[at(w.policy.placements[at(x)].xpu)].type;
  };
  std::int64_t worst_ppm = 0;  // of hosts: the message passes by any of their clocks
  for (const Host& host : w.platform.hosts) worst_ppm = std::max(worst_ppm, host.rate_ppm);
  for (const TransferSpec& t : w.app.transfers) {
    const auto& [u, v] = w.app.edges[at(t.edge)];
    if (type_of(u) == t.from_type && type_of(v) == t.to_type)
      transfer[at(t.edge)] = std::max(
          transfer[at(t.edge)], ceil_div(static_cast<__int128>(t.transfer_us) * w.scale * kMillion,
                                         kMillion - worst_ppm));
  }
  for (std::size_t k = 0; k < w.app.edges.size(); ++k) {
    const auto& [u, v] = w.app.edges[k];
    w.before[at(v)].emplace_back(u, transfer[k] + w.passes(u, v));
    w.after[at(u)].push_back(v);
  }
  w.hearers = w.after;
  return {};
}

/// Into w.order, after what waits; false: in a circle.
bool sort_by_waiting(World& w) {
  const std::size_t n = w.app.xnodes.size();
  std::vector<std::size_t> waits(n, 0);
  w.order.clear();
  for (std::size_t i = 0; i < n; ++i) waits[i] = w.before[i].size();
  for (std::size_t i = 0; i < n; ++i)
    if (waits[i] == 0) w.order.push_back(static_cast<int>(i));
  for (std::size_t k = 0; k < w.order.size(); ++k)
    for (const int v : w.after[at(w.order[k])])
      if (--waits[at(v)] == 0) w.order.push_back(v);
  return w.order.size() == n;
}

/// What of activation n of v's component waits for u of activation n, as the policy's order says. Behind all that is by
/// edges: nobody hears by it.
Status add_order(World& w) {
  w.part_of = w.component_of;
  for (const auto& [u, v] : w.policy.order) {
    if (!in(u, w.app.xnodes.size()) || !in(v, w.app.xnodes.size()) || u == v)
      return invalid(fmt::format("[{}, {}] is no pair of XNodes", u, v), "order");
    const std::string pair = fmt::format("'{}' before '{}'", w.name(u), w.name(v));
    if (w.policy.placements[at(u)].xpu != w.policy.placements[at(v)].xpu)
      return invalid(pair + ": nobody keeps an order between two XPUs", "order");
    const Component &a = w.home(u), &b = w.home(v);
    if (a.clock != b.clock || a.period != b.period || a.phi != b.phi)
      return invalid(pair + ": their activations do not belong together", "order");
    if (const int joined = w.part_of[at(v)], into = w.part_of[at(u)]; joined != into)
      std::ranges::replace(w.part_of, joined, into);
    if (std::ranges::find(w.after[at(u)], v) != w.after[at(u)].end()) continue;  // it waits already
    w.before[at(v)].emplace_back(u, 0);
    w.after[at(u)].push_back(v);
  }
  if (!sort_by_waiting(w))
    return invalid("with the edges it is a circle: nothing in it starts", "order");
  return {};
}

Status set_modules(World& w) {
  const std::size_t n = w.app.xnodes.size();
  if (!sort_by_waiting(w)) return invalid("the edges have a cycle", "app '" + w.app.name + "'");
  std::map<std::string_view, int> numbers;
  w.module_of.resize(n);
  for (std::size_t i = 0; i < n; ++i) {
    const auto [found, fresh] =
        numbers.emplace(w.app.xnodes[i].module, static_cast<int>(numbers.size()));
    w.module_of[i] = found->second;
    if (fresh) w.module_xnodes.emplace_back();
    w.module_xnodes[at(w.module_of[i])].push_back(static_cast<int>(i));
  }
  w.in_flight.assign(numbers.size(), 1);
  for (const ModuleSpec& m : w.app.modules) {
    if (m.max_in_flight < 1 || m.max_in_flight > kMillion)
      return invalid(fmt::format("max_in_flight {} is out of range", m.max_in_flight),
                     "module '" + m.name + "'");
    const auto found = numbers.find(m.name);
    if (found != numbers.end()) w.in_flight[at(found->second)] = m.max_in_flight;
  }
  w.entry.assign(n, 1);
  for (const auto& [u, v] : w.app.edges)
    if (w.module_of[at(u)] == w.module_of[at(v)]) w.entry[at(v)] = 0;
  return {};
}

/// How far the grid of a clock may be off, read by any host. That of "main" is the host's own.
std::int64_t ppm_on_hosts(const World& w, int clock) {
  std::int64_t most = 0;
  for (const Host& host : w.platform.hosts) most = std::max(most, host.rate_ppm);
  const std::int64_t own = w.app.clocks[at(clock)].ppm;
  return clock == 0 || most == 0
             ? own
             : ceil_div(static_cast<__int128>(own + most) * kMillion, kMillion - most);
}

/// Components by union of edges and modules; one clock and one period in each.
Status set_components(World& w) {
  const std::size_t n = w.app.xnodes.size();
  std::vector<int> parent(n);
  std::iota(parent.begin(), parent.end(), 0);
  const auto root = [&](int x) {
    while (parent[at(x)] != x) x = parent[at(x)] = parent[at(parent[at(x)])];
    return x;
  };
  for (const auto& [u, v] : w.app.edges) parent[at(root(u))] = root(v);
  for (const auto& all : w.module_xnodes)
    for (const int x : all) parent[at(root(x))] = root(all.front());
  w.component_of.assign(n, -1);
  std::vector<int> number(n, -1);
  for (std::size_t i = 0; i < n; ++i) {
    int& c = number[at(root(static_cast<int>(i)))];
    if (c < 0) {
      c = static_cast<int>(w.components.size());
      w.components.emplace_back();
    }
    w.component_of[i] = c;
    Component& home = w.components[at(c)];
    home.xnodes.push_back(static_cast<int>(i));
    if (!w.before[i].empty()) continue;
    const XNodeSpec& x = w.app.xnodes[i];
    if (x.sources.empty())
      return invalid("has no predecessor and hears no source", "XNode '" + x.name + "'");
    for (const int s : x.sources) {
      const SourceSpec& source = w.app.sources[at(s)];
      if (home.clock >= 0 && (home.clock != source.clock ||
                              w.app.sources[at(home.sources[0])].period != source.period))
        return invalid("hears source '" + source.name + "' beside one of another period or clock",
                       "XNode '" + x.name + "'", "sample one of them instead of waiting for both");
      home.clock = source.clock;
      home.sources.push_back(s);
    }
  }
  for (Component& c : w.components) {
    const SourceSpec& first = w.app.sources[at(c.sources[0])];
    c.ppm = ppm_on_hosts(w, c.clock);
    c.period = first.period.num * (w.scale / first.period.den);
    c.phi = first.offset_us * w.scale;
    for (const int s : c.sources) {
      const SourceSpec& source = w.app.sources[at(s)];
      if (!source.urgent || c.urgent_source == s) continue;
      const std::string where = "source '" + source.name + "'";
      if (c.urgent_source >= 0)
        return invalid("may be urgent beside '" + w.app.sources[at(c.urgent_source)].name + "'",
                       where, "state it of one of those that edges join");
      c.urgent_source = s;
      if (source.urgent->by_us < 1 || source.urgent->by_us > kMaxTimeUs ||
          source.urgent->every_us < 1 || source.urgent->every_us > kMaxTimeUs)
        return invalid("urgent by or every out of range", where);
      c.urgent_by = source.urgent->by_us * w.scale;
      c.urgent_apart = ceil_div(static_cast<__int128>(source.urgent->every_us) * w.scale, c.period);
      if (static_cast<__int128>(c.urgent_apart) * c.period > kMaxTicks)
        return invalid("urgent every does not fit", where, "state less");
    }
    for (const int s : c.sources) c.phi = std::min(c.phi, w.app.sources[at(s)].offset_us * w.scale);
  }
  w.hears_urgent.assign(n, 0);
  for (const int i : w.order) {
    const auto& heard = w.app.xnodes[at(i)].sources;
    const int source = w.home(i).urgent_source;
    const std::string marks = source < 0 ? "" : w.app.sources[at(source)].urgent->marked_by;
    const bool own = marks.empty() && std::ranges::find(heard, source) != heard.end();
    const std::string& here = w.app.xnodes[at(i)].module;
    const bool through = std::ranges::any_of(w.before[at(i)], [&](const auto& before) {
      const std::string& there = w.app.xnodes[at(before.first)].module;
      return w.hears_urgent[at(before.first)] != 0 ||
             (!marks.empty() && there == marks && here != marks);
    });
    w.hears_urgent[at(i)] = own || through;
  }
  return {};
}

/// Whether that many activations of `c` divide all that there are until the rates of its clock come round, which may
/// be too long for a number: gcd(x, lcm(T...)) = lcm(gcd(x, T)...).
bool come_round(const World& w, const Component& c, std::int64_t activations) {
  if (activations > kMaxTicks / c.period) return false;
  const Ticks span = activations * c.period;
  Ticks common = 1;
  for (const Component& other : w.components)
    if (other.clock == c.clock) common = lcm(common, std::gcd(span, other.period));
  return common == span;
}

/// How many windows each component has, and whether the arrays' sizes are those of the format.
Status set_classes(World& w) {
  std::int64_t windows = 0;
  for (std::size_t i = 0; i < w.app.xnodes.size(); ++i) {
    Component& c = w.components[at(w.component_of[i])];
    const auto size = static_cast<std::int64_t>(w.policy.placements[i].key_us.size());
    if (size > 1 && !come_round(w, c, size)) {
      Ticks turn = c.period;
      for (const Component& other : w.components)
        if (other.clock == c.clock && turn > 0) turn = lcm(turn, other.period);
      return invalid(
          fmt::format("{} keys do not divide the {} of a hyperperiod", size,
                      turn == 0 ? "activations" : fmt::format("{} activations", turn / c.period)),
          "XNode '" + w.app.xnodes[i].name + "'");
    }
    c.classes = lcm(c.classes, size);
  }
  // Of one part the windows come round together.
  std::vector<std::int64_t> of_part(w.components.size(), 1);
  for (std::size_t i = 0; i < w.part_of.size(); ++i) {
    std::int64_t& classes = of_part[at(w.part_of[i])];
    classes = lcm(classes, w.home(static_cast<int>(i)).classes);
  }
  for (std::size_t i = 0; i < w.part_of.size(); ++i)
    w.components[at(w.component_of[i])].classes = of_part[at(w.part_of[i])];
  for (const Component& c : w.components) {
    windows += c.classes * static_cast<std::int64_t>(c.xnodes.size());
    if (c.classes < 1 || c.classes > kMaxWindows || windows > kMaxWindows)
      return invalid(fmt::format("more than {} windows", kMaxWindows), "policy",
                     "use fewer keys per XNode");
  }
  return {};
}

/// a, d and e of every job, from the keys of others alone.
Status set_windows(World& w) {
  const std::size_t n = w.app.xnodes.size();
  w.windows.resize(n);
  for (std::size_t i = 0; i < n; ++i) {
    const Placement& p = w.policy.placements[i];
    auto& all = w.windows[i];
    all.resize(static_cast<std::size_t>(w.home(static_cast<int>(i)).classes));
    for (std::size_t j = 0; j < all.size(); ++j) all[j].d = p.key_us[j % p.key_us.size()] * w.scale;
  }
  for (const int i : w.order) {
    const Component& c = w.home(i);
    const Placement& p = w.policy.placements[at(i)];
    auto& all = w.windows[at(i)];
    Ticks ready = 0, early = 0;
    for (const int s : w.app.xnodes[at(i)].sources) {
      const SourceSpec& source = w.app.sources[at(s)];
      const Ticks offset = source.offset_us * w.scale - c.phi;
      ready = std::max(ready, most(offset, c.ppm) + source.jitter_us * w.scale);
      early = std::max(early, least(offset, c.ppm));
    }
    for (std::size_t j = 0; j < all.size(); ++j) {
      Window& window = all[j];
      window.a = ready;
      window.e = early;
      for (const auto& [u, transfer] : w.before[at(i)]) {
        window.a = std::max(window.a, w.windows[at(u)][j].d + transfer);
        if (w.host[at(u)] == w.host[at(i)])  // on another host it may start earlier, by this clock
          window.e = std::max(window.e, w.windows[at(u)][j].e + transfer);
      }
      if (!p.hold_us.empty()) {
        const Ticks hold = p.hold_us[j % p.hold_us.size()] * w.scale;
        window.a = std::max(window.a, hold);
        window.e = std::max(window.e, hold);
      }
      if (w.entry[at(i)]) {
        // Activation j - N has left: all its XNodes have ended, by their keys. A fast clock brings
        // that closer.
        const int m = w.module_of[at(i)];
        const std::int64_t lag = w.in_flight[at(m)];
        const __int128 span = static_cast<__int128>(lag) * c.period;
        if (span <= 2 * kMaxTicks)  // otherwise it is past
          for (const int x : w.module_xnodes[at(m)])
            window.a = std::max(window.a, w.window(x, static_cast<std::int64_t>(j) - lag).d -
                                              least(static_cast<Ticks>(span), c.ppm));
      }
    }
    // An XNode takes activations in order: ready by a is also after the one before is ready.
    for (std::size_t round = 0; round < 2; ++round)
      for (std::size_t j = 0; j < all.size(); ++j) {
        const Window& previous = all[j == 0 ? all.size() - 1 : j - 1];
        all[j].a = std::max(all[j].a, previous.a - least(c.period, c.ppm));
        if (previous.d - least(c.period, c.ppm) > all[j].d)
          return fail(
              ErrorCode::kInfeasible,
              fmt::format("its key, at {} us, may fall before that of the activation before",
                          w.us(all[j].d)),
              place(w, i, static_cast<std::int64_t>(j)),
              "release + key must not fall from one activation to the next");
      }
    for (std::size_t j = 0; j < all.size(); ++j)
      if (all[j].d / c.period >= kMaxInFlight)
        return invalid(
            fmt::format("its key is more than {} periods after its release", kMaxInFlight),
            place(w, i, static_cast<std::int64_t>(j)));
    for (std::size_t j = 0; j < all.size(); ++j)
      if (all[j].a + w.wcet[at(i)] > all[j].d)
        return fail(
            ErrorCode::kInfeasible,
            fmt::format("it is ready by {} us, takes {} us, and its key is {} us", w.us(all[j].a),
                        w.us(w.wcet[at(i)]), w.us(all[j].d)),
            place(w, i, static_cast<std::int64_t>(j)) + ", XPU " + w.platform.xpus[at(p.xpu)].id);
  }
  return {};
}

/// Windows of urgent releases: keys and holds of whatever hears of the source are earlier. What comes
/// from elsewhere comes when it does: messages, other predecessors, the module's and the XNode's
/// activations before, which need not be urgent.
Status set_urgent(World& w) {
  w.urgent.resize(w.app.xnodes.size());
  for (const int i : w.order) {
    const Component& c = w.home(i);
    if (!w.hears_urgent[at(i)]) continue;
    const auto& ordinary = w.windows[at(i)];
    auto& all = w.urgent[at(i)];
    all.resize(ordinary.size());
    const Placement& p = w.policy.placements[at(i)];
    for (std::size_t j = 0; j < all.size(); ++j) {
      Window& window = all[j];
      window.d = ordinary[j].d - c.urgent_by;
      if (!p.hold_us.empty())
        window.a = window.e =
            std::max<Ticks>(0, p.hold_us[j % p.hold_us.size()] * w.scale - c.urgent_by);
      for (const int s : w.app.xnodes[at(i)].sources) {
        const SourceSpec& source = w.app.sources[at(s)];
        const Ticks offset = source.offset_us * w.scale - c.phi;
        window.a = std::max(window.a, most(offset, c.ppm) + source.jitter_us * w.scale);
        window.e = std::max(window.e, least(offset, c.ppm));
      }
      for (const auto& [u, transfer] : w.before[at(i)]) {
        const Window& before = w.urgent[at(u)].empty() ? w.windows[at(u)][j] : w.urgent[at(u)][j];
        window.a = std::max(window.a, before.d + transfer);
        if (w.host[at(u)] == w.host[at(i)]) window.e = std::max(window.e, before.e + transfer);
      }
      const auto n = static_cast<std::int64_t>(j);
      const int m = w.module_of[at(i)];
      const __int128 span = static_cast<__int128>(w.in_flight[at(m)]) * c.period;
      if (w.entry[at(i)] && span <= 2 * kMaxTicks)
        for (const int x : w.module_xnodes[at(m)])
          window.a = std::max(window.a, w.window(x, n - w.in_flight[at(m)]).d -
                                            least(static_cast<Ticks>(span), c.ppm));
      const Window& previous = w.window(i, n - 1);
      window.a = std::max(window.a, previous.a - least(c.period, c.ppm));
      const std::string where = place(w, i, n) + ", urgent";
      if (previous.d - least(c.period, c.ppm) > window.d)
        return fail(ErrorCode::kInfeasible,
                    fmt::format("its key, at {} us, may fall before that of the activation before",
                                w.us(window.d)),
                    where, "urgent releases must not overtake: make urgent.by_us smaller");
      if (window.a + w.wcet[at(i)] > window.d)
        return fail(ErrorCode::kInfeasible,
                    fmt::format("it is ready by {} us, takes {} us, and its key is {} us",
                                w.us(window.a), w.us(w.wcet[at(i)]), w.us(window.d)),
                    where, "make urgent.by_us smaller, or the keys later");
    }
  }
  return {};
}

}  // namespace world

std::vector<std::int64_t> World::lags(int xnode, bool forward) const {
  std::vector<std::int64_t> best(app.xnodes.size(), kNever);
  using Entry = std::pair<std::int64_t, int>;
  std::priority_queue<Entry, std::vector<Entry>, std::greater<>> queue;
  queue.emplace(0, xnode);
  const auto reach = [&](int x, std::int64_t lag) {
    if (lag >= best[at(x)]) return;
    best[at(x)] = lag;
    queue.emplace(lag, x);
  };
  std::vector<char> full(module_xnodes.size(), 0);  // its first reach was the least
  while (!queue.empty()) {
    const auto [lag, x] = queue.top();
    queue.pop();
    if (lag > best[at(x)]) continue;
    if (forward)
      for (const int v : after[at(x)]) reach(v, lag);
    else
      for (const auto& [u, transfer] : before[at(x)]) reach(u, lag);
    // What enters a module waits for all of the activation that has to leave before.
    const int m = module_of[at(x)];
    if ((!forward && !entry[at(x)]) || full[at(m)]) continue;
    full[at(m)] = 1;
    for (const int v : module_xnodes[at(m)])
      if (!forward || entry[at(v)]) reach(v, lag + in_flight[at(m)]);
  }
  best[at(xnode)] = std::min<std::int64_t>(best[at(xnode)], 1);
  return best;
}

Result<World> structure(const AppSpec& app, const Platform& platform, const Policy& policy,
                        bool fine, Ticks multiple_of) {
  XAUTO_TRY(validate(app));
  XAUTO_TRY(validate(platform));
  XAUTO_TRY(world::check_indices(app, platform, policy));
  XAUTO_TRY(validate_on(app, platform));
  World w{app, platform, policy};
  w.scale = multiple_of;
  XAUTO_TRY(world::set_scale(w, fine));
  XAUTO_TRY(set_hosts(w));
  XAUTO_TRY(world::set_graph(w));
  XAUTO_TRY(world::set_modules(w));
  XAUTO_TRY(world::set_components(w));
  XAUTO_TRY(world::add_order(w));
  XAUTO_TRY(world::set_classes(w));
  return w;
}

Result<World> derive(const AppSpec& app, const Platform& platform, const Policy& policy, bool fine,
                     Ticks multiple_of, bool others) {
  XAUTO_ASSIGN(World w, structure(app, platform, policy, fine, multiple_of));
  XAUTO_TRY(world::set_windows(w));
  XAUTO_TRY(world::set_urgent(w));
  XAUTO_TRY(prove_counted(w, others));
  return w;
}

}  // namespace xauto::solver::keys::checking
