// SPDX-License-Identifier: Apache-2.0
#include "solver/least_loss.h"

#include <algorithm>
#include <map>
#include <string>
#include <utility>

#include "base/index.h"
#include "solver/ilp_model.h"

namespace xauto::solver {
namespace {

using Levels = std::vector<int>;  ///< [item]

struct Item {
  int xnode = -1;                 ///< or
  std::string module;             ///< an optional one, with one level: it is off
  std::vector<int> variants;      ///< [level - 1] of the XNode
  std::vector<std::int64_t> pct;  ///< [level] what is lost; the first is 0
  std::vector<int> pulls;         ///< items of modules that wait for this one: off where it is

  [[nodiscard]] int highest() const { return static_cast<int>(pct.size()) - 1; }
};

/// Best quality first. What is on no type of the platform faster than all that is better is left out.
Item item_of(const XNodeSpec& x, int xnode, const std::vector<std::string>& types) {
  Item item{xnode, {}, {}, {0}, {}};
  std::vector<int> order(x.variants.size());
  for (std::size_t v = 0; v < order.size(); ++v) order[v] = static_cast<int>(v);
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) {
    return x.variants[at(a)].quality_pct > x.variants[at(b)].quality_pct;
  });
  std::map<std::string, std::int64_t, std::less<>> best = x.wcet_us;
  for (const int v : order) {
    bool faster = false;
    for (const auto& [type, us] : x.variants[at(v)].wcet_us) {
      if (std::find(types.begin(), types.end(), type) == types.end()) continue;
      const auto [known, added] = best.try_emplace(type, us);
      faster = faster || added || us < known->second;
      known->second = std::min(known->second, us);
    }
    if (!faster) continue;
    item.variants.push_back(v);
    item.pct.push_back(100 - x.variants[at(v)].quality_pct);
  }
  return item;
}

class Search {
 public:
  Search(const AppSpec& app, const Platform& platform,
         const std::function<bool(const Loss&)>& suffices, const Until& until)
      : app_(app), suffices_(suffices), until_(until) {
    const std::vector<std::string> types = platform.types();
    for (std::size_t i = 0; i < app.xnodes.size(); ++i)
      if (Item item = item_of(app.xnodes[i], static_cast<int>(i), types); item.highest() > 0)
        items_.push_back(std::move(item));
    std::map<std::string, int> number;
    for (const ModuleSpec& module : app.modules) {
      if (!module.optional) continue;
      number[module.name] = static_cast<int>(items_.size());
      items_.push_back({-1, module.name, {}, {0, 100}, {}});
    }
    for (const auto& [u, v] : app.edges) {
      const auto from = number.find(app.xnodes[at(u)].module),
                 to = number.find(app.xnodes[at(v)].module);
      if (from != number.end() && from != to) items_[at(from->second)].pulls.push_back(to->second);
    }
  }

  LeastLoss run() {
    Levels none(items_.size(), 0), all;
    for (const Item& item : items_) all.push_back(item.highest());
    if (suffices(none)) return {{}, true, true};
    if (!suffices(all)) return {loss_of(all), false, false};
    Levels best = lowered(all);
    std::vector<Levels> cuts{raised(none)};
    while (!until_.over()) {
      const auto cheapest = master(cuts);
      if (!cheapest) break;
      if (pct_of(*cheapest) >= pct_of(best)) return {loss_of(best), true, true};
      if (suffices(*cheapest)) return {loss_of(*cheapest), true, !until_.over()};
      cuts.push_back(raised(*cheapest));
    }
    return {loss_of(best), true, false};
  }

 private:
  /// Modules that wait for one that is off are off, too.
  void pull(Levels& levels) const {
    for (bool again = true; again;) {
      again = false;
      for (std::size_t k = 0; k < items_.size(); ++k)
        for (const int other : items_[k].pulls)
          if (levels[k] > 0 && levels[at(other)] == 0) {
            levels[at(other)] = 1;
            again = true;
          }
    }
  }

