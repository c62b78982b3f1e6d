// SPDX-License-Identifier: Apache-2.0
#include "xauto/remedies.h"

#include <algorithm>
#include <chrono>
#include <numeric>
#include <optional>
#include <utility>

#include <fmt/format.h>

#include "base/index.h"
#include "model/components.h"
#include "solver/keys/sustain.h"
#include "solver/keys/what_if.h"

#include "xauto/command.h"
#include "xauto/rare_wcets.h"

namespace xauto::cli {
namespace {

namespace keys = solver::keys;

constexpr double kPartOfTime = 0.3, kLeastS = 0.02;  ///< one search
constexpr std::int64_t kPartOfBudget = 8;
constexpr std::size_t kMostOutliers = 6, kMostSources = 6, kMostFactors = 3;  ///< tried
/// Of periods: ratios of small numbers, so that rates still meet soon.
constexpr std::pair<int, int> kFactors[] = {{10, 9}, {5, 4}, {4, 3}, {3, 2}, {5, 3}, {2, 1},
                                            {5, 2},  {3, 1}, {4, 1}, {5, 1}, {8, 1}, {10, 1}};

class Remedies {
 public:
  Remedies(const AppSpec& app, const Platform& platform, const keys::Options& options)
      : app_(app),
        platform_(platform),
        options_(options),
        began_(std::chrono::steady_clock::now()) {}

  std::vector<Remedy> find(const keys::Uncertified& found) {
    less_margin(found.in_time_pct, false);
    if (found.certified_pct != found.in_time_pct) less_margin(found.certified_pct, true);
    outliers();
    sources();
    return std::move(found_);
  }

 private:
  [[nodiscard]] double left_s() const {
    return options_.time_limit_s -
           std::chrono::duration<double>(std::chrono::steady_clock::now() - began_).count();
  }
  [[nodiscard]] bool over() const {
    return left_s() <= 0 || (options_.stop != nullptr && options_.stop->load());
  }
  [[nodiscard]] bool is_proven(const AppSpec& app) const {
    const auto p = keys::Problem::create(app, platform_, options_.wishes);
    return !p || keys::prove_overload(*p);
  }

  void less_margin(const std::optional<std::int64_t>& pct, bool late) {
    if (!pct) return;
    found_.push_back({*pct == 100 ? "a longer search (--time-limit)"
                                  : fmt::format("all WCETs at {} % of what they are ({} % less)",
                                                *pct, 100 - *pct),
                      {{"wcets_pct", *pct}},
                      late});
  }

  /// True: it is certified, and told.
  bool helps(const AppSpec& app, std::string change, Json what) {
    if (over() || is_proven(app)) return false;
    keys::Options asked = options_;
    asked.time_limit_s = std::max(kLeastS, std::min(left_s(), kPartOfTime * options_.time_limit_s));
    if (options_.max_evaluations > 0) {
      asked.max_evaluations = std::max<std::int64_t>(1, options_.max_evaluations / kPartOfBudget);
      asked.time_limit_s = std::max(kLeastS, left_s());
    }
    const auto answer = keys::certifies(app, platform_, asked, true);
    if (!answer || answer->outcome != keys::Outcome::kPolicy) return false;
    found_.push_back({std::move(change), std::move(what), answer->late});
    return true;
  }

  void outliers() {
    const std::vector<std::string> types = platform_.types();
    const std::vector<RareWcet> rare = rare_wcets(app_, [&](int, const std::string& type) {
      return std::find(types.begin(), types.end(), type) != types.end();
    });
    const auto at_typical = [](AppSpec& app, const RareWcet& r) {
      app.xnodes[at(r.xnode)].wcet_us[r.type] = r.typical_us;
    };
    bool one = false;
    for (std::size_t k = 0; k < std::min(kMostOutliers, rare.size()); ++k) {
      AppSpec usual = app_;
      at_typical(usual, rare[k]);
      const std::string& name = app_.xnodes[at(rare[k].xnode)].name;
      one = helps(usual,
                  fmt::format("{} on {} within {}, as usual, not {}", name, rare[k].type,
                              ms(rare[k].typical_us), ms(rare[k].wcet_us)),
                  {{"xnode", name}, {"type", rare[k].type}, {"wcet_us", rare[k].typical_us}}) ||
            one;
    }
    if (one || rare.size() < 2) return;
    AppSpec usual = app_;
    for (const RareWcet& r : rare) at_typical(usual, r);
    helps(usual,
          fmt::format("all {} WCETs that are above twice what is usual, as usual", rare.size()),
          {{"rare_wcets", rare.size()}});
  }

  /// The slightest changes first.
  void sources() {
    const auto parts = find_components(app_);
    if (!parts) return;
    struct Slower {
      std::size_t factor;
      int source;
    };
    std::vector<Slower> tried;
    for (const Component& c : parts->components) {
      if (c.sources.empty()) continue;
      for (std::size_t f = 0; f < std::size(kFactors) && !over(); ++f) {
        const auto app = slower(c.sources.front(), f);
        if (!app || is_proven(*app)) continue;
        tried.push_back({f, c.sources.front()});
        break;
      }
    }
    std::ranges::stable_sort(tried, {}, &Slower::factor);
    if (tried.size() > kMostSources) tried.resize(kMostSources);
    for (const Slower& first : tried) {
      const std::size_t before = found_.size();
      for (std::size_t f = first.factor;
           f < std::min(std::size(kFactors), first.factor + kMostFactors); ++f) {
        const auto app = slower(first.source, f);
        if (!app) continue;
        const SourceSpec& source = app->sources[at(first.source)];
        if (helps(*app,
                  fmt::format("{} at most {:.4g} Hz (every {} or more)", source.name,
                              1e6 * static_cast<double>(source.period.den) /
                                  static_cast<double>(source.period.num),
                              ms(source.period.floor_us())),
                  {{"source", source.name}, {"rate_hz", source.period.rate()}}) &&
            !found_.back().late)
          break;
      }
      // Of a source the first that helps; that with which no deadline is missed, if there is one.
      if (found_.size() == before) continue;
      if (!found_.back().late) std::swap(found_[before], found_.back());
      found_.resize(before + 1);
    }
  }

  [[nodiscard]] Result<AppSpec> slower(int source, std::size_t factor) const {
    const auto [by, of] = kFactors[factor];
    Period period = app_.sources[at(source)].period;
    const std::int64_t num = period.num * by, den = period.den * of, common = std::gcd(num, den);
    return keys::with_period(app_, source, {num / common, den / common});
  }

  const AppSpec& app_;
  const Platform& platform_;
  const keys::Options& options_;
  const std::chrono::steady_clock::time_point began_;
  std::vector<Remedy> found_;
};

}  // namespace

std::vector<Remedy> remedies(const AppSpec& app, const Platform& platform,
                             const keys::Uncertified& found, const keys::Options& options) {
  return Remedies(app, platform, options).find(found);
}

}  // namespace xauto::cli
