// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/check.h"

#include <map>

#include <fmt/format.h>

#include "model/contention.h"
#include "solver/keys/check_chains.h"
#include "solver/keys/check_load.h"
#include "solver/keys/check_world.h"

namespace xauto::solver::keys {
namespace checking {

void compare(const ChainClaim& claim, ChainProof& proof, CheckReport& report) {
  const std::string where = "chain '" + proof.name + "'";
  const auto lies = [&](std::string what) {
    report.lies.push_back({ErrorCode::kInfeasible, std::move(what), where, "solve again"});
  };
  proof.claimed_us = claim.worst_case_us;
  proof.claimed_bound_us = claim.lower_bound_us;
  if (proof.derived_us > claim.worst_case_us)
    lies(fmt::format("worst_case_us is {}, what follows is {}, along {}", claim.worst_case_us,
                     proof.derived_us, fmt::join(proof.path, " > ")));
  if (proof.urgent_us.has_value() != claim.urgent_worst_case_us.has_value())
    lies(proof.urgent_us ? "no urgent_worst_case_us, and its source may be urgent"
                         : "urgent_worst_case_us, and its source is never urgent");
  else if (proof.urgent_us && *proof.urgent_us > *claim.urgent_worst_case_us)
    lies(fmt::format("urgent_worst_case_us is {}, what follows is {}", *claim.urgent_worst_case_us,
                     *proof.urgent_us));
  if (claim.lower_bound_us > proof.derived_us)
    lies(fmt::format("lower_bound_us is {}, but this policy is never longer than {}",
                     claim.lower_bound_us, proof.derived_us));
  else if (claim.lower_bound_us > proof.own_bound_us)
    report.taken.push_back(fmt::format("{}: that none is shorter than {} us; shown is {} us", where,
                                       claim.lower_bound_us, proof.own_bound_us));
  if (claim.optimal && claim.lower_bound_us != claim.worst_case_us)
    lies(fmt::format("optimal, with a lower bound of {} and a worst case of {}",
                     claim.lower_bound_us, claim.worst_case_us));
}

/// What the ticks of a microsecond have to be a multiple of.
Result<Ticks> ticks_beside(const AppSpec& app, const Platform& platform, const Beside& beside) {
  Ticks ticks = 1;
  if (beside.nobody()) return ticks;
  XAUTO_TRY(has_demand(app));
  if (beside.reserve_pct < 0 || beside.reserve_pct > kMaxReservePct)
    return fail(ErrorCode::kInvalid,
                fmt::format("{} % is not from 0 to {} %", beside.reserve_pct, kMaxReservePct),
                "reserve");
  for (const Demand& demand : beside.demands) {
    XAUTO_TRY(validate(demand));
    XAUTO_TRY(validate_on(demand, platform));
    ticks = lcm(ticks, demand.ticks_per_us);
    if (ticks == 0)
      return fail(ErrorCode::kInvalid, "the ticks of the demands have no multiple that fits",
                  "demands", "state periods as ratios of smaller numbers");
  }
  return ticks;
}

/// Keeps a lie; what else is wrong is returned.
Status keep_lie(const Error& error, CheckReport& report) {
  if (error.code != ErrorCode::kInfeasible) return tl::unexpected<Error>(error);
  report.lies.push_back(error);
  return {};
}

}  // namespace checking

Status check_places(const AppSpec& app, const Platform& platform, const Policy& policy) {
  if (policy.by_priority()) return validate(policy, app, platform);
  XAUTO_ASSIGN([[maybe_unused]] const checking::World w,
               checking::structure(app, platform, policy, false));
  return {};
}

Result<CheckReport> examine(const AppSpec& app, const Platform& platform, const Policy& policy,
                            const Beside& beside) {
  if (!policy.certified)
    return fail(ErrorCode::kInvalid, "is not certified: it claims nothing that could be derived",
                "policy", "`xauto solve` says what would make it certified");
  CheckReport report;
  XAUTO_ASSIGN(const checking::Ticks ticks, checking::ticks_beside(app, platform, beside));
  const Platform timed = checking::by_its_clocks(platform);
  // Nobody counts who meets whom on several hosts.
  const Result<checking::World> derived = checking::derive(
      app, timed, policy, true, ticks, !beside.nobody() || !platform.hosts.empty());
  if (!derived) {
    XAUTO_TRY(checking::keep_lie(derived.error(), report));
    return report;
  }
  const checking::World& w = *derived;
  if (policy.chains.size() != app.chains.size())
    return fail(ErrorCode::kInvalid,
                fmt::format("{} chains, the app has {}", policy.chains.size(), app.chains.size()),
                "policy");
  for (const auto& windows : w.windows) {
    std::vector<JobWindow>& list = report.windows.emplace_back();
    for (const checking::Window& window : windows) list.push_back({w.us(window.a), w.us(window.d)});
  }
  std::map<std::pair<int, int>, checking::Ticks> ways;  // from host to host
  for (const auto& [message, x] : w.crossing) ways[{w.host[at(message.first)], message.second}] = x;
  for (const auto& [ends, x] : ways)
    report.taken.push_back(fmt::format(
        "that what leaves host '{}' by a reading of its clock is on host '{}' {} us later, by that "
        "one's clock",
        platform.hosts[at(ends.first)].name, platform.hosts[at(ends.second)].name, w.us_up(x)));
  std::int64_t longest_us = 0;
  for (const Placement& placed : policy.placements)
    longest_us = std::max(longest_us, *std::ranges::max_element(placed.key_us));
  for (std::size_t m = 0; m < platform.xpus.size(); ++m) {
    Result<XpuProof> load = checking::prove_load(w, static_cast<int>(m), beside);
    if (!load) {
      XAUTO_TRY(checking::keep_lie(load.error(), report));
      report.xpus.emplace_back().xpu = platform.xpus[m].id;
      continue;
    }
    XpuProof& proof = *load;
    if (app.one_at_a_time && longest_us > 0) {  // no release takes longer
      proof.load *= static_cast<double>(proof.repeats_us) / static_cast<double>(longest_us);
      proof.repeats_us = static_cast<double>(longest_us);
    }
    if (std::string cost = unmeasured(platform.xpus[m]); proof.charged > 0 && !cost.empty())
      report.taken.push_back(std::move(cost));
    report.xpus.push_back(std::move(proof));
  }
  for (std::size_t k = 0; k < app.chains.size(); ++k) {
    if (policy.chains[k].name != app.chains[k].name)
      return fail(
          ErrorCode::kInvalid,
          fmt::format("chain {} is '{}', not '{}'", k, policy.chains[k].name, app.chains[k].name),
          "policy");
    Result<ChainProof> chain = checking::derive_chain(w, k, false);
    if (!chain) {
      XAUTO_TRY(checking::keep_lie(chain.error(), report));
      break;
    }
    ChainProof& proof = *chain;
    proof.claimed_urgent_us = policy.chains[k].urgent_worst_case_us;
    if (app.sources[at(app.chains[k].from)].urgent) {
      XAUTO_ASSIGN(const ChainProof urgent, checking::derive_chain(w, k, true));
      proof.urgent_us = urgent.derived_us;
    }
    proof.name = app.chains[k].name;
    proof.deadline_us = app.chains[k].deadline_us;
    checking::compare(policy.chains[k], proof, report);
    report.chains.push_back(std::move(proof));
  }
  if (std::string line = independence_of(app, platform, policy); !line.empty())
    report.taken.push_back(std::move(line));
  // Chains follow from keys that are kept.
  if (std::ranges::any_of(report.xpus, [](const XpuProof& proof) { return proof.kind.empty(); })) {
    report.chains.clear();
    report.taken.clear();
  }
  return report;
}

Result<CheckReport> check(const AppSpec& app, const Platform& platform, const Policy& policy,
                          const Beside& beside) {
  XAUTO_ASSIGN(CheckReport report, examine(app, platform, policy, beside));
  if (!report.lies.empty()) return tl::unexpected<Error>(report.lies.front());
  return report;
}

namespace {

Result<checking::Ticks> ticks_of(const std::vector<Demand>& demands) {
  checking::Ticks ticks = 1;
  for (const Demand& demand : demands) {
    XAUTO_TRY(validate(demand));
    ticks = checking::lcm(ticks, demand.ticks_per_us);
    if (ticks == 0)
      return fail(ErrorCode::kInvalid, "the ticks of the demands have no multiple that fits",
                  "demands", "state periods as ratios of smaller numbers");
  }
  return ticks;
}

}  // namespace

Result<int> slack_together(const std::vector<Demand>& demands) {
  if (demands.empty() || demands.front().xpus.size() != 1)
    return fail(ErrorCode::kInvalid, "nothing is asked of one XPU", "demands");
  XAUTO_TRY(check_together(demands));
  XAUTO_ASSIGN(const checking::Ticks ticks, ticks_of(demands));
  Beside all{.demands = demands, .reserve_pct = 0};
  int fits = 0, too_much = kMaxReservePct + 1;
  while (too_much - fits > 1) {
    all.reserve_pct = (fits + too_much) / 2;
    (checking::prove_together(demands.front().xpus.front().xpu, ticks, all) ? fits : too_much) =
        all.reserve_pct;
  }
  return fits;
}

Status check_together(const std::vector<Demand>& demands) {
  XAUTO_ASSIGN(const checking::Ticks ticks, ticks_of(demands));
  if (demands.empty()) return {};
  for (const DemandOnXpu& wanted : demands.back().xpus) {
    Beside all{.demands = {}, .reserve_pct = 0};
    for (const Demand& demand : demands) {
      const auto on = std::ranges::find(demand.xpus, wanted.xpu.id,
                                        [](const DemandOnXpu& other) { return other.xpu.id; });
      if (on == demand.xpus.end()) continue;
      if (on->xpu != wanted.xpu)
        return fail(
            ErrorCode::kInvalid,
            "one app has it that it preempts, at what cost, or its levels otherwise than another",
            "XPU " + wanted.xpu.id, "plan both apps for one platform.json");
      all.demands.push_back({demand.ticks_per_us, {*on}});
    }
    XAUTO_TRY(checking::prove_together(wanted.xpu, ticks, all));
  }
  return {};
}

Result<Demand> demand_of(const AppSpec& app, const Platform& platform, const Policy& policy) {
  XAUTO_TRY(has_demand(app));
  XAUTO_ASSIGN(const checking::World w, checking::derive(app, platform, policy, false, 1, true));
  Demand demand;
  demand.ticks_per_us = w.scale;
  for (std::size_t m = 0; m < platform.xpus.size(); ++m) {
    DemandOnXpu on = checking::demand_on(w, static_cast<int>(m));
    if (!on.sequences.empty()) demand.xpus.push_back(std::move(on));
  }
  XAUTO_TRY(validate(demand));
  return demand;
}

Result<std::vector<SporadicNeed>> sporadic_needs_of(const AppSpec& app, const Platform& platform,
                                                    const Policy& policy) {
  XAUTO_TRY(has_demand(app));
  XAUTO_ASSIGN(const checking::World w, checking::derive(app, platform, policy, false, 1, true));
  constexpr __int128 kNsPerUs = 1000;
  std::vector<SporadicNeed> needs;
  for (int i = 0; i < static_cast<int>(app.xnodes.size()); ++i) {
    if (!w.urgent[at(i)].empty())
      return fail(ErrorCode::kInvalid, "its releases may be urgent: nobody can enforce how often",
                  "XNode '" + w.name(i) + "'");
    checking::Ticks window = checking::kMaxTicks, longest = 0;
    for (const checking::Window& one : w.windows[at(i)]) {
      window = std::min(window, one.d - one.a);
      longest = std::max(longest, one.d - one.e);
    }
    const checking::Component& c = w.home(i);
    const int xpu = policy.placements[at(i)].xpu;
    const Xpu& on = platform.xpus[at(xpu)];
    const checking::Ticks work =
        w.wcet[at(i)] + (on.preemptive ? on.preempt_us * w.scale : checking::Ticks{0});
    needs.push_back(
        {.xnode = i,
         .xpu = xpu,
         .period_ns = checking::floor_div(checking::least(c.period, c.ppm) * kNsPerUs, w.scale),
         .window_ns = checking::floor_div(window * kNsPerUs, w.scale),
         .longest_ns = checking::ceil_div(longest * kNsPerUs, w.scale),
         .work_ns = checking::ceil_div(work * kNsPerUs, w.scale)});
  }
  return needs;
}

}  // namespace xauto::solver::keys
