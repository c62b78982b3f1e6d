// SPDX-License-Identifier: Apache-2.0
// Two random apps on one platform, each with a policy that holds alone, and that are as tight as the test of both
// together lets them be: or refused by it, but only just.
#pragma once

#include <algorithm>
#include <map>
#include <numeric>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "model/together.h"
#include "solver/keys/check.h"
#include "solver/keys/demand.h"
#include "solver/keys/play.h"

#include "attack/attack.h"
#include "attack/producer.h"

namespace xauto::attack {

struct Pair {
  std::vector<Case> each;
  Case together;
  std::vector<int> app_of;
  bool accepted = false;
};

/// Both as one. Nothing: the files would not be accepted either.
inline bool join(Pair& pair) {
  std::vector<AppSpec> apps;
  std::vector<Policy> policies;
  for (const Case& c : pair.each) {
    apps.push_back(c.app);
    policies.push_back(c.policy);
  }
  Result<AppSpec> all = merge_apps(apps);
  if (!all) return false;
  Result<Policy> policy = merge_policies(apps, *all, policies);
  if (!policy) return false;
  pair.together = {std::move(*all), pair.each.front().platform, std::move(*policy)};
  pair.app_of = apps_of_xnodes(apps);
  const Case& c = pair.together;
  pair.accepted = check(c.app, c.platform, c.policy).has_value();
  return true;
}

/// Exactly what follows, of urgent releases, too; false: nothing is proven.
inline bool claim_all(Case& c) {
  c.policy.app_hash = c.app.hash();
  const auto claim = [&](std::size_t k, std::int64_t us, std::int64_t urgent_us) {
    const bool urgent = c.app.sources[at(c.app.chains[k].from)].urgent.has_value();
    c.policy.chains[k] = {c.app.chains[k].name, us, 0, false};
    if (urgent) c.policy.chains[k].urgent_worst_case_us = urgent_us;
  };
  for (std::size_t k = 0; k < c.app.chains.size(); ++k) claim(k, 900'000'000'000, 900'000'000'000);
  const Result<CheckReport> report = check(c.app, c.platform, c.policy);
  if (!report) return false;
  for (std::size_t k = 0; k < c.app.chains.size(); ++k)
    claim(k, report->chains[k].derived_us, report->chains[k].urgent_us.value_or(0));
  return true;
}

inline void add_holds(Case& c, std::uint64_t seed) {
  Random random(seed + 5);
  for (std::size_t i = 0; i < c.app.xnodes.size(); ++i) {
    Placement& p = c.policy.placements[i];
    const std::int64_t slack =
        p.key_us[0] - *c.app.xnodes[i].wcet_on(c.platform.xpus[at(p.xpu)].type);
    if (slack <= 1 || random.below(2) == 0) continue;
    const Placement before = p;
    p.hold_us = {static_cast<std::int64_t>(random.unit() * static_cast<double>(slack))};
    if (!claim_all(c)) p = before;
  }
  claim_all(c);
}

/// As late as the check lets them be.
inline void raise_holds(Case& c) {
  for (std::size_t i = 0; i < c.app.xnodes.size(); ++i) {
    Placement& p = c.policy.placements[i];
    if (p.hold_us.empty()) p.hold_us = {0};
    for (std::int64_t step = p.key_us[0] - p.hold_us[0]; step > 0; step /= 2) {
      const Placement before = p;
      p.hold_us[0] += step;
      if (!claim_all(c)) p = before;
    }
  }
  claim_all(c);
}

inline void add_urgent(Case& c, std::uint64_t seed) {
  Random random(seed + 7);
  for (SourceSpec& source : c.app.sources) {
    if (random.below(2) == 0) continue;
    const std::int64_t period = source.period.floor_us();
    source.urgent = UrgentSpec{1 + static_cast<std::int64_t>(random.below(40)),
                               (1 + static_cast<std::int64_t>(random.below(3))) * (period + 1)};
    if (!claim_all(c)) {
      source.urgent.reset();
      continue;
    }
    // As well a module that hears of it, where there is one with others behind it.
    if (random.below(2) == 0) continue;
    source.urgent->marked_by = c.app.xnodes[random.below(c.app.xnodes.size())].module;
    if (!claim_all(c)) source.urgent->marked_by.clear();
  }
  claim_all(c);
}

/// Of what pairs are made.
struct Kind {
  Wanted wanted;
  bool urgent = false;
};
inline Kind kind_of(std::uint64_t seed) {
  Kind kind;
  Wanted& w = kind.wanted;
  w.clocks = 1 + static_cast<int>(seed % 2);
  w.components = 1 + static_cast<int>(seed / 2 % 2);
  if (seed / 29 % 2 == 0) {  // what waits for nobody can be anywhere in its window
    w.components += 2;
    w.longest = 1;
  }
  w.ppm = seed / 4 % 4 == 3 ? 1000 : 0;
  w.load = 0.25 + 0.02 * static_cast<double>(seed / 16 % 11);
  w.preemptive = seed / 3 % 4 != 0;
  constexpr std::int64_t kCosts[] = {0, 8, 40, 300};
  w.preempt_us = w.preemptive ? kCosts[seed / 5 % 4] : 0;
  w.levels = w.preemptive && seed / 7 % 5 == 0 ? 2 : 0;
  w.jitter_us = seed / 11 % 3 == 0 ? 50 : 0;
  w.thirds = seed / 13 % 6 == 0;
  w.holds = seed / 17 % 2 == 0;
  w.order = seed / 19 % 5 == 0;
  kind.urgent = seed / 23 % 4 == 0;
  return kind;
}

/// With windows of `factor` times the WCETs, and `extra` beside; nothing: one of them does not hold alone.
inline std::optional<Pair> pair_of(std::uint64_t seed, double factor, std::int64_t extra) {
  const Kind kind = kind_of(seed);
  Pair pair;
  for (const std::uint64_t k : {0u, 1u}) {
    Case c = random_app(2 * seed + k, kind.wanted);
    c.app.name = k == 0 ? "a" : "b";
    c.policy.app = c.app.name;
    if (!widen(c, factor, extra)) return {};
    if (kind.wanted.order) add_order(c, 2 * seed + k);
    if (kind.wanted.holds) add_holds(c, 2 * seed + k);
    if (kind.urgent) add_urgent(c, 2 * seed + k);
    pair.each.push_back(std::move(c));
  }
  if (!join(pair)) return {};
  return pair;
}

struct Pairs {
  std::optional<Pair> accepted;  ///< with the tightest windows that the test accepts
  std::optional<Pair> refused;   ///< with the tightest windows that each holds with alone
  std::optional<Pair> just;      ///< refused, too, and a little tighter than what is accepted
};

inline Pairs random_pairs(std::uint64_t seed) {
  Pairs found;
  double low = 0, high = 0;
  const std::int64_t extra = seed % 3 == 0 ? 0 : static_cast<std::int64_t>(seed % 97);
  const auto look = [&](double factor) {
    std::optional<Pair> pair = pair_of(seed, factor, extra);
    const bool accepted = pair && pair->accepted;
    (accepted ? high : low) = factor;
    if (accepted)
      found.accepted = std::move(pair);
    else if (pair)
      (found.refused ? found.just : found.refused) = std::move(pair);
    return accepted;
  };
  for (const double factor : {1.0, 1.6, 2.6, 4.2, 7.0, 12.0})
    if (look(factor)) break;
  for (int k = 0; k < 4 && high > 0 && low > 0; ++k) look((low + high) / 2);
  // No key of it can be smaller; or, where jobs are held, no hold larger.
  if (!found.accepted) return found;
  const Kind kind = kind_of(seed);
  if (kind.wanted.holds)
    raise_holds(found.accepted->together);
  else if (!kind.urgent)
    tighten(found.accepted->together, seed, false);
  return found;
}

/// A wrong test: as if each app's preemptions were those of its own jobs alone.
inline bool accepted_if_charged_per_app(const Pair& pair) {
  std::map<std::string, std::vector<solver::keys::Pattern>> patterns;
  std::vector<Demand> demands;
  std::int64_t ticks = 1;
  for (const Case& c : pair.each) {
    demands.push_back(solver::keys::demand_of(c.app, c.platform, c.policy).value());
    ticks = std::lcm(ticks, demands.back().ticks_per_us);
  }
  for (const Demand& demand : demands)
    for (const DemandOnXpu& on : demand.xpus)
      for (const DemandSequence& s : on.sequences) {
        const std::int64_t by = ticks / demand.ticks_per_us;
        solver::keys::Pattern g{s.period * by, s.ppm, s.slip * by, s.once, 0, {}};
        for (const DemandJob& j : s.jobs) {
          g.deepest = std::max(g.deepest, j.key * by);
          g.jobs.push_back(
              {(j.release + j.ready) % s.period * by, (j.key - j.ready) * by, j.work * by});
        }
        patterns[on.xpu.id].push_back(std::move(g));
      }
  return std::ranges::all_of(
      patterns, [](auto& of_xpu) { return solver::keys::demand_fits(of_xpu.second, {}); });
}

/// What came of many pairs.
struct Tally {
  int pairs = 0, accepted = 0, broken = 0;
  int refused = 0, exhibited = 0;     ///< late in some execution
  int alone = 0, alone_late = 0;      ///< of these, where no XNode waits for another one
  int per_app = 0, per_app_late = 0;  ///< refused, and accepted by the wrong test
  std::int64_t jobs = 0;
  std::string first;  ///< broken pair, in words
};

/// `jobs`: to simulate, for each question.
inline void play_pairs(std::uint64_t seed, std::int64_t jobs, Tally& tally) {
  const Pairs pairs = random_pairs(seed);
  if (!pairs.accepted && !pairs.refused) return;
  ++tally.pairs;
  const auto attacked = [&](const Pair& pair, Early early) {
    const Case& c = pair.together;
    const Found found = attack(c.app, c.platform, c.policy, {jobs, seed, early, pair.app_of});
    tally.jobs += found.jobs;
    return found;
  };
  if (pairs.accepted) {
    const Pair& pair = *pairs.accepted;
    ++tally.accepted;
    Found found = attacked(pair, Early::kByTheRule);
    const auto played =
        solver::keys::play(pair.together.app, pair.together.platform, pair.together.policy,
                           {.seconds = 1,
                            .random_times = seed % 2 == 1,
                            .jitter = true,
                            .phases = true,
                            .seed = seed,
                            .urgent = true,
                            .app_of = pair.app_of});
    if (played) tally.jobs += played->jobs;
    if (found.broken() || !played || played->late > 0) {
      ++tally.broken;
      if (tally.first.empty())
        tally.first = "seed " + std::to_string(seed) + ": " + found.late + found.chain +
                      (played ? played->first_late : played.error().to_string());
    }
  }
  if (pairs.refused) {
    const Pair& pair = *pairs.refused;
    ++tally.refused;
    const bool late = attacked(pair, Early::kNever).broken();
    tally.exhibited += late ? 1 : 0;
    const Wanted wanted = kind_of(seed).wanted;
    tally.alone += wanted.longest == 1 ? 1 : 0;
    tally.alone_late += wanted.longest == 1 && late ? 1 : 0;
  }
  const Wanted wanted = kind_of(seed).wanted;
  if (pairs.just && wanted.preemptive && wanted.levels == 0 && wanted.preempt_us > 0 &&
      accepted_if_charged_per_app(*pairs.just)) {
    ++tally.per_app;
    tally.per_app_late += attacked(*pairs.just, Early::kNever).broken() ? 1 : 0;
  }
}

}  // namespace xauto::attack
