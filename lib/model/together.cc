// SPDX-License-Identifier: Apache-2.0
#include "model/together.h"

#include <set>
#include <utility>

#include "base/index.h"
#include "model/contention.h"
#include "model/demand.h"
#include "model/refusal.h"

namespace xauto {
namespace {

/// Adds `app` behind what `all` has.
class Adding {
 public:
  Adding(const AppSpec& app, AppSpec& all)
      : app_(app),
        all_(all),
        xnodes_(static_cast<int>(all.xnodes.size())),
        sources_(static_cast<int>(all.sources.size())),
        clocks_(static_cast<int>(all.clocks.size())),
        edges_(static_cast<int>(all.edges.size())) {}

  void add() {
    for (ClockSpec clock : app_.clocks) {
      clock.name = renamed(clock.name);
      all_.clocks.push_back(std::move(clock));
    }
    for (SourceSpec source : app_.sources) {
      source.name = renamed(source.name);
      source.clock += clocks_;
      all_.sources.push_back(std::move(source));
    }
    for (ModuleSpec module : app_.modules) {
      module.name = renamed(module.name);
      all_.modules.push_back(std::move(module));
    }
    for (XNodeSpec xnode : app_.xnodes) {
      xnode.name = renamed(xnode.name);
      xnode.module = renamed(xnode.module);
      for (int& source : xnode.sources) source += sources_;
      all_.xnodes.push_back(std::move(xnode));
    }
    add_pairs(app_.edges, all_.edges);
    add_pairs(app_.samples, all_.samples);
    for (TransferSpec transfer : app_.transfers) {
      transfer.edge += edges_;
      all_.transfers.push_back(std::move(transfer));
    }
    for (ChainSpec chain : app_.chains) {
      chain.name = renamed(chain.name);
      chain.from += sources_;
      chain.to += xnodes_;
      if (!chain.deadline_us) chain.deadline_us = app_.deadline_us;
      all_.chains.push_back(std::move(chain));
    }
  }

 private:
  [[nodiscard]] std::string renamed(const std::string& name) const {
    return name_together(app_.name, name);
  }
  void add_pairs(const std::vector<std::pair<int, int>>& from,
                 std::vector<std::pair<int, int>>& to) const {
    for (const auto& [u, v] : from) to.emplace_back(u + xnodes_, v + xnodes_);
  }

  const AppSpec& app_;
  AppSpec& all_;
  int xnodes_, sources_, clocks_, edges_;
};

}  // namespace

std::string name_together(const std::string& app, const std::string& name) {
  return app + "/" + name;
}

Result<AppSpec> merge_apps(const std::vector<AppSpec>& apps) {
  if (apps.size() == 1) return apps.front();
  if (apps.empty() || apps.size() > kMaxTogether)
    return fail(ErrorCode::kInvalid,
                std::to_string(apps.size()) + " apps; 1 to " + std::to_string(kMaxTogether) +
                    " are possible",
                "apps");
  AppSpec all;
  std::set<std::string_view> names;
  for (const AppSpec& app : apps) {
    if (!names.insert(app.name).second)
      return fail(ErrorCode::kInvalid, "two apps are called " + quoted(app.name), "apps",
                  "give one of them another name");
    XAUTO_TRY(has_demand(app));
    all.name += (all.name.empty() ? "" : " + ") + app.name;
    Adding(at_longest(app), all).add();
  }
  XAUTO_TRY(validate(all));
  return all;
}

std::vector<int> apps_of_xnodes(const std::vector<AppSpec>& apps) {
  std::vector<int> of;
  for (std::size_t a = 0; a < apps.size(); ++a)
    of.insert(of.end(), apps[a].xnodes.size(), static_cast<int>(a));
  return of;
}

Result<Policy> merge_policies(const std::vector<AppSpec>& apps, const AppSpec& merged,
                              const std::vector<Policy>& policies) {
  if (policies.size() != apps.size())
    return fail(
        ErrorCode::kInvalid,
        std::to_string(policies.size()) + " policies for " + std::to_string(apps.size()) + " apps",
        "policies", "give one for each app, in the order of the apps");
  if (policies.size() == 1) return policies.front();
  Policy all;
  all.app = merged.name;
  all.app_hash = merged.hash();
  all.platform = policies.front().platform;
  all.method = policies.front().method;
  int first = 0;
  for (std::size_t a = 0; a < apps.size(); ++a) {
    const Policy& policy = policies[a];
    if (!policy.certified || policy.by_priority())
      return fail(ErrorCode::kInvalid, "is not certified: nothing is claimed beside it",
                  "the policy of app " + quoted(apps[a].name), "solve again");
    for (Placement placed : policy.placements) {
      placed.wcet_us.reset();  // beside others the longest counts
      all.placements.push_back(std::move(placed));
    }
    for (ChainClaim claim : policy.chains) {
      claim.name = name_together(apps[a].name, claim.name);
      all.chains.push_back(std::move(claim));
    }
    for (const auto& [u, v] : policy.order) all.order.emplace_back(u + first, v + first);
    all.solve_us += policy.solve_us;
    first += static_cast<int>(apps[a].xnodes.size());
  }
  return all;
}

std::vector<Policy> split_policy(const std::vector<AppSpec>& apps, const Platform& platform,
                                 const Policy& policy) {
  if (apps.size() == 1) return {policy};
  std::vector<Policy> parts;
  std::size_t xnode = 0, chain = 0;
  for (const AppSpec& app : apps) {
    Policy& part = parts.emplace_back();
    part.app = app.name;
    part.app_hash = app.hash();
    part.platform = policy.platform;
    part.method = policy.method;
    part.certified = policy.certified;
    part.solve_us = policy.solve_us;
    const auto first = static_cast<int>(xnode), last = first + static_cast<int>(app.xnodes.size());
    for (; at(last) > xnode; ++xnode) {
      Placement& placed = part.placements.emplace_back(policy.placements[xnode]);
      const XNodeSpec& spec = app.xnodes[xnode - at(first)];
      const std::string& on = platform.xpus[at(placed.xpu)].type;
      if (policy.certified && !policy.by_priority() && !stated_loads(spec, on).empty())
        placed.wcet_us = longest_wcet(spec, on);
    }
    for (std::size_t c = 0; c < app.chains.size() && !policy.chains.empty(); ++c, ++chain) {
      part.chains.push_back(policy.chains[chain]);
      part.chains.back().name = app.chains[c].name;
    }
    for (const auto& [u, v] : policy.order)
      if (u >= first && u < last) part.order.emplace_back(u - first, v - first);
  }
  return parts;
}

}  // namespace xauto
