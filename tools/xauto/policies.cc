// SPDX-License-Identifier: Apache-2.0
#include "xauto/policies.h"

#include <algorithm>
#include <cmath>
#include <iostream>
#include <unordered_map>
#include <utility>

#include <fmt/format.h>

#include "base/columns.h"
#include "base/index.h"
#include "model/claims.h"
#include "model/components.h"
#include "model/contention.h"
#include "model/hosts.h"
#include "model/json.h"
#include "model/json_value.h"
#include "model/together.h"
#include "solver/keys/check.h"
#include "solver/keys/lower_bounds.h"
#include "solver/keys/one_release.h"
#include "solver/keys/what_if.h"

#include "xauto/held.h"
#include "xauto/outputs.h"
#include "xauto/rare_wcets.h"
#include "xauto/remedies.h"
#include "xauto/windows.h"

namespace xauto::cli {
namespace {

namespace keys = solver::keys;

constexpr std::size_t kProofColumns =
    20;  ///< behind the XPU, before what shows that jobs end by their keys
constexpr std::size_t kMostPrices = 12;  ///< of modules in one line
/// Where nothing is certified, so much of the time limit more: for the best policy, and for what would help.
constexpr double kForUncertified = 0.4, kForRemedies = 0.2;
/// Of the time limit more, for the policy of the app alone where none is found beside others; and for the lower bounds
/// of each of several apps.
constexpr double kForAlone = 0.2, kForBoundsAlone = 0.05;
constexpr std::size_t kMostFails = 4;  ///< XPUs that are told

std::string ms_of(double us) {
  return fmt::format("{:.3f} ms", us / 1000);
}
/// Beside what ms_of() tells. Microseconds of a quarter of an hour are nobody's concern, and too wide.
std::string exact_ms(std::int64_t us) {
  return us < 1'000'000'000 ? ms_of(static_cast<double>(us)) : ms(us);
}

/// "22 XNodes, 3 sources, 2 clocks, repeats every 100.000 ms"
std::string shape(const AppSpec& app) {
  std::string text = fmt::format("{} XNodes, {} sources", app.xnodes.size(), app.sources.size());
  if (app.one_at_a_time) return text + ", one release at a time";
  const auto parts = find_components(app);
  if (!parts) return text;
  text += fmt::format(", {} {}", parts->domains.size(),
                      parts->domains.size() == 1 ? "clock" : "clocks");
  if (parts->domains.size() == 1 && parts->domains[0].hyperperiod_ticks)
    text += ", repeats every " + ms_of(static_cast<double>(*parts->domains[0].hyperperiod_ticks) /
                                       static_cast<double>(parts->ticks_per_us));
  return text;
}

/// Whom worst cases are for.
std::string scope(const Apps& apps, bool beside) {
  constexpr std::string_view kAlone = "this app alone, or apps that were tested with it";
  std::string text = scope_of(apps.all.one_at_a_time);
  if (const std::size_t at = text.find(kAlone);
      (apps.several() || beside) && at != std::string::npos)
    text.replace(at, kAlone.size(),
                 std::string(apps.several() ? "these apps" : "this app") +
                     (beside ? ", those of the demands, and nobody else"
                             : " alone, or apps that were tested with them"));
  return text;
}

std::string name_of_all(const Beside& beside) {
  std::string text;
  if (!beside.demands.empty())
    text = fmt::format("beside {} {}", beside.demands.size(),
                       beside.demands.size() == 1 ? "demand" : "demands");
  if (beside.reserve_pct > 0)
    text +=
        fmt::format("{}with {} % of each XPU left", text.empty() ? "" : ", ", beside.reserve_pct);
  return text;
}

/// Of a column of XPUs' names, with a blank.
std::size_t xpu_columns(const Platform& platform) {
  constexpr std::size_t kLeast = 8, kMost = 20;
  std::size_t longest = kLeast - 1;
  for (const Xpu& xpu : platform.xpus) longest = std::max(longest, xpu.id.size());
  return std::min(longest + 1, kMost);
}

std::string proof_table(const Platform& platform, const Policy& policy,
                        const keys::CheckReport& report) {
  const std::size_t name = xpu_columns(platform), before = name + kProofColumns;
  std::string out = fmt::format("  {:<{}}{:>7}{:>9}  {}\n", "XPU", name, "XNodes", "load",
                                "why every job ends by its key");
  for (std::size_t x = 0; x < report.xpus.size(); ++x) {
    const keys::XpuProof& proof = report.xpus[x];
    const auto count =
        std::count_if(policy.placements.begin(), policy.placements.end(),
                      [&](const Placement& p) { return p.xpu == static_cast<int>(x); });
    std::string why = count == 0           ? "it has none"
                      : proof.kind.empty() ? "not shown"
                                           : fmt::format("{} of {} jobs in {}", proof.kind,
                                                         proof.jobs, ms_of(proof.repeats_us));
    if (count > 0 && !proof.kind.empty() && !proof.xnode.empty())
      why += fmt::format(";\n{:{}}tightest {} {}: {} free of {}", "", before, proof.xnode,
                         proof.activation, ms_of(proof.slack_us), ms_of(proof.length_us));
    out += wrapped(row_of(proof.xpu, name) +
                       fmt::format("{:>7}{:>7.1f} %  ", count, 100 * proof.load) + why,
                   before) +
           "\n";
  }
  return out;
}

/// Whose WCET is counted beside fewer loads than are stated, since the plan keeps it apart; empty: no load is stated.
std::string counted_loads(const AppSpec& app, const Platform& platform, const Policy& policy) {
  std::vector<std::string> less;
  std::size_t all = 0;
  for (std::size_t i = 0; i < policy.placements.size(); ++i) {
    const Placement& placed = policy.placements[i];
    if (!placed.wcet_us) continue;
    ++all;
    const std::int64_t longest = longest_wcet(app.xnodes[i], platform.xpus[at(placed.xpu)].type);
    if (*placed.wcet_us < longest)
      less.push_back(
          fmt::format("{} {} of {}", app.xnodes[i].name, ms(*placed.wcet_us), ms(longest)));
  }
  if (all == 0) return {};
  return wrapped(
             fmt::format("  beside loads: {} of {} XNodes count less than their longest WCET{}{}",
                         less.size(), all,
                         less.empty() ? "" : ", being kept apart: ", fmt::join(less, ", ")),
             9) +
         "\n";
}

/// A line per XPU whose preemptions cost what nobody has measured, and are charged; one where XPUs are taken for
/// independent.
std::string not_measured(const AppSpec& app, const Platform& platform, const Policy& policy,
                         const keys::CheckReport& report) {
  std::string out;
  if (const std::string line = independence_of(app, platform, policy); !line.empty())
    out += wrapped("  taken  " + line, 9) + "\n";
  for (std::size_t x = 0; x < report.xpus.size(); ++x)
    if (const std::string cost = unmeasured(platform.xpus[x]);
        report.xpus[x].charged > 0 && !cost.empty())
      out += wrapped("  taken  " + cost, 9) + "\n";
  return out;
}

std::string chain_table(const AppSpec& app, const Policy& policy) {
  std::string out =
      row_of("chain", kNameColumns) +
      fmt::format("{:>11}{:>11}{:>13}{:>8}\n", "worst case", "deadline", "lower bound", "gap");
  for (std::size_t c = 0; c < policy.chains.size(); ++c) {
    const ChainClaim& claim = policy.chains[c];
    const auto& deadline = app.chains[c].deadline_us;
    const double gap = static_cast<double>(claim.worst_case_us - claim.lower_bound_us) /
                       static_cast<double>(std::max<std::int64_t>(1, claim.worst_case_us));
    out += row_of(claim.name, kNameColumns) +
           fmt::format("{:>11}{:>11}{:>13}{:>6.1f} %{}\n", ms(claim.worst_case_us),
                       deadline ? ms(*deadline) : "-", ms(claim.lower_bound_us), 100 * gap,
                       deadline && claim.worst_case_us > *deadline ? " MISSED"
                       : claim.optimal                             ? " optimal"
                                                                   : "");
    if (claim.urgent_worst_case_us)
      out += row_of("  urgent", kNameColumns) +
             fmt::format("{:>11}\n", ms(*claim.urgent_worst_case_us));
  }
  return out;
}

/// What urgency is, and what it takes of the proof. Empty: no source states it.
std::string urgency(const AppSpec& app) {
  std::string out;
  for (const SourceSpec& s : app.sources)
    if (s.urgent)
      out += fmt::format("\n  {}: its urgent releases go first by {}, each {} at most once.",
                         s.name, ms(s.urgent->by_us), ms(s.urgent->every_us));
  if (out.empty()) return out;
  return out +
         "\n  Worst cases hold with them and without. Their XPUs are proven as if several clocks "
         "met "
         "there: an urgent\n  job of each XNode may come at any time, beside all ordinary ones. "
         "Lower "
         "bounds are those without urgency.\n";
}

bool is_optimal(double value, double bound) {
  return value <= bound * (1 + 1e-9);
}

/// What was minimised, in words.
std::string aim_of(const AppSpec& app, const keys::Answer& answer, keys::Aim aim) {
  const bool deadlines = app.has_deadlines();
  const std::string first = deadlines ? "no deadline is missed; then " : "";
  const char* of = deadlines ? "worst case / deadline" : "worst case";
  if (aim == keys::Aim::kLargest)
    return fmt::format("{}the least of the largest {}, and of their sum", first, of);
  const std::string sum = fmt::format("{}the least weighted sum of {}", first, of);
  if (aim == keys::Aim::kSum) return sum;
  return fmt::format("{},\n    the largest of them within 5 % of the least found ({})", sum,
                     deadlines ? fmt::format("{:.1f} %", 100 * answer.least_largest)
                               : fmt::format("{:.3f} ms", answer.least_largest / 1000));
}

/// How far the policy is from the least of any, all chains together.
std::string of_all_chains(const AppSpec& app, const keys::Answer& answer, keys::Aim aim) {
  if (app.chains.empty()) return "";
  const auto& [largest, sum] = answer.totals;
  const auto& [least, least_sum] = answer.bounds;
  const auto optimal = [](double value, double bound) {
    return is_optimal(value, bound) ? ": optimal" : "";
  };
  std::string out = "\n  objective: " + aim_of(app, answer, aim) + "\n";
  if (!app.one_at_a_time) out += "    last, no claim being longer, the least typical latency\n";
  if (!answer.proof.empty()) out += "    " + answer.proof + "\n";
  if (app.has_deadlines())
    return out + fmt::format(
                     "    largest  {:>9.1f} %   of no policy of keys less than {:.1f} %{}\n"
                     "    sum      {:>11.3f}   of no policy of keys less than {:.3f}{}\n",
                     100 * largest, 100 * least, optimal(largest, least), sum, least_sum,
                     optimal(sum, least_sum));
  return out + fmt::format(
                   "    largest  {:>11.3f} ms   of no policy of keys less than {:.3f} ms{}\n"
                   "    sum      {:>11.3f} ms   of no policy of keys less than {:.3f} ms{}\n",
                   largest / 1000, least / 1000, optimal(largest, least), sum / 1000,
                   least_sum / 1000, optimal(sum, least_sum));
}

const char* name_of(keys::Aim aim) {
  switch (aim) {
    case keys::Aim::kLargest:
      return "largest";
    case keys::Aim::kSum:
      return "sum";
    case keys::Aim::kMix:
      break;
  }
  return "mix";
}

Json objective_of(const AppSpec& app, const keys::Answer& answer, keys::Aim aim) {
  const auto of = [](double value, double bound) {
    return Json{{"value", value}, {"lower_bound", bound}, {"optimal", is_optimal(value, bound)}};
  };
  Json told = {{"asked", name_of(aim)},
               {"of", app.has_deadlines() ? "worst case / deadline" : "worst case"},
               {"largest", of(answer.totals.largest, answer.bounds.largest)},
               {"sum", of(answer.totals.sum, answer.bounds.sum)}};
  if (!answer.proof.empty()) told["proof"] = answer.proof;
  if (aim == keys::Aim::kMix) told["least_largest_found"] = answer.least_largest;
  return told;
}

Json proofs(const keys::CheckReport& report) {
  Json list = Json::array();
  for (const keys::XpuProof& proof : report.xpus) {
    if (proof.kind.empty()) continue;
    Json j = {
        {"xpu", proof.xpu}, {"proof", proof.kind}, {"load", proof.load}, {"jobs", proof.jobs}};
    if (!proof.xnode.empty())
      j["tightest"] = {{"xnode", proof.xnode},
                       {"activation", proof.activation},
                       {"length_us", proof.length_us},
                       {"demand_us", proof.demand_us},
                       {"slack_us", proof.slack_us}};
    list.push_back(std::move(j));
  }
  return list;
}

Result<int> find_xnode(const AppSpec& app, const std::string& name, const char* option) {
  const int i = app.find(name);
  if (i < 0) return fail(ErrorCode::kInvalid, "no XNode '" + name + "'", option);
  return i;
}

/// What of the pins, forbids and groups the policy does not keep.
Result<std::vector<std::string>> broken_wishes(const AppSpec& app, const Platform& platform,
                                               const Policy& policy,
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

const char* words(keys::Outcome outcome) {
  switch (outcome) {
    case keys::Outcome::kPolicy:
      return "policy";
    case keys::Outcome::kUnsustainable:
      return "unsustainable";
    case keys::Outcome::kUnknown:
      break;
  }
  return "unknown";
}

Json cases_of(const AppSpec& app, const std::vector<keys::WhatIf>& ifs) {
  Json list = Json::array();
  for (const keys::WhatIf& what : ifs) {
    Json j = {{"change", what.change}, {"outcome", words(what.outcome)}};
    if (!what.overload.empty()) j["proof"] = what.overload;
    for (std::size_t c = 0; c < what.worst_case_us.size(); ++c)
      j["chains"].push_back(
          {{"name", app.chains[c].name}, {"worst_case_us", what.worst_case_us[c]}});
    list.push_back(std::move(j));
  }
  return list;
}

constexpr double kWorthTelling = 0.01;  ///< of a claim
constexpr std::size_t kShownChanges = 3;

std::string what_it_brings(const AppSpec& app, const Policy& policy, const keys::WhatIf& what,
                           double limit_s) {
  if (what.outcome == keys::Outcome::kUnsustainable) return "no policy keeps up: " + what.overload;
  if (what.outcome != keys::Outcome::kPolicy)
    return fmt::format("unknown: no policy found in {:.2f} s", limit_s);
  std::string changes;
  if (!policy.certified) {
    for (std::size_t c = 0; c < what.worst_case_us.size(); ++c)
      changes += fmt::format("{}{} {}", c == 0 ? "certified: " : ", ", app.chains[c].name,
                             exact_ms(what.worst_case_us[c]));
    return changes;
  }
  std::vector<std::pair<double, std::size_t>> parts;  // of the claim, chain
  for (std::size_t c = 0; c < what.worst_case_us.size(); ++c) {
    const auto was = static_cast<double>(policy.chains[c].worst_case_us);
    const double part =
        std::abs(static_cast<double>(what.worst_case_us[c]) - was) / std::max(1.0, was);
    if (part >= kWorthTelling) parts.emplace_back(-part, c);
  }
  std::ranges::sort(parts);
  for (std::size_t k = 0; k < std::min(parts.size(), kShownChanges); ++k) {
    const std::size_t c = parts[k].second;
    changes += fmt::format(
        "{}{} {:+.2f} ms", k == 0 ? "" : ", ", app.chains[c].name,
        static_cast<double>(what.worst_case_us[c] - policy.chains[c].worst_case_us) / 1000);
  }
  if (parts.size() > kShownChanges)
    changes += fmt::format(", {} more", parts.size() - kShownChanges);
  return changes;
}

/// A line per case: the chains that change most. Each was searched for `limit_s`. What changes next to nothing is one line.
std::string what_if_table(const AppSpec& app, const Policy& policy,
                          const std::vector<keys::WhatIf>& ifs, double limit_s) {
  std::string out, none;
  if (!ifs.empty()) out += "\n  What if ... (by the solver alone)\n";
  for (const keys::WhatIf& what : ifs) {
    const std::string brings = what_it_brings(app, policy, what, limit_s);
    if (brings.empty())
      none += (none.empty() ? "" : ", ") + what.change;
    else
      out += wrapped(row_of(what.change, 34) + brings, 36) + "\n";
  }
  if (!none.empty()) out += wrapped("  no chain by 1 %: " + none, 4) + "\n";
  return out;
}

/// What proves that no policy keeps up.
void tell_proof(const AppSpec& app, const keys::OverloadProof& proof, Json& told,
                std::string& text) {
  Json causes = Json::array();
  std::string list;
  for (const auto& [xnode, share] : proof.causes) {
    const std::string& name = app.xnodes[static_cast<std::size_t>(xnode)].name;
    causes.push_back({{"xnode", name}, {"share_pct", static_cast<double>(share) / 10}});
    list +=
        row_of(name, kNameColumns) + fmt::format("{:>7.1f} %\n", static_cast<double>(share) / 10);
  }
  Json weights = Json::object();
  std::string prices;
  for (const auto& [place, weight] : proof.weights) {
    weights[place.c_str()] = weight;
    prices += fmt::format("{}{} {}", prices.empty() ? "" : ", ", place, weight);
  }
  Json of_modules = Json::object();
  for (const auto& [xnode, price] : proof.module_weights) {
    const std::string& module = app.xnodes[static_cast<std::size_t>(xnode)].module;
    of_modules[module.c_str()] = price;
    if (proof.module_weights.size() <= kMostPrices)
      prices += fmt::format(", module {} {}", module, price);
  }
  told["proof"] = proof.text;
  told["load_pct"] = proof.load_pct ? Json(*proof.load_pct) : Json();
  told["weights"] = std::move(weights);
  told["causes"] = std::move(causes);
  if (!proof.module_weights.empty()) told["module_weights"] = std::move(of_modules);
  if (!list.empty()) text += "  most of it is\n" + list;
  if (!prices.empty())
    text += fmt::format(
        "\n  proof: these weights ({}), each unit at its cheapest place{}\n", prices,
        proof.module_weights.size() > kMostPrices ? "; --json has those of modules" : "");
}

/// The best policy all the same: who is where, and how long chains took when it was played.
void tell_policy(const AppSpec& app, const Platform& platform, const keys::Uncertified& found,
                 Json& told, std::string& text) {
  Json xpus = Json::array(), chains = Json::array();
  text +=
      fmt::format("\n  {:<9}{:>7}{:>14}{:>12}\n", "XPU", "XNodes", "load at WCETs", "usual load");
  for (std::size_t x = 0; x < platform.xpus.size(); ++x) {
    const auto count =
        std::ranges::count(found.policy.placements, static_cast<int>(x), &Placement::xpu);
    const auto& [at_wcets, usual] = found.load[x];
    text += row_of(platform.xpus[x].id, 9) +
            fmt::format("{:>7}{:>12.1f} %{:>10.1f} %{}\n", count, 100 * at_wcets, 100 * usual,
                        usual > 1      ? "  more than it can do, even usually"
                        : at_wcets > 1 ? "  full at WCETs"
                                       : "");
    xpus.push_back(
        {{"xpu", platform.xpus[x].id}, {"load_at_wcets", at_wcets}, {"usual_load", usual}});
  }
  told["xpus"] = std::move(xpus);
  if (found.played) {
    text += "\n" + row_of("chain, played", 19) +
            fmt::format("{:>13}{:>13}{:>14}{:>13}\n", "median", "99 %", "longest seen", "deadline");
    for (std::size_t c = 0; c < app.chains.size(); ++c) {
      const keys::PlayedChain& chain = found.played->chains[c];
      const auto& deadline = app.chains[c].deadline_us;
      const auto seen = [&](double us) { return chain.releases > 0 ? ms_of(us) : "-"; };
      text += row_of(chain.name, 19) +
              fmt::format(
                  "{:>13}{:>13}{:>14}{:>13}{}\n", seen(chain.median_us), seen(chain.p99_us),
                  seen(chain.longest_us), deadline ? exact_ms(*deadline) : "-",
                  deadline && chain.longest_us > static_cast<double>(*deadline) ? "  late" : "");
      chains.push_back({{"name", chain.name},
                        {"median_us", chain.median_us},
                        {"p99_us", chain.p99_us},
                        {"longest_us", chain.longest_us},
                        {"releases", chain.releases}});
    }
    told["played"] = {{"duration_us", found.seconds * 1'000'000},
                      {"backlog", found.played->backlog},
                      {"chains", std::move(chains)}};
    text += fmt::format(
        "  {} s at usual times (typical_us; where none is known {} % of the WCET){}\n",
        found.seconds, keys::kUsualPct, found.played->backlog ? ": the backlog grew" : "");
  }
  text +=
      "\n  It is the best that was found, and nothing is claimed of it: no chain has a worst case, "
      "and its keys "
      "only say\n  who goes first.\n";
  told["policy"] = Json::parse(to_json(found.policy, app, platform)).value_or(Json());
}

void tell_remedies(const keys::Uncertified& found, const std::vector<Remedy>& list, Json& told,
                   std::string& text) {
  text += list.empty() ? "\n  No single change was found with which a policy is certified.\n"
                       : "\n  With one of these a policy was certified:\n";
  Json remedies = Json::array();
  for (const Remedy& remedy : list) {
    text += fmt::format("    {}{}\n", remedy.change, remedy.late ? "; a deadline is missed" : "");
    Json one = remedy.what;
    one["change"] = remedy.change;
    one["deadlines"] = remedy.late ? "missed" : "met";
    remedies.push_back(std::move(one));
  }
  if (found.overloaded_pct) {
    text += fmt::format("  With all WCETs at {} % it is proven that no policy keeps up.\n",
                        *found.overloaded_pct);
    told["overloaded_pct"] = *found.overloaded_pct;
  }
  told["remedies"] = std::move(remedies);
}

double assumed_s(const keys::Options& asked) {
  return std::min(2.0, asked.time_limit_s);
}

/// The answers to --assume.
Result<std::vector<keys::WhatIf>> ask_assumed(const AppSpec& app, const Platform& platform,
                                              const Policy& policy,
                                              const std::vector<std::string>& assume,
                                              keys::Options asked) {
  asked.time_limit_s = assumed_s(asked);
  std::vector<keys::WhatIf> ifs;
  for (const std::string& text : assume) {
    auto what = keys::assume(app, platform, policy, text, asked);
    if (!what) {
      what.error().where = "--assume " + what.error().where;
      return tl::unexpected<Error>(std::move(what).error());
    }
    ifs.push_back(std::move(*what));
  }
  return ifs;
}

/// A line per way between hosts, and what was not stated of it.
std::string crossings_text(const AppSpec& app, const Platform& platform, const Policy& policy) {
  if (platform.hosts.empty()) return "";
  const std::vector<int> host = hosts_of(app, platform, policy);
  std::string out;
  std::size_t silent = 0;
  for (const HostLink& link : platform.links) {
    std::vector<std::string_view> from;
    std::int64_t x_us = 0;
    for (const Crossing& c : policy.crossings) {
      if (host[at(c.from)] != link.from || c.host != link.to) continue;
      from.push_back(app.xnodes[at(c.from)].name);
      x_us = c.x_us;
      if (link.mbit_s > 0 && app.xnodes[at(c.from)].message_bytes == 0) ++silent;
    }
    if (!from.empty())
      out += wrapped(fmt::format("  {} to {}: X {}, of {}", platform.hosts[at(link.from)].name,
                                 platform.hosts[at(link.to)].name, ms(x_us), fmt::join(from, ", ")),
                     6) +
             "\n";
  }
  if (out.empty()) return "\n  between hosts: nothing crosses\n";
  if (silent > 0)
    out += fmt::format("  {} of these state no message_bytes, and count with the link's base_us\n",
                       silent);
  return "\n  between hosts, a message is there at most X after its sender's key:\n" + out;
}

/// The policies of several apps, in the order of --out.
void write_policies(const Apps& apps, const Platform& platform, const Policy& policy,
                    const std::vector<std::string>& paths, Outputs& outputs, bool tell) {
  const std::vector<Policy> parts = split_policy(apps.each, platform, policy);
  for (std::size_t a = 0; a < paths.size(); ++a)
    outputs.write(paths[a], to_json(parts[a], apps.each[a], platform));
  if (tell && !paths.empty() && outputs.good())
    std::cout << fmt::format("\n  written to {}\n", fmt::join(paths, ", "));
}

Status write_demand(const AppSpec& app, const Platform& platform, const Policy& policy,
                    const std::string& path, Outputs& outputs) {
  if (path.empty()) return {};
  XAUTO_ASSIGN(const Demand demand, keys::demand_of(app, platform, policy));
  outputs.write(path, to_json(demand));
  return {};
}

/// That nothing was found beside others, or with a reserve: by how much the best alone does not fit.
tl::unexpected<Error> does_not_fit(const AppSpec& app, const Platform& platform,
                                   const keys::Options& asked, const keys::Answer& found) {
  std::string why = "no policy that keeps up was found even without them";
  if (found.outcome == keys::Outcome::kUnsustainable)
    why = "none keeps up even alone: " + found.overload.text;
  keys::Options alone = asked;
  alone.beside = {};
  alone.time_limit_s = kForAlone * asked.time_limit_s;
  if (const auto answer = keys::solve(app, platform, alone);
      answer && answer->outcome == keys::Outcome::kPolicy)
    if (const auto report = keys::examine(app, platform, answer->policy, asked.beside); report) {
      std::vector<std::string> fails;  // XPUs
      for (const Error& lie : report->lies)
        if (fails.size() < kMostFails) fails.push_back(lie.where + ": " + lie.what);
      why = fmt::format("the best alone fails: {}", fmt::join(fails, "; "));
    }
  return fail(ErrorCode::kInfeasible,
              fmt::format("no policy was found {} in {:g} s; {}", name_of_all(asked.beside),
                          asked.time_limit_s, why),
              app.name + " on " + platform.name,
              "give it more time, later deadlines or less work; or plan all again, with --reserve");
}

/// Of each app alone: a bound that knows the others would be of nothing that a user sees in one policy.json.
void claim_bounds_alone(const Apps& apps, const Platform& platform, const keys::Options& asked,
                        Policy& policy) {
  if (!apps.several()) return;
  std::size_t chain = 0;
  for (const AppSpec& app : apps.each) {
    const auto p = keys::Problem::create(app, platform);
    const std::chrono::duration<double> limit(kForBoundsAlone * std::min(asked.time_limit_s, 1e6));
    const solver::Until until{
        std::chrono::steady_clock::now() +
            std::chrono::duration_cast<std::chrono::steady_clock::duration>(limit),
        asked.stop};
    std::vector<keys::Tick> bounds(app.chains.size(), 0);
    if (p) bounds = keys::lower_bounds(*p, app, platform, {}, 0, until);
    for (const keys::Tick bound : bounds) {
      ChainClaim& claim = policy.chains[chain++];
      claim.lower_bound_us = p && bound > 0 ? p->up_to_us(bound) / p->scale : 0;
      claim.optimal = claim.lower_bound_us == claim.worst_case_us;
    }
  }
}

/// Nothing is certified: the best policy all the same, without claims, and what would help.
Result<int> solve_uncertified(const Apps& apps, const Platform& platform,
                              const keys::Answer& answer, const keys::Options& asked,
                              const std::vector<std::string>& assume,
                              const std::vector<std::string>& out, Outputs& outputs,
                              const Options& options) {
  const AppSpec& app = apps.all;
  keys::Options half = asked;
  half.time_limit_s = kForUncertified * asked.time_limit_s;
  XAUTO_ASSIGN(const keys::Uncertified found, keys::least_late(app, platform, half));
  half.time_limit_s = kForRemedies * asked.time_limit_s;
  const std::vector<Remedy> help = remedies(app, platform, found, half);
  XAUTO_ASSIGN(const std::vector<keys::WhatIf> ifs,
               ask_assumed(app, platform, found.policy, assume, asked));
  const bool proven = answer.outcome == keys::Outcome::kUnsustainable;
  Json told = {{"schema", "xauto.uncertified"},
               {"version", 1},
               {"app", app.name},
               {"platform", platform.name},
               {"outcome", words(answer.outcome)}};
  std::string text =
      fmt::format("{} on {}: nothing is certified: {}\n\n", app.name, platform.name,
                  proven ? "no policy keeps up: " + answer.overload.text
                         : "neither a policy that keeps up was found in this time, nor a "
                           "proof that there is none (--time-limit)");
  if (proven) tell_proof(app, answer.overload, told, text);
  const std::vector<RareWcet> rare = rare_in_overload(app, platform, asked.wishes);
  if (!rare.empty()) told["rare_wcets"] = to_json(rare, app);
  tell_policy(app, platform, found, told, text);
  tell_remedies(found, help, told, text);
  if (!ifs.empty()) told["what_if"] = cases_of(app, ifs);
  text += what_if_table(app, found.policy, ifs, assumed_s(asked)) + words_of(rare, app);
  std::cout << (options.json ? told.dump(2) + "\n" : text);
  std::cout.flush();
  write_policies(apps, platform, found.policy, out, outputs, !options.json);
  return outputs.status(kAnswerIsNo);
}

/// By the check's paths: whoever a chain waits for in a component that it goes through.
std::vector<RareWcet> rare_in(const AppSpec& app, const Platform& platform, const Policy& policy,
                              const keys::CheckReport& report) {
  const auto parts = find_components(app);
  if (!parts) return {};
  std::vector<int> xpu;
  for (const Placement& placed : policy.placements) xpu.push_back(placed.xpu);
  std::unordered_map<std::string_view, int> component;
  for (std::size_t i = 0; i < app.xnodes.size(); ++i)
    component.emplace(app.xnodes[i].name, parts->of[i]);
  std::vector<Way> ways;
  for (const keys::ChainProof& chain : report.chains) {
    Way way{{}, chain.derived_us, chain.late()};
    for (std::size_t k = 2; k < chain.path.size(); k += 2)
      way.xnodes.insert(way.xnodes.end(),
                        parts->components[at(component.at(chain.path[k]))].xnodes.begin(),
                        parts->components[at(component.at(chain.path[k]))].xnodes.end());
    ways.push_back(std::move(way));
  }
  return rare_in_policy(app, platform, xpu, ways);
}

/// Who is where, beside where a hint has them.
Json moved(const AppSpec& app, const Platform& platform, const Policy& hint,
           const keys::Answer& answer) {
  Json list = Json::array();
  for (const int i : answer.moved)
    list.push_back({{"xnode", app.xnodes[at(i)].name},
                    {"from", platform.xpus[at(hint.placements[at(i)].xpu)].id},
                    {"to", platform.xpus[at(answer.policy.placements[at(i)].xpu)].id}});
  return list;
}

std::string moved_line(const AppSpec& app, const Platform& platform, const Policy& hint,
                       const keys::Answer& answer) {
  constexpr std::size_t kNamed = 5;
  const auto known = std::count_if(hint.placements.begin(), hint.placements.end(),
                                   [](const Placement& placed) { return placed.xpu >= 0; });
  std::string out = fmt::format("\n  moved: {} of the {} XNodes that the hint places",
                                answer.moved.size(), known);
  for (std::size_t k = 0; k < std::min(kNamed, answer.moved.size()); ++k) {
    const std::size_t i = at(answer.moved[k]);
    out += fmt::format("{} {} ({} to {})", k == 0 ? ":" : ",", app.xnodes[i].name,
                       platform.xpus[at(hint.placements[i].xpu)].id,
                       platform.xpus[at(answer.policy.placements[i].xpu)].id);
  }
  return out + (answer.moved.size() > kNamed ? ", ...\n" : "\n");
}

void show(SearchLine& line, const keys::Progress& progress) {
  if (!line.due(progress.elapsed_s)) return;
  if (progress.release_us > 0) {
    const auto best = static_cast<double>(progress.release_us);
    line.show(progress.elapsed_s,
              fmt::format("best {}   bound {}   gap {:.2f} %   {:.0f} k evaluations/s",
                          ms(progress.release_us), ms(progress.release_bound_us),
                          100 * (best - static_cast<double>(progress.release_bound_us)) / best,
                          progress.evaluations_per_s / 1000));
    return;
  }
  line.show(
      progress.elapsed_s,
      progress.late > 0
          ? fmt::format("worst {:.0f} % of its deadline, sum of worst cases / deadlines {:.3f}",
                        100 * progress.late, progress.sum)
          : "sum of worst cases " + ms_of(progress.sum));
}

/// HEFT and the like: priorities.
Result<int> solve_baseline(const AppSpec& app, const Platform& platform, const keys::Options& asked,
                           const std::string& out, const Options& options) {
  Outputs outputs;
  XAUTO_TRY(outputs.expect("--out", out));
  solver::SolveOptions solving;
  solving.method = asked.method;
  solving.time_limit_s = asked.time_limit_s;
  solving.stop = asked.stop;
  solving.objectives = asked.wishes;
  XAUTO_ASSIGN(const keys::Baseline made, keys::baseline(app, platform, solving));
  if (options.json) {
    Json root = Json::parse(to_json(made.policy, app, platform)).value_or(Json());
    root["release_us"] = made.release_us;
    std::cout << root.dump(2) << "\n";
  } else {
    std::cout << fmt::format(
        "{} on {}: priorities by {}. One release, every job at its WCET, no other release beside "
        "it{}: {}.\nNothing is claimed of any time.\n",
        app.name, platform.name, asked.method,
        app.transfers.empty() ? "" : " and transfers in no time", ms(made.release_us));
  }
  std::cout.flush();
  if (!out.empty()) outputs.write(out, to_json(made.policy, app, platform));
  if (!options.json && !out.empty() && outputs.good())
    std::cout << fmt::format("\n  written to {}\n", out);
  return outputs.status(kDone);
}

Json json_of(const Apps& apps, const Platform& platform, const Policy& policy) {
  if (!apps.several()) return Json::parse(to_json(policy, apps.all, platform)).value_or(Json());
  Json root = {{"schema", "xauto.policies"}, {"version", 1}, {"policies", Json::array()}};
  const std::vector<Policy> parts = split_policy(apps.each, platform, policy);
  for (std::size_t a = 0; a < parts.size(); ++a)
    root["policies"].push_back(
        Json::parse(to_json(parts[a], apps.each[a], platform)).value_or(Json()));
  return root;
}

/// What knows one computer is not asked of several.
Status known_on_hosts(const Platform& platform, const keys::Options& asked,
                      const std::vector<std::string>& assume) {
  if (platform.hosts.empty() || (asked.method == "auto" && assume.empty())) return {};
  return fail(ErrorCode::kInvalid, "platform '" + platform.name + "' has several hosts",
              asked.method != "auto" ? "--method " + asked.method : "--assume",
              "leave it out: it knows one computer");
}

tl::unexpected<Error> none_on_hosts(const AppSpec& app, const Platform& platform,
                                    const keys::Answer& answer) {
  return fail(ErrorCode::kInfeasible,
              answer.outcome == keys::Outcome::kUnsustainable
                  ? "no policy keeps up: " + answer.overload.text
                  : "neither a policy that keeps up was found in this time, nor a proof that "
                    "there is none",
              app.name + " on " + platform.name,
              "give it more time (--time-limit), pin modules to hosts, or give it less work");
}

/// What the solver says of it is false, a bug of ours; and a robot has to run all the same.
tl::unexpected<Error> write_unclaimed(const Apps& apps, const Platform& platform, Policy& policy,
                                      const Error& lie, const std::vector<std::string>& out,
                                      Outputs& outputs) {
  policy.certified = false;
  policy.chains.clear();
  write_policies(apps, platform, policy, out, outputs, false);
  return fail(ErrorCode::kInternal,
              "the solver's answer does not pass the check: " + lie.to_string(),
              apps.all.name + " on " + platform.name,
              std::string("report it with app and platform") +
                  (out.empty() ? "" : "; what was written claims nothing"));
}

}  // namespace

Result<int> solve_policy(const Apps& apps, const Platform& platform, const keys::Options& asked,
                         const std::vector<std::string>& assume, const SolveOut& out,
                         const Options& options) {
  const AppSpec& app = apps.all;
  XAUTO_TRY(known_on_hosts(platform, asked, assume));
  if (asked.method == "heft" || asked.method == "local")
    return solve_baseline(app, platform, asked, out.policies.empty() ? "" : out.policies.front(),
                          options);
  Outputs outputs;
  for (const std::string& path : out.policies) XAUTO_TRY(outputs.expect("--out", path));
  XAUTO_TRY(outputs.expect("--demand-out", out.demand));
  SearchLine line;
  keys::Options solving = asked;
  solving.on_progress = [&](const keys::Progress& progress) { show(line, progress); };
  auto solved = keys::solve(app, platform, solving);
  line.end();
  if (!solved) return tl::unexpected<Error>(std::move(solved).error());
  keys::Answer& answer = *solved;
  if (answer.outcome != keys::Outcome::kPolicy && !asked.beside.nobody())
    return does_not_fit(app, platform, asked, answer);
  if (answer.outcome != keys::Outcome::kPolicy && !platform.hosts.empty())
    return none_on_hosts(app, platform, answer);
  if (answer.outcome != keys::Outcome::kPolicy)
    return solve_uncertified(apps, platform, answer, asked, assume, out.policies, outputs, options);
  claim_bounds_alone(apps, platform, asked, answer.policy);
  // No worst case is told that code of its own does not derive again.
  const auto checked = keys::check(app, platform, answer.policy, asked.beside);
  if (!checked && checked.error().code == ErrorCode::kUnavailable)  // nobody could check it
    return tl::unexpected<Error>(checked.error());
  if (!checked)
    return write_unclaimed(apps, platform, answer.policy, checked.error(), out.policies, outputs);
  XAUTO_ASSIGN(const std::vector<keys::WhatIf> ifs,
               ask_assumed(app, platform, answer.policy, assume, asked));
  const bool late = misses_a_deadline(answer.policy, app);
  const bool never = app.has_deadlines() && answer.bounds.largest > 1;
  const std::vector<RareWcet> rare = rare_in(app, platform, answer.policy, *checked);
  if (options.json) {
    Json root = json_of(apps, platform, answer.policy);
    root["evaluations"] = answer.evaluations;
    root["first_answer_us"] = std::llround(answer.first_answer_ms * 1e3);
    root["proofs"] = proofs(*checked);
    root["taken"] = checked->taken;
    root["objective"] = objective_of(app, answer, asked.aim);
    if (asked.hint != nullptr) root["moved"] = moved(app, platform, *asked.hint, answer);
    if (!ifs.empty()) root["what_if"] = cases_of(app, ifs);
    root["deadlines"] = never  ? "proven impossible"
                        : late ? "missed; not proven impossible"
                               : "met";
    if (!rare.empty()) root["rare_wcets"] = to_json(rare, app);
    std::cout << root.dump(2) << "\n";
  } else {
    std::cout << fmt::format("{} on {}: {}, {:.2f} s{}\n\n", app.name, platform.name, shape(app),
                             static_cast<double>(answer.policy.solve_us) / 1e6,
                             asked.stop != nullptr && asked.stop->load()
                                 ? " (interrupted: best so far)"
                                 : "")
              << proof_table(platform, answer.policy, *checked) << "\n"
              << chain_table(app, answer.policy) << of_all_chains(app, answer, asked.aim)
              << fmt::format(
                     "\n  worst case: {}.\n  The check has derived these worst cases again. Lower "
                     "bounds are the solver's alone: of no policy of keys that\n  keeps to the "
                     "pins, forbids and groups can a shorter worst case be certified this way.\n",
                     scope(apps, !asked.beside.demands.empty()))
              << crossings_text(app, platform, answer.policy)
              << (asked.beside.nobody() ? "" : "  Proven " + name_of_all(asked.beside) + ".\n")
              << counted_loads(app, platform, answer.policy) << held_line(app, answer.policy)
              << not_measured(app, platform, answer.policy, *checked) << urgency(app);
    if (asked.hint != nullptr) std::cout << moved_line(app, platform, *asked.hint, answer);
    std::cout << what_if_table(app, answer.policy, ifs, assumed_s(asked));
    if (late)
      std::cout
          << (never ? "\n  A deadline is missed, and of no policy of keys can all be certified: "
                      "proven, by lower bounds.\n"
                    : "\n  A deadline is missed. That no policy meets it is not proven.\n");
    std::cout << words_of(rare, app);
  }
  std::cout.flush();
  // First: a policy that plans XPUs apart has none, and then nothing is written.
  XAUTO_TRY(write_demand(app, platform, answer.policy, out.demand, outputs));
  write_policies(apps, platform, answer.policy, out.policies, outputs, !options.json);
  return outputs.status(late ? kAnswerIsNo : kDone);
}

/// The whole ways of chains' worst paths. The check names where one enters and leaves each component;
/// inside one it is whichever predecessor has its key last, since that is what the next waits for.
class WholePaths {
 public:
  WholePaths(const AppSpec& app, const Platform& platform, const Policy& policy)
      : succ_(app.successors()),
        into_(app.xnodes.size()),
        of_source_(app.sources.size()),
        reached_(app.xnodes.size(), 0) {
    for (std::size_t i = 0; i < app.xnodes.size(); ++i) {
      number_[app.xnodes[i].name] = static_cast<int>(i);
      for (const int source : app.xnodes[i].sources)
        of_source_[at(source)].push_back(static_cast<int>(i));
    }
    const std::vector<std::int64_t> transfer_us = transfers_us(policy, app, platform);
    for (std::size_t e = 0; e < app.edges.size(); ++e) {
      const auto [u, v] = app.edges[e];
      const auto& keys = policy.placements[at(u)].key_us;
      into_[at(v)].push_back({u, *std::max_element(keys.begin(), keys.end()) + transfer_us[e]});
    }
  }

