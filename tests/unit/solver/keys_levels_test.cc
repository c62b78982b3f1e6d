// SPDX-License-Identifier: Apache-2.0
// XPUs that preempt by levels (docs/keys.md, "Levels"): all executions of tiny sets of jobs against
// last_start, random policies against the attack, policies of the solver against the naive simulator.
#include <cstdio>
#include <functional>

#include <gtest/gtest.h>

#include "solver/keys/play.h"

#include "../cases.h"
#include "attack/attack.h"
#include "attack/producer.h"
#include "keys_certified.h"
#include "keys_naive.h"
#include "keys_random.h"

namespace xauto::solver::keys::test {
namespace {

using attack::Case;

void set_levels(Platform& platform, int levels) {
  for (Xpu& xpu : platform.xpus)
    if (xpu.preemptive) xpu.levels = levels;
}

// ---------------------------------------------------------------- every execution of a few jobs

/// One job of each XNode: ready at some instant of [hold, hold + jitter], for 1 to `most` us.
struct TinyJob {
  int hold = 0, jitter = 0, most = 1, key = 1;
};
constexpr int kPeriod = 1000;  // far more than all of them take

struct Tiny {
  Case c;
  std::vector<TinyJob> jobs;
};

Tiny tiny(std::uint64_t seed, int levels) {
  solver::test::Dice dice(seed);
  Tiny t;
  t.c.app.name = "tiny";
  t.c.app.clocks = {{"main", 0}};
  t.c.platform = {"p", {{"gpu0", "gpu", true, 0, 0, -1, levels}}};
  const int n = dice.roll(2, 4);
  for (int i = 0; i < n; ++i) {
    TinyJob j{0, dice.roll(0, 4), dice.roll(1, 3), 0};
    // A hold that is later than the message leaves one instant.
    if (dice.chance(30)) j = {dice.roll(0, 6), 0, j.most, 0};
    j.key = j.hold + j.jitter + j.most + dice.roll(0, 8);
    t.jobs.push_back(j);
    SourceSpec s;
    s.name = "s" + std::to_string(i);
    s.period = {kPeriod, 1};
    s.jitter_us = j.jitter;
    t.c.app.sources.push_back(s);
    XNodeSpec x;
    x.name = x.module = "x" + std::to_string(i);
    x.wcet_us["gpu"] = j.most;
    x.sources = {i};
    t.c.app.modules.push_back({x.module, 1, false});
    t.c.app.xnodes.push_back(x);
    t.c.app.chains.push_back({x.name, i, i, {}, 1});
    Placement placed;
    placed.xpu = 0;
    placed.key_us = {j.key};
    if (j.hold > 0) placed.hold_us = {j.hold};
    t.c.policy.placements.push_back(placed);
  }
  return t;
}

/// What happened to each job in the executions: the earliest start as the `depth`-th, and the latest end.
struct Seen {
  std::vector<std::vector<int>> start;  ///< [depth][job]
  std::vector<int> end;                 ///< [job]
};
constexpr int kNotSeen = 1 << 20;

/// By the words of the coordinator: a stack of started jobs, the top one runs.
void execute(const std::vector<TinyJob>& jobs, const std::vector<int>& ready, std::vector<int> left,
             int levels, Seen& seen) {
  std::vector<int> stack;
  std::vector<char> started(jobs.size(), 0);
  std::size_t ended = 0;
  for (int now = 0; ended < jobs.size(); ++now) {
    for (;;) {
      int next = -1;
      for (std::size_t i = 0; i < jobs.size(); ++i)
        if (started[i] == 0 && ready[i] <= now && (next < 0 || jobs[i].key < jobs[at(next)].key))
          next = static_cast<int>(i);
      if (next < 0 || static_cast<int>(stack.size()) >= levels) break;
      if (!stack.empty() && jobs[at(stack.back())].key <= jobs[at(next)].key) break;
      stack.push_back(next);
      started[at(next)] = 1;
      int& first = seen.start[stack.size()][at(next)];
      first = std::min(first, now);
    }
    if (stack.empty()) continue;
    const int runs = stack.back();
    if (--left[at(runs)] > 0) continue;
    seen.end[at(runs)] = std::max(seen.end[at(runs)], now + 1);
    stack.pop_back();
    ++ended;
  }
}

Seen execute_all(const std::vector<TinyJob>& jobs, int levels) {
  Seen seen;
  seen.start.assign(jobs.size() + 1, std::vector<int>(jobs.size(), kNotSeen));
  seen.end.assign(jobs.size(), 0);
  std::vector<int> ready, left;
  const std::function<void()> choose = [&] {
    const std::size_t i = ready.size();
    if (i == jobs.size()) return execute(jobs, ready, left, levels, seen);
    for (int r = 0; r <= jobs[i].jitter; ++r)
      for (int c = 1; c <= jobs[i].most; ++c) {
        ready.push_back(jobs[i].hold + r);
        left.push_back(c);
        choose();
        ready.pop_back();
        left.pop_back();
      }
  };
  choose();
  return seen;
}

/// Nobody starts on the last level before last_start. Where it says never, no execution needs a level more.
TEST(KeysLevels, AllExecutionsStartOnTheLastLevelAsItSays) {
  int finite = 0, reached = 0, wrong_by_one = 0, nobody = 0;
  for (std::uint64_t seed = 1; seed <= 300; ++seed) {
    Tiny t = tiny(seed, 0);
    const Seen any = execute_all(t.jobs, 99);
    for (const int levels : {1, 2, 3}) {
      t.c.platform.xpus[0].levels = levels == 1 ? 0 : levels;
      t.c.platform.xpus[0].preemptive = levels > 1;
      const auto p = Problem::create(t.c.app, t.c.platform);
      ASSERT_TRUE(p) << (p ? "" : p.error().to_string());
      Windows w = keys_and_holds(*p, t.c.policy);
      w.a.resize(at(p->num_slots));
      const std::vector<int> xpu(t.jobs.size(), 0);
      derive_ready(*p, 0, xpu, w);
      Charges charges;
      charge(*p, xpu, w, w, -1, charges);
      if (static_cast<int>(t.jobs.size()) <= levels) {
        for (const Tick start : charges.last_start) EXPECT_EQ(start, kForever);
        continue;
      }
      // It is asked for only where one more may want a level.
      if (std::all_of(charges.last_start.begin(), charges.last_start.end(),
                      [](Tick start) { return start == kForever; })) {
        ++nobody;
        for (const int start : any.start[at(levels) + 1]) EXPECT_EQ(start, kNotSeen) << seed;
        continue;
      }
      for (std::size_t i = 0; i < t.jobs.size(); ++i) {
        const Tick says = charges.last_start[at(p->slot[i])];
        const int is = any.start[at(levels)][i];
        EXPECT_TRUE(is == kNotSeen || says <= is)
            << "seed " << seed << " levels " << levels << " job " << i;
        if (says < kForever) ++finite;
        if (says < kForever && is < kNotSeen) ++reached;
        // One level more is another bound: whoever counts one too few is found.
        if (at(levels) + 1 < any.start.size() && is < kNotSeen &&
            any.start[at(levels) + 1][i] != is)
          ++wrong_by_one;
      }
    }
  }
  std::printf("%d may be on the last level, %d are in some execution; of %d sets none waits\n",
              finite, reached, nobody);
  EXPECT_GT(nobody, 50);
  EXPECT_GE(reached, finite * 9 / 10) << "the bound says little";
  EXPECT_GT(wrong_by_one, 100);
}

/// What is certified is in time in all executions; told of another number of levels it is not.
TEST(KeysLevels, NoExecutionOfAFewJobsIsLate) {
  int in_time = 0, tight = 0, one_more = 0, any_number = 0, refused_by_check = 0;
  for (std::uint64_t seed = 1; seed <= 1500; ++seed) {
    const int levels = 2 + static_cast<int>(seed % 2);
    Tiny t = tiny(seed, levels);
    if (static_cast<int>(t.jobs.size()) <= levels) continue;
    const Seen seen = execute_all(t.jobs, levels);
    bool late = false, at_key = false;
    for (std::size_t i = 0; i < t.jobs.size(); ++i) {
      late = late || seen.end[i] > t.jobs[i].key;
      at_key = at_key || seen.end[i] == t.jobs[i].key;
    }
    const bool holds = certified(t.c);
    EXPECT_FALSE(holds && late) << seed;
    in_time += holds ? 1 : 0;
    tight += holds && at_key ? 1 : 0;
    attack::Case claims = t.c;
    claims.policy.app = t.c.app.name;
    claims.policy.app_hash = t.c.app.hash();
    claims.policy.platform = t.c.platform.name;
    claims.policy.method = "test";
    for (const ChainSpec& chain : t.c.app.chains)
      claims.policy.chains.push_back({chain.name, 900'000'000, 0, false});
    const bool checked = attack::check(claims.app, claims.platform, claims.policy).has_value();
    EXPECT_FALSE(checked && late) << seed;
    EXPECT_FALSE(holds && !checked) << seed;
    refused_by_check += checked ? 0 : 1;
    set_levels(t.c.platform, levels + 1);
    one_more += certified(t.c) && late ? 1 : 0;
    set_levels(t.c.platform, 0);
    any_number += certified(t.c) && late ? 1 : 0;
  }
  std::printf(
      "%d certified, %d of them reach a key; late and certified with a level more: %d, with any: "
      "%d\n",
      in_time, tight, one_more, any_number);
  EXPECT_GE(in_time, 200);
  EXPECT_GE(tight, in_time / 4);
  EXPECT_GE(refused_by_check, 50);
  EXPECT_GE(one_more, 5) << "whoever counts a level too many is not found";
  EXPECT_GE(any_number, 5) << "whoever forgets blocking is not found";
}

// ------------------------------------------------------------------------------------- policies

attack::Wanted by_levels(std::uint64_t seed) {
  attack::Wanted w;
  w.levels = 2 + static_cast<int>(seed % 2);
  w.clocks = seed % 3 == 0 ? 2 : 1;
  w.ppm = seed % 5 == 0 ? 20'000 : 0;
  w.components = 4 + static_cast<int>(seed / 3 % 3);
  w.load = seed % 4 == 0 ? 0.85 : 0.6;
  w.preempt_us = seed / 4 % 2 == 0 ? 0 : 10;
  w.jitter_us = seed % 7 > 3 ? 60 : 0;
  w.holds = seed % 4 > 1;
  w.order = seed % 6 == 1;
  return w;
}

TEST(KeysLevels, NothingBreaksWhatIsJustAccepted) {
  const int apps = xauto::test::cases(60, 90);
  int made = 0, touched = 0, blocked = 0;
  for (std::uint64_t seed = 1; seed <= static_cast<std::uint64_t>(apps); ++seed) {
    auto c = attack::valid(seed, by_levels(seed));
    if (!c) continue;
    const bool own = seed % 2 == 0 && certified(*c);
    if (own)
      attack::tighten(*c, seed, seed % 3 == 0, certified);
    else
      attack::tighten(*c, seed, seed % 3 == 0);
    ++made;
    const auto found = attack::attack(c->app, c->platform, c->policy, {20'000, seed});
    EXPECT_TRUE(found.late.empty()) << seed << ": " << found.late;
    touched += found.closest_us > -0.001 ? 1 : 0;
    const auto played = play(c->app, c->platform, c->policy, {1, true, true, true, seed});
    ASSERT_TRUE(played) << played.error().to_string();
    EXPECT_EQ(played->late, 0) << seed << ": " << played->first_late;
    const auto report = attack::check(c->app, c->platform, c->policy);
    ASSERT_TRUE(own || report) << seed;
    if (!report) continue;
    for (const auto& xpu : report->xpus) blocked += xpu.kind == "demand bound and blocking" ? 1 : 0;
  }
  std::printf("%d made, %d reach a key, %d XPUs with blocking\n", made, touched, blocked);
  EXPECT_GE(9 * made, 7 * apps);
  EXPECT_GE(touched, made / 3);
  EXPECT_GE(blocked, made / 3);
}

/// Keys that are as small as they may be with other levels: both refuse what the attack breaks.
TEST(KeysLevels, PoliciesForOtherLevelsAreRefusedAndBroken) {
  for (const bool any : {false, true}) {
    int made = 0, refused = 0, broken = 0;
    for (std::uint64_t seed = 1; seed <= 60; ++seed) {
      attack::Wanted w = by_levels(seed);
      w.levels = 2;
      w.load = 0.85;
      auto c = attack::valid(seed, w);
      if (!c) continue;
      const Platform truth = c->platform;
      set_levels(c->platform, any ? 0 : 3);
      attack::tighten(*c, seed, false);
      c->platform = truth;
      ++made;
      const bool accepted = attack::check(c->app, c->platform, c->policy).has_value();
      const bool own = certified(*c);
      const auto found = attack::attack(c->app, c->platform, c->policy, {40'000, seed});
      EXPECT_FALSE((accepted || own) && !found.late.empty()) << seed << found.late;
      refused += accepted ? 0 : 1;
      broken += found.broken() ? 1 : 0;
    }
    std::printf("%s: %d made, %d refused, %d broken\n", any ? "any number" : "one level more", made,
                refused, broken);
    EXPECT_GE(refused, 10);
    EXPECT_GE(broken, 3);
  }
}

// --------------------------------------------------------------------------------- the solver's

struct Played {
  int policies = 0;
  std::int64_t jobs = 0;
};

/// The solver is told `told` levels; what broke first.
std::string solve_and_play(const RatedShape& shape, int apps, int plays,
                           const std::function<int(int)>& told, Played& played) {
  for (int a = 0; a < apps; ++a) {
    solver::test::Dice dice(static_cast<std::uint64_t>(a) + 7'000'003);
    const AppSpec app = random_rated_app(dice, shape);
    Platform platform = {"tiny",
                         {{"cpu0", "cpu", true, 0}, {"gpu0", "gpu", true, dice.roll(0, 2)}}};
    const int levels = dice.roll(2, 3);
    set_levels(platform, levels);
    Platform on = platform;
    set_levels(on, told(levels));
    const Result<Answer> answer = solve(app, on, brief(60));
    if (!answer) {
      ADD_FAILURE() << answer.error().to_string();
      continue;
    }
    if (answer->outcome != Outcome::kPolicy) continue;
    ++played.policies;
    if (told(levels) == levels) {
      const auto derived = check(app, platform, answer->policy);
      EXPECT_TRUE(derived) << "app " << a << ": " << (derived ? "" : derived.error().to_string());
    }
    const std::string broken = play_naively(app, platform, answer->policy, plays, 14, played.jobs);
    if (!broken.empty()) return "app " + std::to_string(a) + " " + broken;
  }
  return {};
}

RatedShape crowded(int clocks) {
  RatedShape shape;
  shape.max_components = 6;
  shape.max_nodes = 2;
  shape.clocks = clocks;
  shape.least_period = 20;
  shape.most_period = 60;
  shape.max_wcet = 6;
  shape.ppm = clocks > 1 ? 20'000 : 0;
  return shape;
}

TEST(KeysLevels, NoExecutionBreaksAPolicyOfTheSolver) {
  for (const int clocks : {1, 2}) {
    Played played;
    EXPECT_EQ(solve_and_play(
                  crowded(clocks), 120, 12, [](int levels) { return levels; }, played),
              "");
    EXPECT_GT(played.policies, 60);
  }
}

TEST(KeysLevels, ThePlayFindsThatTheSolverWasToldOtherLevels) {
  Played played;
  EXPECT_NE(solve_and_play(
                crowded(1), 600, 24, [](int levels) { return levels + 1; }, played),
            "");
  EXPECT_NE(solve_and_play(
                crowded(1), 600, 24, [](int) { return 0; }, played),
            "");
}

TEST(KeysLevels, UrgentReleasesAreCounted) {
  RatedShape shape = crowded(1);
  shape.urgent = true;
  Played played;
  EXPECT_EQ(solve_and_play(
                shape, 80, 12, [](int levels) { return levels; }, played),
            "");
  EXPECT_GT(played.policies, 20);
}

/// As many as there may ever be: nothing is charged that is not without levels.
TEST(KeysLevels, EnoughLevelsAreAsGoodAsAnyNumber) {
  int made = 0;
  for (std::uint64_t seed = 1; seed <= 40; ++seed) {
    attack::Wanted w = by_levels(seed);
    w.levels = 0;
    auto c = attack::valid(seed, w);
    if (!c) continue;
    attack::tighten(*c, seed, seed % 2 == 0);
    ++made;
    set_levels(c->platform, static_cast<int>(c->app.xnodes.size()));
    EXPECT_TRUE(attack::check(c->app, c->platform, c->policy)) << seed;
  }
  EXPECT_GE(made, 30);
}

}  // namespace
}  // namespace xauto::solver::keys::test
