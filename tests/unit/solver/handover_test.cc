// SPDX-License-Identifier: Apache-2.0
// What a change of tables may cost: the solver's bound against the checker's, and both against plays
// that share no code with them (handover_naive.h).
#include "solver/keys/handover.h"

#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "base/index.h"
#include "model/components.h"
#include "model/drain.h"
#include "model/periodic.h"
#include "model/tables.h"
#include "solver/keys/certificate.h"
#include "solver/keys/check_handover.h"
#include "solver/keys/solve.h"

#include "handover_naive.h"
#include "keys_random.h"

namespace xauto::solver::keys {
namespace {

constexpr std::int64_t kTinyNotice = 2;

/// An app, its twin with other WCETs, and a policy for each; nullopt: none was found.
struct TwoPolicies {
  AppSpec from_app, to_app, both;
  Platform platform;
  std::int64_t notice_us = kTinyNotice;
  Policy from, to;
};

using Forbids = std::vector<std::pair<std::string, std::string>>;

std::optional<Policy> solved_quickly(const AppSpec& app, const Platform& platform,
                                     std::uint64_t seed, const Forbids& forbids = {}) {
  Options options;
  options.wishes.forbids = forbids;
  options.max_evaluations = 300;
  options.seed = seed;
  options.order = false;
  const auto answer = solve(app, platform, options);
  if (!answer || answer->outcome != Outcome::kPolicy) return std::nullopt;
  return answer->policy;
}

enum class Clocks : std::uint8_t {
  kOne,
  kShared,    ///< two, which may share XPUs
  kApart,     ///< two with XPUs of their own; the second has a tolerance
  kDrifting,  ///< one with a tolerance
};

std::optional<TwoPolicies> two_policies(std::uint64_t seed, Clocks clocks = Clocks::kOne,
                                        int ppm = 0) {
  solver::test::Dice dice(seed);
  RatedShape shape;
  shape.clocks = clocks == Clocks::kOne ? 1 : 2;
  shape.ppm = ppm;
  shape.max_components = 3;
  shape.least_period = 12;
  TwoPolicies two;
  two.platform = random_rated_platform(dice);
  if (seed % 3 == 0)  // what blocks shows where most XPUs do not preempt
    for (Xpu& xpu : two.platform.xpus) xpu.preemptive = false;
  if (seed % 6 == 2)  // or have few levels
    for (Xpu& xpu : two.platform.xpus) xpu.levels = xpu.preemptive ? 2 : 0;
  two.from_app = random_rated_app(dice, shape);
  const std::int64_t factor = ppm > 0 ? 1000 : 1;
  stretch(two.from_app, two.platform, factor);
  two.notice_us *= factor;
  Forbids forbids;
  if (clocks == Clocks::kDrifting)
    for (SourceSpec& source : two.from_app.sources) source.clock = 1;
  if (clocks == Clocks::kApart) {
    std::vector<Xpu> others = two.platform.xpus;
    for (Xpu& xpu : others) xpu.id = "other-" + xpu.id;
    const Components found = *find_components(two.from_app);
    for (std::size_t i = 0; i < two.from_app.xnodes.size(); ++i) {
      const int clock = found.domains[at(found.components[at(found.of[i])].domain)].clock;
      for (const Xpu& xpu : clock == 0 ? others : two.platform.xpus)
        forbids.emplace_back(two.from_app.xnodes[i].name, xpu.id);
    }
    two.platform.xpus.insert(two.platform.xpus.end(), others.begin(), others.end());
  }
  if (seed % 3 == 1)  // and what waits for a module in pipelines
    for (ModuleSpec& module : two.from_app.modules) module.max_in_flight = 2;
  two.to_app = two.both = two.from_app;
  for (std::size_t i = 0; i < two.to_app.xnodes.size(); ++i)
    for (auto& [type, us] : two.to_app.xnodes[i].wcet_us) {
      us = std::max(factor, us + factor * dice.roll(-1, 3));
      std::int64_t& larger = two.both.xnodes[i].wcet_us.at(type);
      larger = std::max(larger, us);
    }
  const auto from = solved_quickly(two.from_app, two.platform, seed, forbids),
             to = solved_quickly(two.to_app, two.platform, seed + 1, forbids);
  if (!from || !to) return std::nullopt;
  two.from = *from;
  two.to = *to;
  return two;
}

/// `why`: of windows that do not hold; there are none.
Windows windows_by(const Problem& p, const Policy& keys, std::vector<int>& xpu) {
  Windows w = keys_and_holds(p, keys);
  for (const Placement& placed : keys.placements) xpu.push_back(placed.xpu);
  std::string why;
  EXPECT_TRUE(certify(p, xpu, w, &why)) << why;
  return w;
}

struct Bounds {
  std::vector<std::optional<std::int64_t>> us;
  std::int64_t settles_us = 0;  ///< 0: of some clock nothing follows
};

Bounds bounds_of(const TwoPolicies& two) {
  const Problem now = *Problem::create(two.from_app, two.platform),
                then = *Problem::create(two.to_app, two.platform),
                both = *Problem::create(two.both, two.platform);
  HandoverInput in{now, then, both, {}, {}, {}, {}, two.notice_us * now.scale};
  in.from = windows_by(now, two.from, in.from_xpu);
  in.to = windows_by(then, two.to, in.to_xpu);
  const HandoverBound bound = bound_handover(in, 200'000);
  Bounds bounds;
  for (const Tick t : bound.worst)
    bounds.us.push_back(t == kNoTick ? std::nullopt : std::optional(now.up_to_us(t) / now.scale));
  if (bound.why_not.empty()) bounds.settles_us = now.up_to_us(bound.settles) / now.scale;
  return bounds;
}

Result<HandoverProof> checked(const TwoPolicies& two) {
  return derive_handover(
      {two.from_app, two.to_app, two.both, two.platform, two.from, two.to, two.notice_us},
      1'000'000);
}

/// The checker claims all that the solver claims, and nothing longer.
void expect_checked(const TwoPolicies& two, const Bounds& bounds, std::uint64_t seed) {
  const auto proof = checked(two);
  ASSERT_TRUE(proof) << proof.error().to_string();
  if (bounds.settles_us > 0) {
    EXPECT_LE(proof->settles_us, bounds.settles_us) << "seed " << seed;
  }
  for (std::size_t c = 0; c < bounds.us.size(); ++c) {
    if (!bounds.us[c]) continue;
    ASSERT_TRUE(proof->worst_case_us[c]) << "seed " << seed << ", chain " << c;
    EXPECT_LE(*proof->worst_case_us[c], *bounds.us[c]) << "seed " << seed << ", chain " << c;
  }
}

/// What a climb finds; no play is longer than a bound, nor settles later.
HandoverFound expect_none_longer(const NaiveTables& naive, const Bounds& bounds,
                                 const HandoverAttack& attack) {
  HandoverClimb climb(naive, bounds.us, attack);
  const HandoverFound found = climb.run();
  EXPECT_FALSE(found.deadlock || found.illegal) << "seed " << attack.seed;
  EXPECT_LE(found.worst, 1) << "seed " << attack.seed;
  if (bounds.settles_us > 0) {
    EXPECT_LE(found.settles_us, static_cast<double>(bounds.settles_us)) << "seed " << attack.seed;
  }
  return found;
}

NaiveTables naive_of(const TwoPolicies& two) {
  return {two.from_app, two.to_app, two.both, two.platform, two.from, two.to};
}

/// Of each chain the longer one of both tables' own.
std::vector<std::optional<std::int64_t>> own_worst_cases(const TwoPolicies& two) {
  std::vector<std::optional<std::int64_t>> own;
  for (std::size_t c = 0; c < two.from.chains.size(); ++c)
    own.emplace_back(std::max(two.from.chains[c].worst_case_us, two.to.chains[c].worst_case_us));
  return own;
}

TEST(KeysHandover, NoPlayIsLongerThanTheSolversBoundAndTheCheckerDerivesNoMore) {
  int bounded = 0, broken = 0, chains = 0, slower = 0;
  for (std::uint64_t seed = 1; seed <= 40; ++seed) {
    const auto two = two_policies(seed);
    if (!two) continue;
    const Bounds bounds = bounds_of(*two);
    chains += static_cast<int>(bounds.us.size());
    if (bounds.settles_us == 0) continue;  // it does not settle
    for (const auto& us : bounds.us) bounded += us ? 1 : 0;
    ASSERT_NO_FATAL_FAILURE(expect_checked(*two, bounds, seed));
    const NaiveTables naive = naive_of(*two);
    HandoverAttack attack{two->notice_us, 150, seed};
    expect_none_longer(naive, bounds, attack);
    // That neither table alone bounds a change shows that the plays find something.
    HandoverClimb weaker(naive, own_worst_cases(*two), attack);
    broken += weaker.run().worst > 1;
    // Nor is it better to let everything end first.
    attack.drains = true;
    HandoverClimb drained(naive, bounds.us, attack);
    slower += drained.run().worst > 1;
  }
  EXPECT_GE(slower, 5);
  EXPECT_GE(bounded, 30);
  EXPECT_GE(bounded * 10, chains * 6) << bounded << " of " << chains;
  EXPECT_GE(broken, 5);
}

/// Whether an XPU is of both clocks, in one of the tables or in both together.
bool share_an_xpu(const TwoPolicies& two) {
  const Components found = *find_components(two.from_app);
  std::vector<int> user(two.platform.xpus.size(), -1);
  for (std::size_t i = 0; i < two.from_app.xnodes.size(); ++i) {
    const int domain = found.components[at(found.of[i])].domain;
    for (const Policy* keys : {&two.from, &two.to}) {
      int& other = user[at(keys->placements[i].xpu)];
      if (other >= 0 && other != domain) return true;
      other = domain;
    }
  }
  return false;
}

/// Clocks that drift, and chains through several: attacked by plays in which clocks do that.
void attack_clocks(Clocks clocks, int ppm, std::uint64_t first, int least_bounded) {
  int bounded = 0, unclaimed = 0, broken = 0;
  for (std::uint64_t seed = first; seed < first + 40; ++seed) {
    const auto two = two_policies(seed, clocks, ppm);
    if (!two) continue;
    const Bounds bounds = bounds_of(*two);
    for (const auto& us : bounds.us) (us ? bounded : unclaimed) += 1;
    ASSERT_NO_FATAL_FAILURE(expect_checked(*two, bounds, seed));
    const NaiveTables naive = naive_of(*two);
    const HandoverAttack attack{two->notice_us, 150, seed};
    expect_none_longer(naive, bounds, attack);
    HandoverClimb weaker(naive, own_worst_cases(*two), attack);
    broken += weaker.run().worst > 1;
  }
  EXPECT_GE(bounded, least_bounded) << unclaimed << " are not claimed";
  EXPECT_GE(broken, 2);
}

TEST(KeysHandover, OnAClockWithATolerance) {
  attack_clocks(Clocks::kDrifting, 100, 1000, 40);
  attack_clocks(Clocks::kDrifting, 20'000, 1100, 40);
}

TEST(KeysHandover, ThroughSeveralClocks) {
  attack_clocks(Clocks::kApart, 0, 1200, 40);
  attack_clocks(Clocks::kApart, 100, 1300, 40);
  attack_clocks(Clocks::kApart, 20'000, 1400, 40);
}

/// The same where some modules, with all that wait for them, are off in one of the tables: `both_have`
/// says which chains have none of them. nullopt: nothing to turn off, or no policy.
std::optional<TwoPolicies> two_policies_with_losses(std::uint64_t seed,
                                                    std::vector<char>& both_have) {
  auto two = two_policies(seed);
  if (!two) return std::nullopt;
  solver::test::Dice dice(seed);
  AppSpec app = two->from_app;
  complete_modules(app);
  // An XNode and all behind it, by modules.
  std::set<std::string> off;
  off.insert(app.xnodes[at(dice.roll(0, static_cast<int>(app.xnodes.size()) - 1))].module);
  for (std::size_t round = 0; round < app.xnodes.size(); ++round)
    for (const auto& [u, v] : app.edges)
      if (off.contains(app.xnodes[at(u)].module)) off.insert(app.xnodes[at(v)].module);
  Loss loss;
  loss.off.assign(off.begin(), off.end());
  const bool first = seed % 2 == 0;
  both_have.assign(app.chains.size(), 0);
  for (const int c : kept_chains(app, loss)) both_have[at(c)] = 1;
  const auto with = [&](AppSpec& of, bool lossy) {
    of.modules = app.modules;
    of = app_of_all_chains(of, lossy ? loss : Loss{});
  };
  with(two->from_app, first);
  with(two->both, first);  // jobs of the first table
  with(two->to_app, !first);
  two->platform = platform_with(two->platform, loss.off);
  const auto from = solved_quickly(two->from_app, two->platform, seed),
             to = solved_quickly(two->to_app, two->platform, seed + 1);
  if (!from || !to) return std::nullopt;
  two->from = *from;
  two->to = *to;
  return two;
}

TEST(KeysHandover, WhatIsOffInOneTableMakesNothingElseLater) {
  int bounded = 0, off = 0;
  for (std::uint64_t seed = 300; seed < 350; ++seed) {
    std::vector<char> both_have;
    const auto two = two_policies_with_losses(seed, both_have);
    if (!two) continue;
    Bounds bounds = bounds_of(*two);
    if (bounds.settles_us == 0) continue;
    const auto proof = checked(*two);
    ASSERT_TRUE(proof) << proof.error().to_string();
    EXPECT_LE(proof->settles_us, bounds.settles_us) << "seed " << seed;
    for (std::size_t c = 0; c < bounds.us.size(); ++c) {
      if (both_have[c] == 0) bounds.us[c].reset();
      off += both_have[c] == 0;
      if (!bounds.us[c]) continue;
      ++bounded;
      ASSERT_TRUE(proof->worst_case_us[c]) << "seed " << seed << ", chain " << c;
      EXPECT_LE(*proof->worst_case_us[c], *bounds.us[c]) << "seed " << seed << ", chain " << c;
    }
    const NaiveTables naive{two->from_app, two->to_app, two->both,
                            two->platform, two->from,   two->to};
    HandoverClimb climb(naive, bounds.us, {two->notice_us, 150, seed});
    const HandoverFound found = climb.run();
    EXPECT_FALSE(found.deadlock || found.illegal) << "seed " << seed;
    EXPECT_LE(found.worst, 1) << "seed " << seed;
    EXPECT_LE(found.settles_us, static_cast<double>(bounds.settles_us)) << "seed " << seed;
  }
  EXPECT_GE(bounded, 20);
  EXPECT_GE(off, 20);
}

TEST(KeysHandover, FromATableToItselfWithTheSameTimesNothingIsLonger) {
  int same = 0;
  for (std::uint64_t seed = 100; seed < 160; ++seed) {
    auto two = two_policies(seed);
    if (!two) continue;
    two->to_app = two->both = two->from_app;
    two->to = two->from;
    const Bounds bounds = bounds_of(*two);
    for (std::size_t c = 0; c < bounds.us.size(); ++c) {
      ASSERT_TRUE(bounds.us[c]) << "seed " << seed;
      EXPECT_GE(*bounds.us[c], two->from.chains[c].worst_case_us) << "seed " << seed;
      // What preemptions cost, and who blocks, is counted anew.
      if (!std::all_of(two->platform.xpus.begin(), two->platform.xpus.end(), [](const Xpu& xpu) {
            return xpu.preemptive && xpu.preempt_us == 0 && xpu.levels == 0;
          }))
        continue;
      ++same;
      EXPECT_EQ(*bounds.us[c], two->from.chains[c].worst_case_us) << "seed " << seed;
    }
  }
  EXPECT_GT(same, 10);
}

TEST(KeysHandover, OfClocksThatShareAnXpuNothingFollows) {
  int sharing = 0;
  for (std::uint64_t seed = 3000; seed < 3060; ++seed) {
    const auto two = two_policies(seed, Clocks::kShared);
    if (!two || !share_an_xpu(*two)) continue;
    ++sharing;
    const Bounds bounds = bounds_of(*two);
    EXPECT_EQ(bounds.settles_us, 0) << "seed " << seed;
    ASSERT_NO_FATAL_FAILURE(expect_checked(*two, bounds, seed));
    const auto proof = checked(*two);
    for (std::size_t c = 0; c < bounds.us.size(); ++c)
      EXPECT_FALSE(bounds.us[c] || proof->worst_case_us[c]) << "seed " << seed << ", chain " << c;
  }
  EXPECT_GE(sharing, 10);
}

/// Clocks may share XPUs, and some of these do not preempt.
TEST(KeysHandover, NoPlayDrainsForLongerThanIsSaid) {
  int played = 0;
  double fullest = 0;
  for (const auto& [clocks, ppm] :
       {std::pair(Clocks::kOne, 0), std::pair(Clocks::kShared, 0), std::pair(Clocks::kShared, 100),
        std::pair(Clocks::kShared, 20'000)})
    for (std::uint64_t seed = 4000; seed < 4040; ++seed) {
      const auto two = two_policies(seed, clocks, ppm);
      if (!two) continue;
      const auto said =
          static_cast<double>(drain_us(two->both, two->platform, two->from, two->notice_us));
      HandoverAttack attack{two->notice_us, 150, seed};
      attack.drains = true;
      HandoverClimb climb(naive_of(*two), own_worst_cases(*two), attack);
      const HandoverFound found = climb.run();
      EXPECT_LE(found.drained_us, said) << "seed " << seed << ", " << ppm << " ppm";
      fullest = std::max(fullest, found.drained_us / said);
      ++played;
    }
  EXPECT_GE(played, 100);
  EXPECT_GE(fullest, 0.5);
}

}  // namespace
}  // namespace xauto::solver::keys
