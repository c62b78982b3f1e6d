// SPDX-License-Identifier: Apache-2.0
// Several apps on one machine: docs/keys.md, "Apps compose". Merged in memory, or the one beside the other's demand;
// what is accepted is played, and what is refused, too.
#include <gtest/gtest.h>

#include "model/demand.h"
#include "model/together.h"
#include "solver/keys/solve.h"

#include "attack/pairs.h"
#include "keys_certified.h"

namespace xauto::solver::keys::test {
namespace {

using attack::Case;

/// One XNode on the only XPU, of 1000 us and no jitter.
Case one(const std::string& name, std::int64_t wcet, std::int64_t hold, std::int64_t key,
         const Xpu& xpu, std::int64_t period = 1000) {
  Case c;
  c.platform = {"p", {xpu}};
  c.app.name = name;
  c.app.sources = {{"s", {period, 1}}};
  c.app.xnodes = {{"x", "m", {{"gpu", wcet}}, {0}}};
  c.app.modules = {{"m", 9}};
  c.app.chains = {{"c", 0, 0, {}, 1}};
  c.policy.app = name;
  c.policy.platform = "p";
  c.policy.method = "test";
  c.policy.placements = {{0, {key}, {hold}}};
  c.policy.chains.resize(1);
  EXPECT_TRUE(attack::claim_all(c));
  return c;
}
const Xpu kCosts40{"gpu0", "gpu", true, 40};

attack::Pair pair_of(Case a, Case b) {
  attack::Pair pair;
  pair.each = {std::move(a), std::move(b)};
  EXPECT_TRUE(attack::join(pair));
  return pair;
}

Demand demand(const Case& c) {
  return demand_of(c.app, c.platform, c.policy).value();
}

bool accepted_beside(const Case& c, const Beside& beside) {
  return check(c.app, c.platform, c.policy, beside).has_value();
}

TEST(KeysTogether, WhatIsMergedIsSplitAgain) {
  const attack::Pair pair = pair_of(one("a", 60, 0, 70, kCosts40), one("b", 10, 0, 70, kCosts40));
  const AppSpec& all = pair.together.app;
  EXPECT_EQ(all.name, "a + b");
  EXPECT_EQ(all.xnodes[1].name, "b/x");
  EXPECT_EQ(all.sources[1].name, "b/s");
  EXPECT_NE(all.sources[0].clock, all.sources[1].clock) << "both are 'main', and have no phase";
  const auto parts = split_policy({pair.each[0].app, pair.each[1].app}, pair.together.platform,
                                  pair.together.policy);
  EXPECT_EQ(parts[0], pair.each[0].policy);
  EXPECT_EQ(parts[1], pair.each[1].policy);
}

TEST(KeysTogether, WithoutARateNobodyIsBesideIt) {
  Case c = one("a", 60, 0, 70, kCosts40);
  AppSpec alone = c.app;
  alone.name = "b";
  alone.one_at_a_time = true;
  alone.sources[0].period = kNoRate;
  alone.modules[0].max_in_flight = 1;
  EXPECT_FALSE(merge_apps({c.app, alone}));
  EXPECT_FALSE(merge_apps({c.app, c.app})) << "of one name";
  Policy policy = c.policy;
  policy.app = "b";
  policy.app_hash = alone.hash();
  EXPECT_TRUE(check(alone, c.platform, policy));
  EXPECT_FALSE(demand_of(alone, c.platform, policy));
  EXPECT_FALSE(check(alone, c.platform, policy, {{demand(c)}, 0}));
  EXPECT_FALSE(Problem::create(alone, c.platform, {}, {}, {{}, 10}));
}

/// Windows that fit exactly, and by one microsecond do not.
TEST(KeysTogether, PreemptionsAreChargedOverTheUnion) {
  // The longer window may be preempted: 60 + 40, and 10 beside it.
  for (const std::int64_t key : {109, 110}) {
    const attack::Pair pair =
        pair_of(one("a", 60, 0, 100, kCosts40), one("b", 10, 0, key, kCosts40));
    EXPECT_EQ(pair.accepted, key == 110) << key;
    EXPECT_EQ(accepted_beside(pair.each[1], {{demand(pair.each[0])}, 0}), key == 110) << key;
    EXPECT_EQ(accepted_beside(pair.each[0], {{demand(pair.each[1])}, 0}), key == 110) << key;
    EXPECT_EQ(certified_beside(pair.each[0], {{demand(pair.each[1])}, 0}), key == 110) << key;
    EXPECT_EQ(certified_beside(pair.each[1], {{demand(pair.each[0])}, 0}), key == 110) << key;
    EXPECT_TRUE(attack::accepted_if_charged_per_app(pair)) << key;
    const auto found = attack::attack(pair.together.app, pair.together.platform,
                                      pair.together.policy, {100'000, 1, {}, pair.app_of});
    EXPECT_EQ(found.broken(), key == 109) << key << found.late;
  }
}

/// Nobody pays: windows are alike. Whoever starts before its window, since in its own app nobody is in the way, may be
/// preempted all the same.
TEST(KeysTogether, BesideAnotherAppNobodyStartsEarlyWhereThatCosts) {
  using attack::Early;
  for (const bool preemptive : {true, false}) {
    const Xpu xpu{"gpu0", "gpu", preemptive, preemptive ? 40 : 0};
    const attack::Pair pair = pair_of(one("a", 60, 0, 70, xpu), one("b", 10, 700, 770, xpu));
    ASSERT_TRUE(pair.accepted);
    const auto attacked = [&](Early early) {
      return attack::attack(pair.together.app, pair.together.platform, pair.together.policy,
                            {300'000, 1, early, pair.app_of});
    };
    const auto by_rule = attacked(Early::kByTheRule), as_alone = attacked(Early::kOfItsApp);
    EXPECT_FALSE(by_rule.broken()) << by_rule.late;
    EXPECT_EQ(as_alone.broken(), preemptive) << as_alone.late;
    // The player has the same rule.
    for (std::uint64_t seed = 1; seed <= 200; ++seed) {
      const auto played = play(pair.together.app, pair.together.platform, pair.together.policy,
                               {.seconds = 1, .phases = true, .seed = seed, .app_of = pair.app_of});
      ASSERT_TRUE(played);
      EXPECT_EQ(played->late, 0) << played->first_late;
    }
  }
}

TEST(KeysTogether, WhatIsAcceptedIsNeverLateAndWhatIsRefusedMostlyIs) {
  attack::Tally t;
  for (std::uint64_t seed = 1; seed <= 300; ++seed) attack::play_pairs(seed, 5000, t);
  std::printf(
      "%d accepted; %d of %d refused exhibited, %d of %d where nobody waits; %d of %d per app\n",
      t.accepted, t.exhibited, t.refused, t.alone_late, t.alone, t.per_app_late, t.per_app);
  EXPECT_EQ(t.broken, 0) << t.first;
  EXPECT_GE(t.accepted, 150);
  EXPECT_GE(t.refused, 200);
  EXPECT_GE(t.exhibited, t.refused / 2);
  EXPECT_GE(t.per_app, 20);
  EXPECT_GE(t.per_app_late, 1) << "that a wrong test is wrong is never seen";
}

/// docs/keys.md, "Order": v held until its `a`, in place of its pairs, keeps all `a`, all keys and all worst cases. The
/// source of the figures is the check of either policy.
TEST(KeysTogether, HoldsInPlaceOfOrderChangeNoWorstCase) {
  int pairs = 0;
  for (std::uint64_t seed = 1; seed <= 200; ++seed) {
    attack::Wanted wanted = attack::kind_of(seed).wanted;
    wanted.order = true;
    Case c = attack::random_app(seed, wanted);
    if (!attack::widen(c, 7, 100)) continue;
    attack::add_order(c, seed);
    if (c.policy.order.empty() || !attack::claim_all(c)) continue;
    pairs += static_cast<int>(c.policy.order.size());
    Case held = c;
    held.policy = held_in_place_of_order(c.policy, [](int) { return true; });
    EXPECT_TRUE(held.policy.order.empty());
    ASSERT_TRUE(validate(held.policy, c.app, c.platform)) << seed;
    const auto report = check(held.app, held.platform, held.policy);
    ASSERT_TRUE(report) << seed << report.error().to_string();
    for (std::size_t k = 0; k < c.app.chains.size(); ++k)
      EXPECT_LE(report->chains[k].derived_us, c.policy.chains[k].worst_case_us) << seed;
    // Pairs of XPUs that nobody shares stay.
    EXPECT_EQ(held_in_place_of_order(c.policy, [](int) { return false; }), c.policy);
  }
  EXPECT_GE(pairs, 100);
}

/// By demands alone, as xauto-system asks: the source is the attack, which shares no code with it. Whoever holds alone
/// may be alone.
TEST(KeysTogether, WhatDemandsAloneAdmitIsNeverLate) {
  int admitted = 0, refused = 0, alone = 0, alone_refused = 0;
  for (std::uint64_t seed = 1; seed <= 150; ++seed) {
    const attack::Pairs pairs = attack::random_pairs(seed);
    for (const auto* found : {&pairs.accepted, &pairs.refused, &pairs.just}) {
      if (!*found) continue;
      const attack::Pair pair = pair_of((*found)->each[0], (*found)->each[1]);
      const Demand a = demand(pair.each[0]), b = demand(pair.each[1]);
      for (const Demand& one : {a, b}) {
        ++alone;
        if (!check_together({one})) ++alone_refused;
      }
      const bool fits = check_together({a, b}).has_value();
      EXPECT_EQ(fits, check_together({b, a}).has_value()) << seed;
      ++(fits ? admitted : refused);
      if (!fits) continue;
      EXPECT_TRUE(pair.accepted) << seed;
      const Case& c = pair.together;
      EXPECT_FALSE(
          attack::attack(c.app, c.platform, c.policy, {5000, seed, {}, pair.app_of}).broken())
          << seed;
    }
  }
  std::printf("%d admitted, %d refused; alone %d of %d refused\n", admitted, refused, alone_refused,
              alone);
  EXPECT_GE(admitted, 60);
  EXPECT_GE(refused, 60);
}

/// Whoever asks for no more than what is left, in windows that block nobody, is accepted whatever he is.
TEST(KeysTogether, AReserveIsForWhoeverAsksForNoMore) {
  int met = 0, kept = 0;
  for (std::uint64_t seed = 1; seed <= 150; ++seed) {
    Random random(seed);
    for (const bool preemptive : {true, false}) {
      const Xpu xpu{"gpu0", "gpu", preemptive, preemptive ? 40 : 0};
      const int pct = 10 + static_cast<int>(random.below(40));
      // As tight as the reserve lets it be.
      Case c;
      for (std::int64_t key = 20;; key += 7) {
        c = one("a", 100 + static_cast<std::int64_t>(seed), 0, 5000 + key, xpu, 2000);
        c.policy.placements[0].key_us[0] = key;
        if (attack::claim_all(c) && accepted_beside(c, {{}, pct})) break;
      }
      EXPECT_TRUE(certified_beside(c, {{}, pct}));
      EXPECT_FALSE(accepted_beside(c, {{}, 90}) && certified_beside(c, {{}, 90}));
      ++kept;
      for (int k = 0; k < 20; ++k) {
        const std::int64_t cost = xpu.preempt_us,
                           own = c.app.xnodes[0].wcet_us["gpu"] * 100 / (100 - pct) + 1;
        const std::int64_t window = c.policy.placements[0].key_us[0];
        const std::int64_t period = 3000 + static_cast<std::int64_t>(random.below(9000));
        // A job on an XPU that does not preempt waits for the longest of ours, and keeps no shorter window waiting.
        const std::int64_t key =
            preemptive
                ? 50 + static_cast<std::int64_t>(random.below(static_cast<std::uint64_t>(period)))
                : own + static_cast<std::int64_t>(random.below(
                            static_cast<std::uint64_t>(std::max<std::int64_t>(1, window - own))));
        const std::int64_t work = std::min(key, period) * pct / 100 - cost;
        if (work < 1 || (!preemptive && key > window)) continue;
        const Case newcomer = one("b", work, 0, key, xpu, period);
        ++met;
        EXPECT_TRUE(accepted_beside(newcomer, {{demand(c)}, 0}))
            << seed << " " << preemptive << " " << key;
        EXPECT_TRUE(certified_beside(newcomer, {{demand(c)}, 0}));
        EXPECT_TRUE(pair_of(c, newcomer).accepted);
      }
    }
  }
  EXPECT_GE(met, 1000) << kept;
}

/// The slack of an XPU, by its formula: the least t - D(t) over all t is a part of t. And what it is good for: whoever asks
/// for no more is admitted.
TEST(KeysTogether, TheSlackIsWhatTheDemandsLeave) {
  struct Job {
    std::int64_t window, period, work;
  };
  int some = 0, none = 0;
  for (std::uint64_t seed = 1; seed <= 400; ++seed) {
    Random random(seed);
    const auto roll = [&](std::int64_t from, std::int64_t to) {
      return from + static_cast<std::int64_t>(random.below(static_cast<std::uint64_t>(to - from)));
    };
    const std::int64_t cost = roll(0, 3);
    const Xpu xpu{"gpu0", {}, true, cost};
    std::vector<Job> jobs;
    std::vector<Demand> demands;
    for (std::int64_t n = roll(1, 4); n > 0; --n) {
      const std::int64_t period = 20 * roll(2, 7), window = roll(8, period + 30);
      jobs.push_back({window, period, roll(1, std::min<std::int64_t>(window, 30))});
      demands.push_back(
          {1, {{xpu, {{.period = period, .jobs = {{.key = window, .work = jobs.back().work}}}}}}});
    }
    // lcm(40, 60, 80, 100, 120) and the longest window.
    constexpr std::int64_t kHorizon = 1200 + 150;
    const auto fits = [&](std::int64_t pct) {
      std::int64_t in_the_long_run = 0;
      for (const Job& job : jobs)
        in_the_long_run += 1200 / job.period * (((job.work + cost) * 100 + 99 - pct) / (100 - pct));
      if (in_the_long_run > 1200) return false;
      for (std::int64_t t = 1; t <= kHorizon; ++t) {
        std::int64_t wanted = 0;
        for (const Job& job : jobs)
          if (t >= job.window)
            wanted += ((t - job.window) / job.period + 1) *
                      (((job.work + cost) * 100 + 99 - pct) / (100 - pct));
        if (wanted > t) return false;
      }
      return true;
    };
    const Result<int> slack = slack_together(demands);
    if (!slack) {
      EXPECT_FALSE(check_together(demands));
      EXPECT_FALSE(fits(0));
      continue;
    }
    int expected = kMaxReservePct;
    while (expected > 0 && !fits(expected)) --expected;
    EXPECT_EQ(*slack, expected) << "seed " << seed;
    ++(*slack > 0 ? some : none);
    for (int k = 0; k < 10; ++k) {
      const std::int64_t period = roll(20, 200), window = roll(10, period + 1);
      const std::int64_t work = window * *slack / 100 - cost;
      if (work < 1) continue;
      std::vector<Demand> all = demands;
      all.push_back({1, {{xpu, {{.period = period, .jobs = {{.key = window, .work = work}}}}}}});
      EXPECT_TRUE(check_together(all)) << "seed " << seed << ", window " << window;
    }
  }
  EXPECT_GT(some, 100);
  EXPECT_GT(none, 20);
  EXPECT_FALSE(slack_together({}));
}

/// The solver's own: all at once; or one with a reserve, and the other one beside it.
TEST(KeysTogether, WhatTheSolverPlansHolds) {
  int together = 0, beside = 0, refused = 0;
  Options options;
  options.max_evaluations = 300;
  options.time_limit_s = 60;
  for (std::uint64_t seed = 1; seed <= 40; ++seed) {
    const attack::Pairs pairs = attack::random_pairs(seed);
    if (!pairs.accepted) continue;
    std::vector<Case> each = pairs.accepted->each;
    const auto attacked = [&](const attack::Pair& pair) {
      const Case& c = pair.together;
      const auto found =
          attack::attack(c.app, c.platform, c.policy, {10'000, seed, {}, pair.app_of});
      EXPECT_FALSE(found.broken()) << seed << found.late << found.chain;
    };
    options.beside = {};
    const auto all = solve(pairs.accepted->together.app, each[0].platform, options);
    ASSERT_TRUE(all) << all.error().to_string();
    if (all->outcome == Outcome::kPolicy) {
      const auto parts = split_policy({each[0].app, each[1].app}, each[0].platform, all->policy);
      for (const int k : {0, 1}) each[at(k)].policy = parts[at(k)];
      attacked(pair_of(each[0], each[1]));
      ++together;
    }
    options.beside = {{}, 25};
    const auto first = solve(each[0].app, each[0].platform, options);
    if (!first || first->outcome != Outcome::kPolicy) continue;
    each[0].policy = first->policy;
    EXPECT_TRUE(accepted_beside(each[0], {{}, 25})) << seed;
    options.beside = {{demand(each[0])}, 0};
    const auto second = solve(each[1].app, each[0].platform, options);
    ASSERT_TRUE(second) << second.error().to_string();
    ++(second->outcome == Outcome::kPolicy ? beside : refused);
    if (second->outcome != Outcome::kPolicy) continue;
    each[1].policy = second->policy;
    EXPECT_TRUE(accepted_beside(each[1], options.beside)) << seed;
    const attack::Pair pair = pair_of(each[0], each[1]);
    EXPECT_TRUE(pair.accepted) << seed;
    attacked(pair);
  }
  std::printf("%d together, %d beside, %d not found\n", together, beside, refused);
  EXPECT_GE(together, 15);
  EXPECT_GE(beside, 8);
}

/// Whatever a file says, it is an answer or an error.
TEST(KeysTogether, ADemandOfAnythingIsNoCrash) {
  const Case c = one("a", 60, 0, 100, kCosts40);
  const DemandSequence normal = demand(c).xpus[0].sequences[0];
  for (std::uint64_t seed = 1; seed <= 300; ++seed) {
    Random random(seed);
    const auto any = [&](std::int64_t most) {
      return static_cast<std::int64_t>(random.below(3) == 0 ? random.below(200)
                                                            : random.next() >> 11) %
             most;
    };
    Demand d = demand(c);
    d.ticks_per_us = 1 + any(7);
    d.xpus[0].sequences.clear();
    for (int k = 0; k < 3; ++k) {
      DemandSequence s = normal;
      s.period = 1 + any(kMaxDemandTicks);
      s.ppm = random.below(2) == 0 ? 0 : any(kMaxPpm);
      s.once = random.below(3) == 0;
      s.slip = s.once ? any(kMaxDemandTicks) : 0;
      s.jobs.clear();
      for (int n = 0; n < 4; ++n) {
        const std::int64_t ready = any(kMaxDemandTicks - 1);
        s.jobs.push_back({any(s.period), ready, random.below(2) == 0 ? 0 : ready,
                          ready + 1 + any(kMaxDemandTicks - ready - 1), 1 + any(kMaxDemandTicks),
                          random.below(2) == 0});
      }
      d.xpus[0].sequences.push_back(s);
    }
    ASSERT_TRUE(validate(d));
    const bool by_check = accepted_beside(c, {{d}, static_cast<int>(random.below(50))});
    EXPECT_TRUE(by_check || !certified_beside(c, {{d}, 50})) << seed;
  }
}

/// A file says as much as the app does; where jobs are not preempted, or have levels, it may refuse more.
TEST(KeysTogether, ADemandSaysWhatTheAppDoes) {
  int equal = 0, refused = 0, beyond = 0, weaker = 0;
  for (std::uint64_t seed = 1; seed <= 400; ++seed) {
    const attack::Pairs pairs = attack::random_pairs(seed);
    const attack::Wanted wanted = attack::kind_of(seed).wanted;
    for (const auto* pair : {&pairs.accepted, &pairs.refused, &pairs.just}) {
      if (!*pair) continue;
      // As they were found: what is tightened is tight together.
      for (const int k : {0, 1}) {
        const Case &c = (*pair)->each[at(k)], &other = (*pair)->each[at(1 - k)];
        const bool together = [&] {
          attack::Pair again;
          again.each = (*pair)->each;
          return attack::join(again) && again.accepted;
        }();
        const Beside beside{{demand(other)}, 0};
        const bool by_check = accepted_beside(c, beside);
        EXPECT_TRUE(together || !by_check) << seed;
        EXPECT_TRUE(by_check || !certified_beside(c, beside))
            << seed << ": only the solver accepts it";
        if (attack::kind_of(seed).urgent) continue;
        if (wanted.preemptive && wanted.levels == 0) {
          EXPECT_EQ(together, by_check) << seed;
        }
        if (wanted.ppm == 0 && wanted.preemptive)
          weaker += by_check != certified_beside(c, beside) ? 1 : 0;
        ++(together == by_check ? equal : beyond);
        refused += by_check ? 0 : 1;
      }
    }
  }
  std::printf("%d equal, %d of them refused; of %d the file refuses more\n", equal, refused,
              beyond);
  EXPECT_GE(equal, 500);
  EXPECT_GE(refused, 200);
  EXPECT_LE(weaker, equal / 50) << "the solver knows of earliest starts by holds alone";
}

}  // namespace
}  // namespace xauto::solver::keys::test
