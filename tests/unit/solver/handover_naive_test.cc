// SPDX-License-Identifier: Apache-2.0
// The simulator of changes of tables itself: executions that can be followed by hand.
#include "handover_naive.h"

#include <gtest/gtest.h>

#include "model/periodic.h"

#include "keys_naive.h"
#include "keys_random.h"

namespace xauto::solver::keys {
namespace {

/// Two tables of one app. Times are in us; the WCETs of `from` are those of `to` as well, until a
/// test says something else.
struct TwoByHand {
  AppSpec from, to, both;
  Platform platform;
  Policy p, q;

  TwoByHand(AppSpec app, Platform on, std::vector<Placement> first, std::vector<Placement> second)
      : platform(std::move(on)) {
    complete_modules(app);
    complete_chains(app);
    from = to = both = app;
    p.placements = std::move(first);
    q.placements = std::move(second);
  }
  void takes(std::size_t xnode, const std::string& type, std::int64_t then) {
    to.xnodes[xnode].wcet_us[type] = then;
    both.xnodes[xnode].wcet_us[type] = std::max(then, from.xnodes[xnode].wcet_us[type]);
  }
  [[nodiscard]] NaiveTables tables() const { return {from, to, both, platform, p, q}; }
};

/// S and t in us.
HandoverChoice change_at(const HandoverWorld& world, double s, double t) {
  HandoverChoice choice;
  choice.change = static_cast<std::int64_t>(s * static_cast<double>(world.scale));
  choice.grows = static_cast<std::int64_t>(t * static_cast<double>(world.scale));
  return choice;
}

double end_of(const HandoverWorld& world, const HandoverRun& run, int xnode, int n) {
  return static_cast<double>(run.job(xnode, n).end) / static_cast<double>(world.scale);
}

AppSpec periodic_app(std::vector<XNodeSpec> xnodes, std::vector<SourceSpec> sources) {
  AppSpec app;
  app.name = "handover";
  app.xnodes = std::move(xnodes);
  app.sources = std::move(sources);
  return app;
}

Platform handover_cpus(int count, bool preemptive = true, std::int64_t cost = 0) {
  Platform platform;
  platform.name = "cpus";
  for (int k = 0; k < count; ++k)
    platform.xpus.push_back({test::numbered("cpu", k), "cpu", preemptive, cost});
  return platform;
}

TEST(HandoverNaive, AJobGrowsFromTOn) {
  TwoByHand c(periodic_app({{"x", "m", {{"cpu", 2000}}, {0}}}, {{"s", {10'000}}}), handover_cpus(1),
              {{0, {2000}}}, {{0, {4000}}});
  c.takes(0, "cpu", 4000);
  const HandoverWorld world(c.tables());
  const auto played = [&](double s, double t) {
    return HandoverRun(world, 60'000 * world.scale, change_at(world, s, t));
  };
  // The job of 20'000 has not ended at 21'000, so takes 4 ms. It was p's: its key was 22'000.
  const HandoverRun run = played(25'000, 21'000);
  EXPECT_TRUE(run.all_ended());
  EXPECT_EQ(end_of(world, run, 0, 1), 12'000);
  EXPECT_EQ(end_of(world, run, 0, 2), 24'000);
  EXPECT_EQ(end_of(world, run, 0, 3), 34'000);
  EXPECT_EQ(run.job(0, 2).table, 0);
  EXPECT_EQ(run.job(0, 3).table, 1);
  EXPECT_EQ(run.latest_of(0), 2000 * world.scale);
  EXPECT_EQ(run.latest_of(1), 0);
  EXPECT_EQ(run.settles(), 0) << "the late one ended before S";
  EXPECT_EQ(run.passed(), 22'000 * world.scale);
  EXPECT_EQ(run.seen_us(0), 4000);
  // At 22'000 it would just have ended: it need not. A tick later it has.
  EXPECT_EQ(end_of(world, played(25'000, 22'000), 0, 2), 24'000);
  EXPECT_EQ(end_of(world, played(25'000, 22'000.125), 0, 2), 22'000);
  // What is released at S has q.
  EXPECT_EQ(played(30'000, 30'000).job(0, 3).table, 1);
  EXPECT_EQ(played(30'000.125, 30'000).job(0, 3).table, 0);
}

TEST(HandoverNaive, KeysDecideAcrossBothTables) {
  // p: a before b. q: b before a, and much later than p's b.
  TwoByHand c(periodic_app({{"a", "ma", {{"cpu", 3000}}, {0}}, {"b", "mb", {{"cpu", 4000}}, {1}}},
                           {{"sa", {10'000}}, {"sb", {10'000}, 5000}}),
              handover_cpus(1), {{0, {3000}}, {0, {9000}}}, {{0, {8000}}, {0, {4000}}});
  const HandoverWorld world(c.tables());
  // S at 28'000: b of 25'000 (key 34'000, till then alone) runs to 29'000; a of 30'000 has q's key.
  const HandoverRun run(world, 60'000 * world.scale, change_at(world, 28'000, 28'000));
  EXPECT_EQ(end_of(world, run, 1, 2), 29'000);
  EXPECT_EQ(end_of(world, run, 0, 3), 33'000);
  EXPECT_EQ(end_of(world, run, 1, 3), 39'000);
  // b grows to 7 ms: it goes on to 32'000, since its key 34'000 is before 38'000. Then a.
  c.both.xnodes[1].wcet_us["cpu"] = 7000;
  const HandoverWorld grown(c.tables());
  const HandoverRun longer(grown, 60'000 * world.scale, change_at(world, 28'000, 28'000));
  EXPECT_EQ(end_of(world, longer, 1, 2), 32'000);
  EXPECT_EQ(longer.job(0, 3).start, 32'000 * world.scale);
  EXPECT_EQ(end_of(world, longer, 0, 3), 35'000);
  EXPECT_EQ(longer.latest(), 0) << "b and q's b end with their keys";
  // One that is not preempted pays nothing; with q's a at 3500 it preempts, and pays 500.
  c.q.placements[0].key_us = {3500};
  c.platform.xpus[0].preempt_us = 500;
  const HandoverWorld urgent(c.tables());
  const HandoverRun paid(urgent, 60'000 * world.scale, change_at(world, 28'000, 28'000));
  EXPECT_EQ(end_of(world, paid, 0, 3), 33'500);
  EXPECT_EQ(end_of(world, paid, 1, 2), 35'500);
  EXPECT_EQ(paid.settles(), 11'500 * world.scale) << "q's b of 35'000 waits for p's";
  // Not preemptive: a waits.
  c.platform.xpus[0] = {"cpu0", "cpu", false, 0};
  const HandoverWorld whole(c.tables());
  const HandoverRun waits(whole, 60'000 * world.scale, change_at(world, 28'000, 28'000));
  EXPECT_EQ(end_of(world, waits, 1, 2), 32'000);
  EXPECT_EQ(end_of(world, waits, 0, 3), 35'000);
}

TEST(HandoverNaive, ActivationsStayInOrderOnAnotherXpu) {
  TwoByHand c(periodic_app({{"x", "m", {{"cpu", 2000}}, {0}}}, {{"s", {10'000}}}), handover_cpus(2),
              {{0, {14'000}, {10'500}}}, {{1, {2000}}});
  c.from.modules[0].max_in_flight = c.to.modules[0].max_in_flight =
      c.both.modules[0].max_in_flight = 2;
  c.both.xnodes[0].wcet_us["cpu"] = 3000;
  const HandoverWorld world(c.tables());
  // p's activation 2 is held until 30'500, and takes 3 ms; q's 3 of 30'000 waits for it, elsewhere.
  const HandoverRun run(world, 70'000 * world.scale, change_at(world, 29'000, 29'000));
  EXPECT_EQ(end_of(world, run, 0, 2), 33'500);
  EXPECT_EQ(run.job(0, 3).xpu, 1);
  EXPECT_EQ(run.job(0, 3).start, 33'500 * world.scale);
  EXPECT_EQ(end_of(world, run, 0, 3), 35'500);
  EXPECT_EQ(end_of(world, run, 0, 4), 42'000);
  EXPECT_EQ(run.settles(), 6500 * world.scale);
}

TEST(HandoverNaive, AFullModuleWaitsForTheOtherTable) {
  // One in flight: u and v on CPUs of their own. v of 20'000 may take 9 ms from 24'000 on.
  AppSpec app = periodic_app({{"u", "m", {{"cpu", 1000}}, {0}}, {"v", "m", {{"cpu", 4000}}}},
                             {{"s", {10'000}, 0, 1000}});
  app.edges = {{0, 1}};
  app.transfers = {{0, "cpu", "cpu", 500}};
  TwoByHand c(app, handover_cpus(2), {{0, {2000}}, {1, {6500}}}, {{0, {2000}}, {0, {6500}}});
  c.both.xnodes[1].wcet_us["cpu"] = 9000;
  const HandoverWorld world(c.tables());
  HandoverChoice choice = change_at(world, 30'000, 24'000);
  const HandoverRun run(world, 70'000 * world.scale, choice);
  EXPECT_EQ(end_of(world, run, 1, 2), 20'000 + 1000 + 500 + 9000);
  EXPECT_EQ(run.job(0, 3).start, 30'500 * world.scale);
  EXPECT_EQ(end_of(world, run, 1, 3), 30'500 + 1000 + 500 + 4000);
  EXPECT_EQ(run.seen_us(0), 10'500);
  // Largest jitter of message 2 alone.
  choice.jitter = {{0, 0, 255}};
  const HandoverRun later(world, 70'000 * world.scale, choice);
  EXPECT_EQ(end_of(world, later, 1, 2), 31'500);
  EXPECT_EQ(end_of(world, later, 1, 3), 37'000);
  EXPECT_EQ(later.latest(), 5000 * world.scale);
  // Half of what it may grow by, of nearly no work before: it has ended by then.
  choice.work = {{}, {255, 255, 0}};
  const HandoverRun brief(world, 70'000 * world.scale, choice);
  EXPECT_EQ(brief.job(1, 2).end, 22'500 * world.scale + 1);
  EXPECT_EQ(brief.passed(), -1);
}

TEST(HandoverNaive, AReaderOfTheNextTableReadsOnTheOtherXpu) {
  // u is read by v, which p holds until 6000, and q does not.
  AppSpec app = periodic_app({{"u", "mu", {{"cpu", 2000}}, {0}}, {"v", "mv", {{"cpu", 1000}}, {1}}},
                             {{"su", {10'000}}, {"sv", {10'000}}});
  app.samples = {{0, 1}};
  TwoByHand c(app, handover_cpus(2), {{0, {2000}}, {1, {7000}, {6000}}},
              {{0, {2000}}, {1, {1000}}});
  const HandoverWorld world(c.tables());
  std::size_t across = 0;
  while (c.from.chains[across].from != 0 || c.from.chains[across].to != 1) ++across;
  const auto seen = [&](double s) {
    return HandoverRun(world, 90'000 * world.scale, change_at(world, s, s)).seen_us(across);
  };
  EXPECT_EQ(seen(90'000), 7000) << "p alone: read in the same period";
  EXPECT_EQ(seen(30'000), 11'000) << "q alone: one period later";
  EXPECT_EQ(seen(0), 11'000);
}

/// Random apps: with one table, and nothing that grows, it is the rule that keys_naive.h plays.
TEST(HandoverNaive, WithoutAChangeItIsTheTableItself) {
  int plays = 0;
  for (std::uint64_t a = 0; a < 40; ++a) {
    solver::test::Dice dice(4'000'037 + a);
    RatedShape shape;
    shape.fractions = a % 4 == 0;
    const AppSpec app = random_rated_app(dice, shape);
    const Platform platform = random_rated_platform(dice);
    // No certificate is asked: any keys give an execution, while jobs may be late.
    Policy policy;
    for (const XNodeSpec& x : app.xnodes) {
      std::vector<int> may;
      for (std::size_t m = 0; m < platform.xpus.size(); ++m)
        if (x.wcet_on(platform.xpus[m].type)) may.push_back(static_cast<int>(m));
      policy.placements.push_back(
          {may[static_cast<std::size_t>(dice.roll(0, static_cast<int>(may.size()) - 1))],
           {dice.roll(4, 12), dice.roll(4, 12)},
           {0, dice.roll(0, 4)}});
    }
    policy.chains.resize(app.chains.size());
    AppSpec calm = app;  // both draw their jitter as they like
    for (SourceSpec& s : calm.sources) s.jitter_us = 0;
    Disturbance how;
    how.worst_times = true;
    how.drift = false;
    NaiveRun unchanged(calm, platform, policy, 12, how);
    unchanged.run();
    const HandoverWorld world({calm, calm, calm, platform, policy, policy});
    std::int64_t until = 0;
    for (const SourceSpec& s : calm.sources)
      until = std::max(
          until, s.offset_us * world.scale + 12 * s.period.num * (world.scale / s.period.den));
    for (const std::int64_t change : {std::int64_t{0}, until / 3, until / 2 + 1, until}) {
      HandoverChoice choice;
      choice.change = choice.grows = change;
      const HandoverRun run(world, until, choice);
      EXPECT_EQ(run.completed(), unchanged.completed()) << "app " << a;
      EXPECT_EQ(run.passed(), -1);
      for (std::size_t k = 0; k < calm.chains.size(); ++k)
        EXPECT_EQ(run.seen(k) / world.scale, unchanged.seen(k)) << "app " << a << " chain " << k;
      ++plays;
    }
  }
  EXPECT_EQ(plays, 160);
}

TEST(HandoverNaive, TheClimbFindsTheWorstChange) {
  // b (2 ms) is preempted by a (2 ms). From t on a may take 5 ms: at worst b ends 5 ms late.
  TwoByHand c(periodic_app({{"a", "ma", {{"cpu", 2000}}, {0}}, {"b", "mb", {{"cpu", 2000}}, {1}}},
                           {{"sa", {20'000}}, {"sb", {20'000}, 1000}}),
              handover_cpus(1), {{0, {2000}}, {0, {3000}}}, {{0, {5000}}, {0, {9000}}});
  c.takes(0, "cpu", 5000);
  c.takes(1, "cpu", 3000);
  // By hand: a of 0 ends at 5000, b of 1000 at 8000.
  HandoverAttack attack;
  attack.notice_us = 3000;
  attack.plays = 1500;
  const HandoverFound found = HandoverClimb(c.tables(), {{5000}, {7000}}, attack).run();
  EXPECT_FALSE(found.deadlock);
  EXPECT_FALSE(found.illegal);
  EXPECT_EQ(found.plays, 1500);
  EXPECT_DOUBLE_EQ(found.fullest[0], 1);
  EXPECT_DOUBLE_EQ(found.fullest[1], 1);
  EXPECT_DOUBLE_EQ(found.latest_us, 4000);  // b of table p: key 4000
  // Without notice t is S: b's and a's larger times meet only where S is at 2000 at the latest.
  EXPECT_GT(HandoverClimb(c.tables(), {{4999}, {6999}}, attack).run().worst, 1);
}

}  // namespace
}  // namespace xauto::solver::keys
