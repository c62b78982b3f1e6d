// SPDX-License-Identifier: Apache-2.0
#include "model/scenario.h"

#include <algorithm>
#include <map>
#include <set>

#include "model/contention.h"
#include "model/loss.h"

namespace xauto {
namespace {

Status valid_scale(const Scenario& s, const std::vector<std::string>& types,
                   const std::string& at) {
  for (const auto& [type, pct] : s.wcet_scale_pct) {
    if (std::find(types.begin(), types.end(), type) == types.end())
      return fail(ErrorCode::kInvalid, "the platform has no XPU of type '" + type + "'",
                  at + "/wcet_scale_pct/" + type);
    if (pct < 1 || pct > kMaxScalePct)
      return fail(
          ErrorCode::kInvalid,
          std::to_string(pct) + " is not a percentage from 1 to " + std::to_string(kMaxScalePct),
          at + "/wcet_scale_pct/" + type);
  }
  return {};
}

using Wcets = std::map<std::string, std::int64_t, std::less<>>;  ///< by XPU type

/// Of `has`, what `stated` gives other WCETs.
Status valid_wcets(const Wcets& stated, const Wcets& has, const std::string& whose,
                   const std::string& where) {
  for (const auto& [type, us] : stated) {
    if (!has.contains(type))
      return fail(ErrorCode::kInvalid, whose + " has no implementation on '" + type + "'",
                  where + "/" + type);
    if (us < 1 || us > kMaxTimeUs)
      return fail(
          ErrorCode::kInvalid,
          std::to_string(us) + " is not a WCET from 1 to " + std::to_string(kMaxTimeUs) + " us",
          where + "/" + type);
  }
  return {};
}

Status valid_wcets(const Scenario& s, const AppSpec& app, const std::string& at) {
  const auto xnode = [&](const std::string& name,
                         const std::string& where) -> Result<const XNodeSpec*> {
    const int i = app.find(name);
    if (i < 0) return fail(ErrorCode::kInvalid, "the app has no XNode '" + name + "'", where);
    return &app.xnodes[static_cast<std::size_t>(i)];
  };
  for (const auto& [name, by_type] : s.wcet_us) {
    const std::string where = at + "/wcet_us/" + name;
    XAUTO_ASSIGN(const XNodeSpec* x, xnode(name, where));
    XAUTO_TRY(valid_wcets(by_type, x->wcet_us, "XNode '" + name + "'", where));
  }
  for (const auto& [name, variants] : s.variant_wcet_us) {
    const std::string where = at + "/variant_wcet_us/" + name;
    XAUTO_ASSIGN(const XNodeSpec* x, xnode(name, where));
    for (const auto& [variant, by_type] : variants) {
      const int v = x->find_variant(variant);
      if (v < 0)
        return fail(ErrorCode::kInvalid, "XNode '" + name + "' has no variant '" + variant + "'",
                    where + "/" + variant);
      XAUTO_TRY(valid_wcets(by_type, x->variants[static_cast<std::size_t>(v)].wcet_us,
                            "variant '" + variant + "' of XNode '" + name + "'",
                            where + "/" + variant));
    }
  }
  return {};
}

Status valid_conditions(const Scenario& s, const std::string& at) {
  if (s.when.size() > kMaxConditions)
    return fail(ErrorCode::kInvalid, std::to_string(s.when.size()) + " conditions are too many",
                at + "/when", "at most " + std::to_string(kMaxConditions));
  for (std::size_t k = 0; k < s.when.size(); ++k) {
    const Condition& c = s.when[k];
    const std::string where = at + "/when/" + std::to_string(k);
    if (c.file.empty() || c.file.front() != '/')
      return fail(ErrorCode::kInvalid, "'" + c.file + "' is not an absolute path", where + "/file");
    const bool range = c.at_least || c.at_most;
    if (range == c.equals.has_value())
      return fail(ErrorCode::kInvalid,
                  "needs either equals, or at_least and at_most or one of them", where);
    if (c.at_least && c.at_most && *c.at_least > *c.at_most)
      return fail(ErrorCode::kInvalid,
                  "no number is at least " + std::to_string(*c.at_least) + " and at most " +
                      std::to_string(*c.at_most),
                  where);
    if (c.equals && c.equals->size() > kMaxConditionText)
      return fail(ErrorCode::kInvalid, "is longer than any file that is read", where + "/equals");
  }
  return {};
}

}  // namespace

Status validate(const Scenarios& scenarios, const AppSpec& app, const Platform& platform,
                const std::string& at) {
  if (scenarios.app != app.name)
    return fail(ErrorCode::kInvalid,
                "is about app '" + scenarios.app + "', this is app '" + app.name + "'", "/app");
  if (!scenarios.list.empty() && scenarios.list.front().degraded)
    return fail(ErrorCode::kInvalid, "a run begins with it, so it cannot be degraded",
                at + "/0/degraded", "put a scenario before it in which nothing is lost");
  if (scenarios.list.empty() || scenarios.list.size() > kMaxScenarios)
    return fail(ErrorCode::kInvalid,
                std::to_string(scenarios.list.size()) + " scenarios; 1 to " +
                    std::to_string(kMaxScenarios) + " are possible",
                at);
  const std::vector<std::string> types = platform.types();
  std::set<std::string> names;
  for (std::size_t k = 0; k < scenarios.list.size(); ++k) {
    const Scenario& s = scenarios.list[k];
    const std::string here = at + "/" + std::to_string(k);
    if (s.name.empty()) return fail(ErrorCode::kInvalid, "a scenario needs a name", here + "/name");
    if (!names.insert(s.name).second)
      return fail(ErrorCode::kInvalid, "two scenarios are called '" + s.name + "'", here + "/name");
    XAUTO_TRY(valid_scale(s, types, here));
    XAUTO_TRY(valid_wcets(s, app, here));
    XAUTO_TRY(valid_conditions(s, here));
    std::set<std::string> lost;
    for (std::size_t n = 0; n < s.lost.size(); ++n) {
      const std::string where = here + "/lost/" + std::to_string(n);
      if (platform.find(s.lost[n]) < 0)
        return fail(ErrorCode::kInvalid, "the platform has no XPU '" + s.lost[n] + "'", where);
      if (!lost.insert(s.lost[n]).second)
        return fail(ErrorCode::kInvalid, "XPU '" + s.lost[n] + "' is lost twice", where);
    }
    if (lost.size() == platform.xpus.size())
      return fail(ErrorCode::kInfeasible, "no XPU is left", here + "/lost");
    const AppSpec under = app_under(app, s);
    const Platform left = platform_under(platform, s);
    const auto possible_with = [&](const Loss& loss) {
      return validate_on(app_with(under, loss), platform_with(left, loss.off));
    };
    const Loss forced = forced_loss(under, left);
    if (Status possible = possible_with(s.degraded ? forced : Loss{}); !possible) {
      Error error = std::move(possible).error();
      if (!s.degraded && possible_with(forced))
        error.hint = "let it be degraded, and it is possible with " + words_of(forced, app);
      error.what = "under scenario '" + s.name + "': " + error.what;
      error.where = here;
      return tl::unexpected<Error>(std::move(error));
    }
  }
  return {};
}

namespace {

/// As the scenario scales them; then what it states.
void scale(const Scenario& scenario, const Wcets* stated, Wcets& wcets) {
  for (auto& [type, us] : wcets) {
    if (const auto pct = scenario.wcet_scale_pct.find(type); pct != scenario.wcet_scale_pct.end()) {
      // In two parts: a product of both could pass 64 bits.
      const std::int64_t hundreds = us / 100, rest = us % 100;
      us = hundreds * pct->second + (rest * pct->second + 99) / 100;
    }
    if (stated == nullptr) continue;
    if (const auto own = stated->find(type); own != stated->end()) us = own->second;
  }
}

template <class Map>
const typename Map::mapped_type* in(const Map& map, const std::string& name) {
  const auto found = map.find(name);
  return found == map.end() ? nullptr : &found->second;
}

/// No WCET of `b` is longer than that of `a`, which has the same types.
bool covers(const Wcets& a, const Wcets& b) {
  return std::all_of(b.begin(), b.end(),
                     [&](const auto& of) { return of.second <= a.find(of.first)->second; });
}

/// Of each type the larger one; both have the same.
Wcets larger(const Wcets& a, const Wcets& b) {
  Wcets both = a;
  for (auto& [type, us] : both) us = std::max(us, b.find(type)->second);
  return both;
}

}  // namespace

AppSpec app_under(const AppSpec& app, const Scenario& scenario) {
  AppSpec scaled = at_longest(app);
  for (XNodeSpec& x : scaled.xnodes) {
    scale(scenario, in(scenario.wcet_us, x.name), x.wcet_us);
    const auto* of_variants = in(scenario.variant_wcet_us, x.name);
    for (VariantSpec& variant : x.variants)
      scale(scenario, of_variants == nullptr ? nullptr : in(*of_variants, variant.name),
            variant.wcet_us);
  }
  return scaled;
}

bool covers(const Scenario& a, const AppSpec& under_a, const Scenario& b, const AppSpec& under_b) {
  for (std::size_t i = 0; i < under_b.xnodes.size(); ++i) {
    const XNodeSpec &x = under_a.xnodes[i], &other = under_b.xnodes[i];
    if (!covers(x.wcet_us, other.wcet_us)) return false;
    for (std::size_t v = 0; v < other.variants.size(); ++v)
      if (!covers(x.variants[v].wcet_us, other.variants[v].wcet_us)) return false;
  }
  return std::all_of(b.lost.begin(), b.lost.end(), [&](const std::string& id) {
    return std::find(a.lost.begin(), a.lost.end(), id) != a.lost.end();
  });
}

namespace {

bool same_types(const Wcets& a, const Wcets& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(),
                    [](const auto& x, const auto& y) { return x.first == y.first; });
}

/// They and their variants.
bool on_the_same_types(const XNodeSpec& a, const XNodeSpec& b) {
  return same_types(a.wcet_us, b.wcet_us) &&
         std::equal(a.variants.begin(), a.variants.end(), b.variants.begin(), b.variants.end(),
                    [](const VariantSpec& x, const VariantSpec& y) {
                      return x.name == y.name && same_types(x.wcet_us, y.wcet_us);
                    });
}

}  // namespace

