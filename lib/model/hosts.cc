// SPDX-License-Identifier: Apache-2.0
#include "model/hosts.h"

#include <map>
#include <set>
#include <string>
#include <utility>

#include "base/index.h"
#include "model/refusal.h"

namespace xauto {
namespace {

constexpr std::int64_t kBitsPerByte = 8;

Status one_host_per_module(const AppSpec& app, const Platform& platform,
                           const std::vector<int>& host_of) {
  std::map<std::string_view, std::size_t> first;
  for (std::size_t i = 0; i < app.xnodes.size(); ++i) {
    const auto [at_first, fresh] = first.try_emplace(app.xnodes[i].module, i);
    if (fresh || host_of[i] == host_of[at_first->second]) continue;
    return fail(ErrorCode::kInfeasible,
                "module " + quoted(app.xnodes[i].module) +
                    " is on two hosts: " + quoted(app.xnodes[at_first->second].name) + " on " +
                    quoted(platform.hosts[at(host_of[at_first->second])].name) + ", " +
                    quoted(app.xnodes[i].name) + " on " +
                    quoted(platform.hosts[at(host_of[i])].name),
                nth("xnodes", i) + "/xpu", "the XNodes of a module share its state: solve again");
  }
  for (const ModuleSpec& module : app.modules) {
    const auto there = first.find(module.name);
    if (module.host.empty() || there == first.end()) continue;
    if (const int host = host_of[there->second]; platform.hosts[at(host)].name != module.host)
      return fail(ErrorCode::kInfeasible,
                  "module " + quoted(module.name) + " is on host " +
                      quoted(platform.hosts[at(host)].name) + ", and the app has it on " +
                      quoted(module.host),
                  nth("xnodes", there->second) + "/xpu", "solve again");
  }
  return {};
}

}  // namespace

std::int64_t on_link_us(std::int64_t bytes, const HostLink& link) {
  return link.mbit_s == 0 ? 0 : (bytes * kBitsPerByte + link.mbit_s - 1) / link.mbit_s;
}

Status validate_pins(const AppSpec& app, const Platform& platform) {
  for (std::size_t m = 0; m < app.modules.size(); ++m)
    if (const std::string& host = app.modules[m].host;
        !host.empty() && platform.find_host(host) < 0)
      return fail(ErrorCode::kInvalid,
                  "module " + quoted(app.modules[m].name) + " shall be on host " + quoted(host) +
                      ", and platform " + quoted(platform.name) +
                      (platform.hosts.empty() ? " has no hosts" : " has no such host"),
                  nth("modules", m) + "/host", "give a platform.json with that host");
  return {};
}

std::vector<int> hosts_of(const AppSpec& app, const Platform& platform, const Policy& policy) {
  std::vector<int> host(app.xnodes.size(), 0);
  for (std::size_t i = 0; i < host.size(); ++i)
    host[i] = platform.xpus[at(policy.placements[i].xpu)].host;
  return host;
}

Result<std::vector<Crossing>> crossings_of(const AppSpec& app, const Platform& platform,
                                           const std::vector<int>& host_of) {
  std::vector<Crossing> crossings;
  XAUTO_TRY(validate_pins(app, platform));
  if (platform.hosts.empty()) return crossings;
  XAUTO_TRY(one_host_per_module(app, platform, host_of));
  std::set<std::pair<int, int>> crosses;  // XNode, host
  for (const auto* pairs : {&app.edges, &app.samples})
    for (const auto& [u, v] : *pairs)
      if (host_of[at(u)] != host_of[at(v)]) crosses.insert({u, host_of[at(v)]});
  std::map<const HostLink*, std::int64_t> takes;
  for (const auto& [u, host] : crosses) {
    const HostLink* const link = platform.link(host_of[at(u)], host);
    if (link == nullptr)
      return fail(ErrorCode::kInfeasible,
                  "what " + quoted(app.xnodes[at(u)].name) + " publishes has to get from host " +
                      quoted(platform.hosts[at(host_of[at(u)])].name) + " to " +
                      quoted(platform.hosts[at(host)].name) + ", and no link leads there",
                  "platform " + quoted(platform.name), "state it in \"links\"");
    takes.try_emplace(link, link->base_us).first->second +=
        on_link_us(app.xnodes[at(u)].message_bytes, *link);
  }
  const std::vector<std::int64_t> periods = app.periods();
  for (const auto& [u, host] : crosses) {
    const std::int64_t x_us = takes.at(platform.link(host_of[at(u)], host));
    if (x_us > kMaxTimeUs || (periods[at(u)] > 0 && x_us > periods[at(u)]))
      return fail(ErrorCode::kInfeasible,
                  "messages from host " + quoted(platform.hosts[at(host_of[at(u)])].name) + " to " +
                      quoted(platform.hosts[at(host)].name) + " may take " + std::to_string(x_us) +
                      " us, and " + quoted(app.xnodes[at(u)].name) + " sends one every " +
                      std::to_string(periods[at(u)]) + " us",
                  "platform " + quoted(platform.name),
                  "pin modules so that less crosses, or send less");
    crossings.push_back({u, host, x_us});
  }
  return crossings;
}

Result<std::vector<Crossing>> crossings_of(const AppSpec& app, const Platform& platform,
                                           const Policy& policy) {
  return crossings_of(app, platform, hosts_of(app, platform, policy));
}

}  // namespace xauto