  [[nodiscard]] Loss loss_of(Levels levels) const {
    pull(levels);
    Loss loss;
    for (std::size_t k = 0; k < items_.size(); ++k)
      if (levels[k] > 0 && items_[k].xnode < 0) loss.off.push_back(items_[k].module);
    std::sort(loss.off.begin(), loss.off.end());
    for (std::size_t k = 0; k < items_.size(); ++k) {
      const int i = items_[k].xnode;
      if (levels[k] == 0 || i < 0 || loss.is_off(app_.xnodes[at(i)].module)) continue;
      loss.variant.resize(app_.xnodes.size(), -1);
      loss.variant[at(i)] = items_[k].variants[at(levels[k] - 1)];
    }
    return loss;
  }
  [[nodiscard]] std::int64_t pct_of(const Levels& levels) const {
    return loss_pct(loss_of(levels), app_);
  }

  bool suffices(const Levels& levels) {
    const Loss loss = loss_of(levels);
    const auto [known, added] = asked_.try_emplace({loss.variant, loss.off}, false);
    if (added) known->second = suffices_(loss);
    return known->second;
  }

  /// Dearest first, each item as low as it may be beside the others.
  Levels lowered(Levels levels) {
    std::vector<std::size_t> order(items_.size());
    for (std::size_t k = 0; k < order.size(); ++k) order[k] = k;
    std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
      return items_[a].pct.back() > items_[b].pct.back();
    });
    for (const std::size_t k : order)
      for (int level = 0; level < levels[k] && !until_.over(); ++level) {
        Levels lower = levels;
        lower[k] = level;
        if (suffices(lower)) levels = std::move(lower);
      }
    return levels;
  }

  /// Of a choice that does not suffice: each item as high as it may be so that it still does not.
  Levels raised(Levels levels) {
    pull(levels);
    for (std::size_t k = 0; k < items_.size(); ++k)
      while (levels[k] < items_[k].highest() && !until_.over()) {
        Levels higher = levels;
        ++higher[k];
        pull(higher);
        if (suffices(higher)) break;
        levels = std::move(higher);
      }
    return levels;
  }

  /// The cheapest levels of which each cut has one below; nullopt: lp_solve gave up.
  [[nodiscard]] std::optional<Levels> master(const std::vector<Levels>& cuts) const {
    IlpModel model;
    std::vector<std::vector<int>> from(
        items_.size());  // [item][level - 1]: at that or a higher one
    std::vector<IlpModel::Term> cost;
    for (std::size_t k = 0; k < items_.size(); ++k)
      for (int level = 1; level <= items_[k].highest(); ++level) {
        from[k].push_back(model.add_binary());
        const auto more =
            static_cast<double>(items_[k].pct[at(level)] - items_[k].pct[at(level - 1)]);
        cost.push_back({from[k].back(), more});
        if (level > 1) model.at_least({{from[k][at(level - 2)], 1}, {from[k].back(), -1}}, 0);
      }
    for (std::size_t k = 0; k < items_.size(); ++k)
      for (const int other : items_[k].pulls)
        model.at_least({{from[at(other)].front(), 1}, {from[k].front(), -1}}, 0);
    for (const Levels& cut : cuts) {
      std::vector<IlpModel::Term> above;
      for (std::size_t k = 0; k < items_.size(); ++k)
        if (cut[k] < items_[k].highest()) above.push_back({from[k][at(cut[k])], 1});
      if (above.empty()) return std::nullopt;  // not even all suffices, and it did: not monotone
      model.at_least(above, 1);
    }
    // Of the binaries themselves. Told to minimise a column that a row ties to their sum, lp_solve
    // 5.5.2.5 called 301 optimal where 300 can be had (docs/ilp.md).
    model.minimise(cost);
    constexpr double kSeconds = 2;
    if (model.solve(kSeconds, until_.stop) != IlpModel::Outcome::kOptimal) return std::nullopt;
    Levels levels(items_.size(), 0);
    for (std::size_t k = 0; k < items_.size(); ++k)
      for (const int column : from[k]) levels[k] += model.value(column) > 0.5 ? 1 : 0;
    return levels;
  }

  const AppSpec& app_;
  const std::function<bool(const Loss&)>& suffices_;
  const Until until_;
  std::vector<Item> items_;
  std::map<std::pair<std::vector<int>, std::vector<std::string>>, bool> asked_;
};

}  // namespace

LeastLoss least_loss(const AppSpec& app, const Platform& platform,
                     const std::function<bool(const Loss&)>& suffices, const Until& until) {
  return Search(app, platform, suffices, until).run();
}

}  // namespace xauto::solver