Result<Scenarios> scenarios_of(const std::vector<NamedProfile>& profiles, const Platform& platform,
                               WcetFrom from) {
  if (profiles.empty()) return fail(ErrorCode::kInvalid, "no profile is given");
  std::vector<AppSpec> apps;
  for (const NamedProfile& one : profiles) {
    if (!one.profile.incomplete.empty())
      return fail(ErrorCode::kInvalid, "is incomplete: " + one.profile.incomplete, one.name);
    XAUTO_ASSIGN(AppSpec app, to_app(one.profile, platform, from));
    apps.push_back(std::move(app));
  }
  const AppSpec& first = apps.front();
  Scenarios scenarios{first.name, {}};
  for (std::size_t k = 0; k < apps.size(); ++k) {
    const std::string& name = profiles[k].name;
    if (apps[k].name != first.name)
      return fail(ErrorCode::kInvalid, "is of app '" + apps[k].name + "'", name,
                  profiles[0].name + " is of '" + first.name + "'");
    if (apps[k].xnodes.size() != first.xnodes.size())
      return fail(ErrorCode::kInvalid, "has other XNodes than " + profiles[0].name, name);
    Scenario scenario{name};
    for (const XNodeSpec& x : apps[k].xnodes) {
      const int i = first.find(x.name);
      if (i < 0)
        return fail(ErrorCode::kInvalid,
                    "has XNode '" + x.name + "', which " + profiles[0].name + " has not", name);
      if (!on_the_same_types(x, first.xnodes[static_cast<std::size_t>(i)]))
        return fail(ErrorCode::kInvalid,
                    "XNode '" + x.name +
                        "' was measured on other types of XPU, or in other variants, than in " +
                        profiles[0].name,
                    name, "measure all of them under the same platform");
      for (const auto& [type, us] : x.wcet_us)
        scenario.wcet_us[x.name][type] = longest_wcet(x, type);
      for (const VariantSpec& variant : x.variants)
        scenario.variant_wcet_us[x.name][variant.name] = variant.wcet_us;
    }
    scenarios.list.push_back(std::move(scenario));
  }
  return scenarios;
}

