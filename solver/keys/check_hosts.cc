// SPDX-License-Identifier: Apache-2.0
// Theorem 18's X, written a second time (the first: lib/model/hosts.cc). A message u -> host h of a link g -> h may find
// all others of that link in front of it, each once. So from when it is sent it takes at most
//   base + sum of ceil(8 bytes / rate) over the messages of the link, itself included
// if none of them comes again meanwhile: no period is shorter than that.
#include <set>

#include <fmt/format.h>

#include "solver/keys/check_world.h"

namespace xauto::solver::keys::checking {
namespace {

tl::unexpected<Error> lie(std::string what, std::string where) {
  return fail(ErrorCode::kInfeasible, std::move(what), std::move(where), "solve again");
}

/// Each module is on one host, and on the one that it is pinned to.
Status check_modules(const World& w) {
  std::map<std::string_view, int> host_of_module;
  for (std::size_t i = 0; i < w.host.size(); ++i) {
    const std::string& module = w.app.xnodes[i].module;
    const auto [there, fresh] = host_of_module.emplace(module, w.host[i]);
    if (there->second != w.host[i])
      return lie("its XNodes are on two hosts, and share a state", "module '" + module + "'");
  }
  for (const ModuleSpec& m : w.app.modules) {
    if (m.host.empty()) continue;
    const auto there = host_of_module.find(m.name);
    if (there == host_of_module.end()) continue;
    if (w.platform.hosts.empty() || w.platform.hosts[at(there->second)].name != m.host)
      return lie(fmt::format("is not on host '{}', as the app has it", m.host),
                 "module '" + m.name + "'");
  }
  return {};
}

struct LinkUse {
  std::int64_t takes_us = 0;
  std::vector<std::pair<int, int>> messages;  ///< XNode, host
};

/// Of each pair of hosts what crosses, and for how long it may.
Result<std::map<std::pair<int, int>, LinkUse>> ways_of(const World& w) {
  std::set<std::pair<int, int>> messages;
  const auto add = [&](const std::vector<std::pair<int, int>>& pairs) {
    for (const auto& [u, v] : pairs)
      if (w.host[at(u)] != w.host[at(v)]) messages.emplace(u, w.host[at(v)]);
  };
  add(w.app.edges);
  add(w.app.samples);
  std::map<std::pair<int, int>, LinkUse> ways;
  for (const auto& [u, to] : messages) {
    const int from = w.host[at(u)];
    const HostLink* on = nullptr;
    for (const HostLink& l : w.platform.links)
      if (l.from == from && l.to == to) on = &l;
    if (on == nullptr)
      return lie(fmt::format("no link from '{}' to '{}', where what it publishes is heard",
                             w.platform.hosts[at(from)].name, w.platform.hosts[at(to)].name),
                 "XNode '" + w.name(u) + "'");
    LinkUse& way = ways[{from, to}];
    if (way.messages.empty()) way.takes_us = on->base_us;
    const __int128 bits = static_cast<__int128>(w.app.xnodes[at(u)].message_bytes) * 8;
    if (on->mbit_s > 0) way.takes_us += ceil_div(bits, on->mbit_s);
    way.messages.emplace_back(u, to);
  }
  return ways;
}

/// The shortest period among the sources that it hears of, by whatever way.
std::int64_t least_period_us(const World& w, int xnode) {
  std::vector<char> seen(w.host.size(), 0);
  std::vector<int> open{xnode};
  std::int64_t least = kMaxTimeUs;
  while (!open.empty()) {
    const int x = open.back();
    open.pop_back();
    if (seen[at(x)] != 0) continue;
    seen[at(x)] = 1;
    for (const int s : w.app.xnodes[at(x)].sources) {
      const Period& p = w.app.sources[at(s)].period;
      least = std::min(least, p.num / p.den);
    }
    for (const auto& [u, v] : w.app.edges)
      if (v == x) open.push_back(u);
  }
  return least;
}

/// Of what crosses all is claimed, each for long enough, and nothing else.
Status check_crossings(const World& w) {
  XAUTO_ASSIGN(const auto ways, ways_of(w));
  std::size_t needed = 0;
  for (const auto& [ends, way] : ways)
    for (const auto& [u, to] : way.messages) {
      ++needed;
      const std::string where =
          fmt::format("crossing from '{}' to host '{}'", w.name(u), w.platform.hosts[at(to)].name);
      const auto claimed = w.crossing.find({u, to});
      if (claimed == w.crossing.end()) return lie("is not there", where);
      if (claimed->second < way.takes_us * w.scale)
        return lie(
            fmt::format("x_us is {}, the link takes {}", claimed->second / w.scale, way.takes_us),
            where);
      if (const std::int64_t period = least_period_us(w, u); way.takes_us > period)
        return lie(fmt::format("takes up to {} us, and comes every {} us: it meets itself",
                               way.takes_us, period),
                   where);
    }
  return needed == w.crossing.size()
             ? Status()
             : lie("more than there are messages between hosts", "crossings");
}

}  // namespace

Platform by_its_clocks(const Platform& platform) {
  Platform timed = platform;
  if (platform.hosts.empty()) return timed;
  for (Xpu& xpu : timed.xpus)
    xpu.preempt_us = ceil_div(static_cast<__int128>(xpu.preempt_us) * kMillion,
                              kMillion - platform.hosts[at(xpu.host)].rate_ppm);
  return timed;
}

Status set_hosts(World& w) {
  const std::size_t n = w.app.xnodes.size();
  w.host.assign(n, 0);
  for (std::size_t i = 0; i < n; ++i)
    w.host[i] = w.platform.xpus[at(w.policy.placements[i].xpu)].host;
  XAUTO_TRY(check_modules(w));
  for (const Crossing& c : w.policy.crossings)
    if (!w.crossing.emplace(std::pair(c.from, c.host), c.x_us * w.scale).second)
      return lie("is there twice", fmt::format("crossing from '{}'", w.name(c.from)));
  if (!w.platform.hosts.empty())
    for (std::size_t i = 0; i < n; ++i) {
      const std::int64_t ppm = w.platform.hosts[at(w.host[i])].rate_ppm;
      w.wcet[i] = ceil_div(static_cast<__int128>(w.wcet[i]) * kMillion, kMillion - ppm);
    }
  return check_crossings(w);
}

}  // namespace xauto::solver::keys::checking
