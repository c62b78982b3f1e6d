// SPDX-License-Identifier: Apache-2.0
#include "xauto/periodic.h"

#include <iostream>

#include <fmt/format.h>

#include "base/index.h"
#include "model/json.h"
#include "model/json_value.h"
#include "solver/steady/check.h"

#include "xauto/outputs.h"

namespace xauto::cli {
namespace {

Result<int> find_xnode(const AppSpec& app, const std::string& name, const char* option) {
  const int i = app.find(name);
  if (i < 0) return fail(ErrorCode::kInvalid, "no XNode '" + name + "'", option);
  return i;
}

/// What of the pins, forbids and groups the policy does not keep.
Result<std::vector<std::string>> broken_wishes(const AppSpec& app, const Platform& platform,
                                               const KeyPolicy& policy,
                                               const solver::Objectives& asked) {
  std::vector<std::string> broken;
  const auto runs_on = [&](int i, const std::string& target) {
    const Xpu& xpu = platform.xpus[at(policy.placements[at(i)].xpu)];
    return xpu.id == target || xpu.type == target;
  };
  for (const bool pin : {true, false})
    for (const auto& [name, target] : pin ? asked.pins : asked.forbids) {
      XAUTO_ASSIGN(const int i, find_xnode(app, name, pin ? "pins" : "forbids"));
      if (runs_on(i, target) != pin)
        broken.push_back(fmt::format("XNode '{}' runs on {}, {} to {}", name,
                                     platform.xpus[at(policy.placements[at(i)].xpu)].id,
                                     pin ? "pinned" : "forbidden", target));
    }
  for (const auto& group : asked.groups)
    for (const std::string& name : group) {
      XAUTO_ASSIGN(const int first, find_xnode(app, group.front(), "groups"));
      XAUTO_ASSIGN(const int i, find_xnode(app, name, "groups"));
      if (policy.placements[at(i)].xpu != policy.placements[at(first)].xpu)
        broken.push_back(fmt::format("XNodes '{}' and '{}' are on two XPUs, asked for one",
                                     group.front(), name));
    }
  return broken;
}

std::string proof_text(const solver::steady::XpuProof& p) {
  if (p.jobs == 0) return fmt::format("  shown  {:<8} no job\n", p.xpu);
  std::string text = fmt::format("  shown  {:<8} {}: {} jobs every {:.3f} ms, load {:.1f} %", p.xpu,
                                 p.kind, p.jobs, p.repeats_us / 1000, 100 * p.load);
  if (!p.xnode.empty())
    text += fmt::format(
        "; tightest before the key of '{}', activation {}: {:.3f} of {:.3f} us, {:.3f} left",
        p.xnode, p.activation, p.demand_us, p.length_us, p.slack_us);
  return text + "\n";
}

}  // namespace

Result<int> check_periodic(const AppSpec& app, const Platform& platform,
                           const std::string& policy_path, const solver::Objectives& asked,
                           const Options& options) {
  XAUTO_ASSIGN(const KeyPolicy policy, load_key_policy(policy_path, app, platform));
  std::vector<std::string> lies, missed;
  solver::steady::CheckReport report;
  if (auto checked = solver::steady::check(app, platform, policy))
    report = std::move(*checked);
  else if (checked.error().code == ErrorCode::kInfeasible)
    lies.push_back(checked.error().where + ": " + checked.error().what);
  else
    return tl::unexpected<Error>(checked.error());
  XAUTO_ASSIGN(const std::vector<std::string> broken, broken_wishes(app, platform, policy, asked));
  lies.insert(lies.end(), broken.begin(), broken.end());
  Json xpus = Json::array(), chains = Json::array();
  std::string text;
  for (const auto& p : report.xpus) {
    xpus.push_back({{"xpu", p.xpu},
                    {"kind", p.kind},
                    {"load", p.load},
                    {"jobs", p.jobs},
                    {"repeats_us", p.repeats_us},
                    {"charged", p.charged},
                    {"xnode", p.xnode},
                    {"activation", p.activation},
                    {"length_us", p.length_us},
                    {"demand_us", p.demand_us},
                    {"slack_us", p.slack_us}});
    text += proof_text(p);
  }
  for (const auto& c : report.chains) {
    chains.push_back({{"name", c.name},
                      {"derived_us", c.derived_us},
                      {"worst_case_us", c.claimed_us},
                      {"lower_bound_us", c.claimed_bound_us},
                      {"own_bound_us", c.own_bound_us},
                      {"path", c.path}});
    text += fmt::format("  shown  chain '{}' never takes longer than {}, claimed {}; along {}\n",
                        c.name, ms(c.derived_us), ms(c.claimed_us), fmt::join(c.path, " > "));
    text += fmt::format("  taken  its lower bound of {}: own bound {}\n", ms(c.claimed_bound_us),
                        ms(c.own_bound_us));
    if (c.late())
      missed.push_back(fmt::format("chain '{}' may take {}, its deadline is {}", c.name,
                                   ms(c.derived_us), ms(*c.deadline_us)));
  }
  const int status = lies.empty() && missed.empty() ? kDone : kAnswerIsNo;
  if (options.json) {
    std::cout << Json{{"schema", "xauto.check"},    {"version", 2},
                      {"truthful", lies.empty()},   {"lies", lies},
                      {"missed", missed},           {"xpus", std::move(xpus)},
                      {"chains", std::move(chains)}}
                     .dump(2)
              << "\n";
    return status;
  }
  for (const std::string& lie : lies) std::cout << "  LIE    " << lie << "\n";
  for (const std::string& miss : missed) std::cout << "  MISSED " << miss << "\n";
  std::cout << text
            << (lies.empty() ? fmt::format("\n{} tells the truth.\n", policy_path)
                             : fmt::format("\n{} lies: {} of its statements are false.\n",
                                           policy_path, lies.size()));
  return status;
}

Result<int> play_periodic(const AppSpec& app, const Platform& platform,
                          const std::string& policy_path, const solver::steady::PlayOptions& play,
                          const std::string& out, const Options& options) {
  XAUTO_ASSIGN(const KeyPolicy policy, load_key_policy(policy_path, app, platform));
  Outputs outputs;
  XAUTO_TRY(outputs.expect("--out", out));
  XAUTO_ASSIGN(const solver::steady::PlayReport r,
               solver::steady::play(app, platform, policy, play));
  Json xnodes = Json::array(), chains = Json::array(), xpus = Json::array();
  bool longer = false;
  std::string table = fmt::format("  {:<24}{:<8}{:>10}{:>8}{:>12}{:>20}\n", "XNode", "XPU", "jobs",
                                  "late", "suspended", "last before key us");
  for (std::size_t i = 0; i < r.xnodes.size(); ++i) {
    const auto& x = r.xnodes[i];
    const std::string& xpu = platform.xpus[at(policy.placements[i].xpu)].id;
    xnodes.push_back({{"name", app.xnodes[i].name},
                      {"xpu", xpu},
                      {"jobs", x.jobs},
                      {"late", x.late},
                      {"suspended", x.suspended},
                      {"latest_after_key_us", x.jobs > 0 ? Json(x.closest_us) : Json()}});
    table += fmt::format("  {:<24}{:<8}{:>10}{:>8}{:>12}{:>20.3f}\n", app.xnodes[i].name, xpu,
                         x.jobs, x.late, x.suspended, x.jobs > 0 ? -x.closest_us : 0);
  }
  table += fmt::format("\n  {:<24}{:>14}{:>16}{:>16}\n", "chain", "releases", "longest us",
                       "worst case us");
  for (const auto& c : r.chains) {
    longer = longer || c.longest_us > static_cast<double>(c.claimed_us);
    chains.push_back({{"name", c.name},
                      {"releases", c.releases},
                      {"longest_us", c.longest_us},
                      {"worst_case_us", c.claimed_us}});
    table += fmt::format("  {:<24}{:>14}{:>16.3f}{:>16}\n", c.name, c.releases, c.longest_us,
                         c.claimed_us);
  }
  for (std::size_t m = 0; m < r.busy.size(); ++m)
    xpus.push_back({{"xpu", platform.xpus[m].id}, {"busy", r.busy[m]}});
  const Json document = {{"schema", "xauto.simulation"},
                         {"version", 2},
                         {"app", app.name},
                         {"platform", platform.name},
                         {"seconds", play.seconds},
                         {"seed", play.seed},
                         {"jobs", r.jobs},
                         {"late", r.late},
                         {"unfinished", r.unfinished},
                         {"backlog", r.backlog},
                         {"preemptions", r.suspended},
                         {"first_late", r.first_late},
                         {"chains", std::move(chains)},
                         {"xnodes", std::move(xnodes)},
                         {"xpus", std::move(xpus)}};
  const std::string result = document.dump(2) + "\n";
  if (options.json)
    std::cout << result;
  else
    std::cout << table
              << fmt::format("\n  {} on {}, {} s: {} jobs, {} late, {} preemptions{}\n", app.name,
                             platform.name, play.seconds, r.jobs, r.late, r.suspended,
                             r.backlog ? "; given up, since jobs pile up" : "")
              << (r.first_late.empty() ? "" : "  first: " + r.first_late + "\n");
  outputs.write(out, result);
  return outputs.status(r.late > 0 || longer || r.backlog ? kAnswerIsNo : kDone);
}

}  // namespace xauto::cli
