// SPDX-License-Identifier: Apache-2.0
#include "xauto/held.h"

#include <algorithm>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "base/clock.h"
#include "base/columns.h"
#include "base/index.h"
#include "solver/keys/play.h"
#include "solver/keys/uncertified.h"

#include "xauto/command.h"

namespace xauto::cli {
namespace {

namespace keys = solver::keys;

constexpr std::int64_t kWorthTellingPct = 1;  ///< of a median
constexpr std::size_t kShown = 3;             ///< chains of a list

std::int64_t longest_hold(const Placement& placement) {
  const auto& holds = placement.hold_us;
  return holds.empty() ? 0 : *std::max_element(holds.begin(), holds.end());
}

/// The longest first.
std::vector<Held> held_in(const Policy& policy) {
  std::vector<Held> list;
  for (std::size_t i = 0; i < policy.placements.size(); ++i)
    if (const std::int64_t longest = longest_hold(policy.placements[i]); longest > 0)
      list.push_back({static_cast<int>(i), longest, false, {}, {}, {}});
  std::ranges::stable_sort(list, std::greater<>(), &Held::longest_us);
  return list;
}

/// What was predicted is no longer.
Policy without_holds(Policy policy, int xnode) {
  policy.placements[at(xnode)].hold_us.clear();
  for (Placement& placement : policy.placements)
    placement.start_us.clear(), placement.finish_us.clear();
  return policy;
}

void most_first(std::vector<Differs>& list) {
  std::ranges::stable_sort(list, std::greater<>(), [](const Differs& one) {
    return std::abs(one.with_us - one.without_us);
  });
}

/// Medians by chain; empty: it cannot be played.
std::vector<std::int64_t> medians_of(const AppSpec& usual, const Platform& platform,
                                     Policy policy) {
  policy.app_hash = usual.hash();
  keys::PlayOptions options;
  options.seconds = kPlayedS;
  options.phases = true;
  std::vector<std::int64_t> medians;
  if (const auto played = keys::play(usual, platform, policy, options))
    for (const keys::PlayedChain& chain : played->chains)
      medians.push_back(static_cast<std::int64_t>(chain.median_us));
  return medians;
}

/// What is asked for is what a hold may be for: what has a deadline, or counts in the sum.
void compare_claims(const AppSpec& app, const keys::CheckReport& with,
                    const keys::CheckReport& without, Held& held) {
  for (const keys::XpuProof& proof : without.xpus)
    if (proof.kind.empty()) held.refused.push_back(proof.xpu);
  held.derived = !held.refused.empty() || without.chains.size() == with.chains.size();
  if (!held.refused.empty() || !held.derived) return;
  for (std::size_t c = 0; c < with.chains.size(); ++c) {
    const std::int64_t now = with.chains[c].derived_us, then = without.chains[c].derived_us;
    const ChainSpec& chain = app.chains[c];
    if (then > now && (chain.deadline_us || chain.weight > 0 || !app.has_deadlines()))
      held.longer.push_back({c, now, then});
  }
  most_first(held.longer);
}

std::string list_of(const AppSpec& app, const std::vector<Differs>& list) {
  std::string text;
  for (std::size_t i = 0; i < std::min(list.size(), kShown); ++i)
    text += fmt::format("{}{} {}, else {}", i == 0 ? "" : "; ", app.chains[list[i].chain].name,
                        ms(list[i].with_us), ms(list[i].without_us));
  if (list.size() > kShown) text += fmt::format("; {} more", list.size() - kShown);
  return text;
}

Json json_of(const AppSpec& app, const std::vector<Differs>& list) {
  Json json = Json::array();
  for (const Differs& one : list)
    json.push_back({{"name", app.chains[one.chain].name},
                    {"with_us", one.with_us},
                    {"without_us", one.without_us}});
  return json;
}

}  // namespace

Holds holds_of(const AppSpec& app, const Platform& platform, const Policy& policy,
               const keys::CheckReport& report, double limit_s) {
  Holds holds{held_in(policy), 0};
  if (holds.list.empty()) return holds;
  const std::int64_t end_ns = now_ns() + static_cast<std::int64_t>(limit_s * 1e9);
  const AppSpec usual = keys::at_usual_times(app);
  std::vector<std::int64_t> now;
  std::size_t tried = 0;
  for (; tried < holds.list.size() && now_ns() < end_ns; ++tried) {
    if (tried == 0) now = medians_of(usual, platform, policy);
    Held& held = holds.list[tried];
    const Policy without = without_holds(policy, held.xnode);
    if (const auto derived = keys::examine(app, platform, without))
      compare_claims(app, report, *derived, held);
    const std::vector<std::int64_t> medians = medians_of(usual, platform, without);
    for (std::size_t c = 0; c < std::min(now.size(), medians.size()); ++c)
      if ((now[c] - medians[c]) * 100 >= now[c] * kWorthTellingPct && now[c] > medians[c])
        held.sooner.push_back({c, now[c], medians[c]});
    most_first(held.sooner);
  }
  holds.untried = static_cast<int>(holds.list.size() - tried);
  holds.list.resize(tried);
  return holds;
}

std::string held_line(const AppSpec& app, const Policy& policy) {
  std::string names;
  std::size_t number = 0;
  for (const Held& held : held_in(policy)) {
    if (++number > kShown) continue;
    names += fmt::format("{}{} up to {}", number == 1 ? "" : ", ", app.xnodes[at(held.xnode)].name,
                         ms(held.longest_us));
  }
  if (number == 0) return "";
  if (number > kShown) names += fmt::format(", {} more", number - kShown);
  return wrapped(
             "  held   " + names +
                 " (`xauto explain` says for which claims, and what that costs on an ordinary day)",
             9) +
         "\n";
}

std::string holds_text(const AppSpec& app, const Policy& policy, const Holds& holds) {
  if (holds.list.empty() && holds.untried == 0) return "";
  std::string text = fmt::format(
      "\n  Held, and for which claims (derived by the check); what that costs on an ordinary day\n"
      "  (medians, played for {} s at usual times, where each XNode is held as now, or not)\n",
      kPlayedS);
  for (const Held& held : holds.list) {
    const Placement& placement = policy.placements[at(held.xnode)];
    std::string why = fmt::format("up to {}", ms(held.longest_us));
    if (const auto n =
            std::ranges::count_if(placement.hold_us, [](std::int64_t us) { return us > 0; });
        n < static_cast<std::ptrdiff_t>(placement.hold_us.size()))
      why += fmt::format(", {} of {} jobs", n, placement.hold_us.size());
    if (!held.derived)
      why += ": the check derives nothing without it";
    else if (!held.refused.empty())
      why += fmt::format(", for the keys on {}", fmt::join(held.refused, ", "));
    else
      why += held.longer.empty() ? ": nothing needs it" : ", for " + list_of(app, held.longer);
    if (!held.sooner.empty()) why += ". Medians: " + list_of(app, held.sooner);
    text += wrapped(row_of(app.xnodes[at(held.xnode)].name, 24) + why, 26) + "\n";
  }
  if (holds.untried > 0)
    text += fmt::format("  {} more holds had no turn (--time-limit).\n", holds.untried);
  return text;
}

Json holds_json(const AppSpec& app, const Holds& holds) {
  Json list = Json::array();
  for (const Held& held : holds.list) {
    Json json = {{"xnode", app.xnodes[at(held.xnode)].name},
                 {"longest_us", held.longest_us},
                 {"worst_cases", json_of(app, held.longer)},
                 {"medians", json_of(app, held.sooner)}};
    for (const std::string& xpu : held.refused) json["keys_on"].push_back(xpu);
    list.push_back(std::move(json));
  }
  return list;
}

}  // namespace xauto::cli
