// SPDX-License-Identifier: Apache-2.0
// Cases of theorems 8 and 10 (docs/steady-state.md) by hand. Times are in us.
#include "solver/steady/check_handover.h"

#include <tuple>
#include <utility>

#include <gtest/gtest.h>

#include "base/index.h"
#include "solver/steady/check.h"

namespace xauto::solver::steady {
namespace {

/// An app, and two tables for it, which begin as the same.
struct Handover {
  AppSpec app;
  Platform platform{"p", {{"cpu0", "cpu", true, 0}, {"gpu0", "gpu", true, 0}}};
  KeyPolicy policy;
};

/// Source, XNode and chain, all with that name, alone in their module.
void add_stage(Handover& h, const std::string& name, std::int64_t period, std::int64_t wcet,
               std::int64_t key, int clock = 0) {
  const auto k = static_cast<int>(h.app.xnodes.size());
  h.app.version = 2;
  h.app.name = h.policy.app = "hand";
  h.app.sources.push_back({name, {period, 1}, 0, 0, clock});
  h.app.xnodes.push_back({name, name, {{"cpu", wcet}, {"gpu", wcet}}, {k}});
  h.app.modules.push_back({name, 1});
  h.app.chains.push_back({name, k, k});
  h.policy.placements.push_back({0, {key}});
}

Handover one_stage(std::int64_t wcet, std::int64_t key) {
  Handover h;
  add_stage(h, "a", 10'000, wcet, key);
  return h;
}

/// What keys promise as long as nothing changes.
CheckReport steady_of(Handover& h) {
  h.policy.app_hash = h.app.hash();
  h.policy.chains.clear();
  for (const ChainSpec& c : h.app.chains) {
    h.policy.chains.push_back({c.name, 900'000'000'000});
    if (h.app.sources[at(c.from)].urgent) h.policy.chains.back().urgent_worst_case_us = 900'000'000;
  }
  const auto report = check(h.app, h.platform, h.policy);
  EXPECT_TRUE(report) << (report ? "" : report.error().to_string());
  return report ? *report : CheckReport{};
}

Result<HandoverProof> derived(Handover& p, Handover& q, std::int64_t notice_us = 0,
                              std::int64_t most_jobs = 1'000'000,
                              std::int64_t most_pairs = 10'000'000) {
  steady_of(p);
  steady_of(q);
  AppSpec both = p.app;
  for (std::size_t i = 0; i < both.xnodes.size(); ++i)
    for (auto& [type, wcet] : both.xnodes[i].wcet_us)
      wcet = std::max(wcet, q.app.xnodes[i].wcet_us.at(type));
  return derive_handover({p.app, q.app, both, p.platform, p.policy, q.policy, notice_us}, most_jobs,
                         most_pairs);
}

HandoverProof proven(Handover& p, Handover& q, std::int64_t notice_us = 0) {
  const auto proof = derived(p, q, notice_us);
  EXPECT_TRUE(proof) << (proof ? "" : proof.error().to_string());
  if (!proof) return {};
  for (const std::string& why : proof->why_not) ADD_FAILURE() << why;
  return *proof;
}

TEST(CheckHandover, ToTheSameTableCostsNothing) {
  Handover p = one_stage(2000, 3000), q = p;
  const HandoverProof proof = proven(p, q);
  EXPECT_EQ(proof.worst_case_us[0], 3000);
  // L is S: the job before has ended long ago. 2 D + H.
  EXPECT_EQ(proof.settles_us, 2 * 3000 + 10'000);
}

TEST(CheckHandover, AJobMayTakeAsLongAsUnderBoth) {
  Handover p = one_stage(2000, 3000), q = one_stage(4500, 5000);
  const HandoverProof proof = proven(p, q);
  // p promises 2000 by 3000; 2500 more end by 5500. The next is released at 10 000.
  EXPECT_EQ(proof.worst_case_us[0], 5500);
  EXPECT_EQ(proof.settles_us, 2 * 5000 + 10'000);
  // Where t and S are long before a key, all that is left is the longer work.
  EXPECT_EQ(proven(q, p).worst_case_us[0], 5000);
}

TEST(CheckHandover, TheNextReleaseIsLateToo) {
  Handover p = one_stage(2000, 9500), q = one_stage(4000, 5000);
  const HandoverProof proof = proven(p, q);
  // The last of p by 9500 + 2000; the first of q, released at 10 000, by 11 500 + 4000 > 15 000.
  EXPECT_EQ(proof.worst_case_us[0], 11'500);
  EXPECT_EQ(proof.settles_us, 15'500 - 10'000 + 2 * 5000 + 10'000);
}

TEST(CheckHandover, AnXNodeThatMovesWaitsForItself) {
  Handover p = one_stage(3000, 9000), q = p;
  q.app.xnodes[0].wcet_us = {{"cpu", 5000}, {"gpu", 2000}};
  q.policy.placements = {{1, {2500}}};
  const HandoverProof proof = proven(p, q);
  // On cpu0 by 9000 + 2000. Only then is activation 1 ready, and has ended by 13 000.
  EXPECT_EQ(proof.worst_case_us[0], 11'000);
  EXPECT_EQ(proof.settles_us, 13'000 - 10'000 + 2 * 2500 + 10'000);
}

TEST(CheckHandover, TwoRatesAndASample) {
  Handover p;
  add_stage(p, "a", 10'000, 1000, 2000);
  add_stage(p, "b", 20'000, 1000, 4000);
  p.app.samples = {{0, 1}};
  p.app.chains.push_back({"a to b", 0, 1});
  Handover q = p;
  const HandoverProof same = proven(p, q);
  EXPECT_EQ(same.worst_case_us[0], 2000);
  EXPECT_EQ(same.worst_case_us[1], 4000);
  // Just missed at 0, read at 20 000.
  EXPECT_EQ(same.worst_case_us[2], 24'000);
  EXPECT_EQ(same.settles_us, 2 * 4000 + 20'000);
  // Under q both take longer. a, too long by 500, is so by 2000; then b has ended by 2500 + 3000. Or a was
  // not: then b is too long by 4000, and has 2000 more.
  q.app.xnodes[0].wcet_us = {{"cpu", 1500}, {"gpu", 1500}};
  q.app.xnodes[1].wcet_us = {{"cpu", 3000}, {"gpu", 3000}};
  q.policy.placements[1].key_us = {4500};
  const HandoverProof longer = proven(p, q);
  EXPECT_EQ(longer.worst_case_us[0], 2500);
  EXPECT_EQ(longer.worst_case_us[1], 4000 + 2000);
  // The release at -20 000 was just missed then, and read by b at 0.
  EXPECT_EQ(longer.worst_case_us[2], 20'000 + 6000);
}

TEST(CheckHandover, ArraysOfDifferentSizes) {
  Handover p;
  add_stage(p, "a", 10'000, 1000, 2000);
  add_stage(p, "b", 40'000, 1000, 4000);
  Handover q = p;
  p.policy.placements[0].key_us = {2000, 1000, 1500, 1000};
  q.policy.placements[0].key_us = {2000, 1000};
  const HandoverProof proof = proven(p, q);
  EXPECT_EQ(proof.worst_case_us[0], 2000);
  EXPECT_EQ(proof.worst_case_us[1], 4000);
  EXPECT_EQ(proof.settles_us, 2 * 4000 + 40'000);
}

TEST(CheckHandover, ANoticeOnlyMakesItLonger) {
  Handover p = one_stage(2000, 9500), q = one_stage(4000, 5000);
  const HandoverProof at_once = proven(p, q), noticed = proven(p, q, 3000);
  EXPECT_GE(noticed.worst_case_us[0], at_once.worst_case_us[0]);
  EXPECT_GE(noticed.settles_us, at_once.settles_us);
}

TEST(CheckHandover, AClockWithATolerance) {
  Handover p = one_stage(2000, 3000), q = one_stage(4500, 5000);
  p.app.clocks[0].ppm = q.app.clocks[0].ppm = 100;
  // 2500 more than by 3000, as above, and of 5500 what both may be off.
  const HandoverProof proof = proven(p, q);
  EXPECT_GT(proof.worst_case_us[0], 5500);
  EXPECT_LE(proof.worst_case_us[0], 5503);
  EXPECT_GE(proof.settles_us, 2 * 5000 + 10'000);
  EXPECT_LE(proof.settles_us, 2 * 5000 + 10'000 + 10);
}

TEST(CheckHandover, FromClockToClock) {
  Handover p;
  add_stage(p, "a", 10'000, 2000, 3000);
  p.app.clocks.push_back({"other", 0});
  add_stage(p, "b", 7000, 1000, 2000, 1);
  p.policy.placements[1].xpu = 1;
  p.app.samples = {{0, 1}};
  p.app.chains.push_back({"a to b", 0, 1});
  Handover q = p;
  // By 3000; just missed, by the end of the next.
  EXPECT_EQ(proven(p, q).worst_case_us[2], 3000 + 7000 + 2000);
  // An earlier hold that may read just missed it, and the next is held longer.
  q.policy.placements[1] = {1, {3500}, {2500}};
  EXPECT_EQ(proven(p, q).worst_case_us[2], 3000 + 7000 + 3500);
  // Each part is longest around S: a may end by 5500 (AJobMayTakeAsLongAsUnderBoth).
  q.app.xnodes[0].wcet_us = {{"cpu", 4500}, {"gpu", 4500}};
  q.policy.placements[0].key_us = {5000};
  EXPECT_EQ(proven(p, q).worst_case_us[2], 5500 + 7000 + 3500);
  // What drifts, in real time: 7000 + 3500 and little more.
  p.app.clocks[1].ppm = q.app.clocks[1].ppm = 100;
  const HandoverProof proof = proven(p, q);
  EXPECT_GT(proof.worst_case_us[2], 5500 + 7000 + 3500);
  EXPECT_LE(proof.worst_case_us[2], 5500 + 7000 + 3500 + 3);
}

/// A job of p arrives so late that it begins just before x of q does, which under q has the XPU alone.
std::int64_t beside_a_late_arrival(bool preemptive, std::int64_t key, std::int64_t ppm) {
  Handover p;
  p.platform.xpus[0].preemptive = preemptive;
  p.platform.xpus[0].preempt_us = preemptive ? 3000 : 0;
  add_stage(p, "late", 200'000, 10'000, 90'000);
  add_stage(p, "x", 200'000, 5000, key);
  p.app.clocks[0].ppm = ppm;
  p.app.sources[0].jitter_us = 70'000;
  p.app.sources[1].offset_us = 50'000;
  p.policy.placements[1] = {1, {key}, {20'000}};
  Handover q = p;
  std::swap(q.policy.placements[0].xpu, q.policy.placements[1].xpu);
  return proven(p, q).worst_case_us[1].value_or(0);
}

TEST(CheckHandover, TheNextTablesCertificateDoesNotKnowJobsOfThisOne) {
  // x is held until 70 000. It waits for `late`, 10 000, or pays 3000 for preempting it.
  for (const std::int64_t ppm : {0, 1, 100}) {
    EXPECT_GE(beside_a_late_arrival(false, 28'000, ppm), 20'000 + 10'000 + 5000) << ppm;
    EXPECT_GE(beside_a_late_arrival(true, 26'500, ppm), 20'000 + 3000 + 5000) << ppm;
  }
}

TEST(CheckHandover, OfWhatNothingFollows) {
  Handover p = one_stage(2000, 3000);
  p.app.clocks.push_back({"other", 100});
  add_stage(p, "b", 10'000, 1000, 2000, 1);
  p.policy.placements[1].xpu = 1;
  p.app.samples = {{0, 1}};
  p.app.chains.push_back({"a to b", 0, 1});
  Handover q = p;
  auto proof = derived(p, q);
  ASSERT_TRUE(proof) << proof.error().to_string();
  EXPECT_EQ(proof->worst_case_us[0], 3000);
  EXPECT_TRUE(proof->why_not.empty());
  // Under q they share gpu0, which does not preempt, and both need all of it.
  q.app.clocks[1].ppm = p.app.clocks[1].ppm = 0;
  q.platform.xpus[1].preemptive = p.platform.xpus[1].preemptive = false;
  q.policy.placements[0] = {1, {3000}};
  q.policy.placements[1] = {1, {3000}};
  proof = derived(p, q);
  ASSERT_TRUE(proof) << proof.error().to_string();
  EXPECT_FALSE(proof->worst_case_us[0]);
  EXPECT_FALSE(proof->worst_case_us[1]);
  EXPECT_FALSE(proof->worst_case_us[2]) << "it passes through both";
  EXPECT_EQ(proof->why_not.size(), 3u);
  EXPECT_EQ(proof->settles_us, 0);

  p = q = one_stage(2000, 5000);
  proof = derived(p, q, 0, 3);
  ASSERT_TRUE(proof) << proof.error().to_string();
  EXPECT_FALSE(proof->worst_case_us[0]) << "too many jobs";
  EXPECT_EQ(proof->settles_us, 0);
  p.app.sources[0].urgent = q.app.sources[0].urgent = UrgentSpec{1000, 10'000};
  proof = derived(p, q);
  ASSERT_TRUE(proof) << proof.error().to_string();
  EXPECT_FALSE(proof->worst_case_us[0]) << "urgent";
}

TEST(CheckHandover, WhatMakesNoSense) {
  Handover p = one_stage(2000, 3000), q = p;
  EXPECT_FALSE(derived(p, q, -1));
  q.app.sources[0].period = {5000, 1};
  EXPECT_FALSE(derived(p, q));
  q = p;
  AppSpec both = p.app;
  both.xnodes[0].wcet_us = {{"cpu", 1000}, {"gpu", 1000}};
  steady_of(p);
  steady_of(q);
  EXPECT_FALSE(derive_handover({p.app, q.app, both, p.platform, p.policy, q.policy, 0}));
}

// --------------------------------------------------------------------------------- theorem 10

/// `a` and `b` on one CPU, each with a clock of its own.
Handover two_clocks(std::int64_t wcet, std::int64_t key) {
  Handover h = one_stage(wcet, key);
  h.app.clocks.push_back({"other", 0});
  add_stage(h, "b", 7000, 1000, 4000, 1);
  return h;
}

void set_wcet(Handover& h, std::size_t xnode, std::int64_t us) {
  for (auto& [type, wcet] : h.app.xnodes[xnode].wcet_us) wcet = us;
}

TEST(CheckHandover, ClocksThatShareToTheSameTable) {
  Handover p = two_clocks(2000, 5000), q = p;
  const HandoverProof proof = proven(p, q);
  EXPECT_EQ(proof.worst_case_us[0], 5000);
  EXPECT_EQ(proof.worst_case_us[1], 4000);
  EXPECT_EQ(proof.settles_us, 0) << "nobody is late, and all of p was ready at once";
  // Those of p that are ready by 1500 may be so that long after S.
  p.app.sources[1].jitter_us = q.app.sources[1].jitter_us = 1500;
  EXPECT_EQ(proven(p, q).settles_us, 1500);
}

TEST(CheckHandover, WhatTheNextTablesCertificateCountsIsNotLate) {
  Handover p = two_clocks(2000, 5000), q = two_clocks(3000, 5000);
  for (const auto& [from, to] : {std::pair(&p, &q), std::pair(&q, &p)}) {
    const HandoverProof proof = proven(*from, *to);
    EXPECT_EQ(proof.worst_case_us[0], 5000);
    EXPECT_EQ(proof.worst_case_us[1], 4000);
  }
}

TEST(CheckHandover, ALateJobOfOneClockMakesTheOtherLate) {
  Handover p = two_clocks(2000, 3000), q = two_clocks(3000, 6000);
  const HandoverProof proof = proven(p, q);
  // 3000 have to end by 3000, and q lets none of `a` do so. q's own are no later than that.
  EXPECT_EQ(proof.worst_case_us[0], 6000 + 3000);
  EXPECT_EQ(proof.worst_case_us[1], 4000 + 3000);
  // M is 0. Of each later us 8 % are left: 3261 by 6000 and 1087 by 4000, 2174 by 3000.
  EXPECT_EQ(proof.settles_us, 3000 * 100 / 8);
  // 2 % are left where both take 3900 of 4000.
  p = two_clocks(2900, 3000);
  EXPECT_EQ(proven(p, q).settles_us, 3000 * 100 / 2);
}

TEST(CheckHandover, AWindowIsLongerThanAHyperperiod) {
  Handover p = two_clocks(3000, 6000);
  add_stage(p, "c", 10'000, 100, 2000);
  add_stage(p, "d", 10'000, 3500, 10'500);
  p.app.modules.back().max_in_flight = 3;
  p.policy.placements[2].hold_us = {1000};
  Handover q = p;
  q.policy.placements[3] = {0, {21'000}, {9000}};
  // In [0, 10 500] is all of p. Of q any 10 500 have but `a` and `c`: a later `a` ends before the
  // `d` that began sooner, but that `d` is not within.
  const HandoverProof proof = proven(p, q);
  EXPECT_EQ(proof.worst_case_us[0], 6000 + 3500);
  EXPECT_EQ(proof.worst_case_us[1], 4000 + 3500);
}

TEST(CheckHandover, OneClockGainsAndAnotherOneLoses) {
  Handover p = two_clocks(2000, 5000), q = two_clocks(3000, 5000);
  set_wcet(q, 1, 900);
  HandoverProof proof = proven(p, q);
  // S just after a release of both. In [0, 5000] `a` takes 3000, as p's. Neither table's
  // certificate counts any window: none is whole up to S, or from S on. So it is with `b`'s 1000.
  EXPECT_EQ(proof.worst_case_us[0], 5000 + 3000 + 1000);
  EXPECT_EQ(proof.worst_case_us[1], 4000 + 3000 + 1000);
  EXPECT_EQ(proof.settles_us, (3000 + 1000) * 100 / 8);
  // Nor is it whole where it is p that knows of the longer work.
  proof = proven(q, p);
  EXPECT_EQ(proof.worst_case_us[0], 5000 + 3000 + 1000);
  EXPECT_EQ(proof.settles_us, (3000 + 1000) * 100 / 8);
  // Too few pairs to look at are no other answer.
  int refused = 0;
  for (std::int64_t pairs = 1; pairs < 5000; pairs += 7) {
    const auto few = derived(q, p, 0, 1'000'000, pairs);
    ASSERT_TRUE(few) << few.error().to_string();
    if (!few->why_not.empty())
      ++refused;
    else
      EXPECT_EQ(few->worst_case_us, proof.worst_case_us) << pairs;
  }
  EXPECT_GE(refused, 10);
  // Where no work becomes less, or none more, one table's certificate counts all windows.
  set_wcet(q, 1, 1000);
  EXPECT_EQ(proven(p, q).worst_case_us[0], 5000);
  EXPECT_EQ(proven(q, p).worst_case_us[0], 5000);
}

TEST(CheckHandover, AClocksOwnXpuMakesAnotherClockLate) {
  Handover p = two_clocks(2000, 5000);
  add_stage(p, "c", 10'000, 2000, 3000);
  p.policy.placements[2].xpu = 1;
  p.app.sources[2].clock = 0;
  Handover q = p;
  set_wcet(q, 2, 4500);
  q.policy.placements[2].key_us = {5000};
  // `c` has ended by 4500, 1500 late. Nobody on the CPU waits for it.
  HandoverProof proof = proven(p, q);
  EXPECT_EQ(proof.worst_case_us[0], 5000);
  EXPECT_EQ(proof.worst_case_us[1], 4000);
  EXPECT_EQ(proof.worst_case_us[2], 5000 + 1500);
  EXPECT_EQ(proof.settles_us, 3000 + 1500 * 100 / 8);
  // Now somebody does, and all of both clocks may wait for that.
  for (Handover* h : {&p, &q}) {
    h->app.xnodes.push_back({"d", "c", {{"cpu", 100}, {"gpu", 100}}, {}});
    h->app.edges = {{2, 3}};
    h->policy.placements.push_back({0, {7000}});
  }
  proof = proven(p, q);
  EXPECT_EQ(proof.worst_case_us[0], 5000 + 1500);
  EXPECT_EQ(proof.worst_case_us[1], 4000 + 1500);
  EXPECT_EQ(proof.worst_case_us[2], 5000 + 1500);
  // From 3000 after S on.
  EXPECT_EQ(proof.settles_us, 3000 + 1500 * 100 / 8);
  EXPECT_EQ(proof.chain_settles_us[1], proof.settles_us);
}

TEST(CheckHandover, WhereNobodyWaitsForClocksThatShareNobodyIsLate) {
  // `a` and `b` may be 3000 late on cpu0. `c`, a control loop of the clock of `a`, is on cpu2.
  Handover p = two_clocks(2000, 3000), q = two_clocks(3000, 6000);
  for (Handover* h : {&p, &q}) {
    h->platform.xpus.push_back({"cpu1", "cpu", true, 0});
    h->platform.xpus.push_back({"cpu2", "cpu", true, 0});
    add_stage(*h, "c", 5000, 1000, 1500);
    h->policy.placements[2].xpu = 3;
  }
  const auto worst = [&] { return *proven(p, q).worst_case_us[2]; };
  HandoverProof proof = proven(p, q);
  EXPECT_EQ(proof.worst_case_us[0], 6000 + 3000);
  EXPECT_EQ(proof.worst_case_us[1], 4000 + 3000);
  EXPECT_EQ(proof.worst_case_us[2], 1500);
  EXPECT_EQ(proof.settles_us, 3000 * 100 / 8);
  // What becomes longer on its own CPU is its own, and nobody else's.
  set_wcet(q, 2, 1600);
  q.policy.placements[2].key_us = {1700};
  proof = proven(p, q);
  EXPECT_EQ(proof.worst_case_us[0], 6000 + 3000);
  EXPECT_EQ(proof.worst_case_us[1], 4000 + 3000);
  EXPECT_EQ(proof.worst_case_us[2], 1700 + 100);
  set_wcet(q, 2, 1000);
  q.policy.placements[2].key_us = {1500};

  // A reader of `a` on that CPU, by an edge, is late, and so is who shares the CPU with it.
  for (Handover* h : {&p, &q}) {
    h->app.xnodes.push_back({"d", "a", {{"cpu", 100}, {"gpu", 100}}, {}});
    h->app.edges = {{0, 3}};
    h->app.chains.push_back({"a to d", 0, 3});
    h->policy.placements.push_back({3, {8000}});
  }
  proof = proven(p, q);
  EXPECT_EQ(proof.worst_case_us[3], 8000 + 3000);
  EXPECT_EQ(proof.worst_case_us[2], 1500 + 3000);
  // Not if it is elsewhere, unless somebody on cpu2 waits for that.
  p.policy.placements[3].xpu = q.policy.placements[3].xpu = 2;
  proof = proven(p, q);
  EXPECT_EQ(proof.worst_case_us[3], 8000 + 3000);
  EXPECT_EQ(proof.worst_case_us[2], 1500);
  for (Handover* h : {&p, &q}) {
    h->app.xnodes.push_back({"e", "a", {{"cpu", 100}, {"gpu", 100}}, {}});
    h->app.edges.emplace_back(3, 4);
    h->policy.placements.push_back({3, {9000}});
  }
  EXPECT_EQ(worst(), 1500 + 3000);
  // One table is enough.
  p.policy.placements[4].xpu = 2;
  EXPECT_EQ(worst(), 1500 + 3000);
  p.policy.placements[4].xpu = 3;
  q.policy.placements[4].xpu = 2;
  EXPECT_EQ(worst(), 1500 + 3000);
  q.policy.placements[4].xpu = p.policy.placements[4].xpu = 2;
  EXPECT_EQ(worst(), 1500);
}

TEST(CheckHandover, WhoWaitsForTheTableBeforeIsLateWithIt) {
  // As above, and `d` moves from cpu0 to the CPU of `c`, or back.
  Handover p = two_clocks(2000, 3000), q = two_clocks(3000, 6000);
  for (Handover* h : {&p, &q}) {
    add_stage(*h, "c", 5000, 1000, 1500);
    add_stage(*h, "d", 10'000, 100, 8000);
    h->policy.placements[2].xpu = 1;
  }
  EXPECT_EQ(proven(p, q).worst_case_us[2], 1500);
  q.policy.placements[3].xpu = 1;
  EXPECT_EQ(proven(p, q).worst_case_us[2], 1500 + 3000);
  // On cpu0 it waits for what is never late.
  std::swap(p.policy.placements[3].xpu, q.policy.placements[3].xpu);
  EXPECT_EQ(proven(p, q).worst_case_us[2], 1500);

  // `e`, the entry of its module, waits for `f` of the activation before. 2 is the CPU of `c`.
  const auto worst = [](std::pair<int, int> of_p, std::pair<int, int> of_q) {
    Handover from = two_clocks(2000, 3000), to = two_clocks(3000, 6000);
    for (auto& [h, of] : {std::pair(&from, of_p), std::pair(&to, of_q)}) {
      h->platform.xpus.push_back({"cpu1", "cpu", true, 0});
      add_stage(*h, "c", 5000, 1000, 1500);
      add_stage(*h, "e", 10'000, 100, 200);
      h->app.xnodes.push_back({"f", "e", {{"cpu", 100}, {"gpu", 100}}, {}});
      h->app.edges = {{3, 4}};
      h->policy.placements[2].xpu = 2;
      h->policy.placements[3].xpu = of.first;
      h->policy.placements.push_back({of.second, {8000}});
    }
    return *proven(from, to).worst_case_us[2];
  };
  EXPECT_EQ(worst({2, 0}, {1, 1}), 1500 + 3000) << "under p";
  EXPECT_EQ(worst({1, 1}, {2, 0}), 1500 + 3000) << "under q";
  EXPECT_EQ(worst({1, 0}, {2, 2}), 1500 + 3000) << "of q for p";
  EXPECT_EQ(worst({1, 1}, {2, 1}), 1500);
  EXPECT_EQ(worst({2, 2}, {1, 0}), 1500) << "nobody of p waits for one of q";
}

TEST(CheckHandover, WhatDoesNotRiseMayStillBeLate) {
  Handover p = two_clocks(2000, 5000);
  p.platform.xpus.push_back({"gpu1", "gpu", true, 0});
  add_stage(p, "u", 20'000, 1000, 1100);
  add_stage(p, "v", 20'000, 11'400, 12'500);
  p.policy.placements[2].xpu = 1;
  p.policy.placements[3].xpu = 2;
  Handover q = p;
  set_wcet(q, 2, 1200);
  q.policy.placements[2].key_us = {1400};
  q.policy.placements[3].xpu = 1;
  q.policy.placements[2].xpu = 2;
  // S just after the last release of `u` under p, whose 1200 are before `v`'s 11 400 on gpu1.
  q.app.sources[3].offset_us = p.app.sources[3].offset_us = 1;
  const HandoverProof proof = proven(p, q);
  // `u` is 100 late at 1100, and λ does not rise any more. But `v` is late at 12 501: by 99.
  EXPECT_GT(proof.settles_us, 1100 + 100 * 100 / 8 + 1000);
  EXPECT_GE(proof.settles_us, 12'501 + 99 * 100 / 8);
}

TEST(CheckHandover, AMessageMakesLatenessLast) {
  Handover p = two_clocks(2000, 3000);
  Handover q = two_clocks(3000, 6000);
  const auto settles = [&] { return proven(p, q).settles_us; };
  for (Handover* h : {&p, &q}) {
    h->app.xnodes.push_back({"c", "b", {{"cpu", 100}, {"gpu", 100}}, {}});
    h->app.edges = {{1, 2}};
    h->policy.placements.push_back({1, {6000}});
  }
  EXPECT_EQ(settles(), 4000 + 3000 * 100 / 8) << "M is 4000";
  for (Handover* h : {&p, &q}) h->app.transfers = {{0, "cpu", "gpu", 1000}};
  // `c` is late by what `b` was 1000 before its window of 1000 began.
  EXPECT_EQ(settles(), 5000 + 2 * 3000 * 100 / 8);
}

TEST(CheckHandover, AnotherClocksKeyIsBetween) {
  // Under p `b` has windows of 5000 us, under q of 10 000.
  Handover p = one_stage(1000, 5400);
  p.app.sources[0].period = {20'000, 1};
  p.app.clocks.push_back({"other", 0});
  add_stage(p, "b", 10'000, 4000, 9900, 1);
  p.policy.placements[1].hold_us = {4900};
  Handover q = p;
  set_wcet(q, 0, 3000);
  q.policy.placements[1] = {0, {10'000}};
  // S just after 10 000: `b` ran from 4900 to 8900, `a`, of [4800, 10 200], has to run for 3000 then.
  EXPECT_GE(proven(p, q).worst_case_us[0], 8900 + 3000 - 4800);
}

TEST(CheckHandover, ClocksThatShareAndDrift) {
  Handover p = two_clocks(2000, 3000), q = two_clocks(3000, 6000);
  for (Handover* h : {&p, &q}) h->app.clocks[1].ppm = 100;
  // `b` may be as late as one of its jobs, since windows of 4000 us may be a little shorter; and
  // `a` as late as that and as its own 3000.
  const HandoverProof proof = proven(p, q);
  EXPECT_GE(*proof.worst_case_us[0], 6000 + 3000 + 1000);
  EXPECT_LE(*proof.worst_case_us[0], 6000 + 3000 + 1000 + 10);
  EXPECT_GE(*proof.worst_case_us[1], 4000 + 3000 + 1000);
  EXPECT_LE(*proof.worst_case_us[1], 4000 + 3000 + 1000 + 10);
}

TEST(CheckHandover, WhyNothingFollowsForClocksThatShare) {
  const auto why = [](Handover p, Handover q, std::int64_t most_pairs = 10'000'000) {
    const auto proof = derived(p, q, 0, 1'000'000, most_pairs);
    EXPECT_TRUE(proof) << proof.error().to_string();
    if (!proof || proof->why_not.empty()) return std::string();
    EXPECT_EQ(proof->settles_us, 0);
    EXPECT_FALSE(proof->worst_case_us[0]);
    return proof->why_not[0];
  };
  const std::string begin = "chain 'a': clock 'main' shares cpu0 with clock 'other', and ";
  Handover p = two_clocks(2000, 5000), q = p;
  EXPECT_EQ(why(p, q), "");
  EXPECT_EQ(why(p, q, 10), begin + "that takes more work than is looked at");

  // It may be in the way, as 3000 of `a` in 4000 are.
  p.platform.xpus[0].preemptive = q.platform.xpus[0].preemptive = false;
  EXPECT_EQ(why(p, q), "");
  set_wcet(p, 0, 2990);
  set_wcet(q, 0, 2990);
  p.policy.placements[0] = q.policy.placements[0] = {0, {5000}};
  EXPECT_EQ(why(p, q), begin + "both tables leave less than 1 % of an XPU");

  p = q = two_clocks(2000, 5000);
  set_wcet(q, 0, 2001);
  set_wcet(q, 1, 999);
  EXPECT_EQ(why(p, q), "") << "of their work some becomes more and some less";

  p = q = two_clocks(2000, 2005);
  EXPECT_EQ(why(p, q), begin + "both tables leave less than 1 % of an XPU");

  // `c` moves. The last of p may end 5000 after S, and only then the first of q begins.
  p = two_clocks(2000, 5000);
  p.platform.xpus.push_back({"gpu1", "gpu", true, 0});
  add_stage(p, "c", 10'000, 3000, 15'000);
  p.app.modules.back().max_in_flight = 2;
  p.policy.placements[2].xpu = 1;
  q = p;
  q.policy.placements[2] = {2, {5000}};
  EXPECT_EQ(why(p, q), "") << "then it has a later due";

  p = two_clocks(2000, 5000);
  add_stage(p, "c", 1'000'000'007, 1000, 9000);
  add_stage(p, "d", 1'000'000'009, 1000, 9000);
  for (const std::size_t k : {2, 3}) p.policy.placements[k].xpu = 1;
  EXPECT_EQ(why(p, p), begin + "the hyperperiod of clock 'main' does not fit");
}

/// Beside clocks that share cpu0: `u`, and `v` after it, on gpu0, which does not preempt. `key_of_x`:
/// of another clock's `x` there, between them; 0: there is none.
Handover with_v_after_u(std::int64_t key_of_u, std::int64_t key_of_x) {
  Handover h = two_clocks(2000, 5000);
  h.platform.xpus[1].preemptive = false;
  add_stage(h, "u", 10'000, 1000, key_of_u);
  if (key_of_x > 0) add_stage(h, "x", 7000, 500, key_of_x, 1);
  h.app.xnodes.push_back({"v", "u", {{"cpu", 2000}, {"gpu", 2000}}, {}});
  h.app.edges = {{2, static_cast<int>(h.app.xnodes.size()) - 1}};
  h.policy.placements.push_back({1, {8000}});
  for (std::size_t k = 2; k < h.policy.placements.size(); ++k) h.policy.placements[k].xpu = 1;
  return h;
}

TEST(CheckHandover, WhoWaitsIsNotInTheWay) {
  // `v` takes 2000, and does not begin before `u` has ended.
  Handover p = with_v_after_u(1100, 0), q = p;
  const HandoverProof proof = proven(p, q);
  EXPECT_EQ(proof.worst_case_us[2], 1100);
  EXPECT_EQ(proof.settles_us, 8000) << "M, with the keys of p";
}

TEST(CheckHandover, WhoWaitsMayBeInTheWayOfAnotherClock) {
  // `v` may be in the way of `x`, but not while `u` is served.
  Handover p = with_v_after_u(2000, 4500), q = p;
  const HandoverProof proof = proven(p, q);
  // Around a change G says less: 1000 and 2000 in 2000, or 1500 and 2000 in less than 3500.
  EXPECT_GT(*proof.worst_case_us[2], 2000);
  EXPECT_GT(*proof.worst_case_us[3], 4500);
}

TEST(CheckHandover, WhoBeganUnderTheTableBeforeIsInTheWay) {
  Handover p = two_clocks(2000, 5000);
  p.platform.xpus[1].preemptive = false;
  p.platform.xpus.push_back({"gpu1", "gpu", true, 0});
  add_stage(p, "z", 20'000, 3000, 5000);
  add_stage(p, "x", 20'000, 1000, 2500);
  p.app.sources[3].offset_us = 1000;
  p.policy.placements[2].xpu = 1;
  p.policy.placements[3].xpu = 2;
  Handover q = p;
  // Under q both are on gpu0, where `z` is held until `x` has been there.
  q.policy.placements[2] = {1, {7000}, {1100}};
  q.policy.placements[3] = {1, {1500}};
  // S after 0: `z` has gpu0 until 3000, and then `x`, which was there at 1000.
  EXPECT_GE(proven(p, q).worst_case_us[3], 3000);
}

TEST(CheckHandover, LatenessLastsThroughMessages) {
  Handover p = two_clocks(2000, 5000);
  for (const char* id : {"gpu1", "gpu2"}) p.platform.xpus.push_back({id, "gpu", true, 0});
  p.platform.xpus.push_back({"cpu1", "cpu", true, 0});
  add_stage(p, "u", 400'000, 2000, 3000);
  add_stage(p, "v", 400'000, 9000, 10'000);
  p.app.sources[3].offset_us = 1;
  Handover q = p;
  set_wcet(q, 2, 4500);
  q.policy.placements[2].key_us = {5000};
  p.policy.placements[2].xpu = q.policy.placements[3].xpu = 1;
  p.policy.placements[3].xpu = q.policy.placements[2].xpu = 2;
  constexpr int kAfter = 12;
  for (Handover* h : {&p, &q}) {
    std::int64_t key = 10'000;
    for (int k = 0; k < kAfter; ++k) {
      h->app.xnodes.push_back({"v" + std::to_string(k), "v", {{"cpu", 100}, {"gpu", 100}}, {}});
      h->app.edges.emplace_back(3 + k, 4 + k);
      h->app.transfers.push_back({k, "gpu", "cpu", 20'000});
      h->app.transfers.push_back({k, "cpu", "cpu", 20'000});
      key += (h == &q ? 20'000 : 0) + 110;
      h->policy.placements.push_back({h == &q ? 4 : 3, {key}});
    }
  }
  // `u` takes 4500, so `v` has ended by 13 500, and each that waits for it catches up with 10 us.
  EXPECT_GE(proven(p, q).settles_us, 13'500 + kAfter * 20'100);
}

TEST(CheckHandover, WhatWaitsForTheTableBeforeMayBeLate) {
  Handover p = two_clocks(2000, 5000);
  p.platform.xpus.push_back({"gpu1", "gpu", true, 0});
  add_stage(p, "c", 10'000, 3000, 17'000);
  p.app.modules.back().max_in_flight = 2;
  add_stage(p, "d", 40'000, 12'000, 14'000);
  p.policy.placements[2].xpu = p.policy.placements[3].xpu = 1;
  Handover q = p;
  q.policy.placements[2] = {2, {7100}};
  // `c` under p has ended by 15 000, after `d`: 5000 after S, where the next one begins, on gpu1.
  const HandoverProof proof = proven(p, q);
  EXPECT_GE(proof.settles_us, 5000 + 3000);
  // By its key it is known to be ready by 7000 after S, when all of p's own have been so for long.
  EXPECT_EQ(proof.worst_case_us[2], 17'000);
  EXPECT_EQ(proof.worst_case_us[0], 5000) << "nobody on cpu0 waits for `c`";
  // Once somebody does, all that is there may be as late.
  for (Handover* h : {&p, &q}) {
    h->app.xnodes.push_back({"e", "c", {{"cpu", 100}, {"gpu", 100}}, {}});
    h->app.edges = {{2, 4}};
    h->policy.placements.push_back({0, {h == &p ? 19'000 : 9000}});
  }
  const HandoverProof waits = proven(p, q);
  EXPECT_EQ(waits.worst_case_us[0], 5000 + 2900);
  EXPECT_EQ(waits.worst_case_us[1], 4000 + 2900);
}

/// `c` with a `key` under p; under q it moves to an XPU of its own, with the window `to_key`.
std::pair<Handover, Handover> with_c_that_moves(std::int64_t wcet, std::int64_t key,
                                                std::int64_t to_key, std::int64_t in_flight) {
  Handover p = two_clocks(2000, 5000);
  for (const char* id : {"gpu1", "gpu2"}) p.platform.xpus.push_back({id, "gpu", true, 0});
  add_stage(p, "c", 10'000, wcet, key);
  p.app.modules.back().max_in_flight = in_flight;
  p.policy.placements[2].xpu = 1;
  Handover q = p;
  q.policy.placements[2] = {2, {to_key}};
  return {p, q};
}

/// `e` after `c`, on an XPU.
void add_after_c(Handover& h, int xpu, std::int64_t key) {
  h.app.xnodes.push_back({"e", "c", {{"cpu", 100}, {"gpu", 100}}, {}});
  h.app.edges = {{2, 3}};
  h.app.chains.push_back({"c to e", 2, 3});
  h.policy.placements.push_back({xpu, {key}});
}

TEST(CheckHandover, WhoWaitsUntilAfterItsKeyIsDueLater) {
  // The last of p may end 5000 after S, which is when the first of q had to. It is due at 10 000.
  auto [p, q] = with_c_that_moves(3000, 15'000, 5000, 2);
  HandoverProof proof = proven(p, q);
  EXPECT_EQ(proof.worst_case_us, (decltype(proof.worst_case_us){5000, 4000, 15'000}));
  EXPECT_EQ(proof.settles_us, 10'000 + 10'000) << "from the release before S";
  q.policy.placements[2].key_us = {5001};
  // If it is ready 1 us before its key, that stays what is asked of it: it is 2999 late.
  EXPECT_EQ(proven(p, q).settles_us, 10'000 + 5001 + (2999 * 100 + 7) / 8);

  // Where its window is longer than a period, it ends later than under p: by 15 000 + 12 000.
  std::tie(p, q) = with_c_that_moves(3000, 25'000, 12'000, 3);
  proof = proven(p, q);
  EXPECT_EQ(proof.worst_case_us[2], 27'000);
  EXPECT_EQ(proof.settles_us, 10'000 + 27'000);
  // The next one has its key at 22 000. From 15 000 on both take 8000, 1000 too much.
  std::tie(p, q) = with_c_that_moves(4000, 25'000, 12'000, 3);
  proof = proven(p, q);
  EXPECT_EQ(proof.worst_case_us[2], 27'000 + 1000);
  EXPECT_EQ(proof.worst_case_us[0], 5000) << "nobody on cpu0 waits for it";
  EXPECT_EQ(proof.settles_us, 10'000 + 27'000 + 1000 * 100 / 8);
}

TEST(CheckHandover, ItsSuccessorIsDueLaterToo) {
  auto [p, q] = with_c_that_moves(3000, 25'000, 12'000, 3);
  add_after_c(p, 3, 26'000);
  add_after_c(q, 3, 15'000);
  HandoverProof proof = proven(p, q);
  EXPECT_EQ(proof.worst_case_us[3], 27'000 + 3000);
  EXPECT_EQ(proof.settles_us, 10'000 + 30'000);
  // A message takes time.
  for (Handover* h : {&p, &q}) h->app.transfers = {{0, "gpu", "gpu", 500}};
  proof = proven(p, q);
  EXPECT_EQ(proof.worst_case_us[3], 27'500 + 2500);
  // What `c` is late makes it late.
  set_wcet(p, 2, 4000);
  set_wcet(q, 2, 4000);
  EXPECT_EQ(proven(p, q).worst_case_us[3], 27'500 + 2500 + 1000);
  // If it has its key later, it is in time.
  q.policy.placements[3].key_us = {28'000};
  EXPECT_EQ(proven(p, q).worst_case_us[3], 28'000 + 1000);
}

TEST(CheckHandover, SeveralThatAreDueLaterHaveToFit) {
  auto [p, q] = with_c_that_moves(2000, 17'000, 3000, 2);
  for (auto [h, xpu, key] : {std::tuple(&p, 1, 17'000), std::tuple(&q, 2, 6000)}) {
    add_stage(*h, "g", 10'000, 2000, key);
    h->app.modules.back().max_in_flight = 2;
    h->policy.placements.back().xpu = xpu;
  }
  // Both are ready 7000 after S. `c` is due by 10 000, when both may have taken 4000. By 13 000, when
  // `g` is due, and has `c` its next key, they take no more than fits.
  const HandoverProof proof = proven(p, q);
  EXPECT_EQ(proof.settles_us, 10'000 + 13'000 + 1000 * 100 / 8);
}

/// `c` and `e`, of one module, one at a time. Under p they are held until 9000 and have ended by 19 000.
std::pair<Handover, Handover> with_a_loop(std::int64_t key_of_e) {
  auto [p, q] = with_c_that_moves(100, 14'000, 6000, 1);
  p.policy.placements[2].hold_us = {9000};
  add_after_c(p, 1, 19'000);
  add_after_c(q, 3, key_of_e);
  return {p, q};
}

TEST(CheckHandover, WhatIsDueLaterIsWaitedForInTheModule) {
  // The first `c` of q is ready at 9000, and due by 15 000, `e` by 17 000. The next one is ready by 7000
  // after its release, and `e` is due by 15 000 after that. The one after it is ready at 25 000, before
  // its key.
  auto [p, q] = with_a_loop(8000);
  HandoverProof proof = proven(p, q);
  EXPECT_EQ(proof.worst_case_us[2], 15'000);
  EXPECT_EQ(proof.worst_case_us[3], 19'000);
  EXPECT_EQ(proof.settles_us, 10'000 + 25'000);
}

TEST(CheckHandover, WhatIsDueLaterHasToBeMadeUpFor) {
  const std::string begin = "chain 'a': clock 'main' shares cpu0 with clock 'other', and ";
  // `e` is due by 18 000, 17 000, 16 000 and 15 000; the `c` after that is ready at 5000. That is before
  // its key, but 40 000 after S, where 19 000 and two hyperperiods are looked at.
  auto [p, q] = with_a_loop(9000);
  const std::string too_long =
      begin + "XNode 'c' may still wait for the table before when that should have been over";
  const auto late = derived(p, q);
  ASSERT_TRUE(late) << late.error().to_string();
  ASSERT_FALSE(late->why_not.empty());
  EXPECT_EQ(late->why_not[0], too_long);
  // In a loop as long as the period nothing is ever made up for.
  std::tie(p, q) = with_a_loop(10'000);
  const auto never = derived(p, q);
  ASSERT_TRUE(never) << never.error().to_string();
  ASSERT_FALSE(never->why_not.empty());
  EXPECT_EQ(never->why_not[0], too_long);
  EXPECT_FALSE(never->worst_case_us[0]);
}

/// Of clock `main` under q: `z` has [0, 3500] of each period, and `u` [10 000, 18 500] of two. `x`, another
/// clock's, has its window anywhere.
std::pair<Handover, Handover> with_z_that_waits(int z_goes_to) {
  Handover p;
  p.platform.xpus.push_back({"gpu1", "gpu", true, 0});
  add_stage(p, "z", 10'000, 2000, 15'000);
  add_stage(p, "u", 20'000, 2000, 8500);
  p.app.clocks.push_back({"other", 0});
  add_stage(p, "x", 20'000, 1000, 1300, 1);
  p.app.xnodes[0].wcet_us = {{"cpu", 2000}, {"gpu", 4000}};
  p.app.modules[0].max_in_flight = 2;
  p.app.sources[1].offset_us = 10'000;
  p.policy.placements[0] = {1, {15'000, 9500}, {9500, 0}};
  Handover q = p;
  q.policy.placements[0] = {z_goes_to, {z_goes_to == 0 ? 3500 : 4500}};
  return {p, q};
}

TEST(CheckHandover, WhoWaitsUntilAfterItsKeyMayMeetAnotherClock) {
  // `z` of 10 000 is ready by 15 000, with the key 13 500. If so between both, it goes before an `x` there,
  // which needs 3000 then; no job of `main` would tell.
  auto [p, q] = with_z_that_waits(0);
  const auto proof = derived(p, q);
  ASSERT_TRUE(proof) << proof.error().to_string();
  EXPECT_FALSE(proof->worst_case_us[2]);
  ASSERT_FALSE(proof->why_not.empty());
  // On an XPU that `main` has for itself it meets nobody.
  std::tie(p, q) = with_z_that_waits(2);
  EXPECT_EQ(proven(p, q).worst_case_us[2], 1300);
}

// ------------------------------------------------------------------- XPUs that do not preempt

/// An XNode after another one, of its own module, held until what that has as its key.
void add_after(Handover& h, int before, const std::string& name, std::int64_t wcet,
               std::int64_t window) {
  h.app.edges.emplace_back(before, static_cast<int>(h.app.xnodes.size()));
  h.app.xnodes.push_back({name, name, {{"cpu", wcet}, {"gpu", wcet}}, {}});
  h.app.modules.push_back({name, 1});
  const std::int64_t held = h.policy.placements[at(before)].key_us[0];
  h.policy.placements.push_back({0, {held + window}, {held}});
}

/// As add_stage, where some XNodes have no source.
void add_other_stage(Handover& h, const std::string& name, std::int64_t period, std::int64_t wcet,
                     std::int64_t key, int clock) {
  add_stage(h, name, period, wcet, key, clock);
  h.app.xnodes.back().sources = {static_cast<int>(h.app.sources.size()) - 1};
  h.app.chains.back().from = static_cast<int>(h.app.sources.size()) - 1;
}

/// Under p `a` takes 3000 of cpu0, and `b` has a GPU. Under q `b` is on cpu0 with a short window, beside
/// three jobs of the other clock that take 1000 each.
std::pair<Handover, Handover> with_a_short_window(bool preemptive) {
  Handover p = two_clocks(3000, 9500);
  p.platform.xpus[0].preemptive = preemptive;
  p.platform.xpus.push_back({"gpu1", "gpu", true, 0});
  for (const char* name : {"c", "d"}) {
    add_stage(p, name, 10'000, 1000, 9500);
    p.app.sources.back().clock = 0;
    p.policy.placements.back().xpu = 2;
  }
  Handover q = p;
  set_wcet(q, 0, 1000);
  q.policy.placements[1] = {0, {2500}};
  p.policy.placements[1] = {1, {1100}};
  q.policy.placements[2].xpu = q.policy.placements[3].xpu = 0;
  return {p, q};
}

TEST(CheckHandover, ALongJobOfTheTableBeforeIsInTheWay) {
  auto [p, q] = with_a_short_window(true);
  EXPECT_EQ(proven(p, q).worst_case_us[1], 2500);
  std::tie(p, q) = with_a_short_window(false);
  // `a` of p may have begun just before: 3000, and 1000 of its own. With 1 % to be left 1541 are counted, and
  // once more for the second job, which is also before S + M.
  EXPECT_EQ(proven(p, q).worst_case_us[1], 2500 + 2 * 1541);
  // It is as before where `a` takes no longer under p than under q.
  set_wcet(p, 0, 1000);
  EXPECT_EQ(proven(p, q).worst_case_us[1], 2500);
}

/// Of one clock under p: `z`, which takes 3000. Under q: `s`, which needs 1000 of its first 1100, and is
/// released so long after `z`.
std::pair<Handover, Handover> with_one_clock_beside(std::int64_t after) {
  Handover p = two_clocks(2000, 5000);
  p.platform.xpus.push_back({"cpu1", "cpu", false, 0});
  add_stage(p, "z", 10'000, 3000, 9000);
  add_stage(p, "s", 10'000, 1000, 1100);
  p.app.sources[2].clock = p.app.sources[3].clock = 0;
  p.app.sources[3].offset_us = after;
  p.policy.placements[2].xpu = 2;
  p.policy.placements[3].xpu = 1;
  Handover q = p;
  std::swap(q.policy.placements[2].xpu, q.policy.placements[3].xpu);
  return {p, q};
}

TEST(CheckHandover, OnAnXpuOfOneClockItIsInTheWayIfItMayHaveBegun) {
  auto [p, q] = with_one_clock_beside(0);
  EXPECT_EQ(proven(p, q).worst_case_us[3], 1100) << "all of p had its key before";
  std::tie(p, q) = with_one_clock_beside(1);
  const HandoverProof proof = proven(p, q);
  EXPECT_EQ(proof.worst_case_us[3], 3000 + 1000);
  EXPECT_EQ(proof.worst_case_us[0], 5000) << "nobody on cpu0 waits for it";
  std::tie(p, q) = with_one_clock_beside(2500);
  EXPECT_EQ(proven(p, q).worst_case_us[3], 3000 + 1000);
  // It goes first if it has the smaller key. Then it is not in the way; all of it counts from its α on.
  p.policy.placements[2].key_us = {3300};
  EXPECT_EQ(proven(p, q).worst_case_us[3], 3000 + 1000 - 2500);
}

/// `z` and `b` wait for `u` of a GPU, which under p may take 2400 too long. `w` of the same clock comes 2300
/// after they should have begun. All have windows of the same length.
std::pair<Handover, Handover> with_w_let_in(std::int64_t window, std::int64_t after = 3400) {
  Handover p;
  p.platform.xpus[0].preemptive = false;
  p.platform.xpus.push_back({"cpu1", "cpu", true, 0});
  add_stage(p, "u", 20'000, 1000, 1100);
  p.policy.placements[0].xpu = 1;
  add_after(p, 0, "z", 1500, window);
  add_after(p, 0, "b", 500, window);
  add_other_stage(p, "w", 20'000, 2000, window, 0);
  p.app.sources.back().offset_us = after;
  p.app.clocks.push_back({"other", 0});
  add_other_stage(p, "x", 7000, 100, window, 1);
  p.app.chains.push_back({"u to b", 0, 2});
  Handover q = p;
  q.policy.placements[0].xpu = 2;
  q.app.xnodes[0].wcet_us["gpu"] = 3500;
  return {p, q};
}

TEST(CheckHandover, LatenessLetsInWhoWouldHaveComeTooLate) {
  // 1500, 500 and 100 fit into 3000. But `w` may have begun before all of that, with a larger key.
  auto [p, q] = with_w_let_in(3000);
  const auto proof = derived(p, q);
  ASSERT_TRUE(proof) << proof.error().to_string();
  ASSERT_FALSE(proof->why_not.empty());
  EXPECT_EQ(
      proof->why_not[0],
      "chain 'u': clock 'main' shares cpu0 with clock 'other', and cpu0 does not preempt, and "
      "less than 1 % of it is left beside what may be in the way");
  // Not if it comes when they must have begun.
  std::tie(p, q) = with_w_let_in(3000, 3501);
  EXPECT_TRUE(proven(p, q).worst_case_us[3]);
  // With 4600 that fits, too.
  std::tie(p, q) = with_w_let_in(4600);
  EXPECT_EQ(proven(p, q).worst_case_us[3], 1100 + 4600 + 2400);
  // So it does where `u` is never late.
  std::tie(p, q) = with_w_let_in(3000);
  q.app.xnodes[0].wcet_us["gpu"] = 1000;
  EXPECT_EQ(proven(p, q).worst_case_us[3], 1100 + 3000);
}

}  // namespace
}  // namespace xauto::solver::steady
