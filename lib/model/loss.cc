// SPDX-License-Identifier: Apache-2.0
#include "model/loss.h"

#include <algorithm>
#include <map>
#include <set>
#include <unordered_set>
#include <utility>

#include "base/index.h"
#include "model/components.h"
#include "model/refusal.h"

namespace xauto {
namespace {

Status validate_variants(const AppSpec& app) {
  for (std::size_t i = 0; i < app.xnodes.size(); ++i) {
    const std::vector<VariantSpec>& variants = app.xnodes[i].variants;
    const std::string list = nth("xnodes", i) + "/variants";
    if (variants.size() > kMaxVariants)
      return invalid(std::to_string(variants.size()) + " variants; at most " +
                         std::to_string(kMaxVariants) + " are possible",
                     list);
    XAUTO_TRY(validate_names(variants, (list.substr(1)).c_str(), "variant"));
    for (std::size_t k = 0; k < variants.size(); ++k) {
      const std::string where = list + "/" + std::to_string(k);
      XAUTO_TRY(in_range(variants[k].quality_pct, 1, 100, "a quality in percent",
                         where + "/quality_pct"));
      if (variants[k].wcet_us.empty())
        return invalid("variant " + quoted(variants[k].name) + " has no implementation",
                       where + "/wcet_us", "give a WCET for at least one XPU type");
      for (const auto& [type, us] : variants[k].wcet_us) {
        if (type.empty()) return invalid("an XPU type without name", where + "/wcet_us");
        XAUTO_TRY(in_range(us, 1, kMaxTimeUs, "a WCET in us", where + "/wcet_us/" + type));
      }
    }
  }
  return {};
}

std::unordered_set<std::string_view> optional_modules(const AppSpec& app) {
  std::unordered_set<std::string_view> optional;
  for (const ModuleSpec& module : app.modules)
    if (module.optional) optional.insert(module.name);
  return optional;
}

}  // namespace

bool Loss::none() const {
  return off.empty() &&
         std::all_of(variant.begin(), variant.end(), [](int which) { return which < 0; });
}

bool Loss::is_off(const std::string& module) const {
  return std::binary_search(off.begin(), off.end(), module);
}

Status validate_losses(const AppSpec& app) {
  XAUTO_TRY(validate_variants(app));
  const auto optional = optional_modules(app);
  if (optional.empty()) return {};
  if (app.one_at_a_time &&
      std::all_of(app.xnodes.begin(), app.xnodes.end(),
                  [&](const XNodeSpec& x) { return optional.contains(x.module); }))
    return invalid("every module is optional: nothing would be left to run", "/modules");
  for (std::size_t e = 0; e < app.edges.size(); ++e) {
    const std::string &from = app.xnodes[at(app.edges[e].first)].module,
                      &to = app.xnodes[at(app.edges[e].second)].module;
    if (optional.contains(from) && !optional.contains(to))
      return invalid("module " + quoted(to) + " waits for module " + quoted(from) +
                         ", which is optional, and is not optional itself",
                     nth("edges", e), "make both optional, or neither");
  }
  return {};
}

Status validate(const Loss& loss, const AppSpec& app, const std::string& where) {
  if (!loss.variant.empty() && loss.variant.size() != app.xnodes.size())
    return invalid("does not say the variant of every XNode", where + "/variants");
  for (std::size_t i = 0; i < loss.variant.size(); ++i)
    if (loss.variant[i] < -1 || loss.variant[i] >= static_cast<int>(app.xnodes[i].variants.size()))
      return invalid("XNode " + quoted(app.xnodes[i].name) + " has no such variant",
                     where + "/variants/" + app.xnodes[i].name);
  const auto optional = optional_modules(app);
  for (std::size_t k = 0; k < loss.off.size(); ++k) {
    const std::string here = where + "/off/" + std::to_string(k);
    if (!optional.contains(loss.off[k]))
      return invalid("module " + quoted(loss.off[k]) + " is not optional", here);
    if (k > 0 && loss.off[k] <= loss.off[k - 1])
      return invalid("are not in alphabetical order, each once", here);
  }
  for (const auto& [u, v] : app.edges) {
    const std::string &from = app.xnodes[at(u)].module, &to = app.xnodes[at(v)].module;
    if (loss.is_off(from) && !loss.is_off(to))
      return invalid("module " + quoted(from) + " is off, and module " + quoted(to) +
                         ", which waits for it, is not",
                     where + "/off");
  }
  if (!app.chains.empty() && kept_chains(app, loss).empty())
    return invalid("leaves no chain without a module that is off", where + "/off");
  return {};
}

std::optional<std::int64_t> wcet_of(const XNodeSpec& xnode, int variant, std::string_view type) {
  if (variant < 0) return xnode.wcet_on(type);
  const auto& wcets = xnode.variants[at(variant)].wcet_us;
  const auto found = wcets.find(type);
  if (found == wcets.end()) return std::nullopt;
  return found->second;
}

std::int64_t loss_pct(const Loss& loss, const AppSpec& app) {
  std::int64_t pct = 100 * static_cast<std::int64_t>(loss.off.size());
  for (const int i : kept(app, loss))
    if (const int variant = loss.variant_of(at(i)); variant >= 0)
      pct += 100 - app.xnodes[at(i)].variants[at(variant)].quality_pct;
  return pct;
}

Loss forced_loss(const AppSpec& app, const Platform& platform) {
  const std::vector<std::string> types = platform.types();
  const auto runs = [&](const auto& wcet_us) {
    return std::any_of(types.begin(), types.end(),
                       [&](const std::string& type) { return wcet_us.contains(type); });
  };
  const auto optional = optional_modules(app);
  std::set<std::string> off;
  Loss loss;
  for (std::size_t i = 0; i < app.xnodes.size(); ++i) {
    const XNodeSpec& x = app.xnodes[i];
    if (runs(x.wcet_us)) continue;
    int best = -1;
    for (std::size_t v = 0; v < x.variants.size(); ++v)
      if (runs(x.variants[v].wcet_us) &&
          (best < 0 || x.variants[v].quality_pct > x.variants[at(best)].quality_pct))
        best = static_cast<int>(v);
    if (best >= 0) {
      loss.variant.resize(app.xnodes.size(), -1);
      loss.variant[i] = best;
    } else if (optional.contains(x.module)) {
      off.insert(x.module);
    }
  }
  for (bool again = !off.empty(); again;) {
    again = false;
    for (const auto& [u, v] : app.edges)
      if (off.contains(app.xnodes[at(u)].module))
        again = off.insert(app.xnodes[at(v)].module).second || again;
  }
  loss.off.assign(off.begin(), off.end());
  return loss;
}

std::string words_of(const Loss& loss, const AppSpec& app) {
  std::string words;
  const auto add = [&](const std::string& what) { words += (words.empty() ? "" : ", ") + what; };
  for (const std::string& module : loss.off) add(module + " off");
  for (const int i : kept(app, loss))
    if (const int variant = loss.variant_of(at(i)); variant >= 0)
      add(app.xnodes[at(i)].name + " " + app.xnodes[at(i)].variants[at(variant)].name);
  return words;
}

std::vector<char> ends_of(const AppSpec& app) {
  const auto optional = optional_modules(app);
  std::vector<char> ends(app.xnodes.size(), 1);
  for (const auto& [u, v] : app.edges) {
    const std::string& to = app.xnodes[at(v)].module;
    if (to == app.xnodes[at(u)].module || !optional.contains(to)) ends[at(u)] = 0;
  }
  return ends;
}

std::vector<int> kept(const AppSpec& app, const Loss& loss) {
  std::vector<int> kept;
  for (std::size_t i = 0; i < app.xnodes.size(); ++i)
    if (!loss.is_off(app.xnodes[i].module)) kept.push_back(static_cast<int>(i));
  return kept;
}

namespace {

/// Of chains, the XNodes on their ways.
class OnTheWay {
 public:
  OnTheWay(const AppSpec& app, std::vector<int> component)
      : component_(std::move(component)), onward_(app.xnodes.size()), back_(app.xnodes.size()) {
    for (const auto* links : {&app.edges, &app.samples})
      for (const auto& [u, v] : *links) {
        onward_[at(u)].push_back({v, links == &app.samples});
        back_[at(v)].push_back({u, links == &app.samples});
      }
  }
  [[nodiscard]] int component(std::size_t xnode) const { return component_[xnode]; }