  /// `path`: source, then first and last XNode of each component.
  [[nodiscard]] std::vector<int> of(const ChainSpec& chain, const std::vector<std::string>& path) {
    std::vector<int> whole;
    for (std::size_t k = 1; k + 1 < path.size(); k += 2) {
      std::vector<int> seen = k > 1 ? std::vector{number_.at(path[k])} : of_source_[at(chain.from)];
      for (const int i : seen) reached_[at(i)] = 1;
      for (std::size_t n = 0; n < seen.size(); ++n)
        for (const int v : succ_[at(seen[n])])
          if (!std::exchange(reached_[at(v)], 1)) seen.push_back(v);
      std::vector<int> back;
      for (int x = number_.at(path[k + 1]); x >= 0;) {
        back.push_back(x);
        std::int64_t last = -1;
        int next = -1;
        for (const Ready& ready : into_[at(x)])
          if (reached_[at(ready.after)] && ready.us > last) last = ready.us, next = ready.after;
        x = next;
      }
      for (const int i : seen) reached_[at(i)] = 0;
      whole.insert(whole.end(), back.rbegin(), back.rend());
    }
    return whole;
  }

 private:
  struct Ready {
    int after;  ///< its predecessor
    std::int64_t us;
  };

  std::vector<std::vector<int>> succ_;
  std::vector<std::vector<Ready>> into_;     ///< [XNode]
  std::vector<std::vector<int>> of_source_;  ///< [source] XNodes that it releases
  std::unordered_map<std::string, int> number_;
  std::vector<char> reached_;  ///< [XNode] all 0 between two chains
};

/// Of chain `c` of the report: source, then every XNode on its worst path.
std::vector<std::string> names_on_path(const AppSpec& app, const std::vector<int>& whole,
                                       std::size_t c) {
  std::vector<std::string> list = {app.sources[at(app.chains[c].from)].name};
  for (const int i : whole) list.push_back(app.xnodes[at(i)].name);
  return list;
}

/// The same for people; where it goes to another host, with that host and X.
std::string way_text(const AppSpec& app, const Platform& platform, const Policy& policy,
                     const std::vector<int>& whole, std::size_t c) {
  const std::vector<int> host = hosts_of(app, platform, policy);
  std::string text = app.sources[at(app.chains[c].from)].name;
  for (std::size_t k = 0; k < whole.size(); ++k) {
    text += " > " + app.xnodes[at(whole[k])].name;
    if (k == 0 || host[at(whole[k - 1])] == host[at(whole[k])]) continue;
    const int to = host[at(whole[k])];
    for (const Crossing& crossing : policy.crossings)
      if (crossing.from == whole[k - 1] && crossing.host == to)
        text += fmt::format(" (on {}, X {})", platform.hosts[at(to)].name, ms(crossing.x_us));
  }
  return text;
}

constexpr double kPartOfHolds = 0.25;  ///< of the time for moves and holds

Result<int> explain_policy(const AppSpec& app, const Platform& platform, const std::string& path,
                           const std::string& picture, double moves_s, const Options& options) {
  Outputs outputs;
  XAUTO_TRY(outputs.expect("--windows", picture));
  XAUTO_ASSIGN(const Policy policy, load_policy(path, app, platform));
  if (policy.by_priority())
    return fail(ErrorCode::kInvalid, "has priorities: nothing is planned or claimed by them", path,
                "`xauto simulate`, and `xauto explain --trace` of a run, show what happens");
  XAUTO_ASSIGN(const keys::CheckReport report, keys::check(app, platform, policy));
  // The chain that is worst off: in parts of its deadline, or else the longest.
  std::size_t worst = 0;
  double most = -1;
  for (std::size_t c = 0; c < report.chains.size(); ++c) {
    const keys::ChainProof& chain = report.chains[c];
    const double part = static_cast<double>(chain.derived_us) /
                        (chain.deadline_us ? static_cast<double>(*chain.deadline_us) : 1e15);
    if (part > most) worst = c;
    most = std::max(most, part);
  }
  std::vector<std::vector<int>> ways;  // [chain]
  WholePaths whole(app, platform, policy);
  for (std::size_t c = 0; c < report.chains.size(); ++c)
    ways.push_back(whole.of(app.chains[c], report.chains[c].path));
  const std::vector<int> on_path = ways.empty() ? std::vector<int>() : ways[worst];
  // Beside them, what stands in the tightest window of an XPU.
  std::vector<int> to_move = on_path;
  for (const keys::XpuProof& proof : report.xpus)
    if (const int i = app.find(proof.xnode);
        i >= 0 && std::find(to_move.begin(), to_move.end(), i) == to_move.end())
      to_move.push_back(i);
  const Holds holds = holds_of(app, platform, policy, report, moves_s * kPartOfHolds);
  keys::Options asked;
  asked.time_limit_s = moves_s * (1 - kPartOfHolds);
  asked.threads = 2;
  XAUTO_ASSIGN(const keys::Moves moved, keys::moves(app, platform, policy, to_move, asked));
  const auto names = [&](std::size_t c) { return names_on_path(app, ways[c], c); };
  if (options.json) {
    Json root = {{"schema", "xauto.explanation"}, {"version", 2}, {"proofs", proofs(report)}};
    for (std::size_t c = 0; c < report.chains.size(); ++c)
      root["chains"].push_back({{"name", report.chains[c].name},
                                {"worst_case_us", report.chains[c].derived_us},
                                {"path", names(c)}});
    root["holds"] = holds_json(app, holds);
    root["holds_untried"] = holds.untried;
    root["moves"] = cases_of(app, moved.tried);
    root["moves_untried"] = moved.untried;
    std::cout << root.dump(2) << "\n";
  } else {
    std::cout << proof_table(platform, policy, report) << "\n";
    for (std::size_t c = 0; c < report.chains.size(); ++c)
      std::cout << wrapped(fmt::format("  {}: {}, along {}", report.chains[c].name,
                                       ms(report.chains[c].derived_us),
                                       way_text(app, platform, policy, ways[c], c)),
                           4)
                << "\n";
    std::cout << crossings_text(app, platform, policy) << holds_text(app, policy, holds);
    if (!report.chains.empty())
      std::cout << fmt::format(
                       "\n  The worst off is {}. Its XNodes elsewhere, and those of the tightest "
                       "windows, all others where they are:",
                       report.chains[worst].name)
                << what_if_table(app, policy, moved.tried, moved.each_s);
    if (moved.untried > 0)
      std::cout << fmt::format("\n  {} more were not tried in {:g} s (--time-limit).\n",
                               moved.untried, moves_s);
  }
  std::cout.flush();
  if (!picture.empty()) outputs.write(picture, windows_svg(app, platform, policy, report));
  return outputs.status(kDone);
}

/// Of a policy that is not certified.
Result<int> check_places(const AppSpec& app, const Platform& platform, const Policy& policy,
                         const std::string& path, const std::vector<std::string>& broken,
                         const Options& options) {
  const Status stated = keys::check_places(app, platform, policy);
  if (!stated && stated.error().code != ErrorCode::kInfeasible)
    return tl::unexpected<Error>(stated.error());
  const int status = stated && broken.empty() ? kDone : kAnswerIsNo;
  if (options.json) {
    Json root = {{"schema", "xauto.check"},
                 {"version", 2},
                 {"truthful", stated.has_value()},
                 {"certified", false},
                 {"lies", Json::array()},
                 {"taken", Json::array()},
                 {"missed", broken},
                 {"proofs", Json::array()},
                 {"chains", Json::array()}};
    if (!stated) root["lies"].push_back(stated.error().to_string());
    std::cout << root.dump(2) << "\n";
  } else if (!stated) {
    std::cout << "  LIE    " << stated.error().to_string() << "\n" << words_of_lies(path, 1);
  } else {
    for (const std::string& wish : broken) std::cout << "  MISSED " << wish << "\n";
    std::cout
        << fmt::format(
               "  shown: it is for this app, each of {} XNodes is where it has an "
               "implementation, and {} pairs of order leave a way through\n\n"
               "{} states nothing false. It is not certified: nothing is claimed of any time.\n",
               app.xnodes.size(), policy.order.size(), path)
        << words_of_missed(broken);
  }
  return status;
}

namespace {

/// Each chain with what was derived, what is claimed, and its worst path.
void show_chains(const keys::CheckReport& report, const std::vector<std::string>& ways) {
  if (!report.chains.empty())
    std::cout << "\n"
              << row_of("chain", kNameColumns)
              << fmt::format("{:>11}{:>11}\n", "derived", "claimed");
  for (std::size_t c = 0; c < report.chains.size(); ++c) {
    const keys::ChainProof& chain = report.chains[c];
    std::cout << row_of(chain.name, kNameColumns)
              << fmt::format("{:>11}{:>11}{}\n", ms(chain.derived_us), ms(chain.claimed_us),
                             chain.late() ? "   MISSED" : "");
    if (chain.urgent_us)
      std::cout << row_of("  urgent", kNameColumns)
                << fmt::format("{:>11}{:>11}\n", ms(*chain.urgent_us),
                               ms(chain.claimed_urgent_us.value_or(0)));
    std::cout << wrapped("    along " + ways[c], 6) << "\n";
  }
}

/// `report` is of the policy alone. Whether it holds beside others, too: then it is of that, else what fails is missed.
Result<bool> examine_beside(const AppSpec& app, const Platform& platform, const Policy& policy,
                            const Beside& beside, keys::CheckReport& report,
                            std::vector<std::string>& missed) {
  if (beside.nobody() || !report.lies.empty()) return report.lies.empty();
  XAUTO_ASSIGN(keys::CheckReport with, keys::examine(app, platform, policy, beside));
  for (const Error& lie : with.lies)
    missed.push_back(name_of_all(beside) + ": " + lie.where + ": " + lie.what);
  if (!with.lies.empty()) return false;
  report = std::move(with);
  return true;
}

}  // namespace

Result<int> check_policy(const Apps& apps, const Platform& platform,
                         const std::vector<std::string>& paths, const solver::Objectives& asked,
                         const BesideFlags& others, const std::string& demand,
                         const Options& options) {
  const AppSpec& app = apps.all;
  const std::string path = fmt::format("{}", fmt::join(paths, ", "));
  XAUTO_ASSIGN(const Policy policy, load_policies(apps, paths, platform));
  XAUTO_ASSIGN(std::vector<std::string> broken, broken_wishes(app, platform, policy, asked));
  XAUTO_ASSIGN(const Beside beside, load_beside(others, platform));
  Outputs outputs;
  XAUTO_TRY(outputs.expect("--demand-out", demand));
  if (!policy.certified && (!beside.nobody() || !demand.empty()))
    return fail(ErrorCode::kInvalid, "is not certified: nothing bounds what it asks of an XPU",
                path, "leave --beside, --reserve and --demand-out out");
  if (!policy.certified) return check_places(app, platform, policy, path, broken, options);
  XAUTO_ASSIGN(keys::CheckReport report, keys::examine(app, platform, policy));
  XAUTO_ASSIGN(const bool fits, examine_beside(app, platform, policy, beside, report, broken));
  for (const std::string& file : others.demands)
    if (fits) report.taken.push_back(file + ": that the apps which it is of ask for no more");
  std::vector<std::string> lies;
  for (const Error& lie : report.lies) lies.push_back(lie.to_string());
  std::vector<std::string> missed = broken;
  for (const keys::ChainProof& chain : report.chains)
    if (chain.late())
      missed.push_back(fmt::format("chain '{}': {} of {}", chain.name, ms(chain.derived_us),
                                   ms(*chain.deadline_us)));
  const int status = lies.empty() && missed.empty() ? kDone : kAnswerIsNo;
  std::vector<std::vector<int>> ways;  // [chain]
  std::vector<std::string> texts;
  WholePaths whole(app, platform, policy);
  for (std::size_t c = 0; c < report.chains.size(); ++c) {
    ways.push_back(whole.of(app.chains[c], report.chains[c].path));
    texts.push_back(way_text(app, platform, policy, ways[c], c));
  }
  if (options.json) {
    Json root = {{"schema", "xauto.check"},  {"version", 2},
                 {"truthful", lies.empty()}, {"lies", lies},
                 {"missed", missed},         {"taken", report.taken},
                 {"proofs", proofs(report)}, {"chains", Json::array()}};
    for (std::size_t c = 0; c < report.chains.size(); ++c) {
      const keys::ChainProof& chain = report.chains[c];
      Json j = {{"name", chain.name},
                {"worst_case_us", chain.derived_us},
                {"claimed_us", chain.claimed_us},
                {"own_bound_us", chain.own_bound_us},
                {"claimed_bound_us", chain.claimed_bound_us},
                {"late", chain.late()},
                {"path", names_on_path(app, ways[c], c)}};
      if (chain.urgent_us) {
        j["urgent_worst_case_us"] = *chain.urgent_us;
        j["claimed_urgent_us"] = chain.claimed_urgent_us.value_or(0);
      }
      root["chains"].push_back(std::move(j));
    }
    std::cout << root.dump(2) << "\n";
    if (lies.empty()) XAUTO_TRY(write_demand(app, platform, policy, demand, outputs));
    return outputs.status(status);
  }
  for (const std::string& lie : lies) std::cout << wrapped("  LIE    " + lie, 9) << "\n";
  if (!report.windows.empty())
    std::cout << (lies.empty() ? "" : "\n") << proof_table(platform, policy, report);
  show_chains(report, texts);
  std::cout << crossings_text(app, platform, policy);
  for (const std::string& wish : broken) std::cout << wrapped("  MISSED " + wish, 9) << "\n";
  if (lies.empty()) std::cout << counted_loads(app, platform, policy);
  for (const std::string& taken : report.taken)
    std::cout << wrapped("  taken  " + taken, 9) << "\n";
  std::cout << (lies.empty()
                    ? fmt::format(
                          "\n{} {} the truth{}{}: {}.\n", path, apps.several() ? "tell" : "tells",
                          beside.nobody() || !fits ? "" : ", ", fits ? name_of_all(beside) : "",
                          scope(apps, fits && !beside.demands.empty()))
                    : words_of_lies(path, lies.size()))
            << words_of_missed(missed);
  if (lies.empty()) XAUTO_TRY(write_demand(app, platform, policy, demand, outputs));
  return outputs.status(status);
}

namespace {

std::string worst_of(const std::optional<std::int64_t>& claimed_us) {
  return claimed_us ? exact_ms(*claimed_us) : "-";
}

/// A row of the table and an element of `xnodes`.
std::string tell_played(const AppSpec& app, const Platform& platform, const Policy& policy,
                        const keys::PlayReport& played, Json& xnodes) {
  const std::size_t name = xpu_columns(platform);
  std::string table =
      row_of("XNode", 24) + left("XPU", name) +
      fmt::format("{:>9}{:>8}{:>11}{:>18}\n", "jobs", "late", "suspended", "nearest its key");
  for (std::size_t i = 0; i < played.xnodes.size(); ++i) {
    const keys::PlayedXNode& node = played.xnodes[i];
    const std::string& xpu = platform.xpus[static_cast<std::size_t>(policy.placements[i].xpu)].id;
    const bool near = node.jobs > 0 && !policy.by_priority();  // a priority is no time
    xnodes.push_back({{"name", app.xnodes[i].name},
                      {"xpu", xpu},
                      {"jobs", node.jobs},
                      {"late", node.late},
                      {"suspended", node.suspended},
                      {"closest_us", near ? Json(node.closest_us) : Json()}});
    table += row_of(app.xnodes[i].name, 24) + left(xpu, name) +
             fmt::format("{:>9}{:>8}{:>11}{:>18}\n", node.jobs, node.late, node.suspended,
                         near ? ms_of(node.closest_us) : "-");
  }
  return table;
}

/// Likewise of `chains`.
std::string tell_chains(const keys::PlayReport& played, Json& chains) {
  std::string table =
      row_of("chain", 17) + fmt::format("{:>13}{:>13}{:>14}{:>12}{:>9}\n", "median", "99 %",
                                        "longest seen", "worst case", "releases");
  for (const keys::PlayedChain& chain : played.chains) {
    Json entry = {{"name", chain.name},
                  {"median_us", chain.median_us},
                  {"p99_us", chain.p99_us},
                  {"longest_us", chain.longest_us},
                  {"releases", chain.releases}};
    if (chain.claimed_us) entry["worst_case_us"] = *chain.claimed_us;
    const auto seen = [&](double us) { return chain.releases > 0 ? ms_of(us) : "-"; };
    table += row_of(chain.name, 17) + fmt::format("{:>13}{:>13}{:>14}{:>12}{:>9}\n",
                                                  seen(chain.median_us), seen(chain.p99_us),
                                                  seen(chain.longest_us),
                                                  worst_of(chain.claimed_us), chain.releases);
    if (chain.urgent > 0) {
      Json urgent = {{"longest_us", chain.longest_urgent_us}, {"releases", chain.urgent}};
      if (chain.claimed_urgent_us) urgent["worst_case_us"] = *chain.claimed_urgent_us;
      entry["urgent"] = std::move(urgent);
      table +=
          fmt::format("  {:<43}{:>14}{:>12}{:>9}\n", "  urgent", ms_of(chain.longest_urgent_us),
                      worst_of(chain.claimed_urgent_us), chain.urgent);
    }
    chains.push_back(std::move(entry));
  }
  return table;
}

}  // namespace

Result<int> simulate_policy(const Apps& apps, const Platform& platform,
                            const std::vector<std::string>& paths, const keys::PlayOptions& asked,
                            const std::string& out, const Options& options) {
  const AppSpec& app = apps.all;
  XAUTO_ASSIGN(const Policy policy, load_policies(apps, paths, platform));
  Outputs outputs;
  XAUTO_TRY(outputs.expect("--out", out));
  keys::PlayOptions play = asked;
  if (apps.several()) play.app_of = apps_of_xnodes(apps.each);
  XAUTO_ASSIGN(const keys::PlayReport played, keys::play(app, platform, policy, play));
  Json xnodes = Json::array(), chains = Json::array();
  std::string table = tell_played(app, platform, policy, played, xnodes);
  table += "\n" + tell_chains(played, chains);
  const bool exceeded = std::any_of(played.chains.begin(), played.chains.end(),
                                    [](const keys::PlayedChain& c) { return c.exceeded(); });
  table +=
      fmt::format("\n  {} on {}: {} jobs in {} s, {} late, {} times one was suspended\n", app.name,
                  platform.name, played.jobs, asked.seconds, played.late, played.suspended);
  if (!policy.certified)
    table +=
        policy.by_priority()
            ? "  nothing is claimed: the policy has priorities\n"
            : "  nothing is claimed: the policy is not certified, and its keys only say who goes "
              "first\n";
  else if (!played.first_late.empty())
    table += "  " + played.first_late + "\n";
  if (played.backlog) table += "  the backlog grew: this policy does not keep up\n";
  Json told = {{"schema", "xauto.simulation"},
               {"version", 2},
               {"app", app.name},
               {"platform", platform.name},
               {"duration_us", asked.seconds * 1'000'000},
               {"seed", asked.seed},
               {"jobs", played.jobs},
               {"late", played.late},
               {"suspended", played.suspended},
               {"backlog", played.backlog},
               {"xnodes", std::move(xnodes)},
               {"chains", std::move(chains)}};
  if (!policy.certified) told["certified"] = false;
  const std::string result = told.dump(2) + "\n";
  std::cout << (options.json ? result : table);
  outputs.write(out, result);
  const bool late = policy.certified && played.late > 0;
  return outputs.status(exceeded || late || played.backlog ? kAnswerIsNo : kDone);
}

}  // namespace xauto::cli
