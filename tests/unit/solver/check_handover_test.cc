// SPDX-License-Identifier: Apache-2.0
// Cases of theorem 8 (docs/keys.md) by hand. Times are in us.
#include "solver/keys/check_handover.h"

#include <utility>

#include <gtest/gtest.h>

#include "base/index.h"
#include "solver/keys/check.h"

namespace xauto::solver::keys {
namespace {

/// An app, and two tables for it, which begin as the same.
struct Handover {
  AppSpec app;
  Platform platform{"p", {{"cpu0", "cpu", true, 0}, {"gpu0", "gpu", true, 0}}};
  Policy policy;
};

/// Source, XNode and chain, all with that name, alone in their module.
void add_stage(Handover& h, const std::string& name, std::int64_t period, std::int64_t wcet,
               std::int64_t key, int clock = 0) {
  const auto k = static_cast<int>(h.app.xnodes.size());
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
CheckReport settled_of(Handover& h) {
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
                              std::int64_t most_jobs = 1'000'000) {
  settled_of(p);
  settled_of(q);
  AppSpec both = p.app;
  for (std::size_t i = 0; i < both.xnodes.size(); ++i)
    for (auto& [type, wcet] : both.xnodes[i].wcet_us)
      wcet = std::max(wcet, q.app.xnodes[i].wcet_us.at(type));
  return derive_handover({p.app, q.app, both, p.platform, p.policy, q.policy, notice_us},
                         most_jobs);
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
  // Under q they share gpu0.
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
  settled_of(p);
  settled_of(q);
  EXPECT_FALSE(derive_handover({p.app, q.app, both, p.platform, p.policy, q.policy, 0}));
}

}  // namespace
}  // namespace xauto::solver::keys
