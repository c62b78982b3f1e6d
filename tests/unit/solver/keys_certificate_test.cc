// SPDX-License-Identifier: Apache-2.0
// What the solver's own certificate accepts, by itself. Policies of the search hold what a
// non-preemptive XPU must not take early, so that most charges of the certificate never decide there.
// Keys and holds of others have to be judged right, too: a hint's, a caller's.
#include <utility>

#include <gtest/gtest.h>

#include "solver/keys/check.h"

#include "attack/attack.h"
#include "attack/producer.h"
#include "keys_certified.h"

namespace xauto::solver::keys::test {
namespace {

using attack::Case;

attack::Wanted mixture(std::uint64_t seed) {
  attack::Wanted w;
  w.clocks = seed % 3 == 0 ? 2 : 1;
  w.ppm = seed % 2 == 0 ? 20'000 : 0;  // far worse than any: a few activations are enough
  w.components = 2 + static_cast<int>(seed / 3 % 3);
  w.load = seed % 5 == 0 ? 0.85 : 0.6;
  w.preemptive = seed / 4 % 2 == 0;
  w.preempt_us = seed / 8 % 2 == 0 ? 10 : 0;
  w.jitter_us = seed % 7 > 3 ? 60 : 0;
  w.holds = seed % 4 > 1;
  w.order = seed % 3 == 1;
  return w;
}

TEST(KeysCertificate, NothingBreaksWhatIsJustAccepted) {
  int made = 0, touched = 0;
  for (std::uint64_t seed = 1; seed <= 90; ++seed) {
    auto c = attack::valid(seed, mixture(seed));
    if (!c || !certified(*c)) continue;
    attack::tighten(*c, seed, seed % 3 == 0, certified);
    ++made;
    const auto found = attack::attack(c->app, c->platform, c->policy, {20'000, seed});
    EXPECT_TRUE(found.late.empty()) << seed << ": " << found.late;
    touched += found.closest_us > -0.001 ? 1 : 0;
  }
  EXPECT_GE(made, 45);
  EXPECT_GE(touched, made / 3);  // the attack reaches keys: it would see a microsecond more
}

/// Pairs make keys possible that are not without them: whoever forgets them breaks those.
TEST(KeysCertificate, PairsAreCountedOn) {
  int made = 0, refused = 0, broken = 0;
  for (std::uint64_t seed = 1; seed <= 60; ++seed) {
    attack::Wanted w = mixture(seed);
    w.order = true;
    w.preemptive = seed % 4 == 0;
    w.load = 0.8;
    auto c = attack::valid(seed, w);
    if (!c || c->policy.order.empty() || !certified(*c)) continue;
    attack::tighten(*c, seed, seed % 3 == 0, certified);
    ++made;
    EXPECT_FALSE(attack::attack(c->app, c->platform, c->policy, {20'000, seed}).broken()) << seed;
    c->policy.order.clear();
    const bool accepted = certified(*c);
    refused += accepted ? 0 : 1;
    const bool breaks =
        !attack::attack(c->app, c->platform, c->policy, {20'000, seed}).late.empty();
    EXPECT_FALSE(accepted && breaks) << seed;
    broken += breaks ? 1 : 0;
  }
  std::printf("%d made, %d refused without order, %d broken\n", made, refused, broken);
  EXPECT_GE(made, 20);
  EXPECT_GE(refused, made / 4);
  EXPECT_GE(broken, 4);
}

/// Solver and check have a short way for XNodes of one component with one activation a hyperperiod. Beside a component of
/// twice the period, on an XPU of its own, the same policy has two: the long way has to charge the same.
TEST(KeysCertificate, WhatIsChargedDoesNotDependOnWhoElseThereIs) {
  int apart = 0, charged = 0, blocked = 0;
  for (std::uint64_t seed = 1; seed <= 400; ++seed) {
    attack::Wanted w;
    w.components = 1;
    w.load = seed % 2 == 0 ? 0.9 : 0.5;
    w.preempt_us = seed % 3 == 0 ? 0 : 10;
    w.preemptive = seed % 4 != 3;
    w.levels = seed % 4 == 1 ? 1 + static_cast<int>(seed % 3) : 0;
    w.holds = seed % 5 > 1;
    w.order = seed % 7 > 3;
    const auto alone = attack::valid(seed, w);
    if (!alone) continue;
    Case beside = *alone;
    SourceSpec source = beside.app.sources.front();
    source.name = "another";
    source.period.num *= 2;
    beside.app.sources.push_back(source);
    beside.app.modules.push_back({"another", 1, false});
    beside.app.xnodes.push_back({"another", "another", {{"npu", 1}}});
    beside.app.xnodes.back().sources = {static_cast<int>(beside.app.sources.size()) - 1};
    beside.platform.xpus.push_back({"npu0", "npu"});
    const int npu = static_cast<int>(beside.platform.xpus.size()) - 1;
    const std::int64_t key = 1 + source.jitter_us + source.offset_us;
    beside.policy.placements.push_back({npu, {key}});
    for (Placement& placed : beside.policy.placements) placed.start_us = placed.finish_us = {};
    for (std::size_t x = 0; x + 1 < beside.policy.placements.size(); ++x)
      for (auto* times :
           {&beside.policy.placements[x].key_us, &beside.policy.placements[x].hold_us})
        if (times->size() == 1) times->push_back(times->front());
    beside.policy.app_hash = beside.app.hash();

    std::vector<Charges> found;
    std::vector<Problem> problems;
    for (const Case* c : {&*alone, &std::as_const(beside)}) {
      problems.push_back(*Problem::create(c->app, c->platform, {}, c->policy.order));
      const Problem& p = problems.back();
      std::vector<int> xpu;
      for (const Placement& placed : c->policy.placements) xpu.push_back(placed.xpu);
      Windows windows = keys_and_holds(p, c->policy);
      for (std::size_t d = 0; d < p.domains.size(); ++d)
        derive_ready(p, static_cast<int>(d), xpu, windows);
      charge(p, xpu, windows, windows, -1, found.emplace_back());
    }
    const Problem &one = problems[0], &two = problems[1];
    if (one.jobs.front() != 1) continue;
    ++apart;
    ASSERT_EQ(two.jobs.front(), 2);
    for (int i = 0; i < one.num_xnodes; ++i)
      for (int n = 0; n < 2; ++n) {
        const std::size_t s = one.slot_of(i, 0), t = two.slot_of(i, n);
        EXPECT_EQ(found[0].preempts[s], found[1].preempts[t]) << seed << " " << i;
        // Of other scales: times are compared in microseconds.
        EXPECT_EQ(found[0].blocked_by[s] * two.scale, found[1].blocked_by[t] * one.scale) << seed;
        charged += found[0].preempts[s];
        blocked += found[0].blocked_by[s] > 0 ? 1 : 0;
      }
    const auto first = check(alone->app, alone->platform, alone->policy);
    const auto second = check(beside.app, beside.platform, beside.policy);
    ASSERT_EQ(first.has_value(), second.has_value()) << seed;
    for (std::size_t m = 0; first && m < first->xpus.size(); ++m)
      EXPECT_EQ(2 * first->xpus[m].charged, second->xpus[m].charged) << seed << " XPU " << m;
  }
  std::printf("%d apps, %d charged, %d blocked\n", apart, charged, blocked);
  EXPECT_GT(apart, 100);
  EXPECT_GT(charged, 50);
  EXPECT_GT(blocked, 50);
}

}  // namespace
}  // namespace xauto::solver::keys::test
