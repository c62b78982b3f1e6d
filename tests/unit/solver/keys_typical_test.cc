// SPDX-License-Identifier: Apache-2.0
// The last of the search: among candidates that claim no more the least typical latency.
#include <algorithm>
#include <cmath>

#include <gtest/gtest.h>

#include "base/index.h"
#include "solver/keys/certificate.h"
#include "solver/keys/chains.h"
#include "solver/keys/check.h"
#include "solver/keys/lower_bounds.h"
#include "solver/keys/play.h"
#include "solver/keys/solve.h"
#include "solver/keys/typical.h"
#include "solver/keys/uncertified.h"

#include "keys_random.h"

namespace xauto::solver::keys {
namespace {

Policy policy_of(const AppSpec& app, const Platform& platform, const Problem& p,
                 const Candidate& candidate) {
  Policy policy;
  policy.app = app.name;
  policy.app_hash = app.hash();
  policy.platform = platform.name;
  policy.method = "auto";
  const Windows& w = candidate.figures.w;
  for (int i = 0; i < p.num_xnodes; ++i) {
    Placement& placed = policy.placements.emplace_back();
    placed.xpu = candidate.decision.xpu[at(i)];
    for (int n = 0; n < p.jobs[at(i)]; ++n) {
      placed.key_us.push_back(w.d[p.slot_of(i, n)] / p.scale);
      placed.hold_us.push_back(w.hold[p.slot_of(i, n)] / p.scale);
    }
  }
  for (const Chain& chain : p.chains) {
    const Tick worst = p.up_to_us(std::max(Tick{0}, worst_case(p, chain, w))) / p.scale;
    policy.chains.push_back({chain.name, worst, 0, false});
    if (app.sources[at(chain.source)].urgent)
      policy.chains.back().urgent_worst_case_us =
          p.up_to_us(worst_case(p, chain, w, true)) / p.scale;
  }
  return policy;
}

/// A certified candidate that was searched for a short time.
Candidate searched(const AppSpec& app, const Platform& platform, const Problem& p,
                   std::uint64_t seed) {
  Search search(p, lower_bounds(p, app, platform, {}, 0, {}), Aim::kMix, seed);
  search.run({{}, {}, 200, {}, {}}, nullptr, Keep::kNothing, [](const Candidate&) {});
  return search.found().best();
}

AppSpec random_app(solver::test::Dice& dice, int kind) {
  RatedShape shape;
  shape.max_components = 3;
  shape.urgent = kind == 1;
  if (kind == 2) {
    shape.clocks = 2;
    shape.least_period = 14;
  }
  return random_rated_app(dice, shape);
}

/// The checker shares no code with the solver.
TEST(KeysTypical, NoClaimGrowsAndAllIsCertified) {
  int better = 0, cases = 0;
  for (int kind = 0; kind < 3; ++kind)
    for (std::uint64_t seed = 1; seed <= 25; ++seed) {
      solver::test::Dice dice(seed);
      const AppSpec app = random_app(dice, kind);
      const Platform platform = random_rated_platform(dice);
      const auto p = Problem::create(app, platform);
      ASSERT_TRUE(p) << seed;
      const Candidate before = searched(app, platform, *p, seed);
      if (!before.figures.valid) continue;
      ++cases;
      Candidate after = before;
      least_typical(app, *p, seed, Keep::kNothing, {{}, {}, 300, {}, {}}, after);
      const Policy was = policy_of(app, platform, *p, before),
                   is = policy_of(app, platform, *p, after);
      for (std::size_t c = 0; c < was.chains.size(); ++c) {
        EXPECT_LE(is.chains[c].worst_case_us, was.chains[c].worst_case_us) << kind << " " << seed;
        if (was.chains[c].urgent_worst_case_us) {
          EXPECT_LE(*is.chains[c].urgent_worst_case_us, *was.chains[c].urgent_worst_case_us)
              << kind << " " << seed;
        }
      }
      const auto checked = check(app, platform, is);
      EXPECT_TRUE(checked) << kind << " " << seed << ": " << checked.error().to_string();
      TypicalPlay play(app, *p, seed);
      if (play.latency(after.decision.xpu, after.figures.w) <
          play.latency(before.decision.xpu, before.figures.w))
        ++better;
    }
  EXPECT_GT(cases, 30);
  EXPECT_GT(better, cases / 10);
}

TEST(KeysTypical, IsTheSameForASeed) {
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    solver::test::Dice dice(seed);
    const AppSpec app = random_app(dice, 2);
    const Platform platform = random_rated_platform(dice);
    const auto p = Problem::create(app, platform);
    ASSERT_TRUE(p) << seed;
    Candidate one = searched(app, platform, *p, seed);
    if (!one.figures.valid) continue;
    Candidate other = one;
    for (Candidate* of : {&one, &other})
      least_typical(app, *p, seed, Keep::kNothing, {{}, {}, 200, {}, {}}, *of);
    EXPECT_EQ(one.decision.xpu, other.decision.xpu) << seed;
    EXPECT_EQ(one.figures.w.d, other.figures.w.d) << seed;
    EXPECT_EQ(one.figures.w.hold, other.figures.w.hold) << seed;
  }
}

/// Of one rate, where each release is as the one before, against the simulator of `xauto simulate`, which shares no
/// code with it.
TEST(KeysTypical, PlaysAsSimulateDoes) {
  int cases = 0;
  for (std::uint64_t seed = 1; seed <= 200; ++seed) {
    solver::test::Dice dice(seed);
    RatedShape shape;
    shape.max_components = 3;
    shape.jitter = false;
    AppSpec app = random_rated_app(dice, shape);
    Platform platform = random_rated_platform(dice);
    stretch(app, platform, 1000);
    for (SourceSpec& source : app.sources) source.period = app.sources.front().period;
    for (XNodeSpec& xnode : app.xnodes)
      for (const auto& [type, us] : xnode.wcet_us)
        xnode.typical_us[type] = dice.roll(1, static_cast<int>(us));
    const auto p = Problem::create(app, platform);
    ASSERT_TRUE(p) << seed;
    const Candidate c = searched(app, platform, *p, seed);
    if (!c.figures.valid) continue;
    const AppSpec usual = at_usual_times(app);
    Policy policy = policy_of(usual, platform, *p, c);
    policy.certified = false;
    policy.chains.clear();
    PlayOptions asked;
    asked.seconds = 1;
    const auto played = play(usual, platform, policy, asked);
    ASSERT_TRUE(played) << seed << ": " << played.error().to_string();
    double sum = 0;
    bool steady = true;
    for (const PlayedChain& chain : played->chains) {
      sum += chain.median_us * static_cast<double>(p->scale);
      // What is longer has not come through when the play ends.
      steady = steady && chain.p99_us == chain.median_us &&
               chain.longest_us <= static_cast<double>(app.sources.front().period.num);
    }
    if (!steady) continue;
    ++cases;
    TypicalPlay ordinary(app, *p, seed);
    EXPECT_NEAR(ordinary.latency(c.decision.xpu, c.figures.w), sum, 1e-6 * sum) << seed;
  }
  EXPECT_GT(cases, 80);
}

/// A camera every 30 ms, control every 15 ms. `near` takes 16 ms at most and 10 usually, `other` 10 and 6, on one CPU.
/// Control reads what `near` has made. Whoever is first, at WCETs it ends after 15 ms, at 16 or 26, and is read at 30:
/// the claim is 31 ms. Usually, if `near` is first, it ends at 10 and is read at 15, so all takes 16 ms; if it is
/// second, it ends at 16 and is read at 30. Control may not wait: its own chain has 1 ms.
struct Ticking {
  AppSpec app;
  Platform platform;
  Ticking() {
    app.name = "ticking";
    app.sources = {{.name = "camera", .period = {30'000, 1}},
                   {.name = "tick", .period = {15'000, 1}}};
    const auto add = [&](const char* name, int source, const char* type, std::int64_t wcet_us,
                         std::int64_t typical_us) {
      XNodeSpec& x = app.xnodes.emplace_back();
      x.name = x.module = name;
      x.sources = {source};
      x.wcet_us[type] = wcet_us;
      x.typical_us[type] = typical_us;
      app.modules.push_back({name, 1});
    };
    add("near", 0, "cpu", 16'000, 10'000);
    add("other", 0, "cpu", 10'000, 6'000);
    add("control", 1, "gpu", 1'000, 1'000);
    app.samples = {{0, 2}};
    app.chains = {{"way", 0, 2, 60'000}, {"control", 1, 2, 1'000}};
    platform.name = "two";
    platform.xpus = {{"cpu0", "cpu", true, 0}, {"gpu0", "gpu", true, 0}};
  }
};

TEST(KeysTypical, IsInTimeForATickThatTheWorstCaseMisses) {
  const Ticking t;
  const auto p = Problem::create(t.app, t.platform);
  ASSERT_TRUE(p);
  Candidate c;
  c.decision.xpu = {0, 0, 1};
  c.decision.key = {2, 1, 1};  // `other` first
  c.decision.hold = {0, 0, 0};
  for (auto* flags : {&c.decision.held, &c.decision.polite, &c.decision.late}) *flags = {0, 0, 0};
  c.decision.window = {0, 0, 0};
  Evaluator evaluator(*p, {1, 1});
  evaluator.evaluate(c.decision, kInvalidCost, c.figures);
  ASSERT_TRUE(c.figures.valid);
  EXPECT_EQ(c.figures.chain[0], 31'000 * p->scale);
  TypicalPlay play(t.app, *p, 1);
  EXPECT_DOUBLE_EQ(play.latency(c.decision.xpu, c.figures.w), 31. / 60 + 1);
  least_typical(t.app, *p, 1, Keep::kNothing, {{}, {}, 200, {}, {}}, c);
  EXPECT_EQ(c.figures.chain[0], 31'000 * p->scale);
  EXPECT_DOUBLE_EQ(play.latency(c.decision.xpu, c.figures.w), 16. / 60 + 1);
}

TEST(KeysTypical, SolveLooksAtIt) {
  const Ticking t;
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    Options options = brief(1000);
    options.seed = seed;
    auto answer = solve(t.app, t.platform, options);
    ASSERT_TRUE(answer);
    ASSERT_EQ(answer->outcome, Outcome::kPolicy);
    EXPECT_EQ(answer->policy.chains[0].worst_case_us, 31'000);
    const AppSpec usual = at_usual_times(t.app);
    Policy policy = answer->policy;
    policy.app_hash = usual.hash();
    policy.certified = false;
    policy.chains.clear();
    const auto played = play(usual, t.platform, policy, {});
    ASSERT_TRUE(played);
    EXPECT_EQ(played->chains[0].median_us, 16'000) << seed;
  }
}

/// A reader every 100 ms, held until 30 ms, and what it samples: of another clock, released 10 ms later, there after 15
/// ms, with a key at 45 ms. No claim counts on that one's being read at 30 ms, so the reader may start at once.
struct Reading {
  AppSpec app;
  Platform platform;
  Policy policy;
  Reading() {
    app.name = "reading";
    app.clocks = {{"main", 0}, {"other", 0}};
    app.sources = {{.name = "tick", .period = {100'000, 1}},
                   {.name = "radar", .period = {100'000, 1}, .offset_us = 10'000, .clock = 1}};
    const auto add = [&](const char* name, int source, const char* type, std::int64_t us) {
      XNodeSpec& x = app.xnodes.emplace_back();
      x.name = x.module = name;
      x.sources = {source};
      x.wcet_us[type] = x.typical_us[type] = us;
      app.modules.push_back({name, 1});
    };
    add("reader", 0, "cpu", 1'000);
    add("read", 1, "gpu", 15'000);
    app.samples = {{1, 0}};
    app.chains = {{"own", 0, 0}, {"read", 1, 0}};
    platform.name = "two";
    platform.xpus = {{"cpu0", "cpu", true, 0}, {"gpu0", "gpu", true, 0}};
    policy.platform = platform.name;
    policy.placements = {{0, {60'000}, {30'000}}, {1, {35'000}}};
    policy.certified = false;
  }
  /// Chain by chain.
  std::vector<double> medians() {
    policy.app = app.name;
    policy.app_hash = app.hash();
    PlayOptions asked;
    asked.seconds = 5;
    std::vector<double> medians;
    const auto played = play(app, platform, policy, asked);
    EXPECT_TRUE(played) << played.error().to_string();
    if (played)
      for (const PlayedChain& chain : played->chains) medians.push_back(chain.median_us);
    return medians;
  }
  [[nodiscard]] bool chosen() const {
    const Problem p = Problem::create(app, platform).value();
    Candidate candidate;
    candidate.decision.xpu = {0, 1};
    candidate.figures.w = keys_and_holds(p, policy);
    EXPECT_TRUE(certify(p, candidate.decision.xpu, candidate.figures.w));
    const std::vector<char> all = readers_of_all(app, p, 1, {}, candidate);
    EXPECT_EQ(all[1], 0) << "it reads nothing";
    return all[0] != 0;
  }
};

TEST(KeysTypical, WhoReadsAllOfAnotherClockWaitsForIt) {
  Reading r;
  EXPECT_EQ(r.medians(), (std::vector<double>{1'000, 91'000}));
  r.policy.placements[0].reads_all = true;
  EXPECT_EQ(r.medians(), (std::vector<double>{26'000, 16'000}));
}

TEST(KeysTypical, AReaderWaitsForAnotherClockWhereItsChainsAreShorterForIt) {
  Reading r;
  EXPECT_TRUE(r.chosen());
  r.app.chains[0].weight = 1'000;
  EXPECT_FALSE(r.chosen());
  r.app.chains[0].weight = 1;
  r.policy.placements[0].hold_us = {};
  EXPECT_FALSE(r.chosen()) << "nothing holds it";
}

}  // namespace
}  // namespace xauto::solver::keys