namespace {

/// [file] -> [profile] what it said there; files that all of them have read.
using Said = std::map<std::string, std::vector<const Reading*>>;
Said said_to_all(const std::vector<NamedProfile>& profiles, Reading::Of of) {
  Said said;
  for (const NamedProfile& one : profiles)
    for (const Reading& reading : one.profile.conditions.readings)
      if (reading.of == of) said[reading.file].push_back(&reading);
  std::erase_if(said, [&](const auto& file) { return file.second.size() != profiles.size(); });
  return said;
}

bool alike(const Said& clocks, const Said& modes, std::size_t a, std::size_t b) {
  return std::all_of(clocks.begin(), clocks.end(),
                     [&](const auto& file) {
                       return Reading::same_clock(file.second[a]->min, file.second[b]->min);
                     }) &&
         std::all_of(modes.begin(), modes.end(), [&](const auto& file) {
           return file.second[a]->texts == file.second[b]->texts;
         });
}

/// By how many percent the times of two scenarios differ at most, and where; "": nowhere.
std::string difference(const Scenario& a, const Scenario& b) {
  std::int64_t largest = 0;
  std::string where;
  const auto compare = [&](const Wcets& these, const Wcets& those, const std::string& whose) {
    for (const auto& [type, us] : these) {
      const std::int64_t other = those.at(type);
      const std::int64_t low = std::min(us, other), high = std::max(us, other);
      const std::int64_t pct = ((high - low) * 100 + low - 1) / low;
      if (pct <= largest) continue;
      largest = pct;
      where = "by " + std::to_string(pct) + " % (" + whose + " on " + type + ")";
    }
  };
  for (const auto& [xnode, types] : a.wcet_us)
    compare(types, b.wcet_us.at(xnode), "XNode '" + xnode + "'");
  for (const auto& [xnode, variants] : a.variant_wcet_us)
    for (const auto& [variant, types] : variants)
      compare(types, b.variant_wcet_us.at(xnode).at(variant),
              "variant '" + variant + "' of XNode '" + xnode + "'");
  return where;
}

}  // namespace

