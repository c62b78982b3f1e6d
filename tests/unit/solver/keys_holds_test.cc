// SPDX-License-Identifier: Apache-2.0
// Holds of the solver's policies, against the checker, which shares no code with it: each of them is needed.
#include <algorithm>
#include <functional>
#include <optional>

#include <gtest/gtest.h>

#include "base/index.h"
#include "model/components.h"
#include "solver/keys/certificate.h"
#include "solver/keys/chains.h"
#include "solver/keys/check.h"
#include "solver/keys/holds.h"
#include "solver/keys/solve.h"

#include "keys_random.h"

namespace xauto::solver::keys {
namespace {

RatedShape shape_of(int kind) {
  RatedShape shape;
  shape.max_components = 3;
  shape.urgent = kind == 1;
  if (kind == 2) {
    shape.clocks = 2;
    shape.least_period = 14;
  }
  return shape;
}

struct Case {
  AppSpec app;
  Platform platform;
  Policy policy;
};

/// One that has a policy, if this seed does.
std::optional<Case> solved(int kind, std::uint64_t seed) {
  solver::test::Dice dice(seed);
  Case c;
  c.app = random_rated_app(dice, shape_of(kind));
  c.platform = random_rated_platform(dice);
  Options options = brief(300);
  options.seed = seed;
  auto answer = solve(c.app, c.platform, options);
  EXPECT_TRUE(answer) << seed;
  if (!answer || answer->outcome != Outcome::kPolicy) return {};
  c.policy = std::move(answer->policy);
  return c;
}

/// Whether the policy is certified, and no chain takes longer than `of` claims, of those that count.
bool keeps(const Problem& p, const Policy& policy, const Policy& of) {
  std::vector<int> xpu;
  for (const Placement& placed : policy.placements) xpu.push_back(placed.xpu);
  Windows w = keys_and_holds(p, policy);
  if (!certify(p, xpu, w)) return false;
  for (std::size_t k = 0; k < p.chains.size(); ++k) {
    const ChainClaim& claim = of.chains[k];
    if (p.deadlines && p.chains[k].deadline == kNoTick && p.chains[k].weight == 0) continue;
    if (worst_case(p, p.chains[k], w) > claim.worst_case_us * p.scale) return false;
    if (claim.urgent_worst_case_us &&
        worst_case(p, p.chains[k], w, true) > *claim.urgent_worst_case_us * p.scale)
      return false;
  }
  return true;
}

TEST(KeysHolds, EachIsNeededForAClaimOrTheCertificate) {
  int holds = 0, by_check_alone = 0;
  for (int kind = 0; kind < 3; ++kind)
    for (std::uint64_t seed = 1; seed <= 80; ++seed) {
      const std::optional<Case> c = solved(kind, seed);
      if (!c) continue;
      EXPECT_TRUE(check(c->app, c->platform, c->policy)) << kind << ", seed " << seed;
      const Problem p = *Problem::create(c->app, c->platform, {}, c->policy.order);
      EXPECT_TRUE(keeps(p, c->policy, c->policy)) << kind << ", seed " << seed;
      for (std::size_t i = 0; i < c->policy.placements.size(); ++i) {
        Policy without = c->policy;
        auto& [xpu, keys, held, start, finish, counted, all, priority] = without.placements[i];
        start.clear();
        finish.clear();
        const std::vector<std::int64_t> before = held;
        for (std::size_t j = 0; j < before.size(); ++j) {
          if (before[j] == 0) continue;
          ++holds;
          held[j] = 0;
          EXPECT_FALSE(keeps(p, without, c->policy))
              << kind << ", seed " << seed << ": XNode " << i << ", activation " << j;
          by_check_alone += check(c->app, c->platform, without).has_value();
          held = before;
        }
        if (before.empty()) continue;
        held.clear();
        EXPECT_FALSE(keeps(p, without, c->policy)) << kind << ", seed " << seed << ": XNode " << i;
      }
    }
  EXPECT_GT(holds, 50);
  // The check's charges are other ones, here and there smaller.
  EXPECT_LT(10 * by_check_alone, holds);
}

/// What nobody asks for holds nobody: it has no deadline, others have, and it does not count in the sum. Its claim is true.
TEST(KeysHolds, NoneIsForAChainThatNobodyAsksFor) {
  int asked = 0, unasked = 0;
  for (std::uint64_t seed = 1; seed <= 120; ++seed) {
    solver::test::Dice dice(seed);
    RatedShape shape;
    shape.max_components = 3;
    AppSpec app = random_rated_app(dice, shape);
    const Platform platform = random_rated_platform(dice);
    for (ChainSpec& chain : app.chains) chain.deadline_us.reset();
    app.chains.front().deadline_us = kMaxTimeUs / 1000;
    for (const std::int64_t weight : {1, 0}) {
      for (std::size_t c = 1; c < app.chains.size(); ++c) app.chains[c].weight = weight;
      Options options = brief(300);
      options.seed = seed;
      const auto answer = solve(app, platform, options);
      ASSERT_TRUE(answer) << seed;
      if (answer->outcome != Outcome::kPolicy) break;
      EXPECT_TRUE(check(app, platform, answer->policy)) << seed;
      const Problem p = *Problem::create(app, platform, {}, answer->policy.order);
      for (std::size_t i = 0; i < answer->policy.placements.size(); ++i) {
        Policy without = answer->policy;
        std::vector<std::int64_t>& held = without.placements[i].hold_us;
        const auto holds = std::ranges::count_if(held, [](std::int64_t us) { return us > 0; });
        (weight == 0 ? unasked : asked) += static_cast<int>(holds);
        if (holds == 0) continue;
        held.clear();
        EXPECT_FALSE(keeps(p, without, answer->policy)) << seed << ": XNode " << i;
      }
    }
  }
  EXPECT_GT(asked, 20);
  EXPECT_LT(unasked, asked);
}

/// Held at their planned starts, as the search has them, and as it leaves them.
TEST(KeysHolds, MostAreNotNeeded) {
  std::int64_t before = 0, after = 0;
  for (std::uint64_t seed = 1; seed <= 80; ++seed) {
    const std::optional<Case> c = solved(0, seed);
    if (!c) continue;
    const Problem p = *Problem::create(c->app, c->platform);
    std::vector<int> xpu;
    for (const Placement& placed : c->policy.placements) xpu.push_back(placed.xpu);
    Windows w = keys_and_holds(p, c->policy);
    ASSERT_TRUE(certify(p, xpu, w)) << seed;
    // As late as each job may be held: until what it waits for has ended.
    Windows held = w;
    for (std::size_t s = 0; s < held.a.size(); ++s)
      held.hold[s] = std::max(held.hold[s], held.a[s] / p.scale * p.scale);
    if (!certify(p, xpu, held)) continue;
    const auto count = [](const Windows& of) {
      return std::ranges::count_if(of.hold, [](Tick hold) { return hold > 0; });
    };
    before += count(held);
    std::vector<Tick> worst;
    for (const Chain& chain : p.chains) worst.push_back(p.up_to_us(worst_case(p, chain, held)));
    drop_holds(p, xpu, held);
    after += count(held);
    ASSERT_TRUE(certify(p, xpu, held)) << seed;
    for (std::size_t k = 0; k < p.chains.size(); ++k)
      EXPECT_LE(worst_case(p, p.chains[k], held), worst[k]) << seed;
  }
  EXPECT_GT(before, 200);
  EXPECT_LT(3 * after, before);
}

/// As claimed, of each chain, and of its urgent releases.
std::vector<Tick> worst_cases_of(const Problem& p, const Windows& w) {
  std::vector<Tick> worst;
  for (const Chain& chain : p.chains)
    for (const bool urgent : {false, true})
      worst.push_back(p.up_to_us(worst_case(p, chain, w, urgent && p.any_urgent)));
  return worst;
}
bool no_longer(const std::vector<Tick>& now, const std::vector<Tick>& before) {
  return std::equal(now.begin(), now.end(), before.begin(), std::less_equal<>());
}

/// Rates that come round after hundreds of activations, of which a change is looked at around it alone (recertify.h):
/// the whole certificate, and all releases of each chain, say the same.
TEST(KeysHolds, WhereRatesComeRoundLate) {
  int gone = 0, needed = 0, longer = 0;
  for (std::uint64_t seed = 1; seed <= 90; ++seed) {
    solver::test::Dice dice(seed);
    RatedShape shape = shape_of(static_cast<int>(seed % 3));
    AppSpec app = random_rated_app(dice, shape);
    const int periods[] = {13, 17, 19};
    for (std::size_t s = 0; s < app.sources.size(); ++s) {
      app.sources[s].period = {periods[s]};
      app.sources[s].offset_us = 0;
      if (app.sources[s].urgent) app.sources[s].urgent = {dice.roll(1, 6), 4 * periods[s]};
    }
    Platform platform = random_rated_platform(dice);
    for (Xpu& xpu : platform.xpus)
      if (xpu.preemptive && dice.chance(70)) xpu.preempt_us = 2;
    const auto answer = solve(app, platform, brief(20));
    ASSERT_TRUE(answer) << seed;
    if (answer->outcome != Outcome::kPolicy || !answer->policy.order.empty()) continue;
    const Problem p = *Problem::create(app, platform);
    std::vector<int> xpu;
    for (const Placement& placed : answer->policy.placements) xpu.push_back(placed.xpu);
    // As late as each job may be held: until what it waits for has ended.
    Windows w = keys_and_holds(p, answer->policy);
    ASSERT_TRUE(certify(p, xpu, w)) << seed;
    Windows held = w;
    held.hold = held.a;
    if (!certify(p, xpu, held)) held = w;
    const std::vector<Tick> worst = worst_cases_of(p, held);
    const Windows before = held;
    drop_holds(p, xpu, held);
    Windows whole = held;
    ASSERT_TRUE(certify(p, xpu, whole)) << seed;
    EXPECT_EQ(whole.a, held.a) << seed;
    EXPECT_EQ(whole.e, held.e) << seed;
    EXPECT_TRUE(no_longer(worst_cases_of(p, held), worst)) << seed;
    for (std::size_t s = 0; s < held.hold.size(); ++s) {
      gone += before.hold[s] > 0 && held.hold[s] == 0;
      if (held.hold[s] == 0 || !dice.chance(10)) continue;
      Windows without = held;
      without.hold[s] = 0;
      ++needed;
      if (!certify(p, xpu, without)) continue;
      EXPECT_FALSE(no_longer(worst_cases_of(p, without), worst)) << seed << ": " << s;
      ++longer;
    }
  }
  EXPECT_GT(gone, 5000);
  EXPECT_GT(needed, 100);
  EXPECT_GT(longer, 50);
}

/// Pairs lead from one component to another: who is held behind such a pair starts no sooner than its first.
TEST(KeysHolds, GoAlsoWherePairsJoinComponents) {
  int joined = 0;
  for (std::uint64_t seed = 1; seed <= 400; ++seed) {
    solver::test::Dice dice(seed);
    RatedShape shape;
    shape.max_components = 4;
    shape.offsets = false;
    AppSpec app = random_rated_app(dice, shape);
    for (SourceSpec& source : app.sources) source.period = {60};
    Platform platform = random_rated_platform(dice);
    platform.xpus.back().preempt_us = platform.xpus.back().preemptive ? 2 : 0;
    Options options = brief(100);
    options.seed = seed;
    const auto answer = solve(app, platform, options);
    ASSERT_TRUE(answer) << seed;
    if (answer->outcome != Outcome::kPolicy || answer->policy.order.empty()) continue;
    const Components parts = find_components(app).value();
    for (const auto& [u, v] : answer->policy.order) joined += parts.of[at(u)] != parts.of[at(v)];
    const auto checked = check(app, platform, answer->policy);
    EXPECT_TRUE(checked) << seed << ": " << checked.error().to_string();
    // All are held until they are ready, and what is not needed goes: the rest is as if derived anew.
    const Problem p = Problem::create(app, platform, {}, answer->policy.order).value();
    std::vector<int> xpu;
    for (const Placement& placed : answer->policy.placements) xpu.push_back(placed.xpu);
    Windows w = keys_and_holds(p, answer->policy);
    derive_ready(p, 0, xpu, w);
    w.hold = w.a;
    if (!certify(p, xpu, w)) continue;
    drop_holds(p, xpu, w, {});
    Windows anew = w;
    derive_ready(p, 0, xpu, anew);
    EXPECT_EQ(w.a, anew.a) << seed;
    EXPECT_EQ(w.e, anew.e) << seed;
  }
  EXPECT_GT(joined, 30);
}

}  // namespace
}  // namespace xauto::solver::keys
