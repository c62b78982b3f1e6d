// SPDX-License-Identifier: Apache-2.0
#include <gtest/gtest.h>

#include "solver/keys/check.h"
#include "solver/keys/play.h"

#include "attack/attack.h"
#include "attack/producer.h"

namespace xauto::solver::keys::test {
namespace {

using attack::Case;
using attack::claim_what_follows;

constexpr std::int64_t kEver = 900'000'000'000;

/// One XPU of each kind; XNodes, edges and keys follow.
Case empty(bool preemptive = true, std::int64_t preempt_us = 0) {
  Case c;
  c.app.name = "sketch";
  c.platform = {"p",
                {{"cpu0", "cpu", preemptive, preempt_us, 0, -1},
                 {"gpu0", "gpu", preemptive, preempt_us, 0, -1}}};
  c.policy.app = c.app.name;
  return c;
}

int source(Case& c, std::int64_t period, std::int64_t offset = 0, std::int64_t jitter = 0,
           int clock = 0) {
  c.app.sources.push_back(
      {"s" + std::to_string(c.app.sources.size()), {period, 1}, offset, jitter, clock});
  return static_cast<int>(c.app.sources.size()) - 1;
}

/// XNode 'a', 'b', ... each in a module of its own; `from`: a source, or -1 for the XNode before.
int xnode(Case& c, int from, int xpu, std::int64_t wcet, std::vector<std::int64_t> keys,
          std::vector<std::int64_t> holds = {}) {
  const auto i = static_cast<int>(c.app.xnodes.size());
  const std::string name(1, static_cast<char>('a' + i));
  c.app.xnodes.push_back({name, "M" + name, {{c.platform.xpus[at(xpu)].type, wcet}}});
  c.app.modules.push_back({"M" + name, 1, false});
  if (from >= 0)
    c.app.xnodes.back().sources = {from};
  else
    c.app.edges.emplace_back(i - 1, i);
  c.policy.placements.push_back({xpu, std::move(keys), std::move(holds), {}, {}});
  return i;
}

void chain(Case& c, int from, int to, std::int64_t claim = kEver) {
  c.app.chains.push_back({"chain" + std::to_string(c.app.chains.size()), from, to, {}, 1});
  c.policy.chains.push_back({c.app.chains.back().name, claim, 0, false});
}

Result<CheckReport> checked(Case& c) {
  if (c.app.chains.empty()) chain(c, c.app.xnodes[0].sources[0], 0);
  c.policy.app_hash = c.app.hash();
  return check(c.app, c.platform, c.policy);
}

testing::AssertionResult holds(Case& c) {
  const auto report = checked(c);
  if (!report) return testing::AssertionFailure() << report.error().to_string();
  const auto found = attack::attack(c.app, c.platform, c.policy, {50'000, 1});
  if (found.broken()) return testing::AssertionFailure() << found.late << found.chain;
  return testing::AssertionSuccess();
}

/// Refused, with `words` in what is said, and not for nothing: an execution breaks it.
testing::AssertionResult fails(Case& c, const std::string& words) {
  const auto report = checked(c);
  if (report) return testing::AssertionFailure() << "it is accepted";
  const std::string text = report.error().to_string();
  if (text.find(words) == std::string::npos) return testing::AssertionFailure() << text;
  if (report.error().code != ErrorCode::kInfeasible)
    return testing::AssertionFailure() << "not a no: " << text;
  const auto found = attack::attack(c.app, c.platform, c.policy, {200'000, 1});
  if (!found.broken()) return testing::AssertionFailure() << "no execution breaks it: " << text;
  return testing::AssertionSuccess();
}

testing::AssertionResult refused(Case& c, const std::string& words) {
  const auto report = checked(c);
  if (report) return testing::AssertionFailure() << "it is accepted";
  if (report.error().to_string().find(words) == std::string::npos)
    return testing::AssertionFailure() << report.error().to_string();
  return testing::AssertionSuccess();
}

// ------------------------------------------------------------------------------- seeded faults

TEST(KeysCheck, KeysThatForgetTheJitterAreRefused) {
  Case c = empty();
  xnode(c, source(c, 1000), 0, 300, {300});
  EXPECT_TRUE(holds(c));
  c.app.sources[0].jitter_us = 1;
  EXPECT_TRUE(fails(c, "ready by 1 us"));
}

TEST(KeysCheck, KeysThatForgetTheBlockingAreRefused) {
  for (const bool preemptive : {true, false}) {
    Case c = empty(preemptive);
    xnode(c, source(c, 1000), 0, 400, {900});
    xnode(c, source(c, 1000, 399), 0, 100, {100});
    if (preemptive)
      EXPECT_TRUE(holds(c));
    else
      EXPECT_TRUE(fails(c, "400 us of 'a', which may run when they begin"));
    // Nothing may run when it begins.
    c.app.sources[1].offset_us = 400;
    c.policy.placements[0].key_us = {400};
    EXPECT_TRUE(holds(c));
  }
}

/// On an XPU that is full there is no end of the busy time; a turn of the windows is enough.
TEST(KeysCheck, AGateMayBeFull) {
  Case c = empty(false);
  xnode(c, source(c, 1000), 1, 600, {600});
  xnode(c, source(c, 1000), 1, 400, {1000}, {600});
  EXPECT_TRUE(holds(c));
  c.policy.placements[1].key_us = {999};
  EXPECT_TRUE(fails(c, "ready by 600 us"));
  c.policy.placements[1].key_us = {1000};
  c.app.sources[0].offset_us = 1;  // the grid's begin moves on for one of them: `b` may come first
  c.policy.placements[1].hold_us = {};
  EXPECT_TRUE(fails(c, "of 'b', which may run when they begin"));
}

/// `a` pays for a preemption in every second activation. If it always did, the XPU would be overloaded.
TEST(KeysCheck, NotEveryJobPays) {
  Case c = empty(true, 1000);
  c.app.clocks = {{"main", 0}, {"lidar", 0}};
  xnode(c, source(c, 10'000), 0, 2000, {8000});
  xnode(c, source(c, 20'000), 0, 8900, {20'000});
  xnode(c, source(c, 10'000, 0, 0, 1), 0, 2000, {8000});
  EXPECT_TRUE(holds(c));
  EXPECT_EQ(checked(c)->xpus[0].kind, "demand bound");
  c.app.xnodes[1].wcet_us["cpu"] = 9000;
  EXPECT_TRUE(holds(c));  // full: 20 ms of work in 20 ms
  c.app.xnodes[1].wcet_us["cpu"] = 9001;
  EXPECT_TRUE(refused(c, "load it by 100.0050 %"));
}

TEST(KeysCheck, KeysThatForgetThePreemptionsAreRefused) {
  Case c = empty(true, 50);
  xnode(c, source(c, 1000), 0, 400, {900});
  xnode(c, source(c, 1000, 399), 0, 100, {149});
  EXPECT_TRUE(fails(c, "150 us of work, charged preemptions included"));
  c.policy.placements[1].key_us = {150};
  EXPECT_TRUE(holds(c));
  EXPECT_EQ(checked(c)->xpus[0].charged, 1);
  // Held until the other one has ended, it finds nobody to suspend.
  c.policy.placements[1].key_us = {501};
  c.policy.placements[1].hold_us = {401};
  c.policy.placements[0].key_us = {400};
  EXPECT_TRUE(holds(c));
  EXPECT_EQ(checked(c)->xpus[0].charged, 0);
}

TEST(KeysCheck, KeysThatForgetTheModuleIsFullAreRefused) {
  Case c = empty();
  xnode(c, source(c, 1000), 0, 600, {600});
  xnode(c, -1, 1, 600, {1200});
  c.app.xnodes[1].module = "Ma";
  c.app.modules = {{"Ma", 2, false}};
  EXPECT_TRUE(holds(c));
  c.app.modules[0].max_in_flight = 1;
  EXPECT_TRUE(fails(c, "XNode 'a', activation 0, XPU cpu0: it is ready by 200 us"));
}

TEST(KeysCheck, KeysThatForgetATransferAreRefused) {
  Case c = empty();
  xnode(c, source(c, 1000), 0, 100, {100});
  xnode(c, -1, 1, 100, {200});
  EXPECT_TRUE(holds(c));
  for (XNodeSpec& x : c.app.xnodes) x.wcet_us = {{"cpu", 100}, {"gpu", 100}};
  c.app.transfers = {{0, "gpu", "cpu", 50}};  // the other way
  EXPECT_TRUE(holds(c));
  c.app.transfers = {{0, "cpu", "gpu", 50}};
  EXPECT_TRUE(fails(c, "ready by 150 us"));
}

TEST(KeysCheck, AFastClockBringsWindowsOfDifferentReleasesTogether) {
  // Modulo the period [0, 500000] and [500000, 1000000]; but the second belongs to an earlier
  // release, and does not come closer as the clock is fast.
  Case c = empty();
  c.app.clocks = {{"main", 0}};
  xnode(c, source(c, 1'000'000), 0, 499'950, {500'000});
  xnode(c, source(c, 1'000'000, 0, 1'500'000), 0, 499'950, {2'000'000});
  c.app.modules[1].max_in_flight = 3;
  EXPECT_TRUE(holds(c));
  c.app.clocks[0].ppm = 100;
  EXPECT_TRUE(fails(c, "XPU cpu0"));
  c.app.xnodes[0].wcet_us["cpu"] = c.app.xnodes[1].wcet_us["cpu"] = 499'800;
  EXPECT_TRUE(holds(c));
}

TEST(KeysCheck, HoldsDelayReadiness) {
  Case c = empty();
  xnode(c, source(c, 1000), 0, 100, {150}, {50});
  EXPECT_TRUE(holds(c));
  c.policy.placements[0].hold_us = {51};
  EXPECT_TRUE(fails(c, "ready by 51 us"));
}

TEST(KeysCheck, TwoClocksMayMeetAtAnyPhase) {
  Case c = empty();
  c.app.clocks.push_back({"lidar", 0});
  xnode(c, source(c, 1000), 0, 300, {500});
  xnode(c, source(c, 1500, 0, 0, 1), 0, 400, {699});
  EXPECT_TRUE(fails(c, "700 us of work may have their windows in the 699 us before its key"));
  c.policy.placements[1].key_us = {700};
  EXPECT_TRUE(holds(c));
  // On one clock the offset keeps them apart.
  c.app.sources[1] = {"s1", {2000, 1}, 300, 0, 0};
  c.policy.placements[1].key_us = {400};
  c.policy.placements[0].key_us = {300};
  EXPECT_TRUE(holds(c));
  EXPECT_EQ(checked(c)->xpus[0].kind, "schedule");
}

TEST(KeysCheck, EachActivationHasItsOwnKey) {
  // Every second activation of a meets b.
  Case c = empty();
  xnode(c, source(c, 1000), 0, 300, {700, 300});
  xnode(c, source(c, 2000), 0, 400, {400});
  EXPECT_TRUE(holds(c));
  const XpuProof proof = checked(c)->xpus[0];
  EXPECT_EQ(proof.jobs, 3);
  EXPECT_EQ(proof.slack_us, 0);
  c.policy.placements[0].key_us = {300, 700};
  EXPECT_TRUE(fails(c, "700 us of work"));
  c.policy.placements[0].key_us = {700, 300, 700};
  EXPECT_TRUE(refused(c, "3 keys do not divide the 2 activations of a hyperperiod"));
}

TEST(KeysCheck, AnXNodeTakesActivationsInOrder) {
  Case c = empty();
  xnode(c, source(c, 1000), 0, 300, {1500, 400});
  source(c, 2000);
  c.app.xnodes[0].sources = {0};
  xnode(c, 1, 1, 100, {100});
  EXPECT_TRUE(refused(c, "must not fall"));
}

// ------------------------------------------------------------------------------------- chains

/// u, of the first source, is sampled by v, of the second.
Case sampled(int clock, std::int64_t ppm, std::vector<std::int64_t> hold, std::int64_t key) {
  Case c = empty();
  if (clock > 0) c.app.clocks.push_back({"other", ppm});
  xnode(c, source(c, 1000), 0, 100, {300});
  xnode(c, source(c, 1000, 0, 0, clock), 1, 100, {key}, std::move(hold));
  c.app.samples = {{0, 1}};
  chain(c, 0, 1);
  return c;
}

std::int64_t derived(Case c) {
  const auto report = checked(c);
  return report ? report->chains[0].derived_us : -1;
}

TEST(KeysCheck, AReaderMayStartAtItsRelease) {
  EXPECT_EQ(derived(sampled(0, 0, {}, 100)), 1100);
  EXPECT_EQ(derived(sampled(0, 0, {300}, 400)), 400);
  EXPECT_EQ(derived(sampled(0, 0, {299}, 400)), 1400);
  EXPECT_EQ(derived(sampled(1, 0, {}, 100)), 1400);
  EXPECT_EQ(derived(sampled(1, 0, {300}, 400)), 1400);
  EXPECT_EQ(derived(sampled(1, 100, {}, 100)), 1401);
}

TEST(KeysCheck, AClaimBelowWhatFollowsIsRefused) {
  for (Case c : {sampled(0, 0, {}, 100), sampled(0, 0, {300}, 400)}) {
    const std::int64_t follows = derived(c);
    c.policy.chains[0].worst_case_us = follows;
    EXPECT_TRUE(holds(c));
    c.policy.chains[0].worst_case_us = follows - 1;
    EXPECT_TRUE(refused(c, "what follows is " + std::to_string(follows)));
    c.policy.chains[0] = {"chain0", follows, follows + 1, false};
    EXPECT_TRUE(refused(c, "is never longer"));
    c.policy.chains[0] = {"chain0", follows, follows - 1, true};
    EXPECT_TRUE(refused(c, "optimal"));
  }
}

TEST(KeysCheck, ATightWorstCaseOccurs) {
  Case c = sampled(0, 0, {}, 100);
  xnode(c, source(c, 1000), 0, 200, {200});  // delays u up to its key
  c.policy.app_hash = c.app.hash();
  ASSERT_TRUE(claim_what_follows(c));
  EXPECT_EQ(attack::attack(c.app, c.platform, c.policy, {50'000, 1}).fullest, 1);
  c.policy.chains[0].worst_case_us -= 1;
  EXPECT_TRUE(fails(c, "along s0 > a > a > b > b"));
}

TEST(KeysCheck, NoPathVisitsAComponentTwice) {
  Case c = sampled(0, 0, {}, 100);
  c.app.samples.emplace_back(1, 0);  // feedback
  EXPECT_EQ(derived(c), 1100);
  chain(c, 0, 0);
  EXPECT_EQ(checked(c)->chains[1].derived_us, 300);
  c.app.samples.clear();
  EXPECT_TRUE(refused(c, "XNode 'b' does not hear of source 's0'"));
}

/// Each of them: whoever mends the first and asks again would wait for each next one.
TEST(KeysCheck, TellsAllThatIsFalse) {
  Case c = empty();
  c.platform.xpus.push_back({"cpu1", "cpu", true, 0, 0, -1});
  for (int i = 0; i < 3; ++i) {
    xnode(c, source(c, 1000), i, 300, {300});
    chain(c, i, i, 300);
    c.policy.chains.back().lower_bound_us = 300;
    c.policy.chains.back().optimal = true;
  }
  ASSERT_TRUE(checked(c));
  const auto truth = examine(c.app, c.platform, c.policy);
  ASSERT_TRUE(truth) << truth.error().to_string();
  EXPECT_TRUE(truth->lies.empty());
  // Its two CPUs share what nobody has measured.
  ASSERT_EQ(truth->taken.size(), 1U);
  EXPECT_TRUE(truth->taken[0].starts_with("XPUs are independent")) << truth->taken[0];
  EXPECT_EQ(truth->chains.size(), 3u);
  EXPECT_TRUE(check(c.app, c.platform, c.policy));

  Case bad = c;
  bad.policy.chains[0].worst_case_us = 299;  // and so is not its bound
  bad.policy.chains[2] = {"chain2", 299, 301, false};
  const auto lies = examine(bad.app, bad.platform, bad.policy);
  ASSERT_TRUE(lies) << lies.error().to_string();
  std::string said;
  for (const Error& lie : lies->lies) said += lie.to_string() + "\n";
  EXPECT_EQ(lies->lies.size(), 4u) << said;
  EXPECT_EQ(check(bad.app, bad.platform, bad.policy).error().to_string(),
            lies->lies[0].to_string());

  // One CPU is too full: nothing follows of the chains.
  bad = c;
  bad.policy.placements[2].xpu = 0;
  const auto full = examine(bad.app, bad.platform, bad.policy);
  ASSERT_TRUE(full) << full.error().to_string();
  EXPECT_EQ(full->lies.size(), 1u);
  EXPECT_TRUE(full->chains.empty());
  EXPECT_TRUE(full->xpus[0].kind.empty());
  EXPECT_FALSE(full->xpus[1].kind.empty());

  bad = c;
  bad.app.chains[0].to = bad.app.chains[1].to = bad.app.chains[2].to = 7;
  EXPECT_EQ(examine(bad.app, bad.platform, bad.policy).error().code, ErrorCode::kInvalid);
}

// ------------------------------------------------------------------------------ what is refused

TEST(KeysCheck, MalformedInputIsRefusedAndNothingElseHappens) {
  Case c = sampled(1, 100, {300}, 400);
  ASSERT_TRUE(checked(c));
  const auto spoilt = [&](const auto& spoil, const std::string& words) {
    Case bad = c;
    spoil(bad);
    const auto report = check(bad.app, bad.platform, bad.policy);
    const std::string text = report ? "it is accepted" : report.error().to_string();
    return text.find(words) == std::string::npos ? testing::AssertionFailure() << text
                                                 : testing::AssertionSuccess();
  };
  EXPECT_TRUE(spoilt([](Case& x) { x.policy.app = "another"; }, "solve this app again"));
  EXPECT_TRUE(spoilt([](Case& x) { x.policy.placements.pop_back(); }, "1 XNodes, the app has 2"));
  EXPECT_TRUE(spoilt([](Case& x) { x.policy.placements[0].xpu = 2; }, "XNode 'a': no XPU"));
  EXPECT_TRUE(spoilt([](Case& x) { x.policy.placements[0].xpu = 1; }, "no implementation"));
  EXPECT_TRUE(spoilt([](Case& x) { x.policy.placements[0].key_us = {}; }, "not of one number"));
  EXPECT_TRUE(spoilt([](Case& x) { x.policy.placements[0].key_us = {INT64_MAX}; }, "out of range"));
  EXPECT_TRUE(spoilt([](Case& x) { x.policy.placements[0].hold_us = {-1}; }, "out of range"));
  EXPECT_TRUE(spoilt(
      [](Case& x) {
        x.policy.placements[0].hold_us = {1, 2};
      },
      "not of one number"));
  EXPECT_TRUE(spoilt([](Case& x) { x.policy.placements[0].key_us = {20'000'000}; },
                     "periods after its release"));
  EXPECT_TRUE(spoilt([](Case& x) { x.policy.placements[0].start_us = {1}; }, "not of one number"));
  EXPECT_TRUE(spoilt(
      [](Case& x) {
        x.policy.placements[0].start_us = {1};
        x.policy.placements[0].finish_us = {301};
      },
      "contradict"));
  EXPECT_TRUE(spoilt([](Case& x) { x.policy.chains[0].name = "x"; }, "'x', not 'chain0'"));
  EXPECT_TRUE(spoilt([](Case& x) { x.policy.chains.clear(); }, "0 chains, the app has 1"));
  EXPECT_TRUE(spoilt([](Case& x) { x.app.chains[0].to = 7; }, "chain"));
  EXPECT_TRUE(spoilt([](Case& x) { x.app.samples[0].second = 2; }, "samples"));
  EXPECT_TRUE(spoilt([](Case& x) { x.app.xnodes[0].sources = {}; }, "neither"));
  EXPECT_TRUE(spoilt([](Case& x) { x.app.sources[0].clock = 2; }, "clock"));
  EXPECT_TRUE(spoilt([](Case& x) { x.app.clocks[1].ppm = 1'000'000; }, "ppm"));
  EXPECT_TRUE(spoilt([](Case& x) { x.app.edges = {{0, 1}}; }, "with predecessors"));
  EXPECT_TRUE(spoilt([](Case& x) { x.app.modules[0].max_in_flight = 0; }, "max_in_flight"));
  EXPECT_TRUE(spoilt([](Case& x) { x.platform.xpus.clear(); }, "XPU"));
  // Denominators whose least common multiple does not fit.
  EXPECT_TRUE(spoilt(
      [](Case& x) {
        for (const std::int64_t prime : {999'983, 999'979, 999'961})
          x.app.sources.push_back({"p" + std::to_string(prime), {10'000'001, prime}, 0, 0, 0});
      },
      "divides all their periods"));
}

TEST(KeysCheck, AnOverloadIsRefused) {
  Case c = empty();
  xnode(c, source(c, 1000), 0, 600, {100'000});
  c.app.modules[0].max_in_flight = 1000;
  xnode(c, source(c, 1500), 0, 601, {100'000});
  c.app.modules[1].max_in_flight = 1000;
  EXPECT_TRUE(refused(c, "load it by 100.0667 %"));
  c.app.xnodes[1].wcet_us["cpu"] = 600;
  EXPECT_TRUE(holds(c));
  c.app.clocks.push_back({"other", 100});
  c.app.sources[1].clock = 1;
  EXPECT_TRUE(refused(c, "load it by 100."));
}

TEST(KeysCheck, PatternsTooLongToEnumerateAreBoundByDemand) {
  Case c = empty();
  // 999 983 and 999 979 are primes: a hyperperiod of 11 days, and with a third one of 32 000 years.
  xnode(c, source(c, 999'983), 0, 300'000, {300'000});
  xnode(c, source(c, 999'979), 0, 300'000, {599'999});
  xnode(c, source(c, 999'961), 1, 300'000, {600'000});
  EXPECT_TRUE(fails(c, "600000 us of work may have their windows in the 599999 us"));
  c.policy.placements[1].key_us = {600'000};
  EXPECT_TRUE(holds(c));
  EXPECT_EQ(checked(c)->xpus[0].kind, "demand bound");
  EXPECT_EQ(checked(c)->xpus[1].kind, "schedule");
}

TEST(KeysCheck, EightThousandJobs) {
  Case c = empty();
  c.app.name = c.policy.app = "large";
  for (int k = 0; k < 40; ++k) {
    const int s = source(c, k % 2 == 0 ? 1000 : 3000);
    for (int i = 0; i < 2; ++i) {
      xnode(c, s, i, 12, {900});
      XNodeSpec& x = c.app.xnodes.back();
      x.name = "x" + std::to_string(c.app.xnodes.size());
      c.app.modules.back().name = x.module = "M" + x.name;
    }
  }
  xnode(c, source(c, 300'000), 0, 1, {200'000});
  for (Placement& p : c.policy.placements)
    if (p.key_us[0] == 900) p.key_us.assign(100, 900);
  const auto report = checked(c);
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_EQ(report->xpus[0].jobs, 8001);
}

// ------------------------------------------------------------------------------------- at random

attack::Wanted kind(std::uint64_t seed) {
  attack::Wanted w;
  w.clocks = 1 + static_cast<int>(seed % 3);
  w.ppm = seed % 2 == 0 ? 0 : 1000;
  w.components = 2 + static_cast<int>(seed / 3 % 3);
  w.load = seed % 4 == 0 ? 0.85 : 0.6;
  w.preemptive = seed % 5 > 0;
  w.preempt_us = seed % 5 > 2 ? 10 : 0;
  w.jitter_us = seed % 7 > 3 ? 60 : 0;
  w.thirds = seed % 6 == 5;
  w.holds = seed % 4 > 1;
  w.order = seed % 4 == 3;
  return w;
}

/// As KeysCertificate.PairsAreCountedOn, of the check: its windows, its lags and its chains.
TEST(KeysCheck, PairsAreCountedOn) {
  int made = 0, refused = 0, broken = 0;
  for (std::uint64_t seed = 1; seed <= 60; ++seed) {
    attack::Wanted w = kind(seed);
    w.order = true;
    w.preemptive = seed % 3 == 0;
    auto c = attack::valid(seed, w);
    if (!c || c->policy.order.empty()) continue;
    attack::tighten(*c, seed, seed % 2 == 0);
    ++made;
    const auto found = attack::attack(c->app, c->platform, c->policy, {20'000, seed});
    EXPECT_FALSE(found.broken()) << seed << ": " << found.late << found.chain;
    const auto played = play(c->app, c->platform, c->policy, {1, true, true, true, seed});
    ASSERT_TRUE(played) << played.error().to_string();
    EXPECT_EQ(played->late, 0) << seed << ": " << played->first_late;
    c->policy.order.clear();
    const bool accepted = check(c->app, c->platform, c->policy).has_value();
    const bool breaks = attack::attack(c->app, c->platform, c->policy, {20'000, seed}).broken();
    EXPECT_FALSE(accepted && breaks) << seed;
    refused += accepted ? 0 : 1;
    broken += breaks ? 1 : 0;
  }
  std::printf("%d made, %d refused without order, %d broken\n", made, refused, broken);
  EXPECT_GE(made, 20);
  EXPECT_GE(refused, made / 4);
  EXPECT_GE(broken, 4);
}

TEST(KeysCheck, OrderIsOfWhatIsReleasedTogetherOnOneXpu) {
  Case c = empty();
  xnode(c, source(c, 1000), 1, 100, {500});
  xnode(c, source(c, 1000), 1, 100, {600});
  xnode(c, source(c, 2000), 1, 100, {700});
  xnode(c, source(c, 1000), 0, 100, {700});
  EXPECT_TRUE(holds(c));
  c.policy.order = {{0, 1}};
  EXPECT_TRUE(holds(c));
  c.policy.order = {{0, 1}, {1, 0}};
  EXPECT_TRUE(refused(c, "circle"));
  c.policy.order = {{0, 2}};
  EXPECT_TRUE(refused(c, "do not belong together"));
  c.policy.order = {{0, 3}};
  EXPECT_TRUE(refused(c, "between two XPUs"));
  for (const auto& pair : {std::pair(0, 0), std::pair(-1, 0), std::pair(0, 4)}) {
    c.policy.order = {pair};
    EXPECT_TRUE(refused(c, "no pair of XNodes"));
  }
}

TEST(KeysCheck, NothingBreaksWhatIsJustAccepted) {
  int made = 0, touched = 0;
  for (std::uint64_t seed = 1; seed <= 60; ++seed) {
    auto c = attack::valid(seed, kind(seed));
    if (!c) continue;
    attack::tighten(*c, seed, seed % 2 == 0);
    ++made;
    const auto found = attack::attack(c->app, c->platform, c->policy, {20'000, seed});
    EXPECT_FALSE(found.broken()) << seed << ": " << found.late << found.chain;
    touched += found.closest_us > -0.001 ? 1 : 0;
    const auto played = play(c->app, c->platform, c->policy, {1, true, true, true, seed});
    ASSERT_TRUE(played) << played.error().to_string();
    EXPECT_EQ(played->late, 0) << seed << ": " << played->first_late;
    for (const PlayedChain& chain : played->chains)
      EXPECT_LE(chain.longest_us, static_cast<double>(*chain.claimed_us)) << seed;
  }
  EXPECT_GE(made, 50);
  EXPECT_GE(touched, 40);  // the attack reaches keys: it would see a microsecond more
}

TEST(KeysCheck, PoliciesForAKinderWorldAreRefusedAndBroken) {
  int refusals = 0, breaks = 0;
  for (std::uint64_t seed = 1; seed <= 40; ++seed) {
    attack::Wanted w = kind(seed);
    w.preemptive = true;
    w.preempt_us = 40;
    w.jitter_us = 100;
    auto c = attack::valid(seed, w);
    if (!c) continue;
    const Case truth = *c;
    if (seed % 2 == 0)
      for (SourceSpec& s : c->app.sources) s.jitter_us = 0;
    else
      for (Xpu& x : c->platform.xpus) x.preempt_us = 0;
    attack::tighten(*c, seed, false);
    c->app.sources = truth.app.sources;
    c->platform = truth.platform;
    c->policy.app_hash = c->app.hash();
    const bool accepted = check(c->app, c->platform, c->policy).has_value();
    const bool broken = attack::attack(c->app, c->platform, c->policy, {50'000, seed}).broken();
    EXPECT_FALSE(accepted && broken) << seed;
    refusals += accepted ? 0 : 1;
    breaks += broken ? 1 : 0;
  }
  EXPECT_GE(refusals, 30);
  EXPECT_GE(breaks, refusals * 2 / 3);
}

// ------------------------------------------------------------------------------------------ play

TEST(KeysPlay, TellsWhatHappens) {
  Case c = empty(true, 50);
  xnode(c, source(c, 1000), 0, 400, {900});
  xnode(c, source(c, 1000, 300), 0, 100, {149});
  c.app.samples = {{0, 1}};
  chain(c, 0, 1, 1234);
  c.policy.app_hash = c.app.hash();
  const auto played = play(c.app, c.platform, c.policy, {});
  ASSERT_TRUE(played) << played.error().to_string();
  // b suspends a at 300 and ends at 450, after its key; a ends at 550, and b reads it at 1300.
  EXPECT_EQ(played->xnodes[1].late, 10'000);
  EXPECT_EQ(played->xnodes[1].closest_us, 1);
  EXPECT_EQ(played->xnodes[0].closest_us, 550 - 900);
  EXPECT_EQ(played->xnodes[0].suspended, 10'000);
  EXPECT_EQ(played->chains[0].longest_us, 1450);
  EXPECT_EQ(played->chains[0].claimed_us, 1234);
  EXPECT_NEAR(played->busy[0], 0.55, 0.001);
  EXPECT_EQ(played->first_late,
            "XNode 'b', activation 0, ends 1.000 us after its key, at 450.000 us");
}

TEST(KeysPlay, RanksGoBeforeKeys) {
  Case c = empty(true, 50);
  xnode(c, source(c, 1000), 0, 400, {900});
  xnode(c, source(c, 1000, 300), 0, 100, {149});
  c.app.samples = {{0, 1}};
  chain(c, 0, 1, 1450);
  c.policy.app_hash = c.app.hash();
  const auto longest = [&](std::vector<std::int64_t> rank, std::int64_t suspended) {
    PlayOptions options;
    options.rank = std::move(rank);
    const auto played = play(c.app, c.platform, c.policy, options);
    EXPECT_TRUE(played);
    EXPECT_EQ(played->suspended, suspended);
    return played->chains[0].longest_us;
  };
  EXPECT_EQ(longest({}, 10'000), 1450);
  EXPECT_EQ(longest({1, 0}, 10'000), 1450);
  // a ends at 400 and b reads it; of equal ranks a was ready first.
  EXPECT_EQ(longest({0, 1}, 0), 500);
  EXPECT_EQ(longest({0, 0}, 0), 500);
  PlayOptions options;
  options.rank = {1};
  EXPECT_FALSE(play(c.app, c.platform, c.policy, options));
}

TEST(KeysPlay, WhatCannotKeepUpPilesUp) {
  Case c = empty();
  const int s = source(c, 10);
  chain(c, s, xnode(c, s, 0, 11, {20}));
  c.policy.app_hash = c.app.hash();
  const auto played = play(c.app, c.platform, c.policy, {10, false, false, false, 1});
  ASSERT_TRUE(played);
  EXPECT_GT(played->late, 900'000);
  EXPECT_GT(played->unfinished, 90'000);
}

/// A clock that is off for long meets every phase, so what is sampled just too late is seen: by each seed,
/// whichever clock drifts, and by as little as half of the ppm.
TEST(KeysPlay, ClocksThatAreOffComeRound) {
  for (const auto& [main_ppm, other_ppm] :
       std::vector<std::pair<int, int>>{{0, 1000}, {1000, 0}, {500, 500}, {0, 100}, {20'000, 3}}) {
    Case c = empty();
    c.app.clocks[0].ppm = main_ppm;
    c.app.clocks.push_back({"other", other_ppm});
    xnode(c, source(c, 1000), 0, 100, {100});
    xnode(c, source(c, 1000, 0, 0, 1), 1, 100, {100});
    c.app.samples = {{0, 1}};
    chain(c, 0, 1, 1300);
    c.policy.app_hash = c.app.hash();
    // In half of the play, at half of the ppm, the phase goes once round a period of 1 ms.
    const std::int64_t seconds = 4 * 1000 / (main_ppm + other_ppm) + 2;
    for (std::uint64_t seed = 1; seed <= 8; ++seed) {
      const auto played = play(c.app, c.platform, c.policy, {seconds, false, false, true, seed});
      ASSERT_TRUE(played) << played.error().to_string();
      EXPECT_GT(played->chains[0].longest_us, main_ppm > 10'000 ? 1180 : 1198)
          << main_ppm << " and " << other_ppm << " ppm, seed " << seed;
    }
  }
}

TEST(KeysPlay, TheSameSeedPlaysTheSame) {
  auto c = attack::valid(8, kind(8));
  ASSERT_TRUE(c);
  const PlayOptions options{2, true, true, true, 5};
  const auto one = play(c->app, c->platform, c->policy, options);
  const auto two = play(c->app, c->platform, c->policy, options);
  ASSERT_TRUE(one && two);
  EXPECT_EQ(one->suspended, two->suspended);
  EXPECT_EQ(one->chains[0].longest_us, two->chains[0].longest_us);
  PlayOptions other = options;
  other.seed = 6;
  EXPECT_NE(play(c->app, c->platform, c->policy, other)->chains[0].longest_us,
            one->chains[0].longest_us);
}

}  // namespace
}  // namespace xauto::solver::keys::test