  /// [xnode] whether some way from `roots`, which are of one component, to `to` may pass it. A way enters
  /// no component twice, so none goes on from that of `to`, or comes back into that of `roots`.
  [[nodiscard]] std::vector<char> between(const std::vector<int>& roots, int to) const {
    std::vector<char> both = reach(roots, onward_, component_[at(to)]);
    const std::vector<char> before = reach({to}, back_, component_[at(roots.front())]);
    for (std::size_t i = 0; i < both.size(); ++i) both[i] = both[i] != 0 && before[i] != 0 ? 1 : 0;
    return both;
  }

 private:
  struct EdgeEnd {
    int xnode;
    bool sample;
  };
  [[nodiscard]] std::vector<char> reach(std::vector<int> todo,
                                        const std::vector<std::vector<EdgeEnd>>& links,
                                        int last) const {
    std::vector<char> seen(links.size(), 0);
    for (const int x : todo) seen[at(x)] = 1;
    while (!todo.empty()) {
      const int x = todo.back();
      todo.pop_back();
      for (const auto& [next, sample] : links[at(x)]) {
        if (sample && component_[at(x)] == last) continue;
        if (std::exchange(seen[at(next)], 1) == 0) todo.push_back(next);
      }
    }
    return seen;
  }

  std::vector<int> component_;  ///< [xnode]
  std::vector<std::vector<EdgeEnd>> onward_, back_;
};

}  // namespace

std::vector<int> kept_chains(const AppSpec& app, const Loss& loss) {
  std::vector<int> chains;
  std::optional<OnTheWay> ways;
  if (!loss.off.empty())
    if (auto components = find_components(app)) ways.emplace(app, std::move(components->of));
  for (std::size_t c = 0; c < app.chains.size(); ++c) {
    std::map<int, std::vector<int>> hear;  // component -> its XNodes that hear of the source
    for (std::size_t i = 0; ways && i < app.xnodes.size(); ++i)
      if (const std::vector<int>& of = app.xnodes[i].sources;
          std::find(of.begin(), of.end(), app.chains[c].from) != of.end())
        hear[ways->component(i)].push_back(static_cast<int>(i));
    bool whole = true;
    for (const auto& [component, roots] : hear) {
      const std::vector<char> way = ways->between(roots, app.chains[c].to);
      for (std::size_t i = 0; i < app.xnodes.size(); ++i)
        whole = whole && (way[i] == 0 || !loss.is_off(app.xnodes[i].module));
    }
    if (whole) chains.push_back(static_cast<int>(c));
  }
  return chains;
}

namespace {

void take_variant(XNodeSpec& x, int variant) {
  if (variant >= 0) {
    x.wcet_us = x.variants[at(variant)].wcet_us;
    x.memory_kb = x.variants[at(variant)].memory_kb;
    x.typical_us = x.variants[at(variant)].typical_us;
    x.beside.clear();
    std::erase_if(x.real_on, [&](const std::string& type) { return !x.wcet_us.contains(type); });
  }
  x.variants.clear();
}

}  // namespace

AppSpec app_with(const AppSpec& app, const Loss& loss) {
  if (loss.none()) return app;
  AppSpec left = app_of_all_chains(app, loss);
  left.chains.clear();
  for (const int c : kept_chains(app, loss)) left.chains.push_back(app.chains[at(c)]);
  return left;
}

AppSpec release_of(const AppSpec& app, const Loss& loss) {
  AppSpec left = app;
  left.modules.clear();
  left.chains.clear();
  left.transfers.clear();
  left.xnodes.clear();
  left.edges.clear();
  std::vector<int> now(app.xnodes.size(), -1);
  for (const int i : kept(app, loss)) {
    now[at(i)] = static_cast<int>(left.xnodes.size());
    take_variant(left.xnodes.emplace_back(app.xnodes[at(i)]), loss.variant_of(at(i)));
  }
  for (const auto& [u, v] : app.edges)
    if (now[at(u)] >= 0 && now[at(v)] >= 0) left.edges.emplace_back(now[at(u)], now[at(v)]);
  return left;
}

AppSpec app_of_all_chains(const AppSpec& app, const Loss& loss) {
  AppSpec left = app;
  if (loss.none()) return left;
  for (std::size_t i = 0; i < left.xnodes.size(); ++i) {
    take_variant(left.xnodes[i], loss.variant_of(i));
    if (loss.is_off(app.xnodes[i].module)) {
      left.xnodes[i].wcet_us = {{off_xpu(app.xnodes[i].module), 1}};
      left.xnodes[i].real_on.clear();
      left.xnodes[i].memory_kb.clear();
      left.xnodes[i].typical_us.clear();
      left.xnodes[i].beside.clear();
    }
  }
  // Of types that are not there any more.
  std::erase_if(left.transfers, [&](const TransferSpec& t) {
    const auto [u, v] = left.edges[at(t.edge)];
    return !left.xnodes[at(u)].wcet_on(t.from_type) || !left.xnodes[at(v)].wcet_on(t.to_type);
  });
  return left;
}

std::string off_xpu(const std::string& module) {
  return "(off) " + module;
}

Platform platform_with(Platform platform, const std::vector<std::string>& off) {
  for (const std::string& module : off) {
    Xpu& none = platform.xpus.emplace_back();
    none.id = none.type = off_xpu(module);
  }
  return platform;
}

}  // namespace xauto