std::string set_conditions(Scenarios& scenarios, const std::vector<NamedProfile>& profiles) {
  if (profiles.size() < 2) return {};
  for (const NamedProfile& one : profiles)
    for (const Reading& r : one.profile.conditions.readings)
      if (r.changed() && r.of != Reading::Of::kGovernor)
        return one.name + " was not measured under one condition: " + r.file + " changed meanwhile";
  const Said clocks = said_to_all(profiles, Reading::Of::kClock);
  const Said modes = said_to_all(profiles, Reading::Of::kPowerMode);
  if (clocks.empty() && modes.empty())
    return "no clock and no power mode was read in all of the profiles";
  bool need_modes = false;
  for (std::size_t a = 0; a < profiles.size(); ++a)
    for (std::size_t b = 0; b < a; ++b) {
      if (!alike(clocks, {}, a, b)) continue;
      need_modes = need_modes || !alike({}, modes, a, b);
      if (!alike({}, modes, a, b)) continue;
      if (const std::string differ = difference(scenarios.list[b], scenarios.list[a]);
          !differ.empty())
        return profiles[b].name + " and " + profiles[a].name +
               " were measured under the same clocks and power mode, and their WCETs differ " +
               differ;
    }
  if (clocks.size() + (need_modes ? modes.size() : 0) > kMaxConditions)
    return "more than " + std::to_string(kMaxConditions) + " clocks were read";
  for (std::size_t k = 0; k < profiles.size(); ++k) {
    std::vector<Condition>& when = scenarios.list[k].when;
    for (const auto& [file, readings] : clocks)
      when.push_back({file, readings[k]->min - Reading::jitter(readings[k]->min), {}, {}});
    if (need_modes)
      for (const auto& [file, readings] : modes)
        when.push_back({file, {}, {}, readings[k]->texts.front()});
  }
  return {};
}

Scenario across(const AppSpec& app, const Scenario& from, const Scenario& to) {
  Scenario both;
  both.name = from.name + " -> " + to.name;
  both.lost = from.lost;
  const AppSpec a = app_under(app, from), b = app_under(app, to);
  for (std::size_t i = 0; i < app.xnodes.size(); ++i) {
    const XNodeSpec &x = a.xnodes[i], &other = b.xnodes[i];
    both.wcet_us[x.name] = larger(x.wcet_us, other.wcet_us);
    for (std::size_t v = 0; v < x.variants.size(); ++v)
      both.variant_wcet_us[x.name][x.variants[v].name] =
          larger(x.variants[v].wcet_us, other.variants[v].wcet_us);
  }
  for (const std::string& id : to.lost)
    if (std::find(both.lost.begin(), both.lost.end(), id) == both.lost.end())
      both.lost.push_back(id);
  return both;
}

Platform platform_under(const Platform& platform, const Scenario& scenario) {
  Platform left = platform;
  std::erase_if(left.xpus, [&](const Xpu& xpu) {
    return std::find(scenario.lost.begin(), scenario.lost.end(), xpu.id) != scenario.lost.end();
  });
  return left;
}

}  // namespace xauto
