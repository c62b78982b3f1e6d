// SPDX-License-Identifier: Apache-2.0
// What a change of tables may cost: the solver's bound against the checker's, and both against plays
// that share no code with them (handover_naive.h).
#include "solver/steady/handover.h"

#include <array>
#include <cstdlib>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "base/index.h"
#include "model/components.h"
#include "model/periodic.h"
#include "model/tables.h"
#include "solver/steady/certificate.h"
#include "solver/steady/chains.h"
#include "solver/steady/check_handover.h"
#include "solver/steady/solve.h"

#include "handover_naive.h"
#include "steady_random.h"

namespace xauto::solver::steady {
namespace {

constexpr std::int64_t kTinyNotice = 2;

/// An app, its twin with other WCETs, and a policy for each; nullopt: none was found.
struct TwoPolicies {
  AppSpec from_app, to_app, both;
  Platform platform;
  std::int64_t notice_us = kTinyNotice;
  KeyPolicy from, to;
};

using Forbids = std::vector<std::pair<std::string, std::string>>;

std::optional<KeyPolicy> solved_quickly(const AppSpec& app, const Platform& platform,
                                        std::uint64_t seed, const Forbids& forbids = {},
                                        bool lets_in = false) {
  Options options;
  options.lets_in = lets_in;
  options.wishes.forbids = forbids;
  options.max_evaluations = 300;
  options.seed = seed;
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

/// Longer by what a preemption costs, and some percent: what theorem 10 wants to be left.
AppSpec with_slack(AppSpec app, const Platform& platform) {
  for (XNodeSpec& xnode : app.xnodes)
    for (auto& [type, us] : xnode.wcet_us) {
      std::int64_t cost = 0;
      for (const Xpu& xpu : platform.xpus)
        if (xpu.type == type) cost = std::max(cost, xpu.preempt_us);
      us = ((us + cost) * 100 + 98) / 99;
    }
  return app;
}

/// `lets_in`: as Options.
std::optional<TwoPolicies> two_policies(std::uint64_t seed, Clocks clocks = Clocks::kOne,
                                        int ppm = 0, bool lets_in = false) {
  solver::test::Dice dice(seed);
  SteadyShape shape;
  shape.clocks = clocks == Clocks::kOne ? 1 : 2;
  shape.ppm = ppm;
  shape.max_components = 3;
  shape.least_period = 12;
  TwoPolicies two;
  two.platform = random_steady_platform(dice);
  if (seed % 3 == 0)  // what blocks shows where most XPUs do not preempt
    for (Xpu& xpu : two.platform.xpus) xpu.preemptive = false;
  two.from_app = random_steady_app(dice, shape);
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
      us = std::max(factor, us + factor * dice.roll(-1, clocks == Clocks::kShared ? 6 : 3));
      std::int64_t& larger = two.both.xnodes[i].wcet_us.at(type);
      larger = std::max(larger, us);
    }
  const bool spare = clocks == Clocks::kShared;
  const auto from = solved_quickly(spare ? with_slack(two.from_app, two.platform) : two.from_app,
                                   two.platform, seed, forbids, lets_in),
             to = solved_quickly(spare ? with_slack(two.to_app, two.platform) : two.to_app,
                                 two.platform, seed + 1, forbids, lets_in);
  if (!from || !to) return std::nullopt;
  two.from = *from;
  two.to = *to;
  two.from.app_hash = two.from_app.hash();
  two.to.app_hash = two.to_app.hash();
  return two;
}

/// `why`: of windows that do not hold; there are none.
Windows windows_by(const Problem& p, const KeyPolicy& keys, std::vector<int>& xpu) {
  Windows w = keys_and_holds(p, keys);
  for (const KeyPlacement& placed : keys.placements) xpu.push_back(placed.xpu);
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

TEST(SteadyHandover, NoPlayIsLongerThanTheSolversBoundAndTheCheckerDerivesNoMore) {
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
    for (const KeyPolicy* keys : {&two.from, &two.to}) {
      int& other = user[at(keys->placements[i].xpu)];
      if (other >= 0 && other != domain) return true;
      other = domain;
    }
  }
  return false;
}

/// Clocks that drift, and chains through several: attacked by plays in which clocks do that. `shared`: only
/// where they share an XPU.
void attack_clocks(Clocks clocks, int ppm, std::uint64_t first, int least_bounded,
                   std::uint64_t seeds = 40, bool shared = false) {
  int bounded = 0, unclaimed = 0, broken = 0;
  for (std::uint64_t seed = first; seed < first + seeds; ++seed) {
    const auto two = two_policies(seed, clocks, ppm);
    if (!two || (shared && !share_an_xpu(*two))) continue;
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

TEST(SteadyHandover, OnAClockWithATolerance) {
  attack_clocks(Clocks::kDrifting, 100, 1000, 40);
  attack_clocks(Clocks::kDrifting, 20'000, 1100, 40);
}

TEST(SteadyHandover, ThroughSeveralClocks) {
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

TEST(SteadyHandover, WhatIsOffInOneTableMakesNothingElseLater) {
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

TEST(SteadyHandover, FromATableToItselfWithTheSameTimesNothingIsLonger) {
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
      if (!std::all_of(two->platform.xpus.begin(), two->platform.xpus.end(),
                       [](const Xpu& xpu) { return xpu.preemptive && xpu.preempt_us == 0; }))
        continue;
      ++same;
      EXPECT_EQ(*bounds.us[c], two->from.chains[c].worst_case_us) << "seed " << seed;
    }
  }
  EXPECT_GT(same, 10);
}

TEST(SteadyHandover, OfClocksThatMayShareXpus) {
  attack_clocks(Clocks::kShared, 0, 2000, 60);
  attack_clocks(Clocks::kShared, 100, 2100, 60);
  attack_clocks(Clocks::kShared, 20'000, 2200, 60);
}

TEST(SteadyHandover, OfClocksThatShareXpus) {
  attack_clocks(Clocks::kShared, 0, 3000, 40, 240, true);
  attack_clocks(Clocks::kShared, 100, 3300, 40, 240, true);
  attack_clocks(Clocks::kShared, 20'000, 3600, 40, 240, true);
}

/// With much slack lateness falls sooner, and with little of it there is less: the checker takes the best of both.
TEST(SteadyHandover, WhereXpusDoNotPreemptTheLeastSlackBoundsLateness) {
  double longer = 0;
  int chains = 0;
  for (std::uint64_t seed = 3000; seed < 3240; seed += 3) {
    auto two = two_policies(seed, Clocks::kShared, 100, true);
    if (!two || !share_an_xpu(*two)) continue;
    for (AppSpec* app : {&two->from_app, &two->to_app, &two->both})
      for (XNodeSpec& xnode : app->xnodes)
        for (auto& [type, us] : xnode.wcet_us) us -= us / 8;
    two->from.app_hash = two->from_app.hash();
    two->to.app_hash = two->to_app.hash();
    const Bounds bounds = bounds_of(*two);
    ASSERT_NO_FATAL_FAILURE(expect_checked(*two, bounds, seed));
    const auto proof = checked(*two);
    ASSERT_TRUE(proof) << proof.error().to_string();
    for (std::size_t c = 0; c < bounds.us.size(); ++c) {
      if (!bounds.us[c]) continue;
      ++chains;
      longer += static_cast<double>(*bounds.us[c]) / static_cast<double>(*proof->worst_case_us[c]);
    }
  }
  EXPECT_LE(longer, 1.01 * chains);  // of one slack alone, the largest: 1.06
  EXPECT_GE(chains, 50);
}

TEST(SteadyHandover, WhereXpusDoNotPreemptRoomForWhomLatenessLetsInLetsMoreChangesHaveAWorstCase) {
  std::array<int, 2> chains = {}, bounded = {};            // [with room]
  for (std::uint64_t seed = 3000; seed < 3240; seed += 3)  // most XPUs do not preempt
    for (const std::size_t room : {0, 1}) {
      const auto two = two_policies(seed, Clocks::kShared, 100, room != 0);
      if (!two || !share_an_xpu(*two)) continue;
      const Bounds bounds = bounds_of(*two);
      chains[room] += static_cast<int>(bounds.us.size());
      for (const auto& us : bounds.us) bounded[room] += us ? 1 : 0;
      ASSERT_NO_FATAL_FAILURE(expect_checked(*two, bounds, seed));
      if (room != 0) expect_none_longer(naive_of(*two), bounds, {two->notice_us, 150, seed});
    }
  // 32 of 58 and 64 of 82.
  EXPECT_LE(bounded[0] * 10, chains[0] * 6);
  EXPECT_GE(bounded[1] * 10, chains[1] * 7) << bounded[1] << " of " << chains[1];
  EXPECT_GE(chains[1], 50);
}

/// A module of one clock in a loop as long as its period, held in the first table: in the second one its entry
/// has a key before which the last activation of the first one may not have ended. Another XNode of that clock
/// shares a CPU with another clock.
TwoPolicies waits_past_its_key(std::uint64_t seed, int ppm) {
  solver::test::Dice dice(seed);
  TwoPolicies two;
  two.platform = {"p",
                  {{"cpu0", "cpu", true, 0},
                   {"cpu1", "cpu", true, 0},
                   {"gpu0", "gpu", true, 20},
                   {"cpu2", "cpu", true, 0}}};
  AppSpec& app = two.from_app;
  app.version = 2;
  app.name = "waits";
  app.clocks = {{"main", 0}, {"own", ppm}};
  const bool drifts_itself = dice.roll(0, 1) != 0;  // whose clock has the tolerance
  const std::int64_t period = 12'000, flight = dice.roll(1, 2);
  app.sources = {{"s", {period, 1}, 0, dice.roll(0, 1) * 100, drifts_itself ? 1 : 0},
                 {"t", {dice.roll(50, 90) * 100, 1}, 0, 0, drifts_itself ? 0 : 1}};
  const std::int64_t least = dice.roll(4, 9) * 100, mid = dice.roll(4, 9) * 100;
  const std::int64_t span = flight * period;  // from a release until the one that waits for it
  const std::int64_t lost = span * ppm / 1'000'000 * 3;
  const std::int64_t longest =
      (flight > 1 ? 10'300 : period - least - mid) - dice.roll(10, 14) * 100 - lost;
  app.xnodes = {{"m.e", "M", {{"cpu", least}}, {0}},
                {"m.h", "M", {{"cpu", mid}}},
                {"m.f", "M", {{"gpu", longest}}},
                {"g", "G", {{"cpu", dice.roll(1, 2) * 20}}, {1}},
                {"k", "K", {{"cpu", 1000}}, {0}}};
  app.edges = {{0, 1}, {1, 2}};
  app.transfers = {{1, "cpu", "gpu", dice.roll(0, 1) * 50}};
  app.modules = {{"M", flight}, {"G", 1}, {"K", 1}};
  app.chains = {{"s -> m.f", 0, 2}, {"s -> m.e", 0, 0}, {"t -> g", 1, 3}, {"s -> k", 0, 4}};
  two.to_app = two.both = app;
  std::int64_t& shorter = two.to_app.xnodes[2].wcet_us.at("gpu");
  shorter = longest * dice.roll(5, 8) / 10;
  const std::int64_t held = dice.roll(15, 25) * 100 + lost;
  const std::int64_t room = 160 + 3 * least / 100, passes = app.transfers[0].transfer_us;
  std::int64_t key = held + least + room;
  two.from.placements = {{0, {key}, {held}},
                         {1, {key + mid + 60 + mid / 50}},
                         {2, {span + held - dice.roll(0, 3) * 100 - lost}},
                         {3, {4000}},
                         {3, {3000}}};
  key = app.sources[0].jitter_us + least + room;
  two.to.placements = {{0, {key}},
                       {1, {key + mid + 60 + mid / 50}},
                       {2, {key + mid + 120 + mid / 50 + passes + shorter + shorter / 20 + lost}},
                       {3, {4000}},
                       {3, {3000}}};
  for (KeyPolicy* keys : {&two.from, &two.to}) keys->app = app.name;
  two.from.app_hash = app.hash();
  two.to.app_hash = two.to_app.hash();
  for (const auto& [of, keys] : {std::pair(&app, &two.from), std::pair(&two.to_app, &two.to)}) {
    const Problem p = *Problem::create(*of, two.platform);
    std::vector<int> xpu;
    const Windows w = windows_by(p, *keys, xpu);
    for (const Chain& chain : p.chains)
      keys->chains.push_back({chain.name, p.up_to_us(worst_case(p, chain, w)) / p.scale});
  }
  return two;
}

TEST(SteadyHandover, WhoWaitsForTheTableBeforeUntilAfterItsKey) {
  for (const int ppm : {0, 100, 5'000}) {
    int claimed = 0;
    for (std::uint64_t seed = 1; seed <= 40; ++seed) {
      const TwoPolicies two = waits_past_its_key(seed, ppm);
      const Bounds bounds = bounds_of(two);
      if (bounds.settles_us == 0) continue;
      ++claimed;
      ASSERT_NO_FATAL_FAILURE(expect_checked(two, bounds, seed));
      expect_none_longer(naive_of(two), bounds, {two.notice_us, 100, seed});
    }
    EXPECT_GE(claimed, 36) << ppm;
  }
}

/// Adds what only certify() and worst_case() know.
void finish(TwoPolicies& two) {
  for (KeyPolicy* keys : {&two.from, &two.to}) keys->app = two.from_app.name;
  two.from.app_hash = two.from_app.hash();
  two.to.app_hash = two.to_app.hash();
  for (const auto& [of, keys] :
       {std::pair(&two.from_app, &two.from), std::pair(&two.to_app, &two.to)}) {
    const Problem p = *Problem::create(*of, two.platform);
    std::vector<int> xpu;
    const Windows w = windows_by(p, *keys, xpu);
    for (const Chain& chain : p.chains)
      keys->chains.push_back({chain.name, p.up_to_us(worst_case(p, chain, w)) / p.scale});
  }
}

/// A CPU that does not preempt, of two clocks. One of them has short windows beside a job that is short in the
/// first table, and very long in the second one, where these are elsewhere.
TwoPolicies long_job_in_the_way(std::uint64_t seed, int ppm) {
  solver::test::Dice dice(seed);
  TwoPolicies two;
  two.platform = {"p", {{"cpu0", "cpu", false, 0}, {"cpu1", "cpu", false, 0}}};
  AppSpec& app = two.from_app;
  app.version = 2;
  app.name = "blocks";
  app.clocks = {{"main", 0}, {"own", ppm}};
  const std::int64_t period = 30'000, small = dice.roll(2, 6) * 50, other = dice.roll(2, 6) * 50;
  const std::int64_t before = dice.roll(12, 20) * 100, after = dice.roll(60, 100) * 100;
  const bool apart = dice.roll(0, 1) != 0;  // whether both of the clock come round together
  app.sources = {{"s", {period, 1}, 0, 0, 0},
                 {"l", {apart ? period + 1000 : period, 1}, period - dice.roll(1, 10) * 100, 0, 0},
                 {"t", {dice.roll(250, 350) * 100, 1}, 0, 0, 1}};
  app.xnodes = {{"a", "A", {{"cpu", small}}, {0}},
                {"z", "Z", {{"cpu", before}}, {1}},
                {"b", "B", {{"cpu", other}}, {2}}};
  app.modules = {{"A", 1}, {"Z", 1}, {"B", 1}};
  app.chains = {{"s -> a", 0, 0}, {"l -> z", 1, 1}, {"t -> b", 2, 2}};
  two.to_app = two.both = app;
  two.to_app.xnodes[1].wcet_us.at("cpu") = two.both.xnodes[1].wcet_us.at("cpu") = after;
  const auto room = [&](std::int64_t work) {
    return work + work / 12 + 20 + 3 * work * ppm / kMillion;
  };
  const std::int64_t tight = room(before + small + other), wide = room(after + small + other);
  two.from.placements = {{0, {tight}}, {0, {wide + 4000}}, {0, {tight + dice.roll(0, 2) * 50}}};
  two.to.placements = {{1, {room(small)}}, {0, {wide + dice.roll(0, 2) * 500}}, {0, {wide}}};
  finish(two);
  return two;
}

/// Of an app on a GPU that clocks share: `u` takes longer in the second table. `x` waits for it on a DLA that does
/// not preempt, and `z` is long there; `g` is the other clock's on the GPU, and so is `h` on the DLA if there.
struct GpuAndDlas {
  std::int64_t first, second, other, x, z, passes, small = 0;
};
void fill(TwoPolicies& two, const char* name, const GpuAndDlas& takes, std::int64_t period,
          std::int64_t other_period) {
  two.platform = {
      "p", {{"gpu0", "gpu", true, 20}, {"dla0", "dla", false, 0}, {"dla1", "dla", false, 0}}};
  AppSpec& app = two.from_app;
  app.version = 2;
  app.name = name;
  app.sources = {{"s", {period, 1}, 0, 0, 0}, {"t", {other_period, 1}, 0, 0, 1}};
  app.xnodes = {{"u", "U", {{"gpu", takes.first}}, {0}},
                {"x", "X", {{"dla", takes.x}}},
                {"z", "Z", {{"dla", takes.z}}, {0}},
                {"g", "G", {{"gpu", takes.other}}, {1}}};
  app.edges = {{0, 1}};
  app.transfers = {{0, "gpu", "dla", takes.passes}};
  app.modules = {{"U", 1}, {"X", 1}, {"Z", 1}, {"G", 1}};
  app.chains = {{"s -> x", 0, 1}, {"s -> u", 0, 0}, {"s -> z", 0, 2}, {"t -> g", 1, 3}};
  if (takes.small > 0) {
    app.xnodes.push_back({"h", "H", {{"dla", takes.small}}, {1}});
    app.modules.push_back({"H", 1});
    app.chains.push_back({"t -> h", 1, 4});
  }
  two.to_app = two.both = app;
  two.to_app.xnodes[0].wcet_us.at("gpu") = two.both.xnodes[0].wcet_us.at("gpu") = takes.second;
}
/// A window for so much, with a slack of some percent.
std::int64_t room_for(std::int64_t work, int ppm) {
  return work + work / 12 + 20 + 4 * (work + 20'000) * ppm / kMillion;
}

/// That DLA is of one clock alone. What waits there is planned before the long job: not so if the GPU is late. In
/// the second table that is on another DLA.
TwoPolicies lets_a_long_job_in(std::uint64_t seed, int ppm) {
  solver::test::Dice dice(seed);
  TwoPolicies two;
  two.from_app.clocks = {{"main", dice.roll(0, 1) != 0 ? ppm : 0}, {"own", ppm}};
  const std::int64_t first = dice.roll(5, 10) * 100, other = dice.roll(1, 3) * 100;
  const std::int64_t second = first + dice.roll(10, 30) * 100, x = dice.roll(2, 5) * 100,
                     z = dice.roll(50, 80) * 100, passes = dice.roll(0, 2) * 50;
  fill(two, "lets in", {first, second, other, x, z, passes}, 20'000, dice.roll(90, 120) * 100);
  const auto room = [&](std::int64_t work) { return room_for(work, ppm); };
  const std::int64_t gpu = room(first + other + 40), later = room(second + other + 40);
  const std::int64_t ends = gpu + passes + room(x), held = ends + room(dice.roll(0, 2) * 100);
  two.from.placements = {{0, {gpu}}, {1, {ends}}, {1, {held + room(z)}, {held}}, {0, {gpu}}};
  two.to.placements = {{0, {later}}, {1, {later + passes + room(x)}}, {2, {room(z)}}, {0, {later}}};
  finish(two);
  return two;
}

/// That DLA is of two clocks. The long job has a shorter window than who waits for the GPU: in time nobody is
/// blocked by it.
TwoPolicies lets_in_beside_another_clock(std::uint64_t seed, int ppm) {
  solver::test::Dice dice(seed);
  TwoPolicies two;
  two.from_app.clocks = {{"main", 0}, {"own", ppm}};
  const std::int64_t first = dice.roll(5, 10) * 100, other = dice.roll(1, 3) * 100,
                     x = dice.roll(30, 50) * 100, z = dice.roll(30, 50) * 100,
                     small = dice.roll(1, 3) * 100, passes = dice.roll(0, 2) * 50;
  const std::int64_t second = first + x + dice.roll(10, 30) * 100;
  fill(two, "lets in beside", {first, second, other, x, z, passes, small}, 40'000,
       dice.roll(300, 400) * 100);
  const auto room = [&](std::int64_t work) { return room_for(work, ppm); };
  const std::int64_t gpu = room(first + other + 40), later = room(second + other + 40);
  const std::int64_t window = room(std::max(x, z) + 2 * small);
  const std::int64_t ready = gpu + passes, ends = ready + window;
  const std::int64_t held = ready + room(x) + dice.roll(0, 1) * 200;
  const std::int64_t beside = room(std::max(x, z) + small);
  two.from.placements = {{0, {gpu}},
                         {1, {ends}, {ready}},
                         {1, {held + window}, {held}},
                         {0, {gpu}},
                         {1, {beside + dice.roll(0, 3) * 1000}}};
  two.to.placements = {{0, {later}},
                       {1, {later + passes + room(x + 2 * small)}, {later + passes}},
                       {2, {room(z)}},
                       {0, {later}},
                       {1, {beside + 1000}}};
  finish(two);
  return two;
}

/// `least_claimed` of 40 apps. `make check` tries the first 16 of them.
void attack_blocking(TwoPolicies (*make)(std::uint64_t, int), int least_claimed,
                     double least_close) {
  const int apps = std::getenv("XAUTO_FULL") != nullptr ? 40 : 16;
  for (const int ppm : {0, 100, 5'000}) {
    int claimed = 0, broken = 0;
    double closest = 0;
    for (std::uint64_t seed = 1; seed <= static_cast<std::uint64_t>(apps); ++seed) {
      const TwoPolicies two = make(seed, ppm);
      const Bounds bounds = bounds_of(two);
      if (bounds.settles_us == 0) continue;
      ++claimed;
      ASSERT_NO_FATAL_FAILURE(expect_checked(two, bounds, seed));
      const NaiveTables naive = naive_of(two);
      const HandoverAttack attack{two.notice_us, 200, seed};
      closest = std::max(closest, expect_none_longer(naive, bounds, attack).worst);
      HandoverClimb weaker(naive, own_worst_cases(two), attack);
      broken += weaker.run().worst > 1;
    }
    EXPECT_GE(40 * claimed, apps * least_claimed) << ppm;
    EXPECT_GE(40 * broken, apps * 10) << ppm;
    EXPECT_GE(closest, least_close) << ppm;
  }
}

TEST(SteadyHandover, ALongJobMayBeInTheWayWhereXpusDoNotPreempt) {
  attack_blocking(long_job_in_the_way, 36, 0.2);
}

TEST(SteadyHandover, LatenessLetsALongJobInWhereXpusDoNotPreempt) {
  attack_blocking(lets_a_long_job_in, 36, 0.7);
}

TEST(SteadyHandover, LatenessLetsALongJobInBesideAnotherClockWhereXpusDoNotPreempt) {
  attack_blocking(lets_in_beside_another_clock, 30, 0.4);
}

}  // namespace
}  // namespace xauto::solver::steady
