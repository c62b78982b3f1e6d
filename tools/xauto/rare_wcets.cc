// SPDX-License-Identifier: Apache-2.0
#include "xauto/rare_wcets.h"

#include <algorithm>
#include <set>

#include <fmt/format.h>

#include "base/index.h"
#include "solver/keys/sustain.h"

#include "xauto/command.h"

namespace xauto::cli {
namespace {

constexpr std::size_t kNamed = 8;          ///< in words; JSON has all
constexpr std::int64_t kPartOfWorst = 10;  ///< one of so many parts of a worst case is much

}  // namespace

std::vector<RareWcet> rare_wcets(
    const AppSpec& app, const std::function<bool(int xnode, const std::string& type)>& counts) {
  std::vector<RareWcet> rare;
  for (std::size_t i = 0; i < app.xnodes.size(); ++i)
    for (const auto& [type, typical] : app.xnodes[i].typical_us) {
      const std::int64_t wcet = app.xnodes[i].wcet_on(type).value_or(0);
      if (wcet > 2 * typical && counts(static_cast<int>(i), type))
        rare.push_back({static_cast<int>(i), type, wcet, typical});
    }
  std::stable_sort(rare.begin(), rare.end(), [](const RareWcet& a, const RareWcet& b) {
    return a.wcet_us - a.typical_us > b.wcet_us - b.typical_us;
  });
  return rare;
}

std::vector<RareWcet> rare_in_overload(const AppSpec& app, const Platform& platform,
                                       const solver::Objectives& wishes) {
  const std::vector<std::string> types = platform.types();
  std::vector<RareWcet> rare = rare_wcets(app, [&](int, const std::string& type) {
    return std::find(types.begin(), types.end(), type) != types.end();
  });
  AppSpec usual = app;
  for (const RareWcet& r : rare) usual.xnodes[at(r.xnode)].wcet_us[r.type] = r.typical_us;
  const auto problem = solver::keys::Problem::create(usual, platform, wishes);
  if (!problem || solver::keys::prove_overload(*problem)) rare.clear();
  return rare;
}

std::vector<RareWcet> rare_in_policy(const AppSpec& app, const Platform& platform,
                                     const std::vector<int>& xpu, const std::vector<Way>& ways) {
  const auto type_of = [&](int i) -> const std::string& {
    return platform.xpus[at(xpu[at(i)])].type;
  };
  std::set<int> decide, late_on;
  for (const Way& way : ways)
    for (const int i : way.xnodes) {
      const auto& usual = app.xnodes[at(i)].typical_us;
      const auto typical = usual.find(type_of(i));
      if (way.late) late_on.insert(xpu[at(i)]);
      if (way.late ||
          (typical != usual.end() &&
           (app.xnodes[at(i)].wcet_on(type_of(i)).value_or(0) - typical->second) * kPartOfWorst >
               way.worst_case_us))
        decide.insert(i);
    }
  return rare_wcets(app, [&](int i, const std::string& type) {
    return type == type_of(i) && (decide.contains(i) || late_on.contains(xpu[at(i)]));
  });
}

std::string words_of(const std::vector<RareWcet>& rare, const AppSpec& app, bool decide) {
  if (rare.empty()) return "";
  std::string out = fmt::format("\n  WCETs above twice what is usual {} this:\n",
                                decide ? "decide" : "may decide");
  for (std::size_t k = 0; k < std::min(kNamed, rare.size()); ++k)
    out += fmt::format("  {:<24}{:<8}{:>14}, usually {}\n", app.xnodes[at(rare[k].xnode)].name,
                       rare[k].type, ms(rare[k].wcet_us), ms(rare[k].typical_us));
  if (rare.size() > kNamed) out += fmt::format("  and {} more\n", rare.size() - kNamed);
  return out +
         "  Are they outliers of a profile? Measure again (profile --stable), or take --from "
         "p99.\n";
}

Json to_json(const std::vector<RareWcet>& rare, const AppSpec& app) {
  Json list = Json::array();
  for (const RareWcet& r : rare)
    list.push_back({{"xnode", app.xnodes[at(r.xnode)].name},
                    {"type", r.type},
                    {"wcet_us", r.wcet_us},
                    {"typical_us", r.typical_us}});
  return list;
}

}  // namespace xauto::cli
