// SPDX-License-Identifier: Apache-2.0
// What is looked at around a change alone, against the same as a whole: jobs of one XPU against the processor demand of
// every interval (Baruah, Rosier, Howell 1990), which shares no code with it; a policy against its whole certificate.
#include <algorithm>
#include <optional>

#include <gtest/gtest.h>

#include "base/index.h"
#include "solver/keys/certificate.h"
#include "solver/keys/recertify.h"
#include "solver/keys/solve.h"

#include "keys_random.h"

namespace xauto::solver::keys {
namespace {

/// Whether the demand of no interval is above its length: of four hyperperiods, which no window is as long as.
bool demand_is_met(const std::vector<LaidJob>& jobs, Tick hyper) {
  std::vector<LaidJob> all;
  Tick load = 0;
  for (const LaidJob& job : jobs) {
    load += job.work;
    for (Tick turn = 0; turn < 4 * hyper; turn += hyper) {
      all.push_back(job);
      all.back().arrival += turn;
      all.back().due += turn - job.slack;
    }
  }
  if (load > hyper) return false;
  std::ranges::sort(all, {}, &LaidJob::due);
  for (const LaidJob& first : all) {
    Tick demand = 0;
    for (const LaidJob& job : all)
      if (job.arrival >= first.arrival && (demand += job.work) > job.due - first.arrival)
        return false;
  }
  return true;
}

LaidJob random_job(solver::test::Dice& dice, Tick hyper, Tick slack) {
  LaidJob job;
  job.arrival = dice.roll(0, static_cast<int>(hyper) - 1);
  job.work = dice.roll(1, 9);
  job.due =
      job.arrival + job.work + dice.roll(0, dice.chance(20) ? static_cast<int>(hyper) : 25) + slack;
  job.slack = slack;
  return job;
}

/// It arrives sooner, or later within its window; or it is longer or shorter.
LaidJob changed(solver::test::Dice& dice, LaidJob job, Tick hyper) {
  if (dice.chance(40)) {
    job.work = std::max(Tick{1}, job.work + dice.roll(-3, 3));
    return job;
  }
  const Tick due = job.due;
  const Tick by =
      dice.chance(70) ? -dice.roll(1, 15) : dice.roll(0, static_cast<int>(job.due - job.arrival));
  const Tick arrival = job.arrival + by, turn = floor_div(arrival, hyper) * hyper;
  job.arrival = arrival - turn;
  job.due = due - turn;
  return job;
}

TEST(KeysRecertify, AroundAChangeIsAsTheWholePattern) {
  int met = 0, missed = 0, undone = 0;
  for (std::uint64_t seed = 1; seed <= 400; ++seed) {
    solver::test::Dice dice(seed);
    const Tick hyper = dice.roll(20, 90), slack = dice.chance(30) ? dice.roll(1, 3) : 0;
    std::vector<LaidJob> jobs;
    for (int k = dice.roll(1, 20); k > 0; --k) {
      jobs.push_back(random_job(dice, hyper, slack));
      std::vector<LaidJob> sorted = jobs;
      const bool fits = fits_alone(sorted, hyper);
      EXPECT_EQ(fits, demand_is_met(jobs, hyper)) << seed;
      if (!fits) jobs.pop_back();
    }
    FittingAlone::Jobs numbered;
    for (std::size_t k = 0; k < jobs.size(); ++k) numbered.emplace_back(k, jobs[k]);
    FittingAlone kept(hyper, numbered);
    for (int k = 0; k < 100 && !jobs.empty(); ++k) {
      FittingAlone::Jobs change;
      std::vector<LaidJob> next = jobs;
      for (std::size_t j = 0; j < jobs.size(); ++j) {
        if (!dice.chance(static_cast<int>(150 / jobs.size()))) continue;
        next[j] = changed(dice, jobs[j], hyper);
        change.emplace_back(j, next[j]);
      }
      const bool fits = demand_is_met(next, hyper);
      ASSERT_EQ(kept.change(change), fits) << seed << ", change " << k;
      ++(fits ? met : missed);
      if (fits && dice.chance(30)) {
        kept.undo();
        ++undone;
      } else if (fits) {
        jobs = next;
      }
    }
  }
  EXPECT_GT(met, 2000);
  EXPECT_GT(missed, 1000);
  EXPECT_GT(undone, 500);
}

/// The policy as solve has it, each job held until it is ready: the most that may fall.
struct Held {
  Problem problem;
  std::vector<int> xpu;
  Windows w;
};
std::optional<Held> held(solver::test::Dice& dice, const RatedShape& shape) {
  AppSpec app = random_rated_app(dice, shape);
  Platform platform = random_rated_platform(dice);
  for (Xpu& xpu : platform.xpus)
    if (xpu.preemptive && dice.chance(80)) xpu.preempt_us = dice.roll(1, 3);
  if (shape.ppm > 0) stretch(app, platform, 1000);
  const auto answer = solve(app, platform, brief(30));
  EXPECT_TRUE(answer);
  if (!answer || answer->outcome != Outcome::kPolicy) return {};
  Held of{Problem::create(app, platform, {}, answer->policy.order).value(), {}, {}};
  for (const Placement& placed : answer->policy.placements) of.xpu.push_back(placed.xpu);
  of.w = keys_and_holds(of.problem, answer->policy);
  EXPECT_TRUE(certify(of.problem, of.xpu, of.w));
  Windows all = of.w;
  all.hold = all.a;
  for (Tick& hold : all.hold) hold = hold / of.problem.scale * of.problem.scale;
  if (certify(of.problem, of.xpu, all)) of.w = all;
  return of;
}

TEST(KeysRecertify, AfterEachHoldIsAsTheWholeCertificate) {
  int kept = 0, lost = 0;
  for (int kind = 0; kind < 4; ++kind)
    for (std::uint64_t seed = 1; seed <= 60; ++seed) {
      solver::test::Dice dice(seed);
      RatedShape shape;
      shape.max_components = 4;
      shape.clocks = kind == 1 || kind == 2 ? 2 : 1;
      shape.ppm = kind == 2 ? 20'000 : 0;
      shape.urgent = kind == 3;
      std::optional<Held> of = held(dice, shape);
      if (!of) continue;
      const Problem& p = of->problem;
      Recertifier recertifier(p, of->xpu, of->w);
      for (int k = 0; k < 40; ++k) {
        Windows next = of->w;
        for (int s = 0; s < p.num_slots; ++s)
          if (next.hold[at(s)] > 0 && dice.chance(k % 2 == 0 ? 60 / p.num_slots + 1 : 30))
            next.hold[at(s)] = dice.chance(60) ? 0 : next.hold[at(s)] / 2 / p.scale * p.scale;
        const bool whole = certify(p, of->xpu, next);
        // What does not fall is asked for elsewhere (holds.cc).
        bool falls = false;
        for (int s = 0; s < p.num_slots; ++s) {
          const int i = p.slot_xnode[at(s)];
          const Tick period = p.period_of(i);
          falls = falls || next.hold[p.slot_of(i, s - p.slot[at(i)] + 1)] + period -
                                   lost_in(period, p.domains[at(p.domain_of(i))].ppm) <
                               next.hold[at(s)];
        }
        if (falls) continue;
        std::vector<Recertifier::Was> fallen;
        for (int s = 0; s < p.num_slots; ++s)
          if (next.a[at(s)] != of->w.a[at(s)] || next.e[at(s)] != of->w.e[at(s)])
            fallen.push_back({s, of->w.a[at(s)], of->w.hold[at(s)], of->w.e[at(s)]});
        ASSERT_EQ(recertifier.still(next, fallen), whole) << kind << ", seed " << seed << ", " << k;
        if (fallen.empty()) continue;
        ++(whole ? kept : lost);
        if (whole) of->w = next;
      }
    }
  EXPECT_GT(kept, 500);
  EXPECT_GT(lost, 200);
}

}  // namespace
}  // namespace xauto::solver::keys
